"""How a height map changes by waves of the attitude that were found after the matching.

A registration may find waves along the parallax, which only move heights. The map stays as it was matched: each of its
points keeps its pixels in both images, and the lines of sight through them have moved by the change of the waves in the
lines in which these pixels lie.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, FloatArray
from ..geometry.jitter import Jitter
from ..geometry.rectification import RectifiedPair
from ..scene import View
from .parameters import STEREO, StereoParameters
from .triangulation import NodeTable, PairGeometry, nodes


@dataclass(frozen=True)
class WaveGeometry:
    """Where waves of the two views of a pair act on its height map, and how much.

    ``lines`` are the lines of the two images by column, row and height of the map. ``height_m`` is the height that one
    px of a wave in columns and in rows adds, (2,) for each view; ``place_m`` (2, 2) what one px of the first view's
    adds to x and y. ``along`` is the direction of the parallax in each image, (2,) of length one.
    """

    lines: Tuple[NodeTable, NodeTable]
    height_m: Tuple[FloatArray, FloatArray]
    place_m: FloatArray
    along: Tuple[FloatArray, FloatArray]


def wave_geometry(
    pair: RectifiedPair,
    geometry: PairGeometry,
    first: View,
    second: View,
    altitudes: Altitudes,
    parameters: StereoParameters = STEREO,
) -> WaveGeometry:
    """Of a pair over its tile. Effects of one px are those in the middle of the frame: they change by some per cent."""
    columns, rows = (nodes(n, parameters.node_step_px) for n in pair.size)
    z, r, c = np.meshgrid(np.linspace(*altitudes, parameters.levels), rows, columns, indexing="ij")
    originals = pair.first_original(np.stack([c, r], axis=-1))
    seen = second.project(first.localise(originals, z))
    lines = tuple(NodeTable.fit(columns, rows, z, pixels[..., 1])[0] for pixels in (originals, seen))
    middle = np.array([[(n - 1) / 2 for n in pair.size]])
    height, step = np.array([sum(altitudes) / 2]), 1.0
    ends = np.concatenate([height, height + 10.0])
    here = pair.first_original(middle)[0]
    ground = first.localise(here, height[0])
    there = second.project(ground)
    risen = np.array([[*ground[:2], h] for h in ends])
    along = tuple(_unit(np.diff(view.project(risen), axis=0)[0]) for view in (first, second))

    def height_of(pixel: FloatArray, other: FloatArray) -> float:
        (col, row), far = pair.first_rectified(pixel), pair.second_rectified(other)
        at = np.array([[col - far[0]]])
        return float(geometry.height.on_grid(np.array([col]), np.array([row]), at)[0, 0])

    moves = step * np.eye(2)
    own = np.array([height_of(here - move, there) - height_of(here + move, there) for move in moves]) / (2 * step)
    far = np.array([height_of(here, there - move) - height_of(here, there + move) for move in moves]) / (2 * step)
    place = np.array([_places(geometry, pair.first_rectified(here + move), height[0]) for move in moves])
    place -= np.array([_places(geometry, pair.first_rectified(here - move), height[0]) for move in moves])
    return WaveGeometry((lines[0], lines[1]), (own, far), -place.T / (2 * step), (along[0], along[1]))


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))


def _places(geometry: PairGeometry, place: FloatArray, height: float) -> Tuple[float, float]:
    """x and y of a place of the frame at a height."""
    at = np.array([place[0]]), np.array([place[1]]), np.array([[height]])
    return float(geometry.x.on_grid(*at)[0, 0]), float(geometry.y.on_grid(*at)[0, 0])


@dataclass(frozen=True)
class WaveChange:
    """How waves of the two views of a height map have changed since it was matched: those ``now`` and ``before``."""

    geometry: WaveGeometry
    now: Tuple[Optional[Jitter], Optional[Jitter]]
    before: Tuple[Optional[Jitter], Optional[Jitter]]

    def of(self, columns: FloatArray, rows: FloatArray, height: FloatArray) -> Tuple[FloatArray, FloatArray]:
        """(H, W) m to add to heights (H, W) on the grid of (W,) columns and (H,) rows, and (H, W, 2) m to add to their
        x and y."""
        up, moved = np.zeros_like(height), np.zeros((*height.shape, 2))
        for number in range(2):
            lines = self.geometry.lines[number].on_grid(columns, rows, height)
            change = _displacement(self.now[number], lines) - _displacement(self.before[number], lines)
            up += change @ self.geometry.height_m[number]
            if number == 0:
                moved = change @ self.geometry.place_m.T
        return up, moved


def _displacement(jitter: Optional[Jitter], lines: FloatArray) -> FloatArray:
    return np.zeros((*lines.shape, 2)) if jitter is None else jitter.at(lines)
