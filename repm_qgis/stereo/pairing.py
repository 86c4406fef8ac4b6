"""A pair of views over a tile, with cameras that are fitted to the altitudes of its ground."""

from __future__ import annotations

from typing import Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, Bounds, FloatArray
from ..geometry.equivalent_error import RefinedPinhole, fit_pinhole, refine_pinhole, virtual_grid
from ..geometry.frames import EnuFrame, geodetic_from_projected
from ..geometry.parameters import VIRTUAL_GRID
from ..geometry.rectification import RectifiedPair, rectify
from ..geometry.tiles import pixel_window
from ..imagery.parameters import SAMPLING
from ..scene import Scene, View
from .parameters import STEREO, StereoParameters


def rectified_pair(
    scene: Scene, first: View, second: View, bounds: Bounds, altitudes: Altitudes, parameters: StereoParameters = STEREO
) -> Optional[RectifiedPair]:
    """Fit, refine and rectify two views over a ground rectangle (in the scene's CRS); None unless both see it.

    Cameras are fitted again: relative pointing and a narrower altitude range make them better than those of the
    first fit.
    """
    found = (refined_view(scene, view, bounds, altitudes) for view in (first, second))
    refined = [view for view in found if view is not None]
    if len(refined) < 2:
        return None
    return rectify_over(scene, refined, bounds, altitudes, reductions(first, second)[0], parameters)


def reductions(first: View, second: View) -> Tuple[float, float]:
    """How many pixels of each view one pixel of their common frame is wide: the frame has the GSD of the coarser view.

    1 for views that are about equally fine.
    """
    coarser = max(first.gsd_m, second.gsd_m)
    found = coarser / first.gsd_m, coarser / second.gsd_m
    return found if max(found) > SAMPLING.alike else (1.0, 1.0)


def rectify_over(
    scene: Scene,
    pair: Sequence[RefinedPinhole],
    bounds: Bounds,
    altitudes: Altitudes,
    reduction: float,
    parameters: StereoParameters = STEREO,
) -> RectifiedPair:
    """Rectify two refined views so that the frame holds a ground rectangle at all altitudes of a range.

    One of its pixels is ``reduction`` px of the first view wide.
    """
    points, (first, second) = parameters.ground_points, pair
    plane, tile = (ground_points(scene, bounds, levels, points) for levels in ((sum(altitudes) / 2,), altitudes))
    local = scene.frame.from_geodetic
    return rectify(first, second, local(plane), local(tile), parameters.most_shear, reduction)


def refined_view(scene: Scene, view: View, bounds: Bounds, altitudes: Altitudes) -> Optional[RefinedPinhole]:
    """The refined camera of a view over a ground rectangle, by the scene's refinement model; None where unseen."""
    window = pixel_window(
        view.project, lambda xy: geodetic_from_projected(scene.crs, xy), bounds, altitudes=altitudes, size=view.size
    )
    if window is None:
        return None
    steady = view.steady
    grid = virtual_grid(steady.localise, window, altitudes, scene.frame, VIRTUAL_GRID.tile)
    model, camera = scene.refinement or "polynomial", fit_pinhole(grid).camera
    refined = refine_pinhole(model, camera, grid, window=window, order=scene.order, terrain=scene.terrain(steady))
    return refined.shaken(view.jitter)


def ground_points(
    scene: Scene, bounds: Bounds, altitudes: Tuple[float, ...], points: int = STEREO.ground_points
) -> FloatArray:
    """(N, 3) longitude, latitude, height: a grid over a ground rectangle at some altitudes."""
    x, y = np.linspace(bounds[0], bounds[2], points), np.linspace(bounds[1], bounds[3], points)
    lon_lat = geodetic_from_projected(scene.crs, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    return np.concatenate([np.column_stack([lon_lat, np.full(len(lon_lat), z)]) for z in altitudes])


def convergence(first: View, second: View, lon: float, lat: float, altitude: float) -> Tuple[float, float]:
    """Convergence angle in degrees and base-to-height ratio of two views at a ground point."""
    rays, frame = [], EnuFrame(lon, lat, altitude)
    for view in (first, second):
        pixel = view.project(np.array([lon, lat, altitude]))
        ends = frame.from_geodetic(view.localise(np.array([pixel, pixel]), np.array([altitude - 50, altitude + 50])))
        rays.append((ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]))
    angle = float(np.degrees(np.arccos(np.clip(rays[0] @ rays[1], -1, 1))))
    slopes = [ray[:2] / ray[2] for ray in rays]
    return angle, float(np.linalg.norm(slopes[0] - slopes[1]))
