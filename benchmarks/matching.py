"""The matcher's choices measured, one change at a time (``make bench-matching``).

Each row is one pair of one scene matched and gridded to 0.5 m as the pipeline does, with something of the ``sgm``
backend left out or replaced, and scored on all cells of the reference, after the best whole-cell shift and the median
height difference where the scene has a truth (pointing without ground control leaves such a shift).
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List

import cv2
import numpy as np
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.dsm import fusion  # noqa: E402
from repm_qgis.dsm.aggregation import aggregate  # noqa: E402
from repm_qgis.evaluation.scoring import score  # noqa: E402
from repm_qgis.geometry.cell_grid import CellGrid  # noqa: E402
from repm_qgis.imagery.enhancement import view_stretch  # noqa: E402
from repm_qgis.imagery.raster import opened, read  # noqa: E402
from repm_qgis.matching import edges, occlusions, pair_backend, sgm, subpixel  # noqa: E402
from repm_qgis.matching.disparity_map import DisparityMap  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.scene import Scene  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402
from repm_qgis.stereo.height_maps import HeightMap  # noqa: E402
from repm_qgis.stereo.pairing import grown, rectified_pair  # noqa: E402
from repm_qgis.stereo.triangulation import pair_geometry  # noqa: E402

SHARED = Path(os.environ.get("REPM_SHARED_DATA", ROOT.parent / "shared" / "data"))
CELL = 0.5
MODULES = {"pair_backend": pair_backend, "sgm": sgm, "edges": edges, "subpixel": subpixel, "occlusions": occlusions}


class Case:
    """One pair of a scene, rectified and sampled, and the reference it is scored against."""

    def __init__(self, name: str, images: List[str], reference: str, align: bool, folder: str) -> None:
        self.name, self.align = name, align
        work = f"{folder}/{name}"
        made = run_stage(
            "pipeline", {"images": images[:2], "workspace": work, "output": f"{work}.tif", "resolution": CELL}, Silent()
        )
        scene = Scene.load(made["scene"])
        tile, self.views = scene.tiles[0], scene.views[:2]
        names = tuple(view.name for view in self.views)
        stretches = tuple(view_stretch(view.image, view.band) for view in self.views)
        self.task = pair_backend.PairTask(
            sgm.BACKEND, scene, tile.id, tile.bounds, tile.altitudes, names, stretches, "", ""
        )
        self.pair = rectified_pair(scene, *self.views, grown(tile.bounds, 32 * scene.gsd_m), tile.altitudes)
        self.geometry = pair_geometry(self.pair, *self.views, tile.altitudes, scene.crs)
        with opened(reference) as dataset:
            west, cell, _, north, _, _ = dataset.GetGeoTransform()
            size = dataset.RasterXSize, dataset.RasterYSize
            step = max(1, round(CELL / cell))
            self.truth = read(dataset).astype(np.float64)[::step, ::step]
        self.grid = CellGrid(west, north, cell * step, (size[1] // step, size[0] // step))
        self.truth = self.truth[: self.grid.shape[0], : self.grid.shape[1]]

    def matched(self) -> DisparityMap:
        """What the matcher, as it now is, finds."""
        return pair_backend._match(self.task, self.pair, self.geometry, *self.views)

    def dsm_of(self, found: DisparityMap) -> np.ndarray:
        """The DSM of a height map alone, on the truth's grid."""
        columns, rows = (np.arange(n, dtype=np.float64) for n in found.disparity.shape[::-1])
        height = self.geometry.height.on_grid(columns, rows, found.disparity.astype(np.float64))
        x, y = (part.on_grid(columns, rows, height) for part in (self.geometry.x, self.geometry.y))
        heights = HeightMap(x, y, height, found.score, found.filled)
        layer = fusion._layer(self.grid, heights, {"metres_per_px": self.geometry.metres_per_px}, self.task.scene.gsd_m)
        return aggregate([layer], "mean").height

    def score(self) -> List[float]:
        """CPU seconds, valid %, ME, MAE, RMSE (m), C1, C2.5 (%) of the matcher as it now is."""
        start = time.process_time()
        found = self.matched()
        seconds = time.process_time() - start
        m = score(self.dsm_of(found), self.truth, "cells" if self.align else "none", thresholds=(1.0, 2.5)).metrics
        return [seconds, m.valid, m.me, m.mae, m.rmse, *(share for _, share in m.completeness)]


@contextmanager
def changed(members: Dict[str, Any]) -> Iterator[None]:
    """Other members, named ``module.name``, in the matcher's modules for a while."""
    places = {name: (MODULES[name.split(".")[0]], name.split(".")[1]) for name in members}
    kept = {name: getattr(*place) for name, place in places.items()}
    try:
        for name, value in members.items():
            setattr(*places[name], value)
        yield
    finally:
        for name, value in kept.items():
            setattr(*places[name], value)


def _with_mode(mode: int, block: int = 1, p1: int = 12, p2: int = 48) -> Callable[[int], Any]:
    def matcher(count: int) -> Any:
        return cv2.StereoSGBM_create(
            0, -(-count // 16) * 16, block, p1 * block * block, p2 * block * block, -1, 31, 0, 0, 0, mode
        )

    return matcher


def _ranks(image: np.ndarray) -> np.ndarray:
    """How many of 7 x 7 neighbours are darker (Zabih and Woodfill 1994), spread over eight bits."""
    grey = np.nan_to_num(image).astype(np.float32)
    padded = cv2.copyMakeBorder(grey, 3, 3, 3, 3, cv2.BORDER_REFLECT)
    rank = np.zeros(grey.shape, np.uint8)
    for row in range(7):
        for column in range(7):
            rank += padded[row : row + grey.shape[0], column : column + grey.shape[1]] < grey
    return rank * np.uint8(5)


def _twice(disparity: Any, *others: Any) -> Any:
    return edges.at_edges(edges.at_edges(disparity, *others), *others)


def _large_pieces(disparity: Any, first: Any, second: Any, low: int, high: int) -> Any:
    return sgm._pieces(disparity, low, 80)


def _without_turns(disparity: Any, first: Any, second: Any, high: int) -> Any:
    """All steps on the brightness first, all smoothing after them."""
    with changed({"subpixel.denoised": lambda disparity: disparity, "subpixel._smoothed": lambda disparity: disparity}):
        sharp = subpixel.refined(disparity, first, second, high)
    return subpixel.denoised(sharp)


def _lowest_along_rows(disparity: Any, nearer: float, *_: object) -> Any:
    """Filling as it was first: the lower of a gap's two ends in its row."""
    known = np.isfinite(disparity)
    left, right, long = occlusions._ends(np.float32(nearer) * disparity, known)
    with np.errstate(invalid="ignore"):
        gap = ~known & (long <= np.abs(left - right) * 1.6 + 6)
    return np.where(gap, np.float32(nearer) * np.fmin(left, right), disparity)


AS_MATCHED = {"sgm.at_edges": lambda disparity, *others: disparity}
THREE, FIVE, EIGHT = cv2.STEREO_SGBM_MODE_SGBM_3WAY, cv2.STEREO_SGBM_MODE_SGBM, cv2.STEREO_SGBM_MODE_HH
VARIANTS: Dict[str, Dict[str, Any]] = {
    "as it is": {},
    "no coarse level": {"pair_backend.guide_of": lambda *_: None},
    "all that floats kept": {"pair_backend.without_unsupported": lambda matched, *_: matched},
    "OpenCV's eight ways, checked both ways, nothing else": {
        "sgm._matcher": _with_mode(EIGHT, 3, 8, 32),
        **AS_MATCHED,
        "sgm._without_islands": _large_pieces,
        "sgm.refined": lambda disparity, *others: disparity,
        "sgm.with_background": lambda disparity, *_: disparity.copy(),
    },
    "eight-way aggregation": {"sgm._matcher": _with_mode(EIGHT)},
    "eight ways, penalties 12 and 36": {"sgm._matcher": _with_mode(EIGHT, 1, 12, 36)},
    "five-way aggregation": {"sgm._matcher": _with_mode(FIVE)},
    "blocks of 3 px": {"sgm._matcher": _with_mode(THREE, 3, 16, 64)},
    "blocks of 5 px": {"sgm._matcher": _with_mode(THREE, 5, 8, 32)},
    "penalties halved": {"sgm._matcher": _with_mode(THREE, 1, 6, 24)},
    "penalties doubled": {"sgm._matcher": _with_mode(THREE, 1, 24, 96)},
    "ranks of 7 x 7 for brightness": {"sgm._grey": _ranks},
    "matched one way only": {"sgm._agree": lambda forth, back, high: np.isfinite(forth)},
    "ways may differ by 2 px": {"sgm._AGREE_PX": 2.0},
    "edges left as matched": AS_MATCHED,
    "edges: window does not follow the image": {
        "edges._guided": lambda guide, values: edges._mean(values, edges._SUPPORT)
    },
    "edges: window of 5 px": {"edges._SUPPORT": 5},
    "edges: window of 9 px": {"edges._SUPPORT": 9},
    "edges: 7 px to each side": {"edges._REACH": 7, "edges._NEIGHBOURHOOD": 13},
    "edges: twice": {"sgm.at_edges": _twice},
    "all islands kept": {"sgm._without_islands": lambda disparity, *others: disparity},
    "islands below 80 px dropped": {"sgm._without_islands": _large_pieces},
    "not sharpened": {"subpixel._moved": lambda disparity, *others: disparity},
    "sharpened, then smoothed, no turns": {"sgm.refined": _without_turns},
    "sharpened: noise does not count": {"subpixel._PRIOR_PX": 10.0},
    "sharpened: half as much expected (0.13 px)": {"subpixel._PRIOR_PX": 0.13},
    "sharpened: windows of 1 px": {"subpixel._SIGMA_PX": 1.0},
    "sharpened: windows of 2 px": {"subpixel._SIGMA_PX": 2.0},
    "noise left": {"subpixel.denoised": lambda disparity: disparity, "subpixel._smoothed": lambda disparity: disparity},
    "median only, over steps too": {
        "subpixel.denoised": subpixel.median,
        "subpixel._smoothed": lambda disparity: disparity,
    },
    "median only, not over steps": {"subpixel._smoothed": lambda disparity: disparity},
    "occlusions left empty": {"sgm.with_background": lambda disparity, *_: disparity.copy()},
    "occlusions: along rows only": {"sgm.with_background": _lowest_along_rows},
}


def _cases(folder: str) -> Iterator[Case]:
    for name, kind, size, seed, views in (
        ("town 1", "urban", 800, 1, (0, 1)),
        ("town 4", "urban", 700, 4, (1, 2)),
        ("mountains", "mountains", 700, 3, (0, 1)),
    ):
        made = run_stage(
            "sampledata", {"folder": f"{folder}/made {name}", "kind": kind, "size": size, "seed": seed}, Silent()
        )
        yield Case(f"simulated {name}", [made["images"][view] for view in views], made["truth"], True, folder)
    for name, reference, align in (("truth_urban", "truth.tif", True), ("pleiades_pair", "s2p_dsm.tif", False)):
        data = SHARED / name
        if data.exists():
            yield Case(name, [str(data / "img_01.tif"), str(data / "img_02.tif")], str(data / reference), align, folder)


def main() -> None:
    gdal.SetCacheMax(64 << 20)
    parts = []
    with tempfile.TemporaryDirectory() as folder:
        for case in _cases(folder):
            rows = []
            for label, members in VARIANTS.items():
                with changed(members):
                    rows.append([label, *(round(value, 3) for value in case.score())])
            low, high = case.geometry.disparities
            parts.append(
                f"{case.name}, {case.pair.size[0]} x {case.pair.size[1]} px, {high - low:.0f} disparities"
                + ("" if case.align else " (reference: S2P's DSM)")
                + ":"
            )
            parts.append(table(["matcher", "CPU s", "valid %", "ME m", "MAE m", "RMSE m", "C1 %", "C2.5 %"], rows))
    absent = "" if SHARED.exists() else f"Parts not measured: '{SHARED}' is absent."
    publish("matching", "The matcher's choices", "make bench-matching", [*parts, absent])


if __name__ == "__main__":
    main()
