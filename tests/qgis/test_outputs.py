"""What dialogs and qgis_process refuse before a run: formats, layers of others; and the part that EXTENT chooses."""

from __future__ import annotations

import pytest
from osgeo import gdal, ogr
from qgis.core import (
    QgsApplication,
    QgsProcessingContext,
    QgsProcessingOutputLayerDefinition,
    QgsProject,
    QgsProperty,
)


def checked(name, values):
    """Whether an algorithm accepts parameters, and what it says where it does not."""
    algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}")
    return algorithm.checkParameterValues(values, QgsProcessingContext())


@pytest.fixture
def dsms(tmp_path):
    found = {}
    for name in ("BEFORE", "AFTER"):
        found[name] = str(tmp_path / f"{name}.tif")
        dataset = gdal.GetDriverByName("GTiff").Create(found[name], 20, 20, 1, gdal.GDT_Float32)
        dataset.SetGeoTransform((500000, 1, 0, 5000000, 0, -1))
        dataset = None
    return found


@pytest.mark.parametrize(
    "name, value, words",
    (
        ("OUTPUT", "c.dxf", "must end with .tif, .tiff, .img or .asc"),
        ("VOLUMES", "v.tab", "must end with .gpkg"),
        ("VOLUMES", "ogr:dbname='x.gpkg' table=\"y\" (geom)", "must be a file of its own"),
        ("VOLUMES", "town.gpkg", "it holds 'parcels'"),
        ("SIGNIFICANT", "s.asc", "it has several bands"),
    ),
)
@pytest.mark.parametrize("layer", (False, True))
def test_the_dialog_refuses_what_would_not_be_written_as_named(dsms, tmp_path, name, value, words, layer):
    source = ogr.GetDriverByName("GPKG").CreateDataSource(str(tmp_path / "town.gpkg"))
    source.CreateLayer("parcels", None, ogr.wkbPoint)
    source = None
    value = value if ":" in value else str(tmp_path / value)
    if layer:  # as the dialog gives it
        value = QgsProcessingOutputLayerDefinition(QgsProperty.fromValue(value).staticValue(), QgsProject.instance())
    fine, text = checked("change", {**dsms, "OUTPUT": str(tmp_path / "c.tif"), name: value})
    assert not fine and words in text and text.startswith(f"{name} is ")


def test_formats_that_are_written_are_accepted(dsms, tmp_path):
    products = {"OUTPUT": "c.asc", "SIGNIFICANT": "s.img", "VOLUMES": "v.fgb", "REPORT": "r.html"}
    fine, text = checked("change", {**dsms, **{name: str(tmp_path / value) for name, value in products.items()}})
    assert fine, text
    assert checked("change", {**dsms, "OUTPUT": "TEMPORARY_OUTPUT", "VOLUMES": "TEMPORARY_OUTPUT"})[0]


def test_a_sparse_frame_is_accepted_where_extent_lies_on_its_pixels(shared_data, tmp_path):
    images = [str(shared_data / "cases" / "full_frame" / f"frame{number}.tif") for number in (1, 2)]
    values = {"IMAGES": images, "WORKSPACE": str(tmp_path / "w"), "OUTPUT": str(tmp_path / "dsm.tif")}
    fine, text = checked("pipeline", values)
    assert not fine and "give an EXTENT there" in text
    fine, text = checked("pipeline", {**values, "EXTENT": "5.4418,5.4438,43.2605,43.262 [EPSG:4326]"})
    assert fine, text
