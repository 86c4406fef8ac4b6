"""Whether control points belong to the images at all: where the vendors' RPCs put their pixels, and where they lie.

The adjustment finds and leaves out single wrong points. A table that is wrong as a whole (another place, CRS or order
of columns) has no correct majority to compare with, and would be fitted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np
import pyproj

from ..contracts.arrays import FloatArray
from ..contracts.errors import InputTableError
from ..contracts.findings import Finding
from ..geometry.height_causes import FOOT_M
from ..planning.promises import promise_of
from ..runtime.progress import counted, listed
from ..scene import View
from .control_noise import most_set_aside
from .ground_control import Gcp, residuals
from .parameters import POINTING, PointingParameters

_WGS84 = pyproj.Geod(ellps="WGS84")
_SWAPS: Tuple[Tuple[str, Callable[[Gcp], Gcp]], ...] = (
    ("lon and lat", lambda gcp: replace(gcp, lon=gcp.lat, lat=gcp.lon)),
    ("col and row", lambda gcp: replace(gcp, pixels={view: pixel[::-1] for view, pixel in gcp.pixels.items()})),
)

_READINGS: Tuple[Tuple[str, str, Callable[[Gcp], Gcp]], ...] = (
    ("col and row are exchanged", "exchange these columns in the table", _SWAPS[1][1]),
    (
        "heights are feet and not metres",
        "convert the heights to metres",
        lambda gcp: replace(gcp, height=FOOT_M * gcp.height),
    ),
    (
        "heights are metres and not feet",
        "give the heights as metres",
        lambda gcp: replace(gcp, height=gcp.height / FOOT_M),
    ),
)


@dataclass(frozen=True)
class PlacedPoint:
    """A point in the image where it is nearest to its pixel: metres on the ground between the two (infinite where the
    RPC gives none), the largest plausible distance, and whether it lies in the footprint of any image."""

    gcp: Gcp
    view: str
    distance_m: float
    limit_m: float
    inside: bool

    @property
    def is_far(self) -> bool:
        return self.distance_m > self.limit_m


def placed_points(
    gcps: Sequence[Gcp], views: Sequence[View], parameters: PointingParameters = POINTING
) -> List[PlacedPoint]:
    """Every point that is measured in an image; pointing corrections are not used."""
    return [_placed(gcp, seen, parameters) for gcp in gcps for seen in [_measuring(gcp, views)] if seen]


def misplaced(gcps: Sequence[Gcp], views: Sequence[View], path: str, parameters: PointingParameters = POINTING) -> str:
    """What is wrong with the table as a whole, in one sentence; "" where so few points are far from their pixels that
    the adjustment can name them and leave them out."""
    placed = placed_points(gcps, views, parameters)
    far = [point for point in placed if point.is_far]
    if len(far) <= most_set_aside(len(placed)):
        return ""
    worst = max(far, key=lambda point: point.distance_m)
    distances = sorted(point.distance_m for point in far)
    outside = sum(not point.inside for point in far)
    limit = max(point.limit_m for point in far)
    return (
        f"{len(far)} of {counted(len(placed), 'point')} of '{path}' lie too far from where the vendors' RPCs put their "
        f"pixels: {_length(distances[len(distances) // 2])} in the median, {_length(worst.distance_m)} at the worst "
        f"('{worst.gcp.id}' in {worst.view}), where at most {limit:.0f} m are plausible (the RPCs' promise plus "
        f"{parameters.places.margin_m:.0f} m), and {outside or 'none'} of them outside the images' footprints: "
        f"{_remedy(gcps, views, parameters)}."
    )


def misread(gcps: Sequence[Gcp], views: Sequence[View], path: str, parameters: PointingParameters = POINTING) -> str:
    """What the whole table says otherwise than it was read, in one sentence: what brings the residuals of its points
    together, which lie far apart as they are. "" where nothing does, or no view has enough points."""
    plain, plan = [view.with_pointing(np.eye(2, 3)) for view in views], parameters.places
    given = {name: px for name, px in _spreads(gcps, plain, parameters).items() if px > plan.misread_px}
    for cause, remedy, repaired in _READINGS if given else ():
        left = _spreads([repaired(gcp) for gcp in gcps], plain, parameters)
        better = [name for name in given if plan.misread_gain * left.get(name, math.inf) < given[name]]
        if better:
            found, px = (max(spreads[name] for name in better) for spreads in (given, left))
            text = f"The residuals of the points of '{path}' in {listed(better)} differ by {found:.1f} px (RMS)"
            return f"{text}, and by {px:.1f} px if {cause}: {remedy}."
    return ""


def _spreads(gcps: Sequence[Gcp], views: Sequence[View], parameters: PointingParameters) -> Dict[str, float]:
    """How far residuals lie from their median (RMS), px by the view's name."""
    seen: Dict[str, List[FloatArray]] = {}
    for gcp in gcps:
        for name, residual in residuals(gcp, views).items():
            seen.setdefault(name, []).append(residual)
    enough = {name: np.array(each) for name, each in seen.items() if len(each) >= parameters.places.misread_points}
    return {name: float(np.sqrt(2 * np.mean((each - np.median(each, axis=0)) ** 2))) for name, each in enough.items()}


def require_places(
    gcps: Sequence[Gcp],
    views: Sequence[View],
    path: str,
    parameters: PointingParameters = POINTING,
    warn: Optional[Callable[[Finding], None]] = None,
) -> None:
    """Raise InputTableError where points as a whole were read wrongly (:func:`misread`), or do not belong to the images
    (:func:`misplaced`): these are only named, by ``warn``, where some lie in an image's footprint."""
    text = misread(gcps, views, path, parameters)
    if not text:
        text = misplaced(gcps, views, path, parameters)
        if text and warn and any(point.inside for point in placed_points(gcps, views, parameters)):
            return warn(Finding("points-misplaced", text))
    if text:
        raise InputTableError(text)


def _remedy(gcps: Sequence[Gcp], views: Sequence[View], parameters: PointingParameters) -> str:
    for columns, swapped in _SWAPS:
        placed = placed_points([swapped(gcp) for gcp in gcps], views, parameters)
        if sum(point.is_far for point in placed) <= most_set_aside(len(placed)):
            return f"the columns {columns} are swapped, so exchange their names in the table"
    return (
        "choose the points of this place, and check that lon and lat are degrees in WGS 84 and not in another CRS, "
        "that the columns col and row are not swapped, and the datum of the heights (GCP_DATUM)"
    )


def _measuring(gcp: Gcp, views: Sequence[View]) -> List[View]:
    return [view for view in views if view.name in gcp.pixels]


def _placed(gcp: Gcp, views: Sequence[View], parameters: PointingParameters) -> PlacedPoint:
    found: Dict[str, Tuple[float, float]] = {}
    inside = False
    for view in views:
        limit = promise_of(view, parameters.planning.promises).horizontal_m + parameters.places.margin_m
        found[view.name] = (_distance(gcp, view), limit)
        reach = limit / view.gsd_m
        pixel = view.model.project(gcp.lon_lat_h)
        inside = inside or bool(((pixel > -reach) & (pixel < np.array(view.size) + reach)).all())
    name = min(found, key=lambda view: found[view][0] - found[view][1])
    distance, limit = found[name]
    return PlacedPoint(gcp, name, distance_m=distance, limit_m=limit, inside=inside)


def _distance(gcp: Gcp, view: View) -> float:
    """Metres on the ground from a point to where a view's RPC puts its pixel, at the point's height."""
    lon, lat, _ = view.model.localise(gcp.pixels[view.name], gcp.height)
    distance = float(_WGS84.inv(gcp.lon, gcp.lat, lon, lat)[2])
    return distance if math.isfinite(distance) else math.inf


def _length(metres: float) -> str:
    """A distance in words."""
    if not math.isfinite(metres):
        return "farther than the RPC reaches"
    return f"{metres / 1000:.1f} km" if metres >= 1000 else f"{metres:.0f} m"
