"""Spreads and weights that a few gross errors do not move; one place for all robust fits."""

from __future__ import annotations

from typing import Optional, Union

import numpy as np

from ..contracts.arrays import Floats

NMAD_FACTOR = 1.4826  # the standard deviation of Gaussian noise over its median absolute deviation


def nmad(values: Floats, centre: Optional[float] = None) -> float:
    """The normalised absolute deviation of finite values from their median or a known centre; inf where there are
    none."""
    away = values - (np.median(values) if centre is None else centre) if values.size else np.array([np.inf])
    return NMAD_FACTOR * float(np.median(np.abs(away)))


def tukey(share: Floats) -> Floats:
    """Tukey's biweight (Beaton and Tukey 1974) of residuals as shares of the limit from which on they do not count."""
    return np.asarray(np.maximum(1.0 - share**2, 0.0) ** 2)


def huber(size: Union[float, Floats], limit: float) -> Floats:
    """Huber's weights (1964) of the sizes of residuals, which fall beyond a limit: nearly least absolute residuals."""
    return np.asarray(np.minimum(1.0, limit / np.maximum(size, 1e-9)))
