"""Lay a DSM onto a reference: by height only, or by a shift in three dimensions.

**Sign.** ``dx, dy, dz`` are what to *add* to the DSM's coordinates so that it lies on the reference: metres to the
east, to the north, and up. A DSM that lies 2 m too far east and 1 m too high gives (-2, 0, -1).

The 3-D shift follows Nuth and Kääb (2011, The Cryosphere 5): where a surface with gradient g is displaced by s, its
heights differ by g·s; solving for s by least squares weighs cells by slope by itself. Three things are added for
surfaces with edges, such as cities, where that holds for a fraction of a cell only: a search by whole cells from
coarse to fine comes first, cells whose difference is no small shift are left out robustly, and a last search
minimises the mean truncated absolute difference directly. Both surfaces are smoothed alike before, so that shifts by
part of a cell (which smooth, too) are not preferred.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, List, Sequence, Tuple

import numpy as np

from ..errors import EmptyResultError
from ..imagery.sampling import mean_of_known
from .metrics import NMAD_FACTOR

Patch = Tuple[np.ndarray, np.ndarray]
"""DSM and reference on the same cells, (rows, columns) each, row 0 in the north, NaN = no height."""

MIN_CELLS = 100
_SEARCH_CELLS = 32  # the coarse search reaches this far
_KERNEL = np.array([1, 4, 6, 4, 1]) / 16.0
_ITERATIONS = 15


@dataclass(frozen=True)
class Alignment:
    """What to add to the DSM (metres east, north, up), and the NMAD (m) on the sampled cells before and after."""

    method: str
    dx: float = 0.0
    dy: float = 0.0
    dz: float = 0.0
    nmad_before: float = math.nan
    nmad_after: float = math.nan
    cells: int = 0
    iterations: int = 0


def align_vertical(patches: Sequence[Patch]) -> Alignment:
    """The median height difference. Raises EmptyResultError where fewer than 100 cells can be compared."""
    difference = _differences(patches)
    _enough(difference)
    return Alignment(
        "vertical",
        dz=-float(np.median(difference)),
        nmad_before=_nmad(difference),
        nmad_after=_nmad(difference),
        cells=difference.size,
    )


def align_3d(
    patches: Sequence[Patch], cell: Tuple[float, float], check: Callable[[], None] = lambda: None
) -> Alignment:
    """The shift in three dimensions that lays the DSM onto the reference.

    Parameters
    ----------
    patches : parts of both surfaces on the reference's grid; all have one common shift. A patch should be at least
        100 cells wide; shifts up to 32 cells (or a quarter of the patch) are found.
    cell : width and height of a cell in metres.
    check : called between steps; may raise to stop.

    Raises EmptyResultError where too few cells overlap, or where the ground has too little relief to tell.
    """
    before = _differences(patches)
    _enough(before)
    whole = _coarse_search(patches, check)
    smooth = [(_smoothed(dsm), _smoothed(reference)) for dsm, reference in patches]
    shift, iterations = _nuth_kaab(smooth, whole, check)
    shift = _polish(smooth, shift, check)
    after = np.concatenate([_difference(dsm, reference, shift) for dsm, reference in patches])
    _enough(after)
    return Alignment(
        "3d",
        dx=float(shift[0] * cell[0]),
        dy=float(-shift[1] * cell[1]),
        dz=-float(np.median(after)),
        nmad_before=_nmad(before),
        nmad_after=_nmad(after),
        cells=after.size,
        iterations=iterations,
    )


def moved(array: np.ndarray, columns: float, rows: float) -> np.ndarray:
    """The surface displaced by a number of cells to the right and down, same shape, NaN where nothing came from.

    Cubic (Catmull-Rom) between cells; a cell is NaN where one of the cells with a weight in it is.
    """
    return _moved_along(_moved_along(array, columns, 1), rows, 0)


def _moved_along(array: np.ndarray, by: float, axis: int) -> np.ndarray:
    whole = math.floor(by + 1e-9)
    t = by - whole
    if t < 1e-6:
        return _rolled(array, whole, axis)
    # out[i] = array[i - by]: between the cells i - whole - 1 and i - whole, at 1 - t from the former.
    u = 1.0 - t
    weights = (
        (-u + 2 * u**2 - u**3) / 2,
        (2 - 5 * u**2 + 3 * u**3) / 2,
        (u + 4 * u**2 - 3 * u**3) / 2,
        (u**3 - u**2) / 2,
    )
    result = np.zeros_like(array, dtype=np.float32)
    for offset, weight in zip((2, 1, 0, -1), weights):
        result += np.float32(weight) * _rolled(array, whole + offset, axis)
    return result


def _rolled(array: np.ndarray, by: int, axis: int) -> np.ndarray:
    if by == 0:
        return array
    result = np.full_like(array, np.nan, dtype=np.float32)
    n = array.shape[axis]
    if abs(by) >= n:
        return result
    to, source = (slice(by, None), slice(None, n - by)) if by > 0 else (slice(None, n + by), slice(-by, None))
    if axis == 0:
        result[to] = array[source]
    else:
        result[:, to] = array[:, source]
    return result


def shrunk(array: np.ndarray, factor: int) -> np.ndarray:
    """Means of blocks of factor x factor cells; NaN where fewer than half of a block's cells have a value."""
    if factor <= 1:
        return np.asarray(array, np.float32)
    rows, columns = (-(-n // factor) for n in array.shape)
    padded = np.full((rows * factor, columns * factor), np.nan, np.float32)
    padded[: array.shape[0], : array.shape[1]] = array
    blocks = padded.reshape(rows, factor, columns, factor)
    count = np.isfinite(blocks).sum(axis=(1, 3))
    total = np.nansum(blocks, axis=(1, 3), dtype=np.float64)
    enough = count * 2 >= factor * factor
    return np.where(enough, total / np.maximum(count, 1), np.nan).astype(np.float32)


def _coarse_search(patches: Sequence[Patch], check: Callable[[], None]) -> np.ndarray:
    """Columns and rows (right, down) by whole cells with the least NMAD of differences, coarse to fine."""
    smallest = min(min(reference.shape) for _, reference in patches)
    best, reach = np.zeros(2, int), min(_SEARCH_CELLS, smallest // 4)
    factor = 1
    while factor * 2 <= max(reach // 4, 1) and smallest // (factor * 2) >= 24:
        factor *= 2
    around = max(1, math.ceil(reach / factor))
    while factor >= 1:
        check()
        level = [(shrunk(dsm, factor), shrunk(reference, factor)) for dsm, reference in patches]
        centre = np.round(best / factor).astype(int)
        best = _best_whole(level, centre, around) * factor
        around, factor = 2, factor // 2
    return best.astype(float)


def _best_whole(level: Sequence[Patch], centre: np.ndarray, around: int) -> np.ndarray:
    count = sum(np.isfinite(reference).sum() for _, reference in level)
    step = max(1, int(math.sqrt(count / 200_000)))  # so many differences are plenty for one NMAD
    best, least = centre, math.inf
    for dc in range(centre[0] - around, centre[0] + around + 1):
        for dr in range(centre[1] - around, centre[1] + around + 1):
            parts = [_thin(dsm, reference, dc, dr, step) for dsm, reference in level]
            difference = np.concatenate(parts)
            if difference.size < max(MIN_CELLS // 4, 0.2 * count / step**2):
                continue
            spread = _nmad(difference)
            if spread < least * (1 - 1e-9):
                best, least = np.array([dc, dr]), spread
    return best


def _thin(dsm: np.ndarray, reference: np.ndarray, dc: int, dr: int, step: int) -> np.ndarray:
    rows, columns = reference.shape
    r0, r1, c0, c1 = max(dr, 0), rows + min(dr, 0), max(dc, 0), columns + min(dc, 0)
    if r0 >= r1 or c0 >= c1:
        return np.empty(0, np.float32)
    difference = dsm[r0 - dr : r1 - dr : step, c0 - dc : c1 - dc : step] - reference[r0:r1:step, c0:c1:step]
    return difference[np.isfinite(difference)]


def _nuth_kaab(patches: Sequence[Patch], start: np.ndarray, check: Callable[[], None]) -> Tuple[np.ndarray, int]:
    """Columns and rows by robust Gauss-Newton steps from ``start``; the gradient is the reference's."""
    gradients = [_gradient(reference) for _, reference in patches]
    shift, iterations = start.astype(float), 0
    while iterations < _ITERATIONS:
        iterations += 1
        check()
        difference = [moved(dsm, *shift) - reference for dsm, reference in patches]
        good = [np.isfinite(d) & np.isfinite(gx) & np.isfinite(gy) for d, (gx, gy) in zip(difference, gradients)]
        e = np.concatenate([d[ok] for d, ok in zip(difference, good)]).astype(float)
        _enough(e)
        design = np.column_stack(
            [np.concatenate([g[i][ok] for g, ok in zip(gradients, good)]) for i in (0, 1)] + [np.ones(e.size)]
        ).astype(float)
        step = _robust_step(design, e)
        shift = shift + np.clip(step, -1.0, 1.0)
        if np.hypot(*step) < 0.002:
            break
    if np.abs(shift - start).max() > 3.0:
        shift = start.astype(float)  # ran away from the minimum that the search had found: let the last search go on
    return shift, iterations


def _robust_step(design: np.ndarray, e: np.ndarray) -> np.ndarray:
    """Displacement right and down that explains the differences: e = -(g · step) + offset, with Tukey's weights."""
    solution = np.array([0.0, 0.0, float(np.median(e))])
    for _ in range(4):
        residual = e - design @ solution
        scale = max(_nmad(residual), 1e-4)
        weight = np.clip(1 - (residual / (4.685 * scale)) ** 2, 0, None) ** 2
        weighted = design * weight[:, None]
        normal = weighted.T @ design
        _check_relief(normal, scale, e.size)
        solution = np.linalg.solve(normal, weighted.T @ e)
    return solution[:2]


def _check_relief(normal: np.ndarray, scale: float, count: int) -> None:
    """Raise where the gradients cannot fix a shift to half a cell (flat ground, or one tilted plane)."""
    weight = max(normal[2, 2], 1e-12)
    mean = normal[:2, 2] / weight
    relief = float(np.linalg.eigvalsh(normal[:2, :2] / weight - np.outer(mean, mean))[0])
    independent = max(count / 25.0, 1.0)  # neighbouring cells err alike
    if relief < 1e-8 or scale / math.sqrt(relief * independent) > 0.5:
        raise EmptyResultError(
            f"The ground has too little relief for a 3-D alignment: its slopes vary by "
            f"{math.sqrt(max(relief, 0)):.2g} m a cell only, against {scale:.2g} m noise in {count} "
            "cells; set ALIGN to vertical, or compare over a larger area."
        )


def _polish(patches: Sequence[Patch], start: np.ndarray, check: Callable[[], None]) -> np.ndarray:
    """Pattern search of the least mean truncated absolute difference, down to 1/100 of a cell."""
    first = np.concatenate([_difference(dsm, reference, start) for dsm, reference in patches])
    cap = max(3.0 * _nmad(first), 0.05)
    done: dict = {}

    def cost(at: Tuple[float, float]) -> float:
        if at not in done:
            check()
            d = np.concatenate([_difference(dsm, reference, np.array(at)) for dsm, reference in patches])
            done[at] = float(np.minimum(np.abs(d - np.median(d)), cap).mean()) if d.size >= MIN_CELLS else math.inf
        return done[at]

    at, step = (float(start[0]), float(start[1])), 0.32
    while step > 0.009:
        near = [(round(at[0] + i * step, 6), round(at[1] + j * step, 6)) for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        best = min(near, key=cost)
        at, step = (best, step) if cost(best) < cost(at) else (at, step / 2)
    return _vertex(cost, at, step * 4)


def _vertex(cost: Callable[[Tuple[float, float]], float], at: Tuple[float, float], step: float) -> np.ndarray:
    """The lowest point of parabolas through three costs along each axis."""
    result = np.array(at)
    for axis in (0, 1):
        low, high = list(at), list(at)
        low[axis] -= step
        high[axis] += step
        a, b, c = cost(tuple(low)), cost(at), cost(tuple(high))
        if math.isfinite(a + b + c) and a + c - 2 * b > 0:
            result[axis] += float(np.clip(0.5 * (a - c) / (a + c - 2 * b), -1, 1)) * step
    return result


def _gradient(z: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    gx, gy = np.full_like(z, np.nan), np.full_like(z, np.nan)
    gx[:, 1:-1] = (z[:, 2:] - z[:, :-2]) / 2
    gy[1:-1] = (z[2:] - z[:-2]) / 2
    return gx, gy


def _smoothed(array: np.ndarray) -> np.ndarray:
    """Binomial 5 x 5 smoothing; NaN within two cells of a hole would lose much, so holes weigh nothing instead."""
    z = np.asarray(array, np.float32)
    good = np.isfinite(z)
    level = np.float32(z[good].mean()) if good.any() else np.float32(0)
    mean, share = mean_of_known(z - level, good, lambda image: _convolved(_convolved(image, 0), 1), 1e-6)
    return np.where(good & (share > 0.5), mean + level, np.nan).astype(np.float32)


def _convolved(array: np.ndarray, axis: int) -> np.ndarray:
    pad = [(2, 2) if i == axis else (0, 0) for i in (0, 1)]
    padded = np.pad(array, pad)
    n = array.shape[axis]
    parts: List[np.ndarray] = [padded[i : i + n] if axis == 0 else padded[:, i : i + n] for i in range(5)]
    return sum((np.float32(w) * part for w, part in zip(_KERNEL, parts)), np.zeros_like(array))


def _difference(dsm: np.ndarray, reference: np.ndarray, shift: np.ndarray) -> np.ndarray:
    difference = moved(dsm, float(shift[0]), float(shift[1])) - reference
    return difference[np.isfinite(difference)]


def _differences(patches: Sequence[Patch]) -> np.ndarray:
    parts = [dsm - reference for dsm, reference in patches]
    return np.concatenate([part[np.isfinite(part)] for part in parts]) if parts else np.empty(0)


def _nmad(values: np.ndarray) -> float:
    if values.size == 0:
        return math.inf
    return NMAD_FACTOR * float(np.median(np.abs(values - np.median(values))))


def _enough(difference: np.ndarray) -> None:
    if difference.size < MIN_CELLS:
        raise EmptyResultError(
            f"Only {difference.size} cells have a height in both the DSM and the reference, and an "
            f"alignment needs {MIN_CELLS}: choose a reference that covers more of the DSM."
        )
