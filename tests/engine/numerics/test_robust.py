from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from repm_qgis.numerics.robust import huber, nmad, tukey


def test_the_biweight_ends_at_its_limit():
    assert tukey(np.array([0.0, 0.5, -0.5, 1.0, -2.0])).tolist() == [1.0, 0.5625, 0.5625, 0.0, 0.0]


def test_hubers_weight_falls_with_the_residual_beyond_the_limit():
    assert huber(np.array([0.0, 0.5, 0.7, 1.4, 7.0]), 0.7) == pytest.approx([1.0, 1.0, 1.0, 0.5, 0.1])
    assert float(huber(3.0, 1.5)) == 0.5


def test_nmad_is_the_deviation_of_the_bulk():
    values = np.random.default_rng(1).normal(3.0, 2.0, 20_001)
    assert nmad(values) == pytest.approx(stats.median_abs_deviation(values, scale="normal"), rel=1e-5)
    values[:4000] += 1000.0
    assert nmad(values) < 3.0 < values.std(), "a fifth of gross errors hardly moves it"
    assert nmad(np.array([1.0, 2.0]), 0.0) == pytest.approx(1.4826 * 1.5) and nmad(np.array([])) == np.inf
