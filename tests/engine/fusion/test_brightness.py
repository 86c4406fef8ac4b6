"""The brightness of cells: the median of the views that show them, in units of what each of them has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Window
from repm_qgis.fusion.brightness import Witnesses, brightness
from repm_qgis.fusion.parameters import FUSION
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.footprints import ray_slope
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.scene import load_views

HEIGHT = np.full((60, 60), 200.0, np.float32)
LEVELS = (150.0, 260.0)


@pytest.fixture(scope="module")
def middle(urban):
    """A grid of 60 x 60 cells of 0.5 m in the middle of the town."""
    x0, y0, x1, y1 = urban.bounds
    return CellGrid(np.floor((x0 + x1) / 2) - 15, np.floor((y0 + y1) / 2) + 15, 0.5, (60, 60))


@pytest.fixture(scope="module")
def view_of(urban, tmp_path_factory, write_image):
    """A function that gives a view with the geometry of the town's first and other pixels."""
    folder = tmp_path_factory.mktemp("brightness")

    def view(name, pixels, index=0):
        path = write_image(folder / f"{name}.tif", pixels.astype(np.float32), urban.views[index].rpc)
        return load_views((path,))[0]

    return view


@pytest.fixture(scope="module")
def seen_by(urban):
    """A function that gives the brightness of a grid as some views show it."""

    def seen(views, grid, height=HEIGHT, parameters=FUSION.brightness):
        stretches = tuple(view_stretch(view.image, view.band) for view in views)
        place = np.array([(urban.views[0].rpc.lon_off), (urban.views[0].rpc.lat_off)])
        slopes = tuple(ray_slope(view, place, 200.0) for view in views)
        return brightness(Witnesses(tuple(views), stretches, slopes, urban.crs, LEVELS), grid, height, parameters)

    return seen


def ramp(contrast, level):
    return level + contrast * np.mgrid[:400, :400][1]


def test_units_do_not_matter(middle, view_of, seen_by):
    found = [
        seen_by([view_of(f"unit{contrast}", ramp(contrast, level))], middle)
        for contrast, level in ((1.0, 0.0), (40.0, 3000.0))
    ]
    np.testing.assert_allclose(*found, atol=1e-3)
    assert 0.0 < np.nanmin(found[0]) < np.nanmax(found[0]) < 1.0


def test_what_one_of_three_views_shows_does_not_count(middle, view_of, seen_by):
    """A shadow that only one date has."""
    lit, shaded = ramp(1.0, 10.0), ramp(1.0, 10.0)
    shaded[150:250, 150:250] = 0.0
    once = seen_by([view_of("lit", lit)], middle)
    views = [view_of("first", lit), view_of("second", shaded), view_of("third", lit)]
    np.testing.assert_allclose(seen_by(views, middle), once, atol=1e-3)


def test_views_of_other_ground_are_passed_over(middle, view_of, seen_by):
    far = CellGrid(middle.west + 5000.0, middle.north, 0.5, (60, 60))
    assert np.isnan(seen_by([view_of("here", ramp(1.0, 10.0))], far)).all()


def test_no_more_views_than_wanted_are_asked(middle, view_of, seen_by):
    one = replace(FUSION.brightness, views=1)
    views = [view_of("one", ramp(1.0, 10.0)), view_of("other", ramp(-1.0, 500.0))]
    np.testing.assert_array_equal(seen_by(views, middle, parameters=one), seen_by(views[:1], middle))


def test_a_part_of_the_cells_is_as_bright_as_in_the_whole(middle, view_of, seen_by):
    """To the byte: neither the block nor its place has a part in it."""
    views = [view_of("a", ramp(1.0, 10.0)), view_of("b", ramp(2.0, 7.0), 1)]
    window = Window(7, 11, 40, 33)
    part = seen_by(views, middle.part(window), HEIGHT[11:44, 7:47])
    np.testing.assert_array_equal(part, seen_by(views, middle)[11:44, 7:47])


def test_nothing_is_known_without_views_or_heights(middle, view_of, seen_by):
    assert np.isnan(seen_by([], middle)).all()
    assert np.isnan(seen_by([view_of("some", ramp(1.0, 0.0))], middle, HEIGHT * np.float32(np.nan))).all()
