"""The bounds beyond which reports warn. What only concerns pages and pictures stays in their modules."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class VerdictParameters(Parameters):
    """The bounds beyond which a report says "look at" instead of "good". All values are chosen: good scenes, simulated
    and real, lie well on the other side (docs/benchmarks.md)."""

    least_covered_percent: float = 80.0  # cells with a height, of the ground that two images see
    most_residual_px: float = 0.5  # median residual of the tie points after the correction; 0.1 to 0.3 is usual
    most_parallax_px: float = 0.5  # median vertical parallax of one pair then: beyond, its matching finds other rows
    most_equivalent_px: float = 0.3  # RMSE of a tile's cameras after refinement; below, matching is not disturbed
    most_rpc_px: float = 0.01  # from an exported RPC to the pointed model; corrections of usual size stay below 0.001
    least_compared_percent: float = 50.0  # reference cells with a height of the DSM
    least_compared_cells: int = 100  # cells: what fewer say of a DSM is chance
    most_moved_m: float = (
        30.0  # by an alignment, along the ground: images without control points differ by less, or ...
    )
    most_moved_cells: float = 3.0  # ... by so many cells
    most_raised_m: float = 10.0  # and up: images without control points differ by metres, geoids by more
    least_points: int = 4  # ground control points: with fewer, none can be called wrong
    most_points_m: float = 3.0  # spread of a DSM's errors at them (RMS), or a cell: a storey, as where a place is wrong
    most_points_left_m: float = 1.0  # the same by the shortest half, or a cell, where it is more than this share of ...
    most_points_unexplained: float = 0.5  # ... the spread of the heights
    most_bias_m: float = 0.5  # median difference from a reference, or of two DSMs of a mosaic ...
    most_bias_nmads: float = 2.0  # ... where it is more than so many NMADs, too
    most_spread_m: float = 10.0  # NMAD against a reference; DSMs of satellite images have 0.3 to 4 m ...
    most_spread_cells: float = 1.0  # ... and global DEMs less than a cell: a coarse surface is off by its relief
    most_changed_share: float = 0.3  # of the ground of two dates: beyond, most of it is not stable
    most_offset_m: float = 10.0  # between two dates: images without control points differ by metres, geoids by more
    most_level_m: float = 3.0  # a storey
    least_used_share: float = 0.5  # of a reference's heights that agree with the surface; forests leave a third


VERDICT = VerdictParameters()
