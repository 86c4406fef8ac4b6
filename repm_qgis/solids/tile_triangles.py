"""The cells of a tile that its triangles need, and the triangles: squares are halved where the surface is not flat.

Tiles of one level must meet without gaps, and vertices must be cells of the DSM: so right-angled triangles are halved,
from the tile's two largest down to the cells, where a cell that is left out would lie too far from them. This is no
package's work: collapsed edges (solids/simplification.py) put vertices between the cells.

References
----------
Evans, Kirkpatrick and Townsend, Right-triangulated irregular networks, Algorithmica 30 (2001).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List

import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import AnyArray, FloatImage, Mask
from ..runtime.progress import Progress
from .lattice import TRIANGLES, square_triangles

Places = NDArray[np.int32]
"""Rows and columns of cells."""
_GATHERED = 1 << 18  # cells below triangles that are looked at together; bounds the memory


@dataclass(frozen=True)
class Kept:
    """Which of a tile's cells are vertices, and (N, 3) their numbers in the triangles."""

    cells: Mask
    triangles: NDArray[np.int32]


def kept_of_tile(heights: FloatImage, cell_m: float, tolerance_m2: float, *, lost: float, progress: Progress) -> Kept:
    """The cells and triangles of a tile of 2**n + 1 cells a side, NaN = no height.

    Cells are left out whose sum of squared distances is within the tolerance. A cell that is lost to a hole counts as
    ``lost`` squared sides of its triangle. All cells along the tile's sides stay, so that it meets its neighbours.
    """
    errors = _errors(heights, cell_m, lost, progress)
    errors[[0, -1]] = errors[:, [0, -1]] = np.inf
    half = 1
    while half < len(heights) - 1:
        _contain(errors, half)
        half *= 2
    corners = _triangles(errors > tolerance_m2, heights)
    used = np.zeros(heights.shape, bool)  # cells with only holes around them have no triangle
    used[corners[..., 0], corners[..., 1]] = True
    numbers = np.cumsum(used, dtype=np.int32).reshape(used.shape) - 1
    return Kept(used, numbers[corners[..., 0], corners[..., 1]])


def surface_of_tile(heights: FloatImage, used: Mask) -> FloatImage:
    """The heights of a tile's triangles at all of its cells: those of the cells that are ``used``, and between them the
    means of the ends of the edges that would be split there."""
    surface = heights.copy()
    half = (len(heights) - 1) // 2
    while half:
        side = 2 * half
        a, b, c, d = _corners(surface, side)
        falling = np.indices(a.shape).sum(axis=0) % 2 == 0
        ends = surface[::side, ::side]
        for place, mean in (
            ((slice(half, None, side), slice(half, None, side)), np.where(falling, a + d, b + c) / 2),
            ((slice(None, None, side), slice(half, None, side)), (ends[:, :-1] + ends[:, 1:]) / 2),
            ((slice(half, None, side), slice(None, None, side)), (ends[:-1] + ends[1:]) / 2),
        ):
            surface[place] = np.where(used[place], surface[place], mean)
        half //= 2
    return surface


# Errors -----------------------------------------------------------------------------------------------------------


def _errors(heights: FloatImage, cell_m: float, lost: float, progress: Progress) -> FloatImage:
    """The error of each cell as the middle of its two triangles alone, m2."""
    found = np.zeros(heights.shape, np.float32)
    surface = _Surface(heights, _steepness(heights, cell_m)[:-1, :-1])
    half = 1
    while half < len(heights) - 1:
        progress.check_cancelled()
        surface.add(found, half, lost * (2 * half * cell_m) ** 2)
        half *= 2
    return found


def _steepness(heights: FloatImage, cell_m: float) -> FloatImage:
    """Squared distance from a slope by squared difference of height, by the largest step to a neighbour: on a wall, a
    mesh that is metres too low is decimetres away. Cells without a height do not count."""
    rise = np.zeros(heights.shape, np.float32)
    for a, b in (((slice(-1),), (slice(1, None),)), ((slice(None), slice(-1)), (slice(None), slice(1, None)))):
        step = np.nan_to_num(np.abs(heights[b] - heights[a]))
        for place in (a, b):
            np.maximum(rise[place], step, out=rise[place])
    weights: FloatImage = np.where(np.isfinite(heights), 1 / (1 + (rise / np.float32(cell_m)) ** 2), np.float32(0))
    return weights


class _Surface:
    """What the cells of a tile lie away from the triangles of a level."""

    def __init__(self, heights: FloatImage, weights: FloatImage) -> None:
        known = np.isfinite(heights)
        self._known, self._weights = known, weights
        self._heights = np.where(known, heights, np.float32(0))
        self._broken = ~(known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:])

    def add(self, found: FloatImage, half: int, lost: float) -> None:
        """Add the errors of the middles of squares of twice ``half`` a side, and of the middles of their sides."""
        side = 2 * half
        corners, known = _corners(self._heights, side), _corners(self._known, side)
        a, b, c, d = (_spread(corner, side) for corner in corners)
        u, v = (np.tile(np.arange(side, dtype=np.float32) / side, size // side) for size in a.shape)
        u, v = u[:, None], v[None]
        upper, first = u <= v, u + v < 1
        # The square's two halves: their diagonal goes through the middle of the next larger square.
        even = np.indices(corners[0].shape).sum(axis=0) % 2 == 0
        falling = _spread(even, side)
        near = np.where(falling, upper, first)
        lines = np.where(upper, a + (b - a) * v + (d - b) * u, a + (c - a) * u + (d - c) * v)
        others = np.where(first, a + (b - a) * v + (c - a) * u, d + (c - d) * (1 - v) + (b - d) * (1 - u))
        away = self._away(np.where(falling, lines, others))
        ends = known[0] & known[1] & np.where(even, known[3], known[2])
        found[half::side, half::side] = self._sums(near, away, ends, side, lost)
        ends = known[2] & known[3] & np.where(even, known[0], known[1])
        found[half::side, half::side] += self._sums(~near, away, ends, side, lost)
        # The square's four quarters, which meet in its middle.
        middle = _spread(self._heights[half::side, half::side], side)
        p, q, flat = np.where(first, a, d), np.where(upper, b, c), upper == first
        along, inwards = np.where(flat, v, u), np.where(flat, u, v)
        along, inwards = np.where(first, along, 1 - along), 2 * np.where(first, inwards, 1 - inwards)
        away = self._away(p + (q - p) * along + (middle - (p + q) / 2) * inwards)
        inner = self._known[half::side, half::side]
        for part, ends, place in (
            (upper & first, known[0] & known[1], found[0:-1:side, half::side]),
            (~upper & ~first, known[2] & known[3], found[side::side, half::side]),
            (~upper & first, known[0] & known[2], found[half::side, 0:-1:side]),
            (upper & ~first, known[1] & known[3], found[half::side, side::side]),
        ):
            place += self._sums(part, away, ends & inner, side, lost / 2)

    def _away(self, surface: FloatImage) -> FloatImage:
        away: FloatImage = self._weights * (self._heights[:-1, :-1] - surface) ** 2
        return away

    def _sums(self, part: Mask, away: FloatImage, whole: Mask, side: int, lost: float) -> FloatImage:
        """Sums over a part of each square; where a hole reaches into it, its cells are ``lost`` with it."""
        holed = (_summed(part & self._broken, side, np.int32) > 0) | ~whole
        gone = _summed(part & self._known[:-1, :-1], side, np.int32) * np.float32(lost)
        sums: FloatImage = np.where(holed, gone, _summed(part * away, side, np.float32))
        return sums


def _corners(values: AnyArray, side: int) -> List[AnyArray]:
    """Corners of all squares of a side: upper left, upper right, lower left, lower right."""
    grid = values[::side, ::side]
    return [grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]]


def _spread(values: AnyArray, side: int) -> AnyArray:
    """Each square's value in all of its cells."""
    return np.repeat(np.repeat(values, side, axis=0), side, axis=1)


def _summed(values: AnyArray, side: int, kind: type) -> AnyArray:
    """Sums over the cells of each square."""
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], side), axis=0, dtype=kind)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], side), axis=1)


def _contain(errors: FloatImage, half: int) -> None:
    """Make the errors of squares' middles not less than those of their sides', and of their corners than theirs."""
    side = 2 * half
    middles, corners = errors[half::side, half::side], errors[::side, ::side]
    across, down = errors[::side, half::side], errors[half::side, ::side]
    for sides in (across[:-1], across[1:], down[:, :-1], down[:, 1:]):
        np.maximum(middles, sides, out=middles)
    around = np.pad(middles, 1)
    for part in (around[:-1, :-1], around[:-1, 1:], around[1:, :-1], around[1:, 1:]):
        np.maximum(corners, part, out=corners)


# Triangles --------------------------------------------------------------------------------------------------------


def _triangles(used: Mask, heights: FloatImage) -> Places:
    """(N, 3, 2) row and column of the corners of all triangles that lie on no hole, counter-clockwise from above."""
    known, root = np.isfinite(heights), len(heights) - 1
    # The tile's two halves, the right angle's corner first.
    level = np.array([[[0, root], [0, 0], [root, root]], [[root, 0], [root, root], [0, 0]]], np.int32)
    done: List[Places] = []
    while len(level):
        if np.abs(level[0, 1] - level[0, 0]).sum() == 1:  # no cell is between two neighbours
            done += _smallest(level, heights)
            break
        middle = (level[:, 1] + level[:, 2]) // 2
        split = used[middle[:, 0], middle[:, 1]]
        done.append(_whole(level[~split], known))
        parent, middle = level[split], middle[split]
        level = np.concatenate([np.stack([middle, parent[:, n], parent[:, m]], axis=1) for n, m in ((0, 1), (2, 0))])
    return np.concatenate(done)


def _smallest(level: Places, heights: FloatImage) -> List[Places]:
    """Halves of squares between four neighbours; of whole ones, the triangles that the mesh of all cells has."""
    place = level.min(axis=1)
    _, first, number, count = np.unique(
        place[:, 0].astype(np.int64) * heights.shape[1] + place[:, 1],
        return_index=True,
        return_inverse=True,
        return_counts=True,
    )
    halves = _whole(level[count[number.ravel()] == 1], np.isfinite(heights))
    row, column = place[first[count == 2]].T
    a, b, c, d = (heights[row + down, column + right] for down in (0, 1) for right in (0, 1))
    square, kind = square_triangles(a, b, c, d)
    return [halves, np.stack([row, column], axis=-1)[square][:, None] + TRIANGLES[kind].astype(np.int32)]


def _whole(level: Places, known: Mask) -> Places:
    """Those of equally large triangles below which all cells have heights."""
    level = level[known[level[..., 0], level[..., 1]].all(axis=1)]
    if not len(level):
        return level
    legs = level[:, 1:] - level[:, :1]
    length = int(np.abs(legs[0, 0]).max())
    along, across = np.indices((2 * length + 1, 2 * length + 1)).reshape(2, -1)  # of the legs, in halves of cells
    odd = (along % 2, across % 2)
    inside = (odd[0] == odd[1]) if legs[0, 0].all() else (odd[0] + odd[1] == 0)
    inside &= along + across <= 2 * length
    steps = np.stack([along[inside], across[inside]])
    whole = np.empty(len(level), dtype=bool)
    many = max(_GATHERED // steps.shape[1], 1)
    for start in range(0, len(level), many):
        part = slice(start, start + many)
        row, column = (level[part, 0, n, None] + (legs[part, :, n] // length) @ steps // 2 for n in (0, 1))
        whole[part] = known[row, column].all(axis=1)
    found: Places = level[whole]
    return found
