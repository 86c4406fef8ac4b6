"""Refuses a run that would replace a file that it reads, or write two products under one name."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Dict, List, Tuple

from ..contracts.errors import ImageError, OptionError, SceneError
from ..contracts.formats import require_formats
from ..contracts.options import Options
from ..contracts.paths import real_path
from ..contracts.products import BUILT_FOLDER, FOLDER, POINTS, POLYGONS, RASTER, SCENE, Product, paths_of
from ..contracts.records import with_files
from ..files.vector import file_and_layer, strangers_in
from ..imagery.raster import files_of
from ..rpc.readers import rpc_sidecars
from ..runtime.progress import listed
from ..runtime.workspace import existing_place, require_replaceable
from ..scene import Scene


def require_writable(stage: str, options: Options) -> None:
    """Raise OptionError for a product in a format that is not written, or whose file holds layers of others, which
    would be lost. Dialogs use the same check as the engine."""
    require_formats(stage, options)
    for product, path in paths_of(stage, options):
        others = strangers_in(path) if product.form in (RASTER, POINTS, POLYGONS) else []
        if others:
            names = listed([repr(each) for each in others])
            lost = f"holds {names}, which this program did not write, and which would be lost: choose another file"
            raise OptionError(product.option.upper(), path, lost)


def require_distinct(stage: str, options: Options) -> None:
    """Raise OptionError for a product whose path is that of another one, or of a file that the stage reads.

    Links are followed, and the files that belong to an image, and those that a scene names, are compared too. A stage
    may write its scene over the one that it reads, which it continues. Names that differ only in case are the same
    where the file system ignores case. Raises WorkspaceError for a file that another program keeps from being replaced,
    or that an OBJ's picture or material would replace.
    """
    written = [(each, path) for each, path in paths_of(stage, options) if each.form != FOLDER]
    taken: Dict[str, Tuple[Product, str]] = {}
    for each, path in written:
        place = _place(path)
        if place in taken:
            raise OptionError(each.option.upper(), path, f"is also {taken[place][0].option.upper()}: choose two names")
        taken[place] = each, path
    built = {place: each for place, (each, _) in taken.items() if each.form == BUILT_FOLDER}
    for place, (each, path) in taken.items():
        for folder, owner in built.items():
            if place.startswith(os.path.join(folder, "")):
                inside = f"lies in {owner.option.upper()}, a folder that is replaced as a whole: choose another place"
                raise OptionError(each.option.upper(), path, inside)
    files = {(name, file) for name, path in options.read_paths() for file in _files(name, path, stage)}
    for each, path in written:
        for name, file in sorted(files):
            if not (each.form == SCENE and name == "scene") and _same(path, file, each in built.values()):
                reason = f"is also a file of the input {name.upper()}, which would be lost: choose another name"
                raise OptionError(each.option.upper(), path, reason)
    for each, path in written:
        require_replaceable(path)
        if each.option == "mesh" and path.lower().endswith(".obj"):
            from ..solids.obj import require_own_companions

            require_own_companions(path)


def _place(path: str) -> str:
    """A value that is equal for two paths of one file, which need not exist yet."""
    place = real_path(path)
    return place.casefold() if _ignores_case(existing_place(place)) else place


def _ignores_case(place: str) -> bool:
    """Whether a file or folder is also found under its name in the other case, as on Windows and macOS."""
    folder, name = os.path.split(place)
    if not name:
        return os.name == "nt"
    if name.swapcase() == name:
        return _ignores_case(folder)
    try:
        return os.path.samefile(place, os.path.join(folder, name.swapcase()))
    except OSError:
        return False


def _files(name: str, path: str, stage: str) -> List[str]:
    """The files that an input consists of."""
    if name in ("scene", "scenes"):
        return _files_of_scene(path, stage)
    if name in ("table", "gcps", "profiles", "rpcs", "edits", "areas"):
        return [file_and_layer(path)[0]]
    return files_of(path) + (rpc_sidecars(path) if name in ("images", "xs") else [])


def _files_of_scene(path: str, stage: str) -> List[str]:
    """A scene's file and those that it names, except files that the stage makes again."""
    if stage == "pipeline":  # its own scenes, in its workspace
        return [path]
    try:
        scene = Scene.load(path)
    except (SceneError, ImageError):  # the stage reports what is wrong
        return [path]
    files = [path]

    def found(file: str) -> str:
        files.append(file)
        return file

    with_files(replace(scene, tie_points="") if stage == "reconstruct" else scene, found)
    return [*files, *(file for view in scene.views for file in (*files_of(view.image), *rpc_sidecars(view.image)))]


def _same(path: str, file: str, is_folder: bool) -> bool:
    """Whether writing to a path would replace a file, which may lie in the folder of that path."""
    place, read = real_path(path), real_path(file)
    if place == read or (is_folder and read.startswith(os.path.join(place, ""))):
        return True
    try:
        return os.path.samefile(place, read)
    except OSError:
        return False
