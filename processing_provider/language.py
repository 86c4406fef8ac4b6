"""QGIS's language, and the engine's texts in it."""

from __future__ import annotations

import os
import re
from typing import Callable, Dict

from qgis.core import QgsApplication, QgsProcessingUtils, QgsProject, QgsSettings
from qgis.PyQt.QtCore import QLocale

from ..repm_qgis.runtime.translation import Translator
from ..repm_qgis.runtime.wording import with_decimals, with_labels
from .words import shown


def locale() -> str:
    """The code of QGIS's language, such as "de_DE"; the system's where the user chose none."""
    return str(QgsSettings().value("locale/userLocale", "") or QLocale().name() or "")


def language() -> str:
    """The code of the language that the engine's texts have here: "en" where there is no catalogue of QGIS's."""
    return Translator.of(locale()).language


def labels(stage: str) -> Dict[str, str]:
    """What the dialogs call the parameters, by their names: as the algorithm of the stage does, else as another does.

    Reports of the stage give their advice in these words.
    """
    provider = QgsApplication.processingRegistry().providerById("repm")
    algorithms = provider.algorithms() if provider is not None else []
    found: Dict[str, str] = {}
    for algorithm in sorted(algorithms, key=lambda each: each.name() != stage):
        for definition in algorithm.parameterDefinitions():
            found.setdefault(definition.name(), definition.description())
    return found


def dialog_words(stage: str) -> Callable[[str], str]:
    """What puts a message about a stage into the words of its dialog: labels of fields, choices in words, and layers'
    names for their temporary files; commands keep the names that they are given. Reads the project: main thread
    only."""
    if not is_desktop():
        return str
    named, layers = labels(stage), QgsProject.instance().mapLayers().values()
    temporary = os.path.join(os.path.abspath(QgsProcessingUtils.tempFolder()), "")
    files = {f"'{path}'": f"'{layer.name()}'" for layer in layers for path in [layer.source().split("|")[0]]}
    files = {path: name for path, name in files.items() if path[1:].startswith(temporary)}
    choices = re.compile(rf"\b({'|'.join(map(re.escape, named))}) (is|ist) '(\w+)'")

    def put(text: str) -> str:
        for path, name in files.items():
            text = text.replace(path, name)
        text = choices.sub(lambda each: f"{each[1]} {each[2]} ‘{shown(each[1], each[3])}’", text)
        return with_decimals(with_labels(text, named), language())

    return put


def is_desktop() -> bool:
    """Whether people see dialogs; qgis_process and servers have none."""
    return bool(QgsApplication.platform() == "desktop")


def said(text: str) -> str:
    """A text of the engine in QGIS's language."""
    return Translator.of(locale()).translate(text)
