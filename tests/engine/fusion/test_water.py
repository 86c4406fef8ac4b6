"""Water: where it is found and where not, its level along a shore, and what becomes of a surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Window
from repm_qgis.fusion import water as module
from repm_qgis.fusion.parameters import FUSION
from repm_qgis.fusion.provenance import SurfaceCells
from repm_qgis.fusion.surface import Block
from repm_qgis.fusion.water import find_water, flattened, monotonic, water_levels
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.imagery.confidence import Provenance

CELL = 1.0
SHAPE = (240, 300)
GRID = CellGrid(500000.0, 5000000.0, CELL, SHAPE)
LAKE = (slice(40, 120), slice(40, 130))


def surface(height):
    known = np.isfinite(height)
    parts = [np.where(known, value, np.nan).astype(np.float32) for value in (2, 0.1, 0.9, 0, 0.2, 0.4)]
    return SurfaceCells(height.astype(np.float32), *parts)


def stored(tmp_path, height, halves=1):
    """The surface in blocks, side by side."""
    made, width = [], SHAPE[1] // halves
    for number in range(halves):
        own = Window(number * width, 0, width, SHAPE[0])
        block = Block(own, str(tmp_path / f"{number}.npy"))
        part = surface(height[:, own.col : own.col + width])
        np.save(block.path, np.stack([getattr(part, name) for name in vars(part)]))
        made.append(block)
    return made


@pytest.fixture
def ground():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    height = 101 + 0.02 * y + 0.3 * np.random.default_rng(1).random(SHAPE)
    height[LAKE] = np.nan
    height[36:40, 60:90] += 9  # houses at the shore
    return height


@pytest.fixture
def shown(monkeypatch):
    """Two views: textured land; what ``looks`` gives elsewhere by its rows and columns: (brightness, roughness)."""

    def use(*looks, views=2):
        rng = np.random.default_rng(2)
        made = []
        for number in range(2):
            light = 0.5 + 0.2 * rng.random(SHAPE)
            for part, tone, rough in looks:
                light[part] = tone + rough * rng.random(light[part].shape)
            made.append(light.astype(np.float32) if number < views else np.full(SHAPE, np.nan, np.float32))
        monkeypatch.setattr(module, "lights", lambda given, *_: iter(given or made))

    return use


def found(blocks):
    return find_water(blocks, GRID, None, lambda: None)


def test_a_lake_has_the_level_of_its_shore_and_land_none(tmp_path, ground, shown):
    shown((LAKE, 0.05, 0.01))
    made = found(stored(tmp_path, ground))
    (body,) = made.bodies
    level = made.within(Window(0, 0, *GRID.size))
    assert not body.falls and body.area == pytest.approx(7200, rel=0.02)
    assert np.isfinite(level[LAKE]).mean() > 0.97 and np.isnan(level[130:]).all() and np.isnan(level[:, 140:]).all()
    shore = ground[36:124, 36:134]
    assert np.nanmin(shore) <= np.nanmax(level) == np.nanmin(level) < np.nanpercentile(shore, 20)


@pytest.mark.parametrize(
    ("tone", "rough", "views"),
    [(0.9, 0.01, 2), (0.05, 0.2, 2), (0.05, 0.01, 1), (0.05, 0.01, 0)],
    ids=["a bright cloud", "a dark wood", "what one view shows", "what no view shows"],
)
def test_other_empty_ground_is_no_water(tone, rough, views, tmp_path, ground, shown):
    shown((LAKE, tone, rough), views=views)
    assert found(stored(tmp_path, ground)).bodies == ()


@pytest.mark.parametrize("strip", [(slice(10, 20), slice(0, 290)), (slice(180, 220), slice(200, 240))])
def test_shadows_are_too_narrow_or_too_small(strip, tmp_path, ground, shown):
    ground[LAKE] = 101.0
    ground[strip] = np.nan
    shown((strip, 0.03, 0.01))
    assert found(stored(tmp_path, ground)).bodies == ()


def test_dark_ground_with_heights_is_no_water(tmp_path, ground, shown):
    ground[LAKE] = 101.0
    shown((LAKE, 0.03, 0.01))
    assert found(stored(tmp_path, ground)).bodies == ()


def test_neither_blocks_nor_larger_cells_lose_the_lake(tmp_path, ground, shown):
    shown((LAKE, 0.05, 0.01))
    whole = found(stored(tmp_path, ground))
    shown((LAKE, 0.05, 0.01))
    parts = found(stored(tmp_path, ground, halves=2))
    np.testing.assert_array_equal(whole.level, parts.level)
    few = replace(FUSION, water=replace(FUSION.water, most_cells=SHAPE[0] * SHAPE[1] // 4))
    half = np.s_[20:60, 20:65]
    seen = [np.full((120, 150), 0.5, np.float32) + 0.2 * np.random.default_rng(n).random((120, 150)) for n in (1, 2)]
    for light in seen:
        light[half] = 0.05
    coarse = find_water(stored(tmp_path, ground), GRID, seen, lambda: None, few)
    assert coarse.step == 2 and len(coarse.bodies) == 1
    assert np.isfinite(coarse.within(Window(0, 0, *GRID.size))[LAKE]).mean() > 0.95


def hill():
    """A slope of 10 % to the south, into which the lake was dug: its lowest shore is its southern one, at 109 m."""
    y = np.mgrid[: SHAPE[0], : SHAPE[1]][0]
    height = 121 - 0.1 * y + 0.2 * np.random.default_rng(1).random(SHAPE)
    height[LAKE] = np.nan
    return height


def test_a_lake_whose_low_shore_is_under_a_cloud_has_no_level(tmp_path, shown):
    clear, cloudy = hill(), hill()
    cloudy[60:170, 20:160] = np.nan
    shown((LAKE, 0.05, 0.01))
    (seen,) = found(stored(tmp_path, clear)).bodies
    assert seen.known and seen.lowest == pytest.approx(109.2, abs=0.6)
    shown((LAKE, 0.05, 0.01), (np.s_[122:170, 20:160], 0.9, 0.01))
    half = found(stored(tmp_path, cloudy))
    (hidden,) = half.bodies
    assert not hidden.known and not hidden.falls and hidden.area > 5000
    level = half.within(Window(0, 0, *GRID.size))
    assert np.isposinf(level[45:115, 45:125]).all(), "it is water all the same"
    given = surface(cloudy)
    np.testing.assert_array_equal(flattened(given, level).height, given.height)


def test_a_cloud_on_a_shore_that_is_level_elsewhere_changes_nothing(tmp_path, ground, shown):
    shown((LAKE, 0.05, 0.01))
    (clear,) = found(stored(tmp_path, ground)).bodies
    ground[90:170, 20:100] = np.nan
    shown((LAKE, 0.05, 0.01), (np.s_[90:170, 20:100], 0.9, 0.01))
    (cloudy,) = found(stored(tmp_path, ground)).bodies
    assert cloudy.known and cloudy.lowest == pytest.approx(clear.lowest, abs=0.5)


def test_a_rivers_level_falls_all_along_it():
    """A winding river of 600 m that falls by 4 m, with houses on half of its banks and wrong heights."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:120, :600]
    away = np.abs(y - 60 - 25 * np.sin(x / 60.0))
    inside = away < 10
    bank = (away >= 10) & (away < 13)
    rows, columns = np.nonzero(bank)
    heights = 80 - 4 * columns / 600 + 0.3 + 0.2 * rng.random(len(rows)) + 8 * (rng.random(len(rows)) < 0.5)
    heights[::97] -= 5
    level = water_levels(inside, rows, columns, heights, 1.0)
    assert np.isfinite(level[inside]).all() and np.isnan(level[~inside]).all()
    middle = np.array([level[int(60 + 25 * np.sin(c / 60.0)), c] for c in range(600)])
    assert (np.diff(middle) <= 1e-5).all(), "it rises nowhere"
    assert middle[0] - middle[-1] == pytest.approx(4, abs=0.5)
    assert np.abs(middle - (80.3 - 4 * np.arange(600) / 600)).max() < 0.5
    np.testing.assert_allclose(
        water_levels(inside[:, ::-1], rows, 599 - columns, heights, 1.0), level[:, ::-1], atol=0.1
    )


def test_a_long_lake_is_no_river():
    inside = np.zeros((40, 400), bool)
    inside[10:30, 5:395] = True
    around = np.zeros_like(inside)
    around[7:33, 2:398] = True
    rows, columns = np.nonzero(around & ~inside)
    heights = 50 + np.random.default_rng(4).random(len(rows))
    level = water_levels(inside, rows, columns, heights, 1.0)
    assert len(np.unique(level[inside])) == 1 and level[inside][0] == pytest.approx(50.1, abs=0.05)


def test_the_nearest_values_that_never_fall():
    values, weights = np.array([1.0, 3.0, 2.0, 2.0, 5.0, 4.0]), np.array([1.0, 1.0, 1.0, 2.0, 1.0, 3.0])
    np.testing.assert_allclose(monotonic(values, weights), [1, 2.25, 2.25, 2.25, 4.25, 4.25])


def test_flat_water_says_that_it_was_not_matched(ground):
    level = np.full(SHAPE, np.nan, np.float32)
    level[LAKE] = 100.5
    made = flattened(surface(ground), level)
    assert (made.height[LAKE] == 100.5).all() and (made.source[LAKE] == Provenance.WATER).all()
    assert np.isnan(made.count[LAKE]).all() and np.isnan(made.error[LAKE]).all()
    land = np.isnan(level)
    np.testing.assert_array_equal(made.height[land], ground.astype(np.float32)[land])
    assert (made.source[land] == Provenance.MATCHED).all()
