"""From depths of a tile's frame to heights and ground positions: exact RPC geometry, tabulated on nodes.

COLMAP finds, for a pixel of the reference, the depth whose pinhole pixels in the other images look the same. Here this
is repeated with known ground: at each node the reference's ray is followed by its RPC to some altitudes, each source's
RPC gives the pixel of this ground, and the depth is the one whose pinhole pixels are nearest to those places. So the
errors of the pinhole cameras cancel, as they do for disparities in ``stereo/triangulation.py``. The height is a
parabola of the inverse depth, which in this frame is nearly a straight line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.errors import EmptyResultError
from ..geometry.frames import projected_from_geodetic
from ..geometry.pinhole import PinholeCamera
from ..scene import Scene
from ..stereo.parameters import STEREO, StereoParameters
from ..stereo.triangulation import NodeTable, nodes
from .parameters import COLMAP, ColmapParameters
from .projective_frame import FrameView, TileFrame

Seen = Sequence[Tuple[Tuple[FloatArray, FloatArray], FloatArray]]
"""For each source, how pixels move with the depth (:func:`_transfer`), and where its RPC says that they are."""


@dataclass(frozen=True)
class DepthGeometry:
    """Heights and ground positions of the pixels of a reference image.

    ``height`` takes column, row, 1 / depth to metres above the ellipsoid, ``x`` and ``y`` take column, row, height to
    coordinates of a CRS. ``metres_per_px`` is the height for one px in the source with the most parallax, which has
    the number ``best``; ``error_m`` is the largest error of the three tables at their levels, and
    ``vertical_parallax_px`` the largest distance between a source's pinhole pixel and the RPC's at the best depth.
    """

    height: NodeTable
    x: NodeTable
    y: NodeTable
    metres_per_px: float
    best: int
    error_m: float
    vertical_parallax_px: float


def depth_geometry(
    scene: Scene,
    tile: TileFrame,
    reference: FrameView,
    *,
    sources: Sequence[FrameView],
    crs: str,
    parameters: ColmapParameters = COLMAP,
    stereo: StereoParameters = STEREO,
) -> DepthGeometry:
    """Tabulate a reference view's heights over the tile's altitudes.

    Raises EmptyResultError where its RPC sees no ground there.
    """
    columns, rows = (nodes(n, stereo.node_step_px) for n in reference.size)
    z, r, c = np.meshgrid(np.linspace(*tile.altitudes, stereo.levels), rows, columns, indexing="ij")
    ground = reference.view.localise(reference.to_original(np.stack([c, r], axis=-1)), z)
    if not np.isfinite(ground).all():
        raise EmptyResultError(
            f"{reference.view.name} sees no ground within {tile.altitudes[0]:.0f} to "
            f"{tile.altitudes[1]:.0f} m: check ALTITUDE_MIN and ALTITUDE_MAX."
        )
    camera = reference.camera
    inverse = 1.0 / camera.depth(tile.frame.from_enu(scene.frame.from_geodetic(ground)))
    rays = np.stack([c, r, np.ones_like(c)], axis=-1) @ np.linalg.inv(camera.K).T
    seen = [(_transfer(camera, one.camera, rays), one.from_original(one.view.project(ground))) for one in sources]
    inverse, left_px, parallax = _inverse_depths(inverse, seen, parameters.depth_steps)
    xy = projected_from_geodetic(crs, ground)
    height, error_h = NodeTable.fit(columns, rows, inverse, z)
    x, error_x = NodeTable.fit(columns, rows, z, xy[..., 0])
    y, error_y = NodeTable.fit(columns, rows, z, xy[..., 1])
    best = int(np.argmax(parallax))
    metres = (tile.altitudes[1] - tile.altitudes[0]) / max(parallax[best], 1e-9)
    return DepthGeometry(height, x, y, metres, best, max(error_h, error_x, error_y), left_px)


def _inverse_depths(inverse: FloatArray, seen: Seen, steps: int) -> Tuple[FloatArray, float, List[float]]:
    """(levels, m, n) 1 / depth that fits the sources best, its largest residual in px, each source's parallax in px."""
    for _ in range(steps):
        top, bottom = np.zeros_like(inverse), np.zeros_like(inverse)
        for (still, moving), pixel in seen:
            at, slope = _pixel(still, moving, inverse)
            known = np.isfinite(pixel).all(axis=-1)  # a source may show a part of the tile only
            top += np.where(known, ((pixel - at) * slope).sum(axis=-1), 0.0)
            bottom += np.where(known, (slope * slope).sum(axis=-1), 0.0)
        inverse = inverse + np.where(bottom > 0, top / np.maximum(bottom, 1e-300), 0.0)
    ends = [(_pixel(still, moving, inverse)[0], pixel) for (still, moving), pixel in seen]
    left = [np.linalg.norm(at - pixel, axis=-1) for at, pixel in ends]
    parallax = [float(np.linalg.norm(at[-1] - at[0], axis=-1).mean()) for at, _ in ends]
    return inverse, float(np.nanmax(left, initial=0.0)), parallax


def _transfer(reference: PinholeCamera, source: PinholeCamera, rays: FloatArray) -> Tuple[FloatArray, FloatArray]:
    """(..., 3) b and (3,) a: the homogeneous pixel of a ray in the source is b + a / depth."""
    turn = source.R @ reference.R.T
    return rays @ (source.K @ turn).T, source.K @ (source.t - turn @ reference.t)


def _pixel(still: FloatArray, moving: FloatArray, inverse: FloatArray) -> Tuple[FloatArray, FloatArray]:
    """(..., 2) a source's pixel at 1 / depth, and its derivative."""
    homogeneous = still + inverse[..., None] * moving
    at = homogeneous[..., :2] / homogeneous[..., 2:]
    return at, (moving[:2] - at * moving[2]) / homogeneous[..., 2:]
