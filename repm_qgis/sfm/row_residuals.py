"""What no height explains: how far two views' pixels of one ground point miss each other across the parallax.

In a rectified pair that is the difference of rows, hence the name; here it comes from the sensor models themselves, so
that no camera fitted over a whole scene blurs it.
"""

from __future__ import annotations

from itertools import combinations
from typing import Dict, List, Sequence, Tuple

import numpy as np

from ..arrays import FloatArray
from ..geometry.frames import EnuFrame
from ..scene import View
from .adjustment import Track


def row_residuals(
    views: Tuple[View, View], pixels: Tuple[FloatArray, FloatArray], ground: FloatArray
) -> Tuple[FloatArray, FloatArray]:
    """(N,) the first view's row less the second's, px, and (N,) where that row grows to on the ground.

    Parameters
    ----------
    views : their pointing is included.
    pixels : (N, 2) in each view.
    ground : (N, 3) longitude, latitude, height; near the points, some ten metres do no harm.

    Returns
    -------
    px; and azimuths, degrees clockwise from north.

    Notes
    -----
    Four residuals, and three coordinates of the ground point that may take them up: what is left is their component
    along the one direction that no move of the point reaches. Scaled so that one px in one image counts as one.
    """
    frame = EnuFrame(*map(float, ground.mean(axis=0)))
    enu = frame.from_geodetic(ground)
    base = [view.project(ground) for view in views]
    moved = [frame.to_geodetic(enu + delta) for delta in np.eye(3)]
    jacobian = np.concatenate(
        [np.stack([view.project(place) - at for place in moved], axis=-1) for view, at in zip(views, base)], axis=1
    )
    across = np.linalg.svd(jacobian)[0][:, :, 3]
    # Signed so that "down" (or right, where the parallax runs along columns) in the first image is positive.
    leading = np.take_along_axis(across[:, :2], np.abs(across[:, :2]).argmax(axis=1)[:, None], axis=1)
    across = across * np.where(leading < 0, -1.0, 1.0)
    residual = np.concatenate([measured - at for measured, at in zip(pixels, base)], axis=1)
    rows = np.sqrt(2.0) * (across * residual).sum(axis=1)
    step = across[:, :2] / np.linalg.norm(across[:, :2], axis=1, keepdims=True)
    ends = [frame.from_geodetic(views[0].localise(base[0] + k * step, ground[:, 2])) for k in (0.0, 1.0)]
    east, north = (ends[1] - ends[0])[:, :2].T
    return rows, np.degrees(np.arctan2(east, north)) % 360.0


def worst_rows(views: Sequence[View], tracks: Sequence[Track], ground: FloatArray) -> Tuple[FloatArray, FloatArray]:
    """(N,) row residual and azimuth of each track in the pair of its views where the residual is largest."""
    by_pair: Dict[Tuple[int, int], List[int]] = {}
    for number, track in enumerate(tracks):
        seen = [i for i, view in enumerate(views) if view.name in track.pixels]
        for pair in combinations(seen, 2):
            by_pair.setdefault(pair, []).append(number)
    rows, azimuths = np.zeros(len(tracks)), np.zeros(len(tracks))
    for (i, j), members in by_pair.items():
        pixels = tuple(np.array([tracks[k].pixels[views[v].name] for k in members]) for v in (i, j))
        found, azimuth = row_residuals((views[i], views[j]), pixels, ground[members])
        larger = np.abs(found) > np.abs(rows[members])
        chosen = np.array(members)[larger]
        rows[chosen], azimuths[chosen] = found[larger], azimuth[larger]
    return rows, azimuths
