"""Voids that no nodata value declares are no heights, wherever rasters of heights are read."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.imagery.dem import dem_range, surface_of
from repm_qgis.imagery.heights import read_heights, void_share
from repm_qgis.imagery.raster import opened
from repm_qgis.stages import run_stage
from tests.engine.change.test_change import ground, write

VOIDS = (32767.0, -32768.0, -9999.0, -3.4028235e38, 3.4028235e38, 9999.0)
PLACE = (500_000.0, 4_000_000.0)
HOLE = (slice(40, 61), slice(70, 90))


def raster(path, values, crs="EPSG:32631", cell=2.0):
    """A raster that declares no nodata value."""
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), *values.shape[::-1], 1, gdal.GDT_Float32)
    dataset.SetGeoTransform((PLACE[0], cell, 0, PLACE[1], 0, -cell))
    from osgeo import osr

    system = osr.SpatialReference()
    system.SetFromUserInput(crs)
    dataset.SetSpatialRef(system)
    dataset.GetRasterBand(1).WriteArray(values.astype(np.float32))
    dataset = None
    return str(path)


def holed(void, shape=(200, 240)):
    values = (600 + 3 * np.sin(np.arange(shape[1]) / 9) + np.zeros(shape)).astype(np.float32)
    values[HOLE] = void
    return values


@pytest.mark.parametrize("void", VOIDS)
@pytest.mark.parametrize("size", (None, (60, 50), (37, 41)))
def test_voids_are_not_read_and_not_averaged(tmp_path, void, size):
    path = raster(tmp_path / "dsm.tif", holed(void))
    with opened(path) as dataset:
        heights = read_heights(dataset, None, 1, size)
        assert void_share(dataset) == pytest.approx(21 * 20 / (200 * 240))
    assert heights.shape == ((200, 240) if size is None else size[::-1])
    known = np.isfinite(heights)
    assert 0.97 < known.mean() < 1.0 and np.abs(heights[known] - 600).max() < 3.1


@pytest.mark.parametrize("void", VOIDS)
def test_the_range_and_the_surface_of_a_dem_leave_them_out(tmp_path, void):
    path = raster(tmp_path / "dem.tif", holed(void), cell=20.0)
    low, high, _ = dem_range(path, "EPSG:32631", (PLACE[0], PLACE[1] - 4000, PLACE[0] + 4800, PLACE[1]))
    assert 596 < low < high < 604
    surface = surface_of(path, Bounds(3.001, 36.13, 3.05, 36.14), 50.0)
    assert 596 < surface.heights.min() < surface.heights.max() < 604


def test_a_shared_dem_with_voids_gives_the_altitudes_of_its_ground(shared_data):
    path = shared_data / "cases" / "dem_void" / "void_32767.tif"
    with opened(str(path)) as dataset:
        xmin, width, _, ymax, _, height = dataset.GetGeoTransform()
        bounds = (xmin, ymax + 214 * height, xmin + 216 * width, ymax)
    low, high, _ = dem_range(str(path), "EPSG:32631", bounds)
    assert 0 < low < high < 1000


def test_a_comparison_leaves_them_out_and_names_the_file(tmp_path, told):
    heights = ground()
    holey = np.where(np.add.outer(np.arange(300), np.arange(300)) % 7 == 0, 32767.0, heights)
    dsm, reference = write(tmp_path / "dsm.tif", [heights + 0.1]), raster(tmp_path / "reference.tif", holey, cell=0.5)
    dataset = gdal.Open(reference, gdal.GA_Update)
    dataset.SetGeoTransform((500000.0, 0.5, 0, 5000000.0, 0, -0.5))
    dataset = None
    said = told()
    report = str(tmp_path / "report.html")
    found = run_stage("comparedsm", {"dsm": dsm, "reference": reference, "report": report}, said)
    page = open(report, encoding="utf-8").read()
    assert "numbers that cannot be heights" in page and "Good." not in page
    assert found.rmse == pytest.approx(0.1, abs=0.01)
    (text,) = [text for text in said.warnings if "cannot be heights" in text]
    assert text.startswith("14.3 % of the cells of") and reference in text


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("stage", ("dtm", "buildings", "change"))
def test_dsms_with_huge_voids_are_worked_on(tmp_path, told, stage):
    heights = ground()
    heights[100:130, 100:140] = 3.4e38
    path = raster(tmp_path / "dsm.tif", heights, cell=0.5)
    page = str(tmp_path / "report.html")
    said, output = told(), str(tmp_path / ("o.gpkg" if stage == "buildings" else "o.tif"))
    if stage == "change":
        other = raster(tmp_path / "after.tif", np.where(heights > 1e9, heights, heights + 0.01), cell=0.5)
        run_stage(stage, {"before": path, "after": other, "output": output, "align": "none", "report": page}, said)
    else:
        run_stage(stage, {"dsm": path, "output": output, "report": page}, said)
    assert "Good." not in open(page, encoding="utf-8").read()
    assert any("1.3 % of the cells" in text for text in said.warnings)
    if stage == "dtm":
        with opened(output) as dataset:
            terrain = read_heights(dataset)
        assert 90 < np.nanmin(terrain) < np.nanmax(terrain) < 130


def test_another_nodata_value_does_not_make_the_usual_mark_a_height(tmp_path):
    path = raster(tmp_path / "dsm.tif", holed(-9999.0))
    dataset = gdal.Open(path, gdal.GA_Update)
    dataset.GetRasterBand(1).SetNoDataValue(0.0)
    dataset = None
    with opened(path) as dataset:
        assert np.nanmin(read_heights(dataset)) > 590 and np.nanmin(read_heights(dataset, None, 1, (60, 50))) > 590


def test_the_usual_mark_is_a_note(tmp_path, told):
    said = told()
    dsm = write(tmp_path / "dsm.tif", [ground()])
    heights = ground()
    heights[:30] = -9999
    reference = raster(tmp_path / "reference.tif", heights, cell=0.5)
    dataset = gdal.Open(reference, gdal.GA_Update)
    dataset.SetGeoTransform((500000.0, 0.5, 0, 5000000.0, 0, -0.5))
    dataset = None
    run_stage("comparedsm", {"dsm": dsm, "reference": reference}, said)
    assert any(text.startswith("10.0 % of the cells of") for text in said.notes)
    assert not any("cells of" in text for text in said.warnings)
