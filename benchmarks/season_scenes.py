"""Simulated scenes of two seasons: what matching makes of them, and how alike their images are beside real ones.

Tuned was one number, the share of the texture that is a date's own (``Tone.own``): so that a town without snow in the
sun of 006 and 018 of `jax_068` has their correlations, which are 0.18 / 0.53 / 0.81 (quartiles); it has 0.19 / 0.55 /
0.80, and for patches of 1.5, 10 and 20 m within 0.18 of theirs. The town below has snow and a lower sun besides, and a
little less of it.
"""

from __future__ import annotations

import re
import tempfile
from dataclasses import replace
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np
from osgeo import gdal
from scipy import ndimage

from benchmarks.runner import few, is_quick, pipeline, say
from benchmarks.scenes import SHARED, Scene, simulated
from benchmarks.scoring import heights_of
from benchmarks.simulated.chips import grey_of
from benchmarks.tables import table
from repm_qgis.contracts.arrays import FloatArray, FloatImage, Mask
from repm_qgis.contracts.options import INTENSITY
from repm_qgis.evaluation.coregistration import Alignment
from repm_qgis.evaluation.grids import Grid, HeightWarper
from repm_qgis.evaluation.metrics import height_metrics
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.imagery.heights import read_heights
from repm_qgis.imagery.raster import opened
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene as SceneFile
from repm_qgis.scene import View
from repm_qgis.simulation.scene import SceneSpec
from repm_qgis.simulation.seasons import Season, Tone
from repm_qgis.simulation.sensor import PLEIADES, Look


def _tones(own: float, wet: float) -> Dict[str, Any]:
    """Tones of a date: ``own`` is the part of roofs' texture that is its own, ``wet`` 0 for dry ground to 1."""
    return {
        "plants": Tone(own=2.0 * own),
        "soils": Tone(1 - 0.4 * wet, 0.0, 2.5 * own),
        "streets": Tone(1 - 0.25 * wet, 0.0, 1.2 * own),
        "roofs": Tone(1 - 0.1 * wet, 0.0, own),
    }


DECEMBER = Season("20141204110000", leaves=0.0, grass=0.13, soil=0.12, snow=0.1, **_tones(0.1, 0.7))
MAY = Season("20150521110000", **_tones(0.1, 0.0))
APRIL = Season("20150424110000", leaves=0.6, winter_crops=0.08, summer_crops=0.16, **_tones(0.06, 0.3))
OCTOBER = Season(
    "20151012110000", leaves=0.7, grass=0.11, soil=0.13, winter_crops=0.15, summer_crops=0.1, **_tones(0.06, 0.7)
)
_SENSOR = replace(PLEIADES, name="NEO", looks=(Look(9.0, 0.35), Look(-8.0, 0.35, 5.0)))
_SPEC = SceneSpec("urban", 1000, 31, _SENSOR, cell_m=0.5, surface_step=2, base_m=300.0, relief_m=0.0)
_SCENES = {
    "town, December and May": replace(_SPEC, seasons=(DECEMBER, MAY)),
    "farmland, April and October": replace(_SPEC, kind="farmland", seasons=(APRIL, OCTOBER)),
}
_TOWN = SHARED / "jax_068"
_REAL = {
    "001 + 002 (one day)": "001 002",
    "006 + 018 (December, May)": "006 018",
    "005 + 020 (October, July)": "005 020",
}


class _Log(Silent):
    """Keeps what a run tells."""

    def __init__(self) -> None:
        self.said: List[str] = []

    def info(self, text: str) -> None:
        self.said.append(text)


def _scenes() -> List[Tuple[str, Scene]]:
    return [(label, simulated(f"season_{spec.kind}", spec)) for label, spec in few(list(_SCENES.items()))]


_WINDOW_M = 4.5  # side of the patches that are correlated
_HIDDEN_M = 1.0  # by which something stands above the line of sight


def alike(views: Sequence[View], truth: str, alignment: Alignment) -> str:
    """Quartiles of the correlations of patches of two images at the true heights, where both see all of the patch.

    Each cell of the truth is looked up in both images, so that neither a matcher nor a rectification has a part in it:
    only the pointing, of which the best shift between the images is taken. ``alignment`` is that of a DSM of these
    views onto the truth, whose cells are squares.
    """
    dataset = gdal.Open(truth)
    west, cell, _, north, _, _ = dataset.GetGeoTransform()
    height = heights_of(dataset)
    filled = np.where(np.isfinite(height), height, np.nanmedian(height))
    x = west + (np.arange(filled.shape[1]) + 0.5) * cell - alignment.dx
    y = north - (np.arange(filled.shape[0]) + 0.5) * cell - alignment.dy
    place = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    lon_lat = geodetic_from_projected(dataset.GetProjection(), place)[:, :2]
    ground = np.column_stack([lon_lat, filled.ravel() - alignment.dz])
    seen, pixels, images = np.isfinite(height), [], []
    for view in views:
        pixels.append(view.project(ground).reshape(*filled.shape, 2))
        seen &= _visible(view, ground, filled, cell)
        bands = np.atleast_3d(gdal.Open(view.image).ReadAsArray().astype(np.float32).T).T
        images.append(grey_of(bands) if len(bands) == 3 else bands[0])
        inside = (pixels[-1] >= 4) & (pixels[-1] <= np.array(view.size) - 5)
        seen &= inside.all(axis=-1)
    side = int(round(_WINDOW_M / cell)) | 1
    whole = ndimage.minimum_filter(seen, side, mode="constant")
    first = _sampled(images[0], pixels[0])
    best = np.zeros(2)
    for step in (1.0, 0.5, 0.25):
        while True:
            tries = [best + step * np.array([i, j]) for i in (0, -1, 1) for j in (0, -1, 1)]
            every = [_correlation(first, _sampled(images[1], pixels[1] + by), side)[whole] for by in tries]
            at = int(np.argmax([np.median(values) for values in every]))
            best, found = tries[at], every[at]
            if at == 0:
                break
    return " / ".join(f"{value:.2f}" for value in np.quantile(found, (0.25, 0.5, 0.75)))


def _sampled(image: FloatImage, pixels: FloatArray) -> FloatImage:
    found: FloatImage = ndimage.map_coordinates(image, (pixels[..., 1], pixels[..., 0]), order=1, mode="nearest")
    return found


def _visible(view: View, ground: FloatArray, height: FloatArray, cell: float) -> Mask:
    """Which cells of a surface a view sees, from its direction in the middle."""
    middle = ground[len(ground) // 2][None]
    pixel = view.project(middle)
    low, high = (view.localise(pixel, float(middle[0, 2]) + up)[0] for up in (0.0, 50.0))
    metre = np.radians(6371.0e3)
    east = (high[0] - low[0]) * metre * np.cos(np.radians(low[1])) / 50 / cell  # cells for each metre up
    south = (low[1] - high[1]) * metre / 50 / cell
    hidden = np.zeros(height.shape, bool)
    step = 1.0 / max(abs(east), abs(south), 1.0 / 50)
    for up in np.arange(step, float(np.ptp(height)) + step, step):
        moved = ndimage.shift(height, (-south * up, -east * up), order=0, mode="nearest")
        hidden |= moved > height + up + _HIDDEN_M
    return ~hidden


def _correlation(first: FloatImage, second: FloatImage, side: int) -> FloatArray:
    """(R, C) correlations of square windows of two images."""

    def mean(values: FloatArray) -> FloatArray:
        found: FloatArray = ndimage.uniform_filter(values, side, mode="nearest")
        return found

    a, b = first.astype(np.float64), second.astype(np.float64)
    both = mean(a * b) - mean(a) * mean(b)
    own = [np.maximum(mean(v * v) - mean(v) ** 2, 1e-3) for v in (a, b)]
    result: FloatArray = both / np.sqrt(own[0] * own[1])
    return result


def _aligned(raster: str, truth: str, alignment: Alignment, band: int = 1) -> FloatImage:
    """A band of a DSM's, or of its confidence, on the cells of the truth."""
    with opened(raster) as source, opened(truth) as target:
        grid = Grid.of(target)
        if band > 1:
            grid, alignment = grid.flat, replace(alignment, dz=0.0)
        return HeightWarper(source, grid, band=band, heights=band == 1).read(grid, alignment)


def _figures(dsm: str, confidence: str, scene: Scene, alignment: Alignment) -> List[object]:
    """Heights, % of cells; within 1 m, %; RMSE; errors above three expected ones, %, and within their LE90, %.

    Where trees shed their leaves, the ground is as right as the crown: the error is the smaller one.
    """
    height, expected, le90 = (
        _aligned(path, scene.reference, alignment, band) for path, band in ((dsm, 1), (confidence, 5), (confidence, 6))
    )
    with opened(scene.reference) as crowns, opened(str(scene.folder / "bare.tif")) as bare:
        errors = [height - read_heights(truth) for truth in (crowns, bare)]
    error = np.where(np.abs(errors[0]) < np.abs(errors[1]), errors[0], errors[1])
    found, known = height_metrics(error, error.size), np.isfinite(error) & np.isfinite(expected)
    size = np.abs(error[known])
    shares = [100.0 * float(part.mean()) for part in (size > 3 * expected[known], size <= le90[known])]
    return [found.valid, dict(found.completeness)[1.0], found.rmse, *shares]


def _rows(label: str, scene: Scene) -> List[List[object]]:
    """A row for each cost; both have the pointing of the first, and so its alignment."""
    rows: List[List[object]] = []
    alignment = Alignment("none")
    for cost in ("auto", INTENSITY):
        say(f"{label}, {cost} ...")
        with tempfile.TemporaryDirectory() as folder:
            log, confidence = _Log(), f"{folder}/confidence.tif"
            options = {"resolution": scene.resolution, "matching_cost": cost, "confidence": confidence}
            dsm, facts = pipeline(scene.images, folder, log, **options).output, ["", ""]
            if cost == "auto":
                alignment = score_files(dsm, scene.reference, "3d").alignment
                found = SceneFile.load(f"{folder}/w/reconstructed.json")
                chosen = sorted({record.cost for tile in found.tiles for record in tile.heights})
                agreed = re.search(r"agree on (\d+)", "\n".join(log.said))
                share = agreed[1] if agreed else "enough"
                facts = [f"{', '.join(chosen)}; {share}", alike(found.views, scene.reference, alignment)]
            rows.append([label, cost, *_figures(dsm, confidence, scene, alignment), *facts])
    return rows[::-1]


def _likeness(names: str) -> str:
    """What :func:`alike` says of two real images."""
    images, truth = [str(_TOWN / f"JAX_068_{name}_RGB.tif") for name in names.split()], str(_TOWN / "truth_west.tif")
    with tempfile.TemporaryDirectory() as folder:
        dsm = pipeline(images, folder, resolution=0.5).output
        views = SceneFile.load(f"{folder}/w/reconstructed.json").views
        return alike(views, truth, score_files(dsm, truth, "3d").alignment)


def seasons() -> List[str]:
    rows = [row for label, scene in _scenes() for row in _rows(label, scene)]
    real = {} if is_quick() or not _TOWN.exists() else _REAL
    beside = "; ".join(f"{label} {_likeness(names)}" for label, names in real.items()) or "not measured"
    return [
        "Pairs of 0.35 m with 17 degrees between them, in cells of 0.5 m: a town in December (bare trees, patches of "
        "snow, the sun at 23 degrees) and in May, and hills with fields in April and October. One true surface; where "
        "trees shed their leaves, heights of the crown and of the ground below are both right. *wrong*: errors above "
        "three stated ones; *chosen*: what `auto` took, and on how many % of the ground intensities agree; *alike*: "
        "quartiles of the correlations of patches of 4.5 m of both images at the true heights, where both show them.",
        table("scene | cost | heights, % | C1, % | RMSE, m | wrong, % | within LE90, % | chosen | alike", rows),
        f"*alike* of real images of `jax_068`: {beside}.",
    ]
