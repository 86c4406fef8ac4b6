"""Where the images really look: ties, sharpened, adjusted, with ground control if there is any."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from ..arrays import FloatArray
from ..errors import EmptyResultError
from ..geometry.frames import projected_from_geodetic
from ..imagery.enhancement import Stretch
from ..progress import Part, Progress
from ..records import GcpFigures, PairFigures, PointingFigures, ViewPair
from ..scene import Scene, View
from .adjustment import Adjustment, Track, adjust, tracks_from
from .colmap_adjustment import adjust_colmap
from .ground_control import Gcp, intersect
from .keypoints import with_best_detector
from .row_residuals import row_residuals
from .tie_alignment import align_ties
from .tie_points import PairMatches, find_ties

LEAST_TIES = 20
_USUAL_PX = 2.0  # by which two vendor RPCs of one pass disagree, in each direction


@dataclass(frozen=True)
class Pointing:
    """The scene's views as they really look, the adjustment, its tracks with their (N, 2) places in the scene's CRS.

    ``figures`` is what reports say of them.
    """

    views: List[View]
    tracks: List[Track]
    adjusted: Adjustment
    xy: FloatArray
    figures: PointingFigures


def point_views(
    scene: Scene,
    pairs: Sequence[ViewPair],
    stretches: Dict[str, Stretch],
    model: str,
    gcps: Sequence[Gcp],
    progress: Progress,
    workers: int = 0,
    route: str = "rpc",
) -> Pointing:
    """Find ties and adjust the views' pointing; the scene stays as it is.

    ``workers`` 0 means one a core. ``route`` is ``rpc`` (ours) or ``colmap`` (principal points only: ``model`` and
    ``gcps`` are not used).

    Raises EmptyResultError with the counts where the ties are too few.
    """
    names = [(pair.first, pair.second) for pair in pairs]
    matches, detector = with_best_detector(
        lambda best: find_ties(scene, names, stretches, Part(progress, 0.0, 0.7), workers, best), progress
    )
    tracks = align_ties(scene, tracks_from(matches), stretches, Part(progress, 0.7, 0.95), workers)
    if len(tracks) < LEAST_TIES:
        raise EmptyResultError(
            f"Only {len(tracks)} tie points hold at full resolution (needed: {LEAST_TIES}): are the "
            "images in focus, of one season, and free of clouds?"
        )
    if route == "colmap":
        adjusted = adjust_colmap(scene, tracks, Part(progress, 0.95, 1.0))
    else:
        adjusted = adjust(scene.views, tracks, sum(scene.altitudes) / 2, model, gcps)
    views = [view.with_pointing(adjusted.pointing[view.name]) for view in scene.views]
    before, after = (
        {(pair.first, pair.second): _rows(seen, pair, tracks, adjusted.ground) for pair in pairs}
        for seen in (scene.views, views)
    )
    controlled = any(gcp.role == "control" and gcp.pixels for gcp in gcps)
    figures = PointingFigures(
        count=len(tracks),
        detector=detector.name,
        before_px=float(np.median(adjusted.before_px)),
        after_px=float(np.median(adjusted.residual_px)),
        model=adjusted.model,
        reason=adjusted.reason,
        shifts_px={name: (float(shift[0]), float(shift[1])) for name, shift in adjusted.shifts.items()},
        pairs=tuple(_pair_figures(match, before, after) for match in matches),
        gcps=_gcp_figures(gcps, views, adjusted),
        rejected_gcps=tuple(adjusted.rejected) if gcps else (),
        control_noise_px=adjusted.control_noise_px if controlled else None,
        height_uncertainty_m=None if controlled else _height_uncertainty(scene, pairs, before),
    )
    _log(figures, progress)
    return Pointing(views, tracks, adjusted, projected_from_geodetic(scene.crs, adjusted.ground), figures)


def _rows(views: Sequence[View], pair: ViewPair, tracks: Sequence[Track], ground: FloatArray) -> FloatArray:
    """(N,) vertical parallax of a pair's tracks with the views' present pointing, px."""
    shared = [k for k, t in enumerate(tracks) if pair.first in t.pixels and pair.second in t.pixels]
    if not shared:
        return np.zeros(0)
    names = (pair.first, pair.second)
    pixels = tuple(np.array([tracks[k].pixels[name] for k in shared]) for name in names)
    first, second = (next(view for view in views if view.name == name) for name in names)
    return row_residuals((first, second), pixels, ground[shared])[0]


def _pair_figures(match: PairMatches, before: Dict[Any, FloatArray], after: Dict[Any, FloatArray]) -> PairFigures:
    key = (match.first, match.second)
    return PairFigures(
        pair=key,
        candidates=len(match.first_px),
        count=len(after[key]),
        before_px=_median(before[key]),
        after_px=_median(np.abs(after[key])),
        spread_px=1.4826 * _median(np.abs(after[key] - _median(after[key]))),
    )


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _gcp_figures(gcps: Sequence[Gcp], views: Sequence[View], adjusted: Adjustment) -> Tuple[GcpFigures, ...]:
    """Where the corrected views put the control points that they see."""
    offsets = [(gcp, intersect(gcp, views)) for gcp in gcps]
    return tuple(
        GcpFigures(gcp.id, gcp.role, gcp.id in adjusted.rejected, *map(float, offset))
        for gcp, offset in offsets
        if offset is not None
    )


def _height_uncertainty(scene: Scene, pairs: Sequence[ViewPair], before: Dict[Any, FloatArray]) -> float:
    """Two standard deviations of the absolute height, m.

    Across the parallax the vendors' disagreement is seen; along it, where it passes for height, it is likely as large.
    One or three pairs are few to tell a deviation from, so what is usual counts as one pair more. The pair with the
    widest base tells the height best.
    """
    seen = [_median(rows) for rows in before.values() if len(rows)]
    deviation = np.sqrt((_USUAL_PX**2 + sum(row**2 for row in seen)) / (1 + len(seen)))
    return float(2.0 * deviation * scene.gsd_m / max(pair.base_to_height for pair in pairs))


def _log(figures: PointingFigures, progress: Progress) -> None:
    shifts = ", ".join(f"{name} ({c:+.2f}, {r:+.2f})" for name, (c, r) in figures.shifts_px.items())
    progress.info(
        f"{figures.count} tie points; pointing corrected by {shifts} px ({figures.model}: {figures.reason}); their "
        f"median residual fell from {figures.before_px:.2f} to {figures.after_px:.2f} px."
    )
    if figures.control_noise_px is not None:
        progress.info(
            f"The control points fit to {figures.control_noise_px:.2f} px in each direction: that gives "
            "them their weight beside the tie points."
        )
    for identity in figures.rejected_gcps:
        progress.warn(
            f"The control point {identity} contradicts all others and was left out: check its coordinates, "
            "its height's datum, and its pixels."
        )
    if figures.height_uncertainty_m is not None:
        progress.info(
            "Without ground control points the absolute height is as good as the vendors' RPCs: uncertain by "
            f"{figures.height_uncertainty_m:.1f} m (two standard deviations); relative heights are not "
            "affected."
        )
