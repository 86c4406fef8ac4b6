"""Texts in Latin-1 in files that state no encoding: they are read, and can be written again."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal, ogr, osr

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.checks import as_text, as_texts
from repm_qgis.files.tables import LayerTable
from repm_qgis.imagery.acquisition import acquired
from repm_qgis.imagery.bands import band_name
from repm_qgis.imagery.spacing import stated_spacings
from repm_qgis.registration.references import read_reference

UTM = "EPSG:32631"
BOUNDS = Bounds(500_000.0, 4_000_000.0, 500_100.0, 4_000_100.0)
PAM = b"""<PAMDataset>
<Metadata><MDI key="Aufl\xf6sung">0.5</MDI><MDI key="VERTICAL_DATUM">H\xf6hen</MDI></Metadata>
<Metadata domain="IMAGERY"><MDI key="Satellit \xe9">one</MDI></Metadata>
<Metadata domain="RPC"><MDI key="Bemerkung f\xfcr">x</MDI></Metadata>
<PAMRasterBand band="1"><Description>H\xf6he</Description></PAMRasterBand>
</PAMDataset>"""


def image(path):
    made = gdal.GetDriverByName("GTiff").Create(str(path), 100, 100, 1, gdal.GDT_Float32)
    made.SetGeoTransform((BOUNDS.xmin, 1.0, 0.0, BOUNDS.ymax, 0.0, -1.0))
    reference = osr.SpatialReference()
    reference.SetFromUserInput(UTM)
    made.SetSpatialRef(reference)
    made.GetRasterBand(1).WriteArray(np.full((100, 100), 7.0, np.float32))
    made = None  # noqa: F841
    path.with_name(f"{path.name}.aux.xml").write_bytes(PAM)
    return str(path)


def layer(folder, driver, name):
    """Two points; an id and a field's name are in Latin-1, whatever the file says of its encoding."""
    path, reference = folder / name, osr.SpatialReference()
    reference.SetFromUserInput(UTM)
    source = ogr.GetDriverByName(driver).CreateDataSource(str(path))
    points = source.CreateLayer("points", reference, ogr.wkbPoint25D)
    for field in ("id", "hXhe"):
        points.CreateField(ogr.FieldDefn(field, ogr.OFTString))
    for number in (1, 2):
        feature = ogr.Feature(points.GetLayerDefn())
        feature.SetField(0, f"straXe{number}")
        feature.SetField(1, "x")
        feature.SetGeometry(ogr.CreateGeometryFromWkt(f"POINT Z ({500_010 * 1.0 + number} 4000010 5)"))
        points.CreateFeature(feature)
    feature = points = source = None  # noqa: F841
    for each in folder.glob(f"{path.stem}.*"):
        data = each.read_bytes().replace(b"straXe", b"stra\xdfe").replace(b"hXhe", b"h\xf6he")
        each.write_bytes(b"UTF-8" if each.suffix == ".cpg" else data)
    return str(path)


def test_metadata_of_an_image(tmp_path):
    path = image(tmp_path / "a.tif")
    dataset = gdal.Open(path)
    assert [metres for metres, _ in stated_spacings(dataset)] == [pytest.approx(1.0, rel=1e-3)]
    assert acquired(dataset, path) == ""
    assert band_name(dataset, 1) == "H\xf6he"
    assert len(read_reference(path, UTM, BOUNDS, 0.0).height) == 10_000


@pytest.mark.parametrize(
    "driver, name", (("FlatGeobuf", "a.fgb"), ("ESRI Shapefile", "a.shp"), ("GPKG", "a.gpkg"), ("GeoJSON", "a.geojson"))
)
def test_names_and_texts_of_a_layer(tmp_path, driver, name):
    table = LayerTable(layer(tmp_path, driver, name))
    rows = sorted(table.rows(), key=lambda row: row[1]["id"])  # FlatGeobuf sorts by place
    assert table.fields == ["id", "h\xf6he"] and [row[1]["id"] for row in rows] == ["stra\xdfe1", "stra\xdfe2"]
    assert rows[0][2] == (500_011.0, 4_000_010.0, 5.0)


@pytest.mark.parametrize(
    "given, text",
    ((b"\xe9", "\xe9"), ("\udce9", "\xe9"), ("h\xf6he", "h\xf6he"), ("\u9ad8", "\u9ad8"), (b"\xc3\xb6", "\xf6")),
)
def test_what_is_utf_8_stays_and_what_is_not_is_latin_1(given, text):
    assert as_text(given) == text and as_texts({given: given}) == {text: text} and as_texts(None) == {}
