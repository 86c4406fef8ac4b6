"""Choices of scenes of many dates, beside those of all simulations: what makes their images differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from repm_qgis.contracts.parameters import Parameters
from repm_qgis.simulation.parameters import SimulationParameters, TownParameters


@dataclass(frozen=True)
class EffectParameters(Parameters):
    """What makes images of different dates differ; with the defaults nothing does. ``REAL`` has the real values."""

    moving_sun: bool = False  # each image has the sun of its own time; else all have the first one's
    sun_disc_deg: float = 0.0  # the sun's diameter, which makes the edges of shadows soft; 0 is a point
    seasons: float = 0.0  # share of the year's change of grass and of trees that shed their leaves
    rough_crowns: bool = False  # trees of many boughs with gaps between them; else half ellipsoids
    gloss: float = 0.0  # of the mirror-like part of roofs and cars, as a share of a real one
    moving_cars: bool = False  # each day has its own parked cars, each image its own moving ones
    colour_ratio: int = 1  # GSD of the colours over that of the panchromatic band; 1: colours as sharp as it
    chip_blur_px: float = 0.0  # deviation of the blur that the vendor's resampling adds
    tone_curve: bool = False  # 8 bits by the vendor's curve; else digital numbers of 12 bits


REAL = EffectParameters(
    moving_sun=True,
    sun_disc_deg=0.53,  # the sun's mean angular diameter
    seasons=1.0,
    rough_crowns=True,
    gloss=1.0,
    moving_cars=True,
    colour_ratio=4,  # WorldView-3: 0.31 m and 1.24 m
    chip_blur_px=0.2,  # so that the power spectrum falls as that of the chips of jax_068 does (docs/method.md)
    tone_curve=True,
)


@dataclass(frozen=True)
class Material(Parameters):
    """How a kind of ground or roof reflects: its colour as shares of the albedo, and its mirror-like part."""

    red: float = 1.0
    green: float = 1.0
    blue: float = 1.0
    gloss: float = 0.0  # share of the light that is reflected as by a mirror, about Blinn and Phong's half vector


@dataclass(frozen=True)
class DistrictParameters(Parameters):
    """The plan of a district of large flat buildings, its trees and cars, and the light of its dates."""

    plan: TownParameters = TownParameters(
        block_m=(132.0, 104.0),
        street_m=15.0,
        roadway_m=5.0,
        turn_deg=1.0,  # most American towns stand north-up, and so do rows of cells
        flats=((0.30, 0.012), (0.16, 0.01), (0.24, 0.015), (0.33, 0.012), (0.20, 0.013), (0.55, 0.012)),
    )
    materials: Tuple[Material, ...] = (
        Material(),  # asphalt, concrete
        Material(0.92, 1.1, 0.85),  # grass
        Material(0.88, 1.1, 0.85),  # evergreen leaves
        Material(0.92, 1.1, 0.85),  # leaves that fall
        Material(1.15, 0.97, 0.85, 0.01),  # gravel and bitumen
        Material(0.97, 1.0, 1.04, 0.08),  # metal sheets, painted or galvanised
        Material(1.0, 1.0, 1.0, 0.03),  # membranes
        Material(1.0, 1.0, 1.0, 0.05),  # cars
    )
    shininess: float = 25.0  # Blinn and Phong's exponent: weathered metal and plastic, lobes of some 15 degrees
    sun_colour: Tuple[float, float, float] = (1.05, 1.0, 0.93)  # red, green, blue of sunlight over the mean,
    sky_colour: Tuple[float, float, float] = (0.78, 1.0, 1.28)  # and of the blue sky, which alone lights shadows
    haze_colour: Tuple[float, float, float] = (0.8, 1.0, 1.3)  # and of the light that the air scatters
    leaves: Tuple[Tuple[float, float], ...] = ((0, 0.1), (60, 0.1), (95, 1), (305, 1), (345, 0.1), (366, 0.1))
    """Day of the year, and the share of their leaves that trees have that shed them: at 30 degrees north."""
    green: Tuple[Tuple[float, float], ...] = ((0, 0.25), (60, 0.25), (110, 1), (290, 1), (350, 0.25), (366, 0.25))
    """Day of the year, and the share of grass that is green."""
    dry_grass: float = 1.6  # albedo of dry over green grass (ASTER spectral library: 0.12 to 0.2 against 0.08 to 0.1)
    shedding: float = 0.5  # share of trees that shed their leaves
    occupied: float = 0.6  # share of stalls and of places on roads with a car
    street_cars: float = 0.25
    tone_black: float = 0.85  # black over the intensity that 0.2 % of pixels are below: no shadow is black in chips
    tone_white: float = 0.965  # share of pixels below white (measured in jax_068: 0.94 to 0.975)
    tone_gamma: float = 1.9  # of the curve: the medians of the chips of jax_068 are 139 to 166 of 255
    colour_noise_dn: float = 3.0  # standard deviation of the noise of the colours, at their own GSD


@dataclass(frozen=True)
class DatedParameters(SimulationParameters):
    """All of them."""

    district: DistrictParameters = DistrictParameters()
    effects: EffectParameters = EffectParameters()


DATED = DatedParameters()
