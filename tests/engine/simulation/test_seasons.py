"""Seasons: the sun, snow, leaves and tones against what is known of them, and the surface that they must not change."""

import math
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from benchmarks.simulated.dates import WORLDVIEW3_JACKSONVILLE
from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import OptionError
from repm_qgis.imagery.acquisition import acquired
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.parameters import SIMULATION
from repm_qgis.simulation.scene import SceneSpec, make_ground, make_scene
from repm_qgis.simulation.seasons import Season, Tone, daylight, in_season, noon, sun_at
from repm_qgis.simulation.sensor import PLEIADES
from repm_qgis.simulation.surface import Cover, Ground, Sun

PLACE = (1.44, 43.60)
WINTER = Season("20141214110000", leaves=0.0, grass=0.13, snow=0.3, soils=Tone(0.6, 0.01, 0.1))
SUMMER = Season("20150521110000")
SPEC = SceneSpec("urban", 320, 3, replace(PLEIADES, looks=PLEIADES.looks[::2]), 0.5, 1, base_m=190.0, relief_m=0.0)


def test_the_sun_stands_where_the_metadata_of_real_images_say():
    for one in WORLDVIEW3_JACKSONVILLE:
        sun = sun_at(one.utc, -81.663, 30.316)
        assert sun.elevation_deg == pytest.approx(one.sun.elevation_deg, abs=0.4)
        assert sun.azimuth_deg == pytest.approx(one.sun.azimuth_deg, abs=1.5)  # it turns fast where it stands high


def test_noon_is_the_highest_sun_of_a_day():
    days = ("20150621", 90 - 43.6 + 23.44, 180.0), ("20141221", 90 - 43.6 - 23.44, 180.0)
    for day, elevation, azimuth in days:
        sun = noon(day + "000000", *PLACE)
        assert sun.elevation_deg == pytest.approx(elevation, abs=0.2) and sun.azimuth_deg == pytest.approx(
            azimuth, abs=5
        )
    assert noon("20150621000000", 151.2, -33.9).azimuth_deg % 359 < 5  # in the north


def test_a_low_sun_has_less_light_and_the_sky_a_greater_share_of_it():
    usual, low = daylight(Sun()), daylight(Sun(180.0, 20.0))
    assert usual.sun_dn == pytest.approx(SIMULATION.light.sun_dn)
    assert usual.sky_share == pytest.approx(SIMULATION.light.sky_share)
    # Diffuse over global light of a clear sky: some 0.2 at 48 degrees, and twice as much at 20.
    diffuse = [one.sky_share / (one.sky_share + math.sin(math.radians(e))) for one, e in ((usual, 48), (low, 20))]
    assert diffuse[0] == pytest.approx(0.22, abs=0.03) and 1.6 < diffuse[1] / diffuse[0] < 3
    assert low.sun_dn < 0.75 * usual.sun_dn
    with pytest.raises(OptionError, match="sun"):
        daylight(sun_at("20141214230000", *PLACE))


@pytest.fixture(scope="module", params=["urban", "farmland"])
def grounds(request):
    bounds = Bounds(374000.0, 4828500.0, 374280.0, 4828760.0)
    bare = {name: replace(getattr(SIMULATION, name), trees=False) for name in ("town", "farmland")}
    sets = SIMULATION, replace(SIMULATION, **bare)
    return [make_ground(replace(SPEC, kind=request.param), bounds, Silent(), each) for each in sets]


def test_a_season_changes_no_true_height_and_shows_crowns_or_what_is_below_them(grounds):
    ground, below = grounds
    kept = [layer.copy() for one in grounds for layer in (one.height, one.albedo, one.wall_albedo, one.cover)]
    crown = ground.cover >= Cover.EVERGREEN
    assert 0.01 < crown.mean() < 0.6 and not (below.cover >= Cover.EVERGREEN).any()
    for season, plants in ((WINTER, 0.9), (replace(WINTER, leaves=1.0), 4.0)):
        dated = in_season(ground, below, season, PLACE, 3)
        assert ((dated.height == ground.height) | (crown & (dated.height == below.height))).all()
        shed = ground.cover == Cover.SHEDDING
        assert (dated.cover[shed] != Cover.SHEDDING).mean() == pytest.approx(math.exp(-plants / 2), abs=0.06)
        green = ground.cover == Cover.EVERGREEN
        assert (dated.cover[green] != Cover.EVERGREEN).mean() == pytest.approx(math.exp(-2), abs=0.06)
    now = [layer for one in grounds for layer in (one.height, one.albedo, one.wall_albedo, one.cover)]
    assert all(np.array_equal(*layers) for layers in zip(kept, now))


def test_snow_has_the_share_asked_for_and_lies_on_no_street(grounds):
    ground, below = grounds
    crown = ground.cover >= Cover.EVERGREEN
    for share in (0.1, 0.4):
        white, without = (in_season(ground, below, replace(WINTER, snow=s), PLACE, 3) for s in (share, 0.0))
        snow = white.albedo > 0.6
        assert snow[~crown & (ground.cover != Cover.STREET)].mean() == pytest.approx(share, abs=0.01)
        assert not (snow & (white.cover == Cover.STREET)).any()
        assert np.array_equal(white.albedo[~snow], without.albedo[~snow])
        # In patches: most of its neighbours are white as well.
        assert snow[:, 1:][snow[:, :-1]].mean() > 0.85


def test_snow_lies_in_the_shade_and_on_northern_slopes():
    rows, cols = np.mgrid[:400, :400]
    ground = Ground.empty(Bounds(0.0, 0.0, 399.0, 399.0), 1.0)
    ground.height[:] = 20 * np.abs(rows - 200) / 50  # a valley: its southern slope looks north, its northern one south
    ground.height[195:205, 100:110] += 40
    ground.albedo[:] = 0.1
    snow = in_season(ground, ground, WINTER, PLACE, 1).albedo > 0.6
    north, south = snow[230:], snow[:170]
    assert snow.mean() == pytest.approx(0.3, abs=0.01) and north.mean() > 3 * south.mean()
    sun = noon(WINTER.utc, *PLACE)
    level = replace(ground, height=np.where((np.abs(rows - 200) < 5) & (np.abs(cols - 200) < 100), 30, 0).astype("f4"))
    snow = in_season(level, level, WINTER, PLACE, 1).albedo > 0.6
    reach = int(30 / math.tan(math.radians(sun.elevation_deg)))
    shaded, free = snow[195 - reach + 5 : 193, 120:280], snow[210 : 210 + reach, 120:280]
    assert shaded.mean() > 0.3 + free.mean()


def test_the_shadow_of_a_block_is_as_long_as_the_season_s_sun_makes_it():
    for season in (replace(WINTER, snow=0.0), SUMMER):
        ground = Ground.empty(Bounds(0.0, 0.0, 199.5, 199.5), 0.5)
        ground.albedo[:] = 0.1
        ground.height[195:206, 195:206] = 20.0
        sun = sun_at(season.utc, *PLACE)
        seen = in_season(ground, ground, season, PLACE, 1).finish("EPSG:32631", sun, 0.9, daylight(sun))
        level = seen.radiance[ground.height == 0]
        half = 0.5 * (np.median(level) + level.min())
        rows, cols = np.nonzero((seen.radiance < half) & (ground.height == 0))
        towards = math.radians(sun.azimuth_deg)
        away = -((cols - 200) * math.sin(towards) + (200 - rows) * math.cos(towards)) * 0.5
        aside = ((cols - 200) * math.cos(towards) - (200 - rows) * math.sin(towards)) * 0.5
        edge = 2.75 / max(abs(math.sin(towards)), abs(math.cos(towards)))
        assert away.max() == pytest.approx(edge + 20.0 / math.tan(math.radians(sun.elevation_deg)), abs=1.2)
        assert away.min() > -2.75 * math.sqrt(2) and np.abs(aside).max() < 2.75 * math.sqrt(2) + 0.75


def test_grounds_have_the_reflectance_and_the_tone_asked_for(grounds):
    ground, below = grounds
    dated = in_season(ground, below, replace(WINTER, snow=0.0, streets=Tone(0.8)), PLACE, 3)
    wanted = {Cover.GRASS: 0.13, Cover.SOIL: 0.6 * 0.15 + 0.01, Cover.WINTER_CROPS: 0.09}
    for kind, albedo in wanted.items():
        here = dated.cover == kind
        if here.any():
            assert dated.albedo[here].mean() == pytest.approx(albedo, rel=0.03)
    street = (ground.cover == Cover.STREET) & (dated.cover == Cover.STREET)
    np.testing.assert_allclose(dated.albedo[street], 0.8 * ground.albedo[street], rtol=1e-5)


def test_the_same_seed_and_day_have_the_same_bytes_and_others_have_others(grounds):
    season = replace(WINTER, plants=Tone(own=0.1))
    later = replace(season, utc="20141215110000")
    one, again, other, next_day = (
        in_season(*grounds, each, PLACE, seed) for each, seed in ((season, 3), (season, 3), (season, 4), (later, 3))
    )
    assert one.albedo.tobytes() == again.albedo.tobytes() and one.height.tobytes() == again.height.tobytes()
    assert (one.albedo != other.albedo).mean() > 0.1 and (one.albedo != next_day.albedo).mean() > 0.1
    assert np.array_equal(one.height, next_day.height)  # boughs stay


@pytest.mark.long
def test_scenes_of_other_seasons_have_other_images_of_the_same_truth(tmp_path):
    parameters = replace(SIMULATION, render=replace(SIMULATION.render, oversample=1))
    for name, seasons in (("a", (WINTER, SUMMER)), ("b", (SUMMER, SUMMER)), ("c", ())):
        make_scene(replace(SPEC, seasons=seasons), str(tmp_path / name), Silent(), parameters)
    truths = [(tmp_path / name / "truth.tif").read_bytes() for name in "abc"]
    assert truths[0] == truths[1] == truths[2]
    images = {name: gdal.Open(str(tmp_path / name / "img_01.tif")) for name in "ab"}
    assert acquired(images["a"], "").startswith("2014-12-14T11:00:00")
    assert (images["a"].ReadAsArray() != images["b"].ReadAsArray()).mean() > 0.9
    last = [(tmp_path / name / "img_02.tif").read_bytes() for name in "ab"]
    assert last[0] == last[1]
    truth, bare = (gdal.Open(str(tmp_path / "a" / f"{name}.tif")).ReadAsArray() for name in ("truth", "bare"))
    assert not (tmp_path / "c" / "bare.tif").exists()
    crowns = truth != bare
    assert 0.01 < crowns.mean() < 0.3 and (truth[crowns] > bare[crowns] - 1.5).all()
