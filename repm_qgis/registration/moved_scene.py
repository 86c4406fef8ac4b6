"""A shift of the ground put into the images' pointing, so that every product of the scene follows."""

from __future__ import annotations

from dataclasses import replace
from typing import Tuple

import numpy as np

from ..contracts.arrays import Altitudes, Bounds, FloatArray
from ..contracts.records import GroundShift
from ..geometry.frames import geodetic_from_projected
from ..geometry.ground_shifts import moved_area
from ..geometry.tiles import enclosing
from ..scene import Scene, Tile, View

_NODES = (7, 7, 3)  # east, north, up


def moved_scene(scene: Scene, shift: GroundShift) -> Tuple[Scene, float]:
    """The scene with its ground moved by a shift in its CRS: views, tiles, area, altitudes and control points' offsets.

    Its height maps stay, and keep the bounds that they were matched with. The second result is that of
    :func:`moved_view`, for the worst view.
    """
    ground = enclosing([tile.bounds for tile in scene.tiles])
    low = min(tile.altitudes[0] for tile in scene.tiles)
    high = max(tile.altitudes[1] for tile in scene.tiles)
    moved = [moved_view(view, scene.crs, ground, (low, high), shift) for view in scene.views]

    def raised(altitudes: Altitudes, bounds: Bounds) -> Altitudes:
        middle = 0.5 * (bounds[0] + bounds[2]), 0.5 * (bounds[1] + bounds[3])
        up = shift.up_at(middle)
        return altitudes[0] + up, altitudes[1] + up

    def placed(tile: Tile) -> Tile:
        heights = tuple(replace(record, ground=record.ground or tile.bounds) for record in tile.heights)
        return replace(
            tile,
            bounds=shift.of_bounds(tile.bounds),
            altitudes=raised(tile.altitudes, tile.bounds),
            heights=heights,
        )

    pointing = scene.pointing
    if pointing is not None:
        east, north, up = shift.moved
        points = (replace(p, east_m=p.east_m + east, north_m=p.north_m + north) for p in pointing.gcps)
        pointing = replace(pointing, gcps=tuple(replace(p, up_m=p.up_m + up) for p in points))
    changed = replace(
        scene,
        views=tuple(view for view, _ in moved),
        area=moved_area(scene.area, shift),
        altitudes=raised(scene.altitudes, ground),
        pointing=pointing,
    )
    return changed.with_tiles(placed), max(error for _, error in moved)


def moved_view(view: View, crs: str, bounds: Bounds, altitudes: Altitudes, shift: GroundShift) -> Tuple[View, float]:
    """The view with a pointing that sees every point of the ground where the shift has moved it.

    ``crs`` is the projected CRS of the shift and of ``bounds``, the ground that matters; ``altitudes`` are metres above
    the ellipsoid. The pointing is an affine map, so a shift is not exactly one: the second result is the largest error
    that is left in the image, px.
    """
    ends = (bounds.xmin, bounds.xmax), (bounds.ymin, bounds.ymax), altitudes
    lattice = np.meshgrid(*(np.linspace(*pair, count) for pair, count in zip(ends, _NODES)))
    ground = np.column_stack([axis.ravel() for axis in lattice])
    seen = view.steady.project(_geodetic(crs, ground))
    raw = view.model.project(_geodetic(crs, shift.applied(ground)))
    middle = raw.mean(axis=0)  # small numbers, or the solution loses digits
    design = np.column_stack([raw - middle, np.ones(len(raw))])
    solution = np.linalg.lstsq(design, seen, rcond=None)[0].T
    error = float(np.abs(design @ solution.T - seen).max())
    pointing = np.column_stack([solution[:, :2], solution[:, 2] - solution[:, :2] @ middle])
    return view.with_pointing(pointing, view.jitter), error


def _geodetic(crs: str, xyz: FloatArray) -> FloatArray:
    return np.column_stack([geodetic_from_projected(crs, xyz[:, :2]), xyz[:, 2]])
