"""Which matcher works: the names of the dialog, and the modules behind them."""

from __future__ import annotations

import importlib
from typing import Callable, Tuple

import numpy as np
from numpy.typing import NDArray

from .matching import Matched

FloatImage = NDArray[np.float32]
Matcher = Callable[[FloatImage, FloatImage, Tuple[int, int], float], Matched]

_MODULES = {"sgm": "repm_qgis.mvs.sgm"}


def resolve(backend: str) -> str:
    """The backend that ``auto`` means on this machine; others are taken by their word."""
    return "sgm" if backend == "auto" else backend


def matcher_of(backend: str) -> Matcher:
    """The ``match`` function of a backend, imported now: workers ask for it by name."""
    return importlib.import_module(_MODULES[backend]).match
