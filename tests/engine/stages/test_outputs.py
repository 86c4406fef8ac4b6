"""Products in the format of their extension, in files of their own, or refused before the work."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal, ogr

from repm_qgis.contracts.errors import OptionError
from repm_qgis.files.vector import strangers_in
from repm_qgis.geometry.vertical import TAG
from repm_qgis.imagery.heights import read_heights
from repm_qgis.imagery.raster import opened
from repm_qgis.stages import run_stage
from tests.engine.change.test_change import BUILT, ground, write


@pytest.fixture
def dates(tmp_path):
    after = ground()
    after[BUILT] += 6
    return {
        "before": write(tmp_path / "before.tif", [ground()], crs="EPSG:32631+5773"),
        "after": write(tmp_path / "after.tif", [after], crs="EPSG:32631+5773"),
        "align": "none",
    }


@pytest.mark.parametrize(
    "stage, option, name, words",
    (
        ("change", "output", "c.dxf", "must end with .tif, .tiff, .img or .asc, which says in what format"),
        ("change", "output", "c.nc", "must end with .tif, .tiff"),
        ("change", "output", "c.gpkg", "must end with .tif, .tiff"),
        ("change", "output", "c.vrt", "must end with .tif, .tiff"),
        ("change", "significant", "s.asc", "must end with .tif, .tiff or .img: it has several bands, which .asc does"),
        ("change", "volumes", "v.dxf", "must end with .gpkg, .geojson, .json, .shp or .fgb"),
        ("change", "report", "r.pdf", "must end with .html"),
        ("change", "volumes", "ogr:dbname='x.gpkg' table=\"y\" (geom)", "must be a file of its own"),
        ("change", "volumes", "postgres://dbname='x' table=\"y\" (geom)", "must be a file of its own"),
        ("mosaic", "sources", "s.asc", "must end with .tif, .tiff, .img or .vrt"),
    ),
)
def test_other_formats_are_refused_before_the_work(dates, tmp_path, told, stage, option, name, words):
    options = {**dates, "output": "change.tif", option: name}
    if stage == "mosaic":
        options = {"dsms": [dates["before"], dates["after"]], "output": "m.tif", option: name}
    with pytest.raises(OptionError) as caught:
        run_stage(stage, {key: _at(tmp_path, value) for key, value in options.items()}, told())
    assert str(caught.value).startswith(f"{option.upper()} is ") and words in str(caught.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["after.tif", "before.tif"]


def _at(folder, value):
    plain = isinstance(value, str) and "/" not in value and ":" not in value and value != "none"
    return str(folder / value) if plain else value


@pytest.mark.parametrize("end, driver", ((".img", "HFA"), (".asc", "AAIGrid"), (".tiff", "GTiff")))
def test_the_extension_is_the_format(dates, tmp_path, told, end, driver):
    plain, other = str(tmp_path / "change.tif"), str(tmp_path / f"other{end}")
    for path in (plain, other):
        run_stage("change", {**dates, "output": path}, told())
    with opened(plain) as dataset:
        expected, place = read_heights(dataset), dataset.GetGeoTransform()
        tags = {name: dataset.GetMetadataItem(name) for name in (TAG, "REPM_ENGINE")}
        description = dataset.GetRasterBand(1).GetDescription()
    with opened(other) as dataset:
        assert dataset.GetDriver().ShortName == driver
        values = read_heights(dataset)
        assert dataset.GetGeoTransform() == pytest.approx(place)
        assert {name: dataset.GetMetadataItem(name) for name in tags} == tags
        assert dataset.GetRasterBand(1).GetDescription() == description
        assert dataset.GetSpatialRef().GetAuthorityCode(None) in ("32631", None)
    assert np.array_equal(np.isfinite(values), np.isfinite(expected))
    assert np.nanmax(np.abs(values - expected)) < (1e-4 if end == ".asc" else 1e-6)


def layer_in(path, name):
    source = ogr.GetDriverByName("GPKG").Open(path, 1) or ogr.GetDriverByName("GPKG").CreateDataSource(path)
    source.CreateLayer(name, None, ogr.wkbPoint)
    source = None


def test_a_geopackage_of_the_user_is_not_replaced(dates, tmp_path, told):
    path = str(tmp_path / "town.gpkg")
    for name in ("parcels", "roads"):
        layer_in(path, name)
    with pytest.raises(OptionError, match="VOLUMES is .*town.gpkg': it holds 'parcels', 'roads', which"):
        run_stage("change", {**dates, "output": str(tmp_path / "c.tif"), "volumes": path}, told())
    assert strangers_in(path) == ["parcels", "roads"] and not (tmp_path / "c.tif").exists()


def test_a_layer_of_the_files_name_that_others_wrote_is_not_replaced_either(dates, tmp_path, told):
    path = str(tmp_path / "parcels.gpkg")
    layer_in(path, "parcels")
    with pytest.raises(OptionError, match="it holds 'parcels', which"):
        run_stage("change", {**dates, "output": str(tmp_path / "c.tif"), "volumes": path}, told())


def test_a_raster_in_a_geopackage_counts_too(dates, tmp_path, told):
    path = str(tmp_path / "photo.gpkg")
    photo = gdal.GetDriverByName("MEM").Create("", 64, 64, 3, gdal.GDT_Byte)
    photo.SetProjection(gdal.Open(dates["before"]).GetProjection())
    photo.SetGeoTransform((500000.0, 1, 0, 5000000.0, 0, -1))
    gdal.GetDriverByName("GPKG").CreateCopy(path, photo)
    with pytest.raises(OptionError, match="it holds 'photo', which"):
        run_stage("change", {**dates, "output": str(tmp_path / "c.tif"), "volumes": path}, told())


def test_own_layers_are_replaced_and_strangers_beside_them_protect_them(dates, tmp_path, told):
    path = str(tmp_path / "volumes.gpkg")
    options = {**dates, "output": str(tmp_path / "c.tif"), "volumes": path}
    for _ in range(2):
        run_stage("change", options, told())
        assert strangers_in(path) == []
    layer_in(path, "notes")
    with pytest.raises(OptionError, match="it holds 'notes', which"):
        run_stage("change", options, told())
