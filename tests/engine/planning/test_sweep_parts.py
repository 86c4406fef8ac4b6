"""The parts of the search for altitudes, against plain loops over cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.planning import altitude_range
from repm_qgis.planning.altitude_range import _correlation, _in_large_parts, _middle, sweep_patches
from repm_qgis.planning.altitudes import ALTITUDES
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import View

SWEEP = PLANNING.sweep
SMALL = replace(SWEEP, window_radius=2)


def by_windows(a, b, radius):
    """The correlation of square windows around each cell, window by window; NaN where one has gaps."""
    found = np.full(a.shape, np.nan)
    for row in range(radius, a.shape[0] - radius):
        for column in range(radius, a.shape[1] - radius):
            part = np.s_[row - radius : row + radius + 1, column - radius : column + radius + 1]
            if np.isfinite(a[part]).all() and np.isfinite(b[part]).all():
                found[row, column] = np.corrcoef(a[part].ravel(), b[part].ravel())[0, 1]
    return found


@pytest.mark.parametrize("shift", ((0, 0), (2, -1)))
def test_the_correlation_is_that_of_the_windows(shift):
    rng = np.random.default_rng(0)
    a = (20.0 + ndimage.gaussian_filter(rng.normal(size=(30, 34)), 1.0) * 8).astype(np.float32)
    b = (a + rng.normal(0, 0.6, a.shape)).astype(np.float32)
    b = np.roll(b, (-shift[0], -shift[1]), axis=(0, 1))
    found, wanted = _correlation(a, b, shift, SMALL), by_windows(a, np.roll(b, shift, axis=(0, 1)), 2)
    known = np.isfinite(wanted)
    assert found[known] == pytest.approx(wanted[known], abs=1e-3) and known.sum() > 700
    assert np.median(found[known]) > 0.8


def test_gaps_and_even_ground_have_no_correlation():
    rng = np.random.default_rng(1)
    a = (30.0 + rng.normal(size=(40, 40)) * 3).astype(np.float32)
    b = a.copy()
    b[:, 20:] = np.nan
    found = _correlation(a, b, (0, 0), SMALL)
    assert (found[10:30, 5:17] > 0.99).all() and (found[10:30, 20:] == -1).all()
    for flat in (a, b := a.copy()):
        even = flat.copy()
        even[:, :20] = 30.0 + rng.normal(size=(40, 20)) * 0.1  # a contrast of a three hundredth is noise
        pair = (even, b) if flat is a else (a, even)
        assert (_correlation(*pair, (0, 0), SMALL)[10:30, 5:15] == -1).all()
    assert (_correlation(a, np.full_like(a, np.nan), (0, 0), SMALL) == -1).all()


def test_a_window_may_lack_a_fifth_of_its_cells():
    rng = np.random.default_rng(2)
    a = (30.0 + rng.normal(size=(21, 21)) * 3).astype(np.float32)
    for missing, known in ((5, True), (6, False)):
        b = a.copy()
        b[8:13, 8:13].flat[:missing] = np.nan
        assert (_correlation(a, b, (0, 0), SMALL)[10, 10] > 0.99) == known


def by_labels(altitude, step):
    """Parts of like altitude that are connected, and have as many cells as a window at least; by flooding."""
    large, seen = np.zeros(altitude.shape, bool), ~np.isfinite(altitude)
    for start in zip(*np.nonzero(~seen)):
        if seen[start]:
            continue
        part, queue = [], [start]
        seen[start] = True
        while queue:
            row, column = queue.pop()
            part.append((row, column))
            for place in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
                if all(0 <= k < n for k, n in zip(place, altitude.shape)) and not seen[place]:
                    if abs(altitude[place] - altitude[row, column]) <= SMALL.joined_planes * step:
                        seen[place] = True
                        queue.append(place)
        if len(part) >= 25:
            large[tuple(np.transpose(part))] = True
    return large


@pytest.mark.parametrize("seed", range(4))
def test_large_parts_are_those_of_a_flood(seed):
    rng = np.random.default_rng(seed)
    altitude = np.round(ndimage.gaussian_filter(rng.normal(size=(40, 50)), 2.0) * 60) * 4.0
    altitude[rng.random(altitude.shape) < 0.25] = np.nan
    altitude[:, 24] = np.nan
    altitude[30:, 30:] = 4.0 * np.arange(20)[None, :]  # a ramp whose ends are far apart, and which is one part
    found = _in_large_parts(altitude, 4.0, SMALL)
    assert (found == by_labels(altitude, 4.0)).all() and found[30:, 30:].all() and 0 < found.sum() < found.size


def test_patches_are_spread_over_the_area():
    side = SWEEP.cells * SWEEP.reduction * 0.5  # 640 m
    (one,) = sweep_patches((0.0, 100.0, 600.0, 800.0), 0.5, SWEEP)
    assert one == (0.0, 100.0, 600.0, 800.0)
    wide = sweep_patches((0.0, 0.0, 6000.0, 600.0), 0.5, SWEEP)
    assert len(wide) == 3 and [patch.xmin for patch in wide] == pytest.approx([0.0, 2520.0, 5040.0])
    assert all(patch.xmax - patch.xmin == pytest.approx(1.5 * side) for patch in wide)
    nine = sweep_patches((0.0, 0.0, 6000.0, 7000.0), 0.5, SWEEP)
    assert len(nine) == 9 and nine[0][:2] == (0.0, 0.0) and nine[-1][2:] == (6000.0, 7000.0)
    assert [patch.ymin for patch in nine[:3]] == [0.0, 0.0, 0.0]
    two = sweep_patches((0.0, 0.0, 1.6 * side, 100.0), 0.5, SWEEP)
    assert len(two) == 2 and two[0].xmax == two[1].xmin == pytest.approx(0.8 * side)
    assert _middle(nine[0]) == pytest.approx((240.0, 240.0, 720.0, 720.0))
    assert _middle(Bounds(0.0, 100.0, 8.0, 500.0)) == pytest.approx((2.0, 200.0, 6.0, 400.0))


def test_planes_are_as_dense_as_the_images_tell_and_no_more_than_is_worth_it(synthetic_rpc, monkeypatch):
    view, seen = View("a", "a.tif", 1, 1000, 1000, synthetic_rpc(), 0.5), []

    def no_shift(sweep, patches):
        seen.append(sweep.planes)
        return 0, 0

    monkeypatch.setattr(altitude_range, "_pointing_shift", no_shift)
    monkeypatch.setattr(altitude_range, "sweep_patches", lambda *given: [])
    for search in ((100.0, 160.0), (-500.0, 5500.0)):
        area = Bounds(0, 0, 1, 1)
        altitude_range._swept(view, view, 0.5, "EPSG:32631", area, search, Silent(), SWEEP, ALTITUDES)
    few, many = seen
    assert np.diff(few) == pytest.approx(np.full(len(few) - 1, 0.5 * SWEEP.reduction / 0.5))
    assert SWEEP.most_planes <= len(many) <= SWEEP.most_planes + 2 and many[0] == -500.0 and many[-1] > 5499.9


def test_a_patch_that_not_both_images_show_has_no_shift(monkeypatch):
    monkeypatch.setattr(altitude_range, "_reduced_pair", lambda sweep, patch: ((8, 8), np.zeros((9, 9, 2)), None))
    assert altitude_range._cross_shift(None, Bounds(0, 0, 1, 1)) == (-1.0, 0, (0, 0))


def test_pairs_are_looked_at_in_the_middle_of_the_area_and_of_the_search(urban, monkeypatch):
    asked = []

    def pair_at(first, second, place, *rest):
        asked.append(place)
        return pairs(first, second, place, *rest)

    pairs = altitude_range.pair_at
    monkeypatch.setattr(altitude_range, "pair_at", pair_at)
    found = altitude_range._pairs(urban.views, urban.bounds, urban.crs, (150.0, 350.0), SWEEP)
    assert len(found) >= 2 and {place[2] for place in asked} == {250.0}
    west, south, east, north = urban.bounds
    middle = geodetic_from_projected(urban.crs, np.array([(west + east) / 2, (south + north) / 2]))
    assert asked[0][:2] == pytest.approx(tuple(middle))
