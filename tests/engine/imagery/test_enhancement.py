"""One stretch for a whole view."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Window
from repm_qgis.contracts.errors import ImageError
from repm_qgis.imagery.enhancement import Stretch, view_stretch


def test_stretch_is_a_root_up_to_the_threshold_and_keeps_nan():
    pixels = np.array([[50, 100, 200, 500, np.nan]], dtype=np.float32)
    found = Stretch(100.0, 500.0).apply(pixels)
    np.testing.assert_allclose(found[0, :4], [0, 0, 0.45, 0.9], atol=1e-6)
    assert np.isnan(found[0, 4]) and found.dtype == np.float32


def test_above_the_threshold_brighter_stays_brighter_and_below_1():
    found = Stretch(100.0, 500.0).apply(np.arange(300, 1200, 5, dtype=np.float32)[None])[0]
    assert (np.diff(found) > 0).all() and found[-1] < 1.0
    steps = np.diff(found)
    assert np.abs(np.diff(steps)).max() < 0.1 * steps.max()  # no kink at the threshold


def test_percentiles_leave_out_glare_and_nodata(tmp_path, write_image):
    values = np.tile(np.arange(100, 1100, dtype=np.uint16), (300, 1))
    values[:60] = 0
    values[100, :10] = 65000
    stretch = view_stretch(write_image(tmp_path / "a.tif", values, nodata=0), 1)
    assert stretch.low == pytest.approx(101, abs=1.5) and stretch.high == pytest.approx(1094.5, abs=3)


@pytest.mark.parametrize(
    "values, nodata, words",
    (
        (np.zeros((100, 100), np.uint16), 0, "has only nodata in band 1"),
        (np.full((100, 100), 37, np.uint16), None, "has the same value (37) almost everywhere"),
    ),
)
def test_images_that_show_nothing(tmp_path, write_image, values, nodata, words):
    path = write_image(tmp_path / "a.tif", values, nodata=nodata)
    with pytest.raises(ImageError) as caught:
        view_stretch(path, 1)
    assert path in str(caught.value) and words in str(caught.value)


def test_of_a_part_that_is_used_nothing_outside_counts(tmp_path, write_image):
    part = np.random.default_rng(1).integers(200, 900, (300, 400)).astype(np.uint16)
    values = np.full((6000, 5000), 40, np.uint16)  # less than the threshold's share of it has data
    values[700:1000, 4000:4400] = part
    path = write_image(tmp_path / "whole.tif", values)
    with pytest.raises(ImageError, match="has the same value .40. almost everywhere"):
        view_stretch(path, 1)
    found = view_stretch(path, 1, part=Window(4000, 700, 400, 300))
    assert found == view_stretch(write_image(tmp_path / "part.tif", part), 1)


def test_a_part_that_shows_nothing_takes_the_stretch_of_the_whole(tmp_path, write_image):
    """The view has nothing to add there, and the run goes on with the others."""
    values = np.tile(np.arange(100, 1100, dtype=np.uint16), (300, 1))
    values[:100, :200] = 0
    path = write_image(tmp_path / "a.tif", values, nodata=0)
    assert view_stretch(path, 1, part=Window(0, 0, 200, 100)) == view_stretch(path, 1)
