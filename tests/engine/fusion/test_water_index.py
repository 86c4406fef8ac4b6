"""The index of water: where its threshold lies, and when there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.fusion.parameters import FUSION
from repm_qgis.fusion.water_index import Colours, otsu, water_threshold, wet_above

RNG = np.random.default_rng(3)
PLANTS, BARE = RNG.normal(-0.55, 0.08, 6000), RNG.normal(-0.1, 0.06, 4000)
LAND = np.concatenate([PLANTS, BARE])
SHADOWS = RNG.normal(0.05, 0.12, 1500)
WATER = RNG.normal(0.55, 0.06, 1200)
LEAST = 300.0


def test_otsus_cut_is_that_of_the_greatest_variance_between_its_parts():
    values = np.linspace(-1.0, 1.0, 60)
    frequencies = np.exp(-(((values + 0.4) / 0.15) ** 2)) + 0.6 * np.exp(-(((values - 0.5) / 0.1) ** 2))

    def between(cut):
        parts = (frequencies[:cut], values[:cut]), (frequencies[cut:], values[cut:])
        weights, means = zip(*((f.sum(), (f * v).sum() / f.sum()) for f, v in parts))
        return weights[0] * weights[1] * (means[0] - means[1]) ** 2

    best = max(range(1, 60), key=between)
    assert otsu(frequencies, values) == best and -0.2 < values[best] < 0.3
    assert otsu(np.array([0.0, 5.0, 0.0]), np.array([1.0, 2.0, 3.0])) == 0, "one value has no parts"


@pytest.mark.parametrize("calibrated", (True, False))
def test_water_stands_above_plants_bare_ground_and_shadows(calibrated):
    threshold = water_threshold(LAND, np.concatenate([SHADOWS, WATER]), LEAST, calibrated)
    assert (WATER > threshold).mean() > 0.97 and (SHADOWS > threshold).mean() < 0.03


@pytest.mark.parametrize(
    "empty", [SHADOWS, PLANTS[:1500], np.concatenate([SHADOWS, WATER[:100]])], ids=["shadows", "plants", "too little"]
)
def test_without_water_there_is_no_threshold(empty):
    assert water_threshold(LAND, empty, LEAST, True) is None
    assert water_threshold(LAND, empty, LEAST, False) is None


def test_reflectances_of_water_are_never_below_zero():
    """The same numbers, lower by what gains of the bands could do: without a calibration they may be water."""
    empty = np.concatenate([SHADOWS, WATER]) - 0.62
    assert water_threshold(LAND - 0.62, empty, LEAST, True) is None
    assert -0.5 < water_threshold(LAND - 0.62, empty, LEAST, False) < -0.1


def test_what_is_bright_in_the_infrared_is_no_water():
    shape = (100, 100)
    index = RNG.normal(-0.3, 0.1, shape).astype(np.float32)
    index[:, 70:] = RNG.normal(0.5, 0.05, (100, 30))  # a lake, and a cloud above its lower half
    infrared = np.full(shape, 800.0, np.float32) + RNG.normal(0, 50, shape).astype(np.float32)
    infrared[:50, 70:], infrared[50:, 70:] = 60.0, 3000.0
    empty = np.zeros(shape, bool)
    empty[:, 70:] = True
    wet, threshold = wet_above(index, infrared, ~empty, empty, 1.0, True)
    assert wet[:50, 70:].all() and not wet[50:].any() and not wet[:, :70].any() and 0.0 < threshold < 0.4
    none, nothing = wet_above(index, infrared, ~empty, empty, 1.0, True, replace(FUSION.water, least_m2=1e9))
    assert nothing is None and not none.any()


LAKE, SHADE, TARMAC = np.s_[10:60, 10:70], np.s_[90:150, 20:70], np.s_[80:140, 120:180]


def ground(lake_dn=(322.0, 53.0), dim=None):
    """Colours by the light that falls on ground and the air's: (green, near infrared) of a lake, a large patch of shade
    without texture, tarmac, and all around them plants and bare ground of many tones, half of it in shade."""
    shape, rng = (200, 220), np.random.default_rng(8)
    air, sun, sky = np.array([130.0, 35.0]), np.array([4500.0, 3400.0]), np.array([1250.0, 500.0])
    tone = rng.uniform(0.05, 0.3, shape)
    shaded = np.add.outer(np.arange(shape[0]) // 10, np.arange(shape[1]) // 10) % 2 == 0
    light = np.where(shaded[..., None], sky, sun + sky)
    plants = np.add.outer(np.arange(shape[0]) // 40, np.arange(shape[1]) // 40) % 2 == 0
    own = np.where(plants[..., None], [0.6, 3.0], [1.0, 1.15])
    bands = air + tone[..., None] * own * light
    bands[SHADE] = air + 0.14 * np.array([1.0, 1.15]) * sky
    bands[TARMAC] = air + 0.045 * np.array([1.0, 1.15]) * (sun + sky)
    if dim is not None:  # nothing else is so dark
        bright = np.ones(shape, bool)
        for part in (LAKE, SHADE, TARMAC):
            bright[part] = False
        bands[bright] += dim
    bands[LAKE] = lake_dn
    bands += np.sqrt(0.2 * bands) * rng.standard_normal(bands.shape)
    total = bands.sum(axis=-1)
    index = (bands[..., 0] - bands[..., 1]) / total
    bodies = np.zeros(shape, bool)
    for part in (LAKE, SHADE, TARMAC):
        bodies[part] = True
    return Colours(*(each.astype(np.float32) for each in (index, bands[..., 1], total))), bodies


@pytest.mark.parametrize("lake_dn", [(322.0, 53.0), (660.0, 155.0), (410.0, 105.0)], ids=["clear", "murky", "glint"])
def test_shade_and_tarmac_have_the_index_of_other_dark_ground_and_water_has_not(lake_dn):
    colours, bodies = ground(lake_dn)
    gone = colours.shaded(bodies, ~bodies, 1.0)
    assert gone[SHADE].all() and gone[TARMAC].all() and not gone[LAKE].any()
    assert gone.sum() == 50 * 60 + 60 * 60


def test_where_nothing_else_is_as_dark_and_where_no_colours_are_known_a_body_stays():
    colours, bodies = ground(dim=np.array([900.0, 900.0]))
    assert not colours.shaded(bodies, ~bodies, 1.0).any()
    colours, bodies = ground()
    blind = colours.index.copy()
    blind[SHADE] = np.nan
    gone = replace(colours, index=blind).shaded(bodies, ~bodies, 1.0)
    assert not gone[SHADE].any() and gone[TARMAC].all()


def test_ground_beside_a_body_says_nothing_of_it():
    """A lake with a rim of mixed pixels, which are as dark as it is and have nearly its index."""
    colours, bodies = ground()
    index, total = colours.index.copy(), colours.total.copy()
    near = np.zeros(bodies.shape, bool)
    near[4:66, 4:76] = True
    near[LAKE] = False
    index[near], total[near] = colours.index[LAKE][0, 0], np.median(colours.total[LAKE])
    gone = replace(colours, index=index, total=total).shaded(bodies, ~bodies, 1.0)
    assert not gone[LAKE].any() and gone[SHADE].all()
