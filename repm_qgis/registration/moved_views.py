"""A shift of the ground put into the images' pointing, so that every product of the scene follows."""

from __future__ import annotations

from typing import Tuple

import numpy as np

from ..arrays import Altitudes, Bounds, FloatArray
from ..geometry.frames import geodetic_from_projected
from ..scene import View
from .solve import Shift

_NODES = (7, 7, 3)  # east, north, up


def added(shift: Shift, xy: FloatArray) -> FloatArray:
    """(N, 3) metres east, north, up that a shift adds to the own surface at (N, 2) places of it."""
    tilted = (xy - shift.centre) @ shift.tilt
    return np.column_stack([np.tile(shift.moved[:2], (len(xy), 1)), shift.moved[2] + tilted])


def moved_view(view: View, crs: str, bounds: Bounds, altitudes: Altitudes, shift: Shift) -> Tuple[View, float]:
    """The view with a pointing that sees every point of the ground where the shift has moved it.

    ``crs`` is the projected CRS of the shift and of ``bounds``, the ground that matters; ``altitudes`` are metres above
    the ellipsoid. The pointing is an affine map, so a shift is not exactly one: the second result is the largest error
    that is left in the image, px.
    """
    ends = (bounds.xmin, bounds.xmax), (bounds.ymin, bounds.ymax), altitudes
    lattice = np.meshgrid(*(np.linspace(*pair, count) for pair, count in zip(ends, _NODES)))
    ground = np.column_stack([axis.ravel() for axis in lattice])
    seen = view.project(_geodetic(crs, ground))
    raw = view.rpc.project(_geodetic(crs, ground + added(shift, ground[:, :2])))
    middle = raw.mean(axis=0)  # small numbers, or the solution loses digits
    design = np.column_stack([raw - middle, np.ones(len(raw))])
    solution = np.linalg.lstsq(design, seen, rcond=None)[0].T
    error = float(np.abs(design @ solution.T - seen).max())
    return view.with_pointing(np.column_stack([solution[:, :2], solution[:, 2] - solution[:, :2] @ middle])), error


def _geodetic(crs: str, xyz: FloatArray) -> FloatArray:
    return np.column_stack([geodetic_from_projected(crs, xyz[:, :2]), xyz[:, 2]])
