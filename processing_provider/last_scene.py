"""The scene that was written last: what a stage's dialog takes up."""

from __future__ import annotations

import os

from qgis.core import QgsSettings

_KEY = "repm/last_scene"


def last_scene() -> str:
    """Its path; "" where there is none any more."""
    path = str(QgsSettings().value(_KEY, "") or "")
    return path if os.path.exists(path) else ""


def remember(path: str) -> None:
    QgsSettings().setValue(_KEY, path)
