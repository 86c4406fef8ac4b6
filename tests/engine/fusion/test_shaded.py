"""Ground in shadows: where they fall, and which heights they take."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from repm_qgis.fusion.aggregation import Candidate
from repm_qgis.fusion.parameters import FUSION
from repm_qgis.fusion.shaded import NOTHING, SUPPORTED, WEAK, Sun, cast_shadow, shaded_ground, support
from repm_qgis.geometry.sun import sun_position

CELL, GROUND, ROOF = 0.5, 20.0, 35.0
SUNS = [Sun(azimuth, elevation) for azimuth in (0.0, 37.0, 90.0, 155.0, 180.0, 243.0, 315.0) for elevation in (25, 50)]


HOUSE = np.s_[120:140, 130:150]


def behind(height, weak=False, filled=False):
    """What is behind heights of which some are weak and some are filled."""
    own = np.where(weak, WEAK, SUPPORTED)
    return np.where(np.isnan(height) | filled, NOTHING, own).astype(np.uint8)


def ground_of(height, weak=False, filled=False, sun=None, parameters=FUSION.shaded):
    return shaded_ground(height, behind(height, weak, filled), CELL, sun or SUN, parameters)


def town():
    """Level ground with one house of 15 m in the middle."""
    height = np.full((260, 280), GROUND, np.float32)
    height[HOUSE] = ROOF
    return height


def lit_by(height, sun, row, column):
    """Whether a ray from a cell to the sun passes over all heights, in steps of a tenth of a cell."""
    azimuth = math.radians(sun.azimuth)
    for steps in np.arange(0.5, 80, 0.2):
        r = int(round(row - steps * math.cos(azimuth)))
        c = int(round(column + steps * math.sin(azimuth)))
        if not (0 <= r < height.shape[0] and 0 <= c < height.shape[1]):
            return True
        if height[r, c] > height[row, column] + steps * CELL * math.tan(math.radians(sun.elevation)) + 0.5:
            return False
    return True


@pytest.mark.parametrize("sun", SUNS, ids=str)
@pytest.mark.slow
def test_shadows_fall_where_rays_to_the_sun_are_blocked(sun):
    height = town()
    shadow = cast_shadow(height, CELL, sun)
    part = np.s_[70:190, 70:210]
    places = [(r, c) for r in range(70, 190, 3) for c in range(70, 210, 3)]
    expected = np.array([not lit_by(height, sun, r, c) for r, c in places]).reshape(shadow[part][::3, ::3].shape)
    # Lines run through whole cells: a shadow's border may be one cell off.
    sure = minimum_filter(shadow, 3)[part][::3, ::3], maximum_filter(shadow, 3)[part][::3, ::3]
    assert expected.sum() > 30
    assert not (sure[0] & ~expected).any() and not (expected & ~sure[1]).any()
    assert not shadow[HOUSE].any()


@pytest.mark.parametrize("sun", SUNS, ids=str)
def test_what_is_empty_in_a_shadow_takes_the_ground_it_ends_on(sun):
    height = town()
    shadow = cast_shadow(height, CELL, sun)
    holed = np.where(shadow, np.float32(np.nan), height)
    holed[5:12, 5:12] = np.nan  # in the sun
    found = ground_of(holed, sun=sun)
    taken = np.isfinite(found)
    assert not taken[~shadow].any()
    assert taken.sum() > 0.85 * shadow.sum()
    assert found[taken] == pytest.approx(GROUND)


SUN = Sun(155.0, 36.0)


def ramp():
    """The town with a ramp from the roof down into the shadow, and where that is wrong."""
    height = town()
    shadow = cast_shadow(height, CELL, SUN)
    row = np.arange(height.shape[0])[:, None] * np.ones(height.shape)
    wrong = np.where(shadow, np.maximum(ROOF - 1.4 * CELL * (120 - row), GROUND), height).astype(np.float32)
    return wrong, shadow & (wrong > GROUND + 1)


def test_a_ramp_that_the_images_do_not_support_gives_way_to_the_ground():
    wrong, false = ramp()
    assert false.sum() > 300
    found = ground_of(wrong, weak=false)
    mended = np.where(np.isfinite(found), found, wrong)
    assert (np.abs(mended - town())[false] < 0.5).mean() > 0.9
    untouched = np.isnan(found)
    assert untouched[~false].all()


def test_a_ramp_that_is_well_supported_stays():
    wrong, false = ramp()
    assert np.isnan(ground_of(wrong)).all()


def test_rays_are_the_same_in_every_part_of_a_dsm():
    """Lines run through whole cells, which must be the same ones whatever part is asked for."""
    height = town()
    whole = cast_shadow(height, CELL, Sun(151.3, 36.0))
    part = cast_shadow(height[33:251, 41:262], CELL, Sun(151.3, 36.0), first=(33, 41))
    assert whole.sum() > 500
    np.testing.assert_array_equal(part, whole[33:251, 41:262])


def test_on_slopes_hardly_anything_is_filled_and_nothing_wrongly():
    slope = np.float32(0.25) * np.arange(280, dtype=np.float32)[None, :]  # half a metre for each metre
    hill = town() + slope
    holed = np.where(cast_shadow(hill, CELL, SUN), np.float32(np.nan), hill)
    assert np.isnan(holed).sum() > 1000
    found = ground_of(holed)
    taken = np.isfinite(found)
    # Beside the house slope and wall may look level together.
    assert taken.sum() < 0.01 * np.isnan(holed).sum()
    assert np.abs(found - hill)[taken] == pytest.approx(0.0, abs=0.5)


def test_what_matching_filled_with_a_roof_gives_way_to_the_ground():
    height = town()
    shadow = cast_shadow(height, CELL, SUN)
    height[shadow] = ROOF - 3.0
    found = ground_of(height, filled=shadow)
    assert (found[shadow] == GROUND).mean() > 0.85
    assert np.isnan(found[~shadow]).all()


COURT = np.s_[105:120, 126:142]


def walled(sure_rows):
    """A court to the north of the house, wholly in its shadow, behind a lower house: only some of its rows are known,
    beside that one."""
    height = town()
    height[90:105, 100:180] = GROUND + 8.0
    holed = height.copy()
    holed[COURT] = np.nan
    holed[105 : 105 + sure_rows, 126:142] = GROUND
    assert cast_shadow(height, CELL, SUN)[COURT].all()
    return holed


def test_ground_that_the_images_support_in_the_shadow_goes_on_in_it():
    found = ground_of(walled(6))[COURT]
    assert np.isfinite(found).mean() > 0.4
    assert found[np.isfinite(found)] == pytest.approx(GROUND)


def test_single_cells_follow_those_around_them():
    height = town()
    shadow = cast_shadow(height, CELL, SUN)
    height[0:70] = np.where(np.arange(280) % 12 == 0, GROUND - 6.0, GROUND)  # slots in the ground where shadows end
    height[40:120][shadow[40:120]] = np.nan
    found = ground_of(height)
    inner = minimum_filter(shadow, 9) & np.isfinite(found)
    assert inner.sum() > 200
    assert (found[inner] == GROUND).all()


def test_nothing_is_known_beyond_the_border():
    height = town()
    holed = np.where(cast_shadow(height, CELL, SUN), np.float32(np.nan), height)
    holed[:, :140] = np.nan
    found = ground_of(holed)
    assert np.isnan(found[:, :140]).all()
    assert np.isfinite(found[:, 145:]).any()


def test_a_shadow_whose_end_lies_beyond_the_reach_stays_empty():
    height = town()
    holed = np.where(cast_shadow(height, CELL, SUN), np.float32(np.nan), height)
    near = replace(FUSION.shaded, reach_m=2.0)
    far, close = (ground_of(holed, parameters=p) for p in (FUSION.shaded, near))
    assert np.isfinite(close).sum() < 0.5 * np.isfinite(far).sum()


def test_only_single_heights_with_a_low_score_are_weak():
    height = np.array([[1.0, 1, 1, 1, np.nan]])
    count = np.array([[1, 1, 2, 0, 0]], np.uint8)
    score = np.array([[0.5, 0.95, 0.5, np.nan, np.nan]])
    first = Candidate(height, *(np.ones((1, 5)) for _ in range(2)), count, np.full((1, 5), np.nan), score)
    assert support(first).tolist() == [[WEAK, SUPPORTED, SUPPORTED, NOTHING, NOTHING]]


def scene(*times):
    views = [SimpleNamespace(time=time) for time in times]
    return SimpleNamespace(frame=SimpleNamespace(lon=-81.66, lat=30.33), views=views)


def test_the_sun_is_the_mean_over_the_scene_seen_from_the_grids_north():
    noon = datetime(2015, 1, 21, 16, 12, tzinfo=timezone.utc)
    azimuth, elevation = sun_position(noon, -81.66, 30.33)
    sun = Sun.over(scene(noon, None, noon), "EPSG:32617")
    # West of the middle of its zone, the grid's north lies east of true north by (lon - lon0) sin(lat).
    assert sun.azimuth == pytest.approx(azimuth - (-81.66 + 81) * math.sin(math.radians(30.33)), abs=0.02)
    assert sun.elevation == pytest.approx(elevation, abs=1e-6)
    both = Sun.over(scene(noon, noon + timedelta(hours=2)), "EPSG:32617")
    assert sun.azimuth < both.azimuth < sun.azimuth + 30


def test_without_times_or_under_a_low_sun_there_is_none():
    assert Sun.over(scene(None, None), "EPSG:32617") is None
    assert Sun.over(scene(datetime(2015, 1, 21, 12, 40, tzinfo=timezone.utc)), "EPSG:32617") is None
