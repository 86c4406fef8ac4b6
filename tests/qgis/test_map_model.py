"""The model that makes the layers of a map from a DSM: its values are those that a plane, a flat and a cone have."""

from __future__ import annotations

import gc
import math
import pathlib

import numpy as np
import pytest
from osgeo import gdal, ogr, osr
from qgis.core import (
    QgsApplication,
    QgsProcessingContext,
    QgsProcessingOutputLayerDefinition,
    QgsProject,
    QgsRasterLayer,
)

CELL, WEST, NORTH = 2.0, 500_000.0, 4_900_000.0
EAST_SLOPE, NORTH_SLOPE = 0.3, 0.4
LAYERS = {
    "contours:CONTOURS": "contours.gpkg",
    "slope:SLOPE": "slope.tif",
    "hillshade:HILLSHADE": "hillshade.tif",
    "ruggedness:RUGGEDNESS": "ruggedness.tif",
    "breaklines:BREAKLINES": "breaklines.gpkg",
}
TITLES = ["Contours north", "Breaklines north", "Slope north", "Ruggedness north", "Hillshade north"]


def plane(x, y):
    return 1000.0 + EAST_SLOPE * (x - WEST) + NORTH_SLOPE * (y - NORTH)


@pytest.fixture(scope="module")
def dsm(tmp_path_factory):
    """60 x 120 cells: a plane on the left with a hole in it, a flat of 851 m with a small cone on the right.

    The flat lies on no contour: GDAL 3.10.3 would draw one around it, and 3.6 and 3.13 would not.
    """
    path = tmp_path_factory.mktemp("town") / "north" / "dsm.tif"
    path.parent.mkdir()
    rows, columns = np.indices((60, 120))
    x, y = WEST + CELL * (columns + 0.5), NORTH - CELL * (rows + 0.5)
    heights = np.where(columns < 60, plane(x, y), 851.0)
    away = np.hypot(x - (WEST + 180.0), y - (NORTH - 60.0))
    heights = np.where(columns < 60, heights, 851.0 + np.maximum(8.0 - away, 0.0))
    heights[30:34, 20:24] = -9999.0
    raster = gdal.GetDriverByName("GTiff").Create(str(path), 120, 60, 1, gdal.GDT_Float32)
    raster.SetGeoTransform((WEST, CELL, 0, NORTH, 0, -CELL))
    crs = osr.SpatialReference()
    crs.ImportFromEPSG(32631)
    raster.SetProjection(crs.ExportToWkt())
    raster.GetRasterBand(1).WriteArray(heights)
    raster.GetRasterBand(1).SetNoDataValue(-9999.0)
    return path


@pytest.fixture
def model(plugin):
    return QgsApplication.processingRegistry().algorithmById("repm:dsm_to_map")


def run_as_the_dialog(model, dsm, feedback, outputs):
    """The model's results, and the project that its layers were put into."""
    from processing.gui.Postprocessing import handleAlgorithmResults

    project = QgsProject.instance()
    project.clear()
    context = QgsProcessingContext()
    context.setProject(project)
    given = {"DSM": str(dsm), "INTERVAL": 5.0, "SHORTEST": 30.0}
    given.update({key: QgsProcessingOutputLayerDefinition(path, project) for key, path in outputs.items()})
    results, fine = model.run(given, context, feedback)
    assert fine, feedback.heard["error"]
    gc.collect()
    assert handleAlgorithmResults(model, context, feedback, parameters=given)
    return {name: results[name] for name in outputs}, project


@pytest.fixture
def made(model, dsm, feedback, tmp_path):
    yield run_as_the_dialog(model, dsm, feedback, {key: str(tmp_path / name) for key, name in LAYERS.items()})
    QgsProject.instance().clear()


def values(path):
    raster = gdal.Open(str(path)).ReadAsArray().astype(float)
    return raster[5:25, 5:55], raster[5:20, 66:76]  # the plane, the flat


def test_the_model_is_valid_and_of_algorithms_that_every_qgis_has(model):
    assert model.validate()[0], model.validate()[1]
    steps = {child.algorithmId() for child in model.childAlgorithms().values()}
    assert {step.split(":")[0] for step in steps} == {"gdal", "native"} and len(steps) == 5
    assert model.displayName() == "3.3 Make map layers of a DSM (model)"
    assert model.groupId() == "derived" and pathlib.Path(model.svgIconPath()).exists() and not model.icon().isNull()
    copy = model.create()  # its parameters live as long as it does
    shown = {each.name(): each for each in copy.parameterDefinitions() if not each.isDestination()}
    assert list(shown) == ["DSM", "INTERVAL", "SHORTEST", "STEEP"]
    assert "in metres" in model.shortHelpString()
    assert (shown["INTERVAL"].defaultValue(), shown["SHORTEST"].defaultValue()) == (5.0, 50.0)


def test_it_speaks_german(german):
    model = QgsApplication.processingRegistry().algorithmById("repm:dsm_to_map").create()
    assert model.displayName() == "3.3 Kartenlayer aus einem DOM erzeugen (Modell)"
    labels = [each.description() for each in model.parameterDefinitions()]
    assert labels == [
        "DOM", "Äquidistanz der Höhenlinien, m", "Kürzeste Höhenlinie oder Bruchkante, m",
        "Neigung an Bruchkanten, Grad", "Bruchkanten", "Höhenlinien", "Schummerung", "Rauheit", "Neigung",
    ]  # fmt: skip


@pytest.mark.long
def test_each_layer_has_the_values_of_the_surface(made):
    results, _ = made
    slope, ruggedness, shading = (
        values(results[key]) for key in ("slope:SLOPE", "ruggedness:RUGGEDNESS", "hillshade:HILLSHADE")
    )
    steep = math.hypot(EAST_SLOPE, NORTH_SLOPE)
    np.testing.assert_allclose(slope[0], math.degrees(math.atan(steep)), atol=0.01)
    np.testing.assert_array_equal(slope[1], 0.0)
    # The root of the sum of squared differences to the eight neighbours (Riley et al. 1999).
    np.testing.assert_allclose(ruggedness[0], math.sqrt(6) * steep * CELL, rtol=1e-3)
    np.testing.assert_array_equal(ruggedness[1], 0.0)
    # Light from four directions, 45 degrees high, each by the square of the cosine between it and the aspect.
    np.testing.assert_allclose(shading[1], 1 + 254 * math.sin(math.radians(45)), atol=1.0)
    tilt, aspect = math.atan(steep), math.pi + math.atan2(EAST_SLOPE, NORTH_SLOPE)
    away = np.radians([225, 270, 315, 360]) - aspect
    lit = math.sqrt(0.5) * (math.cos(tilt) + math.sin(tilt) * np.cos(away))
    np.testing.assert_allclose(shading[0], 1 + 254 * (np.cos(away) ** 2 * lit).sum() / 2, atol=1.0)


@pytest.mark.long
def test_contours_lie_at_their_heights_and_leave_out_what_is_small(made):
    results, _ = made
    source = ogr.Open(results["contours:CONTOURS"])
    lines = [(each.GetField("height"), each.GetGeometryRef().Clone()) for each in source.GetLayer(0)]
    heights = sorted({height for height, _ in lines})
    assert heights[0] == 855.0 and np.allclose(np.diff(heights), 5.0), "the lowest are at the wall above the flat"
    for height, line in lines:
        assert line.Length() >= 30.0
        x, y = np.array(line.GetPoints())[:, :2].T
        assert x.max() < WEST + 122.0, "the cone's contours are short"
        on_plane = x < WEST + 117.0
        on_plane[[0, -1]] = False  # GDAL draws to the edge of the last cell, beyond its centre
        np.testing.assert_allclose(plane(x, y)[on_plane], height, atol=0.01)


@pytest.mark.long
def test_breaklines_are_the_rims_of_what_is_steep(made):
    """The plane has 27 degrees, the cone 45 up to 8 m from its middle, and a wall stands between plane and flat."""
    results, _ = made
    source = ogr.Open(results["breaklines:BREAKLINES"])
    lines = [np.array(each.GetGeometryRef().GetPoints())[:, :2] for each in source.GetLayer(0)]
    away = [np.hypot(x - (WEST + 180.0), y - (NORTH - 60.0)) for x, y in (line.T for line in lines)]
    (rim,) = [each for each in away if each.max() < 20.0]
    assert abs(rim.mean() - 8.0) < CELL and rim.max() < 8.0 + CELL, "a slope is that of 3 x 3 cells"
    rest = np.concatenate([line for line, each in zip(lines, away) if each.max() >= 20.0])
    holes = np.hypot(rest[:, 0] - (WEST + 44.0), rest[:, 1] - (NORTH - 64.0)) < 12.0
    assert (np.abs(rest[~holes][:, 0] - (WEST + 120.0)) < 2 * CELL).all() and (~holes).any()


@pytest.mark.long
def test_layers_are_styled_named_and_in_one_group(made):
    _, project = made
    (group,) = project.layerTreeRoot().children()
    layers = [node.layer() for node in group.findLayers()]
    assert (group.name(), [layer.name() for layer in layers]) == ("north", TITLES)
    kinds = [layer.renderer().type() for layer in layers]
    assert kinds == ["singleSymbol", "singleSymbol", "singlebandpseudocolor", "singlebandpseudocolor", "singlebandgray"]
    assert layers[0].labelsEnabled() and layers[0].labeling().settings().fieldName == "height"
    low, high = layers[2].renderer().classificationMin(), layers[2].renderer().classificationMax()
    assert low == 0 and 25 < high < 90
    assert all(isinstance(layer, QgsRasterLayer) and layer.isValid() for layer in layers[2:])


def test_a_layer_can_be_left_out_although_another_is_made_of_it(model, dsm, feedback, tmp_path):
    wanted = {"breaklines:BREAKLINES": str(tmp_path / "breaklines.gpkg")}
    results, project = run_as_the_dialog(model, dsm, feedback, wanted)
    assert ogr.Open(results["breaklines:BREAKLINES"]).GetLayer(0).GetFeatureCount() and len(project.mapLayers()) == 1
    project.clear()


def test_layers_that_are_not_kept_leave_no_style_where_qgis_was_started(model, dsm, feedback, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, project = run_as_the_dialog(model, dsm, feedback, dict.fromkeys(LAYERS, "TEMPORARY_OUTPUT"))
    (contours,) = project.mapLayersByName("Contours north")
    assert contours.dataProvider().name() == "memory" and contours.labeling().settings().fieldName == "height"
    assert list(tmp_path.iterdir()) == []
    project.clear()
