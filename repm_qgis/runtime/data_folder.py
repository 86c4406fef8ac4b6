"""Where the engine's own files that are no code lie: templates, styles, translations, the glossary."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
_IN_WHEEL = _PACKAGE / "data"
DATA_FOLDER = _IN_WHEEL if _IN_WHEEL.is_dir() else _PACKAGE.parent
"""The plugin's folder, of which a wheel has the engine's part inside the package (pyproject.toml)."""
