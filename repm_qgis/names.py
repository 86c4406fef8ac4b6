"""The name of a scene on the map, in reports and on pages: by the most telling folder or file name, and the days.
Folders such as "out", files such as "dsm.tif" and temporary folders of QGIS do not identify a scene; then the folder
around them names it, or the images.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import List, Sequence

from .contracts.checks import as_text
from .contracts.errors import ImageError
from .contracts.options import PREVIEW
from .geometry.vertical import PLACED, PLACED_TAG
from .imagery import raster
from .runtime.translation import said
from .scene import Scene, origin

DAYS = "REPM_DAYS"
"""The item of a DSM's metadata with the days on which its images were taken, between spaces."""

_KINDS = {
    "dsm",
    "dtm",
    "dem",
    "ortho",
    "orthophoto",
    "mosaic",
    "terrain",
    "truth",
    "confidence",
    "surface",
    "edited",
    "registered",
}
_PLAIN = _KINDS | {
    *("out", "output", "outputs", "result", "results", "product", "products", "export", "exports", "run", "runs"),
    *("work", "workspace", "working", "temp", "tmp", "test", "tests", "data", "raw", "images", "image", "img", "imgs"),
    *("scene", "scenes", "repm", "folder", "new", "neu", "bilder", "daten", "ergebnis", "ergebnisse", "ausgabe"),
    *("preview", "vorschau"),
    *("home", "user", "users", "documents", "dokumente", "downloads", "desktop", "schreibtisch", "mnt", "media"),
}
_TEMPORARY = re.compile(r"processing_\w+|[0-9a-f]{32}")
_MOST_PARTS = 3  # that a mosaic is named after
_SCENES_OF_RUNS = ("registered.json", "reconstructed.json", "scene.json")


def titled(name: str, taken: Sequence[str]) -> str:
    """A scene's name and its days: "hills, 2019-04-02"."""
    return ", ".join(filter(None, (name, period(taken))))


def marked(name: str, registered: bool, preset: str = "") -> str:
    """A scene's name, which tells it from its preview and from that before it was registered, also where its end is cut
    off: "registered, hills"."""
    marks = [said("preview")] * (preset == PREVIEW) + [said("registered")] * registered
    return ", ".join([*marks, name]) if name else name


def period(taken: Sequence[str]) -> str:
    """The first and the last of some days (ISO 8601), "" where none is known."""
    return " – ".join(dict.fromkeys((taken[0], taken[-1]))) if taken else ""


def folder_name(path: str) -> str:
    """The name of a folder, or of the one around it where its own is a common word; "" where both are."""
    if not path:
        return ""
    folder, home = Path(os.path.abspath(path)), Path.home()
    if any(_TEMPORARY.fullmatch(part) for part in folder.parts):
        return ""
    for each in (folder, folder.parent):
        if each == home or each in home.parents:
            return ""
        if not _is_plain(each.name):
            return each.name
    return ""


def images_name(paths: Sequence[str]) -> str:
    """The name of the folder that holds all of several images, else that of the first image's file."""
    if not paths:
        return ""
    try:
        folder = os.path.commonpath([os.path.dirname(os.path.abspath(path)) for path in paths])
    except ValueError:  # on several drives
        folder = ""
    return (folder_name(folder) if len(paths) > 1 else "") or Path(paths[0]).stem


def surface_name(path: str) -> str:
    """The name of a raster of heights or a cloud: its file's, else its folder's, else that of the scene beside it."""
    folder = os.path.dirname(os.path.abspath(path))
    if any(_TEMPORARY.fullmatch(part) for part in Path(folder).parts):
        return ""
    words = re.split(r"[_\- ]+", Path(path).stem)
    while words and words[0].lower() in _KINDS:
        del words[0]
    while words and words[-1].lower() in _KINDS:
        del words[-1]
    stem = Path(path).stem
    own = stem[stem.find(words[0]) : stem.rfind(words[-1]) + len(words[-1])] if words else ""
    found = own if own and not _is_plain(own) else folder_name(folder)
    scenes = (os.path.join(folder, name) for name in _SCENES_OF_RUNS)
    return found or next((images_name(origin(scene)[1]) for scene in scenes if os.path.exists(scene)), "")


def scene_name(path: str) -> str:
    """The name of a scene, by its file: the workspace's, else that in which it began, else the images'."""
    began, images = origin(path)
    return folder_name(os.path.dirname(path)) or folder_name(began) or images_name(images)


def run_name(workspace: str, output: str, images: Sequence[str]) -> str:
    """The name of what a run makes of images: the workspace's, else the DSM's file's, else the images'."""
    return folder_name(workspace) or (surface_name(output) if output else "") or images_name(images)


def scene_title(scene: Scene, path: str) -> str:
    """The name and the days of a scene whose file is, or will be, ``path``."""
    record = scene.record_of("epmfit")
    began = str(record.options.get("workspace") or "") if record else ""
    images = [view.image for view in scene.views]
    name = folder_name(os.path.dirname(path)) or folder_name(began) or images_name(images)
    return titled(marked(name, scene.registration is not None, scene.preset), scene.days())


def surface_title(path: str) -> str:
    """The name and the days of a DSM."""
    return titled(marked(surface_name(path), is_of_registered(path)), surface_days(path))


def dates_title(*surfaces: str) -> str:
    """The names of the DSMs of several dates, and the days of their images."""
    return titled(dates_name(*surfaces), sorted({day for each in surfaces for day in surface_days(each)}))


def dates_name(*surfaces: str) -> str:
    """The names of the DSMs of several dates, or the one name that all have; of many the first and the last."""
    found = list(dict.fromkeys(filter(None, map(surface_name, surfaces))))
    return " – ".join(found if len(found) <= _MOST_PARTS else (found[0], found[-1]))


def mosaic_name(output: str, parts: Sequence[str]) -> str:
    """The name of a mosaic: its file's, or those of its parts where there are few."""
    names = (scene_name(part) if part.lower().endswith(".json") else surface_name(part) for part in parts)
    found = list(dict.fromkeys(filter(None, names)))
    stem = surface_name(output)
    return " + ".join(found) if not stem and len(found) <= _MOST_PARTS else stem


def surface_days(path: str) -> List[str]:
    """The days of the images that a DSM of this plugin was made of; empty for other files."""
    return sorted(set(_item(path, DAYS).split()))


def is_of_registered(path: str) -> bool:
    """Whether a DSM of this plugin was made of a scene that was registered to a reference; False for other files."""
    return _item(path, PLACED_TAG) == PLACED[0]


def _item(path: str, tag: str) -> str:
    """An item of a raster's metadata, "" where it has none or is no raster."""
    try:
        with raster.opened(path) as dataset:
            return as_text(dataset.GetMetadataItem(tag) or "")
    except ImageError:
        return ""


def _is_plain(name: str) -> bool:
    """Whether a name does not identify a scene: a common word, with a short number or a cell size."""
    words = [word.lower() for word in re.split(r"[_\- ().]+", name) if word]
    telling = [word for word in words if word not in _PLAIN and not re.fullmatch(r"\d{1,3}m?", word)]
    plain_end = re.fullmatch(r"([^\W\d_]+)\d{1,3}", telling[0]) if len(telling) == 1 else None
    return not telling or bool(plain_end and plain_end[1] in _PLAIN)
