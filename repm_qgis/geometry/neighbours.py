"""How the neighbours of each point of a cloud lie: their principal axes."""

from __future__ import annotations

from typing import Any, Iterator, Tuple

import numpy as np

from ..contracts.arrays import FloatArray


def principal_axes(
    tree: Any, neighbours: int, at_once: int, dimensions: int = 3
) -> Iterator[Tuple[slice, FloatArray, FloatArray, FloatArray]]:
    """For a tree's points, ``at_once`` of them at a time: distances of the neighbours (n, k), variances along the
    principal axes (n, d), the smallest first, and these axes (n, d, d), one in each column.

    ``tree`` is scipy's cKDTree of (N, 3) points; a point is its own first neighbour. Of ``dimensions`` only the first
    so many coordinates are looked at, where the neighbours are those in space.
    """
    xyz = tree.data
    for first in range(0, len(xyz), at_once):
        part = slice(first, first + at_once)
        away, near = tree.query(xyz[part], k=neighbours)
        places = xyz[near][..., :dimensions]
        around = places - places.mean(axis=1, keepdims=True)
        values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around) / neighbours)
        yield part, away, values, axes
