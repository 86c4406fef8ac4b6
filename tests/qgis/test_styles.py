"""Styles as QGIS draws them: legends, labels, arrows, discrete values, time, heights in 3-D; in the user's language."""

from __future__ import annotations

import pathlib
import re

import numpy as np
import pytest
from osgeo import gdal
from qgis.core import (
    Qgis,
    QgsDateTimeRange,
    QgsFeature,
    QgsGeometry,
    QgsLayerTreeModel,
    QgsPointXY,
    QgsProject,
    QgsRasterLayer,
    QgsRectangle,
    QgsVectorLayer,
    QgsVectorLayerTemporalContext,
)
from qgis.PyQt.QtCore import QDateTime
from qgis.PyQt.QtGui import QFont

from tests.qgis.drawing import drawn

UTM = "EPSG:32631"
FIELDS = {
    "tie_points": "field=residual:double&field=row:double&field=direction:double",
    "gcps": "field=id:string&field=role:string&field=wrong:int&field=east:double&field=north:double"
    "&field=height_error:double",
    "tiles": "field=tile:string&field=worst_rmse:double",
}
GEOMETRY = {"tie_points": "Point", "gcps": "Point", "tiles": "Polygon"}


@pytest.fixture
def styled(plugin, tmp_path):
    """Makes a memory layer with the style of a kind, and the features that are given."""
    from repm_qgis.reports.styles import write_style

    def make(kind, *rows):
        layer = QgsVectorLayer(f"{GEOMETRY[kind]}?crs={UTM}&{FIELDS[kind]}", kind, "memory")
        for number, row in enumerate(rows):
            feature = QgsFeature(layer.fields())
            feature.setGeometry(QgsGeometry.fromPointXY(QgsPointXY(654300.0 + 100 * number, 4812300.0)))
            feature.setAttributes(list(row))
            assert layer.dataProvider().addFeature(feature)
        assert layer.loadNamedStyle(write_style(kind, tmp_path / f"{kind}.gpkg"))[1]
        return layer

    return make


@pytest.fixture
def raster(plugin, tmp_path):
    """Makes a GeoTIFF with the style of a kind, and opens it."""
    from repm_qgis.imagery.raster import write
    from repm_qgis.reports.styles import write_style

    def make(kind, *bands, **more):
        path = str(tmp_path / f"{kind}.tif")
        arrays = [np.asarray(band, np.float32) for band in bands]
        write(path, arrays, (654300.0, 1.0, 0, 4812300.0, 0, -1.0), crs_wkt(), cog=True)
        write_style(kind, path, **more)
        layer = QgsRasterLayer(path, kind)
        assert layer.isValid() and layer.loadNamedStyle(str(pathlib.Path(path).with_suffix(".qml")))[1]
        return layer

    return make


def crs_wkt():
    import pyproj

    return pyproj.CRS.from_user_input(UTM).to_wkt()


def legend(layer):
    """Names and widths (px) of a layer's legend."""
    project = QgsProject()
    project.addMapLayer(layer, True)
    model = QgsLayerTreeModel(project.layerTreeRoot())
    nodes = model.layerLegendNodes(project.layerTreeRoot().findLayer(layer.id()))
    found = [(node.data(0), node.minimumIconSize().width()) for node in nodes if hasattr(node, "minimumIconSize")]
    model = None
    project.takeMapLayer(layer)
    return found


def test_legends_are_as_narrow_as_their_symbols(styled):
    names = {}
    for kind in FIELDS:
        layer = styled(kind)
        found = legend(layer)
        assert len(found) >= 6 and max(width for _, width in found) <= 48, found  # 512 with arrows of a vector field
        names[kind] = [name for name, _ in found]
    assert names["gcps"][:2] == ["control point", "check point"] and "no height found" in names["gcps"]
    assert names["tie_points"][-1] == "vertical parallax (10 mm = 0.5 px)"


def box_around(layer):
    place = next(layer.getFeatures()).geometry().asPoint()
    return QgsRectangle(place.x() - 50, place.y() - 50, place.x() + 50, place.y() + 50)


def test_control_points_check_points_and_missing_heights_look_different(styled):
    rows = {
        "control": ["A", "control", 0, None, None, 0.1],
        "check": ["A", "check", 0, None, None, 0.1],
        "no height": ["A", "check", 0, None, None, None],
        "wrong": ["A", "control", 1, None, None, 0.1],
    }
    pictures = {}
    for name, row in rows.items():
        layer = styled("gcps", row)
        layer.setLabelsEnabled(False)
        pictures[name] = drawn(layer, box_around(layer), (100, 100))
    names = list(rows)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            differing = (np.abs(pictures[first] - pictures[second]).max(axis=2) > 60).sum()
            assert differing > 8, (first, second)


@pytest.mark.parametrize(("row", "direction", "towards"), [(0.5, 90, "right"), (0.5, 270, "left"), (-0.5, 90, "left")])
def test_arrows_point_where_the_parallax_does_and_have_a_white_rim(styled, row, direction, towards):
    layer = styled("tie_points", [0.05, row, direction])
    pixels = drawn(layer, box_around(layer), (100, 100), "#1e5a3c")  # a green DSM
    dark = (pixels.max(axis=2) < 75) & (np.abs(pixels[..., 0] - 29) < 20)
    bright = pixels.min(axis=2) > 200
    columns = np.nonzero(dark[46:55].any(axis=0))[0]
    assert (columns.max() > 75) == (towards == "right") and (columns.min() < 25) == (towards == "left"), columns
    side = slice(62, 80) if towards == "right" else slice(20, 38)
    assert bright[44:49, side].any(axis=0).mean() > 0.8 and bright[51:57, side].any(axis=0).mean() > 0.8


def test_labels_are_not_ghostly(styled):
    for kind in ("gcps", "tiles"):
        layer = styled(kind)
        labeling = layer.labeling()
        settings = labeling.settings()
        text = settings.format()
        assert text.font().weight() == QFont().weight()  # 0, which is thinner than thin, where a style does not say


def test_error_maps_compare_with_each_other_and_with_tiles(raster, styled):
    """An error has one colour in all maps, which is that of a tile with this error."""
    sizes = (0.0, 0.02, 0.05, 0.2, 0.5, 7.0)
    layer = raster("error", np.repeat(sizes, 20)[None].repeat(20, axis=0), np.zeros((20, 120)))
    shown = drawn(layer, layer.extent(), (120, 20))[10, 10::20]
    tiles = styled("tiles")
    ranges = tiles.renderer().ranges()
    for size, colour in zip(sizes, shown):
        (of_tile,) = (each for each in ranges if each.lowerValue() <= size < each.upperValue())
        outline = of_tile.symbol().symbolLayer(0).strokeColor()
        assert np.abs(colour[:3].astype(int) - (outline.red(), outline.green(), outline.blue())).max() <= 2, size
    bounds = [each.upperValue() for each in ranges[:-1]]
    assert bounds == [0.01, 0.03, 0.1, 0.3, 1.0]


def test_a_zoomed_hillshade_has_no_grid(raster):
    from repm_qgis.reports.templates import RESOURCES

    east, north = np.meshgrid(np.arange(40.0), np.arange(40.0))
    layer = raster("dsm", 3 * np.sin(east / 6) + 2 * np.cos(north / 7))
    assert layer.loadNamedStyle(str(RESOURCES / "styles" / "hillshade.qml"))[1]
    pixels = drawn(layer, QgsRectangle(654315, 4812275, 654325, 4812285), (300, 300))[..., 0]
    # Of 30 px for a cell: the steps between neighbouring pixels are alike inside cells and between them.
    steps = np.abs(np.diff(pixels, axis=1)).mean(axis=0)[10:-10]
    assert steps.max() < 6 and steps.mean() > 0.02, steps.max()


def test_an_orthophoto_is_shown_when_its_images_were_taken(raster):
    grey = np.arange(100.0).reshape(10, 10)
    layer = raster("ortho", grey, taken=("2019-04-02T10:15:00.000Z", "2019-04-02T10:16:30.000Z"))
    time = layer.temporalProperties()
    assert time.isActive()
    found = time.fixedTemporalRange()
    assert found.begin().toUTC().toString("yyyy-MM-dd HH:mm:ss") == "2019-04-02 10:15:00"
    assert found.end().toUTC().toString("yyyy-MM-dd HH:mm:ss") == "2019-04-02 10:16:30"
    assert not raster("dsm", grey).temporalProperties().isActive()


def test_footprints_have_the_times_of_their_images(plugin, tmp_path):
    from repm_qgis.reports.styles import write_style

    layer = QgsVectorLayer(f"Point?crs={UTM}&field=view:string&field=taken:string", "footprints", "memory")
    for view, taken in (("a", "2019-04-02 10:15:00"), ("b", "2019-06-01 10:15:00"), ("c", None)):
        feature = QgsFeature(layer.fields())
        feature.setAttributes([view, taken])
        layer.dataProvider().addFeature(feature)
    polygons = QgsVectorLayer(f"Polygon?crs={UTM}&field=taken:string", "footprints", "memory")
    taken = "2019-04-02T10:15:00.000Z", "2019-06-01T10:15:00.000Z"
    polygons.loadNamedStyle(write_style("footprints", tmp_path / "f.gpkg", taken=taken))
    time = polygons.temporalProperties()
    assert time.isActive()
    context = QgsVectorLayerTemporalContext()
    context.setLayer(polygons)
    april = QgsDateTimeRange(QDateTime(2019, 4, 1, 0, 0, 0), QDateTime(2019, 4, 30, 0, 0, 0))
    wanted = layer.getFeatures(time.createFilterString(context, april))
    assert [feature["view"] for feature in wanted] == ["a"]
    polygons.loadNamedStyle(write_style("footprints", tmp_path / "f.gpkg"))
    assert "<temporal" not in (tmp_path / "f.qml").read_text(encoding="utf-8")


def test_a_dsm_is_an_elevation(raster):
    layer = raster("dsm", np.arange(100.0).reshape(10, 10))
    if Qgis.QGIS_VERSION_INT < 32600:
        pytest.skip(f"QGIS {Qgis.QGIS_VERSION}: rasters have elevations from 3.26 on")
    assert layer.elevationProperties().isEnabled()
    assert not raster("error", np.arange(100.0).reshape(10, 10)).elevationProperties().isEnabled()


def test_a_dsm_is_the_terrain_of_a_project_that_had_none(raster, feedback):
    from qgis.core import QgsProcessingContext
    from repm.processing_provider.styles import LayerStyler, Run

    project, context = QgsProject(), QgsProcessingContext()
    context.setProject(project)
    if not hasattr(project, "elevationProperties"):
        pytest.skip(f"QGIS {Qgis.QGIS_VERSION}: projects have a terrain from 3.26 on")
    layer = raster("dsm", np.arange(100.0).reshape(10, 10))
    others = QgsRasterLayer(layer.source(), "another")
    for each in (layer, others):
        project.addMapLayer(each)
        LayerStyler.make("", "dsm", Run("town", kinds={"dsm"})).postProcessLayer(each, context, feedback)
    terrain = project.elevationProperties().terrainProvider()
    assert terrain.type() == "raster" and terrain.layer().id() == layer.id()  # the first stays, as somebody may have it
    project.clear()


def test_statistics_are_in_the_file_and_qgis_writes_none_beside_it(raster, tmp_path):
    values = np.arange(600.0 * 600).reshape(600, 600)
    layer = raster("dsm", values)
    found = layer.dataProvider().bandStatistics(1)
    assert (found.minimumValue, found.maximumValue) == (0.0, 359999.0)
    assert found.mean == pytest.approx(values.mean()) and found.stdDev == pytest.approx(values.std(), rel=1e-4)
    assert not list(tmp_path.glob("*.aux.xml"))
    dataset = gdal.Open(layer.source())
    assert dataset.GetRasterBand(1).GetOverviewCount() >= 1
    assert dataset.GetRasterBand(1).GetMetadataItem("STATISTICS_MEAN")
    dataset = None


def test_a_confidence_offers_its_counts_and_its_sources(raster, feedback):
    from qgis.core import QgsProcessingContext
    from repm.processing_provider import styles

    bands = [np.tile([1.0, 2.0, 3.0, 3.0], (4, 1)), np.ones((4, 4)), np.ones((4, 4)), np.tile([0.0, 1, 2, 3], (4, 1))]
    layer = raster("confidence", *bands, np.full((4, 4), 0.5), np.full((4, 4), 0.8))
    views = styles._views("confidence", layer.source(), feedback)
    styles.LayerStyler.make("", "confidence", styles.Run("town"), views=views).postProcessLayer(
        layer, QgsProcessingContext(), feedback
    )
    manager = layer.styleManager()
    views = {"Height maps that agree", "Source of each height", "LE90 of each height"}
    assert set(manager.styles()) == {"default", *views}
    assert layer.renderer().type() == "singlebandpseudocolor" and layer.renderer().usesBands() == [5]
    found = {}
    for name in ("Height maps that agree", "Source of each height"):
        assert manager.setCurrentStyle(name)
        assert layer.renderer().type() == "paletted"
        found[layer.renderer().usesBands()[0]] = [each.label for each in layer.renderer().classes()]
    assert found[1] == ["1", "2", "3"]
    sources = ["Matched", "Background of an occlusion", "Interpolated", "Interpolated on the DEM"]
    assert found[4] == [
        *sources,
        "Ground in a shadow",
        "From neighbouring cells",
        "Edited by hand",
        "Level of the water",
    ]
    assert manager.setCurrentStyle("LE90 of each height") and layer.renderer().usesBands() == [6]
    assert manager.setCurrentStyle("Source of each height")
    assert len({tuple(pixel) for pixel in drawn(layer, layer.extent(), (4, 4)).reshape(-1, 3)}) == 4


def test_legends_are_in_the_users_language(styled):
    from repm_qgis.runtime.translation import written_in

    with written_in("de"):
        names = [name for kind in FIELDS for name, _ in legend(styled(kind))]
    assert "keine Höhe gefunden" in names and "Lagefehler (10 mm = 1 m)" in names and "Passpunkt" in names
    words = re.compile(r"\b(height|found|point|error|over|under|to|parallax)\b")
    assert not [name for name in names if words.search(name)]
