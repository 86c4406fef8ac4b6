"""Which matcher works: the names of the dialog, and the modules behind them.

``sgm`` matches pairs on the CPU (:mod:`dense`, its ``match`` is asked for by name); ``colmap`` all views of a tile on
CUDA (:mod:`colmap_backend`).
"""

from __future__ import annotations

import importlib
from typing import Callable

from ..environment import cuda, cuda_usable
from ..errors import DeviceError
from .matched import Matched

Matcher = Callable[..., Matched]

_MODULES = {"sgm": "repm_qgis.matching.sgm"}


def resolve(backend: str) -> str:
    """The backend that ``auto`` means on this machine: ``colmap`` only where a CUDA device really answers.

    Raises DeviceError where ``colmap`` is asked for by name and cannot run.
    """
    if backend == "auto":
        return "colmap" if cuda_usable() else "sgm"
    remedy = cuda()["remedy"] if backend == "colmap" else ""
    if remedy:
        raise DeviceError(f"BACKEND colmap needs CUDA, and {remedy}; or choose sgm.")
    return backend


def matcher_of(backend: str) -> Matcher:
    """The ``match`` function of a backend that matches pairs, imported now: workers ask for it by name."""
    return importlib.import_module(_MODULES[backend]).match
