"""LE90 and CE90: the words in which contracts, standards and vendors state accuracy, defined here for all reports.

- **LE90** (linear error, 90 %): the height error that nine of ten heights do not exceed, in either direction.
- **CE90** (circular error, 90 %): the radius, on the ground, of the circle around their true places that holds nine of
  ten points.

Of *measured* errors they are the quantile of 90 % of the absolute errors, with all their bias and gross errors, as the
United States' National Map Accuracy Standards (NMAS 1947) count points. Of a *predicted* standard deviation they are
its multiple for the normal distribution (NIMA STDI-0002). ASPRS (Positional Accuracy Standards for Digital Geospatial
Data, Edition 2, 2023) states root mean squares instead: RMSE_V of heights and RMSE_H of horizontal distances, of at
least thirty check points.
"""

from __future__ import annotations

import numpy as np

from ..contracts.arrays import FloatArray, Floats

SHARE = 0.9
LE90 = 1.645
"""LE90 by the standard deviation of heights, of the normal distribution."""
CE90 = 2.146
"""CE90 by the standard deviation in each direction, of the circular normal distribution."""
LEAST_POINTS = 30
"""Check points that ASPRS (2023) asks for."""

EXPLAINED = (
    "LE90: nine of ten heights are off by no more (NMAS: a quantile of the absolute errors, with bias and gross errors "
    "in it)."
)
"""The sentence below tables that have an LE90."""


def le90(errors: Floats) -> float:
    """The LE90 of errors of any shape, in their unit; NaN are left out, and no error at all gives NaN."""
    known = np.abs(errors[np.isfinite(errors)])
    return float(np.quantile(known, SHARE)) if known.size else float("nan")


def distances(east_north: FloatArray) -> FloatArray:
    """(N,) horizontal distances of (N, 2) errors, whose LE90 is the CE90; NaN where either is."""
    found: FloatArray = np.hypot(east_north[:, 0], east_north[:, 1])
    return found
