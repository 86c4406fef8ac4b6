"""Lay a DSM onto a reference: by height only, by whole cells, or by a shift in three dimensions.

**Sign.** ``dx, dy, dz`` are what to *add* to the DSM's coordinates so that it lies on the reference: metres to the
east, to the north, and up. A DSM that lies 2 m too far east and 1 m too high gives (-2, 0, -1).

The 3-D shift follows Nuth and Kääb (2011, The Cryosphere 5): where a surface with gradient g is displaced by s, its
heights differ by g·s, and a least-squares solution for s gives steep cells their weight. That holds only for small
parts of a cell on surfaces with edges, such as cities. Three steps are therefore added: first a search by whole cells
from coarse to fine; robust weights, which exclude cells whose difference is no small shift; and a last search that
minimises the mean truncated absolute difference directly. Both surfaces are smoothed in the same way before, so that
shifts by part of a cell (which smooth, too) are not preferred.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Dict, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Floats, IntArray
from ..contracts.errors import EmptyResultError
from ..imagery.sampling import mean_of_known
from ..numerics.robust import nmad, tukey
from .parameters import COREGISTRATION, CoregistrationParameters

Patch = Tuple[Floats, Floats]
"""DSM and reference on the same cells, (rows, columns) each, row 0 in the north, NaN = no height."""
Check = Callable[[], None]
"""A function that is called between steps, and may raise an exception to stop."""

_KERNEL = np.array([1, 4, 6, 4, 1]) / 16.0


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

    def applied(self, dsm: Floats, cell: Tuple[float, float]) -> FloatImage:
        """A DSM with cells of this width and height (m), moved; NaN where no cell is moved to."""
        return shifted(dsm, self.dx / cell[0], -self.dy / cell[1]) + np.float32(self.dz)


def align(
    method: str,
    patches: Sequence[Patch],
    cell: Tuple[float, float],
    check: Check = lambda: None,
    parameters: CoregistrationParameters = COREGISTRATION,
) -> Alignment:
    """The shift of the DSM onto the reference.

    Parameters
    ----------
    method : "none"; "vertical", by the median difference; "cells", by whole cells and the median; "3d".
    patches : parts of both surfaces on the reference's grid; all have one common shift. For "3d" a patch should be at
        least 100 cells wide; shifts up to 32 cells (or a quarter of the patch) are found.
    cell : width and height of a cell in metres.

    Raises EmptyResultError where too few cells overlap, or where the relief does not determine a 3-D shift.
    """
    if method == "none":
        return Alignment("none")
    before = after = _differences(patches, np.zeros(2), parameters)
    shift = np.zeros(2)
    if method == "cells":
        shift = _best_whole(patches, np.zeros(2, int), parameters.whole_search, parameters).astype(float)
    elif method == "3d":
        whole = _coarse_search(patches, parameters, check)
        smooth = [(_smoothed(dsm), _smoothed(reference)) for dsm, reference in patches]
        shift = _polish(smooth, _nuth_kaab(smooth, whole, parameters, check), parameters, check)
    if method != "vertical":
        after = _differences(patches, shift, parameters)
    east, north, up = float(shift[0] * cell[0]), float(-shift[1] * cell[1]), -float(np.median(after))
    return Alignment(method, east, north, up, nmad(before), nmad(after), after.size)


def moved_by(
    method: str,
    patches: Sequence[Patch],
    cell: Tuple[float, float],
    shift_m: FloatArray,
    parameters: CoregistrationParameters = COREGISTRATION,
) -> Alignment:
    """The alignment of a shift (3,), metres to the east, to the north and up, that was found in another way."""
    before = _differences(patches, np.zeros(2), parameters)
    east, north, up = map(float, shift_m)
    after = _differences(patches, np.array([east / cell[0], -north / cell[1]]), parameters)
    return Alignment(method, east, north, up, nmad(before), nmad(after), after.size)


def shifted(array: Floats, columns: float, rows: float) -> Floats:
    """The surface displaced by a number of cells to the right and down, same shape, NaN where no cell came from.

    Cubic (Catmull-Rom) between cells; a cell is NaN where one of the cells with a weight in it is.
    """
    return _shifted_along(_shifted_along(array, columns, 1), rows, 0)


def _shifted_along(array: Floats, by: float, axis: int) -> Floats:
    whole = math.floor(by + 1e-9)
    t = by - whole
    if t < 1e-6:
        return _rolled(array, whole, axis)
    # out[i] = array[i - by]: between the cells i - whole - 1 and i - whole, at 1 - t from the former.
    u = 1.0 - t
    outer = (-u + 2 * u**2 - u**3) / 2, (u**3 - u**2) / 2
    weights = outer[0], (2 - 5 * u**2 + 3 * u**3) / 2, (u + 4 * u**2 - 3 * u**3) / 2, outer[1]
    result = np.zeros_like(array, dtype=np.float32)
    for offset, weight in zip((2, 1, 0, -1), weights):
        result += np.float32(weight) * _rolled(array, whole + offset, axis)
    return result


def _rolled(array: Floats, by: int, axis: int) -> Floats:
    if by == 0:
        return array
    result = np.full_like(array, np.nan, dtype=np.float32)
    n = array.shape[axis]
    if abs(by) >= n:
        return result
    to, source = (slice(by, None), slice(None, n - by)) if by > 0 else (slice(None, n + by), slice(-by, None))
    rest = (slice(None),) * axis
    result[(*rest, to)] = array[(*rest, source)]
    return result


def block_means(array: Floats, factor: int) -> FloatImage:
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


def _coarse_search(patches: Sequence[Patch], parameters: CoregistrationParameters, check: Check) -> FloatArray:
    """Columns and rows (right, down) by whole cells with the least NMAD of differences, coarse to fine."""
    smallest = min(min(reference.shape) for _, reference in patches)
    best, reach = np.zeros(2, int), min(parameters.search, smallest // 4)
    factor = 1
    while factor * 2 <= max(reach // 4, 1) and smallest // (factor * 2) >= parameters.coarsest:
        factor *= 2
    around = max(1, math.ceil(reach / factor))
    while factor >= 1:
        check()
        level = [(block_means(dsm, factor), block_means(reference, factor)) for dsm, reference in patches]
        centre = np.round(best / factor).astype(int)
        best = _best_whole(level, centre, around, parameters) * factor
        around, factor = parameters.fine_search, factor // 2
    return np.asarray(best, dtype=float)


def _best_whole(
    level: Sequence[Patch], centre: IntArray, around: int, parameters: CoregistrationParameters
) -> IntArray:
    """The whole cells (right, down) within ``around`` of a centre that give the least NMAD."""
    count = sum(np.isfinite(reference).sum() for _, reference in level)
    step = max(1, int(math.sqrt(count / parameters.differences)))
    enough = max(parameters.least_cells // 4, parameters.least_share * count / step**2)
    best, least = centre, math.inf
    for dc in range(centre[0] - around, centre[0] + around + 1):
        for dr in range(centre[1] - around, centre[1] + around + 1):
            difference = np.concatenate([_thinned(dsm, reference, dc, dr, step) for dsm, reference in level])
            if difference.size >= enough:
                spread = nmad(difference)
                if spread < least * (1 - 1e-9):
                    best, least = np.array([dc, dr]), spread
    return best


def _thinned(dsm: Floats, reference: Floats, dc: int, dr: int, step: int) -> Floats:
    """Differences at every ``step``-th cell, with the DSM displaced by whole cells."""
    rows, columns = reference.shape
    r0, r1, c0, c1 = max(dr, 0), rows + min(dr, 0), max(dc, 0), columns + min(dc, 0)
    if r0 >= r1 or c0 >= c1:
        return np.empty(0, np.float32)
    difference = dsm[r0 - dr : r1 - dr : step, c0 - dc : c1 - dc : step] - reference[r0:r1:step, c0:c1:step]
    known: Floats = difference[np.isfinite(difference)]
    return known


def _nuth_kaab(
    patches: Sequence[Patch], start: FloatArray, parameters: CoregistrationParameters, check: Check
) -> FloatArray:
    """Columns and rows by robust Gauss-Newton steps from ``start``; the gradient is the reference's, over its gaps too:
    stripes and single cells have none of their own."""
    gradients = [_gradient(_filled(reference)) for _, reference in patches]
    shift = start
    for _ in range(parameters.iterations):
        check()
        difference = [shifted(dsm, *shift) - reference for dsm, reference in patches]
        good = [np.isfinite(d) & np.isfinite(gx) & np.isfinite(gy) for d, (gx, gy) in zip(difference, gradients)]
        e = np.concatenate([d[ok] for d, ok in zip(difference, good)]).astype(float)
        _require_cells(e, parameters)
        slopes = [np.concatenate([g[i][ok] for g, ok in zip(gradients, good)]) for i in (0, 1)]
        step = _robust_step(np.column_stack([*slopes, np.ones(e.size)]).astype(float), e, parameters)
        shift = shift + np.clip(step, -parameters.most_step, parameters.most_step)
        if np.hypot(*step) < parameters.converged:
            break
    # Where the steps ran away from the minimum that the search had found, the last search goes on from there.
    return start if np.abs(shift - start).max() > parameters.most_drift else shift


def _robust_step(design: FloatArray, e: FloatArray, parameters: CoregistrationParameters) -> FloatArray:
    """Displacement right and down that explains the differences: e = -(g · step) + offset, with Tukey's weights."""
    solution = np.array([0.0, 0.0, float(np.median(e))])
    for _ in range(parameters.reweightings):
        residual = e - design @ solution
        scale = max(nmad(residual), 1e-4)
        weight = tukey(residual / (parameters.tukey * scale))
        weighted = design * weight[:, None]
        normal = weighted.T @ design
        _require_relief(normal, scale, e.size, parameters)
        solution = np.linalg.solve(normal, weighted.T @ e)
    return solution[:2]


def _require_relief(normal: FloatArray, scale: float, count: int, parameters: CoregistrationParameters) -> None:
    """Raise where the gradients do not determine a shift (flat ground, or one tilted plane)."""
    weight = max(normal[2, 2], 1e-12)
    mean = normal[:2, 2] / weight
    relief = float(np.linalg.eigvalsh(normal[:2, :2] / weight - np.outer(mean, mean))[0])
    independent = max(count / parameters.independent, 1.0)
    if relief < 1e-8 or scale / math.sqrt(relief * independent) > parameters.most_uncertain:
        slopes = f"its slopes vary by only {math.sqrt(max(relief, 0)):.2g} m per cell"
        raise EmptyResultError(
            f"The ground has too little relief for a 3-D alignment: {slopes}, and the noise is {scale:.2g} m in "
            f"{count} cells. Set ALIGN to vertical, or compare over a larger area."
        )


def _polish(
    patches: Sequence[Patch], start: FloatArray, parameters: CoregistrationParameters, check: Check
) -> FloatArray:
    """Pattern search of the least mean truncated absolute difference, down to 1/100 of a cell."""
    cap = max(parameters.cap_nmad * nmad(_known_differences(patches, start)), parameters.least_cap_m)
    done: Dict[Tuple[float, float], float] = {}

    def cost(at: Tuple[float, float]) -> float:
        if at not in done:
            check()
            d = _known_differences(patches, np.array(at))
            few = d.size < parameters.least_cells
            done[at] = math.inf if few else float(np.minimum(np.abs(d - np.median(d)), cap).mean())
        return done[at]

    at, step = (float(start[0]), float(start[1])), parameters.first_step
    while step > parameters.last_step:
        near = [(round(at[0] + i * step, 6), round(at[1] + j * step, 6)) for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        best = min(near, key=cost)
        at, step = (best, step) if cost(best) < cost(at) else (at, step / 2)
    return _vertex(cost, at, step * 4)


def _vertex(cost: Callable[[Tuple[float, float]], float], at: Tuple[float, float], step: float) -> FloatArray:
    """The lowest point of parabolas through three costs along each axis."""
    result, b = np.array(at), cost(at)
    for axis, (right, down) in enumerate(((step, 0.0), (0.0, step))):
        a, c = cost((at[0] - right, at[1] - down)), cost((at[0] + right, at[1] + down))
        if math.isfinite(a + b + c) and a + c - 2 * b > 0:
            result[axis] += float(np.clip(0.5 * (a - c) / (a + c - 2 * b), -1, 1)) * step
    return result


def _gradient(z: Floats) -> Tuple[Floats, Floats]:
    gx, gy = np.full_like(z, np.nan), np.full_like(z, np.nan)
    gx[:, 1:-1] = (z[:, 2:] - z[:, :-2]) / 2
    gy[1:-1] = (z[2:] - z[:-2]) / 2
    return gx, gy


def _smoothed(array: Floats) -> FloatImage:
    """Binomial 5 x 5 smoothing of the known cells; holes have no weight, so that no cells around them are lost."""
    mean, share = _binomial(array)
    good = np.isfinite(array)
    kept = good & (share > 0.5)
    if kept.sum() < 0.5 * good.sum():  # stripes or single cells: none has more of its window
        kept = good
    return np.where(kept, mean, np.nan).astype(np.float32)


def _filled(array: Floats) -> FloatImage:
    """The same surface, with its narrow gaps filled by means of the cells around."""
    mean, share = _binomial(array)
    return np.where(np.isfinite(array), array, np.where(share > 0, mean, np.nan)).astype(np.float32)


def _binomial(array: Floats) -> Tuple[FloatImage, FloatImage]:
    """Means of the known cells by binomial 5 x 5 weights, and the share of these weights."""
    z = np.asarray(array, np.float32)
    good = np.isfinite(z)
    level = np.float32(z[good].mean()) if good.any() else np.float32(0)
    mean, share = mean_of_known(z - level, good, lambda image: _convolved(_convolved(image, 0), 1), 1e-6)
    return mean + level, share


def _convolved(array: FloatImage, axis: int) -> FloatImage:
    padded = np.pad(array, [(2, 2) if i == axis else (0, 0) for i in (0, 1)])
    n, result = array.shape[axis], np.zeros_like(array)
    for i, weight in enumerate(_KERNEL):
        result = result + np.float32(weight) * (padded[i : i + n] if axis == 0 else padded[:, i : i + n])
    return result


def _known_differences(patches: Sequence[Patch], shift: FloatArray) -> Floats:
    """DSM less reference in all cells where both have a height, with the DSM displaced right and down."""
    parts = [shifted(dsm, float(shift[0]), float(shift[1])) - reference for dsm, reference in patches]
    return np.concatenate([part[np.isfinite(part)] for part in parts]) if parts else np.empty(0)


def _differences(patches: Sequence[Patch], shift: FloatArray, parameters: CoregistrationParameters) -> Floats:
    difference = _known_differences(patches, shift)
    _require_cells(difference, parameters)
    return difference


def _require_cells(difference: Floats, parameters: CoregistrationParameters) -> None:
    if difference.size < parameters.least_cells:
        few = f"Cells with a height in both the DSM and the reference: {difference.size}; an alignment"
        remedy = "choose a reference that covers more of the DSM or has smaller cells, or set ALIGN to none"
        raise EmptyResultError(f"{few} needs {parameters.least_cells}: {remedy}.")
