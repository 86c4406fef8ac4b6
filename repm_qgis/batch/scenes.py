"""The scenes of a folder, of a STAC file or of a table, each with the options that it has for itself.

A table may have come from anybody: its size is bounded, its texts are only read as the values of known options, and
none of them may lead to the network.
"""

from __future__ import annotations

import difflib
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable, Dict, List, Mapping, Optional, get_origin

from ..contracts.checks import file_name
from ..contracts.documents import JsonObject
from ..contracts.errors import ImageError, InputTableError, OptionError, RepmError, WorkspaceError, reason_of
from ..contracts.file_kinds import IMAGE_ENDS, is_archive, is_catalogue
from ..contracts.options import PRESETS, BatchOptions, PipelineOptions
from ..contracts.paths import real_path
from ..files.tables import CsvTable, Limits, number_in
from ..imagery.deliveries import delivered_item
from ..imagery.stac import StacItem, named_items
from ..names import images_name

MOST_SCENES = 1000
LIMITS = Limits(4 << 20, MOST_SCENES, "the table of scenes")
_NAME = "scene"  # the column with a scene's name
_NETWORK = re.compile(r"\s*(?:[a-z][a-z0-9+.-]+://|/vsi|\\\\|//)", re.IGNORECASE)
_BOUNDS = re.compile(r"\s*([^\[\]]*?)\s*(?:\[([^\[\]]{1,80})\])?\s*")
_SWITCHES = {**dict.fromkeys(("true", "yes", "1"), True), **dict.fromkeys(("false", "no", "0"), False)}


@dataclass(frozen=True)
class SceneOfMany:
    """One scene: its name, which is that of its folder, the pipeline's options that it has for itself, and what is
    wrong with it where that is known already."""

    name: str
    own: JsonObject = field(default_factory=dict)
    error: Optional[RepmError] = None

    def job(self, common: Mapping[str, object]) -> JsonObject:
        """The pipeline's options of the scene, without places: its own go before the common ones, and so do the values
        of a preset of its own."""
        base = dict(common)
        if "preset" in self.own:
            before = PRESETS.get(str(base.get("preset", "none")), {})
            base = {name: value for name, value in base.items() if name not in before or value != before[name]}
            base.update(PRESETS.get(str(self.own["preset"]), {}))
        return {**base, **self.own}


def scenes_of(options: BatchOptions) -> List[SceneOfMany]:
    """The scenes in their order: those of a folder by name, others as their file has them.

    Raises OptionError where there is none, InputTableError for a table that cannot be read, or has a column or a value
    that is no option's, and ImageError for a file that is no STAC.
    """
    if options.folder:
        found = _in_folder(options.folder, options.workspace)
    elif is_catalogue(str(options.table)):
        found = [_of_item(str(options.table), name, item) for name, item in named_items(str(options.table))]
    else:
        found = _in_table(str(options.table), options)
    taken: Dict[str, str] = {}
    for scene in found:
        place = scene.name.casefold()
        if place in taken:
            where = f"holds two scenes of the name '{scene.name}', and each needs a folder of its own: rename one"
            raise OptionError("FOLDER" if options.folder else "TABLE", options.folder or options.table, where)
        taken[place] = scene.name
    return found


def _in_folder(folder: str, workspace: str) -> List[SceneOfMany]:
    """Each subfolder and each archive; not what is hidden, nor the workspace."""
    try:
        with os.scandir(folder) as listed:
            entries = sorted(listed, key=lambda entry: entry.name)
    except OSError as error:
        raise OptionError("FOLDER", folder, f"cannot be read ({reason_of(error)}): choose another folder") from error
    own = os.path.join(real_path(workspace), "")
    paths = [
        entry.path
        for entry in entries
        if not entry.name.startswith(".")
        and (is_archive(entry.path) or (entry.is_dir() and not own.startswith(os.path.join(real_path(entry.path), ""))))
    ]
    if not paths:
        images = any(entry.name.lower().endswith(IMAGE_ENDS) for entry in entries)
        one = ": for the images of one scene in one folder, use repm:pipeline" if images else ""
        raise OptionError("FOLDER", folder, f"holds no subfolder and no archive, each of which would be a scene{one}")
    if len(paths) > MOST_SCENES:
        raise OptionError("FOLDER", folder, f"holds more than {MOST_SCENES} subfolders: choose the folder of fewer")
    whole = [Path(path).stem if is_archive(path) else os.path.basename(path) for path in paths]
    return [SceneOfMany(file_name(name), {"images": [path]}) for name, path in zip(whole, paths)]


def _of_item(path: str, name: str, item: "StacItem | ImageError") -> SceneOfMany:
    named = file_name(name)
    if isinstance(item, ImageError):
        return SceneOfMany(named, error=item)
    try:
        images = delivered_item(path, item)
    except RepmError as error:
        return SceneOfMany(named, error=error)
    rpcs = {"rpcs": list(images.rpcs)} if any(images.rpcs) else {}
    return SceneOfMany(named, {"images": list(images.images), **rpcs})


# --- tables ---


def _in_table(path: str, options: BatchOptions) -> List[SceneOfMany]:
    if not os.path.isfile(path):
        raise InputTableError(f"There is no table '{path}': check its path.")
    LIMITS.require_size(path)
    table = CsvTable(path)
    _require_columns(path, table.fields)
    found: List[SceneOfMany] = []
    for line, row in table.rows():
        place = f"Row {line} of '{path}'"
        if table.surplus:
            raise InputTableError(
                f"{place} has more values than the first line has columns: put a text that holds the separator in "
                "quotation marks."
            )
        texts = {name: str(text).strip() for name, text in row.items() if name and text is not None}
        if any(texts.values()):
            LIMITS.require_count(path, len(found) + 1)
            found.append(_of_row(place, os.path.dirname(os.path.abspath(path)), texts, options.common))
    if not found:
        raise InputTableError(f"'{path}' has no row below its columns: write a row for each scene.")
    return found


def _require_columns(path: str, columns: List[str]) -> None:
    known = [_NAME, *BatchOptions.column_names()]
    for name in filter(None, columns):
        if columns.count(name) > 1:
            raise InputTableError(f"'{path}' has two columns '{name}': remove one.")
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            meant = f"do you mean '{near[0]}'? Rename or remove it" if near else "remove it"
            raise InputTableError(
                f"'{path}' has a column '{name[:80]}', which is no option of a scene: {meant}. Columns are "
                f"{', '.join(known)}."
            )
    if "images" not in columns:
        raise InputTableError(
            f"'{path}' has no column 'images': name each scene's images there, or their folder, archive or STAC item."
        )


def _of_row(place: str, folder: str, texts: Mapping[str, str], common: Mapping[str, object]) -> SceneOfMany:
    own: JsonObject = {}
    for name, text in texts.items():
        if name != _NAME and text:
            own.update(_value(f"{place}: the column '{name}'", folder, name, text))
    if "images" not in own:
        raise InputTableError(f"{place} has no images: name them, or remove the row.")
    images = own["images"]
    named = texts.get(_NAME) or (_plain_name(images[0]) if len(images) == 1 else images_name(images))
    scene = SceneOfMany(file_name(named), own)
    try:  # values are refused now, before hours of work on the rows above
        given = images if len(images) > 1 else [*images, f"{images[0]}?"]
        job = {**scene.job(common), "images": given, "rpcs": [], "masks": []}
        PipelineOptions.from_json({**job, "workspace": "w", "output": "dsm.tif"})
    except OptionError as error:
        raise InputTableError(f"{place}: {error}") from error
    return scene


def _plain_name(path: str) -> str:
    name = os.path.basename(path.rstrip("/\\"))
    return name if os.path.isdir(path) else os.path.splitext(name)[0]


def _value(place: str, folder: str, name: str, text: str) -> JsonObject:
    """The text of a column as options: its own, and for EXTENT in QGIS's form the CRS."""
    for part in re.split(r"[;\[]", text):
        if _NETWORK.match(part):
            raise InputTableError(f"{place} leads to the network ('{part[:80]}'): download the file and name the copy.")
    if name == "extent":
        return _extent(place, text)
    kind, is_path = PipelineOptions.kind_of(name), bool(PipelineOptions.option(name).metadata.get("read"))

    def one(part: str) -> str:
        return os.path.join(folder, part) if is_path and part else part

    if get_origin(kind) is tuple:
        return {name: [one(part.strip()) for part in text.split(";")]}
    read: Dict[object, Callable[[str], object]] = {
        bool: lambda each: _switch(place, each),
        int: lambda each: _whole(place, name, each),
        float: lambda each: number_in(place, name, each),
        str: one,
    }
    return {name: read[kind](text)}


def _switch(place: str, text: str) -> bool:
    if text.lower() not in _SWITCHES:
        raise InputTableError(f"{place} is '{text[:80]}': write yes or no.")
    return _SWITCHES[text.lower()]


def _whole(place: str, name: str, text: str) -> int:
    number = number_in(place, name, text)
    if not number.is_integer():
        raise InputTableError(f"{place} is '{text[:80]}': write a whole number.")
    return int(number)


def _extent(place: str, text: str) -> JsonObject:
    """xmin ymin xmax ymax as the command line has it, or QGIS's "xmin,xmax,ymin,ymax [EPSG:...]"."""
    found = _BOUNDS.fullmatch(text)
    words = [word for word in re.split(r"[\s,;]+", found[1]) if word] if found else []
    if found is None or len(words) != 4:
        raise InputTableError(
            f"{place} is '{text[:80]}': write xmin ymin xmax ymax, or xmin,xmax,ymin,ymax [EPSG:...] as QGIS does."
        )
    a, b, c, d = (number_in(place, "extent", word) for word in words)
    return {"extent": [a, c, b, d], "extent_crs": found[2].strip()} if found[2] else {"extent": [a, b, c, d]}


def folder_of(workspace: str, name: str) -> str:
    """The folder of a scene; raises WorkspaceError where a link with its name leads out of the workspace."""
    path = os.path.join(workspace, name)
    if os.path.islink(path):
        raise WorkspaceError(f"'{path}' is a link, where a scene needs a folder of its own: remove it.")
    return path
