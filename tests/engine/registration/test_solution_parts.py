"""The parts of a registration's solution against sums over all pairs, and against what algebra says of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.registration import estimation, solve
from repm_qgis.registration.estimation import Correlation
from repm_qgis.registration.parameters import REGISTRATION
from repm_qgis.registration.solve import Prior, _Problem, _Solution
from repm_qgis.registration.surfaces import Reference


class Slope:
    """A surface of 1 m cells that rises to the east and to the north, with all that a solution asks of it."""

    middle, extent_m, cell_m, resolution_m = (500.0, 800.0), (400.0, 400.0), 1.0, 1.0

    def __init__(self, east=0.05, north=-0.02):
        self.east, self.north = east, north

    def at(self, x, y):
        inside = (np.abs(x - 500.0) <= 200.0) & (np.abs(y - 800.0) <= 200.0)
        height = 100.0 + self.east * (x - 500.0) + self.north * (y - 800.0)
        return (np.where(inside, height, np.nan), *(np.full(x.shape, slope) for slope in (self.east, self.north)))


def solution(rng, count=600, residual=None, noise=1.0, weight=1.0):
    """A solution with unit noise, at random places; its places, too."""
    place = np.column_stack([rng.uniform(320, 680, count), rng.uniform(620, 980, count)])
    away = place - (500.0, 800.0)
    design = np.column_stack([rng.normal(0, 0.3, (count, 2)), np.ones(count), away])
    residual = rng.normal(0, 1, count) if residual is None else residual(place)
    full = np.ones(count)
    return _Solution(np.zeros(5), residual, weight * full, full > 0, noise * full, design, design), place


def problem(place, surface=None, heights=None, parameters=REGISTRATION):
    xyz = np.column_stack([place, np.zeros(len(place)) if heights is None else heights])
    return _Problem(surface or Slope(), Reference("points", xyz, (3.0, 3.0)), parameters)


@pytest.mark.parametrize("length", (4.0, 15.0, 40.0))
@pytest.mark.parametrize("form", ("exponential", "gaussian"))
def test_a_correlation_is_fitted_as_it_is(form, length):
    """Also with a length near the end of what the distances show, and with a part that is each height's own."""
    lags = np.linspace(1.0, 100.0, 60)
    truth = {"exponential": lambda d: np.exp(-d / length), "gaussian": lambda d: np.exp(-((d / length) ** 2))}[form]
    found = Correlation.fitted(lags, 0.7 * truth(lags), np.full(60, 50.0))
    assert found.at(lags) == pytest.approx(0.7 * truth(lags), abs=0.02)
    assert (found.exponential >= 0).all() and (found.gaussian >= 0).all()
    assert found.at(np.zeros(1))[0] <= 1.0 + 1e-12
    assert found.lengths_m[0] == pytest.approx(1.0) and found.lengths_m[-1] == pytest.approx(50.0)
    distances = np.linspace(0.0, 60.0, 6001)
    wanted = distances[0.7 * truth(distances) >= math.exp(-1)].max()
    assert found.range_m == pytest.approx(wanted, abs=0.05 * wanted + 0.3)


def test_a_correlation_counts_each_distance_as_often_as_it_was_seen():
    lags = np.array([1.0, 10.0, 30.0, 60.0])
    values, wrong = np.exp(-lags / 20.0), np.array([0.0, 0.0, 0.0, 0.6])
    sure = Correlation.fitted(lags, values + wrong, np.array([1e6, 1e6, 1e6, 1.0]))
    assert sure.at(lags[:3]) == pytest.approx(values[:3], abs=0.03)


def test_without_pairs_nothing_is_correlated():
    found = Correlation.fitted(np.empty(0), np.empty(0), np.empty(0))
    assert (found.at(np.array([0.0, 5.0])) == 0).all() and found.range_m == 0.0


def test_one_distance_makes_a_correlation_too():
    found = Correlation.fitted(np.array([3.0]), np.array([0.5]), np.array([10.0]))
    assert found.at(np.array([3.0]))[0] == pytest.approx(0.5, abs=1e-6)
    assert found.lengths_m[0] == pytest.approx(3.0) and found.lengths_m[-1] == pytest.approx(6.0)


def test_the_correlation_is_that_of_all_pairs(monkeypatch):
    """Class by class of the distance, of standardised differences from their mean; without those that do not count."""
    rng = np.random.default_rng(0)
    found, place = solution(rng, 700, noise=2.0)
    found = replace(found, residual=found.residual + 5.0, weight=np.where(np.arange(700) % 7 == 0, 0.0, 1.0))
    given = []
    monkeypatch.setattr(Correlation, "fitted", classmethod(lambda cls, *parts: given.append(parts)))
    problem(place).correlation(found)
    use = found.weight > 0
    r, at = found.residual[use] / 2.0, place[use]
    r = r - r.mean()
    first, second = np.triu_indices(len(r), 1)
    distance = np.hypot(*(at[first] - at[second]).T)
    edges = 0.5 * np.hypot(*np.ptp(at, axis=0)) * np.linspace(0, 1, 65) ** 2
    count = np.histogram(distance, edges)[0]
    total = np.histogram(distance, edges, weights=r[first] * r[second])[0]
    good = count > 0
    lags, values, counts = given[0]
    assert counts == pytest.approx(count[good], abs=1) and lags == pytest.approx(((edges[:-1] + edges[1:]) / 2)[good])
    assert values[5:] == pytest.approx((total[good] / count[good] / np.mean(r**2))[5:], abs=0.02)


@pytest.mark.parametrize("wide", (True, False))
def test_correlated_scores_are_summed_as_over_all_pairs(wide):
    """On the lattice's own cells the Fourier transforms give the very double sum, in an area of any shape."""
    rng, lattice = np.random.default_rng(1), 24
    across = np.arange(lattice + 1)
    down = np.arange(lattice // 3)
    x, y = np.meshgrid(*(across, down) if wide else (down, across))
    place = np.column_stack([x.ravel(), y.ravel()]) * 5.0 + (1000.0, -300.0)
    scores = rng.normal(0, 1, (len(place), 3))
    correlation = Correlation(np.array([12.0, 30.0]), np.array([0.3, 0.2]), np.array([0.1, 0.15]))
    found = estimation.correlated_sum(scores, place, correlation, lattice)
    apart = np.hypot(*(place[:, None] - place[None]).T)
    rho = correlation.at(apart) + 0.25 * np.eye(len(place))  # a quarter is each score's own
    assert found == pytest.approx(scores.T @ rho @ scores, rel=1e-6)


def test_without_correlation_the_covariance_is_that_of_least_squares():
    rng = np.random.default_rng(2)
    found, place = solution(rng, residual=lambda place: np.zeros(len(place)), noise=0.5)
    none = Correlation(np.ones(1), np.zeros(1), np.zeros(1))
    basis = np.eye(5)
    every = np.ones(len(place), bool)
    covariance = problem(place).covariance(found, basis, none, every, 50)
    wanted = 0.25 * np.linalg.inv(found.design.T @ found.design)
    assert covariance == pytest.approx(wanted, rel=1e-6)
    half = problem(place).covariance(found, basis, none, np.arange(len(place)) % 2 == 0, 50)
    assert np.diag(half) == pytest.approx(2 * np.diag(wanted), rel=0.2)
    height = basis[:, 2:3]
    alone = problem(place).covariance(found, height, none, every, 50)
    assert alone[2, 2] == pytest.approx(0.25 / len(place)) and np.count_nonzero(alone) == 1


def test_residuals_near_the_limit_count_less_in_the_covariance():
    """By the derivative of Tukey's psi, as a sum over heights says it."""
    rng = np.random.default_rng(3)
    found, place = solution(rng, noise=2.0)
    u = found.residual / 2.0 / REGISTRATION.tukey
    found = replace(found, weight=(1 - u**2) ** 2)
    none = Correlation(np.ones(1), np.zeros(1), np.zeros(1))
    basis = np.eye(5)[:, 2:3]
    covariance = problem(place).covariance(found, basis, none, np.ones(len(place), bool), 50)
    normal = ((1 - u**2) * (1 - 5 * u**2) / 4.0).sum()
    assert covariance[2, 2] == pytest.approx((found.weight**2 / 4.0).sum() / normal**2, rel=1e-9)


def test_the_noise_grows_with_the_slope_and_trees_do_not_widen_it():
    rng = np.random.default_rng(4)
    slope = rng.uniform(0, 0.6, 30_000)
    sigma = 0.2 + 2.0 * slope
    residual = rng.normal(0, 1, 30_000) * sigma
    seen = np.arange(30_000) % 10 > 0
    residual[~seen] = 100.0
    found = problem(np.zeros((2, 2)))._noise(residual, slope, seen)
    assert found == pytest.approx(np.interp(slope, (0.05, 0.55), (0.3, 1.3)), rel=0.08)
    few = problem(np.zeros((2, 2)))._noise(np.full(50, 0.3), np.linspace(0, 1, 50), np.ones(50, bool))
    assert few == pytest.approx(np.full(50, 1.4826 * 0.3), rel=1e-3)
    level = problem(np.zeros((2, 2)))._noise(np.zeros(200), np.linspace(0, 1, 200), np.ones(200, bool))
    assert (level == REGISTRATION.least_noise_m).all()


def test_derivatives_are_those_of_what_is_predicted():
    rng = np.random.default_rng(5)
    place = np.column_stack([rng.uniform(320, 680, 50), rng.uniform(620, 980, 50)])
    place[0] = 0.0, 0.0  # sees nothing
    heights = rng.normal(100, 5, 50)
    asked, start = problem(place, heights=heights), np.array([3.0, -2.0, 1.0, 1e-3, -2e-3])
    residual, design, seen = asked._linearised(start)
    assert not seen[0] and seen[1:].all() and residual[0] == 0 and (design[0] == 0).all()
    for number, step in enumerate(np.diag([1.0, 1.0, 1.0, 1e-3, 1e-3])):
        moved = asked._linearised(start + step)[0]
        assert (residual - moved)[1:] == pytest.approx((design @ step)[1:], abs=1e-9), number
    predicted = 100 + 0.05 * (place[:, 0] - 503) - 0.02 * (place[:, 1] - 798) + 1.0
    predicted += 1e-3 * (place[:, 0] - 500) - 2e-3 * (place[:, 1] - 800)
    assert residual[1:] == pytest.approx((heights - predicted)[1:], abs=1e-9)


def test_directions_that_are_put_back_take_their_height_along():
    """On a slope to the east, 4 m that are put back there are 0.2 m of height."""
    rng = np.random.default_rng(6)
    place = np.column_stack([rng.uniform(320, 680, 400), rng.uniform(620, 980, 400)])
    heights = Slope().at(place[:, 0] - 4.0, place[:, 1] - 7.0)[0] + 3.0
    asked = problem(place, heights=heights)
    made = asked.solve(np.array([4.0, 7.0, 3.0]), np.empty((0, 2)), False, lambda: None)
    none = Correlation(np.ones(1), np.zeros(1), np.zeros(1))
    moved, _, _ = asked.back((made, np.zeros((5, 5)), none), np.array([[0.0, 1.0]]), False)
    # The slope to the north is free: it takes the height's change, as far as a plane tells the two apart.
    assert moved.unknowns[0] == pytest.approx(0.0, abs=1e-9)
    assert asked._linearised(moved.unknowns)[0] == pytest.approx(np.zeros(400), abs=1e-6)
    level, _, _ = asked.back((made, np.zeros((5, 5)), none), np.empty((0, 2)), False)
    assert level.unknowns == pytest.approx([0.0, 0.0, 3.0 - 4.0 * 0.05 + 7.0 * 0.02, 0.0, 0.0], abs=1e-6)


def test_a_tilt_is_carried_where_both_ends_are_certain():
    surface, prior = Slope(), Prior(8.0, 5.0, 60.0)
    most = REGISTRATION.undetermined * prior.up_m / 200.0
    for east, north, carried in ((0.9, 0.9, True), (1.1, 0.1, False), (0.1, 1.1, False)):
        covariance = np.diag([1.0, 1.0, 1.0, (east * most) ** 2, (north * most) ** 2])
        assert solve._is_precise(covariance, surface, prior, REGISTRATION) is carried


def test_of_many_heights_so_many_pairs_are_taken():
    numbers = np.arange(1000) * 3
    some = estimation.some_of(numbers, 5000, 0)
    assert len(some) == 100 and (np.diff(some) > 0).all() and set(some) <= set(numbers)
    assert (estimation.some_of(numbers[:100], 5000, 0) == numbers[:100]).all()
    assert len(estimation.some_of(numbers[:101], 5000, 0)) == 100


def test_too_few_heights_are_counted():
    rng = np.random.default_rng(7)
    place = np.column_stack([rng.uniform(320, 680, 60), rng.uniform(620, 980, 60)])
    place[11:] += 10_000.0
    with pytest.raises(EmptyResultError, match="Heights of the reference on the scene's own surface: 11. Choose"):
        problem(place).solve(np.zeros(3), np.eye(2), False, lambda: None)
    with pytest.raises(EmptyResultError, match="Heights .* surface: 11, and at least 50 are needed"):
        xyz = np.column_stack([place, np.zeros(60)])
        solve._search(Slope(), xyz, Prior(8.0, 5.0, 60.0), lambda: None, REGISTRATION)


def test_a_reference_is_fine_with_slopes_of_its_own_and_cells_like_the_surfaces():
    xyz, slopes = np.zeros((60, 3)), np.zeros((60, 2))
    wide = REGISTRATION.fine_cells * Slope.cell_m

    def is_fine(width_m, slopes):
        return _Problem(Slope(), Reference("dem", xyz, (width_m, width_m), slopes=slopes), REGISTRATION).is_fine

    assert is_fine(0.9 * wide, slopes)
    assert not is_fine(1.1 * wide, slopes) and not is_fine(0.9 * wide, None)


def test_the_mode_is_the_middle_of_the_shortest_interval():
    values = np.array([0.0, 1.0, 1.1, 1.2, 1.4, 9.0, 20.0, 40.0])
    assert solve.mode(values, 0.5) == pytest.approx(1.15)
    assert solve.mode(values, 1.0) == pytest.approx(1.3) and solve.mode(values, 0.25) in (1.05, 1.15)
    assert solve.mode(np.array([4.0]), 0.5) == 4.0
    assert solve.mode(-values, 0.5) == pytest.approx(-1.15)


def test_unknowns_are_the_free_directions_the_height_and_the_tilt():
    assert (solve._basis(np.eye(2), True) == np.eye(5)).all()
    assert (solve._basis(np.eye(2), False) == np.eye(5)[:, :3]).all()
    assert solve._basis(np.array([[0.6, 0.8]]), False).T.tolist() == [[0.6, 0.8, 0, 0, 0], [0, 0, 1, 0, 0]]


def test_parts_ask_for_the_weighted_mean_of_their_own_differences():
    """Of a surface that may only move up: sixteen parts, each with at least fifty heights, by its own weights."""
    rng = np.random.default_rng(8)
    found, place = solution(rng, 4000)
    noise, weight = rng.uniform(0.2, 3.0, 4000), rng.uniform(0.1, 1.0, 4000)
    column, row = np.floor((place - (300.0, 600.0)) / 100.0).astype(int).T
    few = np.flatnonzero((column == 3) & (row == 2))[49:]
    weight[few] = 0.0
    unknowns = np.array([1.0, -2.0, 4.0, 1e-3, -2e-3])
    found = replace(found, noise=noise, weight=weight, unknowns=unknowns, residual=found.residual * 0.3 + column)
    none = Correlation(np.ones(1), np.zeros(1), np.zeros(1))
    offsets = list(problem(place).local_offsets(found, np.empty((0, 2)), none))
    assert len(offsets) == 15
    for offset in offsets:
        part = np.floor((np.array([offset.x, offset.y]) - (300.0, 600.0)) / 100.0).astype(int)
        use = (column == part[0]) & (row == part[1]) & (weight > 0)
        assert offset.count == use.sum() and [offset.x, offset.y] == pytest.approx(place[use].mean(axis=0))
        own = (weight / noise**2)[use]
        wanted = (own * found.residual[use]).sum() / own.sum()
        tilt = unknowns[3:] @ ((offset.x, offset.y) - np.array([500.0, 800.0]))
        assert offset.moved == pytest.approx((1.0, -2.0, 4.0 + wanted + tilt))
        assert offset.deviation[:2] == (0.0, 0.0) and 0 < offset.deviation[2] < 0.5


def test_a_solution_ends_as_soon_as_it_stays():
    rng = np.random.default_rng(3)
    place = np.column_stack([rng.uniform(320, 680, 800), rng.uniform(620, 980, 800)])
    heights = Slope().at(*place.T)[0] + 2.0 + rng.normal(0.0, 0.1, 800)  # two metres too low
    steps = []
    found = problem(place, heights=heights).solve(np.zeros(3), np.zeros((0, 2)), False, lambda: steps.append(1))
    assert found.unknowns[2] == pytest.approx(2.0, abs=0.02) and not found.unknowns[:2].any()
    # Three steps with the middle of the differences taken away, and then until it is found: no more than some.
    assert 4 <= len(steps) < REGISTRATION.iterations
