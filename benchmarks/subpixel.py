"""What the fractions of a pixel are worth, taken apart with the true disparities of simulated scenes.

``make bench-subpixel``. The matcher's last step is started from what semi-global matching gives, and from the truth:
what it then leaves is the images' noise (steps on the brightness alone) and what smoothing costs (filters alone).
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

import cv2
import numpy as np
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.matching import changed  # noqa: E402
from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.imagery.enhancement import view_stretch  # noqa: E402
from repm_qgis.imagery.raster import opened, read  # noqa: E402
from repm_qgis.imagery.warping import sample_array  # noqa: E402
from repm_qgis.matching import pair_backend, sgm, subpixel  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.scene import Scene  # noqa: E402
from repm_qgis.simulation.scene import SceneSpec, make_scene  # noqa: E402
from repm_qgis.simulation.sensor import ZY3  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402
from repm_qgis.stereo.height_maps import MARGIN_PX  # noqa: E402
from repm_qgis.stereo.pairing import grown, rectified_pair  # noqa: E402
from repm_qgis.stereo.triangulation import PairGeometry, pair_geometry  # noqa: E402

SCENES: Dict[str, SceneSpec] = {
    "town, 700 px of 0.5 m": SceneSpec.default("urban", 700, 1),
    "mountains, 700 px of 1 m": SceneSpec.default("mountains", 700, 3),
    "ZY-3, 900 px of 2.5 m": SceneSpec(
        "mountains", 900, 11, ZY3, cell_m=2.5, surface_step=1, base_m=300.0, relief_m=700.0, lon=6.65, lat=44.38
    ),
}
_RIM = 20
_KEPT = {"subpixel.denoised": lambda disparity: disparity, "subpixel._smoothed": lambda disparity: disparity}
_STILL = {"subpixel._moved": lambda disparity, *others: disparity}
STARTS: List[Tuple[str, bool, Dict[str, Any]]] = [
    ("semi-global matching as it comes", False, {**_KEPT, **_STILL}),
    ("**refined**", False, {}),
    ("from the truth: refined", True, {}),
    ("from the truth: steps on the brightness only", True, _KEPT),
    ("from the truth: filters only", True, _STILL),
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
        tile, first, second = scene.tiles[0], *(scene.views[view] for view in views)
        stretches = tuple(view_stretch(view.image, view.band) for view in (first, second))
        pair = rectified_pair(scene, first, second, grown(tile.bounds, MARGIN_PX * scene.gsd_m), tile.altitudes)
        geometry = pair_geometry(pair, first, second, tile.altitudes, scene.crs)
        names = first.name, second.name
        task = pair_backend.PairTask(sgm.BACKEND, scene, "", tile.bounds, tile.altitudes, names, stretches, "", "")
        seen: Dict[str, Any] = {}

        def watched(disparity: Any, a: Any, b: Any, high: int) -> Any:
            seen.update(start=disparity, first=a, second=b, high=high)
            return subpixel.refined(disparity, a, b, high)

        guides: List[Any] = []

        def kept(*arguments: Any) -> Any:
            guides.append(guide_of(*arguments))
            return guides[-1]

        guide_of, pair_backend.guide_of = pair_backend.guide_of, kept
        try:
            with changed({"sgm.refined": watched}):
                matched = pair_backend._match(task, pair, geometry, first, second)
        finally:
            pair_backend.guide_of = guide_of
        self.seen, self.guide, self.metres_per_px = seen, guides[-1], geometry.metres_per_px
        self.truth = true_disparities(geometry, pair.size, truth, place)
        error = (matched.disparity - self.truth)[~matched.filled]
        self.truth += np.nanmedian(error)
        self.true_start = np.where(np.isfinite(seen["start"]), self._residual(), np.nan).astype(np.float32)

    def _residual(self) -> np.ndarray:
        """The true disparities around the guide that the second image was sampled on."""
        if self.guide is None:
            return self.truth
        residual = np.nan_to_num(self.seen["start"])
        for _ in range(8):
            residual = (residual - 0.7 * np.nan_to_num(self.guide.whole(residual) - self.truth)).astype(np.float32)
        found = np.abs(self.guide.whole(residual) - self.truth) < 0.02
        return np.where(found, residual, np.nan)

    def left(self, from_truth: bool, members: Dict[str, Any]) -> List[float]:
        """Median and 90 % of absolute errors, and the standard deviation of their means in the steps' window, px."""
        with changed(members):
            found = subpixel.refined(
                self.true_start if from_truth else self.seen["start"],
                self.seen["first"],
                self.seen["second"],
                self.seen["high"],
            )
        error = (found if self.guide is None else self.guide.whole(found)) - self.truth
        known = np.isfinite(error) & np.isfinite(self.true_start)
        known[:_RIM] = known[-_RIM:] = known[:, :_RIM] = known[:, -_RIM:] = False
        # What lies on another surface is not a matter of fractions.
        near = known & (np.abs(error) < 1)
        mean = cv2.GaussianBlur(np.where(near, error, 0.0), (0, 0), subpixel._SIGMA_PX)
        mean /= np.maximum(cv2.GaussianBlur(near.astype(float), (0, 0), subpixel._SIGMA_PX), 1e-3)
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
                for what, from_truth, members in STARTS:
                    rows.append(
                        [
                            label,
                            round(case.metres_per_px, 2),
                            what,
                            *(round(value, 3) for value in case.left(from_truth, members)),
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
