"""Multispectral images of simulated water (`benchmarks/water_and_clouds.py`): what each band sees of land and water.

Reflectances are rounded from spectral libraries: plants are bright in the near infrared, clear water is black there and
murky water nearly so, and bare ground, roads and most roofs are a little brighter there than in the green. Light in
shadows is the sky's and has little infrared, and the air scatters green and blue into the camera: so the index of a
shadow lies between those of sunlit ground and of water. Digital numbers of the bands have different gains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, Tuple

import numpy as np

from repm_qgis.simulation.scene import SceneSpec
from repm_qgis.simulation.surface import SimulatedSurface, fractal, irradiance


@dataclass(frozen=True)
class Band:
    """Digital numbers of a white surface and of the air's light, the sky's light in the band by that of the whole
    spectrum, and reflectances by the grey albedo of plants and of bare ground; those of clear and murky water."""

    white_dn: float
    haze_dn: float
    sky: float
    plants: float
    bare: float
    blue_roof: float
    clear: float
    murky: float


BANDS: Dict[str, Band] = {
    "red": Band(4300.0, 80.0, 1.0, 0.55, 1.05, 0.75, 0.020, 0.10),
    "green": Band(4800.0, 130.0, 1.25, 0.8, 0.95, 1.1, 0.040, 0.11),
    "blue": Band(4000.0, 170.0, 1.5, 0.5, 0.8, 1.5, 0.050, 0.08),
    "near infrared": Band(3000.0, 35.0, 0.7, 4.0, 1.15, 0.7, 0.006, 0.04),
}
_PLANTS_AT = 0.0  # of a fractal of unit deviation: half of the ground
_BLUE_ROOFS_AT = 1.0  # a sixth of the roofs
_ROOF_M = 2.5  # above what lies around: a roof, and not a plant
_GROUND_M = 20.0  # window of the lowest around a node


def land_cover(surface: SimulatedSurface, spec: SceneSpec) -> Tuple[np.ndarray, np.ndarray]:
    """Where plants grow, and which roofs are of blue metal (R, C)."""
    rng, shape = np.random.default_rng([spec.seed, 41]), surface.height.shape
    fields = fractal(rng, shape, surface.cell, 80.0, 4.0, 0.8)
    roofs = fractal(rng, shape, surface.cell, 60.0, 20.0, 1.0)
    if not np.isfinite(surface.wall_m):
        return fields > _PLANTS_AT, np.zeros(shape, bool)
    from scipy import ndimage

    around = ndimage.minimum_filter(surface.height[::4, ::4], max(int(_GROUND_M / surface.cell / 4), 3))
    lowest = np.kron(around, np.ones((4, 4), np.float32))[: shape[0], : shape[1]]
    raised = surface.height - lowest > _ROOF_M
    return (fields > _PLANTS_AT) & ~raised, (roofs > _BLUE_ROOFS_AT) & raised


def in_band(
    surface: SimulatedSurface, spec: SceneSpec, name: str, cover: Tuple[np.ndarray, np.ndarray], water: np.ndarray
) -> SimulatedSurface:
    """The surface in the light of a band; ``water`` (R, C) is what the water reflects there, NaN on land."""
    band, light, (plants, blue) = BANDS[name], surface.light, cover
    direct, sky, _ = irradiance(surface.height, surface.cell, spec.sun, surface.wall_m, light)
    albedo = (surface.radiance - light.haze_dn) / np.maximum(light.sun_dn * (direct + sky), 1.0)
    own = albedo * np.where(plants, band.plants, np.where(blue, band.blue_roof, band.bare))
    radiance = band.haze_dn + band.white_dn * np.minimum(own, 0.95) * (direct + band.sky * sky)
    radiance = np.where(np.isfinite(water), band.haze_dn + band.white_dn * water, radiance)
    facade = surface.facade * np.float32(band.bare * band.white_dn / light.sun_dn)
    return replace(surface, radiance=radiance.astype(np.float32), facade=facade.astype(np.float32))
