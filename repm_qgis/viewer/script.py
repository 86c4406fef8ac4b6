"""The page's script: the modules of ``resources/viewer`` as one, because browsers import none from a file's folder.

Modules are joined as they are, each after those that it imports, without the lines that import and the word
``export``. For that they keep to a part of the language: ``import {a, b} from "./other.js";`` at a line's beginning,
``export`` in front of a function, a class or a constant, and no name at two modules' top level.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Dict, Tuple

_IMPORT = re.compile(r'^import \{\s*\w+(?:,\s*\w+)*,?\s*\} from "\./([\w.]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const) )", re.MULTILINE)
_OTHER = re.compile(r"^(?:import|export)\b.*", re.MULTILINE)
_DECLARED = re.compile(r"^(?:async )?(?:function\*?|class|const|let|var) (\w+|\{[^}]*\}|\[[^\]]*\])", re.MULTILINE)


def joined(entry: Path) -> str:
    """A module, after all those that it imports from its folder.

    Raises ValueError for modules that import one another in a circle, that import or export in a way that is not
    known here, and for a name that two of them have. Raises OSError for a module that is not there.
    """
    order: Dict[str, str] = {}
    _collect(entry.parent, entry.name, order, ())
    owners: Dict[str, str] = {}
    for name, text in order.items():
        for declared in _DECLARED.findall(text):
            for word in re.findall(r"\w+", declared):
                if owners.setdefault(word, name) != name:
                    raise ValueError(f"{owners[word]} and {name} both declare '{word}'.")
    return "\n".join(f"// {name}\n{text}" for name, text in order.items())


def _collect(folder: Path, name: str, order: Dict[str, str], importers: Tuple[str, ...]) -> None:
    """Put into ``order`` what a module imports, then the module."""
    if name in importers:
        raise ValueError(f"Modules import one another in a circle: {' > '.join((*importers, name))}.")
    if name in order:
        return
    source = (folder / name).read_text(encoding="utf-8")
    for other in _IMPORT.findall(source):
        _collect(folder, other, order, (*importers, name))
    text = _EXPORT.sub("", _IMPORT.sub("", source)).lstrip("\n")
    unknown = _OTHER.search(text)
    if unknown:
        raise ValueError(f"{name} has a line that cannot be joined with other modules: {unknown.group()}")
    order[name] = text
