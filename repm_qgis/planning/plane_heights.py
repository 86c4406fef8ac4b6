"""The heights of the planes that ortho-ready images were projected to, where their metadata do not state them.

If the heights of all images are wrong by the same amount, each line of sight passes its place on the map too high or
too low by this amount, and so does every point where two of them meet: all heights of the surface are wrong by this
amount, and nothing else is. No measure in the images can show it: heights of the ground are needed, from a DEM. Where
the heights of two images are wrong by different amounts, their lines of sight miss each other by the difference times
the part of their inclination that they share; the pointing removes this vertical parallax, as it does any shift.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, Bounds
from ..contracts.findings import Finding
from ..geometry.frames import geodetic_from_projected
from ..imagery.dem import dem_range, surface_of
from ..imagery.ortho_ready import OPTION
from ..runtime.progress import Progress, listed
from ..scene import View
from .altitude_range import sweep_altitudes
from .parameters import PLANNING, PlaneParameters, SweepParameters

_REMEDY = f"Give {OPTION}, or REFERENCE, to which the DSM is then registered."


def with_planes(
    views: Sequence[View],
    crs: str,
    bounds: Bounds,
    *,
    search: Altitudes,
    dem: Optional[str],
    progress: Progress,
    sweep: SweepParameters = PLANNING.sweep,
    parameters: PlaneParameters = PLANNING.planes,
) -> Tuple[Tuple[View, ...], Altitudes]:
    """The views with the heights of their planes, and the heights to search the ground in.

    Says where each height comes from, and warns where it is only assumed. ``bounds`` are those of the area in ``crs``,
    ``search`` the RPCs' heights, m above the ellipsoid. Raises what reading the DEM raises.
    """
    views = tuple(views)
    for view in views:
        if view.plane is not None and view.plane.source:
            at = f"projected to {view.plane.height:.2f} m above the ellipsoid ({view.plane.source})"
            progress.info(f"{view.name} is an ortho-ready image, {at}.")
    assumed = [view for view in views if view.plane is not None and not view.plane.source]
    if not assumed:
        return views, search
    names = listed([view.name for view in assumed])
    known = [view.plane.height for view in views if view.plane is not None and view.plane.source]
    height = float(np.mean(known or [view.plane.height for view in assumed if view.plane is not None]))
    views = tuple(_at_plane(view, height, "") if view in assumed else view for view in views)
    if known:
        progress.warn(
            Finding(
                "plane-height-of-others",
                f"Nothing states to which height {names} were projected: {height:.0f} m above the ellipsoid is used, "
                f"the mean of the other images' heights. {_REMEDY}",
            )
        )
        return tuple(
            _at_plane(view, height, "the other images") if _is_assumed(view) else view for view in views
        ), search
    wide = search[0] - parameters.reach_m, search[1] + parameters.reach_m
    if dem:
        found = _from_dem(
            views, crs, bounds, search=wide, dem=dem, progress=progress, sweep=sweep, parameters=parameters
        )
        if found is not None:
            height += found[0]
            progress.info(
                f"Nothing states to which height {names} were projected: {height:.1f} m above the ellipsoid was "
                f"found, the height at which the ground of the images agrees with the DEM (median of {found[1]} "
                "places)."
            )
            return tuple(_at_plane(view, height, "DEM") if _is_assumed(view) else view for view in views), search
    progress.warn(
        Finding(
            "plane-height-assumed",
            f"Nothing states to which height {names} were projected: {height:.0f} m above the ellipsoid is assumed, "
            "the middle of the RPC's heights. An error of this height is an error of all heights of the DSM. "
            f"{_REMEDY}",
        )
    )
    return views, wide


def _is_assumed(view: View) -> bool:
    return view.plane is not None and not view.plane.source


def _at_plane(view: View, height: float, source: str) -> View:
    plane = view.plane
    return view if plane is None else replace(view, plane=replace(plane, height=height, source=source))


def _from_dem(
    views: Tuple[View, ...],
    crs: str,
    bounds: Bounds,
    *,
    search: Altitudes,
    dem: str,
    progress: Progress,
    sweep: SweepParameters,
    parameters: PlaneParameters,
) -> Optional[Tuple[float, int]]:
    """What must be added to the planes' height so that the images' heights are the DEM's, m, and from how many places;
    None where the images show too little."""
    low, high, _ = dem_range(dem, crs, bounds)
    around = bounds.grown(sweep.reduction * max(view.gsd_m for view in views))
    corners = np.array([[x, y] for x in (around.xmin, around.xmax) for y in (around.ymin, around.ymax)])
    lon_lat = geodetic_from_projected(crs, corners)
    surface = surface_of(
        dem, Bounds.between(lon_lat.min(axis=0), lon_lat.max(axis=0)), sweep.reduction * views[0].gsd_m
    )
    added, count = 0.0, 0
    fine = replace(sweep, reduction=parameters.fine_reduction)
    near = low - parameters.fine_reach_m, high + parameters.fine_reach_m
    for heights, how in ((search, sweep), (near, fine)):
        moved = [_at_plane(view, view.plane.height + added, "") if view.plane is not None else view for view in views]
        swept = sweep_altitudes(moved, crs, bounds, search=heights, progress=progress, parameters=how)
        if swept is None:
            return None
        lon, lat, altitude = swept.points.T
        added, count = added + float(np.median(surface.height(lon, lat) - altitude)), len(altitude)
    return added, count
