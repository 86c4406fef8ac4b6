"""Where the engine's own files that are no code lie: templates, styles, translations, the glossary."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
IN_WHEEL = (_PACKAGE / "data").is_dir()
"""Whether the engine was installed as a package of its own, without the plugin."""
DATA_FOLDER = _PACKAGE / "data" if IN_WHEEL else _PACKAGE.parent
"""The plugin's folder, of which a wheel has the engine's part inside the package (pyproject.toml)."""
