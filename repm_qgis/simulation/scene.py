"""A truth scene on disk: images with RPCs, the true DSM, ground control points, and a record of it all.

Files: ``img_01.tif``...: uint16 GeoTIFF with RPC tags and no other georeference. ``truth.tif``: the DSM where all
views see the ground. ``gcps.csv``: points with their true ground position and noisy image position. ``truth.json``:
seed, sensor, the pointing error of each RPC, and versions. With seasons, ``bare.tif``: the true surface without crowns
that shed their leaves, which is as right as ``truth.tif`` there. Same seed and size: same bytes.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from dataclasses import dataclass, replace
from typing import Dict, List, Mapping, Sequence, Tuple

import numpy as np
from osgeo import gdal, osr

from .. import __version__
from ..contracts.arrays import Altitudes, Bounds, FloatArray
from ..contracts.errors import OptionError
from ..contracts.results import SampleDataResult
from ..geometry.frames import projected_from_geodetic, utm_crs
from ..imagery.raster import RasterFrame, created
from ..pointing.ground_control import Gcp, write_gcps
from ..rpc.fit import RpcFit, fit_rpc
from ..rpc.model import Rpc
from ..rpc.writers import rpc_tags
from ..runtime.progress import Part, Progress
from ..runtime.workspace import ensure_folder, write_text
from .gcps import choose_gcps, common_square
from .mountains import build_mountains
from .parameters import SIMULATION, JitterParameters, SimulationParameters, VendorParameters
from .render import render_view
from .seasons import Season, daylight, in_season, sun_at
from .sensor import PLEIADES, JitterSine, PushbroomView, Sensor, aim
from .surface import Cover, Ground, SimulatedSurface, Sun
from .town import Farmland, Town

_STRIP_ROWS = 256  # of the true DSM that are written together


@dataclass(frozen=True)
class SceneSpec:
    """What to simulate."""

    kind: str  # urban, mountains or farmland
    size: int  # side of the images, px
    seed: int
    sensor: Sensor
    cell_m: float  # of the true DSM
    surface_step: int  # surface nodes a cell of the true DSM
    base_m: float  # lowest height (mountains) or mean height (others) of the ground above the ellipsoid
    relief_m: float  # of mountains
    lon: float = 1.44  # degrees, the middle of the images
    lat: float = 43.60
    heading_deg: float = 191.0  # of the flight
    sun: Sun = Sun()
    jitter_px: float = 0.0  # largest amplitude of a wave of the attitude that the RPCs do not know
    seasons: Tuple[Season, ...] = ()  # one a view, for towns and farmland; none: all have one date, and ``sun``

    @classmethod
    def default(cls, kind: str, size: int, seed: int) -> SceneSpec:
        """A town seen at 0.5 m, or mountains at 1 m whose relief is three tenths of the scene's width.

        Raises OptionError for an unknown kind.
        """
        if kind == "urban":
            return cls(kind, size, seed, PLEIADES, cell_m=0.5, surface_step=2, base_m=190.0, relief_m=0.0)
        if kind != "mountains":
            raise OptionError("KIND", kind, "must be one of urban, mountains")
        sensor, relief = PLEIADES.at_gsd(1.0), min(0.3 * size, 2000.0)
        return cls(kind, size, seed, sensor, 1.0, 1, base_m=900.0, relief_m=relief, lon=6.65, lat=44.38)

    @property
    def crs(self) -> str:
        """The UTM zone of the scene's middle."""
        return utm_crs(self.lon, self.lat)

    @property
    def height_bounds(self) -> Altitudes:
        """Heights that the surface never leaves, m."""
        if self.kind == "mountains":
            return self.base_m - 50.0, self.base_m + self.relief_m + 50.0
        return self.base_m - (30.0 if self.kind == "urban" else 70.0), self.base_m + 90.0


def make_views(spec: SceneSpec, parameters: JitterParameters = SIMULATION.jitter) -> List[PushbroomView]:
    """The spec's sensor, aimed at the spec's middle by each of the sensor's looks, with jitter where it has some."""
    low, high = spec.height_bounds
    middle = (spec.lon, spec.lat, 0.5 * (low + high) if spec.kind == "mountains" else spec.base_m)
    size = (spec.size, spec.size)
    views = [
        aim(
            spec.sensor,
            look,
            middle,
            size=size,
            heading_deg=spec.heading_deg,
            seed=spec.seed + 101 * number,
            name=f"img_{number:02d}",
        )
        for number, look in enumerate(spec.sensor.looks, start=1)
    ]
    if spec.jitter_px == 0:
        return views
    return [replace(view, jitter=jitter_sines(spec, number, parameters)) for number, view in enumerate(views, start=1)]


def jitter_sines(
    spec: SceneSpec, number: int, parameters: JitterParameters = SIMULATION.jitter
) -> Tuple[JitterSine, ...]:
    """The waves of the attitude of one of the spec's views."""
    rng, sines = np.random.default_rng([spec.seed, 5, number]), []
    shortest, longest = np.log(parameters.periods)
    for band in range(parameters.sines):
        share = (band + rng.uniform()) / parameters.sines
        period = float(np.exp(shortest + share * (longest - shortest)))
        most = spec.jitter_px * (period / parameters.periods[1]) ** parameters.growth
        columns, rows = (float(v) for v in most * rng.uniform(parameters.least_share, 1.0, 2))
        first, second = (float(v) for v in rng.uniform(0.0, 2.0 * math.pi, 2))
        sines.append(JitterSine(period, (columns, rows), (first, second)))
    return tuple(sines)


def surface_bounds(spec: SceneSpec, views: Sequence[PushbroomView]) -> Bounds:
    """Bounds in the UTM zone of all that any view may see, with a margin for shadows."""
    places = []
    for view in views:
        edges = (np.linspace(-8.0, side + 7.0, 9) for side in view.size)
        pixels = np.stack(np.meshgrid(*edges), axis=-1).reshape(-1, 2)
        places += [projected_from_geodetic(spec.crs, view.localise(pixels, height)) for height in spec.height_bounds]
    every = np.concatenate(places)
    margin = 10 * spec.cell_m
    return Bounds.between(every.min(axis=0) - margin, every.max(axis=0) + margin)


def make_ground(
    spec: SceneSpec, bounds: Bounds, progress: Progress, parameters: SimulationParameters = SIMULATION
) -> Ground:
    """The spec's ground over bounds in its UTM zone."""
    ground = Ground.empty(bounds, spec.cell_m / spec.surface_step)
    progress.step(0.1, spec.kind)
    if spec.kind == "mountains":
        build_mountains(ground, spec.base_m, spec.relief_m, spec.seed, progress)
    else:
        town, plan = (Town, parameters.town) if spec.kind == "urban" else (Farmland, parameters.farmland)
        town(ground, spec.base_m, spec.seed, progress, plan).build()
    return ground


def make_surface(
    spec: SceneSpec, bounds: Bounds, progress: Progress, parameters: SimulationParameters = SIMULATION
) -> SimulatedSurface:
    """The spec's ground in the light of its sun."""
    ground = make_ground(spec, bounds, progress, parameters)
    progress.step(0.7, "light of the sun")
    wall_m = math.inf if spec.kind == "mountains" else parameters.town.wall_m
    return ground.finish(spec.crs, spec.sun, wall_m, parameters.light)


def write_image(
    path: str,
    view: PushbroomView,
    rpc: Rpc,
    surface: SimulatedSurface,
    seed: int,
    progress: Progress,
    parameters: SimulationParameters = SIMULATION,
    metadata: Mapping[str, str] = {},
) -> None:
    """Render a view strip by strip into a tiled GeoTIFF with RPC tags; raises WorkspaceError, Cancelled."""
    _drop_sidecar(path)
    frame, names = RasterFrame(view.size[::-1], np.uint16), ("panchromatic",)
    with created(path, frame, nodata=None, descriptions=names, metadata=metadata, compress=False) as dataset:
        dataset.set_metadata(rpc_tags(rpc), "RPC")
        for first, strip in render_view(surface, view, seed, progress, parameters.render):
            dataset.write(strip, 0, first)


def write_truth(path: str, surface: SimulatedSurface, square: Tuple[int, int, int], step: int) -> None:
    """The true DSM: every ``step``-th node of a square of the surface; a cell's value is the height at its middle."""
    row, col, count = square
    cell = step * surface.cell
    reference = osr.SpatialReference()
    reference.SetFromUserInput(surface.crs)
    west = surface.west + col * surface.cell - cell / 2
    north = surface.north - row * surface.cell + cell / 2
    _drop_sidecar(path)
    place = (west, cell, 0.0, north, 0.0, -cell)
    frame = RasterFrame((count, count), np.float32, 1, place, reference.ExportToWkt())
    names, metadata = ("height above the WGS 84 ellipsoid (m)",), {"VERTICAL_DATUM": "WGS 84 ellipsoid"}
    with created(path, frame, descriptions=names, unit="m", metadata=metadata) as dataset:
        for first in range(0, count, _STRIP_ROWS):
            last = min(first + _STRIP_ROWS, count)
            rows = slice(row + first * step, row + (last - 1) * step + 1, step)
            dataset.write(surface.height[rows, col : col + (count - 1) * step + 1 : step], 0, first)


def _drop_sidecar(path: str) -> None:
    """Remove the statistics that GDAL or QGIS kept in a sidecar of an earlier file of this name."""
    if os.path.exists(path + ".aux.xml"):
        os.remove(path + ".aux.xml")


def fit_view_rpcs(
    views: Sequence[PushbroomView], heights: Altitudes, parameters: SimulationParameters = SIMULATION
) -> List[RpcFit]:
    """RPCs true to the sensor, but for its jitter, for heights rounded outwards with a margin."""
    margin = parameters.vendor.height_margin_m
    low = math.floor((heights[0] - margin) / 10) * 10.0
    high = math.ceil((heights[1] + margin) / 10) * 10.0
    return [fit_rpc(view.steady.localise, view.size, (low, high), parameters.rpc_fit) for view in views]


def pointing_errors(count: int, seed: int, parameters: VendorParameters = SIMULATION.vendor) -> FloatArray:
    """(count, 2) px column, row by which the vendor's RPC of each view is wrong: up to 3 px, mostly in common."""
    rng = np.random.default_rng([seed, 4])
    common, own = parameters.common_pointing_px, parameters.view_pointing_px
    return rng.uniform(-common, common, 2) + rng.uniform(-own, own, (count, 2))


def _record(
    spec: SceneSpec,
    views: Sequence[PushbroomView],
    fits: Sequence[RpcFit],
    biases: FloatArray,
    surface: SimulatedSurface,
    gcps: Sequence[Gcp],
    gcp_noise_px: float,
) -> Dict[str, object]:
    """The content of truth.json."""
    low, high = surface.height_range()
    return {
        "schema": 1,
        "versions": {"repm": __version__, "numpy": np.__version__, "gdal": gdal.__version__},
        "spec": dataclasses.asdict(spec),
        "crs": spec.crs,
        "vertical_datum": "WGS 84 ellipsoid",
        "height_range_m": [low, high],
        "gcp_noise_px": gcp_noise_px,
        "gcp_points": len(gcps),
        "rpc_bias_note": "projection with the file's RPC minus the true projection, px",
        "views": [
            {
                "name": view.name,
                "pitch_deg": view.look.pitch_deg,
                "roll_deg": view.look.roll_deg,
                "gsd_m": view.look.gsd_m,
                "jitter": [dataclasses.asdict(sine) for sine in view.jitter],
                "rpc_bias_px": {"col": float(bias[0]), "row": float(bias[1])},
                "rpc_fit_max_px": fit.max_px,
                "rpc_fit_rms_px": fit.rms_px,
                "true_rpc": fit.rpc.to_mapping(),
            }
            for view, fit, bias in zip(views, fits, biases)
        ],
    }


def make_scene(
    spec: SceneSpec, folder: str, progress: Progress, parameters: SimulationParameters = SIMULATION
) -> SampleDataResult:
    """Simulate a scene and write it into a folder.

    Raises WorkspaceError if the folder cannot be written, and Cancelled if the user stopped it; no half file is left.
    """
    folder = str(ensure_folder(os.path.abspath(folder)))
    views = make_views(spec, parameters.jitter)
    bounds = surface_bounds(spec, views)
    surface = make_surface(spec, bounds, Part(progress, 0.0, 0.35), parameters)
    progress.check_cancelled()
    progress.step(0.35, "RPCs and control points")
    fits = fit_view_rpcs(views, surface.height_range(), parameters)
    biases = pointing_errors(len(views), spec.seed, parameters.vendor)
    square = common_square(surface, views, spec.surface_step, parameters.control)
    gcps = choose_gcps(surface, views, square, spec.surface_step, spec.seed, parameters.control)
    truth, gcp_file = os.path.join(folder, "truth.tif"), os.path.join(folder, "gcps.csv")
    write_truth(truth, surface, square, spec.surface_step)
    write_gcps(gcp_file, gcps)
    if spec.seasons:
        plans = {name: replace(getattr(parameters, name), trees=False) for name in ("town", "farmland")}
        part = Part(progress, 0.35, 0.4)
        ground, below = (make_ground(spec, bounds, part, one) for one in (parameters, replace(parameters, **plans)))
        bare = np.where(ground.cover == Cover.SHEDDING, below.height, ground.height)
        write_truth(os.path.join(folder, "bare.tif"), replace(surface, height=bare), square, spec.surface_step)
    images = []
    for number, (view, fit, bias) in enumerate(zip(views, fits, biases)):
        part = Part(progress, 0.4 + 0.6 * number / len(views), 0.4 + 0.6 * (number + 1) / len(views), view.name)
        images.append(os.path.join(folder, f"{view.name}.tif"))
        # Moving the image by -bias is the same as moving its RPC's projections by +bias.
        rpc, seen, metadata = fit.rpc.shifted(-bias[0], -bias[1]), surface, {}
        if spec.seasons:
            season, place = spec.seasons[number], (spec.lon, spec.lat)
            sun, metadata = sun_at(season.utc, spec.lon, spec.lat), {"NITF_IDATIM": season.utc}
            dated = in_season(ground, below, season, place, spec.seed, parameters)
            seen = dated.finish(spec.crs, sun, surface.wall_m, daylight(sun, parameters.light))
        write_image(images[-1], view, rpc, seen, spec.seed + number, part, parameters, metadata)
    record = _record(spec, views, fits, biases, surface, gcps, parameters.control.noise_px)
    write_text(os.path.join(folder, "truth.json"), json.dumps(record, indent=1, allow_nan=False) + "\n")
    progress.step(1.0, "done")
    worst = max(fit.max_px for fit in fits)
    return SampleDataResult(folder=folder, images=tuple(images), truth=truth, gcps=gcp_file, rpc_fit_max_px=worst)
