"""A tile as other software needs it: views with zero-skew cameras, image sizes, depths, and any tie points.

Pixels are column, row with the first pixel's centre at (0, 0), as everywhere here; formats that count from its corner
use :meth:`ExportView.corner_K`. The world is the scene's local ENU frame, metres, the same for all tiles.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Callable, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, Size
from ..contracts.errors import SceneError
from ..geometry.centring import centred, image_nodes
from ..geometry.equivalent_error import EquivalentError, RefinedPinhole
from ..geometry.frames import EnuFrame
from ..geometry.pinhole import PinholeCamera
from ..geometry.refinement import apply_homography
from ..scene import Scene, Tile, View

PixelMap = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class ExportView:
    """A refined image and its camera.

    Attributes
    ----------
    camera : pixels of the exported image; K[0, 1] is 0, K[0, 0] and K[1, 1] are positive and need not be equal.
    to_original : maps the exported image's pixels to the original's.
    size : width, height.
    depths : least and greatest depth of the ground that the image shows within the tile's altitudes, m.
    shift_px : (2,) how far relative pointing moved the principal point.
    ground : (n, 3) points that the image shows at the tile's lowest and highest altitude, in the frame.
    source : the refined 16-bit image with exactly these pixels; "" where it must be resampled.
    """

    view: View
    camera: PinholeCamera
    to_original: PixelMap
    size: Size
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
        """The step in depth: the footprint of one pixel at the middle depth, m."""
        return sum(self.depths) / 2 / float(np.sqrt(self.camera.K[0, 0] * self.camera.K[1, 1]))

    @property
    def depth_count(self) -> int:
        """The number of depths, one interval apart, from the least to the greatest depth."""
        return int(np.ceil((self.depths[1] - self.depths[0]) / self.depth_interval)) + 1

    def resampled(self, affinity: FloatArray, size: Size) -> "ExportView":
        """The view of an image whose pixel ``affinity`` @ p is this one's pixel p; (3, 3), no shear."""
        return self._seen_by(PinholeCamera(affinity @ self.camera.K, self.camera.R, self.camera.t), size)

    def centred(self) -> "ExportView":
        """The view of the camera rotated towards the image's middle, with square pixels."""
        camera, size = centred(self.camera, self.size)
        return self._seen_by(camera, size)

    def _seen_by(self, camera: PinholeCamera, size: Size) -> "ExportView":
        """The view of another camera at the same projection centre."""
        here_from_there = self.camera.K @ self.camera.R @ np.linalg.inv(camera.K @ camera.R)
        same_axis = np.allclose(camera.R[2], self.camera.R[2], rtol=0, atol=1e-12)
        depths = self.depths if same_axis else _range(camera, self.ground)

        def to_original(points: FloatArray) -> FloatArray:
            return self.to_original(apply_homography(here_from_there, points))

        return replace(self, camera=camera, size=size, depths=depths, source="", to_original=to_original)


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
        """A view's name for lists of other software: without blanks, and unique."""
        names = [re.sub(r"\s+", "_", view.name) for view in self.views]
        return names[index] if names.count(names[index]) == 1 else f"{names[index]}_{index}"


def tile_model(scene: Scene, tile: Tile, reuse_images: bool = True) -> TileModel:
    """A tile's views for export; raises SceneError where the tile is not refined."""
    views = []
    for name, tile_view in tile.views.items():
        if tile_view.refined is None:
            break
        image = (tile_view.image or "") if reuse_images else ""
        views.append(_export_view(scene, tile, name, tile_view.refined, image))
    if not views or len(views) < len(tile.views):
        raise SceneError(
            f"The tile '{tile.id}' of the scene '{scene.path}' has no refined images: run 'Refine the images' first, "
            "and export the scene that it writes."
        )
    return TileModel(tile, scene.frame, scene.crs, tuple(views))


def _export_view(scene: Scene, tile: Tile, name: str, refined: RefinedPinhole, image: str) -> ExportView:
    view, to_original = scene.view(name), refined.to_original
    nodes = image_nodes(refined.size)
    original = to_original.original_from_refined(nodes)
    shift = np.zeros(2)
    if view.jitter is not None or not np.array_equal(view.pointing, np.eye(2, 3)):
        # The mean shift from where the vendor's RPC puts the ground to where it is really seen.
        pointed = original @ view.pointing[:, :2].T + view.pointing[:, 2]
        pointed = pointed if view.jitter is None else view.jitter.added(pointed)
        shift = np.nanmean(to_original.refined_from_original(pointed) - nodes, axis=0)
    camera = refined.camera.moved(*-shift)
    places = np.concatenate([view.localise(original, altitude) for altitude in tile.altitudes])
    ground = scene.frame.from_geodetic(places[np.isfinite(places).all(axis=1)])
    pixels, depths = to_original.original_from_refined, _range(camera, ground)
    made = ExportView(view, camera, pixels, refined.size, depths, refined.error, shift, ground, image)
    if camera.K[1, 1] > 0:
        return made
    # A mirrored image has a negative focal length in K, which other software refuses: its rows are reversed.
    flip = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, refined.size[1] - 1.0], [0.0, 0.0, 1.0]])
    return made.resampled(flip, refined.size)


def _range(camera: PinholeCamera, ground: FloatArray) -> Tuple[float, float]:
    """Least and greatest depth of points."""
    depth = camera.depth(ground)
    return float(depth.min()), float(depth.max())
