"""What the fractions of a pixel are worth, taken apart with the true disparities of simulated scenes.

The matcher's last step is started from what semi-global matching gives, and from the truth: what it then leaves is the
images' noise (steps on the intensity alone) and what smoothing costs (filters alone).
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from typing import Callable, Iterator, List, Sequence, Tuple

import cv2
import numpy as np

from benchmarks.matching import MatchedPair
from benchmarks.runner import few, pipeline, stage
from benchmarks.scenes import Scene, default, simulated, zy3_fine
from benchmarks.tables import Section, table
from repm_qgis.contracts.arrays import Window
from repm_qgis.contracts.stages import COMPAREDSM
from repm_qgis.imagery.raster import opened, read
from repm_qgis.imagery.warping import sample_array
from repm_qgis.matching import sgm
from repm_qgis.matching.pair_backend import sample_pair
from repm_qgis.matching.parameters import MATCHING, SubpixelParameters
from repm_qgis.matching.subpixel import subpixel_disparity
from repm_qgis.scene import Scene as SceneFile
from repm_qgis.stereo.triangulation import PairGeometry

Place = Tuple[float, float, float]
SCENES: Sequence[Tuple[str, Callable[[], Scene]]] = (
    ("town, 700 px of 0.5 m", lambda: default("urban", 700, 1)),
    ("mountains, 700 px of 1 m", lambda: default("mountains", 700, 3)),
    ("ZY-3, 900 px of 2.5 m", lambda: simulated("zy3_fine", zy3_fine(900))),
)
_RIM = 20
DEFAULT = MATCHING.subpixel
NOTHING = replace(DEFAULT, operations=())
STARTS: Sequence[Tuple[str, bool, SubpixelParameters]] = (
    ("semi-global matching as it comes", False, NOTHING),
    ("**subpixel**", False, DEFAULT),
    ("from the truth: subpixel", True, DEFAULT),
    ("from the truth: steps on the intensity only", True, replace(DEFAULT, operations=("step",) * 4)),
    ("from the truth: filters only", True, replace(DEFAULT, operations=("median", "mean", "mean", "mean"))),
)


def moved_truth(dsm: str, truth: str) -> Tuple[np.ndarray, Place]:
    """The true heights and their place as the scene's pointing, which has no ground control, sees them."""
    found = stage(COMPAREDSM, dsm=dsm, reference=truth, align="3d")
    with opened(truth) as raster:
        west, cell, _, north, _, _ = raster.GetGeoTransform()
        return read(raster) - np.float32(found.dz), (west - found.dx, north - found.dy, cell)


def true_disparities(geometry: PairGeometry, size: Tuple[int, int], truth: np.ndarray, place: Place) -> np.ndarray:
    """(H, W) px: each ray of the first image is followed down to where it first meets the ground; NaN outside it."""
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
        ends = [geometry.height.on_grid(columns, rows, disparity + d) for d in (-1.0, 0.0, 1.0)]
        disparity = disparity - (ends[1] - height) / ((ends[2] - ends[0]) / 2)
    return disparity


class Case(MatchedPair):
    """One pair of a scene: sampled as the matcher sees it, what semi-global matching gives, and the truth."""

    def __init__(self, scene: SceneFile, views: Tuple[int, int], truth: np.ndarray, place: Place) -> None:
        super().__init__(scene, views)
        geometry = self.geometry
        self.seen = sample_pair(self.task, self.frame, geometry)
        images = self.seen.first, self.seen.second, self.seen.disparities
        sides = geometry.height_sign, geometry.relief_displacement
        found = sgm.match(*images, *sides, replace(MATCHING, subpixel=NOTHING))
        self.start = np.where(found.filled, np.float32(np.nan), found.disparity)
        self.truth = true_disparities(geometry, self.frame.size, truth, place)
        matched = self.matched()
        self.truth += np.nanmedian((matched.disparity - self.truth)[~matched.filled])
        self.truth = self.truth[self.seen.window.inside(Window(0, 0, *self.frame.size))]
        self.true_start = np.where(np.isfinite(self.start), self._residual(), np.nan).astype(np.float32)

    def full(self, residual: np.ndarray) -> np.ndarray:
        """Disparities of residuals around the prior on which the second image was sampled."""
        return self.seen.full_disparity(residual)

    def _residual(self) -> np.ndarray:
        """The true disparities as residuals."""
        if self.seen.prior is None:
            return self.truth
        residual = np.nan_to_num(self.start)
        for _ in range(8):
            residual = (residual - 0.7 * np.nan_to_num(self.full(residual) - self.truth)).astype(np.float32)
        return np.where(np.abs(self.full(residual) - self.truth) < 0.02, residual, np.nan)

    def errors(self, from_truth: bool, parameters: SubpixelParameters) -> List[float]:
        """Median and 90 % of absolute errors, and the standard deviation of their means in the steps' window, px."""
        start, high = self.true_start if from_truth else self.start, self.seen.disparities[1]
        error = self.full(subpixel_disparity(start, self.seen.first, self.seen.second, high, parameters)) - self.truth
        known = np.isfinite(error) & np.isfinite(self.true_start)
        known[:_RIM] = known[-_RIM:] = known[:, :_RIM] = known[:, -_RIM:] = False
        # What is on another surface is not a matter of fractions.
        near = known & (np.abs(error) < 1)
        mean = cv2.GaussianBlur(np.where(near, error, 0.0), (0, 0), DEFAULT.sigma_px)
        mean /= np.maximum(cv2.GaussianBlur(near.astype(float), (0, 0), DEFAULT.sigma_px), 1e-3)
        size = np.abs(error[known])
        return [float(np.median(size)), float(np.percentile(size, 90)), float(mean[near].std())]


def cases(name: str, scene: Scene) -> Iterator[Tuple[str, Case]]:
    with tempfile.TemporaryDirectory() as folder:
        made = pipeline(scene.images, folder, tile_size=2000)
        truth, place = moved_truth(made.output, scene.reference)
        for views in few(((0, 1), (0, 2))):
            case = Case(SceneFile.load(made.scene), views, truth, place)
            yield f"{name}, views {views[0] + 1} and {views[1] + 1}", case


def fractions() -> List[str]:
    rows: List[List[object]] = []
    for name, scene in few(SCENES):
        for label, case in cases(name, scene()):
            for what, from_truth, parameters in STARTS:
                errors = (round(value, 3) for value in case.errors(from_truth, parameters))
                rows.append([label, round(case.geometry.metres_per_px, 2), what, *errors])
    return [
        "Pixels that are matched; errors in px of disparity against the true surface, after a shift in three "
        "dimensions. *In windows*: the standard deviation of the errors' means in the window of a step, errors "
        "below 1 px.",
        table("pair | m a px | what | MedAE px | 90 % px | in windows px", rows),
    ]


SECTIONS = [Section("subpixel", "Fractions of a pixel, taken apart", "make bench-subpixel", {"subpixel": fractions})]
