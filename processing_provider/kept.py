"""Products without a name from the user: the workspace keeps them, or the folder of the DSM that they come from, not
QGIS's temporary one. So all layers of a run still exist when the project is opened again.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import Container, Iterator, Mapping, Optional, Sequence

from qgis.core import (
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingOutputLayerDefinition,
    QgsProcessingUtils,
    QgsProject,
    QgsProperty,
)

from ..repm_qgis.contracts.options import PREVIEW
from ..repm_qgis.contracts.products import OF_SCENES, Product, products_of, stem_of
from ..repm_qgis.names import images_name
from ..repm_qgis.scene import origin
from .values import any_paths, is_empty

_NOT_PLACED = ("epmfit.workspace", "reconstruct.heights")  # says where the workspace is; lies in it if left out
PLACES = ("WORKSPACE", "OUTPUT_SCENE", "SCENE", "DSM", "AFTER", "DSMS", "SCENES")
_promised: set[str] = set()  # places of runs that are under way


def is_lasting(path: str) -> bool:
    """Whether a path is outside the folder that QGIS empties when it closes."""
    temporary = os.path.join(os.path.abspath(QgsProcessingUtils.tempFolder()), "")
    return bool(path) and not os.path.join(os.path.abspath(path), "").startswith(temporary)


@contextmanager
def in_workspace(
    algorithm: QgsProcessingAlgorithm,
    parameters: Mapping[str, object],
    inputs: Mapping[str, object],
    context: QgsProcessingContext,
) -> Iterator[dict[str, object]]:
    """The parameters, with temporary products in the workspace where the user has named one: ``dsm.tif``, or
    ``dsm_2.tif`` where the first is taken, so that nothing is replaced that an earlier run has made. ``inputs`` are the
    engine's options."""
    folder, surface = _place(algorithm, parameters, inputs, context) if algorithm.name() in OF_SCENES else ("", "")
    if folder and inputs.get("preset") == PREVIEW:
        folder = os.path.join(folder, PREVIEW)
    places = _places(algorithm, parameters, folder, surface)
    _promised.update(places.values())
    try:
        yield {**parameters, **{name: moved_to(path, parameters[name]) for name, path in places.items()}}
    finally:
        _promised.difference_update(places.values())


def in_folder(
    algorithm: QgsProcessingAlgorithm,
    parameters: Mapping[str, object],
    typed: Container[str],
    context: QgsProcessingContext,
) -> dict[str, object]:
    """A dialog's parameters, with products in the workspace or beside the surface that they are made of: those without
    a name, which a command leaves temporary, and those whose name was ``typed`` without a folder, which QGIS puts into
    one for all projects. Reads the project: main thread only."""
    placed = {**parameters, "OUTPUT_SCENE": QgsProcessing.TEMPORARY_OUTPUT} if "OUTPUT_SCENE" in typed else parameters
    folder, surface = _place(algorithm, placed, _named(parameters, context), context)
    places = _places(algorithm, parameters, folder, surface) if algorithm.name() not in OF_SCENES else {}
    for name, value in parameters.items() if folder else ():
        if name in typed and name != "WORKSPACE" and not is_temporary(value):
            sink = _sink(value)
            path = sink.staticValue() if sink is not None else value
            places[name] = os.path.join(folder, os.path.basename(str(path)))
    return {**parameters, **{name: moved_to(path, parameters[name]) for name, path in places.items()}}


def folder_for_products(
    algorithm: QgsProcessingAlgorithm, parameters: Mapping[str, object], context: QgsProcessingContext
) -> str:
    """Where a dialog with these parameters keeps products without a name, "" for QGIS's temporary folder. Reads the
    project: main thread only."""
    return _place(algorithm, parameters, _named(parameters, context), context)[0]


def _named(parameters: Mapping[str, object], context: QgsProcessingContext) -> dict[str, object]:
    return {name.lower(): any_paths(parameters.get(name), context, only_named=True) for name in PLACES}


def _places(
    algorithm: QgsProcessingAlgorithm, parameters: Mapping[str, object], folder: str, surface: str
) -> dict[str, str]:
    """The places in a folder of products without a name, by parameter; none without a folder."""
    names = {
        each.option.upper(): _name(algorithm, each, surface)
        for each in products_of(algorithm.name())
        if f"{each.stage}.{each.option}" not in _NOT_PLACED and is_temporary(parameters.get(each.option.upper()))
    }
    return _free(folder, names) if folder else {}


def propose_workspace(images: Sequence[str]) -> str:
    """A workspace in the project's folder, or in that of the images where the project has none; "" where nothing can be
    written there. A scene of other images keeps its own."""
    if not images:
        return ""
    folder = place_of("WORKSPACE", QgsProject.instance().homePath() or os.path.dirname(os.path.abspath(images[0])))
    name, number = images_name(images), 1
    path = place = os.path.join(folder, "repm", name) if folder else ""
    own = [os.path.realpath(image) for image in images]
    while os.path.lexists(path) and [os.path.realpath(each) for each in origin(f"{path}/scene.json")[1]] != own:
        number += 1
        path = f"{place}_{number}"
    return path


def propose_for_many(path: str) -> str:
    """A workspace for the scenes of a folder or a table, in the project's folder or beside that; "" where nothing can
    be written there. Scenes of an earlier run keep it, as a second one goes on there."""
    if not path:
        return ""
    folder = place_of("WORKSPACE", QgsProject.instance().homePath() or os.path.dirname(os.path.abspath(path)))
    name = os.path.splitext(os.path.basename(path.rstrip("/\\")))[0]
    return os.path.join(folder, "repm", name) if folder else ""


def place_of(name: str, path: str) -> str:
    """The folder that a parameter's value stands for: the workspace, or that of a scene or surface; "" where it is a
    temporary one, or one in which nothing can be written."""
    folder = path if name == "WORKSPACE" else os.path.dirname(path)
    if not path or path == QgsProcessing.TEMPORARY_OUTPUT or not is_lasting(folder):
        return ""
    above = folder
    while above and not os.path.isdir(above) and os.path.dirname(above) != above:
        above = os.path.dirname(above)
    return os.path.abspath(folder) if os.access(above, os.W_OK) else ""


def _place(
    algorithm: QgsProcessingAlgorithm,
    parameters: Mapping[str, object],
    inputs: Mapping[str, object],
    context: QgsProcessingContext,
) -> tuple[str, str]:
    """The folder for products without a name, "" for QGIS's temporary one, and the surface they come from, if any."""
    for name in PLACES:
        definition = algorithm.parameterDefinition(name)
        if name == "OUTPUT_SCENE" and is_temporary(parameters.get(name)):
            continue  # it lies beside the scene before it
        if definition is not None and definition.isDestination() and not is_empty(parameters.get(name)):
            return place_of(name, algorithm.parameterAsString(parameters, name, context)), ""
        given = inputs.get(name.lower())
        path = str((given[0] if isinstance(given, (list, tuple)) else given) if given else "")
        if path:
            is_scene = name in ("SCENE", "SCENES")
            return place_of(name, path if os.path.exists(path) else ""), "" if is_scene else path
    return "", ""


def _name(algorithm: QgsProcessingAlgorithm, product: Product, surface: str) -> tuple[str, str]:
    """A product's name in its folder, and its extension ("" for folders)."""
    definition = algorithm.parameterDefinition(product.option.upper())
    extension = "" if definition.type() == "folderDestination" else f".{definition.defaultFileExtension()}"
    return stem_of(algorithm.name(), product, surface), extension


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


def is_temporary(value: object) -> bool:
    sink = _sink(value)
    return (sink.staticValue() if sink is not None else value) == QgsProcessing.TEMPORARY_OUTPUT


def moved_to(path: str, value: object) -> object:
    """The value with another place; whether QGIS loads the layer, and where, stays."""
    if not isinstance(value, QgsProcessingOutputLayerDefinition):
        return path
    moved = QgsProcessingOutputLayerDefinition(path, value.destinationProject)
    moved.destinationName, moved.createOptions = value.destinationName, value.createOptions
    return moved
