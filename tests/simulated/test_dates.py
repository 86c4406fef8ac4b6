"""Scenes of many dates: each effect against what it must do to the ground, the light or the pixels."""

import csv
import math
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from benchmarks.simulated.chips import pansharpened, toned
from benchmarks.simulated.dates import (
    WORLDVIEW3,
    WORLDVIEW3_JACKSONVILLE,
    DatedSpec,
    aimed,
    band_surfaces,
    make_dated_scene,
    to_satellite,
)
from benchmarks.simulated.district import CAR, GRASS, METAL, SHEDDING, Date, District
from benchmarks.simulated.parameters import DATED, REAL, EffectParameters
from repm_qgis.contracts.arrays import Bounds
from repm_qgis.geometry.frames import projected_from_geodetic
from repm_qgis.imagery.acquisition import acquired
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.surface import Ground, Sun, irradiance

OWN = DATED.district
WINTER, SUMMER = Date(735000, 100, 20), Date(735180, 100, 200)


@pytest.fixture(scope="module")
def district():
    ground = Ground.empty(Bounds(0.0, 0.0, 150.0, 130.0), 0.25)
    return District(ground, -20.0, 3, Silent())


def _box(tall=20.0, cell=0.25, side=600):
    height = np.zeros((side, side), np.float32)
    height[280:321, 280:321] = tall
    return height, cell


@pytest.mark.parametrize("azimuth, elevation", [(90.0, 40.0), (180.0, 60.0), (270.0, 33.5)])
def test_the_shadow_of_a_box_has_its_length_away_from_the_sun(azimuth, elevation):
    height, cell = _box()
    light = replace(DATED.light, sun_disc_deg=REAL.sun_disc_deg)
    direct, _, _ = irradiance(height, cell, Sun(azimuth, elevation), 0.9, light)
    full = math.sin(math.radians(elevation))
    assert direct[10, 10] == pytest.approx(full, rel=0.01)  # level ground sees the whole sun
    dark = (direct < full / 2) & (height == 0)
    right, down = -math.sin(math.radians(azimuth)), math.cos(math.radians(azimuth))
    rows, cols = np.nonzero(dark)
    away = (cols - 300) * right + (rows - 300) * down
    assert away.max() * cell == pytest.approx(41 * cell / 2 + 20.0 / math.tan(math.radians(elevation)), abs=0.6)
    assert away.min() > 0


def test_the_edge_of_a_shadow_is_as_wide_as_the_sun_s_disc_makes_it():
    height, cell = _box(40.0, 0.25, 900)
    sun, widths = Sun(270.0, 40.0), {}
    for disc in (0.0, 0.53):
        direct, _, _ = irradiance(height, cell, sun, 0.9, replace(DATED.light, sun_disc_deg=disc))
        line = direct[300, 330:] / math.sin(math.radians(40.0))
        widths[disc] = ((line > 0.02) & (line < 0.98)).sum() * cell
    # d(h / tan e) / de = h / sin^2 e
    assert widths[0.53] == pytest.approx(40 * math.radians(0.53) / math.sin(math.radians(40.0)) ** 2, abs=0.5)
    assert widths[0.0] < 0.6


def test_each_image_has_the_sun_of_its_own_time(district):
    ground, material = district.dated(SUMMER, EffectParameters())
    sight, seen = np.array([0.0, 0.0, 1.0]), []
    for sun in (Sun(100.0, 40.0), Sun(250.0, 40.0)):
        seen.append(band_surfaces("EPSG:32617", ground, material, sun, sight, DATED)[1].radiance)
    assert (np.abs(seen[0] - seen[1]) > 0.5 * np.minimum(*seen)).mean() > 0.05


def test_grass_is_dry_and_trees_are_thin_in_winter(district):
    effects = replace(REAL, moving_cars=False)
    (summer, kinds), (winter, others) = (district.dated(date, effects) for date in (SUMMER, WINTER))
    grass = (kinds == GRASS) & (others == GRASS)
    ratio = winter.albedo[grass] / summer.albedo[grass]
    assert np.median(ratio) == pytest.approx(1 + 0.75 * (OWN.dry_grass - 1), rel=0.01)
    assert (others == SHEDDING).sum() < 0.6 * (kinds == SHEDDING).sum()
    evergreen = (kinds == SHEDDING - 1).sum()
    assert abs((others == SHEDDING - 1).sum() - evergreen) < 0.05 * evergreen
    still = [district.dated(date, replace(effects, seasons=0.0))[0] for date in (SUMMER, WINTER)]
    assert np.array_equal(still[0].albedo, still[1].albedo) and np.array_equal(still[0].height, still[1].height)


def test_rough_crowns_have_gaps_and_each_its_own_shape(district):
    found = [(tree, district.crown(tree, True)) for tree in district.trees]
    trees = [tree for tree, crown in found if crown and crown[2].sum() > 200]
    for tree in trees[:4]:
        (_, smooth, under), (area, rough, parts) = (district.crown(tree, kind) for kind in (False, True))
        steps = [np.abs(np.diff(top, axis=1))[on[:, 1:]].mean() for top, on in ((rough, parts), (smooth, under))]
        assert steps[0] > 1.3 * steps[1]
    ground, kinds = district.dated(SUMMER, replace(REAL, moving_cars=False))
    crown = np.zeros(kinds.shape, bool)
    for tree in district.trees:
        found = district.crown(tree, True)
        if found:
            crown[found[0]] |= found[2]
    crown &= kinds != CAR
    leaves = np.isin(kinds, (SHEDDING - 1, SHEDDING))
    assert 1 - leaves[crown].mean() == pytest.approx(math.exp(-DATED.season.leaf_area[0] / 2), abs=0.06)  # Beer's law
    top, classes = district.truth(SUMMER, REAL)
    assert (top[crown] >= ground.height[crown] - 1e-3).all() and (classes[crown] == 5).all()
    shapes = [district.crown(replace(trees[0], seed=seed), True)[1] for seed in (1, 2)]
    assert np.abs(shapes[0] - shapes[1]).max() > 1


def test_metal_roofs_shine_where_the_mirrored_sun_is_near(district):
    ground, material = district.dated(SUMMER, EffectParameters())
    sun = Sun(150.0, 50.0)
    east, north, up = sun.direction()
    mirror, elsewhere = np.array([-east, -north, up]), np.array([east, north, up])
    every = replace(DATED, effects=replace(EffectParameters(), gloss=1.0))
    roof = (material == METAL) & (_level(ground.height))
    lit = {}
    for name, sight in (("mirror", mirror), ("elsewhere", elsewhere)):
        for amount in (every, DATED):
            radiance = band_surfaces("EPSG:32617", ground, material, sun, sight, amount)[1].radiance
            lit[name, amount is every] = float(np.median(radiance[roof]))
    assert lit["mirror", True] > 1.3 * lit["mirror", False]
    assert lit["elsewhere", True] < 1.05 * lit["elsewhere", False]


def _level(height):
    flat = np.ones(height.shape, bool)
    flat[1:] &= np.abs(np.diff(height, axis=0)) < 0.05
    flat[:, 1:] &= np.abs(np.diff(height, axis=1)) < 0.05
    return flat


def test_parked_cars_change_from_day_to_day_and_moving_ones_from_image_to_image(district):
    later = replace(SUMMER, moment=111)
    other = replace(SUMMER, day=SUMMER.day + 1)
    first, soon, next_day = ((district.dated(date, REAL)[1] == CAR) for date in (SUMMER, later, other))
    assert 0.02 < (first != soon).sum() / first.sum() < (first != next_day).sum() / first.sum()
    assert (first & next_day).sum() < 0.8 * first.sum()
    fixed = [district.dated(date, replace(REAL, moving_cars=False))[1] == CAR for date in (SUMMER, other)]
    assert np.array_equal(*fixed)


def test_colours_are_as_coarse_as_the_vendor_s_and_the_grey_is_sharp():
    quiet = replace(WORLDVIEW3, read_noise_dn=0.0, photon_gain=0.0)
    fine = np.full((256, 256), 800.0, np.float32)
    red, blue = fine.copy(), fine.copy()
    red[:, 128:], blue[:, 128:] = 1600.0, 400.0
    own = replace(OWN, colour_noise_dn=0.0)
    rise = {}
    for ratio in (1, 4):
        effects = replace(EffectParameters(), colour_ratio=ratio)
        chip = pansharpened([red, fine, blue], quiet, 2, np.random.default_rng(0), own, effects)
        hue = (chip[0] / chip[2])[64]
        rise[ratio] = ((hue > 1.2) & (hue < 3.8)).sum()
    assert rise[4] >= 3 * rise[1]
    grey = np.where(np.arange(256) < 128, 800.0, 1600.0).astype(np.float32)
    step = np.broadcast_to(grey, (256, 256))
    sharp, coarse, blurred = (
        pansharpened([step] * 3, quiet, 2, np.random.default_rng(0), own, replace(EffectParameters(), **change))
        for change in ({}, {"colour_ratio": 4}, {"chip_blur_px": 1.0})
    )
    assert np.abs(sharp - coarse)[:, 16:-16, 16:-16].max() < 1.0  # grey things stay sharp
    assert np.abs(np.diff(blurred[0, 64])).max() < 0.8 * np.abs(np.diff(sharp[0, 64])).max()


def test_the_tone_curve_has_a_gamma_and_saturates():
    band = np.linspace(200.0, 3000.0, 10000, dtype=np.float32).reshape(100, 100)
    chip = toned(np.stack([band] * 3), OWN)
    assert chip.dtype == np.uint8 and chip.min() >= 1
    assert (chip[0] == 255).mean() == pytest.approx(1 - OWN.tone_white, abs=0.01)
    black = OWN.tone_black * np.quantile(band, 0.002)
    share = (band[50, 0] - black) / (np.quantile(band, OWN.tone_white) - black)
    assert chip[0, 50, 0] == pytest.approx(255 * share ** (1 / OWN.tone_gamma), abs=1)


def test_views_are_those_of_the_acquisitions():
    spec = DatedSpec()
    for number in (0, 3, 8, 13):
        one = WORLDVIEW3_JACKSONVILLE[number]
        east, north, up = to_satellite(aimed(spec, one, number + 1), (spec.lon, spec.lat, spec.base_m))
        assert math.degrees(math.acos(up)) == pytest.approx(one.incidence_deg, abs=0.05)
        assert math.degrees(math.atan2(east, north)) % 360 == pytest.approx(one.azimuth_deg, abs=0.2)


def test_times_and_suns_are_those_of_the_real_images(shared_data):
    table = shared_data / "jax_068" / "acquisitions.csv"
    if not table.exists():
        pytest.skip(f"'{table}' is not there: the built-in table is not compared with it")
    with open(table, encoding="utf-8", newline="") as stream:
        rows = [(r["utc"], float(r["sun_azimuth_deg"]), float(r["sun_elevation_deg"])) for r in csv.DictReader(stream)]
    assert rows == [(one.utc, one.sun.azimuth_deg, one.sun.elevation_deg) for one in WORLDVIEW3_JACKSONVILLE]


@pytest.mark.long
def test_a_scene_on_disk_is_whole_and_the_same_again(tmp_path):
    spec = DatedSpec(side_m=60.0, acquisitions=WORLDVIEW3_JACKSONVILLE[:2])
    made = [make_dated_scene(spec, str(tmp_path / name), Silent(), replace(DATED, effects=REAL)) for name in "ab"]
    for first, again in zip(made[0]["images"], made[1]["images"]):
        dataset = gdal.Open(first)
        assert dataset.RasterCount == 3 and dataset.GetMetadata("RPC")
        assert np.array_equal(dataset.ReadAsArray(), gdal.Open(again).ReadAsArray())
        assert acquired(dataset, first).startswith("2014-10-05T16:01")
    truth = gdal.Open(made[0]["truth"])
    assert truth.RasterXSize == 120
    west, cell, _, north, _, _ = truth.GetGeoTransform()
    target = projected_from_geodetic("EPSG:32617", np.array([[spec.lon, spec.lat, 0.0]]))[0]
    assert np.abs(np.array([west + 60 * cell, north - 60 * cell]) - target[:2]).max() < 0.5  # all images see the square
    plain = make_dated_scene(spec, str(tmp_path / "c"), Silent())
    assert gdal.Open(plain["images"][0]).GetRasterBand(1).DataType == gdal.GDT_UInt16
