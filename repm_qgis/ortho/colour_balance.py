"""Gains and offsets that make the colours of all views and dates equal: solved together, band by band.

For each two views, quantiles of their colours at the places that both see must become equal. Quantiles and not single
places: shadows, cars and pointing errors move single places, and would draw a regression's slope towards zero. A prior
of no change determines what the overlaps leave open, as in Brown and Lowe 2007 (Automatic Panoramic Image Stitching
using Invariant Features, IJCV 74, section 6, gain compensation), and the mean of all gains is one, that of all offsets
zero: without that, the smallest contrast would fit best.
"""

from __future__ import annotations

from itertools import combinations
from typing import Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage
from .parameters import ORTHO, BalanceParameters


def balanced(samples: FloatImage, parameters: BalanceParameters = ORTHO.balance) -> Tuple[FloatArray, FloatArray]:
    """(views, bands) gains and offsets of (N, views, bands) colours at places, NaN where a view does not see one."""
    views, bands = samples.shape[1:]
    gains, offsets = np.ones((views, bands)), np.zeros((views, bands))
    for band in range(bands):
        gains[:, band], offsets[:, band] = _of_band(samples[:, :, band].astype(np.float64), parameters)
    return gains, offsets


def contrasts(samples: FloatImage) -> FloatArray:
    """(bands,) the standard deviation of each band's colours, 1 where there is none: the unit of differences."""
    with np.errstate(invalid="ignore"):
        flat = samples.reshape(-1, samples.shape[2])
        known = flat[np.isfinite(flat).all(axis=1)]
    if len(known) < 2:
        return np.ones(samples.shape[2])
    spread: FloatArray = known.astype(np.float64).std(axis=0)
    return np.where(spread > 0, spread, 1.0)


def _of_band(values: FloatArray, parameters: BalanceParameters) -> Tuple[FloatArray, FloatArray]:
    count = values.shape[1]
    known = np.isfinite(values)
    if count < 2 or not known.any():
        return np.ones(count), np.zeros(count)
    middle, scale = float(np.median(values[known])), max(float(np.std(values[known])), 1e-9)
    scaled = (values - middle) / scale
    rows, targets = [], []
    for first, second in combinations(range(count), 2):
        both = known[:, first] & known[:, second]
        if both.sum() < parameters.least_common:
            continue
        weight = np.sqrt(both.sum() / len(values) / len(parameters.quantiles))
        ends = (np.quantile(scaled[both, view], parameters.quantiles) for view in (first, second))
        for one, other in zip(*ends):
            row = np.zeros(2 * count)
            row[[first, count + first]], row[[second, count + second]] = (one, 1.0), (-other, -1.0)
            rows.append(weight * row)
            targets.append(0.0)
    pull = np.sqrt(parameters.pull)
    for view in range(2 * count):
        row = np.zeros(2 * count)
        row[view] = pull
        rows.append(row)
        targets.append(pull if view < count else 0.0)
    for part in (slice(0, count), slice(count, 2 * count)):
        row = np.zeros(2 * count)
        row[part] = parameters.mean
        rows.append(row)
        targets.append(parameters.mean * count if part.start == 0 else 0.0)
    solution = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0]
    gain = np.clip(solution[:count], 1.0 / parameters.largest_gain, parameters.largest_gain)
    # Of values as they are: gain * (value - middle) + offset * scale + middle.
    return gain, solution[count:] * scale + middle * (1.0 - gain)
