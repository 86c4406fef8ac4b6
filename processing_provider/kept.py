"""Products without a name from the user: the user's own workspace keeps them, instead of QGIS's temporary folder. So
all layers of a run still exist when the project is opened again.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import Iterator, Mapping, Optional

from qgis.core import (
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingOutputLayerDefinition,
    QgsProcessingUtils,
    QgsProperty,
)

from ..repm_qgis.contracts.products import Product, products_of

_NOT_PLACED = ("workspace", "output_scene", "heights")  # what says where the workspace is, or lies in it if left out
_AFTER_RUN = {
    **{"pipeline": "dsm", "dsmfuse": "dsm", "epmfit": "cameras", "errormap": "equivalent_error"},
    **{"refine": "refinement", "reconstruct": "reconstruction", "register": "registration"},
}
"""What products of one name in several stages are called after. The engine's own ``tiles.gpkg`` and ``report.html`` are
those of the last run, and are replaced by the next."""
_promised: set[str] = set()  # places of runs that are under way


def is_lasting(path: str) -> bool:
    """Whether a path is outside the folder that QGIS empties when it closes."""
    temporary = os.path.join(os.path.abspath(QgsProcessingUtils.tempFolder()), "")
    return bool(path) and not os.path.join(os.path.abspath(path), "").startswith(temporary)


@contextmanager
def in_workspace(
    algorithm: QgsProcessingAlgorithm, parameters: Mapping[str, object], context: QgsProcessingContext
) -> Iterator[dict[str, object]]:
    """The parameters, with temporary products in the workspace where the user has named one: ``dsm.tif``, or
    ``dsm_2.tif`` where the first is taken, so that nothing is replaced that an earlier run has made."""
    places: dict[str, str] = {}
    workspace = _workspace(algorithm, parameters, context)
    if workspace:
        names = {
            each.option.upper(): _name(algorithm, each)
            for each in products_of(algorithm.name())
            if each.option not in _NOT_PLACED and _is_temporary(parameters.get(each.option.upper()))
        }
        places = _free(workspace, names)
    _promised.update(places.values())
    try:
        yield {**parameters, **{name: _at(path, parameters[name]) for name, path in places.items()}}
    finally:
        _promised.difference_update(places.values())


def _workspace(
    algorithm: QgsProcessingAlgorithm, parameters: Mapping[str, object], context: QgsProcessingContext
) -> str:
    """The user's own folder in which a stage works, its scene's too; "" where it works in temporary ones."""
    for name in ("WORKSPACE", "OUTPUT_SCENE", "SCENE") if algorithm.name() in _AFTER_RUN else ():
        if algorithm.parameterDefinition(name) is not None:
            given = algorithm.parameterAsString(parameters, name, context)
            place = given if name == "WORKSPACE" else os.path.dirname(given)
            return os.path.abspath(place) if given != QgsProcessing.TEMPORARY_OUTPUT and is_lasting(place) else ""
    return ""


def _name(algorithm: QgsProcessingAlgorithm, product: Product) -> tuple[str, str]:
    """A product's name in the workspace, and its extension ("" for folders)."""
    definition = algorithm.parameterDefinition(product.option.upper())
    extension = "" if definition.type() == "folderDestination" else f".{definition.defaultFileExtension()}"
    shared = product.option if product.option in ("report", "tiles", "tie_points") else ""
    of_run = _AFTER_RUN[algorithm.name()]
    return f"{of_run}_{shared}" if shared else product.style or product.option, extension


def _free(folder: str, names: Mapping[str, tuple[str, str]]) -> dict[str, str]:
    """The products' places in a folder, all with the first number that none of them has yet."""
    number = 1
    while True:
        end = f"_{number}" if number > 1 else ""
        places = {key: os.path.join(folder, f"{name}{end}{extension}") for key, (name, extension) in names.items()}
        if not any(os.path.lexists(path) or path in _promised for path in places.values()):
            return places
        number += 1


def _sink(value: object) -> Optional[QgsProperty]:
    return value.sink if isinstance(value, QgsProcessingOutputLayerDefinition) else None


def _is_temporary(value: object) -> bool:
    sink = _sink(value)
    return (sink.staticValue() if sink is not None else value) == QgsProcessing.TEMPORARY_OUTPUT


def _at(path: str, value: object) -> object:
    """The value with another place; whether QGIS loads the layer, and where, stays."""
    if not isinstance(value, QgsProcessingOutputLayerDefinition):
        return path
    moved = QgsProcessingOutputLayerDefinition(path, value.destinationProject)
    moved.destinationName, moved.createOptions = value.destinationName, value.createOptions
    return moved
