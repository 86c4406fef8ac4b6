"""The brightness of cells: the median of the views that show them, in units of what each of them has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.fusion.brightness import brightness
from repm_qgis.fusion.parameters import FUSION
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.scene import load_views

HEIGHT = np.full((60, 60), 200.0)


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


def ramp(contrast, level):
    return level + contrast * np.mgrid[:400, :400][1]


def test_units_do_not_matter(urban, middle, view_of):
    found = [
        brightness([view_of(f"unit{contrast}", ramp(contrast, level))], middle, HEIGHT, urban.crs)
        for contrast, level in ((1.0, 0.0), (40.0, 3000.0))
    ]
    np.testing.assert_allclose(*found, atol=1e-3)
    dark, bright = np.percentile(found[0], FUSION.brightness.percents)
    assert dark == pytest.approx(0.0, abs=1e-4) and bright == pytest.approx(1.0, abs=1e-4)


def test_what_one_of_three_views_shows_does_not_count(urban, middle, view_of):
    """A shadow that only one date has."""
    lit, shaded = ramp(1.0, 10.0), ramp(1.0, 10.0)
    shaded[150:250, 150:250] = 0.0
    once = brightness([view_of("lit", lit)], middle, HEIGHT, urban.crs)
    views = [view_of("first", lit), view_of("second", shaded), view_of("third", lit)]
    np.testing.assert_allclose(brightness(views, middle, HEIGHT, urban.crs), once, atol=1e-3)


def test_views_of_other_ground_are_passed_over(urban, middle, view_of):
    """The first views that show the ground are taken: here the second one, although one is wanted."""
    far = CellGrid(middle.west + 5000.0, middle.north, 0.5, (60, 60))
    here = view_of("here", ramp(1.0, 10.0))
    one = replace(FUSION, brightness=replace(FUSION.brightness, views=1))
    nothing = view_of("nothing", np.full((400, 400), np.nan))
    found = brightness([nothing, here], middle, HEIGHT, urban.crs, one)
    np.testing.assert_array_equal(found, brightness([here], middle, HEIGHT, urban.crs))
    assert np.isnan(brightness([here], far, HEIGHT, urban.crs)).all()


def test_nothing_is_known_without_views_or_heights(urban, middle, view_of):
    assert np.isnan(brightness([], middle, HEIGHT, urban.crs)).all()
    assert np.isnan(brightness([view_of("some", ramp(1.0, 0.0))], middle, HEIGHT * np.nan, urban.crs)).all()
