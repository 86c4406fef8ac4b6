#!/usr/bin/env python3
"""Write resources/models/*.model3 through QGIS's own model API ('make models'), so that they always load again.

For the graphical modeler, to look at, take apart and change: the recipe of repm:pipeline stage by stage, and the layers
of a map that QGIS's own algorithms make of a DSM.
"""

from __future__ import annotations

import os
import sys

from qgis.core import (
    QgsApplication,
    QgsProcessingModelAlgorithm,
    QgsProcessingModelChildAlgorithm,
    QgsProcessingModelChildParameterSource,
    QgsProcessingModelOutput,
    QgsProcessingModelParameter,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterLayer,
)
from qgis.PyQt.QtCore import QPointF

FOLDER = os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "resources", "models")
Source = QgsProcessingModelChildParameterSource


def _inputs() -> list:
    """The model's own parameters are those of repm:pipeline."""
    pipeline = QgsApplication.processingRegistry().algorithmById("repm:pipeline")
    in_models = sys.modules["repm"].processing_provider.parameters.in_models
    return [in_models(pipeline.parameterDefinition(name)) for name in ("IMAGES", "EXTENT", "DEM", "RESOLUTION", "CRS")]


def _child(
    model: QgsProcessingModelAlgorithm, place: int, stage: str, title: str, parameters: tuple, scene: str, outputs: dict
) -> None:
    """Add a stage that takes model parameters of the same name, and the scene from "child.OUTPUT"."""
    child = QgsProcessingModelChildAlgorithm(f"repm:{stage}")
    child.setChildId(stage)
    child.setDescription(title)
    child.setPosition(QPointF(360, 80 + 110 * place))
    for definition in QgsApplication.processingRegistry().algorithmById(f"repm:{stage}").parameterDefinitions():
        if definition.name() in parameters:
            child.addParameterSources(definition.name(), [Source.fromModelParameter(definition.name())])
        elif definition.defaultValue() is not None and not definition.isDestination():
            child.addParameterSources(definition.name(), [Source.fromStaticValue(definition.defaultValue())])
    if scene:
        child.addParameterSources("SCENE", [Source.fromChildOutput(*scene.split("."))])
    _show(child, place, outputs)
    model.addChildAlgorithm(child)


def stages_model() -> QgsProcessingModelAlgorithm:
    """epmfit, errormap, refine, reconstruct, dsmfuse: the same DSM as repm:pipeline's."""
    model = QgsProcessingModelAlgorithm("dsm_by_stages", "REPM")
    _add_inputs(model, _inputs())
    _child(
        model,
        0,
        "epmfit",
        "Fit equivalent pinhole cameras",
        ("IMAGES", "EXTENT", "DEM"),
        "",
        {
            "TILES": ("TILES", "Tiles"),
            "WORKSPACE": ("WORKSPACE", "Workspace"),
            "REPORT": ("REPORT", "Report of the cameras"),
        },
    )
    _child(
        model,
        1,
        "errormap",
        "Map the equivalent error",
        (),
        "epmfit.SCENE",
        {"OUTPUT": ("ERROR_MAP", "Equivalent error")},
    )
    _child(model, 2, "refine", "Refine the images", (), "epmfit.SCENE", {})
    _child(
        model,
        3,
        "reconstruct",
        "Reconstruct heights",
        (),
        "refine.OUTPUT_SCENE",
        {"TIE_POINTS": ("TIE_POINTS", "Tie points")},
    )
    _child(
        model,
        4,
        "dsmfuse",
        "Fuse heights into a DSM",
        ("RESOLUTION", "CRS"),
        "reconstruct.OUTPUT_SCENE",
        {"OUTPUT": ("DSM", "DSM")},
    )
    _describe(
        model,
        "Make a DSM stage by stage (model)",
        "The stages of repm:pipeline one after the other, as a model to take apart. To change a stage, "
        "or to add one of your own, click with the right mouse button on it in the toolbox and choose 'Copy to my "
        "models and edit…': QGIS can edit only models of your own.",
    )
    return model


def map_model() -> QgsProcessingModelAlgorithm:
    """Contours, slope, hillshade, ruggedness and breaklines of a DSM, by GDAL, which reads a raster line by line."""
    model = QgsProcessingModelAlgorithm("dsm_to_map", "REPM")
    number, double = QgsProcessingParameterNumber, QgsProcessingParameterNumber.Type.Double
    dsm = QgsProcessingParameterRasterLayer("DSM", "DSM")
    interval = number("INTERVAL", "Interval of the contours, m", double, 5.0, False, 0.01)
    shortest = number("SHORTEST", "Shortest contour or breakline, m", double, 50.0, False, 0.0)
    steep = number("STEEP", "Slope at breaklines, degrees", double, 35.0, False, 1.0, 89.0)
    _add_inputs(model, [dsm, interval, shortest, steep])
    from_dsm, packed = Source.fromModelParameter("DSM"), Source.fromStaticValue("COMPRESS=DEFLATE|TILED=YES")
    lines = {
        "INPUT": from_dsm,
        "INTERVAL": Source.fromModelParameter("INTERVAL"),
        "FIELD_NAME": Source.fromStaticValue("height"),
    }
    _step(model, 0, "lines", "gdal:contour", "Draw all contours", lines)
    length, extract = Source.fromExpression("'length($geometry) >= ' || @SHORTEST"), "native:extractbyexpression"
    long_enough = {"INPUT": Source.fromChildOutput("lines", "OUTPUT"), "EXPRESSION": length}
    _step(model, 1, "contours", extract, "Keep the long contours", long_enough, {"OUTPUT": ("CONTOURS", "Contours")})
    raster = {"INPUT": from_dsm, "COMPUTE_EDGES": Source.fromStaticValue(True), "OPTIONS": packed}
    many = {**raster, "MULTIDIRECTIONAL": Source.fromStaticValue(True)}
    slope, shading, rough = (
        {"OUTPUT": (name, title)}
        for name, title in (("SLOPE", "Slope"), ("HILLSHADE", "Hillshade"), ("RUGGEDNESS", "Ruggedness"))
    )
    _step(model, 2, "slope", "gdal:slope", "Slope in degrees", raster, slope)
    _step(model, 3, "hillshade", "gdal:hillshade", "Hillshade from several directions", many, shading)
    ruggedness = "gdal:triterrainruggednessindex"
    _step(model, 4, "ruggedness", ruggedness, "Terrain ruggedness index (TRI)", raster, rough)
    # Not the step "slope": QGIS 3.22 does not run a step whose layer is left out, though another step needs it.
    _step(model, 5, "steepness", "gdal:slope", "Slope for the breaklines", raster)
    at_one_slope = {
        "INPUT": Source.fromChildOutput("steepness", "OUTPUT"),
        "INTERVAL": Source.fromStaticValue(90.0),  # no second line: slopes are below 90 degrees
        "OFFSET": Source.fromModelParameter("STEEP"),
        "FIELD_NAME": Source.fromStaticValue("slope"),
    }
    _step(model, 6, "edges", "gdal:contour", "Draw lines around steep places", at_one_slope)
    breaklines = {"INPUT": Source.fromChildOutput("edges", "OUTPUT"), "EXPRESSION": length}
    named = {"OUTPUT": ("BREAKLINES", "Breaklines")}
    _step(model, 7, "breaklines", extract, "Keep the long breaklines", breaklines, named)
    _describe(
        model,
        "Make map layers of a DSM (model)",
        "The layers that a map needs, made of a DSM or DTM by QGIS's own algorithms: contours, the slope in degrees, "
        "a hillshade with light from several directions, the terrain ruggedness index, which is high at edges and "
        "walls, and breaklines: the upper and lower rims of banks and walls, where the slope passes a limit. "
        "The heights must be in metres, and the CRS a projected one: degrees would make the slopes wrong. "
        "Contours and breaklines that are shorter than the shortest are left out: they are single trees, cars and "
        "errors of a few cells. Each output can be skipped. To change a step, click with the right mouse button on "
        "the model in the toolbox and choose 'Copy to my models and edit…'. A copy's layers have QGIS's usual styles.",
    )
    return model


def _step(
    model: QgsProcessingModelAlgorithm,
    place: int,
    name: str,
    algorithm: str,
    title: str,
    sources: dict,
    outputs: dict | None = None,
) -> None:
    """Add an algorithm of QGIS's with the sources of its parameters, and its defaults for all others."""
    child = QgsProcessingModelChildAlgorithm(algorithm)
    child.setChildId(name)
    child.setDescription(title)
    child.setPosition(QPointF(360, 80 + 110 * place))
    for definition in QgsApplication.processingRegistry().algorithmById(algorithm).parameterDefinitions():
        if definition.name() in sources:
            child.addParameterSources(definition.name(), [sources[definition.name()]])
        elif definition.defaultValue() is not None and not definition.isDestination():
            child.addParameterSources(definition.name(), [Source.fromStaticValue(definition.defaultValue())])
    _show(child, place, outputs or {})
    model.addChildAlgorithm(child)


def _show(child: QgsProcessingModelChildAlgorithm, place: int, outputs: dict) -> None:
    """Make outputs of a step the model's own, beside the step."""
    shown = {}
    for row, (name, (key, label)) in enumerate(outputs.items()):
        output = QgsProcessingModelOutput(key, label)
        output.setChildId(child.childId())
        output.setChildOutputName(name)
        output.setPosition(QPointF(640, 60 + 110 * place + 40 * row))
        shown[key] = output
    child.setModelOutputs(shown)


def _add_inputs(model: QgsProcessingModelAlgorithm, parameters: list) -> None:
    for place, parameter in enumerate(parameters):
        component = QgsProcessingModelParameter(parameter.name())
        component.setPosition(QPointF(100, 60 + 90 * place))
        model.addModelParameter(parameter, component)
    model.setParameterOrder([parameter.name() for parameter in parameters])


def _describe(model: QgsProcessingModelAlgorithm, title: str, text: str) -> None:
    model.setHelpContent(
        {
            "ALG_DESC": text,
            "ALG_CREATOR": "The REPM plugin's maintainers",
            "ALG_VERSION": "0.1.0",
            "SHORT_DESCRIPTION": title,
        }
    )


def main() -> int:
    sys.path.insert(0, "/usr/share/qgis/python/plugins")
    application = QgsApplication([], False)
    application.initQgis()
    from processing.core.Processing import Processing

    Processing.initialize()  # GDAL's algorithms
    # The children's definitions are needed to write the model: load the provider as QGIS does.
    import importlib.util

    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    spec = importlib.util.spec_from_file_location(
        "repm", os.path.join(root, "__init__.py"), submodule_search_locations=[root]
    )
    if spec is None or spec.loader is None:
        raise SystemExit(f"make_models: {root} is no package.")
    package = importlib.util.module_from_spec(spec)
    sys.modules["repm"] = package
    spec.loader.exec_module(package)
    plugin = package.classFactory(None)
    plugin.initProcessing()
    written, problems = True, []
    for name, model in (("repm_stages", stages_model()), ("repm_map", map_model())):
        written &= model.toFile(os.path.join(FOLDER, f"{name}.model3"))
        problems += model.validate()[1]
    del model
    plugin.unload()
    application.exitQgis()
    for problem in problems:
        sys.stderr.write(f"make_models: {problem}\n")
    return 0 if written and not problems else 1


if __name__ == "__main__":
    sys.exit(main())
