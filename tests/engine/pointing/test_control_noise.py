"""The noise of ground control points, and who is called wrong, against known noise."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.pointing.control_noise import (
    ControlEquations,
    contradicts,
    f_quantile,
    first_noise,
    robust_weight,
    suspects,
    variance_component,
)
from repm_qgis.pointing.parameters import POINTING

CONTROL = POINTING.control


def observations(points, noise, seed, views=2):
    """Points seen in views that are all shifted by the same unknown (2,): residuals about zero."""
    numbers = np.random.default_rng(seed)
    return [
        ControlEquations(numbers.normal(0, noise, 2 * views), np.tile(np.eye(2), (views, 1))) for _ in range(points)
    ]


def fit(points, noise):
    """(2,) the mean and its covariance by ordinary least squares."""
    normal = sum(point.design.T @ point.design for point in points)
    right = sum(point.design.T @ point.misclosure for point in points)
    return np.linalg.solve(normal, right), noise**2 * np.linalg.inv(normal)


@pytest.mark.parametrize("noise", (0.2, 1.0, 3.0))
def test_the_variance_component_has_no_bias(noise):
    found = []
    for seed in range(400):
        points = observations(4, noise, seed)
        step, covariance = fit(points, noise)
        redundancy = sum(point.redundancy(covariance, noise) for point in points)
        assert redundancy == pytest.approx(16 - 2)
        found.append(variance_component([point.after(step) for point in points], redundancy, CONTROL) ** 2)
    # One observation of 0.1 px is added to fourteen.
    assert np.mean(found) == pytest.approx((14 * noise**2 + 0.01) / 15, rel=0.06)


def test_exact_points_are_as_good_as_rpcs_and_a_single_one_says_little_of_itself():
    assert variance_component([np.zeros(4)] * 10, 36.0, CONTROL) == pytest.approx(0.02)
    assert 0.05 < variance_component([np.zeros(4)], 1.0, CONTROL) < 0.1
    assert variance_component([np.zeros(4)], -0.5, CONTROL) == pytest.approx(0.1)


def test_wrong_points_do_not_move_the_first_noise():
    residuals = [point.misclosure for point in observations(40, 0.3, 1)]
    clean = first_noise(residuals, CONTROL)
    assert clean == pytest.approx(0.3, rel=0.2)
    assert first_noise([r + 10 * (k % 5 == 0) for k, r in enumerate(residuals)], CONTROL) < 1.6 * clean


def test_suspects_are_the_far_ones_worst_first_and_half_at_most():
    near = [point.misclosure for point in observations(6, 0.2, 2)]
    far = [near[0] + 3, near[1] + 9]
    assert suspects(near[2:] + far, 0.2, CONTROL)[:2] == [5, 4]
    assert len(suspects([r + 50 * k for k, r in enumerate(near)], 0.2, CONTROL)) == 3
    assert suspects([np.zeros(4), np.full(4, 9.0)], 0.2, CONTROL) == []
    assert robust_weight(np.full(4, 2.0), 0.2) == pytest.approx(0.1) and robust_weight(np.zeros(4), 0.2) == 1.0


def test_false_alarms_are_as_rare_as_said_and_wrong_points_are_seen():
    """1 % a table of twelve points; a point 5 standard deviations off in both views is wrong."""
    alarms, seen = 0, 0
    for seed in range(2000):
        *others, last = observations(12, 0.5, seed)
        step, covariance = fit(others, 0.5)
        moved = [ControlEquations(point.after(step), point.design) for point in (*others, last)]
        redundancy = 44 - 2
        noise = variance_component([point.misclosure for point in moved[:-1]], redundancy, CONTROL)
        scaled = covariance * (noise / 0.5) ** 2
        alarms += contradicts(moved[-1], scaled, noise, redundancy, 12, CONTROL)
        off = ControlEquations(moved[-1].misclosure + 2.5, last.design)
        seen += contradicts(off, scaled, noise, redundancy, 12, CONTROL)
    # A twelfth of 1 % for each point: 1.7 of 2000 are expected.
    assert alarms <= 6 and seen == 2000


def test_less_than_half_a_pixel_is_nobodys_mistake():
    point = ControlEquations(np.array([0.3, 0.3, -0.3, 0.3]), np.tile(np.eye(2), (2, 1)))
    assert not contradicts(point, 1e-6 * np.eye(2), 0.02, 40.0, 12, CONTROL)
    assert contradicts(ControlEquations(2 * point.misclosure, point.design), 1e-6 * np.eye(2), 0.02, 40.0, 12, CONTROL)


@pytest.mark.parametrize("probability", (0.99, 0.999, 0.9995))
def test_the_f_distribution_is_that_of_scipy(probability):
    special = pytest.importorskip("scipy.special")
    for first in (4, 6, 12, 34):
        for second in (8.0, 20.5, 60.0, 500.0):
            exact = float(special.fdtri(first, second, probability))
            # With little redundancy the approximation is cautious: by a twelfth in distance at most.
            assert f_quantile(probability, first, second) == pytest.approx(exact, rel=0.03 if second > 8 else 0.17)
            assert f_quantile(probability, first, second) > 0.99 * exact
    assert f_quantile(probability, 4, 1.0) == np.inf
