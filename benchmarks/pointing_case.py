"""Truth scenes whose RPCs are wrong by known pointings, and how well pointing finds them again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from benchmarks.runner import stage
from benchmarks.scenes import CACHE, Scene, default
from repm_qgis.contracts.stages import EPMFIT
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.planning.pair_selection import choose_pairs
from repm_qgis.pointing.ground_control import Gcp
from repm_qgis.pointing.parameters import POINTING, PointingParameters
from repm_qgis.pointing.pointing import Pointing, point_views
from repm_qgis.rpc.fit import fit_rpc
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene as SceneFile
from repm_qgis.scene import View, load_views
from repm_qgis.simulation.scene import SceneSpec, make_views

_MARGIN_M = 30  # of the RPCs' heights beyond those of the surface


def write_image(path: Path, pixels: np.ndarray, tags: Dict[str, str]) -> str:
    size = pixels.shape[::-1]
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), *size, 1, gdal.GDT_UInt16, ["TILED=YES"])
    dataset.SetMetadata(tags, "RPC")
    dataset.GetRasterBand(1).WriteArray(pixels)
    dataset = None
    return str(path)


def numeric_moves(view: Any, ground: np.ndarray, enu: EnuFrame) -> np.ndarray:
    """(N, 2, 3) how a view's pixels move with ground points (N, 3), px/m."""
    local, seen = enu.from_geodetic(ground), view.project(ground)
    return np.stack([view.project(enu.to_geodetic(local + d)) - seen for d in np.eye(3)], axis=-1)


class Case:
    """A truth scene whose RPCs are wrong by known affine pointings, (2, 3) a view: vendor's pixel to the real one."""

    def __init__(self, made: Tuple[SceneSpec, Path], pointings: Sequence[np.ndarray], folder: Path) -> None:
        spec, base = made
        folder.mkdir(parents=True, exist_ok=True)
        self.truth, self.folder, self.size = base / "truth.tif", folder, spec.size
        self.true = make_views(spec)
        low, high = json.loads((base / "truth.json").read_text())["height_range_m"]
        self.images = []
        for view, A in zip(self.true, pointings):

            def real(px: np.ndarray, h: np.ndarray, view: Any = view, A: np.ndarray = A) -> np.ndarray:
                return view.localise(px @ A[:, :2].T + A[:, 2], h)

            rpc = fit_rpc(real, view.size, (low - _MARGIN_M, high + _MARGIN_M)).rpc
            pixels = gdal.Open(str(base / f"{view.name}.tif")).ReadAsArray()
            self.images.append(write_image(folder / f"{view.name}.tif", pixels, rpc_tags(rpc)))
        truth = gdal.Open(str(self.truth))
        self.surface, self.transform, self.crs = truth.ReadAsArray(), truth.GetGeoTransform(), truth.GetProjection()

    def views(self) -> List[View]:
        """The views as the vendor's RPCs have them."""
        return list(load_views(self.images))

    def scene(self) -> SceneFile:
        return fitted(self.images, self.folder / "w")

    def ground(self, count: int, seed: int) -> np.ndarray:
        """(N, 3) points of the true surface."""
        rng = np.random.default_rng(seed)
        rows, cols = (rng.integers(8, n - 8, count) for n in self.surface.shape)
        x = self.transform[0] + (cols + 0.5) * self.transform[1]
        y = self.transform[3] + (rows + 0.5) * self.transform[5]
        lon, lat = pyproj.Transformer.from_crs(self.crs, "EPSG:4326", always_xy=True).transform(x, y)
        return np.column_stack([lon, lat, self.surface[rows, cols]])

    def gcps(self, count: int, noise: float, wrong: int, seed: int) -> List[Gcp]:
        """Control points on the true surface; the first ``wrong`` were measured some 10 px away from it."""
        rng = np.random.default_rng(seed)
        points = []
        for number, ground in enumerate(self.ground(count, seed)):
            pixels = {view.name: view.project(ground[None])[0] + rng.normal(0, noise, 2) for view in self.true}
            if number < wrong:
                error = rng.uniform(4, 12, 2) * rng.choice((-1, 1), 2)
                pixels = {name: pixel + error for name, pixel in pixels.items()}
            lon, lat, height = map(float, ground)
            points.append(Gcp(f"G{number + 1:02d}", lon, lat, height, "control", pixels))
        return points

    def misfits(self, pointing: Dict[str, np.ndarray], ground: np.ndarray) -> List[np.ndarray]:
        """For each view, (N, 2) true pixels less those of a recovered pointing."""
        found = [view.with_pointing(pointing[view.name]) for view in self.views()]
        return [true.project(ground) - view.project(ground) for true, view in zip(self.true, found)]

    def observable_px(self, pointing: Dict[str, np.ndarray]) -> np.ndarray:
        """(N,) what a recovered pointing leaves that no move of the ground points takes up, px a view (RMS)."""
        ground = self.ground(600, 77)
        enu = EnuFrame(*ground.mean(axis=0))
        moves = [numeric_moves(view.with_pointing(pointing[view.name]), ground, enu) for view in self.views()]
        residual = np.concatenate(self.misfits(pointing, ground), axis=1)
        jacobian = np.concatenate(moves, axis=1)
        left = residual - np.einsum("nij,njk,nk->ni", jacobian, np.linalg.pinv(jacobian), residual)
        return np.sqrt((left**2).sum(axis=1) / len(self.true))

    def absolute_px(self, pointing: Dict[str, np.ndarray]) -> np.ndarray:
        """(N,) the largest error of a recovered pointing over the views at points of the surface, px."""
        return np.max([np.linalg.norm(m, axis=1) for m in self.misfits(pointing, self.ground(600, 78))], axis=0)


def fitted(images: Sequence[str], workspace: Path) -> SceneFile:
    """The scene with cameras, as the pipeline makes it by default."""
    made = stage(EPMFIT, images=list(images), workspace=str(workspace))
    return replace(SceneFile.load(made.scene), refinement="polynomial")


def pointed(scene: SceneFile, model: str = "auto", parameters: PointingParameters = POINTING) -> Pointing:
    pairs = choose_pairs(scene)
    stretches = {view.name: view_stretch(view.image, view.band) for view in scene.views}
    return point_views(scene, pairs, stretches, model=model, gcps=(), progress=Silent(), parameters=parameters)


def shift_of(col: float, row: float) -> np.ndarray:
    return np.array([[1.0, 0.0, col], [0.0, 1.0, row]])


def known_pointings(kind: str, size: int) -> List[np.ndarray]:
    """Shifts of up to 15 px; ``affine``: and a drift of up to 3 px from one side of the image to the other."""
    pointings = [shift_of(15.0, -11.0), shift_of(-12.0, 15.0), shift_of(4.0, -14.0)]
    if kind == "shift":
        return pointings
    middle = (size - 1) / 2
    drifts = [[3.0, -1.5], [1.0, 2.0]], [[-2.0, 3.0], [-3.0, 1.0]], [[1.5, -2.5], [3.0, -3.0]]
    for A, drift in zip(pointings, drifts):
        linear = np.array(drift) / size
        A[:, :2] += linear
        A[:, 2] -= linear @ [middle, middle]
    return pointings


def truth_scene(label: str) -> Scene:
    """The town or the hills, 800 px."""
    return default({"town": "urban", "hills": "mountains"}[label], 800, 5)


def case_of(label: str, kind: str = "shift") -> Case:
    """The town or the hills with known pointings."""
    scene = truth_scene(label)
    pointings = known_pointings(kind, scene.made.size)
    return Case((scene.made, scene.folder), pointings, CACHE / f"{scene.name}_{kind}")
