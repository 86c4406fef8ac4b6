"""The orthophoto: brightness from where the ground is seen, and no roof painted on the street behind it."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.fusion.visible import nadir_first, orthophoto
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.footprints import ray_slope
from repm_qgis.geometry.frames import EnuFrame, geodetic_from_projected
from repm_qgis.scene import Scene, load_views


@pytest.fixture(scope="module")
def middle(urban):
    """A grid of 100 x 100 cells of 0.5 m in the middle of the town."""
    x0, y0, x1, y1 = urban.bounds
    west, north = np.floor((x0 + x1) / 2) - 25, np.floor((y0 + y1) / 2) + 25
    return CellGrid(west, north, 0.5, (100, 100))


def on_ground(urban, grid, height):
    xs, ys = grid.centres()
    lon_lat = geodetic_from_projected(urban.crs, np.stack(np.meshgrid(xs, ys), axis=-1))
    return np.concatenate([lon_lat, np.broadcast_to(height, grid.shape)[..., None]], axis=-1)


def painted(urban, folder, write_image, index=0):
    """A view whose brightness tells the column and row it was taken from: 10 x column, or 10 x row."""
    rows, cols = np.mgrid[:400, :400]
    return [
        load_views(
            (write_image(folder / f"{name}.tif", (10 * axis + 100).astype(np.float32), urban.views[index].rpc),)
        )[0]
        for name, axis in (("col", cols), ("row", rows))
    ]


def test_each_cell_has_the_brightness_of_its_pixel(urban, middle, tmp_path, write_image):
    height = 200 + 20 * np.sin(np.arange(100) / 15)[:, None] * np.cos(np.arange(100) / 20)
    expected = urban.views[0].rpc.project(on_ground(urban, middle, height))
    for axis, view in enumerate(painted(urban, tmp_path, write_image)):
        found = (orthophoto([view], middle, height, urban.crs) - 100) / 10
        seen = np.isfinite(found)
        assert seen.mean() > 0.9
        assert np.abs(found - expected[..., axis])[seen].max() < 0.05


def test_a_box_hides_what_lies_behind_it(urban, middle, tmp_path, write_image):
    """A tower of 30 m: the cells behind it are left empty, and they are those its shadow of sight says."""
    height = np.full((100, 100), 180.0)
    height[40:60, 40:60] = 210.0
    view = painted(urban, tmp_path, write_image)[0]
    found = orthophoto([view], middle, height, urban.crs)
    centre = on_ground(urban, middle, height)[50, 50, :2]
    slope = ray_slope(view, centre, 195.0)
    # Toward the satellite a ray climbs 1 m for each |slope| m: behind the tower, 30 m high, that much is hidden.
    hidden = np.zeros((100, 100), bool)
    for lift in np.arange(0.5, 30.0, 0.25):
        dc, dr = -slope[0] * lift / 0.5, slope[1] * lift / 0.5
        r0, r1, c0, c1 = 40 + dr, 60 + dr, 40 + dc, 60 + dc
        r, c = np.mgrid[:100, :100] + 0.5
        hidden |= (r > r0) & (r < r1) & (c > c0) & (c < c1)
    hidden &= height < 200
    empty = np.isnan(found)
    assert 30 < hidden.sum() < 3000
    assert (empty & hidden).sum() / hidden.sum() > 0.85
    assert (empty & ~hidden).sum() < 0.15 * hidden.sum() + 60
    assert np.isfinite(found[42:58, 42:58]).all()


def test_other_views_fill_what_one_does_not_see(urban, middle):
    """Each cell once, from the first that sees it."""
    height = np.full((100, 100), 180.0)
    height[40:60, 40:60] = 215.0
    one = orthophoto(urban.views[:1], middle, height, urban.crs)
    all_three = orthophoto(urban.views, middle, height, urban.crs)
    assert np.isnan(one).sum() > np.isnan(all_three).sum()
    seen = np.isfinite(one)
    np.testing.assert_array_equal(all_three[seen], one[seen])


def test_no_height_no_brightness(urban, middle):
    height = np.full((100, 100), np.nan)
    assert np.isnan(orthophoto(urban.views, middle, height, urban.crs)).all()
    height[10:20, 10:20] = 190.0
    found = orthophoto(urban.views, middle, height, urban.crs)
    assert (np.isfinite(found) == np.isfinite(height)).all()


def test_the_steepest_view_comes_first(urban):
    lon, lat = urban.views[0].rpc.lon_off, urban.views[0].rpc.lat_off
    scene = Scene(urban.views, EnuFrame(lon, lat), urban.crs, "", (150.0, 250.0), [])
    tilt = {v["name"]: np.hypot(v["pitch_deg"], v["roll_deg"]) for v in urban.record["views"]}
    assert [view.name for view in nadir_first(scene)] == sorted(tilt, key=tilt.get)
