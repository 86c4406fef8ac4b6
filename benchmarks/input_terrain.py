"""Bad input, the part on terrain: snow of weak texture, and a full scene of great relief. benchmarks/input.py runs the
trials."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import List, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from benchmarks.epm import rough_surface, simulated
from benchmarks.input_case import Ended, Job, Trial, pipeline
from benchmarks.runner import is_quick
from benchmarks.scenes import CACHE, made_once, quick_size
from repm_qgis.evaluation.coregistration import align
from repm_qgis.imagery.raster import opened, read, write
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.gcps import common_square
from repm_qgis.simulation.scene import (
    SceneSpec,
    fit_view_rpcs,
    make_views,
    surface_bounds,
    write_image,
    write_truth,
)
from repm_qgis.simulation.sensor import PLEIADES, Look
from repm_qgis.simulation.surface import Ground, fractal

_CELL_M, _TILT = 0.5, math.radians(25.0)
_RELIEF: Tuple[float, float] = (200.0, 8800.0)


# --- snow -----------------------------------------------------------------------------------------------------------


def snow(texture_dn: float, waves_m: float) -> Path:
    """The folder of a pair (B/H 0.28, 0.5 m) of a slope of 25 degrees, a quarter of it rock and the rest snow.

    The snow's albedo varies by ``texture_dn`` counts of 12 bits over 1 to 40 m, its height by ``waves_m`` over 15 to
    120 m (standard deviations); the noise is 11 counts. ``snow.tif`` is 1 there, in the cells of ``truth.tif``.
    """
    sensor = replace(PLEIADES, looks=(Look(8.0, 0.5), Look(-8.0, 0.5, 2.0)))
    size = quick_size(800)
    spec = SceneSpec("mountains", size, 3, sensor, _CELL_M, 1, base_m=900.0, relief_m=200.0, lon=6.65, lat=44.38)
    folder = CACHE / f"snow_{texture_dn:g}_{waves_m:g}_{size}"

    def make() -> None:
        views = make_views(spec)
        ground = Ground.empty(surface_bounds(spec, views), _CELL_M)
        rock = _snow_and_rock(ground, spec, texture_dn, waves_m)
        surface = ground.finish(spec.crs, spec.sun, math.inf)
        for number, (view, fit) in enumerate(zip(views, fit_view_rpcs(views, surface.height_range()))):
            write_image(str(folder / f"{view.name}.tif"), view, fit.rpc, surface, spec.seed + number, Silent())
        row, col, count = square = common_square(surface, views, 1)
        write_truth(str(folder / "truth.tif"), surface, square, 1)
        with opened(str(folder / "truth.tif")) as truth:
            place, wkt = truth.GetGeoTransform(), truth.GetProjection()
        covered = (rock[row : row + count, col : col + count] < 0.02).astype(np.float32)
        write(str(folder / "snow.tif"), [covered], place, wkt)

    return made_once(folder, make)


def _snow_and_rock(ground: Ground, spec: SceneSpec, texture_dn: float, waves_m: float) -> np.ndarray:
    """Build the slope; gives how much of each node is rock, 0..1."""
    rng = np.random.default_rng([spec.seed, 21])
    shape, cell = ground.height.shape, ground.cell
    rows, columns = np.indices(shape, dtype=np.float32)
    x, y = (columns - shape[1] / 2) * cell, (shape[0] / 2 - rows) * cell
    ground.height[:] = spec.base_m + 100.0 + (0.8 * x + 0.6 * y) * math.tan(_TILT)
    ground.height[:] += waves_m * fractal(rng, shape, cell, 120.0, 15.0, 1.3)
    rock = np.clip((fractal(rng, shape, cell, 300.0, 10.0) + (x - 0.5 * y) / 120.0 - 0.9) / 0.1, 0, 1)
    fine = fractal(rng, shape, cell, 12 * cell, 0.0, 0.3)
    ground.height[:] += rock * (3.0 * np.abs(fractal(rng, shape, cell, 40.0, 0.0, 0.9)) + 0.2 * fine)
    ground.albedo[:] = 0.62 + texture_dn / 4700.0 * fractal(rng, shape, cell, 40.0, 1.0, 0.5)
    ground.albedo[:] += rock * (0.13 + 0.035 * fine - ground.albedo)
    return rock


def over_snow(texture_dn: float, waves_m: float, folder: Path) -> List[Job]:
    images = [str(snow(texture_dn, waves_m) / f"img_{number:02d}.tif") for number in (1, 2)]
    return [pipeline(folder, images, resolution=_CELL_M, confidence=str(folder / "confidence.tif"))]


def on_snow(texture_dn: float, waves_m: float, ended: Ended) -> str:
    """How much of the snow has heights, and how well their stated errors hold."""
    place = snow(texture_dn, waves_m)
    truth, covered, dsm, stated = (
        _over(path, str(place / "truth.tif"))
        for path in (
            *(str(place / name) for name in ("truth.tif", "snow.tif")),
            ended.result["output"],
            str(ended.folder / "confidence.tif"),
        )
    )
    error = align("cells", [(dsm, truth)], (_CELL_M, _CELL_M)).applied(dsm, (_CELL_M, _CELL_M)) - truth
    there = (covered == 1) & np.isfinite(error) & np.isfinite(stated)
    off, share = np.abs(error[there]), 100.0 * there.sum() / (covered == 1).sum()
    if not there.any():
        return "exit 0: no height on the snow"
    within = [f"{100.0 * float((off < times * stated[there]).mean()):.0f}" for times in (1, 2)]
    nmad = 1.4826 * float(np.median(np.abs(error[there] - np.median(error[there]))))
    return (
        f"exit 0: {share:.0f} % of the snow has heights, NMAD {nmad:.2f} m, {within[0]} % of them within one stated "
        f"deviation and {within[1]} % within two"
    )


def _over(path: str, truth: str) -> np.ndarray:
    """The last band of a raster on the cells of the truth."""
    with opened(truth) as grid:
        west, cell, _, north, _, _ = grid.GetGeoTransform()
        width, height, wkt = grid.RasterXSize, grid.RasterYSize, grid.GetProjection()
    with opened(path) as source:
        band = source.RasterCount
    bounds = (west, north - height * cell, west + width * cell, north)
    one = gdal.Translate("", path, format="MEM", bandList=[band])
    warped = gdal.Warp("", one, format="MEM", outputBounds=bounds, width=width, height=height, dstSRS=wkt)
    return read(warped).astype(np.float64)


# --- relief ---------------------------------------------------------------------------------------------------------


def great_relief() -> Tuple[List[str], str]:
    """Two full images over 8600 m of relief, and a DEM of it; the images show stripes, as nothing is matched."""
    size = 8000 if is_quick() else 40000
    folder = CACHE / f"great_relief_{size}"
    images, dem = [str(folder / f"img_{number}.tif") for number in (1, 2)], str(folder / "dem.tif")

    def make() -> None:
        rpcs = [simulated(PLEIADES, look, (size, size), _RELIEF) for look in (PLEIADES.looks[0], PLEIADES.looks[2])]
        for path, rpc in zip(images, rpcs):
            options = ["TILED=YES", "COMPRESS=DEFLATE", "ZLEVEL=1"]
            image = gdal.GetDriverByName("GTiff").Create(path, size, size, 1, gdal.GDT_Byte, options)
            strip = np.full((512, size), 100, np.uint8)
            strip[::2, ::3] += 9
            for row in range(0, size, 512):
                image.GetRasterBand(1).WriteArray(strip[: min(512, size - row)], 0, row)
            image.SetMetadata(rpc_tags(rpc), "RPC")
            image = None
        surface = rough_surface(rpcs[0], _RELIEF, 3)
        across, down = surface.step_lon, surface.step_lat
        place = (surface.lon - across / 2, across, 0.0, surface.lat + down / 2, 0.0, -down)
        write(dem, [surface.heights.astype(np.float32)], place, pyproj.CRS(4326).to_wkt())

    made_once(folder, make)
    return images, dem


def terrain_tiles(tile_size: int, folder: Path) -> List[Job]:
    images, dem = great_relief()
    fit = {"images": images, "workspace": str(folder), "altitude_min": _RELIEF[0], "altitude_max": _RELIEF[1]}
    scene = str(folder / "scene.json")
    refine = {"scene": scene, "output_scene": str(folder / "refined.json"), "model": "terrain", "dem": dem}
    return [("epmfit", {**fit, "tile_size": tile_size}), ("refine", {**refine, "write_images": False})]


def refined(ended: Ended) -> str:
    scene = json.loads((ended.folder / "refined.json").read_text())
    tiles, seconds, result = len(scene["tiles"]), scene["history"][-1]["seconds"], ended.result
    return (
        f"exit 0: {tiles} tiles in {seconds:.0f} s, {ended.cpu_s:.0f} s of CPU; RMSE {result['rmse']:.4f} px, largest "
        f"{result['max_error']:.3f} px"
    )


TRIALS: List[Trial] = [
    *(
        Trial(
            "7",
            f"a slope of snow, texture of {texture:g} counts and waves of {waves:g} m under noise of 11 counts",
            partial(over_snow, texture, waves),
            partial(on_snow, texture, waves),
        )
        for texture, waves in ((5.0, 0.3), (5.0, 0.1), (2.0, 0.05))
    ),
    Trial("10", "a full scene of 8600 m of relief, MODEL=terrain, automatic tiles", partial(terrain_tiles, 0), refined),
    Trial("10", "the same, tiles of 5120 px", partial(terrain_tiles, 5120), refined),
]
