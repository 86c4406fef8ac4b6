"""Versions of packages that some tests need, and that not every Python has."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

import pytest


def _pycolmap() -> str:
    for name in ("pycolmap", "pycolmap-cuda12"):
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return "none"  # the tests then fail by themselves


needs_pycolmap_4 = pytest.mark.skipif(
    _pycolmap().split(".")[0] in ("0", "1", "2", "3"),
    reason="pycolmap 4 is needed, which has no wheel for Python 3.9: the engine says so in a sentence",
)
