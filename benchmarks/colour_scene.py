"""A truth scene with colours: panchromatic images as ever, and a multispectral image beside each of them.

The ground has tints that vary over tens of metres and from object to object. The panchromatic value is a known weighted
sum of the bands, so that the true colour of every place is known. A multispectral image has a quarter of the
resolution, an RPC of its own, and the panchromatic one's pointing error with a little of its own.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np

from repm_qgis.imagery.raster import RasterFrame, created, write
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.render import render_view
from repm_qgis.simulation.scene import (
    SceneSpec,
    fit_view_rpcs,
    make_scene,
    make_surface,
    make_views,
    pointing_errors,
    surface_bounds,
)
from repm_qgis.simulation.surface import SimulatedSurface, fractal

RATIO = 4
WEIGHTS = {"red": 0.3, "green": 0.35, "blue": 0.2, "near infrared": 0.15}
_OWN_ERROR_PX = 0.35  # of the multispectral images' pointing, px of theirs, at most


def make_colour_scene(spec: SceneSpec, folder: str) -> Tuple[List[str], List[str], str]:
    """Simulate a scene; gives its panchromatic and multispectral images, and the true colours.

    The true colours are a raster of four bands over the ground (every node of the surface), without walls.
    """
    made = make_scene(spec, folder, Silent())
    sharp = make_views(spec)
    surface = make_surface(spec, surface_bounds(spec, sharp), Silent())
    tints = _tints(surface, spec.seed)
    looks = tuple(replace(look, gsd_m=RATIO * look.gsd_m) for look in spec.sensor.looks)
    views = make_views(replace(spec, size=spec.size // RATIO, sensor=replace(spec.sensor, looks=looks)))
    fits = fit_view_rpcs(views, surface.height_range())
    biases = pointing_errors(len(views), spec.seed) / RATIO
    biases = biases + np.random.default_rng([spec.seed, 9]).uniform(-_OWN_ERROR_PX, _OWN_ERROR_PX, biases.shape)
    paths = []
    for number, (view, fit, bias) in enumerate(zip(views, fits, biases)):
        paths.append(str(Path(folder) / f"{view.name}_XS.tif"))
        frame = RasterFrame(view.size[::-1], np.uint16, len(tints))
        with created(paths[-1], frame, nodata=None, descriptions=tuple(tints), compress=False) as dataset:
            dataset.set_metadata(rpc_tags(fit.rpc.shifted(-bias[0], -bias[1])), "RPC")
            for band, tint in enumerate(tints.values(), start=1):
                for first, strip in render_view(_tinted(surface, tint), view, spec.seed + 50 * band + number, Silent()):
                    dataset.write(strip, 0, first, band)
    truth = str(Path(folder) / "colours.tif")
    place = surface.west - surface.cell / 2, surface.cell, 0.0, surface.north + surface.cell / 2, 0.0, -surface.cell
    write(truth, [surface.radiance * tint for tint in tints.values()], place, surface.crs, descriptions=tuple(tints))
    return list(made.images), paths, truth


def _tints(surface: SimulatedSurface, seed: int) -> Dict[str, np.ndarray]:
    """(R, C) what the grey is multiplied with for each band; their weighted sum is one everywhere."""
    rng = np.random.default_rng([seed, 7])
    shape = surface.radiance.shape
    raw = [np.exp(0.25 * fractal(rng, shape, surface.cell, 40.0, 4.0, 0.5)).astype(np.float32) for _ in WEIGHTS]
    total = sum(weight * tint for weight, tint in zip(WEIGHTS.values(), raw))
    return {name: tint / total for name, tint in zip(WEIGHTS, raw)}


def _tinted(surface: SimulatedSurface, tint: np.ndarray) -> SimulatedSurface:
    return replace(surface, radiance=surface.radiance * tint, facade=surface.facade * tint)
