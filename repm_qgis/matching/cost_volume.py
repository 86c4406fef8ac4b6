"""Matching costs of learned features, their semi-global aggregation along eight paths (Hirschmueller 2008), and the
best disparity of each pixel with what tells whether it is right.

OpenCV's matcher takes no costs of others. Here a cost is half of 1 less the cosine of two pixels' features: matrix
products of blocks of a row with the band of the other row that they may match. All costs and paths are bytes, which
numpy adds and compares 32 at a time; sums over paths are of 16 bits. A penalty for a jump is less where the first
image has an edge: there, surfaces end.
"""

from __future__ import annotations

from typing import Callable, Iterator, NamedTuple, Tuple

import cv2
import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from ..contracts.arrays import ByteImage, FloatImage, IntArray
from ..imagery.sampling import known_or_zero
from .learned_features import features_of_rows, normalised
from .parameters import LearnedParameters

_ROWS = 128  # at once: features and costs of so many rows stay in the caches
_BLOCK = 64  # columns of a matrix product: narrower ones are slow, wider ones compute more than the band
_BYTE = 255  # the largest value of a path
_PATHS = 8
_NEVER = np.uint16(np.iinfo(np.uint16).max)


Penalties = Callable[[int, int], ByteImage]
Sums = NDArray[np.uint16]


class Winners(NamedTuple):
    """The best disparity of each pixel of the first image and of the second; ``first`` etc. are (H, W).

    ``first`` is the offset, to a fraction of a px, by which the second image's column is greater, and ``second``
    (H, W + span) the same for its pixels, in whole px. ``margin`` is by how much the next best offset, 3 px away or
    more, is dearer, ``lead`` the same of the mean over all offsets, and ``cost`` that of the pixel itself; all are of
    one path, in units of the dearest cost.
    """

    first: FloatImage
    second: IntArray
    margin: FloatImage
    lead: FloatImage
    cost: FloatImage


def winners(first: FloatImage, second: FloatImage, span: int, parameters: LearnedParameters) -> Winners:
    """Match images (H, W) and (H, W + span), 0..1 with NaN where there are none, over the offsets 0 to span."""
    p = parameters
    scale = int(_BYTE / (1 + p.p1 + p.p2))
    one = np.uint8(round(scale * p.p1))
    jump = _penalties(first, one + 1, scale * p.p2, p.contrast)
    volume = _costs(first, second, span, scale, np.uint8(round(scale * p.outside)))
    total = _along_rows(volume, one, jump)
    rows = range(len(volume))
    for _ in _along_columns(volume, total, rows, one, jump):
        pass
    return _chosen(volume, total, _along_columns(volume, total, rows[::-1], one, jump), scale)


def _costs(first: FloatImage, second: FloatImage, span: int, scale: int, outside: np.uint8) -> ByteImage:
    """(H, span + 1, W) costs 0 to ``scale`` of each offset; ``outside`` where the second image shows nothing."""
    a, b, missing = normalised(first), normalised(second), ~np.isfinite(second)
    (height, width), half = first.shape, np.float32(scale / 2)
    volume = np.empty((height, span + 1, width), dtype=np.uint8)
    for top in range(0, height, _ROWS):
        rows = slice(top, min(top + _ROWS, height))
        own, other = (features_of_rows(image, rows.start, rows.stop) for image in (a, b))
        own *= -half
        own = np.stack([cv2.transpose(own[:, row]) for row in range(own.shape[1])])
        other = np.ascontiguousarray(other.transpose(1, 0, 2))
        for left in range(0, width, _BLOCK):
            right = min(left + _BLOCK, width)
            product = np.matmul(own[:, left:right], other[:, :, left : right + span])
            costs = np.add(product, half + np.float32(0.5)).astype(np.uint8)
            along, down, across = costs.strides
            shape = len(costs), span + 1, right - left
            band = as_strided(costs, shape, (along, across, down + across))
            unseen = missing[rows, left : right + span]
            if unseen.any():
                unseen = as_strided(unseen, shape, (unseen.strides[0], 1, 1))
                band = np.where(unseen, outside, band)
            volume[rows, :, left:right] = band
    return volume


def _penalties(image: FloatImage, least: int, most: float, contrast: float) -> Penalties:
    """A function that gives the penalties (H, W) of jumps on paths that come from the pixel so many rows above and
    columns to the left: less where the image has an edge on the way, but not below ``least``."""
    values = known_or_zero(image)

    def from_pixel(above: int, left: int) -> ByteImage:
        step = np.abs(values - np.roll(values, (above, left), (0, 1)))
        found: ByteImage = np.maximum(most / (1 + step / np.float32(contrast)), least).astype(np.uint8)
        return found

    return from_pixel


def _moved_on(
    before: ByteImage, cost: ByteImage, one: np.uint8, two: ByteImage, out: ByteImage, spare: ByteImage
) -> ByteImage:
    """``out`` (D, N): the costs of paths at their next pixels, less the least one before; all of them bytes."""
    least = np.minimum.reduce(before, axis=0)
    np.add(before, one, out=spare)
    np.minimum(before, least + two, out=out)
    np.minimum(out[1:], spare[:-1], out=out[1:])
    np.minimum(out[:-1], spare[1:], out=out[:-1])
    out -= least
    out += cost
    return out


def _along_rows(volume: ByteImage, one: np.uint8, jump: Penalties) -> Sums:
    """(H, D, W) sums of the two paths along rows."""
    total = np.empty(volume.shape, dtype=np.uint16)
    count, width = volume.shape[1:]
    jumps = [jump(0, side) for side in (1, -1)]
    for top in range(0, len(volume), _ROWS):
        rows = slice(top, min(top + _ROWS, len(volume)))
        # Transposed: paths of all rows move on together.
        part = cv2.transpose(volume[rows].transpose(1, 0, 2).reshape(-1, width)).reshape(width, count, -1)
        sums, spare = np.zeros(part.shape, dtype=np.uint16), np.empty_like(part[0])
        for order, two in zip((range(width), range(width - 1, -1, -1)), jumps):
            two = np.ascontiguousarray(two[rows].T)
            before, states = part[order[0]], (np.empty_like(spare), np.empty_like(spare))
            sums[order[0]] += before
            for column in order[1:]:
                before = _moved_on(before, part[column], one, two[column], states[column & 1], spare)
                sums[column] += before
        total[rows] = cv2.transpose(sums.reshape(width, -1)).reshape(count, -1, width).transpose(1, 0, 2)
    return total


_DIAGONALS: Tuple[Tuple[slice, slice, int], ...] = (
    (slice(1, None), slice(None, -1), 0),
    (slice(None, -1), slice(1, None), -1),
)


def _along_columns(volume: ByteImage, total: Sums, order: range, one: np.uint8, jump: Penalties) -> Iterator[int]:
    """Add the three paths that come from the row before to the sums, row after row; gives each row that is done."""
    jumps = [jump(order.step, left) for left in (0, 1, -1)]
    states = np.empty((3, 2, *volume.shape[1:]), dtype=np.uint8)
    moved, spare = np.empty_like(volume[0]), np.empty_like(volume[0])
    before = [volume[order[0]]] * 3
    for row in order:
        if row == order[0]:
            total[row] += np.uint16(3) * volume[row]
        else:
            for number in range(3):
                source = before[number]
                if number:
                    to, of, edge = _DIAGONALS[number - 1]
                    moved[:, to], moved[:, edge] = source[:, of], source[:, edge]
                    source = moved
                out = states[number, row & 1]
                before[number] = _moved_on(source, volume[row], one, jumps[number][row], out, spare)
                total[row] += out
        yield row


def _chosen(volume: ByteImage, total: Sums, rows: Iterator[int], scale: int) -> Winners:
    """The winners of rows as soon as their sums are complete."""
    height, count, width = volume.shape
    columns, wide = np.arange(width), np.full((count, width + count - 1), _NEVER)
    along, across = wide.strides
    seen_from_second = as_strided(wide, (count, width), (along + across, across))
    first, margin, lead, cost = (np.empty((height, width), dtype=np.float32) for _ in range(4))
    second = np.empty((height, width + count - 1), dtype=np.int64)
    for row in rows:
        sums = total[row]
        best = sums.argmin(axis=0)
        least = sums[best, columns]
        first[row] = best + _vertex(sums, best, columns)
        lead[row] = sums.mean(axis=0, dtype=np.float32) - least
        cost[row] = volume[row][best, columns]
        seen_from_second[:] = sums
        second[row] = wide.argmin(axis=0)
        for beside in range(-2, 3):  # the sums of this row are not needed any more
            sums[np.clip(best + beside, 0, count - 1), columns] = _NEVER
        margin[row] = np.minimum(sums.min(axis=0), np.uint16(_PATHS * _BYTE)) - least
    of_paths = np.float32(1 / (_PATHS * scale))
    return Winners(first, second, margin * of_paths, lead * of_paths, cost * np.float32(1 / scale))


def _vertex(sums: Sums, best: IntArray, columns: IntArray) -> FloatImage:
    """(W,) px from the best offset to the vertex of a parabola through it and its neighbours."""
    inner = np.clip(best, 1, len(sums) - 2)
    before, least, after = (sums[inner + beside, columns].astype(np.float32) for beside in (-1, 0, 1))
    curve = np.maximum(before + after - 2 * least, np.float32(1))
    found: FloatImage = np.clip((before - after) / (2 * curve), np.float32(-0.5), np.float32(0.5))
    return np.where(inner == best, found, np.float32(0))
