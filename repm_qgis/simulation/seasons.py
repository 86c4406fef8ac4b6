"""Seasons: what a date makes of one and the same true surface.

**What is true.** A season moves no height. The true surface has crowns in leaf, as lidar sees them. Through the gaps
of a crown one sees what is below, and of a bare one little else, so an image shows of it either surface: where trees
shed their leaves, a height of the crown and one of the ground below it are both right. Snow, grass and crops are as
thin as the errors that matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Tuple, Union

import numpy as np
from scipy import ndimage, special

from ..contracts.arrays import FloatImage, Mask
from ..contracts.errors import OptionError
from ..contracts.parameters import Parameters
from .parameters import SIMULATION, LightParameters, SeasonParameters, SimulationParameters
from .surface import Cover, Ground, Sun, fractal, irradiance


@dataclass(frozen=True)
class Tone(Parameters):
    """How wetness, dirt and age change a kind of surface: albedos times ``gain`` plus ``offset``.

    ``own`` is the deviation of the texture that it has on this date alone, as a share of the albedo.
    """

    gain: float = 1.0
    offset: float = 0.0
    own: float = 0.0


@dataclass(frozen=True)
class Season(Parameters):
    """A date, and what it makes of the ground; reflectances are means of their kind, before its tone."""

    utc: str = "20150615104500"  # of the exposure, YYYYMMDDhhmmss; the sun stands where it does then
    leaves: float = 1.0  # share of their leaves that trees have that shed them
    grass: float = 0.09
    soil: float = 0.15
    winter_crops: float = 0.09  # sown in autumn: green in spring, stubble in late summer
    summer_crops: float = 0.15  # bare in spring, green in summer
    snow: float = 0.0  # share under snow of what is neither a street nor below a crown, in patches
    plants: Tone = Tone()
    soils: Tone = Tone()
    streets: Tone = Tone()
    roofs: Tone = Tone()

    def look_of(self, cover: Cover) -> Tuple[float, Tone]:
        """The mean reflectance of a cover, 0 where it keeps its own, and its tone."""
        plants = {Cover.GRASS: self.grass, Cover.WINTER_CROPS: self.winter_crops, Cover.SUMMER_CROPS: self.summer_crops}
        others = {Cover.SOIL: (self.soil, self.soils), Cover.STREET: (0.0, self.streets), Cover.ROOF: (0.0, self.roofs)}
        return others[cover] if cover in others else (plants.get(cover, 0.0), self.plants)


def sun_at(utc: str, lon: float, lat: float) -> Sun:
    """Where the sun stands over a place at YYYYMMDDhhmmss, within 0.1 degrees (Astronomical Almanac, page C5)."""
    days = (datetime.strptime(utc, "%Y%m%d%H%M%S") - datetime(2000, 1, 1, 12)).total_seconds() / 86400
    anomaly = math.radians(357.529 + 0.98560028 * days)
    along = math.radians(280.459 + 0.98564736 * days + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly))
    tilt = math.radians(23.439)
    ascension = math.atan2(math.cos(tilt) * math.sin(along), math.cos(along))
    declination = math.asin(math.sin(tilt) * math.sin(along))
    hour = math.radians(280.4606 + 360.9856474 * days + lon) - ascension
    phi = math.radians(lat)
    up = math.sin(phi) * math.sin(declination) + math.cos(phi) * math.cos(declination) * math.cos(hour)
    east = -math.cos(declination) * math.sin(hour)
    north = math.cos(phi) * math.sin(declination) - math.sin(phi) * math.cos(declination) * math.cos(hour)
    return Sun(math.degrees(math.atan2(east, north)) % 360, math.degrees(math.asin(up)))


def daylight(sun: Sun, light: LightParameters = SIMULATION.light) -> LightParameters:
    """Sunlight and skylight below the air that the sun shines through; those of ``light`` at the default sun's height.

    Beer's law for the sun; half of what the air takes from it comes down as light of the sky. Raises OptionError at
    night.
    """
    if sun.elevation_deg <= 0:
        raise OptionError("sun", round(sun.elevation_deg), "must stand above the horizon")
    usual, now = (math.sin(math.radians(each.elevation_deg)) for each in (Sun(), sun))
    depth = usual * math.log(1 + 2 * light.sky_share / usual)
    sky = 0.5 * now * (math.exp(depth / now) - 1)
    return replace(light, sun_dn=light.sun_dn * math.exp(depth / usual - depth / now), sky_share=sky)


def foliage(
    boughs: FloatImage,
    tone: Union[float, FloatImage],
    leaves: Union[float, FloatImage],
    own: SeasonParameters = SIMULATION.season,
) -> Tuple[Mask, FloatImage]:
    """Where a crown hides what is below it, and its albedo: Beer's law gives the share of gaps.

    ``boughs`` is normal noise, ``tone`` the albedo of leaves, and ``leaves`` the share of them that hang, 0..1.
    """
    index = own.leaf_area[1] + leaves * (own.leaf_area[0] - own.leaf_area[1])
    albedo = leaves * tone * (1 + 0.15 * boughs) + (1 - leaves) * own.bark
    return boughs > special.ndtri(np.exp(-index / 2)), np.clip(albedo, 0.02, 0.2)


def in_season(
    ground: Ground,
    below: Ground,
    season: Season,
    place: Tuple[float, float],
    seed: int,
    parameters: SimulationParameters = SIMULATION,
) -> Ground:
    """The ground as a season shows it; neither of both given ones is changed.

    ``below`` is the ground without trees, ``place`` longitude and latitude. The same seed has the same boughs on all
    dates; the texture and the snow of a date are the same for the same seed and day.
    """
    own, shape, cell = parameters.season, ground.height.shape, ground.cell
    boughs = fractal(np.random.default_rng([seed, 12]), shape, cell, own.bough_m, 0.0, 0.3)
    crown = ground.cover >= Cover.EVERGREEN
    leaves = np.where(ground.cover == Cover.SHEDDING, np.float32(season.leaves), np.float32(1))
    solid, leafage = foliage(boughs, ground.albedo, leaves, own)
    gap = crown & ~solid
    height = np.where(gap, below.height, ground.height)
    cover = np.where(gap, below.cover, ground.cover)
    albedo = np.where(gap, below.albedo, np.where(crown, leafage, ground.albedo))
    rng = np.random.default_rng([seed, 13, int(season.utc[:8])])
    texture = fractal(rng, shape, cell, own.own_m, 0.0, 0.3)
    for kind in Cover:
        here = cover == kind
        if here.any():
            mean, tone = season.look_of(kind)
            values = albedo[here]
            if mean:
                values *= np.float32(mean) / values.mean()
            albedo[here] = (tone.gain * values + tone.offset) * (1 + np.float32(tone.own) * texture[here])
    if season.snow:
        # Most where the noon sun does not come: in shadows and on slopes away from it. Streets are cleared.
        sun = noon(season.utc, place[0], place[1])
        direct = irradiance(height, cell, sun, parameters.town.wall_m, parameters.light)[0]
        cold = fractal(rng, shape, cell, own.snow_m[0], own.snow_m[1]) - own.snow_roof * (cover == Cover.ROOF)
        cold -= own.snow_sun / np.float32(sun.direction()[2]) * direct
        most = np.quantile(cold[~crown & (cover != Cover.STREET)], 1 - season.snow)
        white = (cold > most) & (cover != Cover.STREET) & (cover < Cover.EVERGREEN)
        albedo[white] = own.snow * (1 + np.float32(0.02) * texture[white])
    walls = np.where(ndimage.binary_dilation(crown, iterations=2), np.float32(0.07), ground.wall_albedo)
    albedo = np.clip(albedo, 0.02, 0.9).astype(np.float32)
    return replace(ground, height=height, albedo=albedo, wall_albedo=walls, cover=cover)


def noon(utc: str, lon: float, lat: float) -> Sun:
    """The sun of a day when it stands highest, within some minutes."""
    hours = (12.0 - lon / 15.0) % 24.0
    return sun_at(f"{utc[:8]}{int(hours):02d}{int(hours % 1 * 60):02d}00", lon, lat)
