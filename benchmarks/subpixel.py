"""What the fractions of a pixel are worth, taken apart with the true disparities of simulated scenes.

``make bench-subpixel``. The matcher's last step is started from what semi-global matching gives, and from the truth:
what it then leaves is the images' noise (steps on the brightness alone) and what smoothing costs (filters alone).
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

import cv2
import numpy as np
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.imagery.enhancement import view_stretch  # noqa: E402
from repm_qgis.imagery.raster import opened, read  # noqa: E402
from repm_qgis.imagery.warping import sample_array  # noqa: E402
from repm_qgis.matching import sgm  # noqa: E402
from repm_qgis.matching.pair_backend import PairTask, match_pair, rectified_over_tile, sample_pair  # noqa: E402
from repm_qgis.matching.parameters import MATCHING, SubpixelParameters  # noqa: E402
from repm_qgis.matching.subpixel import subpixel_disparity  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.scene import Scene  # noqa: E402
from repm_qgis.simulation.scene import SceneSpec, make_scene  # noqa: E402
from repm_qgis.simulation.sensor import ZY3  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402
from repm_qgis.stereo.triangulation import PairGeometry, pair_geometry  # noqa: E402

SCENES: Dict[str, SceneSpec] = {
    "town, 700 px of 0.5 m": SceneSpec.default("urban", 700, 1),
    "mountains, 700 px of 1 m": SceneSpec.default("mountains", 700, 3),
    "ZY-3, 900 px of 2.5 m": SceneSpec(
        "mountains", 900, 11, ZY3, cell_m=2.5, surface_step=1, base_m=300.0, relief_m=700.0, lon=6.65, lat=44.38
    ),
}
_RIM = 20
NO_STEPS = replace(MATCHING.subpixel, operations=())
STARTS: List[Tuple[str, bool, SubpixelParameters]] = [
    ("semi-global matching as it comes", False, NO_STEPS),
    ("**subpixel**", False, MATCHING.subpixel),
    ("from the truth: subpixel", True, MATCHING.subpixel),
    ("from the truth: steps on the intensity only", True, replace(MATCHING.subpixel, operations=("step",) * 4)),
    ("from the truth: filters only", True, replace(NO_STEPS, operations=("median", "mean", "mean", "mean"))),
]


def moved_truth(dsm: str, truth: str) -> Tuple[np.ndarray, Tuple[float, ...]]:
    """The true heights and their place as the scene's pointing, which has no ground control, sees them."""
    found = run_stage("comparedsm", {"dsm": dsm, "reference": truth, "align": "3d"}, Silent())
    with opened(truth) as raster:
        west, cell, _, north, _, _ = raster.GetGeoTransform()
        return read(raster) - np.float32(found["dz"]), (west - found["dx"], north - found["dy"], cell)


def true_disparities(
    geometry: PairGeometry, size: Tuple[int, int], truth: np.ndarray, place: Tuple[float, ...]
) -> np.ndarray:
    """(H, W) px: each ray of the first image is followed down to where it first meets the ground; NaN beside it."""
    columns, rows = (np.arange(n, dtype=np.float64) for n in size)
    west, north, cell = place
    top, bottom = float(np.nanmax(truth)) + 1.0, float(np.nanmin(truth)) - 1.0
    step = max(0.5 * cell, (top - bottom) / 400)
    meets, height, before = np.zeros(size[::-1], bool), np.full(size[::-1], np.nan), None
    for z in np.arange(top, bottom - step, -step):
        x, y = (part.on_grid(columns, rows, np.full(size[::-1], z)) for part in (geometry.x, geometry.y))
        above = z - sample_array(truth, np.stack([(x - west) / cell - 0.5, (north - y) / cell - 0.5], -1), "bilinear")
        now = ~meets & (above <= 0)
        if before is not None:
            with np.errstate(invalid="ignore", divide="ignore"):
                height = np.where(now & (before > 0), z + step * above / (above - before), height)
        meets, before = meets | now, above
    disparity = np.full(size[::-1], float(np.mean(geometry.disparities)))
    for _ in range(8):
        ends = [geometry.height.on_grid(columns, rows, disparity + d) for d in (-1, 0, 1)]
        disparity = disparity - (ends[1] - height) / ((ends[2] - ends[0]) / 2)
    return disparity


class Case:
    """One pair of a scene: sampled as the matcher sees it, what semi-global matching gives, and the truth."""

    def __init__(self, scene: Scene, views: Tuple[int, int], truth: np.ndarray, place: Tuple[float, ...]) -> None:
        tile, names = scene.tiles[0], tuple(scene.views[view].name for view in views)
        first, second = (scene.view(name) for name in names)
        stretches = tuple(view_stretch(view.image, view.band) for view in (first, second))
        pair = rectified_over_tile(scene, names, tile.bounds, tile.altitudes)
        geometry = pair_geometry(pair, first, second, tile.altitudes, scene.crs)
        task = PairTask(sgm.BACKEND, scene, "", tile.bounds, tile.altitudes, names, stretches, "", "")
        self.seen = sample_pair(task, pair, geometry)
        self.prior, self.metres_per_px = self.seen.prior, geometry.metres_per_px
        given = self.seen.first, self.seen.resampled, self.seen.residuals
        sides = geometry.height_sign, geometry.relief_displacement
        found = sgm.match(*given, *sides, replace(MATCHING, subpixel=NO_STEPS))
        self.start = np.where(found.filled, np.float32(np.nan), found.disparity)
        self.truth = true_disparities(geometry, pair.size, truth, place)
        matched = match_pair(task, pair, geometry)
        error = (matched.disparity - self.truth)[~matched.filled]
        self.truth += np.nanmedian(error)
        self.true_start = np.where(np.isfinite(self.start), self._residual(), np.nan).astype(np.float32)

    def _residual(self) -> np.ndarray:
        """The true disparities around the prior on which the second image was sampled."""
        if self.prior is None:
            return self.truth
        residual = np.nan_to_num(self.start)
        for _ in range(8):
            residual = (residual - 0.7 * np.nan_to_num(self.prior.full_disparity(residual) - self.truth)).astype(
                np.float32
            )
        found = np.abs(self.prior.full_disparity(residual) - self.truth) < 0.02
        return np.where(found, residual, np.nan)

    def errors(self, from_truth: bool, parameters: SubpixelParameters) -> List[float]:
        """Median and 90 % of absolute errors, and the standard deviation of their means in the steps' window, px."""
        start, high = self.true_start if from_truth else self.start, self.seen.residuals[1]
        found = subpixel_disparity(start, self.seen.first, self.seen.resampled, high, parameters)
        error = (found if self.prior is None else self.prior.full_disparity(found)) - self.truth
        known = np.isfinite(error) & np.isfinite(self.true_start)
        known[:_RIM] = known[-_RIM:] = known[:, :_RIM] = known[:, -_RIM:] = False
        # What lies on another surface is not a matter of fractions.
        near = known & (np.abs(error) < 1)
        mean = cv2.GaussianBlur(np.where(near, error, 0.0), (0, 0), MATCHING.subpixel.sigma_px)
        mean /= np.maximum(cv2.GaussianBlur(near.astype(float), (0, 0), MATCHING.subpixel.sigma_px), 1e-3)
        size = np.abs(error[known])
        return [float(np.median(size)), float(np.percentile(size, 90)), float(mean[near].std())]


def cases(name: str, folder: str) -> Iterator[Tuple[str, Case]]:
    made = make_scene(SCENES[name], folder, Silent())
    run = run_stage(
        "pipeline",
        {"images": made["images"], "workspace": f"{folder}/w", "output": f"{folder}/dsm.tif", "tile_size": 2000},
        Silent(),
    )
    truth, place = moved_truth(f"{folder}/dsm.tif", made["truth"])
    scene = Scene.load(run["scene"])
    for views in ((0, 1), (0, 2)):
        yield f"{name}, views {views[0] + 1} and {views[1] + 1}", Case(scene, views, truth, place)


def main() -> None:
    gdal.UseExceptions()
    rows: List[List[Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, name in enumerate(SCENES):
            for label, case in cases(name, f"{folder}/{number}"):
                for what, from_truth, parameters in STARTS:
                    rows.append(
                        [
                            label,
                            round(case.metres_per_px, 2),
                            what,
                            *(round(value, 3) for value in case.errors(from_truth, parameters)),
                        ]
                    )
    publish(
        "subpixel",
        "Fractions of a pixel, taken apart",
        "make bench-subpixel",
        [
            "Pixels that are matched; errors in px of disparity against the true surface, after a shift in three "
            "dimensions. *In windows*: the standard deviation of the errors' means in the window of a step, errors below "
            "1 px.",
            table(["pair", "m a px", "what", "ME px", "90 % px", "in windows px"], rows),
        ],
    )


if __name__ == "__main__":
    main()
