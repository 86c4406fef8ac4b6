"""Water that multispectral images show and panchromatic ones hide: sun glint, and water that is bright of mud."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from benchmarks.water_and_clouds import LAND, WATER, make_pair
from repm_qgis.stages import run_stage


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """A pair of mountains with four lakes, and multispectral images beside it under a vendor's names."""
    return make_pair(str(tmp_path_factory.mktemp("lakes")), "mountains", 500, seed=6, clouds=False, xs=True)


def shares(pair, mask):
    """The share of each kind of water, and of land, that a mask takes for water."""
    truth = gdal.Open(pair.truth)
    place, size = truth.GetGeoTransform(), (truth.RasterXSize, truth.RasterYSize)
    bounds = (place[0], place[3] + place[5] * size[1], place[0] + place[1] * size[0], place[3])
    there = gdal.Warp("", mask, format="MEM", outputBounds=bounds, xRes=place[1], yRes=place[1], dstNodata=255)
    water, classes = there.ReadAsArray() == 1, pair.classes[: size[1], : size[0]]
    return {name: float(water[classes == number].mean()) for name, number in {**WATER, "land": LAND}.items()}


@pytest.mark.slow
def test_the_index_finds_glint_and_mud_and_ends_at_the_bank(pair, tmp_path, told):
    job = {
        "images": pair.images,
        "workspace": str(tmp_path),
        "output": str(tmp_path / "dsm.tif"),
        "resolution": 1.0,
        "workers": 1,
        "water": "flatten",
        "water_mask": str(tmp_path / "water.tif"),
    }
    heard = told()
    result = run_stage("pipeline", job, heard)
    with_xs = shares(pair, job["water_mask"])
    assert min(with_xs[name] for name in WATER) > 0.8 and with_xs["land"] < 0.02
    said = gdal.Open(job["water_mask"]).GetMetadataItem("REPM_WATER")
    assert said.startswith("NDWI above 0.") and any("NDWI above" in text for text in heard.notes)
    dsm = gdal.Open(job["output"]).ReadAsArray()
    # The same scene without the colours' help: what is bright is not looked for.
    fuse = {"scene": result.scene, "output": str(tmp_path / "grey.tif"), "colour": "greys", "workers": 1}
    grey = {**fuse, "resolution": 1.0, "water": "flatten", "water_mask": str(tmp_path / "grey_water.tif")}
    run_stage("dsmfuse", grey, told())
    without = shares(pair, grey["water_mask"])
    assert without["still"] > 0.7 and max(without["glint"], without["murky"]) == 0.0
    assert gdal.Open(grey["water_mask"]).GetMetadataItem("REPM_WATER") == "empty, dark and smooth"
    assert np.isfinite(dsm).all()
