"""Steps, ranks and covariances of every registration: one place, so that none drops what heights determine.

**Ranks.** Unknowns are metres and slopes, and a reference may not determine some of them. A pseudo-inverse mixes them
there: it spreads a height that is well determined over a position that is not, and calls the result exact. So each
normal matrix gets a weak prior, which is that of Tikhonov (1963) and Levenberg (1944): what the heights determine they
determine as without it, and the rest keeps its value, with the prior's deviation.

**Covariances.** A solution is an M-estimate, whose covariance is Huber's sandwich (1967) of the slope of its equations
and of the variance of their right-hand side. Errors of neighbouring heights are alike; see :func:`sandwich`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np

from ..contracts.arrays import FloatArray, IntArray
from .parameters import RegistrationParameters

WEAK = np.array([1e4, 1e4, 1e4, 10.0, 10.0])
"""Standard deviations of the weak prior of a shift (m) and of a tilt (m per m): far beyond what is looked for."""

_ROWS = 512  # of pairs' distances that are computed at once


def weak_information(basis: FloatArray) -> FloatArray:
    """(k, k) the information that the weak prior has of the unknowns (5, k) ``basis``."""
    return np.asarray(basis.T @ (basis / WEAK[:, None] ** 2))


def step(normal: FloatArray, right: FloatArray, basis: FloatArray) -> FloatArray:
    """(5,) the step of the unknowns: (k, k) normal matrix, with instruments perhaps not symmetric, and (k,) right-hand
    side of the unknowns ``basis`` (5, k)."""
    return np.asarray(basis @ np.linalg.solve(normal + weak_information(basis), right))


def sandwich(normal: FloatArray, middle: FloatArray, basis: FloatArray) -> FloatArray:
    """(5, 5) the covariance: ``normal`` (k, k) is the slope of the equations, ``middle`` the variance of their
    right-hand side, of the unknowns ``basis`` (5, k). What is not determined has the weak prior's variance.

    As the inverse of an information, that of Godambe (1960) and the prior's, which is never singular.
    """
    scale = np.sqrt(np.maximum(np.diag(middle), 1e-300))
    known = np.linalg.pinv(middle / np.outer(scale, scale), rcond=1e-10, hermitian=True) / np.outer(scale, scale)
    return np.asarray(basis @ np.linalg.inv(normal.T @ known @ normal + weak_information(basis)) @ basis.T)


def deviations_of(information: FloatArray) -> FloatArray:
    """(3,) standard deviations of a shift of (3, 3) information, m: the weak prior's of what it does not determine."""
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information + np.diag(WEAK[:3] ** -2.0)))))


def split(information: FloatArray, scale: FloatArray) -> Tuple[FloatArray, FloatArray]:
    """The covariance (n, n) of what an (n, n) information determines, and the projector (n, n) onto the rest.

    A direction counts as determined where it is by a hundred times its ``scale`` (n,), the size of its unknowns: a
    slope of 1e-6 and a height of a metre then compare. Rounding determines nothing.
    """
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    known = values > max(1e-4, 1e-13 * float(values[-1]))
    vectors_m = vectors * scale[:, None]
    free = np.linalg.qr(vectors_m[:, ~known])[0]
    return np.asarray((vectors_m[:, known] / values[known]) @ vectors_m[:, known].T), np.asarray(free @ free.T)


def correlated_sum(scores: FloatArray, place: FloatArray, correlation: Correlation, lattice: int) -> FloatArray:
    """(k, k) sum over all pairs of scores, s_i s_j' ρ(distance).

    Scores are summed in the cells of a lattice, and the pairs of cells by Fourier transforms. All within a cell
    count as being in one place, which makes the sum rather too large.
    """
    low, side = place.min(axis=0), float(np.ptp(place, axis=0).max())
    cell = max(side / lattice, 1e-6)
    column, row = np.floor((place - low) / cell).astype(int).T
    shape = int(row.max()) + 1, int(column.max()) + 1
    index, padded = row * shape[1] + column, (2 * shape[0], 2 * shape[1])
    down, right = (np.minimum(np.arange(n), n - np.arange(n)) * cell for n in padded)
    spectrum = np.fft.rfft2(correlation.at(np.hypot(down[:, None], right[None, :])))
    sums = [np.bincount(index, column, shape[0] * shape[1]).reshape(shape) for column in scores.T]
    smeared = [np.fft.irfft2(np.fft.rfft2(each, padded) * spectrum, padded)[: shape[0], : shape[1]] for each in sums]
    apart = np.array([[float((a * b).sum()) for b in smeared] for a in sums])
    alone = 1.0 - float(correlation.at(np.zeros(1))[0])  # what is each height's own
    return np.asarray(alone * scores.T @ scores + (apart + apart.T) / 2)


@dataclass(frozen=True)
class Correlation:
    """A sum of exponential and Gaussian functions of the distance, none negative: a valid correlation in the plane."""

    lengths_m: FloatArray
    exponential: FloatArray
    gaussian: FloatArray

    @classmethod
    def of(cls, values: FloatArray, place: FloatArray, parameters: RegistrationParameters) -> Correlation:
        """That of (N,) standardised differences at (N, 2) places by their distance, fitted to pairs of them."""
        p = parameters
        some = some_of(np.arange(len(values)), p.pairs, 0)
        r, place = values[some] - values[some].mean(), place[some]
        edges = p.reach * float(np.hypot(*np.ptp(place, axis=0))) * np.linspace(0, 1, p.lags + 1) ** 2
        total, count = np.zeros(p.lags), np.zeros(p.lags)
        for begin in range(0, len(some), _ROWS):
            rows = np.arange(begin, min(begin + _ROWS, len(some)))
            later = np.arange(len(some))[None, :] > rows[:, None]
            kind = np.digitize(_distances(place[rows], place)[later], edges) - 1
            inside = kind < p.lags
            product = (r[rows, None] * r[None, :])[later]
            total += np.bincount(kind[inside], product[inside], p.lags)
            count += np.bincount(kind[inside], minlength=p.lags)
        good = count > 0
        lags = ((edges[:-1] + edges[1:]) / 2)[good]
        return cls.fitted(lags, total[good] / count[good] / float(np.mean(r**2) or 1.0), count[good])

    @classmethod
    def fitted(cls, lags: FloatArray, values: FloatArray, counts: FloatArray) -> Correlation:
        """To values at distances, by non-negative least squares over lengths from the least to the largest lag."""
        from scipy.optimize import nnls

        if not len(lags):
            return cls(np.ones(1), np.zeros(1), np.zeros(1))
        lengths = np.geomspace(max(lags[0], 1e-6), max(lags[-1] / 2, 2 * lags[0], 1e-5), 12)
        zero = np.zeros(len(lengths))
        design = np.column_stack(
            [
                cls(lengths, exponential, gaussian).at(lags)
                for exponential, gaussian in (*((e, zero) for e in np.eye(12)), *((zero, e) for e in np.eye(12)))
            ]
        )
        weight = np.sqrt(counts)
        found = nnls(design * weight[:, None], values * weight)[0]
        found = found / max(found.sum(), 1.0)
        return cls(lengths, found[:12], found[12:])

    def at(self, distance: FloatArray) -> FloatArray:
        total = np.zeros(distance.shape)
        for length, a, b in zip(self.lengths_m, self.exponential, self.gaussian):
            if a:
                total += a * np.exp(-distance / length)
            if b:
                total += b * np.exp(-((distance / length) ** 2))
        return total

    @property
    def range_m(self) -> float:
        """Up to where the correlation is 1 / e."""
        at = np.linspace(0.0, 3.0 * float(self.lengths_m[-1]), 3000)
        above = np.nonzero(self.at(at) >= math.exp(-1))[0]
        return float(at[above[-1]]) if len(above) else 0.0


def some_of(numbers: IntArray, pairs: int, seed: int) -> IntArray:
    """So many of the numbers that they make about so many pairs."""
    most = int(math.sqrt(2 * pairs))
    if len(numbers) <= most:
        return numbers
    return np.sort(np.random.default_rng(seed).permutation(numbers)[:most])


def _distances(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1]))
