"""The matcher's choices measured, one change at a time (``make bench-matching``).

Each row is one pair of one scene matched and gridded to 0.5 m as the pipeline does, with one choice of the ``sgm``
backend changed, and scored on all cells of the reference, after the best whole-cell shift and the median
height difference where the scene has a truth (pointing without ground control leaves such a shift).
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Iterator, List

import numpy as np
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.dsm.aggregation import aggregate  # noqa: E402
from repm_qgis.dsm.fusion import grid_height_map  # noqa: E402
from repm_qgis.dsm.parameters import FUSION  # noqa: E402
from repm_qgis.evaluation.scoring import score  # noqa: E402
from repm_qgis.geometry.cell_grid import CellGrid  # noqa: E402
from repm_qgis.imagery.enhancement import view_stretch  # noqa: E402
from repm_qgis.imagery.raster import opened, read  # noqa: E402
from repm_qgis.matching import sgm  # noqa: E402
from repm_qgis.matching.disparity_map import DisparityMap  # noqa: E402
from repm_qgis.matching.pair_backend import PairTask, match_pair, rectified_over_tile  # noqa: E402
from repm_qgis.matching.parameters import MATCHING, MatchingParameters  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.scene import Scene  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402
from repm_qgis.stereo.height_maps import HeightMap  # noqa: E402
from repm_qgis.stereo.triangulation import pair_geometry  # noqa: E402

SHARED = Path(os.environ.get("REPM_SHARED_DATA", ROOT.parent / "shared" / "data"))
CELL = 0.5


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
        self.task = PairTask(sgm.BACKEND, scene, tile.id, tile.bounds, tile.altitudes, names, stretches, "", "")
        self.pair = rectified_over_tile(scene, names, tile.bounds, tile.altitudes)
        self.geometry = pair_geometry(self.pair, *self.views, tile.altitudes, scene.crs)
        with opened(reference) as dataset:
            west, cell, _, north, _, _ = dataset.GetGeoTransform()
            size = dataset.RasterXSize, dataset.RasterYSize
            step = max(1, round(CELL / cell))
            self.truth = read(dataset).astype(np.float64)[::step, ::step]
        self.grid = CellGrid(west, north, cell * step, (size[1] // step, size[0] // step))
        self.truth = self.truth[: self.grid.shape[0], : self.grid.shape[1]]

    def matched(self, parameters: MatchingParameters) -> DisparityMap:
        """What the matcher finds with these parameters."""
        return match_pair(replace(self.task, parameters=parameters), self.pair, self.geometry)

    def dsm_of(self, found: DisparityMap) -> np.ndarray:
        """The DSM of a height map alone, on the truth's grid."""
        columns, rows = (np.arange(n, dtype=np.float64) for n in found.disparity.shape[::-1])
        height = self.geometry.height.on_grid(columns, rows, found.disparity.astype(np.float64))
        x, y = (part.on_grid(columns, rows, height) for part in (self.geometry.x, self.geometry.y))
        heights = HeightMap(x, y, height, found.score, found.filled)
        metres, spacing = self.geometry.metres_per_px, self.task.scene.gsd_m
        layer = grid_height_map(self.grid, heights, metres, spacing, FUSION)
        return aggregate([layer], "mean").height

    def score(self, parameters: MatchingParameters) -> List[float]:
        """CPU seconds, valid %, ME, MAE, RMSE (m), C1, C2.5 (%) of the matcher with these parameters."""
        start = time.process_time()
        found = self.matched(parameters)
        seconds = time.process_time() - start
        m = score(self.dsm_of(found), self.truth, "cells" if self.align else "none", thresholds=(1.0, 2.5)).metrics
        return [seconds, m.valid, m.me, m.mae, m.rmse, *(share for _, share in m.completeness)]


def _changed(**sets: Dict[str, Any]) -> MatchingParameters:
    """The default parameters with other values in some of their sets."""
    return replace(MATCHING, **{name: replace(getattr(MATCHING, name), **values) for name, values in sets.items()})


NEVER = 2**31 - 1
AS_MATCHED = {"median_px": 1, "step_px": math.inf}
STEPS = ("step",) * 4
VARIANTS: Dict[str, MatchingParameters] = {
    "as it is": MATCHING,
    "no coarse level": _changed(prior={"least_span_px": math.inf}),
    "reliability mask off": _changed(reliability={"least_px": NEVER, "endless_px": NEVER}),
    "OpenCV's eight paths, consistency check and speckle filter only": _changed(
        sgm={"paths": 8, "block_px": 3, "p1": 72, "p2": 288, "tower_score": 2.0},
        edges=AS_MATCHED,
        subpixel={"operations": ()},
        occlusions={"slack_px": -math.inf, "narrow_px": -1},
    ),
    "eight-path aggregation": _changed(sgm={"paths": 8}),
    "eight paths, penalties 12 and 36": _changed(sgm={"paths": 8, "p2": 36}),
    "five-path aggregation": _changed(sgm={"paths": 5}),
    "blocks of 3 px": _changed(sgm={"block_px": 3, "p1": 144, "p2": 576}),
    "blocks of 5 px": _changed(sgm={"block_px": 5, "p1": 200, "p2": 800}),
    "penalties halved": _changed(sgm={"p1": 6, "p2": 24}),
    "penalties doubled": _changed(sgm={"p1": 24, "p2": 96}),
    "no left-right consistency check": _changed(sgm={"left_right_px": math.inf}),
    "left and right may differ by 2 px": _changed(sgm={"left_right_px": 2.0}),
    "edges as matched": _changed(edges=AS_MATCHED),
    "edges: window does not follow the image": _changed(edges={"contrast": 1e3}),
    "edges: window of 5 px": _changed(edges={"window_px": 5}),
    "edges: window of 9 px": _changed(edges={"window_px": 9}),
    "edges: 7 px to each side": _changed(edges={"reach_px": 7, "surface_window_px": 13}),
    "all speckles kept": _changed(sgm={"speckle_px": 0, "tower_px": 0}),
    "speckles below 80 px removed, towers too": _changed(sgm={"tower_score": 2.0}),
    "no subpixel steps": _changed(subpixel={"operations": ("median", "mean", "mean", "mean")}),
    "subpixel steps, then filters, not in turns": _changed(subpixel={"operations": (*STEPS, "median", "mean")}),
    "subpixel: noise has no weight": _changed(subpixel={"prior_px": 10.0}),
    "subpixel: half as much expected (0.13 px)": _changed(subpixel={"prior_px": 0.13}),
    "subpixel: windows of 1 px": _changed(subpixel={"sigma_px": 1.0}),
    "subpixel: windows of 2 px": _changed(subpixel={"sigma_px": 2.0}),
    "noise not filtered": _changed(subpixel={"operations": STEPS}),
    "median only, over steps too": _changed(
        subpixel={"operations": (*STEPS[:2], "median", *STEPS[:2]), "edge_px": math.inf}
    ),
    "median only, not over steps": _changed(subpixel={"operations": (*STEPS[:2], "median", *STEPS[:2])}),
    "occlusions not filled": _changed(occlusions={"slack_px": -math.inf, "narrow_px": -1}),
    "occlusions: along rows only": _changed(occlusions={"narrow_px": -1}),
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
            for label, parameters in VARIANTS.items():
                rows.append([label, *(round(value, 3) for value in case.score(parameters))])
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
