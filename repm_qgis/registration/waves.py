"""Waves of the attitude along the parallax, from a reference: they change heights and nothing else.

The differences of a reference from the height maps of all pairs are explained by a function of the line for each view,
as splines (pointing/jitter.py), beside one tilted plane. A wave of a view is the same wherever its lines lie in a map,
while errors of the reference are not: so waves of decimetres are found under noise of metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..geometry.jitter import ORDER, splines
from ..numerics.robust import nmad, tukey
from ..pointing.jitter import Waves
from ..pointing.parameters import POINTING, JitterParameters
from .parameters import REGISTRATION, WaveParameters

Ends = Tuple[float, float]


class MapDifferences(NamedTuple):
    """A reference minus the height map of two ``views``, at (N,) supports of the reference.

    ``lines`` are the lines of both images in which they lie, (N,) each, and ``metres`` the height that one px of a wave
    along the parallax adds, for each view. ``x``, ``y`` (N,) are places, ``value`` (N,) the differences, m.
    """

    views: Tuple[str, str]
    metres: Tuple[float, float]
    lines: Tuple[FloatArray, FloatArray]
    x: FloatArray
    y: FloatArray
    value: FloatArray


@dataclass(frozen=True)
class FoundWaves:
    """Coefficients (count,) px along the parallax for each view, between lines ``ends``; the NMAD of the differences
    without and with them, m; and the information criterion less that without waves."""

    coefficients: Dict[str, FloatArray]
    ends: Dict[str, Ends]
    before_m: float
    after_m: float
    criterion: float

    @property
    def largest_px(self) -> float:
        """A spline is nowhere larger than its coefficients."""
        return max(float(np.abs(each).max()) for each in self.coefficients.values())


def find_waves(
    differences: Sequence[MapDifferences],
    width_m: float,
    known: Optional[Tuple[Dict[str, Ends], int]] = None,
    parameters: WaveParameters = REGISTRATION.waves,
    jitter: JitterParameters = POINTING.jitter,
) -> Optional[FoundWaves]:
    """The waves that Schwarz's criterion prefers to none; None where it prefers none, and for too few differences.

    ``known`` are the ends and the number of the splines of waves that the views have already: the same ones are taken.
    Without them the number is the one with the smallest criterion. ``width_m`` is that of the reference's supports.
    """
    parts = [part for part in differences if len(part.value)]
    rows: Dict[str, List[FloatArray]] = {}
    for part in parts:
        for name, lines in zip(part.views, part.lines):
            rows.setdefault(name, []).append(lines)
    if not rows:
        return None
    shown = {name: np.concatenate(each) for name, each in rows.items()}
    if known is not None:
        tried = [known]
    else:
        ends = {name: (float(each.min()), float(each.max())) for name, each in shown.items()}
        span = max(last - first for first, last in ends.values())
        counts = {min(round(span / knots), jitter.most_intervals) for knots in jitter.knots_lines}
        tried = [(ends, n + ORDER - 1) for n in sorted(counts) if n >= jitter.least_intervals]
    found = []
    for ends, count in tried:
        if min(map(len, shown.values())) >= parameters.per_spline * count and set(shown) <= set(ends):
            found.append(_solved(parts, list(shown), ends, count, width_m, parameters, jitter))
    best = min(found, key=lambda each: each.criterion, default=None)
    return best if best is not None and best.criterion < 0 and best.largest_px > jitter.least_px else None


def _solved(
    parts: Sequence[MapDifferences],
    names: Sequence[str],
    ends: Dict[str, Ends],
    count: int,
    width_m: float,
    parameters: WaveParameters,
    jitter: JitterParameters,
) -> FoundWaves:
    """Least squares with Tukey's weights, and a prior of waves of usual size."""
    from scipy import sparse

    value, x, y = (np.concatenate([getattr(part, name) for part in parts]) for name in ("value", "x", "y"))
    plane = np.column_stack([np.ones(len(x)), (x - x.mean()) / 1e3, (y - y.mean()) / 1e3])
    waves = sparse.vstack([_design(part, names, ends, count) for part in parts]).tocsr()
    prior = np.kron(np.eye(len(names)), Waves((), count).prior(jitter))
    p = len(prior)
    spread = parameters.first_spread
    without = _robust(plane, value, parameters)
    solution, weight = np.zeros(p + 3), without[1]
    design = sparse.hstack([waves, sparse.csr_matrix(plane)]).tocsr()
    full = np.zeros((p + 3, p + 3))
    full[:p, :p] = prior
    for _ in range(parameters.iterations):
        residual = value - design @ solution
        sigma = max(nmad(residual), parameters.least_noise_m)
        spread = _spread(residual, weight, x, y, width_m, parameters)
        weight = _weight(residual, sigma, parameters)
        scaled = design.T @ sparse.diags(weight / (spread * sigma**2))
        normal = np.asarray((scaled @ design).todense())
        solution = np.linalg.solve(normal + full, np.asarray(scaled @ value).ravel())
    residual = value - design @ solution
    free = float(p - np.trace(np.linalg.solve(normal + full, full)[:p, :p]))
    independent = max(len(value) / spread, 2.0)
    limit = parameters.limit * nmad(without[0])
    square = [float(np.mean(np.minimum(each**2, limit**2))) for each in (without[0], residual)]
    criterion = independent * math.log(square[1] / square[0]) + free * math.log(independent)
    coefficients = {name: solution[k * count : (k + 1) * count] for k, name in enumerate(names)}
    used = {name: ends[name] for name in names}
    return FoundWaves(coefficients, used, float(nmad(without[0])), float(nmad(residual)), criterion)


def _design(part: MapDifferences, names: Sequence[str], ends: Dict[str, Ends], count: int) -> Any:
    """The sparse (N, views count) derivatives of a map's heights by the splines' coefficients."""
    from scipy import sparse

    size, blocks = len(part.value), []
    for name, metres, lines in zip(part.views, part.metres, part.lines):
        first, weights = splines(lines, ends[name], count)
        columns = names.index(name) * count + first[:, None] + np.arange(ORDER)
        rows = np.repeat(np.arange(size), ORDER)
        shape = size, len(names) * count
        blocks.append(sparse.csr_matrix(((metres * weights).ravel(), (rows, columns.ravel())), shape))
    return blocks[0] + blocks[1]


def _robust(design: FloatArray, value: FloatArray, parameters: WaveParameters) -> Tuple[FloatArray, FloatArray]:
    """(N,) residuals of a robust fit, and its weights."""
    solution, weight = np.zeros(design.shape[1]), np.ones(len(value))
    for _ in range(parameters.iterations):
        residual = value - design @ solution
        weight = _weight(residual, max(nmad(residual), parameters.least_noise_m), parameters)
        scaled = design.T * weight
        solution = np.linalg.solve(scaled @ design, scaled @ value)
    return value - design @ solution, weight


def _weight(residual: FloatArray, sigma: float, parameters: WaveParameters) -> FloatArray:
    middle = float(np.median(residual))
    return tukey((residual - middle) / (parameters.tukey * sigma))


def _spread(
    residual: FloatArray, weight: FloatArray, x: FloatArray, y: FloatArray, width_m: float, parameters: WaveParameters
) -> float:
    """How many differences count as one independent one: errors of neighbours, and of maps of one place, are
    alike. The variance of the means of blocks, over what it would be."""
    side = parameters.block_widths * width_m
    column, row = ((np.floor((each - each.min()) / side)).astype(np.intp) for each in (x, y))
    block = row * (int(column.max()) + 1) + column
    total, sums = np.bincount(block, weight), np.bincount(block, weight * residual)
    enough = total > parameters.block_widths
    if enough.sum() < parameters.least_blocks:
        return parameters.first_spread
    means, sigma = sums[enough] / total[enough], max(nmad(residual), parameters.least_noise_m)
    alike = float(np.median(total[enough]) * nmad(means, 0.0) ** 2 / sigma**2)
    return max(alike, 1.0)
