"""The options of recorded runs: those of a command or a scene, made safe to run again."""

from __future__ import annotations

import html
import os
import re
import shlex
from contextlib import suppress
from typing import Dict, List, Mapping, Tuple

from ..contracts.options import PRESETS, PipelineOptions
from ..contracts.products import products_of
from ..contracts.records import StageRecord
from ..contracts.stages import STAGES
from ..files.untrusted import refusal_of
from ..scene import SceneFacts
from .facts import Value
from .places import is_remote, lies_in

_MOST_WORDS = 20_000  # of a command
_NOT_TAKEN = ("cluster", "workers", "memory", "command")  # of a record: where a run computes is this user's choice
_WORD = re.compile(r'(?:[^\s"]|"[^"]*")+')


def commanded_options(page: str, stage: str) -> Dict[str, Value]:
    """The options of the command that a report shows, as texts; empty where it shows none of this stage."""
    shown = re.search(r"<pre>(qgis_process [^<]{1,300000})</pre>", page)
    return options_of_command(html.unescape(shown.group(1)), stage) if shown else {}


def options_of_command(command: str, stage: str) -> Dict[str, Value]:
    """The options of a ``qgis_process`` command of a stage, as texts; empty for any other text. Nothing is run."""
    try:
        if "\\" in command and "'" not in command:  # as Windows quotes
            words = [word.replace('"', "") for word in _WORD.findall(command)]
        else:
            words = shlex.split(command)
    except ValueError:
        return {}
    if words[:4] != ["qgis_process", "run", f"repm:{stage}", "--"] or len(words) > _MOST_WORDS:
        return {}
    known = set(STAGES[stage].options.names())
    values: Dict[str, List[str]] = {}
    for word in words[4:]:
        name, mark, value = word.partition("=")
        if mark and name.lower() in known and name.lower() not in _NOT_TAKEN:
            values.setdefault(name.lower(), []).append(value)
    return {name: tuple(each) if len(each) > 1 else each[0] for name, each in values.items()}


def recorded_options(facts: SceneFacts, folder: str) -> Dict[str, Value]:
    """The options of the stages in a scene's history, as those of a whole run: what differs from the defaults."""
    known = {*PipelineOptions.names()} - {*_NOT_TAKEN, "workspace"}
    values: Dict[str, Value] = {}
    for entry in facts.history:
        for name, value in _plain_options(entry).items():
            if name in known and name not in ("report", "tiles", "tie_points") and not _is_default(name, value):
                values[name] = value
        extent, crs = entry.options.get("extent"), entry.options.get("extent_crs")
        if isinstance(extent, (list, tuple)) and len(extent) == 4:  # as commands have it
            values["extent"] = "{0},{2},{1},{3} [{4}]".format(*extent, crs)
    values.pop("extent_crs", None)
    values["images"] = tuple(view.image for view in facts.views)
    return relocated_options(values, folder, facts.folder)


def _plain_options(entry: StageRecord) -> Dict[str, Value]:
    """Those options of a record that are texts, numbers, switches or lists of them, which is all that there are."""
    found: Dict[str, Value] = {}
    for name, value in entry.options.items():
        if isinstance(value, (str, int, float)):
            found[name] = value
        elif isinstance(value, (list, tuple)) and value and all(isinstance(each, (str, int, float)) for each in value):
            found[name] = tuple(map(str, value))
    return found


def relocated_options(values: Mapping[str, Value], folder: str, before: str = "") -> Dict[str, Value]:
    """The options of a run in a workspace that may have been elsewhere ``before``; without products that would lie
    outside, and without whatever leads to the network."""
    before = before or str(values.get("workspace") or "")
    outputs = {each.option for each in products_of("pipeline")} - {"workspace"}
    found: Dict[str, Value] = {}
    for name, value in values.items():
        given = (value,) if isinstance(value, str) else value if isinstance(value, tuple) else ()
        texts = [_relocated(each, before, folder) for each in given]
        if any(map(is_remote, texts)):
            continue
        if name in outputs and not all(lies_in(folder, each) for each in texts):
            continue
        found[name] = value if not texts else tuple(texts) if isinstance(value, tuple) else texts[0]
    if found:
        found["workspace"] = folder
    return found


def _relocated(path: str, before: str, folder: str) -> str:
    """A path that lay in a folder ``before``, where the folder is now."""
    text, old = path.replace("\\", "/"), before.replace("\\", "/").rstrip("/")
    if old and (text == old or text.startswith(f"{old}/")):
        return os.path.join(folder, *filter(None, text[len(old) :].split("/")))
    return path


def safe_inputs(options: Mapping[str, Value]) -> Dict[str, Value]:
    """The options of a recorded run without files that must not be opened: those that lead to the network, are no
    absolute paths, or are refused by :func:`~repm_qgis.files.untrusted.refusal_of`."""
    read = {name for name in PipelineOptions.names() if PipelineOptions.option(name).metadata.get("read")}
    found: Dict[str, Value] = {}
    for name, value in options.items():
        if name in read and isinstance(value, (str, tuple)):
            files = (value,) if isinstance(value, str) else value
            kept = tuple(each for each in files if os.path.isabs(each) and not is_remote(each) and not refusal_of(each))
            if name == "images" or len(kept) == len(files):
                found[name] = kept if isinstance(value, tuple) or name == "images" else kept[0]
        else:
            found[name] = value
    return found


def _default(name: str) -> object:
    try:
        return PipelineOptions.default_of(name)
    except StopIteration:
        return None


def _is_default(name: str, value: object) -> bool:
    """Whether a value is an option's default, as a number or as text."""
    default = _default(name)
    if value in (default, None, "", "None") or (value == () and not default):
        return True
    if isinstance(default, bool):
        return str(value).lower() == str(default).lower()
    if isinstance(default, (int, float)):
        with suppress(ValueError, TypeError):
            return float(value) == float(default)  # type: ignore[arg-type]
    return bool(name == "extent_crs" or (default is None and value in (0, "0")))


def differing_options(options: Mapping[str, Value]) -> Tuple[str, ...]:
    """The options that are not the defaults, but for images and products."""
    left_out = {each.option for each in products_of("pipeline")} | {"images", "workspace", "extent_crs"}
    preset = PRESETS.get(str(options.get("preset", "none")), {})
    found = []
    for name, value in options.items():
        if name in left_out or _is_default(name, value) or str(preset.get(name, "")) == str(value):
            continue
        text = ", ".join(map(os.path.basename, value)) if isinstance(value, tuple) else str(value)
        if os.path.isabs(text):
            text = os.path.basename(text)
        found.append(f"{name.upper()} {text}"[:200])
    return tuple(found)
