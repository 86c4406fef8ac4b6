"""Vertical parallax: how far a view's pixel of a ground point lies from the epipolar line of another view's.

No height explains it. In a rectified pair it is the difference of rows; here it comes from the sensor models
themselves, so that no camera fitted over a whole scene changes it.
"""

from __future__ import annotations

from itertools import combinations
from typing import Dict, List, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..geometry.frames import EnuFrame, mean_place
from ..scene import View
from ..ties.tracks import Track, track_pixels


def vertical_parallax(
    views: Tuple[View, View], pixels: Tuple[FloatArray, FloatArray], ground: FloatArray
) -> Tuple[FloatArray, FloatArray]:
    """(N,) vertical parallax, px, and (N,) the azimuth in which it grows on the ground, degrees clockwise from north.

    Parameters
    ----------
    views : with their pointing.
    pixels : (N, 2) in each view.
    ground : (N, 3) longitude, latitude, height; an error of some ten metres does not matter.

    Notes
    -----
    A move of the ground point takes up three of the four coordinates of the residual. What remains is the component
    along the one direction that no move reaches, scaled so that one px in one image counts as one.
    """
    frame = EnuFrame(*map(float, mean_place(ground)))
    enu = frame.from_geodetic(ground)
    base = [view.project(ground) for view in views]
    moved = [frame.to_geodetic(enu + delta) for delta in np.eye(3)]
    parts = [np.stack([view.project(place) - at for place in moved], axis=-1) for view, at in zip(views, base)]
    jacobian = np.concatenate(parts, axis=1)
    across = np.linalg.svd(jacobian)[0][:, :, 3]
    # The sign makes "down" (or right, where the parallax runs along columns) in the first image positive.
    leading = np.take_along_axis(across[:, :2], np.abs(across[:, :2]).argmax(axis=1)[:, None], axis=1)
    across = across * np.where(leading < 0, -1.0, 1.0)
    residual = np.concatenate([measured - at for measured, at in zip(pixels, base)], axis=1)
    parallax = np.sqrt(2.0) * (across * residual).sum(axis=1)
    step = across[:, :2] / np.linalg.norm(across[:, :2], axis=1, keepdims=True)
    ends = [frame.from_geodetic(views[0].localise(base[0] + k * step, ground[:, 2])) for k in (0.0, 1.0)]
    # numpy may take strided columns by another routine, as memory happens to lie, with another last bit.
    east, north = np.ascontiguousarray((ends[1] - ends[0])[:, :2].T)
    return parallax, np.degrees(np.arctan2(east, north)) % 360.0


def tracks_of_pair(
    views: Tuple[View, View], tracks: Sequence[Track], ground: FloatArray
) -> Tuple[FloatArray, FloatArray, FloatArray]:
    """(n,) the numbers of the tracks that both views see, their vertical parallax, and its azimuth."""
    first, second = (view.name for view in views)
    shared = [k for k, track in enumerate(tracks) if first in track.pixels and second in track.pixels]
    if not shared:
        return np.zeros(0, dtype=int), np.zeros(0), np.zeros(0)
    pixels = track_pixels(tracks, first, shared), track_pixels(tracks, second, shared)
    return (np.array(shared), *vertical_parallax(views, pixels, ground[shared]))


def largest_parallax(
    views: Sequence[View], tracks: Sequence[Track], ground: FloatArray
) -> Tuple[FloatArray, FloatArray]:
    """(N,) vertical parallax and azimuth of each track in the pair of its views where it is largest."""
    parallax, azimuths = np.zeros(len(tracks)), np.zeros(len(tracks))
    order = {view.name: number for number, view in enumerate(views)}
    shared: Dict[Tuple[int, int], List[int]] = {}
    for number, track in enumerate(tracks):
        for pair in combinations(sorted(order[name] for name in track.pixels), 2):
            shared.setdefault((pair[0], pair[1]), []).append(number)
    for (i, j), numbers in sorted(shared.items()):
        seen = [tracks[k] for k in numbers]
        own, found, azimuth = tracks_of_pair((views[i], views[j]), seen, ground[numbers])
        members = np.array(numbers)[own]
        larger = np.abs(found) > np.abs(parallax[members])
        chosen = members[larger]
        parallax[chosen], azimuths[chosen] = found[larger], azimuth[larger]
    return parallax, azimuths
