"""Tracks: one ground point, and the pixels of all views that see it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..planning.graph import components
from .tie_points import PairMatches


@dataclass(frozen=True)
class Track:
    """One ground point: the views that see it with their (2,) pixels."""

    pixels: Dict[str, FloatArray]


def track_pixels(tracks: Sequence[Track], name: str, numbers: Sequence[int]) -> FloatArray:
    """(n, 2) the pixels of some tracks in a view."""
    return np.array([tracks[k].pixels[name] for k in numbers])


def tracks_from(matches: Sequence[PairMatches]) -> List[Track]:
    """Join pairwise matches into tracks: keypoints that are the same pixel (to a tenth) of a view are one.

    A track that has two pixels in one view contradicts itself and is dropped.
    """
    pixels: Dict[Tuple[str, int, int], FloatArray] = {}

    def node_of(view: str, pixel: FloatArray) -> Tuple[str, int, int]:
        node = (view, int(round(pixel[0] * 10)), int(round(pixel[1] * 10)))
        pixels.setdefault(node, pixel)
        return node

    pairs = ((match, a, b) for match in matches for a, b in zip(match.first_px, match.second_px))
    edges = [(node_of(match.first, a), node_of(match.second, b)) for match, a, b in pairs]
    joined = components(list(pixels), edges)
    consistent = [nodes for nodes in joined if len({node[0] for node in nodes}) == len(nodes) >= 2]
    return [Track({node[0]: pixels[node] for node in nodes}) for nodes in consistent]
