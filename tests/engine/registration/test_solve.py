"""Known shifts are found again, with honest deviations: simulated surfaces against references of every kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.numerics.robust import nmad
from repm_qgis.registration.parameters import REGISTRATION
from repm_qgis.registration.solve import Prior, mode, solve_shift
from repm_qgis.registration.surfaces import Reference, SupportMeans

CELL, SIDE, WEST, NORTH = 5.0, 320, 500_000.0, 4_000_000.0
PROMISED = Prior(horizontal_m=8.0, up_m=5.0, most_m=60.0)


def relief(rng, metres):
    """Hills with slopes at all scales."""
    wave = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE, CELL), np.fft.fftfreq(SIDE, CELL)))
    wave[0, 0] = 1.0
    spectrum = np.fft.fft2(rng.normal(size=(SIDE, SIDE))) * wave**-1.8 * np.exp(-((30 * wave) ** 2))
    found = np.fft.ifft2(spectrum).real
    return found / found.std() * metres


def houses(rng):
    found = np.zeros((SIDE, SIDE))
    for _ in range(250):
        (row, col), (height, width) = rng.integers(0, SIDE - 12, 2), rng.integers(2, 10, 2)
        found[row : row + height, col : col + width] = rng.uniform(4, 20)
    return found


def correlated(rng, shape, metres, cells):
    found = ndimage.gaussian_filter(rng.normal(size=shape), cells, mode="wrap")
    return found / found.std() * metres


def means(truth, cells):
    """Centres and means of blocks of cells."""
    count = SIDE // cells
    blocks = truth[: count * cells, : count * cells].reshape(count, cells, count, cells).mean(axis=(1, 3))
    at = (np.arange(count) + 0.5) * cells * CELL
    x, y = np.meshgrid(WEST + at, NORTH - at)
    return x, y, blocks


def reference(rng, truth, kind):
    if kind == "discs":
        col, row = rng.uniform(30, SIDE - 30, (2, 1000))
        x, y = WEST + (col + 0.5) * CELL, NORTH - (row + 0.5) * CELL
        exact = surface_of(truth, Reference(kind, truth, (12.0, 12.0), True)).at(x, y)[0]
        return Reference(kind, np.column_stack([x, y, exact + rng.normal(size=1000) * 0.2]), (12.0, 12.0), True)
    cells = {"30 m": 6, "lidar": 3}[kind]
    x, y, height = means(truth, cells)
    noise = correlated(rng, height.shape, 1.5, 2.0) if kind == "30 m" else rng.normal(size=height.shape) * 0.03
    height = height + noise
    down, right = np.gradient(height, cells * CELL)
    slopes = np.column_stack([right.ravel(), -down.ravel()])
    return Reference(kind, np.column_stack([x.ravel(), y.ravel(), height.ravel()]), (cells * CELL,) * 2, slopes=slopes)


def found(seed, kind, metres=60.0, town=False, tilt=(0.0, 0.0), tilted=False, trees=0.0):
    """The shift that was put in, and what is found."""
    rng = np.random.default_rng(seed)
    truth = relief(rng, metres) + (houses(rng) if town else 0.0)
    shift = rng.uniform(-1, 1, 3) * [20, 20, 10]
    own = ndimage.shift(truth, (shift[1] / CELL, -shift[0] / CELL), order=3, mode="nearest") - shift[2]
    east, north = np.meshgrid(np.arange(SIDE), -np.arange(SIDE))
    own -= (east - east.mean()) * CELL * tilt[0] + (north - north.mean()) * CELL * tilt[1]
    if trees:
        own += np.where(correlated(rng, own.shape, 1.0, 4) > trees, rng.uniform(5, 15, own.shape), 0.0)
    own += rng.normal(size=own.shape) * 0.5
    own[rng.random(own.shape) < 0.05] = np.nan
    own[:, :20] = np.nan
    wanted = reference(rng, truth, kind)
    return shift, solve_shift(surface_of(own, wanted), wanted, PROMISED, tilted)


def surface_of(own, wanted):
    return SupportMeans(CellGrid(WEST, NORTH, CELL, own.shape), own, wanted, REGISTRATION.covered)


@pytest.mark.parametrize(
    "kind, metres, town, bars",
    (
        ("30 m", 60.0, False, (1.5, 0.4)),
        ("30 m", 300.0, False, (0.5, 0.4)),
        ("discs", 60.0, False, (0.2, 0.05)),
        ("lidar", 60.0, False, (0.05, 0.02)),
        ("lidar", 5.0, True, (0.1, 0.05)),
    ),
)
@pytest.mark.long
def test_a_known_shift_is_found_with_an_honest_deviation(kind, metres, town, bars):
    shift, solved = found(3, kind, metres, town)
    error = np.abs(solved.moved - shift)
    assert np.hypot(*error[:2]) < bars[0] and error[2] < bars[1]
    assert (error < 4 * solved.deviations).all() and len(solved.determined) == 2
    before = solved.before_m[np.isfinite(solved.before_m)]
    assert np.median(before) == pytest.approx(shift[2], abs=5.0)
    assert (solved.deviations[:2] < bars[0]).all() and solved.unsure_m is None and nmad(solved.after_m) < nmad(before)


@pytest.mark.slow
def test_deviations_are_honest_over_seeds():
    """About 68 % of errors are within one deviation, though errors of neighbouring cells are alike."""
    normal = [
        np.abs(solved.moved - shift) / solved.deviations for shift, solved in (found(n, "30 m") for n in range(10))
    ]
    assert 0.5 <= (np.array(normal) < 1).mean() <= 0.9 and np.max(normal) < 4


def test_a_plain_tells_the_height_and_no_position():
    shift, solved = found(4, "30 m", metres=0.3)
    assert len(solved.determined) == 0 and (solved.moved[:2] == 0).all()
    assert solved.unsure_m[0] > solved.unsure_m[1]
    assert abs(solved.moved[2] - shift[2]) < 0.5 and solved.deviations[:2] == pytest.approx([8.0, 8.0])


@pytest.mark.long
def test_a_level_reference_tells_no_position_of_a_town():
    """The town's own slopes are no evidence: with a constant surface they agree nowhere better than elsewhere."""
    rng = np.random.default_rng(5)
    own = relief(rng, 5.0) + houses(rng) + rng.normal(size=(SIDE, SIDE)) * 0.3
    x, y, height = means(np.full_like(own, 30.0), 6)
    level = Reference("plane", np.column_stack([x.ravel(), y.ravel(), height.ravel()]), (30.0, 30.0))
    solved = solve_shift(surface_of(own, level), level, PROMISED)
    assert len(solved.determined) == 0 and (solved.moved[:2] == 0).all() and solved.unsure_m is None
    assert solved.moved[2] == pytest.approx(30.0 - np.median(own), abs=2.0)
    assert solved.deviations[:2] == pytest.approx([8.0, 8.0])


def test_slopes_in_one_direction_tell_the_position_across_them():
    rng = np.random.default_rng(1)
    ridges = np.tile(60.0 * np.sin(np.arange(SIDE) / 9.0), (SIDE, 1))  # as high everywhere to the north and south
    own = ndimage.shift(ridges, (2.0, -3.0), order=3, mode="nearest") + rng.normal(size=ridges.shape) * 0.3
    wanted = reference(rng, ridges, "30 m")
    solved = solve_shift(surface_of(own, wanted), wanted, PROMISED)
    assert len(solved.determined) == 1 and abs(solved.determined[0, 0]) > 0.999
    assert solved.moved[0] == pytest.approx(15.0, abs=0.5) and abs(solved.moved[1]) < 0.5
    assert solved.deviations[0] < 0.5 and solved.deviations[1] == pytest.approx(8.0, rel=0.01)


def test_a_tilt_is_found_where_it_is_wanted():
    shift, solved = found(5, "30 m", tilt=(2e-3, -1e-3), tilted=True)
    assert solved.ground.tilt == pytest.approx([2e-3, -1e-3], abs=4e-4)
    assert np.abs(solved.moved - shift).max() < 1.5
    assert found(5, "30 m")[1].ground.tilt == (0.0, 0.0)


def test_trees_above_bare_earth_count_little():
    shift, solved = found(6, "lidar", trees=1.0)  # on a sixth of the ground
    assert np.abs(solved.moved - shift)[2] < 0.1 and np.hypot(*(solved.moved - shift)[:2]) < 0.2


def test_too_few_heights_are_a_sentence():
    rng = np.random.default_rng(2)
    truth = relief(rng, 60.0)
    near = reference(rng, truth, "30 m")
    far = replace(near, xyz=near.xyz + [1e5, 0, 0])
    with pytest.raises(EmptyResultError, match="Heights of the reference on the scene's own surface: 0,"):
        solve_shift(surface_of(truth, near), far, PROMISED)


def test_the_mode_is_where_most_values_are():
    rng = np.random.default_rng(7)
    values = np.concatenate([rng.normal(2.0, 0.3, 600), rng.uniform(2.0, 20.0, 400)])
    assert mode(values, 0.5) == pytest.approx(2.0, abs=0.1) and np.median(values) > 2.2
    assert mode(np.array([5.0]), 0.5) == 5.0


@pytest.mark.parametrize("disc", (False, True))
def test_means_are_those_of_the_support(disc):
    """A plane's mean is its middle, a step's the share of it; slopes are the surface's."""
    x = np.arange(60) * 2.0 + 1.0
    kind = Reference("", x, (9.0, 9.0), disc)

    def means(values):
        return SupportMeans(CellGrid(0.0, 0.0, 2.0, values.shape), values, kind, 0.6)

    at = np.array([40.0, 61.3, 80.2])
    value, east, north = means(np.tile(0.3 * x, (60, 1)) - 0.2 * x[:, None]).at(at, -at)
    np.testing.assert_allclose(value, 0.1 * at, atol=1e-6)
    np.testing.assert_allclose(east, 0.3, atol=1e-6)
    np.testing.assert_allclose(north, 0.2, atol=1e-6)
    step = np.where(np.tile(x, (60, 1)) > 60, 10.0, 0.0)
    half = means(step).at(np.array([60.0]), np.array([-60.0]))
    assert half[0][0] == pytest.approx(5.0, abs=0.01) and half[1][0] > 0.5
    step[:, :20] = np.nan
    gone = means(step).at(np.array([20.0, 60.0]), -at[:2])
    assert np.isnan(gone[0][0]) and np.isfinite(gone[0][1])


def test_a_cell_may_be_wider_than_high():
    """As those of a grid in degrees are higher than wide."""
    spike = np.zeros((21, 21))
    spike[10, 10] = 1.0
    found = SupportMeans(CellGrid(0.0, 0.0, 1.0, spike.shape), spike, Reference("", spike, (6.0, 2.0)), 0.6)
    at = np.arange(21) + 0.5
    across, along = found.at(at, np.full(21, -10.5))[0], found.at(np.full(21, 10.5), -at)[0]
    assert (
        (across > 0.01).sum() == 7
        and (along > 0.01).sum() == 3
        and np.nanmax(across) == pytest.approx(1 / 12, abs=1e-6)
    )


@pytest.mark.parametrize(
    ("change", "words"),
    (
        (lambda height: height, None),
        (lambda height: height + 40.0, None),
        (lambda height: -height, "upside down, or"),
        (lambda height: 3.2808 * height, "scaled: check the units"),
        (lambda height: np.roll(height, SIDE // 2, axis=(0, 1)), "of another place"),
    ),
)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_another_relief_is_named(seed, change, words):
    """Heights with a weight agree by choice: 9430 of 10372 heights of a reference were "used" for a surface upside
    down. A plain says nothing."""
    rng = np.random.default_rng(seed)
    truth = relief(rng, 30.0)
    given = reference(rng, truth, "30 m")
    own = SupportMeans(CellGrid(WEST, NORTH, CELL, (SIDE, SIDE)), change(truth), given, REGISTRATION.covered)
    found = solve_shift(own, given, replace(PROMISED, up_m=50.0)).other_relief
    assert (found is None) == (words is None)
    assert words is None or words in found.sentence("dem.tif")
    level = replace(given, xyz=given.xyz * (1, 1, 0.05))
    assert solve_shift(own, level, replace(PROMISED, up_m=50.0)).other_relief is not None  # of other ground
