"""QGIS's language, and the engine's texts in it."""

from __future__ import annotations

from typing import Dict

from qgis.core import QgsApplication, QgsSettings
from qgis.PyQt.QtCore import QLocale

from ..repm_qgis.runtime.translation import Translator


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


def said(text: str) -> str:
    """A text of the engine in QGIS's language."""
    return Translator.of(locale()).translate(text)
