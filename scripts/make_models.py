#!/usr/bin/env python3
"""Write resources/models/*.model3 through QGIS's own model API ('make models'), so that they always load again.

The model is the recipe of repm:pipeline, stage by stage, for the graphical modeler: to look at, take apart and change.
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
)
from qgis.PyQt.QtCore import QPointF

FOLDER = os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "resources", "models")
Source = QgsProcessingModelChildParameterSource


def _inputs() -> list:
    """The model's own parameters are those of repm:pipeline."""
    pipeline = QgsApplication.processingRegistry().algorithmById("repm:pipeline")
    return [pipeline.parameterDefinition(name).clone() for name in ("IMAGES", "EXTENT", "DEM", "RESOLUTION", "CRS")]


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
    shown = {}
    for row, (name, (key, label)) in enumerate(outputs.items()):
        output = QgsProcessingModelOutput(key, label)
        output.setChildId(stage)
        output.setChildOutputName(name)
        output.setPosition(QPointF(640, 60 + 110 * place + 40 * row))
        shown[key] = output
    child.setModelOutputs(shown)
    model.addChildAlgorithm(child)


def stages_model() -> QgsProcessingModelAlgorithm:
    """epmfit, errormap, refine, reconstruct, dsmfuse: the same DSM as repm:pipeline's."""
    model = QgsProcessingModelAlgorithm("dsm_by_stages", "REPM")
    for place, parameter in enumerate(_inputs()):
        component = QgsProcessingModelParameter(parameter.name())
        component.setPosition(QPointF(100, 60 + 90 * place))
        model.addModelParameter(parameter, component)
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
    model.setParameterOrder([parameter.name() for parameter in _inputs()])
    model.setHelpContent(
        {
            "ALG_DESC": "The stages of repm:pipeline one after the other, as a model to take apart. To change a stage, "
            "or to add one of your own, click with the right mouse button on it in the toolbox and choose 'Copy to my "
            "models and edit…': QGIS can edit only models of your own.",
            "ALG_CREATOR": "The REPM plugin's maintainers",
            "ALG_VERSION": "0.1.0",
            "SHORT_DESCRIPTION": "Make a DSM stage by stage (model)",
        }
    )
    return model


def main() -> int:
    sys.path.insert(0, "/usr/share/qgis/python/plugins")
    application = QgsApplication([], False)
    application.initQgis()
    # The children's definitions are needed to write the model: load the provider as QGIS does.
    import importlib.util

    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    spec = importlib.util.spec_from_file_location(
        "repm", os.path.join(root, "__init__.py"), submodule_search_locations=[root]
    )
    package = importlib.util.module_from_spec(spec)
    sys.modules["repm"] = package
    spec.loader.exec_module(package)
    plugin = package.classFactory(None)
    plugin.initProcessing()
    model = stages_model()
    written = model.toFile(os.path.join(FOLDER, "repm_stages.model3"))
    problems = model.validate()[1]
    del model
    plugin.unload()
    application.exitQgis()
    for problem in problems:
        sys.stderr.write(f"make_models: {problem}\n")
    return 0 if written and not problems else 1


if __name__ == "__main__":
    sys.exit(main())
