"""The matcher's choices measured, one change at a time.

Each row is one pair of one scene matched and gridded to 0.5 m as the pipeline does, with one choice of the ``sgm``
backend changed, and scored on all cells of the reference, after the best whole-cell shift and the median height
difference where the scene has a truth (pointing without ground control leaves such a shift).
"""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import replace
from functools import partial
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import cv2
import numpy as np

from benchmarks.runner import few, is_quick, pipeline, there
from benchmarks.scenes import Scene, absent, default, real
from benchmarks.tables import Details, Section, table
from repm_qgis.contracts.arrays import FloatImage
from repm_qgis.contracts.options import INTENSITY
from repm_qgis.evaluation.scoring import score
from repm_qgis.fusion.aggregation import aggregate, rim_cells
from repm_qgis.fusion.parameters import FUSION
from repm_qgis.fusion.tile_fusion import grid_height_map
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.imagery.raster import opened, read
from repm_qgis.matching import sgm
from repm_qgis.matching.depth_edges import correct_depth_edges
from repm_qgis.matching.disparity_map import DisparityMap
from repm_qgis.matching.pair_backend import PairBackend, PairTask, match_pair, rectified_over_tile
from repm_qgis.matching.parameters import MATCHING, DetailParameters, MatchingParameters
from repm_qgis.matching.subpixel import known_median
from repm_qgis.scene import Scene as SceneFile
from repm_qgis.stereo.height_maps import HeightMap
from repm_qgis.stereo.triangulation import pair_geometry

CELL = 0.5
HEADERS = "matcher | CPU s | valid % | MedAE m | MAE m | RMSE m | C1 % | C2.5 %"


class MatchedPair:
    """One pair of one tile, as the pipeline matches it."""

    def __init__(self, scene: SceneFile, views: Tuple[int, int]) -> None:
        tile, first, second = scene.tiles[0], scene.views[views[0]], scene.views[views[1]]
        names = first.name, second.name
        stretches = view_stretch(first.image, first.band), view_stretch(second.image, second.band)
        self.task = PairTask(sgm.BACKEND, scene, tile.id, tile.bounds, tile.altitudes, names, stretches, "", "")
        self.frame = there(rectified_over_tile(scene, names, tile.bounds, tile.altitudes))
        self.geometry = pair_geometry(self.frame, first, second, tile.altitudes, scene.crs)

    def matched(
        self,
        parameters: MatchingParameters = MATCHING,
        backend: PairBackend = sgm.BACKEND,
        cost: str = INTENSITY,
    ) -> DisparityMap:
        task = replace(self.task, parameters=parameters, backend=backend, cost=cost)
        return match_pair(task, self.frame, self.geometry)


class Case(MatchedPair):
    """A pair of a scene, and the reference that its DSM is scored against."""

    def __init__(self, scene: Scene, views: Tuple[int, int] = (0, 1), name: str = "") -> None:
        self.name, self.align = name or scene.name, scene.align
        with tempfile.TemporaryDirectory() as work:
            made = pipeline([scene.images[view] for view in views], work, resolution=CELL)
            super().__init__(SceneFile.load(made.scene), (0, 1))
        with opened(scene.reference) as dataset:
            west, cell, _, north, _, _ = dataset.GetGeoTransform()
            size = dataset.RasterXSize, dataset.RasterYSize
            step = max(1, round(CELL / cell))
            truth = read(dataset).astype(np.float64)[::step, ::step]
        self.grid = CellGrid(west, north, cell * step, (size[1] // step, size[0] // step))
        self.truth = truth[: self.grid.shape[0], : self.grid.shape[1]]

    def dsm_of(self, found: DisparityMap) -> np.ndarray:
        """The DSM of a height map alone, on the truth's grid."""
        columns, rows = (np.arange(n, dtype=np.float64) for n in found.disparity.shape[::-1])
        height = self.geometry.height.on_grid(columns, rows, found.disparity.astype(np.float64))
        x, y = (part.on_grid(columns, rows, height) for part in (self.geometry.x, self.geometry.y))
        heights, spacing = HeightMap(x, y, height, found.score, found.filled), self.task.scene.gsd_m
        layer = grid_height_map(self.grid, heights, self.geometry.metres_per_px, spacing, FUSION)
        return aggregate([layer], "mean", rim_cells(spacing, CELL)).height

    def score(self, parameters: MatchingParameters, backend: PairBackend) -> List[float]:
        """CPU seconds, valid %, MedAE, MAE, RMSE (m), C1, C2.5 (%) of the matcher with these parameters."""
        start = time.process_time()
        found = self.matched(parameters, backend)
        seconds = time.process_time() - start
        m = score(self.dsm_of(found), self.truth, "cells" if self.align else "none", thresholds=(1.0, 2.5)).metrics
        return [seconds, m.valid, m.medae, m.mae, m.rmse, *(share for _, share in m.completeness)]


def ranks(image: np.ndarray) -> np.ndarray:
    """How many of 7 x 7 neighbours are darker (Zabih and Woodfill 1994), spread over eight bits."""
    grey = np.nan_to_num(image).astype(np.float32)
    padded = cv2.copyMakeBorder(grey, 3, 3, 3, 3, cv2.BORDER_REFLECT)
    rank = np.zeros(grey.shape, np.uint8)
    for row in range(7):
        for column in range(7):
            rank += padded[row : row + grey.shape[0], column : column + grey.shape[1]] < grey
    return rank * np.uint8(5)


def corrected_twice(disparity: np.ndarray, *others: Any) -> np.ndarray:
    return correct_depth_edges(correct_depth_edges(disparity, *others), *others)


def lower_end_of_rows(
    first: FloatImage,
    second: FloatImage,
    disparities: Tuple[int, int],
    height_sign: float,
    relief_displacement: float = 0.0,
    parameters: MatchingParameters = MATCHING,
) -> DisparityMap:
    """The matcher with occlusions filled as in its first version: by the lower of a gap's two ends in its row."""
    empty = replace(parameters, occlusions=replace(parameters.occlusions, **NOT_FILLED))
    found = sgm.match(first, second, disparities, height_sign, relief_displacement, empty)
    surface, columns = np.float32(height_sign) * found.disparity, np.arange(first.shape[1])[None, :]
    known, rows = np.isfinite(surface), np.arange(first.shape[0])[:, None]
    before = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, columns, first.shape[1])[:, ::-1], axis=1)[:, ::-1]
    inside = (before >= 0) & (after < first.shape[1])
    left, right = surface[rows, np.maximum(before, 0)], surface[rows, np.minimum(after, first.shape[1] - 1)]
    occluded = after - before - 1 <= np.abs(left - right) * 1.6 + 6
    filled = ~known & inside & occluded & np.isfinite(first)
    dense = np.where(filled, np.float32(height_sign) * np.fmin(left, right), found.disparity)
    return DisparityMap(np.where(filled, known_median(dense, 5), dense), found.score, filled)


def changed(**sets: Mapping[str, object]) -> MatchingParameters:
    """The default parameters with other values in some of their sets."""
    return replace(MATCHING, **{name: replace(getattr(MATCHING, name), **values) for name, values in sets.items()})


def operations(*names: str, **values: object) -> MatchingParameters:
    return changed(subpixel={"operations": names, **values})


NEVER = 2**31 - 1
NO_MASK = changed(reliability={"least_px": NEVER, "endless_px": NEVER})
AS_MATCHED = {"median_px": 1, "step_px": math.inf}
NOT_FILLED: Dict[str, Any] = {"slack_px": -math.inf, "narrow_px": -1}
STEP, STEPS = ("step",) * 2, ("step",) * 4
VARIANTS: Dict[str, MatchingParameters] = {
    "as it is": MATCHING,
    "no coarse level": changed(prior={"least_span_px": math.inf}),
    "reliability mask off": NO_MASK,
    "OpenCV's eight paths, consistency check and speckle filter only": changed(
        sgm={"paths": 8, "block_px": 3, "p1": 72, "p2": 288, "tower_score": 2.0},
        edges=AS_MATCHED,
        subpixel={"operations": ()},
        occlusions=NOT_FILLED,
    ),
    "eight-path aggregation": changed(sgm={"paths": 8}),
    "eight paths, penalties 12 and 36": changed(sgm={"paths": 8, "p2": 36}),
    "five-path aggregation": changed(sgm={"paths": 5}),
    "blocks of 3 px": changed(sgm={"block_px": 3, "p1": 144, "p2": 576}),
    "blocks of 5 px": changed(sgm={"block_px": 5, "p1": 200, "p2": 800}),
    "penalties halved": changed(sgm={"p1": 6, "p2": 24}),
    "penalties doubled": changed(sgm={"p1": 24, "p2": 96}),
    "ranks of 7 x 7 for intensity": MATCHING,
    "no left-right consistency check": changed(sgm={"left_right_px": math.inf}),
    "left and right may differ by 2 px": changed(sgm={"left_right_px": 2.0}),
    "edges as matched": changed(edges=AS_MATCHED),
    "edges: window does not follow the image": changed(edges={"contrast": 1e3}),
    "edges: window of 5 px": changed(edges={"window_px": 5}),
    "edges: window of 9 px": changed(edges={"window_px": 9}),
    "edges: 7 px to each side": changed(edges={"reach_px": 7, "surface_window_px": 13}),
    "edges: twice": MATCHING,
    "all speckles kept": changed(sgm={"speckle_px": 0, "tower_px": 0}),
    "speckles below 80 px removed, towers too": changed(sgm={"tower_score": 2.0}),
    "no subpixel steps": operations("median", "mean", "mean", "mean"),
    "subpixel steps, then filters, not in turns": operations(*STEPS, "median", "mean"),
    "subpixel: noise has no weight": changed(subpixel={"prior_px": 10.0}),
    "subpixel: half as much expected (0.13 px)": changed(subpixel={"prior_px": 0.13}),
    "subpixel: windows of 1 px": changed(subpixel={"sigma_px": 1.0}),
    "subpixel: windows of 2 px": changed(subpixel={"sigma_px": 2.0}),
    "means instead of detail": operations(*STEP, "median", "mean", "step", "mean", "step", "mean"),
    "detail: all of the noise": changed(subpixel={"detail": DetailParameters(noise_share=1.0)}),
    "detail: all scales at the full resolution": changed(subpixel={"full_scale_px": math.inf}),
    "detail: noise taken for white": changed(subpixel={"correlation_lags": 0}),
    "detail: 0.5 px of disparity are alike": changed(subpixel={"alike_detail_px": 0.5}),
    "detail: up to means of 4 px": changed(subpixel={"detail": DetailParameters((1.0, 2.0, 4.0))}),
    "noise not filtered": operations(*STEPS),
    "median only, over steps too": operations(*STEP, "median", *STEP, edge_px=math.inf),
    "median only, not over steps": operations(*STEP, "median", *STEP),
    "occlusions not filled": changed(occlusions=NOT_FILLED),
    "occlusions: along rows only": MATCHING,
}
BACKENDS = {
    "ranks of 7 x 7 for intensity": PairBackend("ranks", partial(sgm.match, to_bytes=ranks)),
    "edges: twice": PairBackend("twice", partial(sgm.match, correct_edges=corrected_twice)),
    "occlusions: along rows only": PairBackend("rows", lower_end_of_rows),
}
"""Variants that are no matter of numbers: a function of the matcher is another one."""


SIMULATED: Sequence[Tuple[str, Tuple[str, int, int], Tuple[int, int]]] = (
    ("simulated town 1", ("urban", 800, 1), (0, 1)),
    ("simulated town 4", ("urban", 700, 4), (1, 2)),
    ("simulated mountains", ("mountains", 700, 3), (0, 1)),
)
"""Name, kind, size and seed, and the two views."""


def choices() -> List[str]:
    cases = [Case(default(*spec), views, name) for name, spec, views in few(SIMULATED)]
    texts: List[str] = []
    for case in few(cases + [Case(scene) for scene in real("truth_urban") if not is_quick()]):
        rows = []
        for label in [*few(VARIANTS), *BACKENDS] if is_quick() else VARIANTS:
            found = case.score(VARIANTS[label], BACKENDS.get(label, sgm.BACKEND))
            rows.append([label, *(round(value, 3) for value in found)])
        (low, high), (width, height) = case.geometry.disparities, case.frame.size
        kind = str if case.name == "truth_urban" else Details
        head = f"{case.name}, {width} x {height} px, {high - low:.0f} disparities:"
        texts += [kind(head), kind(table(HEADERS, rows))]
    return [*texts, *absent("truth_urban")]


SECTIONS = [Section("matching", "The matcher's choices", "make bench-matching", {"matching": choices})]
