"""Normals of matched points: the planes of their neighbours in the same height map, turned to the satellite.

A pair sees a roof and the ground before it as two surfaces, and the wall between them is a third one: neighbours are
looked for on the same of these, and points on a wall have a horizontal normal.
"""

from __future__ import annotations

from typing import Tuple

import numpy as np
from scipy.spatial import cKDTree

from ..contracts.arrays import FloatArray, Mask
from ..geometry.neighbours import principal_axes
from .parameters import SOLIDS, CloudParameters


def normals(
    xyz: FloatArray, wall: Mask, ray: Tuple[float, float], parameters: CloudParameters = SOLIDS.cloud
) -> FloatArray:
    """(N, 3) unit normals east, north, up of the points ``xyz`` (N, 3) of one height map, in metres.

    ``wall`` (N,) are those on walls. ``ray`` is how far the line of sight moves east and north, m for each m of height.
    Points with too few neighbours have the line of sight itself.
    """
    found = np.empty(xyz.shape)
    sight = np.array([*ray, 1.0])
    for on_wall in (False, True):
        part = np.flatnonzero(wall == on_wall)
        dimensions = 2 if on_wall else 3
        view = sight * (1.0, 1.0, 0.0) if on_wall and any(ray) else sight
        normal = np.broadcast_to(view / np.linalg.norm(view), (len(part), 3)).copy()
        if len(part) >= parameters.normal_neighbours:
            tree = cKDTree(xyz[part] - xyz.mean(axis=0))
            normal[:, dimensions:] = 0.0
            for here, _, _, axes in principal_axes(
                tree, parameters.normal_neighbours, parameters.normals_at_once, dimensions
            ):
                normal[here, :dimensions] = axes[:, :, 0]
            normal[normal @ view < 0] *= -1.0
        found[part] = normal
    return found
