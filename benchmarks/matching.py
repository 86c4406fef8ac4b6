"""The matcher's choices measured, one change at a time (``make bench-matching``).

Each row is one pair of one scene matched with something of the ``sgm`` backend left out or replaced, gridded to 0.5 m
and scored on all cells of the reference, after the best whole-cell shift and the median height difference where the
scene has a truth (pointing without ground control leaves such a shift).
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Tuple

import cv2
import numpy as np
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.dsm.grid import CellGrid, grid_points  # noqa: E402
from repm_qgis.geometry.refinement import translation  # noqa: E402
from repm_qgis.imagery.enhancement import view_stretch  # noqa: E402
from repm_qgis.imagery.raster import opened, read  # noqa: E402
from repm_qgis.imagery.warping import warp  # noqa: E402
from repm_qgis.mvs import sgm  # noqa: E402
from repm_qgis.mvs.pairing import grown, rectified_pair  # noqa: E402
from repm_qgis.mvs.rectification import RectifiedPair  # noqa: E402
from repm_qgis.mvs.triangulation import pair_geometry  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.scene import Scene  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402

SHARED = Path(os.environ.get("REPM_SHARED_DATA", ROOT.parent / "shared" / "data"))
CELL = 0.5


class Case:
    """One pair of a scene, rectified and sampled, and the reference it is scored against."""

    def __init__(self, name: str, images: List[str], reference: str, align: bool, folder: str) -> None:
        self.name, self.align = name, align
        work = f"{folder}/{name}"
        made = run_stage("pipeline", {"images": images[:2], "workspace": work, "output": f"{work}.tif",
                                      "resolution": CELL}, Silent())
        scene = Scene.load(made["scene"])
        tile = scene.tiles[0]
        first, second = scene.views[:2]
        pair = rectified_pair(scene, first, second, grown(tile.bounds, 32 * scene.gsd_m), tile.altitudes)
        self.geometry = pair_geometry(pair, first, second, tile.altitudes, scene.crs)
        low, high = (math.floor(self.geometry.disparities[0]) - 6, math.ceil(self.geometry.disparities[1]) + 6)
        self.disparities, (width, height) = (low, high), pair.size
        shifted = RectifiedPair(pair.first, pair.second, pair.h_first, translation(high, 0) @ pair.h_second, pair.size)
        self.first = _sampled(first, pair.first_original, (width, height))
        self.second = _sampled(second, shifted.second_original, (width + high - low, height))
        with opened(reference) as dataset:
            west, cell, _, north, _, _ = dataset.GetGeoTransform()
            size = dataset.RasterXSize, dataset.RasterYSize
            step = max(1, round(CELL / cell))
            self.truth = read(dataset).astype(np.float64)[::step, ::step]
        self.grid = CellGrid(west, north, cell * step, (size[1] // step, size[0] // step))
        self.truth = self.truth[:self.grid.shape[0], :self.grid.shape[1]]

    def score(self, match: Callable[..., Any]) -> List[float]:
        """CPU seconds, valid %, ME, MAE, RMSE (m), C1, C2.5 (%) of a matcher."""
        start = time.process_time()
        found = match(self.first, self.second, self.disparities, self.geometry.nearer)
        seconds = time.process_time() - start
        columns, rows = (np.arange(n, dtype=np.float64) for n in found.disparity.shape[::-1])
        height = self.geometry.height.on_grid(columns, rows, found.disparity.astype(np.float64))
        x, y = (part.on_grid(columns, rows, height) for part in (self.geometry.x, self.geometry.y))
        error = grid_points(self.grid, x, y, height, np.ones_like(height))[0] - self.truth
        if self.align:
            error = self._aligned(error + self.truth)
        known = error[np.isfinite(error)]
        cells = np.isfinite(self.truth).sum()
        size = np.abs(known)
        return [seconds, 100 * known.size / cells, float(np.median(size)), float(size.mean()),
                float(np.sqrt((known ** 2).mean())), 100 * float((size < 1).sum()) / cells,
                100 * float((size < 2.5).sum()) / cells]

    def _aligned(self, dsm: np.ndarray) -> np.ndarray:
        best, error = math.inf, dsm - self.truth
        for dr in range(-4, 5):
            for dc in range(-4, 5):
                moved = np.roll(dsm, (dr, dc), (0, 1)) - self.truth
                spread = np.nanmedian(np.abs(moved - np.nanmedian(moved)))
                if spread < best:
                    best, error = spread, moved - np.nanmedian(moved)
        return error


def _sampled(view: Any, to_original: Any, size: Tuple[int, int]) -> np.ndarray:
    with opened(view.image) as dataset:
        return view_stretch(view.image, view.band).apply(warp(dataset, view.band, to_original, size, "cubic"))


@contextmanager
def changed(**members: Any) -> Iterator[None]:
    """The sgm module with other members for a while."""
    kept = {name: getattr(sgm, name) for name in members}
    try:
        for name, value in members.items():
            setattr(sgm, name, value)
        yield
    finally:
        for name, value in kept.items():
            setattr(sgm, name, value)


def _with_mode(mode: int, block: int = 3, p1: int = 16, p2: int = 64) -> Callable[[int], Any]:
    def matcher(count: int) -> Any:
        return cv2.StereoSGBM_create(0, -(-count // 16) * 16, block, p1 * block * block, p2 * block * block, -1, 31, 0,
                                     0, 0, mode)
    return matcher


VARIANTS: Dict[str, Dict[str, Any]] = {
    "as it is": {},
    "eight-way aggregation": {"_matcher": _with_mode(cv2.STEREO_SGBM_MODE_HH)},
    "five-way aggregation": {"_matcher": _with_mode(cv2.STEREO_SGBM_MODE_SGBM)},
    "blocks of 1 px": {"_matcher": _with_mode(cv2.STEREO_SGBM_MODE_SGBM_3WAY, 1, 24, 96)},
    "blocks of 5 px": {"_matcher": _with_mode(cv2.STEREO_SGBM_MODE_SGBM_3WAY, 5, 8, 32)},
    "penalties halved": {"_matcher": _with_mode(cv2.STEREO_SGBM_MODE_SGBM_3WAY, 3, 8, 32)},
    "penalties doubled": {"_matcher": _with_mode(cv2.STEREO_SGBM_MODE_SGBM_3WAY, 3, 32, 128)},
    "matched one way only": {"_agree": lambda forth, back, high: np.isfinite(forth)},
    "ways may differ by 2 px": {"_AGREE_PX": 2.0},
    "islands kept": {"_without_islands": lambda disparity, low: disparity},
    "not sharpened": {"_sharpened": lambda disparity, first, second, high: disparity},
    "sharpened without noise floor": {"_SHARPEN_NOISE": 1e-4},
    "no median": {"_median": lambda disparity: disparity},
    "occlusions left empty": {"_with_background": lambda disparity, nearer: disparity.copy()},
}


def main() -> None:
    gdal.SetCacheMax(64 << 20)
    with tempfile.TemporaryDirectory() as folder:
        town = run_stage("sampledata", {"folder": f"{folder}/town", "kind": "urban", "size": 800, "seed": 1}, Silent())
        cases = [Case("simulated town", town["images"], town["truth"], True, folder)]
        for name, reference, align in (("truth_urban", "truth.tif", True), ("pleiades_pair", "s2p_dsm.tif", False)):
            data = SHARED / name
            if data.exists():
                cases.append(Case(name, [str(data / "img_01.tif"), str(data / "img_02.tif")], str(data / reference),
                                  align, folder))
        parts = []
        for case in cases:
            rows = []
            for label, members in VARIANTS.items():
                with changed(**members):
                    rows.append([label, *(round(value, 3) for value in case.score(sgm.match))])
            parts.append(f"{case.name}, {case.first.shape[1]} x {case.first.shape[0]} px, "
                         f"{case.disparities[1] - case.disparities[0]} disparities" + (
                             "" if case.align else " (reference: S2P's DSM)") + ":")
            parts.append(table(["matcher", "CPU s", "valid %", "ME m", "MAE m", "RMSE m", "C1 %", "C2.5 %"], rows))
        absent = "" if len(cases) == 3 else f"Parts not measured: '{SHARED}' is absent."
        publish("matching", "The matcher's choices", "make bench-matching", [*parts, absent])


if __name__ == "__main__":
    main()
