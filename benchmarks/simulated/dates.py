"""A truth scene of many dates on disk: a district seen by WorldView-3 at the times and angles of real images.

Files: ``img_01.tif``...: 8-bit colour chips with RPC tags and the time of acquisition; ``truth.tif`` and
``classes.tif``: heights and classes as airborne lidar has them. Same seed, same acquisitions, same effects: same bytes.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np
from osgeo import osr

from repm_qgis.contracts.arrays import FloatArray, FloatImage
from repm_qgis.geometry.frames import ecef_from_geodetic, projected_from_geodetic, utm_crs
from repm_qgis.imagery.raster import RasterFrame, created, write
from repm_qgis.rpc.model import Rpc
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.runtime.progress import Progress
from repm_qgis.runtime.workspace import ensure_folder
from repm_qgis.simulation.render import RayCaster
from repm_qgis.simulation.scene import SceneSpec, fit_view_rpcs, pointing_errors, surface_bounds
from repm_qgis.simulation.sensor import Look, PushbroomView, Sensor, aim
from repm_qgis.simulation.surface import Ground, SimulatedSurface, Sun, irradiance, wall_light

from .chips import grey_of, pansharpened, toned
from .district import Date, District
from .parameters import DATED, DatedParameters

_LIDAR = Date(1, 0, 200)
_MARGIN = 1.04  # of the images over the square


@dataclass(frozen=True)
class Acquisition:
    """One image: its time, the sun, where the satellite stands as seen from the ground, and how it scans; degrees."""

    utc: str  # YYYYMMDDhhmmss
    sun: Sun
    azimuth_deg: float
    incidence_deg: float
    gsd_m: float
    heading_deg: float = 180.3

    @property
    def date(self) -> Date:
        when = datetime.strptime(self.utc, "%Y%m%d%H%M%S")
        seconds = 3600 * when.hour + 60 * when.minute + when.second
        return Date(when.toordinal(), seconds, when.timetuple().tm_yday)


def _taken(utc: str, sun: Tuple[float, float], sight: Tuple[float, float], gsd: float, heading: float) -> Acquisition:
    return Acquisition(utc, Sun(*sun), *sight, gsd, heading)


# The nineteen images of Jacksonville in the Data Fusion Contest 2019, tile JAX_068: times and suns from their metadata,
# the other angles and the GSD from their RPCs.
WORLDVIEW3_JACKSONVILLE = (
    _taken("20141005160138", (150.3, 50.8), (21.3, 20.0), 0.336, 90.1),
    _taken("20141005160149", (150.3, 50.9), (26.5, 12.9), 0.319, 90.2),
    _taken("20141011155720", (150.9, 48.5), (137.5, 19.4), 0.334, 180.3),
    _taken("20141018160722", (156.3, 47.2), (268.0, 7.7), 0.312, 180.4),
    _taken("20141030155732", (155.7, 42.6), (111.4, 18.1), 0.330, 180.3),
    _taken("20141214160402", (158.6, 33.5), (43.7, 16.0), 0.326, 180.3),
    _taken("20141227161109", (158.9, 33.5), (217.6, 12.7), 0.319, 180.4),
    _taken("20150121161253", (155.1, 36.0), (205.2, 23.9), 0.350, 180.4),
    _taken("20150121161308", (155.2, 36.0), (201.7, 32.1), 0.391, 180.4),
    _taken("20150127160845", (152.9, 36.8), (141.3, 5.6), 0.310, 180.3),
    _taken("20150215161208", (150.2, 42.2), (5.2, 17.6), 0.330, 180.3),
    _taken("20150419161439", (135.1, 64.9), (187.4, 20.6), 0.338, 180.3),
    _taken("20150426162435", (137.0, 68.4), (257.8, 23.0), 0.346, 180.4),
    _taken("20150501160357", (125.0, 66.3), (85.7, 27.0), 0.362, 180.2),
    _taken("20150502161943", (131.6, 69.2), (218.0, 20.1), 0.336, 180.4),
    _taken("20150521161849", (120.6, 72.4), (247.1, 6.1), 0.310, 180.3),
    _taken("20150615161248", (108.0, 72.1), (110.8, 12.6), 0.319, 180.4),
    _taken("20150705162954", (114.7, 74.5), (258.9, 26.6), 0.361, 180.4),
    _taken("20151101161954", (163.0, 43.8), (54.4, 12.8), 0.319, 180.2),
)
WORLDVIEW3 = Sensor("WORLDVIEW3", 617e3, (), detectors=35840, read_noise_dn=1.5, photon_gain=0.02)


@dataclass(frozen=True)
class DatedSpec:
    """What to simulate: a square of a district, at Jacksonville's place and height.

    The district fills the ground that the views see, and its plan follows from the size of that: other acquisitions see
    another district.
    """

    seed: int = 1
    side_m: float = 256.0
    cell_m: float = 0.5  # of the truth
    surface_step: int = 2
    base_m: float = -22.0
    lon: float = -81.663
    lat: float = 30.316
    acquisitions: Tuple[Acquisition, ...] = WORLDVIEW3_JACKSONVILLE


def aimed(spec: DatedSpec, one: Acquisition, number: int) -> PushbroomView:
    """The sensor model of an acquisition: a look that meets the ground from the satellite's direction there."""
    target = (spec.lon, spec.lat, spec.base_m)
    size = (int(math.ceil(_MARGIN * spec.side_m / one.gsd_m)),) * 2
    turn = math.radians(one.azimuth_deg - one.heading_deg)
    wanted = math.radians(one.incidence_deg)
    # To the satellite is backwards along the flight for a look ahead, and left of it for a look to the right.
    reach = wanted * 6378.0e3 / (6378.0e3 + WORLDVIEW3.altitude_m)
    look = Look(-math.degrees(reach) * math.cos(turn), one.gsd_m, -math.degrees(reach) * math.sin(turn))
    for _ in range(8):
        view = aim(
            WORLDVIEW3,
            look,
            target,
            size=size,
            heading_deg=one.heading_deg,
            seed=spec.seed + 101 * number,
            name=f"img_{number:02d}",
        )
        ahead, right = _sight_angles(view, target, one.heading_deg)
        look = Look(
            look.pitch_deg + 0.9 * (-math.degrees(wanted) * math.cos(turn) - ahead),
            one.gsd_m,
            look.roll_deg + 0.9 * (-math.degrees(wanted) * math.sin(turn) - right),
        )
    return view


def to_satellite(view: PushbroomView, lon_lat_h: Sequence[float]) -> FloatArray:
    """(3,) unit vector east, north, up from a ground point to the satellite in the middle of the exposure."""
    position, _ = view.rays(np.array([[(view.size[0] - 1) / 2, (view.size[1] - 1) / 2]]))
    sight = position[0] - ecef_from_geodetic(np.array([lon_lat_h], dtype=np.float64))[0]
    lon, lat = np.radians(lon_lat_h[:2])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    found: FloatArray = np.array([sight @ east, sight @ np.cross(up, east), sight @ up])
    return found / np.linalg.norm(found)


def _sight_angles(view: PushbroomView, target: Sequence[float], heading_deg: float) -> Tuple[float, float]:
    """The incidence's parts ahead and to the right of the flight, degrees, with the sign of pitch and roll."""
    east, north, up = to_satellite(view, target)
    azimuth, incidence = math.atan2(east, north), math.degrees(math.acos(up))
    turn = azimuth - math.radians(heading_deg)
    return -incidence * math.cos(turn), -incidence * math.sin(turn)


def band_surfaces(
    crs: str, ground: Ground, material: Any, sun: Sun, sight: FloatArray, parameters: DatedParameters
) -> List[SimulatedSurface]:
    """The ground in red, green and blue light, as one satellite sees it.

    A glossy material sends, besides, a share of the sunlight about the half vector between sun and satellite; roofs are
    taken as level, which those of a district nearly are.
    """
    own, effects = parameters.district, parameters.effects
    light = replace(parameters.light, sun_disc_deg=effects.sun_disc_deg)
    wall_m = own.plan.wall_m
    direct, sky, shade = irradiance(ground.height, ground.cell, sun, wall_m, light)
    facing = wall_light(ground.height, ground.cell, sun)
    half = np.array(sun.direction()) + sight
    lobe = (own.shininess + 8) / 8 * float(half[2] / np.linalg.norm(half)) ** own.shininess
    gloss = np.array([one.gloss for one in own.materials], np.float32)[material]
    mirrored = effects.gloss * lobe * gloss * direct
    surfaces = []
    for band, colour in enumerate(("red", "green", "blue")):
        tint = np.array([getattr(one, colour) for one in own.materials], np.float32)[material]
        from_sun = (
            np.float32(own.sun_colour[band]) * direct * (ground.albedo * tint + mirrored / np.maximum(direct, 0.1))
        )
        from_sky = np.float32(own.sky_colour[band]) * sky * ground.albedo * tint
        haze = light.haze_dn * own.haze_colour[band]
        radiance = ((from_sun + from_sky) * np.float32(light.sun_dn) + np.float32(haze)).astype(np.float32)
        walls = (ground.wall_albedo * facing * np.float32(light.sun_dn * own.sun_colour[band])).astype(np.float32)
        own_light = replace(light, haze_dn=haze, sky_share=light.sky_share * own.sky_colour[band])
        place = (crs, ground.west, ground.north, ground.cell, wall_m)
        surfaces.append(SimulatedSurface(*place, ground.height, radiance, shade, walls, own_light))
    return surfaces


def exposed(
    surfaces: Sequence[SimulatedSurface],
    view: PushbroomView,
    seed: int,
    progress: Progress,
    every: DatedParameters,
) -> Tuple[FloatImage, ...]:
    """The bands of a chip: red, green and blue of 8 bits, or one grey band of 12 bits without a tone curve."""
    step, chunk = every.render.oversample, every.render.chunk_cols
    caster = RayCaster(surfaces[0], view, every.render)
    # A margin of a whole coarse pixel, so that neither blur nor resampling meets an edge.
    margin = 4 * every.effects.colour_ratio
    cols, rows = (-margin - 0.5 + (np.arange((n + 2 * margin) * step) + 0.5) / step for n in view.size)
    fine = [np.empty((rows.size, cols.size), np.float32) for _ in surfaces]
    for first in range(0, cols.size, chunk):
        for top in range(0, rows.size, chunk):
            progress.check_cancelled()
            here = slice(top, top + chunk), slice(first, first + chunk)
            rays, height = caster.cast(cols[here[1]], rows[here[0]])
            for band, surface in zip(fine, surfaces):
                band[here] = caster.radiance(rays, height, surface)
    bands = pansharpened(fine, view.sensor, step, np.random.default_rng([seed, 6]), every.district, every.effects)
    bands = bands[:, margin : margin + view.size[1], margin : margin + view.size[0]]
    if every.effects.tone_curve:
        return tuple(toned(bands, every.district))
    return (np.clip(np.rint(grey_of(bands)), 1, 2**view.sensor.bits - 1).astype(np.uint16),)


def make_dated_scene(
    spec: DatedSpec, folder: str, progress: Progress, parameters: DatedParameters = DATED
) -> Dict[str, object]:
    """Simulate a scene of many dates with ``parameters.effects`` and write it into a folder.

    Returns ``images`` (paths, in the order of the acquisitions), ``truth`` and ``classes`` (paths). Raises
    WorkspaceError if the folder cannot be written, and Cancelled if the user stopped it; no half file is left.
    """
    folder, effects = str(ensure_folder(os.path.abspath(folder))), parameters.effects
    views = [aimed(spec, one, number) for number, one in enumerate(spec.acquisitions, start=1)]
    crs, step = utm_crs(spec.lon, spec.lat), spec.surface_step
    town = SceneSpec(
        "urban",
        max(v.size[0] for v in views),
        spec.seed,
        WORLDVIEW3,
        spec.cell_m,
        step,
        spec.base_m,
        0,
        spec.lon,
        spec.lat,
    )
    ground = Ground.empty(surface_bounds(town, views), spec.cell_m / step)
    progress.step(0.02, "building the district")
    district = District(ground, spec.base_m, spec.seed, progress, parameters.district)
    result = _write_truth(spec, folder, ground, district, parameters)
    low, high = float(ground.height.min()), float(ground.height.max()) + 10.0
    fits = fit_view_rpcs(views, (low, high), parameters)
    biases = pointing_errors(len(views), spec.seed, parameters.vendor)
    images = []
    for number, (one, view, fit, bias) in enumerate(zip(spec.acquisitions, views, fits, biases)):
        progress.step(0.1 + 0.9 * number / len(views), view.name)
        dated, material = district.dated(one.date, effects)
        sun = one.sun if effects.moving_sun else spec.acquisitions[0].sun
        sight = to_satellite(view, (spec.lon, spec.lat, spec.base_m))
        surfaces = band_surfaces(crs, dated, material, sun, sight, parameters)
        bands = exposed(surfaces, view, spec.seed + number, progress, parameters)
        path = os.path.join(folder, f"{view.name}.tif")
        # Moving the image by -bias is the same as moving its RPC's projections by +bias.
        _write_chip(path, bands, one.utc, fit.rpc.shifted(-bias[0], -bias[1]))
        images.append(path)
    progress.step(1.0, "done")
    return {"images": images, **result}


def _write_chip(path: str, bands: Sequence[FloatImage], utc: str, rpc: Rpc) -> None:
    frame = RasterFrame(bands[0].shape, bands[0].dtype, len(bands))
    with created(path, frame, nodata=None, metadata={"NITF_IDATIM": utc}) as dataset:
        dataset.set_metadata(rpc_tags(rpc), "RPC")
        for number, band in enumerate(bands, start=1):
            dataset.write(band, band=number)


def _write_truth(
    spec: DatedSpec, folder: str, ground: Ground, district: District, parameters: DatedParameters
) -> Dict[str, str]:
    """Heights and classes of the square about the target, which all images see; a cell has the value at its middle."""
    height, classes = district.truth(_LIDAR, parameters.effects)
    cell, step = spec.cell_m / spec.surface_step, spec.surface_step
    count = int(spec.side_m / spec.cell_m)
    crs = utm_crs(spec.lon, spec.lat)
    # The grid's middle is not the target: it follows from what slanted views see at all heights.
    east, north = projected_from_geodetic(crs, np.array([[spec.lon, spec.lat, spec.base_m]]))[0][:2]
    row = int(round((ground.north - north) / cell)) - count // 2 * step
    col = int(round((east - ground.west) / cell)) - count // 2 * step
    reference = osr.SpatialReference()
    reference.SetFromUserInput(crs)
    west, north = ground.west + col * cell - spec.cell_m / 2, ground.north - row * cell + spec.cell_m / 2
    frame = (west, spec.cell_m, 0.0, north, 0.0, -spec.cell_m), reference.ExportToWkt()
    nodes = (slice(row, row + count * step, step), slice(col, col + count * step, step))
    paths = {"truth": os.path.join(folder, "truth.tif"), "classes": os.path.join(folder, "classes.tif")}
    write(paths["truth"], [height[nodes]], *frame, unit="m", metadata={"VERTICAL_DATUM": "WGS 84 ellipsoid"})
    write(paths["classes"], [classes[nodes]], *frame, nodata=None)
    return paths
