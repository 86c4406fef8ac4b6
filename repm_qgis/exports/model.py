"""A tile as other software wants it: views with zero-skew cameras, image sizes, depths, and perhaps some points.

Pixels are column, row with the first pixel's centre at (0, 0), as everywhere here; the layouts that count from its
corner take :meth:`ExportView.corner_K`. The world is the scene's local ENU frame, metres, the same for all tiles.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Callable, Tuple

import numpy as np

from ..arrays import FloatArray
from ..errors import SceneError
from ..geometry.equivalent_error import EquivalentError
from ..geometry.frames import EnuFrame
from ..geometry.pinhole import PinholeCamera
from ..geometry.refinement import apply_homography
from ..scene import Scene, Tile, View

PixelMap = Callable[[FloatArray], FloatArray]

_NODES = 9  # pixels a side, for depths and the shift of pointing


@dataclass(frozen=True)
class ExportView:
    """A refined image and its camera.

    Attributes
    ----------
    camera : pixels of the exported image; K[0, 1] is 0, K[0, 0] and K[1, 1] are positive and need not be equal.
    to_original : the exported image's pixels to the original's.
    size : width, height.
    depths : least and greatest depth of the ground that the image shows within the tile's altitudes, m.
    shift_px : (2,) how far relative pointing moved the principal point.
    ground : (n, 3) what the image shows at the tile's lowest and highest altitude, in the frame.
    source : the refined 16-bit image that shows these very pixels; "" where it has to be made.
    """

    view: View
    camera: PinholeCamera
    to_original: PixelMap
    size: Tuple[int, int]
    depths: Tuple[float, float]
    error: EquivalentError
    shift_px: FloatArray
    ground: FloatArray
    source: str = ""

    @property
    def name(self) -> str:
        return self.view.name

    @property
    def corner_K(self) -> FloatArray:  # noqa: N802
        """(3, 3) K for pixels that count from the first pixel's corner: its centre is (0.5, 0.5)."""
        K = self.camera.K.copy()
        K[:2, 2] += 0.5
        return K

    @property
    def cam_from_world(self) -> FloatArray:
        """(4, 4) [R t; 0 1]."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.camera.R, self.camera.t
        return matrix

    @property
    def depth_interval(self) -> float:
        """The step in depth that is one pixel's footprint at the middle depth, m."""
        return sum(self.depths) / 2 / float(np.sqrt(self.camera.K[0, 0] * self.camera.K[1, 1]))

    @property
    def depth_count(self) -> int:
        """How many depths one interval apart, the least depth the first, reach the greatest depth."""
        return int(np.ceil((self.depths[1] - self.depths[0]) / self.depth_interval)) + 1

    def resampled(self, affinity: FloatArray, size: Tuple[int, int]) -> "ExportView":
        """The view of an image whose pixel ``affinity`` @ p is this one's pixel p; (3, 3), no shear."""
        return self._seen_by(PinholeCamera(affinity @ self.camera.K, self.camera.R, self.camera.t), size)

    def centred(self) -> "ExportView":
        """The view of a camera that is turned towards the image's middle: principal point there, square pixels.

        The projection centre stays, so the image changes by a homography only, and is as exact as before. Satellites'
        cameras fitted without it look straight down, with a principal point up to a million pixels outside.
        """
        middle = (np.array(self.size) - 1.0) / 2
        ray = np.linalg.solve(self.camera.K, [*middle, 1.0])
        R = _turn_to(ray / np.linalg.norm(ray)) @ self.camera.R
        turned = PinholeCamera(np.eye(3), R, R @ self.camera.R.T @ self.camera.t)
        # One focal length that keeps the pixels' area at the middle.
        shape = R @ np.linalg.inv(self.camera.K @ self.camera.R)
        steps = apply_homography(shape, middle + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
        focal = abs(np.linalg.det([steps[0] - steps[1], steps[2] - steps[3]])) ** -0.5
        turned = PinholeCamera(np.diag([focal, focal, 1.0]), turned.R, turned.t)
        border = apply_homography(turned.K @ shape, _nodes(self.size))
        low, high = np.floor(border.min(axis=0)), np.ceil(border.max(axis=0))
        return self._seen_by(turned.moved(*low), (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1))

    def _seen_by(self, camera: PinholeCamera, size: Tuple[int, int]) -> "ExportView":
        """The view of another camera at the same projection centre."""
        old = self.to_original
        here_from_there = self.camera.K @ self.camera.R @ np.linalg.inv(camera.K @ camera.R)
        depths = self.depths
        if not np.allclose(camera.R[2], self.camera.R[2], rtol=0, atol=1e-12):
            depths = _range(camera, self.ground)
        return replace(
            self,
            camera=camera,
            size=size,
            depths=depths,
            source="",
            to_original=lambda points: old(apply_homography(here_from_there, points)),
        )


@dataclass(frozen=True)
class TileModel:
    """A tile's views; ``points`` (N, 3) are tie points in the frame, ``residuals_px`` (N,) theirs."""

    tile: Tile
    frame: EnuFrame
    crs: str
    views: Tuple[ExportView, ...]
    points: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    residuals_px: FloatArray = field(default_factory=lambda: np.empty(0))

    def file_name(self, index: int) -> str:
        """A view's name as other software can take it in a list: without blanks, and no other view's."""
        names = [re.sub(r"\s+", "_", view.name) for view in self.views]
        return names[index] if names.count(names[index]) == 1 else f"{names[index]}_{index}"


def tile_model(scene: Scene, tile: Tile, reuse_images: bool = True) -> TileModel:
    """A tile's views as they can be exported.

    Raises SceneError where the tile is not refined.
    """
    missing = [name for name, tile_view in tile.views.items() if tile_view.refined is None]
    if missing or not tile.views:
        raise SceneError(
            f"The tile '{tile.id}' of the scene '{scene.path}' has no refined images: run 'Refine the "
            "images' first, and export the scene that it writes."
        )
    return TileModel(
        tile, scene.frame, scene.crs, tuple(_export_view(scene, tile, name, reuse_images) for name in tile.views)
    )


def _export_view(scene: Scene, tile: Tile, name: str, reuse_image: bool) -> ExportView:
    view, tile_view = scene.view(name), tile.views[name]
    refined = tile_view.refined
    nodes = _nodes(refined.size)
    shift = _pointing_shift(view, refined.to_original, nodes)
    camera = refined.camera.moved(*-shift)
    ground = _ground(scene, tile, view, refined.to_original.original_from_refined(nodes))
    made = ExportView(
        view,
        camera,
        refined.to_original.original_from_refined,
        refined.size,
        _range(camera, ground),
        refined.error,
        shift,
        ground,
        (tile_view.image or "") if reuse_image else "",
    )
    if camera.K[1, 1] > 0:
        return made
    # A mirrored image has a negative focal length in K, which other software refuses: turn its rows round.
    width, height = refined.size
    return made.resampled(np.array([[1.0, 0.0, 0.0], [0.0, -1.0, height - 1.0], [0.0, 0.0, 1.0]]), (width, height))


def _nodes(size: Tuple[int, int]) -> FloatArray:
    """(n, 2) pixels spread over an image, its corners included."""
    u, v = (np.linspace(0, side - 1, _NODES) for side in size)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _pointing_shift(view: View, to_original: object, nodes: FloatArray) -> FloatArray:
    """(2,) mean shift, in refined px, from where the vendor's RPC puts the ground to where it is really seen."""
    if np.array_equal(view.pointing, np.eye(2, 3)):
        return np.zeros(2)
    vendor = to_original.original_from_refined(nodes)
    seen = to_original.refined_from_original(vendor @ view.pointing[:, :2].T + view.pointing[:, 2])
    return np.nanmean(seen - nodes, axis=0)


def _ground(scene: Scene, tile: Tile, view: View, original: FloatArray) -> FloatArray:
    """(n, 3) what original pixels show at the tile's lowest and highest altitude, in the scene's frame."""
    ground = np.concatenate([view.localise(original, altitude) for altitude in tile.altitudes])
    return scene.frame.from_geodetic(ground[np.isfinite(ground).all(axis=1)])


def _range(camera: PinholeCamera, ground: FloatArray) -> Tuple[float, float]:
    """Least and greatest depth of points."""
    depth = camera.depth(ground)
    return float(depth.min()), float(depth.max())


def _turn_to(direction: FloatArray) -> FloatArray:
    """(3, 3) the smallest rotation that takes a unit vector in front of a camera to its optical axis."""
    x, y, z = direction
    axis = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.eye(3) + axis + axis @ axis / (1.0 + z)
