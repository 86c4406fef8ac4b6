"""Pointing of all views: tie points, their subpixel alignment, and the adjustment with or without ground control."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Dict, FrozenSet, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, Bounds, FloatArray
from ..contracts.errors import EmptyResultError, RpcInvalidError
from ..contracts.findings import Finding
from ..contracts.records import GcpFigures, PairFigures, PointingFigures, ViewPair
from ..geometry.footprints import ray_slope
from ..geometry.frames import projected_from_geodetic
from ..imagery.enhancement import Stretch
from ..numerics.robust import nmad
from ..planning.advice import absolute_height, ties_by_part, ties_by_tile
from ..planning.altitudes import ALTITUDES, AltitudeParameters
from ..planning.height_uncertainty import height_uncertainty
from ..runtime.progress import Part, Progress
from ..scene import Scene, View
from ..ties.parameters import TiesParameters
from ..ties.tie_alignment import align_ties
from ..ties.tie_points import PairMatches, find_ties
from ..ties.tracks import Track, tracks_from
from .adjustment import Adjustment, adjust
from .colmap_adjustment import adjust_colmap
from .control_information import control_information
from .exchanged import require_own_rpcs
from .ground_control import Gcp, intersect
from .jitter import can_jitter
from .parameters import POINTING, PointingParameters
from .vertical_parallax import tracks_of_pair


@dataclass(frozen=True)
class Pointing:
    """The views with their pointing, the adjustment, and its tracks with their (N, 2) places in the scene's CRS."""

    views: List[View]
    tracks: List[Track]
    adjusted: Adjustment
    xy: FloatArray
    figures: PointingFigures

    def altitudes(self, bounds: Bounds, parameters: PointingParameters = POINTING) -> Optional[Altitudes]:
        """Between which heights the good ties in and around a rectangle lie; None where they are too few."""
        xmin, ymin, xmax, ymax = bounds
        reach = parameters.around * max(xmax - xmin, ymax - ymin)
        low, high = np.array([xmin, ymin]) - reach, np.array([xmax, ymax]) + reach
        near = ((self.xy > low) & (self.xy < high)).all(axis=1) & (self.adjusted.residual_px < parameters.good_px)
        heights = self.adjusted.ground[near, 2]
        if len(heights) < parameters.least_tracks:
            return None
        least, greatest = np.percentile(heights, (parameters.tail_percent, 100.0 - parameters.tail_percent))
        return float(least), float(greatest)


def point_views(
    scene: Scene,
    pairs: Sequence[ViewPair],
    stretches: Dict[str, Stretch],
    *,
    model: str,
    gcps: Sequence[Gcp],
    progress: Progress,
    workers: int = 0,
    route: str = "rpc",
    parameters: PointingParameters = POINTING,
    altitudes: AltitudeParameters = ALTITUDES,
) -> Pointing:
    """Find ties and adjust the views' pointing; the scene itself is not changed.

    ``workers`` 0 means one for each core. ``route`` is ``rpc`` (ours) or ``colmap`` (principal points only: ``model``
    and ``gcps`` are not used).

    Raises EmptyResultError with the counts where the ties are too few.
    """
    names = [pair.names for pair in pairs]
    search = partial(_aligned_ties, names=names, stretches=stretches, workers=workers)
    altitude = sum(scene.altitudes) / 2
    matches, tracks = search(scene, progress=Part(progress, 0.0, 0.95), parameters=parameters.ties)
    tracks = with_base(scene.views, tracks, altitude, parameters.track_base)
    if len(tracks) < parameters.least_tracks:
        raise EmptyResultError(
            f"Tie points that could be aligned at full resolution: {len(tracks)} (needed: {parameters.least_tracks}). "
            "Are the images in focus, of one season, and free of clouds?"
        )
    if route == "colmap":
        adjusted = adjust_colmap(scene, tracks, Part(progress, 0.95, 1.0), parameters, altitudes)
    else:
        adjusted = adjust(scene.views, tracks, altitude, model, gcps, parameters)
    if adjusted.jitter or (model == "jitter" and can_jitter(scene.views)):
        # Waves need many ties, of all lines, which are found where the first adjustment expects them.
        more, pointed = parameters.with_many_ties(), replace(scene, views=tuple(adjusted.applied(scene.views)))
        matches, tracks = search(pointed, progress=Part(progress, 0.95, 1.0), parameters=more.ties)
        tracks = with_base(scene.views, tracks, altitude, more.track_base)
        adjusted = adjust(scene.views, tracks, altitude, model, gcps, parameters)
    controlled = any(gcp.role == "control" and gcp.pixels for gcp in gcps)
    require_own_rpcs(scene.views, tracks, altitude, progress.warn, parameters, info=progress.info)
    if not controlled:
        _require_small_trends(adjusted, parameters)
    views = adjusted.applied(scene.views)
    before, after = (_parallax(seen, names, tracks, adjusted.ground) for seen in (scene.views, views))
    xy = projected_from_geodetic(scene.crs, adjusted.ground)
    figures = PointingFigures(
        count=len(tracks),
        before_px=float(np.median(adjusted.before_px)),
        after_px=float(np.median(adjusted.residual_px)),
        model=adjusted.model,
        reason=adjusted.reason,
        shifts_px={name: (float(shift[0]), float(shift[1])) for name, shift in adjusted.shifts.items()},
        pairs=tuple(_pair_figures(match, before, after) for match in matches),
        gcps=_gcp_figures(gcps, views, adjusted),
        rejected_gcps=tuple(adjusted.rejected) if gcps else (),
        control_noise_px=adjusted.control_noise_px if controlled else None,
        control_information=_control_information(gcps, views, adjusted) if controlled else None,
        ties_by_tile=ties_by_tile(scene, xy, parameters.planning.advice),
        ties_by_part=ties_by_part(scene, xy, parameters.planning.advice),
        trends_px=adjusted.trends_px,
    )
    if not controlled:
        figures = replace(figures, ground_m=None if scene.dem else ground_heights(adjusted, parameters))
        uncertain_m = 2.0 * height_uncertainty(views, figures, parameters.planning).deviation_m
        figures = replace(figures, height_uncertainty_m=uncertain_m)
    _log(scene.views, figures, parameters, progress)
    return Pointing(views, tracks, adjusted, xy, figures)


def _aligned_ties(
    scene: Scene,
    *,
    names: Sequence[Tuple[str, str]],
    stretches: Dict[str, Stretch],
    progress: Progress,
    workers: int,
    parameters: TiesParameters,
) -> Tuple[List[PairMatches], List[Track]]:
    """The matches of pairs, and the tracks that they join to, aligned at full resolution."""
    searching, aligning = Part(progress, 0.0, 0.74), Part(progress, 0.74, 1.0)
    matches = find_ties(scene, names, stretches, progress=searching, workers=workers, parameters=parameters)
    tracks = align_ties(
        scene,
        tracks_from(matches),
        names,
        stretches=stretches,
        progress=aligning,
        workers=workers,
        parameters=parameters.alignment,
    )
    return matches, tracks


def with_base(views: Sequence[View], tracks: Sequence[Track], altitude: float, least: float) -> List[Track]:
    """The tracks that two views see with at least so much base-to-height ratio: neighbouring frames of one pass see
    nothing of the height, and their ground point would lie anywhere along their common line of sight."""
    slopes = {}
    for view in views:
        lon, lat, _ = view.localise((np.array(view.size) - 1) / 2, altitude)
        slopes[view.name] = ray_slope(view, np.array([lon, lat]), altitude)
    known: Dict[FrozenSet[str], bool] = {}
    for seen in {frozenset(track.pixels) for track in tracks}:
        every = np.array([slopes[name] for name in seen])
        known[seen] = bool(np.hypot(*(every[:, None] - every).T).max() >= least)
    return [track for track in tracks if known[frozenset(track.pixels)]]


def _require_small_trends(adjusted: Adjustment, parameters: PointingParameters) -> None:
    """Refuse RPCs that agree only after corrections that change by many px over an image: the heights would follow
    these."""
    name, trend = max(adjusted.trends_px.items(), key=lambda each: each[1])
    if trend > parameters.most_trend_px:
        raise RpcInvalidError(
            f"The RPC of {name} needs a correction that changes by {trend:.1f} px from the middle of the image to a "
            f"corner (at most {parameters.most_trend_px:g} px; sound RPCs need less than "
            f"{parameters.planning.advice.trend_px:g} px): it is another image's, or damaged; give each image its own "
            "RPC, or ground control points (GCPS)."
        )


def ground_heights(
    adjusted: Adjustment, parameters: PointingParameters = POINTING
) -> Optional[Tuple[float, float, float]]:
    """Between which heights nearly all good ties lie, and the one in their middle, m; None where they are too few."""
    heights = adjusted.ground[adjusted.residual_px < parameters.good_px, 2]
    if len(heights) < parameters.least_tracks:
        return None
    tail = parameters.planning.rpc_heights.tail_percent
    low, middle, high = np.percentile(heights, (tail, 50.0, 100.0 - tail))
    return float(low), float(middle), float(high)


def _parallax(
    views: Sequence[View], pairs: Sequence[Tuple[str, str]], tracks: Sequence[Track], ground: FloatArray
) -> Dict[Tuple[str, str], FloatArray]:
    """(N,) vertical parallax of each pair's tracks, px."""
    of = {view.name: view for view in views}
    return {(a, b): tracks_of_pair((of[a], of[b]), tracks, ground)[1] for a, b in pairs}


def _pair_figures(
    match: PairMatches, before: Dict[Tuple[str, str], FloatArray], after: Dict[Tuple[str, str], FloatArray]
) -> PairFigures:
    key = (match.first, match.second)
    return PairFigures(
        pair=key,
        candidates=len(match.first_px),
        count=len(after[key]),
        before_px=_median(before[key]),
        after_px=_median(np.abs(after[key])),
        spread_px=nmad(after[key]) if len(after[key]) else 0.0,
    )


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _gcp_figures(gcps: Sequence[Gcp], views: Sequence[View], adjusted: Adjustment) -> Tuple[GcpFigures, ...]:
    """Where the corrected views put the control points that they see."""
    offsets = ((gcp, intersect(gcp, views)) for gcp in gcps)
    seen = [(gcp.id, gcp.role, offset) for gcp, offset in offsets if offset is not None]
    return tuple(
        GcpFigures(name, role, name in adjusted.rejected, east_m=float(east), north_m=float(north), up_m=float(up))
        for name, role, (east, north, up) in seen
    )


def _control_information(gcps: Sequence[Gcp], views: Sequence[View], adjusted: Adjustment) -> Optional[FloatArray]:
    noise = adjusted.control_noise_px
    return None if noise is None else control_information(gcps, adjusted.rejected, views, noise)


def _log(views: Sequence[View], figures: PointingFigures, parameters: PointingParameters, progress: Progress) -> None:
    shifts = ", ".join(f"{name} ({c:+.2f}, {r:+.2f})" for name, (c, r) in figures.shifts_px.items())
    progress.info(
        f"{figures.count} tie points; pointing corrected by {shifts} px ({figures.model}: {figures.reason}); their "
        f"median residual fell from {figures.before_px:.2f} to {figures.after_px:.2f} px."
    )
    if figures.control_noise_px is not None:
        progress.info(
            f"The residuals of the control points are {figures.control_noise_px:.2f} px in each direction, which sets "
            "their weight against the tie points."
        )
    for identity in figures.rejected_gcps:
        progress.warn(
            Finding(
                "gcp-contradicts",
                f"The control point {identity} contradicts all others and was left out: check its coordinates, its "
                "vertical datum, and its pixels.",
            )
        )
    for text in absolute_height(views, figures, parameters.planning):
        progress.info(text)
