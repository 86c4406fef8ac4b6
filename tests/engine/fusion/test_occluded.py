"""The ground behind a block, which the height map's own view does not see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.fusion.occluded import occluded_ground
from repm_qgis.fusion.visible import blocked, slope_over
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.imagery.raster import opened, read
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stereo.height_maps import HeightMap

WEST, EAST, SOUTH, NORTH = 40.0, 70.0, 30.0, 60.0
GROUND, ROOF = 100.0, 124.0


def view(column_lean, row_lean, rise=0.0, size=110):
    """What a view sees of a block on ground that rises with x: a pixel is a metre, rows run with y."""
    column, row = np.meshgrid(np.arange(float(size)), np.arange(float(size)))
    height = GROUND + rise * column / (1 + rise * column_lean)
    for z in np.arange(GROUND, ROOF + 0.01, 0.05):
        x, y = column - column_lean * (z - GROUND), row - row_lean * (z - GROUND)
        height = np.where((x > WEST) & (x < EAST) & (y > SOUTH) & (y < NORTH), z, height)
    x, y = column - column_lean * (height - GROUND), row - row_lean * (height - GROUND)
    return HeightMap(
        x,
        y,
        height,
        np.ones(height.shape, np.float32),
        np.zeros(height.shape, dtype=bool),
        (-column_lean, -row_lean),
        (column_lean, row_lean),
    )


def is_hidden(x, y, column_lean, row_lean):
    """Whether ground points are outside the block and the view's line of sight to them meets it."""

    def inside(px, py, room=0.0):
        return (px > WEST - room) & (px < EAST + room) & (py > SOUTH - room) & (py < NORTH + room)

    met = np.zeros(np.shape(x), dtype=bool)
    for up in np.arange(0.0, ROOF - GROUND, 0.1):
        met |= inside(x - column_lean * up, y - row_lean * up)
    return met & ~inside(x, y)


@pytest.mark.parametrize("lean", ((0.5, 0.0), (-0.5, 0.0), (0.0, 0.4), (0.3, -0.01), (-0.45, 0.08), (0.3, 0.3)))
def test_occluded_ground_is_where_the_view_does_not_see(lean):
    heights = view(*lean)
    x, y, z = occluded_ground(heights, 3.0)
    np.testing.assert_allclose(z, GROUND)
    cells = np.stack(np.meshgrid(np.arange(100) + 0.5, np.arange(100) + 0.5), axis=-1)
    truth = is_hidden(cells[..., 0], cells[..., 1], *lean)
    found = np.zeros(truth.shape, dtype=bool)
    found[np.floor(y).astype(int), np.floor(x).astype(int)] = True
    assert truth.sum() > 200
    # All but a pixel along the borders, of which the strip has two long ones.
    assert (truth & found).sum() > 0.8 * truth.sum() and (found & ~truth).sum() < 0.2 * truth.sum()


@pytest.mark.parametrize("lean, rise", ((0.4, 0.2), (0.4, -0.15), (-0.4, 0.1)))
def test_occluded_ground_goes_on_as_the_ground_before_it_slopes(lean, rise):
    x, _, z = occluded_ground(view(lean, 0.0, rise), 3.0)
    assert len(z) > 100
    assert np.abs(z - (GROUND + rise * x)).max() < 0.35  # what a pixel more or less of the strip makes


def test_no_step_hides_nothing():
    heights = view(0.5, 0.0)
    level = np.full(heights.height.shape, GROUND)
    slope = GROUND + np.arange(level.shape[1]) * 1.5 + np.zeros((level.shape[0], 1))
    for height in (level, slope, np.full(level.shape, np.nan)):
        points = occluded_ground(replace(heights, height=height), 3.0)
        assert all(part.size == 0 for part in points)
    assert occluded_ground(view(0.0, 0.0), 3.0)[2].size == 0


@pytest.mark.long
def test_a_pairs_fills_are_right_on_a_truth_scene(urban_run, tmp_path, told, capsys):
    """Most of what is filled has the true surface's height. 98 % of the cells that both images see have a height, and
    seven eighths of those that one of them hides: long gaps over which disparities fall stay empty on purpose."""
    town, scene = urban_run.scene, Scene.load(urban_run.result.scene)
    scene = scene.with_tiles(lambda tile: replace(tile, heights=tile.heights[:1]))
    dsm, sure, error = (str(tmp_path / name) for name in ("dsm.tif", "confidence.tif", "error.tif"))
    run_stage(
        "dsmfuse",
        {"scene": scene.save(str(tmp_path / "pair.json")), "output": dsm, "confidence": sure, "resolution": 0.5},
        told(),
    )
    found = run_stage("comparedsm", {"dsm": dsm, "reference": town.truth, "align": "3d", "error": error}, told())
    with opened(error) as dataset:
        errors, (west, cell, _, north, _, _) = read(dataset), dataset.GetGeoTransform()
    with opened(sure) as dataset:
        source, (x0, size, _, y0, _, _) = read(dataset, band=4), dataset.GetGeoTransform()
    rows, columns = np.indices(errors.shape)
    c = np.floor((west + (columns + 0.5) * cell - found.dx - x0) / size).astype(int)
    r = np.floor((y0 - north + (rows + 0.5) * cell + found.dy) / size).astype(int)
    inside = (c >= 0) & (r >= 0) & (c < source.shape[1]) & (r < source.shape[0])
    filled = inside & (source[np.where(inside, r, 0), np.where(inside, c, 0)] == 1) & np.isfinite(errors)
    right = (np.abs(errors[filled]) < 2.5).mean()
    grid = CellGrid(town.transform[0], town.transform[3], town.transform[1], town.surface.shape)
    views = [view for view in town.true_views if view.name in scene.tiles[0].heights[0].pair]
    surface = town.surface.astype(np.float32)
    hidden = [blocked(slope_over(view, grid, surface, town.crs), grid, surface, 0.5) for view in views]
    known, seen = np.isfinite(errors), ~(hidden[0] | hidden[1])
    shares = known[seen].mean(), known[~seen].mean()
    with capsys.disabled():
        print(
            f"\n{filled.sum()} cells filled, {100 * right:.1f} % right within 2.5 m; a height "
            f"in {100 * shares[0]:.2f} % of what both images see, {100 * shares[1]:.2f} % of what one hides"
        )
    assert len(views) == 2 and 0.1 < (~seen).mean() < 0.2
    assert filled.sum() > 15000 and right > 0.78 and shares[0] > 0.98 and shares[1] > 0.875
