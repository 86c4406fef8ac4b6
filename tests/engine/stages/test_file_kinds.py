"""The same images in files of other kinds, mixed in one run, give the same DSM, to the bit where no value changes."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from benchmarks.files import FORMS, LEAST_ALIKE_M, rpc_error_px
from repm_qgis.evaluation.metrics import nmad
from repm_qgis.stages import run_stage

NAMED = {form.name: form for form in FORMS}


@pytest.fixture(scope="module")
def dsm_of(mountains, tmp_path_factory, told):
    """The heights of a run on the mountains' images, each in one of the kinds named."""

    def run(*kinds):
        folder, images = tmp_path_factory.mktemp("kinds"), []
        for number, (kind, image) in enumerate(zip(kinds, mountains.images)):
            if not NAMED[kind].writable():
                pytest.skip(f"this GDAL does not write {NAMED[kind].driver}")
            place = folder / str(number)
            place.mkdir()
            images.append(NAMED[kind].write(image, place))
            assert rpc_error_px(images[-1], image) < 1e-6
        options = {"images": images, "workspace": str(folder / "w"), "output": str(folder / "dsm.tif")}
        run_stage("pipeline", {**options, "resolution": 1.0, "workers": 1}, told())
        dsm = gdal.Open(str(folder / "dsm.tif"))
        # On the same cells, whichever of them are the first that have heights.
        xmin, _, _, ymax = mountains.bounds
        west, _, _, north, _, _ = dsm.GetGeoTransform()
        row, column = round(np.ceil(ymax) + 300 - north), round(west - np.floor(xmin) + 300)
        heights = np.full((1000, 1000), -9999.0, np.float32)
        heights[row : row + dsm.RasterYSize, column : column + dsm.RasterXSize] = dsm.ReadAsArray()
        return heights

    return run


@pytest.fixture(scope="module")
def plain(dsm_of):
    found = dsm_of(*["16 bit, as it came"] * 3)
    assert (found != -9999).sum() > 100_000
    return found


@pytest.mark.parametrize(
    "kinds",
    (
        ("12 bit", "JPEG 2000, lossless", "RGBA, 16 bit"),
        ("COG", "NITF", "12 bit"),
        ("JPEG 2000, lossless", "VRT", "COG"),
    ),
)
@pytest.mark.slow
def test_kinds_that_keep_every_value(dsm_of, plain, kinds):
    np.testing.assert_array_equal(dsm_of(*kinds), plain)


@pytest.mark.parametrize("kinds", (("float, 0 to 1", "12 bit", "float, 0 to 1"), ("float", "RGBA, 16 bit", "float")))
@pytest.mark.slow
def test_kinds_of_which_means_are_not_rounded(dsm_of, plain, kinds):
    found = dsm_of(*kinds)
    both = (found != -9999) & (plain != -9999)
    assert both.mean() > 0.99 * (plain != -9999).mean()
    assert nmad((found - plain)[both]) < LEAST_ALIKE_M
