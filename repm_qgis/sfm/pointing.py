"""Where the images really look: ties, sharpened, adjusted, with ground control if there is any."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Dict, List, Sequence

import numpy as np

from ..arrays import FloatArray
from ..errors import EmptyResultError
from ..geometry.frames import projected_from_geodetic
from ..imagery.enhancement import Stretch
from ..progress import Part, Progress
from ..records import ViewPair
from ..scene import Scene, View
from .adjustment import Adjustment, Track, adjust, tracks_from
from .colmap_adjustment import adjust_colmap
from .ground_control import Gcp, intersect
from .keypoints import with_best_detector
from .row_residuals import row_residuals
from .sharpening import sharpen
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
    figures: Dict[str, Any]


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
    tracks = sharpen(scene, tracks_from(matches), stretches, Part(progress, 0.7, 0.95), workers)
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
    figures = {
        "count": len(tracks),
        "detector": detector.name,
        "before_px": float(np.median(adjusted.before_px)),
        "after_px": float(np.median(adjusted.residual_px)),
        "model": adjusted.model,
        "reason": adjusted.reason,
        "shifts_px": {name: shift.tolist() for name, shift in adjusted.shifts.items()},
        "pairs": [_pair_figures(match, before, after) for match in matches],
        **_absolute(replace(scene, views=views), pairs, before, gcps, adjusted),
    }
    _tell(figures, progress)
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


def _pair_figures(match: PairMatches, before: Dict[Any, FloatArray], after: Dict[Any, FloatArray]) -> Dict[str, Any]:
    key = (match.first, match.second)
    return {
        "pair": list(key),
        "candidates": len(match.rows_px),
        "count": len(after[key]),
        "rows_before_px": _median(before[key]),
        "rows_after_px": _median(np.abs(after[key])),
        "rows_spread_px": 1.4826 * _median(np.abs(after[key] - _median(after[key]))),
    }


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _absolute(
    scene: Scene, pairs: Sequence[ViewPair], before: Dict[Any, FloatArray], gcps: Sequence[Gcp], adjusted: Adjustment
) -> Dict[str, Any]:
    """How far the absolute height can be trusted: by ground control, or by how much the vendors' RPCs disagree."""
    points = []
    for gcp in gcps:
        offset = intersect(gcp, scene.views)
        if offset is not None:
            points.append(
                {
                    "id": gcp.id,
                    "role": gcp.role,
                    "rejected": gcp.id in adjusted.rejected,
                    "east_m": float(offset[0]),
                    "north_m": float(offset[1]),
                    "up_m": float(offset[2]),
                }
            )
    figures: Dict[str, Any] = {"gcps": points, "rejected_gcps": list(adjusted.rejected)} if gcps else {}
    if any(gcp.role == "control" and gcp.pixels for gcp in gcps):
        return {**figures, "control_noise_px": adjusted.control_noise_px}
    return {**figures, "height_uncertainty_m": _height_uncertainty(scene, pairs, before)}


def _height_uncertainty(scene: Scene, pairs: Sequence[ViewPair], before: Dict[Any, FloatArray]) -> float:
    """Two standard deviations of the absolute height, m.

    Across the parallax the vendors' disagreement is seen; along it, where it passes for height, it is likely as large.
    One or three pairs are few to tell a deviation from, so what is usual counts as one pair more. The pair with the
    widest base tells the height best.
    """
    seen = [_median(rows) for rows in before.values() if len(rows)]
    deviation = np.sqrt((_USUAL_PX**2 + sum(row**2 for row in seen)) / (1 + len(seen)))
    return float(2.0 * deviation * scene.gsd_m / max(pair.base_to_height for pair in pairs))


def _tell(figures: Dict[str, Any], progress: Progress) -> None:
    shifts = ", ".join(f"{name} ({c:+.2f}, {r:+.2f})" for name, (c, r) in figures["shifts_px"].items())
    progress.info(
        f"{figures['count']} tie points; pointing corrected by {shifts} px ({figures['model']}: "
        f"{figures['reason']}); their median residual fell from {figures['before_px']:.2f} to "
        f"{figures['after_px']:.2f} px."
    )
    if figures.get("control_noise_px") is not None:
        progress.info(
            f"The control points fit to {figures['control_noise_px']:.2f} px in each direction: that gives "
            "them their weight beside the tie points."
        )
    for identity in figures.get("rejected_gcps", []):
        progress.warn(
            f"The control point {identity} contradicts all others and was left out: check its coordinates, "
            "its height's datum, and its pixels."
        )
    if "height_uncertainty_m" in figures:
        progress.info(
            "Without ground control points the absolute height is as good as the vendors' RPCs: uncertain by "
            f"{figures['height_uncertainty_m']:.1f} m (two standard deviations); relative heights are not "
            "affected."
        )
