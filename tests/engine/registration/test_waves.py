"""Waves along the parallax from a reference's differences: found under its noise, and not where there are none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.geometry.jitter import ORDER, splines
from repm_qgis.registration.waves import MapDifferences, find_waves

SIDE, CELL = 120, 30.0  # a reference of 3.6 km
METRES = {"a": 3.0, "b": -2.8}  # of height for each px


def wave(rows, period=600.0, size=0.5):
    return size * np.sin(2 * np.pi * rows / period)


def differences(size=0.5, noise=1.5, seed=0, views=("a", "b")):
    """What a DEM with correlated noise and a map of two views differ by, on relief of 250 lines."""
    numbers = np.random.default_rng(seed)
    y, x = np.mgrid[:SIDE, :SIDE] * CELL
    rough = ndimage.gaussian_filter(numbers.normal(size=(SIDE, SIDE)), 8.0)
    relief = 120.0 * rough / rough.std()
    errors = ndimage.gaussian_filter(numbers.normal(size=(SIDE, SIDE)), 1.5)
    lines = 100.0 + y / 2.5 + relief, 100.0 + y / 2.5 - relief
    waves = METRES["a"] * wave(lines[0], size=size) + METRES["b"] * wave(lines[1], 450.0, size)
    value = waves + noise * errors / errors.std() + 4.0 + 1e-4 * x
    value[::9, ::7] += 25.0  # trees
    flat = [each.ravel() for each in (*lines, x, y, value)]
    metres = METRES["a"], METRES["b"]
    return MapDifferences(views, metres, (flat[0], flat[1]), flat[2], flat[3], flat[4])


def values_at(found, name, rows):
    first, weights = splines(rows, found.ends[name], len(found.coefficients[name]))
    return sum(weights[:, k] * found.coefficients[name][first + k] for k in range(ORDER))


def test_waves_are_found_under_the_noise_of_a_dem():
    part = differences()
    found = find_waves([part], CELL)
    rows = np.arange(200.0, 1450.0)
    left = METRES["a"] * (values_at(found, "a", part.lines[0]) - wave(part.lines[0]))
    left += METRES["b"] * (values_at(found, "b", part.lines[1]) - wave(part.lines[1], 450.0))
    before = METRES["a"] * wave(part.lines[0]) + METRES["b"] * wave(part.lines[1], 450.0)
    assert np.std(left) < 0.45 * np.std(before)
    assert found.criterion < -50 and found.after_m < found.before_m - 0.2
    assert np.corrcoef(values_at(found, "a", rows), wave(rows))[0, 1] > 0.85
    assert 0.3 < found.largest_px < 1.5


def test_known_splines_are_taken_as_they_are():
    ends = {"a": (0.0, 1800.0), "b": (-10.0, 1700.0), "c": (0.0, 5.0)}
    found = find_waves([differences()], CELL, (ends, 21))
    assert {name: len(each) for name, each in found.coefficients.items()} == {"a": 21, "b": 21}
    assert found.ends == {"a": (0.0, 1800.0), "b": (-10.0, 1700.0)}


@pytest.mark.parametrize("seed", range(4))
def test_noise_alone_makes_no_waves(seed):
    assert find_waves([differences(size=0.0, seed=seed)], CELL) is None


def test_too_few_differences_make_none():
    part = differences()
    few = [np.linspace(0, SIDE**2 - 1, 60).astype(int)] * 5
    lines = part.lines[0][few[0]], part.lines[1][few[0]]
    assert (
        find_waves([part._replace(lines=lines, x=part.x[few[0]], y=part.y[few[0]], value=part.value[few[0]])], CELL)
        is None
    )
    assert find_waves([], CELL) is None
