"""A frame in which the cameras of satellites are close, without skew, and have square pixels: for single precision.

A satellite is some 6e5 m away. In single precision, in which GPUs calculate, the last bit of such a depth is 6 cm,
homographies through such cameras have errors of tenths of a pixel, and the steps of COLMAP's search, which are shares
of the depth, are larger than all heights. But the world may be changed by any 4 x 4 projective map T if the cameras
are changed too: P' = P T^-1 sees the same pixels. Adapted COLMAP (Zhang, Snavely, Sun, Leveraging Vision Reconstruction
Pipelines for Satellite Imagery, 2019) changes COLMAP's depth; here the world is changed, and COLMAP is not.

T maps, in this order, the tile's middle to the origin, the mean viewing direction to the vertical (a shear that keeps
planes of equal height), the tile's width and altitude range to the unit, and the vertical's point at infinity to
z = D: ``(x, y, z) -> (x, y, z) / (1 + z / D)``. Satellites, which are almost infinitely far away, are then near
(0, 0, D) and look straight down; depths are D^2 / (D + z), so that their inverse is linear in the height.

The remaining skew and unequal focal lengths of a camera are removed by resampling its image with an upper-triangular
affinity, together with the refinement M.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, Bounds, FloatArray, Size
from ..contracts.errors import RpcInvalidError
from ..geometry.equivalent_error import RefinedPinhole
from ..geometry.pinhole import PinholeCamera, factorise
from ..geometry.refinement import apply_homography, translation
from ..scene import Scene, View
from ..stereo.pairing import ground_points, refined_view
from ..stereo.parameters import STEREO, StereoParameters
from .parameters import COLMAP, FrameParameters


@dataclass(frozen=True)
class ProjectiveFrame:
    """T (4, 4), from a scene's local ENU frame (m) to the frame of a tile."""

    matrix: FloatArray

    def from_enu(self, enu_m: FloatArray) -> FloatArray:
        """(..., 3) east, north, up to (..., 3) of this frame."""
        return _mapped(self.matrix, enu_m)

    def camera(self, camera: PinholeCamera) -> PinholeCamera:
        """K', R', t' of P T^-1: the same pixels, mostly with a skew; K'[1, 1] < 0 where the image is mirrored."""
        return factorise(camera.P @ np.linalg.inv(self.matrix))

    @classmethod
    def over(
        cls, cameras: Sequence[PinholeCamera], ground_enu: FloatArray, parameters: FrameParameters = COLMAP.frame
    ) -> "ProjectiveFrame":
        """The frame of a tile from its views' cameras and (N, 3) points that span the tile and its altitudes, all ENU.

        Raises RpcInvalidError where a camera looks along the ground.
        """
        distance, low, high = parameters.distance, ground_enu.min(axis=0), ground_enu.max(axis=0)
        origin = (low + high) / 2
        slope = np.mean([_ray_slope(camera, origin) for camera in cameras], axis=0)
        to_origin, shear = np.eye(4), np.eye(4)
        to_origin[:3, 3] = -origin
        shear[:2, 2] = -slope
        spread = np.abs(_mapped(shear @ to_origin, ground_enu)).max(axis=0)
        across = parameters.half_width * distance / max(float(spread[:2].max()), 1.0)
        up = min(distance / 3 / max(float(spread[2]), 1.0), parameters.most_stretch * across)
        projection = np.eye(4)
        projection[3, 2] = 1.0 / distance
        return cls(projection @ np.diag([across, across, up, 1.0]) @ shear @ to_origin)


def _mapped(matrix: FloatArray, points: FloatArray) -> FloatArray:
    homogeneous = np.asarray(points, dtype=np.float64) @ matrix[:, :3].T + matrix[:, 3]
    mapped: FloatArray = homogeneous[..., :3] / homogeneous[..., 3:]
    return mapped


def _ray_slope(camera: PinholeCamera, origin: FloatArray) -> FloatArray:
    """(2,) east and north by which a viewing ray through the tile's middle moves for each metre up."""
    pixel = np.append(camera.project(origin), 1.0)
    ray = np.linalg.solve(camera.K @ camera.R, pixel)
    if abs(ray[2]) < 0.1 * np.linalg.norm(ray):
        raise RpcInvalidError("an image looks along the ground, not down at it: is it another image's RPC?")
    slope: FloatArray = ray[:2] / ray[2]
    return slope


@dataclass(frozen=True)
class FrameView:
    """A view as COLMAP gets it: square pixels, no skew, first pixel's centre at (0, 0), world in the tile's frame.

    ``from_refined`` (3, 3) is the affinity from pixels of the refined image to those of this one.
    """

    view: View
    refined: RefinedPinhole
    camera: PinholeCamera
    from_refined: FloatArray
    size: Size

    def to_original(self, points: FloatArray) -> FloatArray:
        """(..., 2) original pixels from those of this image: the only resampling."""
        refined = apply_homography(np.linalg.inv(self.from_refined), points)
        return self.refined.to_original.original_from_refined(refined)

    def from_original(self, points: FloatArray) -> FloatArray:
        """(..., 2) pixels of this image from original ones."""
        return apply_homography(self.from_refined, self.refined.to_original.refined_from_original(points))


@dataclass(frozen=True)
class TileFrame:
    """The views that see a ground rectangle (``bounds`` in the scene's CRS) at some altitudes, in one frame.

    Images and tracks reach over ``wide``, the rectangle with its margin.
    """

    frame: ProjectiveFrame
    views: Tuple[FrameView, ...]
    bounds: Bounds
    wide: Bounds
    altitudes: Altitudes

    @property
    def largest_px(self) -> int:
        """Pixels of the largest image."""
        return max(view.size[0] * view.size[1] for view in self.views)

    def view(self, name: str) -> Optional[FrameView]:
        """The view with this name; None where it does not see the tile."""
        return next((view for view in self.views if view.view.name == name), None)

    def depths(self, scene: Scene) -> Tuple[float, float]:
        """Least and greatest depth of the tile's ground in any of its views."""
        ground = self.frame.from_enu(scene.frame.from_geodetic(ground_points(scene, self.wide, self.altitudes)))
        depths = np.array([view.camera.depth(ground) for view in self.views])
        return float(depths.min()), float(depths.max())


def tile_frame(
    scene: Scene,
    names: Sequence[str],
    bounds: Bounds,
    altitudes: Altitudes,
    parameters: FrameParameters = COLMAP.frame,
    stereo: StereoParameters = STEREO,
) -> Optional[TileFrame]:
    """The frame and the views of a ground rectangle with a margin; None where fewer than two of the views see it."""
    wide = Bounds(*bounds).grown(stereo.tile_margin_px * scene.gsd_m)
    refined = {name: refined_view(scene, scene.view(name), wide, altitudes) for name in names}
    seen = {name: found for name, found in refined.items() if found is not None}
    if len(seen) < 2:
        return None
    ground = scene.frame.from_geodetic(ground_points(scene, wide, altitudes))
    frame = ProjectiveFrame.over([found.camera for found in seen.values()], ground, parameters)
    made = [_frame_view(scene.view(name), found, frame, ground) for name, found in seen.items()]
    views = tuple(view for view in made if min(view.size) >= stereo.smallest_px)
    return TileFrame(frame, views, bounds, wide, altitudes) if len(views) >= 2 else None


def _frame_view(view: View, refined: RefinedPinhole, frame: ProjectiveFrame, ground_enu: FloatArray) -> FrameView:
    """A view whose image is limited to what it shows of the tile."""
    camera = frame.camera(refined.camera)
    focal = float(max(camera.K[0, 0], abs(camera.K[1, 1])))  # the finer axis: resampling loses nothing
    square = np.diag([focal, focal, 1.0])
    affinity = square @ np.linalg.inv(camera.K)
    shown = apply_homography(affinity, refined.camera.project(ground_enu))
    width, height = refined.size
    own = apply_homography(affinity, np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1.0]]))
    low = np.floor(np.maximum(shown.min(axis=0), own.min(axis=0)))
    high = np.ceil(np.minimum(shown.max(axis=0), own.max(axis=0)))
    straight = PinholeCamera(square, camera.R, camera.t).moved(*low)
    size = (max(int(high[0] - low[0]) + 1, 0), max(int(high[1] - low[1]) + 1, 0))
    return FrameView(view, refined, straight, translation(*-low) @ affinity, size)
