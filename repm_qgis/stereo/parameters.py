"""All numbers that rectification and triangulation choose. "Chosen" means that no experiment is recorded."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class StereoParameters(Parameters):
    """Rectified pairs, and the tables from which heights and ground positions are interpolated."""

    tile_margin_px: int = 16  # matched beyond a tile's border, so that neighbours agree along it; 32 does as well
    smallest_px: int = 48  # side of an image of a tile: nothing is matched in a smaller one; chosen
    node_step_px: int = 32  # distance of the tables' nodes; each height map's record has their error, below 0.01 m
    levels: int = 5  # altitudes from which the tables' parabolas are fitted; the same record
    ground_points: int = 9  # along a side of the ground rectangle that a pair is rectified for; chosen
    most_shear: float = 0.3  # of a frame's columns along its rows, so that it contains little outside its tile; chosen


STEREO = StereoParameters()
