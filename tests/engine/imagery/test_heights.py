"""Heights are metres, whatever scale, offset and unit a file has them in: one reader for all that reads surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import ImageError
from repm_qgis.imagery.dem import dem_range, make_surface
from repm_qgis.imagery.heights import read_heights, read_values
from repm_qgis.imagery.raster import opened
from repm_qgis.stages import run_stage

FOOT = 0.3048
FORMS = {
    "scaled": (gdal.GDT_Int16, 0.05, 600.0, ""),
    "feet": (gdal.GDT_Float32, None, None, "ft"),
    "scaled feet": (gdal.GDT_Int32, 0.01, 1000.0, "ft"),
    "centimetres": (gdal.GDT_Int32, None, None, "cm"),
}


@pytest.fixture(scope="module")
def surface():
    rng = np.random.default_rng(4)
    waves = np.add.outer(np.sin(np.arange(200) / 17.0), np.cos(np.arange(220) / 23.0))
    return (640.0 + 12.0 * waves + rng.normal(0, 0.05, waves.shape)).astype(np.float32)


def written(path, heights, kind="", shift=0.0):
    """Heights (m) as a file of a kind, 1 m cells; ``shift`` is to the east."""
    form, scale, offset, unit = FORMS.get(kind, (gdal.GDT_Float32, None, None, ""))
    rows, columns = heights.shape
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), columns, rows, 1, form)
    dataset.SetGeoTransform((500_000 + shift, 1, 0, 4_000_000, 0, -1))
    dataset.SetProjection(gdal_wkt())
    band = dataset.GetRasterBand(1)
    numbers = heights.astype(np.float64) / {"ft": FOOT, "cm": 0.01}.get(unit, 1.0)
    if scale is not None:
        band.SetScale(scale)
        band.SetOffset(offset)
        numbers = (numbers - offset) / scale
    if unit:
        band.SetUnitType(unit)
    band.SetNoDataValue(-32000)
    band.WriteArray(np.rint(numbers) if form != gdal.GDT_Float32 else numbers)
    dataset = None
    return str(path)


def gdal_wkt():
    from osgeo import osr

    system = osr.SpatialReference()
    system.ImportFromEPSG(32631)
    return system.ExportToWkt()


@pytest.mark.parametrize("kind", FORMS)
def test_heights_are_metres(tmp_path, surface, kind):
    with opened(written(tmp_path / "dsm.tif", surface, kind)) as dataset:
        np.testing.assert_allclose(read_heights(dataset), surface, atol=0.03)
        if FORMS[kind][3]:
            assert abs(np.median(read_values(dataset)) - np.median(surface)) > 100  # in the band's own unit


@pytest.mark.parametrize("kind", FORMS)
@pytest.mark.long
def test_a_comparison_and_a_terrain_model_are_of_metres(tmp_path, surface, told, kind):
    truth, dsm = written(tmp_path / "truth.tif", surface), written(tmp_path / "dsm.tif", surface + 2.0, kind)
    found = run_stage("comparedsm", {"dsm": dsm, "reference": truth, "align": "none"}, told())
    assert found.bias == pytest.approx(2.0, abs=0.02) and found.nmad < 0.1
    found = run_stage("comparedsm", {"dsm": truth, "reference": dsm, "align": "none"}, told())
    assert found.bias == pytest.approx(-2.0, abs=0.02)
    gentle = 640.0 + (surface - 640.0) / 12.0  # of which all is ground
    dsm = written(tmp_path / "gentle.tif", gentle, kind)
    run_stage("dtm", {"dsm": dsm, "output": str(tmp_path / "dtm.tif"), "workers": 1}, told())
    with opened(str(tmp_path / "dtm.tif")) as dataset:
        np.testing.assert_allclose(np.nanmedian(read_heights(dataset) - gentle), 0.0, atol=0.05)
        assert dataset.GetRasterBand(1).GetScale() in (None, 1.0)


@pytest.mark.parametrize("kind", FORMS)
def test_a_mosaic_of_two_forms_is_one_surface(tmp_path, surface, told, kind):
    """A DSM in feet was moved by 2652 m, and the good one with it."""
    west = written(tmp_path / "west.tif", surface[:, :140])
    east = written(tmp_path / "east.tif", surface[:, 80:], kind, shift=80)
    run_stage("mosaic", {"dsms": [west, east], "output": str(tmp_path / "mosaic.tif"), "workers": 1}, told())
    with opened(str(tmp_path / "mosaic.tif")) as dataset:
        heights = read_heights(dataset)
    assert np.nanmax(np.abs(heights - surface)) < 0.2


@pytest.mark.parametrize("kind", FORMS)
def test_a_dem_is_in_metres(tmp_path, surface, kind):
    """The surface of the terrain model, from a DEM in each form."""
    made = []
    for name, form in (("metres", ""), ("other", kind)):
        path = written(tmp_path / f"{name}.tif", surface, form)
        target = str(tmp_path / f"{name}_surface.tif")
        with opened(make_surface(path, (3.0001, 36.1431, 3.0015, 36.1440), 10.0, target)) as dataset:
            made.append(read_heights(dataset))
    np.testing.assert_allclose(made[1], made[0], atol=0.05)


def test_whole_numbers_with_a_nodata_value_may_lie_below_zero(tmp_path, told):
    """Coasts and hollows in 16 bits: the nodata value is declared, so all other numbers are heights."""
    rng = np.random.default_rng(2)
    heights = (rng.integers(-60, 40, (200, 220)) * 1.0).astype(np.float32)
    paths = []
    for number in range(2):
        path = str(tmp_path / f"{number}.tif")
        dataset = gdal.GetDriverByName("GTiff").Create(path, 220, 200, 1, gdal.GDT_Int16)
        dataset.SetGeoTransform((500_000, 1, 0, 4_000_000, 0, -1))
        dataset.SetProjection(gdal_wkt())
        dataset.GetRasterBand(1).SetNoDataValue(-32768)
        dataset.GetRasterBand(1).WriteArray(np.where(np.arange(220) < 20, -32768, heights - number))
        dataset = None
        paths.append(path)
    with opened(paths[0]) as dataset:
        found = read_heights(dataset)
    assert np.isnan(found[:, :20]).all() and (found[:, 20:] == heights[:, 20:]).all()
    low, high, _ = dem_range(paths[0], "EPSG:32631", (500_050, 3_999_850, 500_150, 3_999_950))
    assert (low, high) == (-60.0, 39.0)
    compared = run_stage("comparedsm", {"dsm": paths[0], "reference": paths[1], "align": "none"}, told())
    assert compared.rmse == pytest.approx(1.0, abs=1e-6)
    made = run_stage("mosaic", {"dsms": paths, "output": str(tmp_path / "m.tif")}, told())
    assert [each.added for each in made.offsets] == pytest.approx([-0.5, 0.5], abs=1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    (
        (lambda band: band.SetUnitType("furlongs"), "has heights in 'furlongs': convert them to metres first"),
        (lambda band: band.SetScale(0.0), "has a band scale of 0 and an offset of 0, which give no heights"),
        (lambda band: band.SetScale(float("nan")), "has a band scale of nan"),
    ),
)
def test_what_gives_no_heights_is_refused(tmp_path, surface, change, words):
    path = written(tmp_path / "dsm.tif", surface)
    dataset = gdal.Open(path, gdal.GA_Update)
    change(dataset.GetRasterBand(1))
    dataset = None
    with opened(path) as dataset, pytest.raises(ImageError, match=words):
        read_heights(dataset)
