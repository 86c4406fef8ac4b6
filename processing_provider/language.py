"""QGIS's language, and the engine's texts in it."""

from __future__ import annotations

from qgis.core import QgsSettings
from qgis.PyQt.QtCore import QLocale

from ..repm_qgis.translation import Translator


def locale() -> str:
    """The code of QGIS's language, such as "de_DE"; the system's where the user chose none."""
    return str(QgsSettings().value("locale/userLocale", "") or QLocale().name() or "")


def language() -> str:
    """The code of the language that the engine's texts have here: "en" where there is no catalogue of QGIS's."""
    return Translator.of(locale()).language


def said(text: str) -> str:
    """A text of the engine in QGIS's language."""
    return Translator.of(locale()).translate(text)
