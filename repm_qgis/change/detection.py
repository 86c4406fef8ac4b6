"""Which cells changed: every rule depends on a cell's neighbourhood only, so that blocks give the same result as the
whole. A change has a core, whose difference is larger than errors of heights, of edges and of hidden ground explain,
and around it the cells that belong to the same change. See docs/algorithms/change.md for the rules and their sources.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..contracts.arrays import FloatImage, Mask
from .errors import ErrorModel
from .parameters import CHANGE, DetectionParameters
from .surfaces import Cells

_FAR = np.float32(-1e9)  # lower than all heights


@dataclass(frozen=True)
class Detected:
    """What a window shows, (rows, columns) each.

    ``level`` of detection, m, NaN where a height is missing or interpolated. ``change`` in m, 0 where there is none,
    NaN where it is not known. ``strength``: the differences of the cells of cores, together with their neighbours, in
    levels of flat ground; 0 elsewhere. ``error`` of the difference, m. ``beside_walls``: changed cells that walls hide.
    """

    level: FloatImage
    change: FloatImage
    strength: FloatImage
    error: FloatImage
    beside_walls: Mask

    @property
    def core(self) -> Mask:
        """Cells that are significant by themselves."""
        return self.strength > 0


def detect(
    cells: Cells, model: ErrorModel, cell_m: float, parameters: DetectionParameters = CHANGE.detection
) -> Detected:
    """The changes in a window; those nearer to its edge than ``halo_cells`` may be cut."""
    error = model.of_cells(cells)
    level = np.float32(parameters.level) * error
    flat = np.float32(parameters.level) * model.of_heights(cells)
    change = np.where(np.isfinite(cells.difference) & np.isfinite(level), np.float32(0), np.float32(np.nan))
    strength, hidden = np.zeros(change.shape, np.float32), np.zeros(change.shape, bool)
    for sign, lower, higher in ((1, cells.before, cells.after), (-1, cells.after, cells.before)):
        rise = higher - lower
        top, bottom = _extreme(lower, parameters.reach_cells), -_extreme(-higher, parameters.reach_cells)
        seen = _with_hidden(top, cell_m, parameters)
        with np.errstate(invalid="ignore"):
            beyond = np.where(cells.measured & (rise > level), np.minimum(higher - seen, bottom - lower) / flat, _FAR)
            # A new house rises above everything around it, and a pit lies below; where only an edge has moved, neither
            # is true.
            near = (rise > flat) & ((higher > top) | (bottom > lower))
            unchanged = _extreme(np.where(rise > flat, _FAR, np.float32(1)), parameters.reach_cells) > 0
        own = _agreed(np.where(np.isfinite(beyond), beyond, _FAR), parameters)
        grown = core = own > 0
        for _ in range(parameters.grown_cells):
            grown = core | (_extreme(np.where(grown, np.float32(1), _FAR), 1) > 0) & near
        # At an edge that one DSM shows farther out, the difference is the whole height of the object, but this is no
        # change.
        most = _extreme(np.where(core, rise, _FAR), parameters.grown_cells)
        # Matching blurs an edge: it lies where half of the height is reached, if the ground beside it is unchanged.
        grown &= ~unchanged | (rise >= np.float32(0.5) * most)
        beside = _joined(grown, most, np.where(rise > flat, rise, _FAR), _walls(lower, seen, parameters), parameters)
        hidden |= beside > 0
        change = np.where(grown, np.float32(sign) * np.minimum(rise, most), change)
        change = np.where(beside > 0, np.float32(sign) * beside, change)
        strength = np.maximum(strength, own)
    return Detected(level, change, strength, error, hidden)


def _walls(lower: FloatImage, seen: FloatImage, parameters: DetectionParameters) -> FloatImage:
    """How high the walls are whose strips a cell lies in: the ground that they hide, and the roof's rim; m."""
    rim = 2 * parameters.reach_cells + parameters.coherent_radius
    return np.asarray(np.maximum(seen - lower, lower + _extreme(-lower, rim)))


def _joined(
    grown: Mask, most: FloatImage, rise: FloatImage, walls: FloatImage, parameters: DetectionParameters
) -> FloatImage:
    """The change of the cells in the strips at walls, which show no core, that adjoin a change and differ by at least
    half as much as it does, as the walls are high; 0 elsewhere. A change may cross the walls, or one of the DSMs may
    have closed the gap beside them: so half of the difference counts."""
    around = np.where(grown, most, _FAR)
    result = np.zeros(most.shape, np.float32)
    for _ in range(parameters.strip_cells if grown.any() else 0):
        near = _extreme(around, 1)
        with np.errstate(invalid="ignore"):
            new = (around == _FAR) & (near > 0) & (np.minimum(rise, walls) >= np.float32(0.5) * near)
        if not new.any():
            break
        around = np.where(new, near, around)
        result = np.where(new, np.float32(0.5) * np.minimum(rise, near), result)
    return result


def _agreed(beyond: FloatImage, parameters: DetectionParameters) -> FloatImage:
    """The difference of each cell, in levels, together with the coherent share of its neighbours; 0 where it is no
    core."""
    radius = parameters.coherent_radius
    side = 2 * radius + 1
    least = math.ceil(parameters.coherent_share * side**2)  # of the window's cells
    rows, columns = np.nonzero(beyond > parameters.core)
    highest_first = np.pad(-beyond, radius, constant_values=-_FAR)
    around = np.stack([highest_first[rows + down, columns + right] for down in range(side) for right in range(side)])
    around.partition(least - 1, axis=0)
    shared = -around[least - 1]  # the value that this many of them reach
    result = np.zeros(beyond.shape, np.float32)
    result[rows, columns] = np.where(shared > parameters.core, np.minimum(beyond[rows, columns], shared), 0)
    return result


def _extreme(values: FloatImage, reach: int) -> FloatImage:
    """The highest known value within ``reach`` cells along both axes; very low where none is known."""
    result = np.where(np.isfinite(values), values, _FAR)
    for axis in (0, 1):
        source = result
        result = source.copy()
        for by in range(1, reach + 1):
            _raise(result, source, by if axis == 0 else 0, by if axis == 1 else 0, 0.0)
    return result


def _with_hidden(top: FloatImage, cell_m: float, parameters: DetectionParameters) -> FloatImage:
    """The surface with a slope at the foot of every wall: in the strip that it hides, heights are not reliable.

    A dilation by a cone, along the axes and both diagonals, each by doubled steps.
    """
    drop = parameters.hidden_gradient * cell_m
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        length = math.hypot(down, right)
        for power in range(parameters.hidden_steps if length == 1 else parameters.hidden_steps - 1):
            source, by = top, 1 << power
            top = source.copy()
            _raise(top, source, down * by, right * by, drop * by * length)
    return top


def _raise(result: FloatImage, source: FloatImage, down: int, right: int, drop: float) -> None:
    """Raise a result to its source ``down, right`` cells away on both sides, less a drop."""
    rows, columns = result.shape
    for dr, dc in ((down, right), (-down, -right)):
        to = slice(max(dr, 0), rows + min(dr, 0)), slice(max(dc, 0), columns + min(dc, 0))
        come = slice(max(-dr, 0), rows + min(-dr, 0)), slice(max(-dc, 0), columns + min(-dc, 0))
        np.maximum(result[to], source[come] - np.float32(drop), out=result[to])
