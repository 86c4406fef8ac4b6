"""All numbers that comparisons with references choose.

"Chosen" means that no experiment is recorded. What only concerns pages and pictures stays in their modules.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Tuple

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class CoregistrationParameters(Parameters):
    """How a DSM is laid onto a reference (Nuth and Kääb 2011, The Cryosphere 5). Lengths are cells of the reference.

    Chosen, unless a source is given; tests/engine/evaluation shows that known shifts are found within 0.05 cells.
    """

    least_cells: int = 100  # with both heights: fewer are refused
    search: int = 32  # reach of the search by whole cells, coarse to fine
    coarsest: int = 24  # cells that a side keeps at the coarsest level
    fine_search: int = 2  # reach at each finer level
    differences: int = 200_000  # that one NMAD of the search is taken from, about
    least_share: float = 0.2  # of the cells that must still overlap after a shift
    whole_search: int = 8  # reach of the alignment by whole cells, which benchmarks use
    iterations: int = 15  # Gauss-Newton steps, at most
    most_step: float = 1.0  # of one of them, along an axis
    converged: float = 0.002  # a step as small as this is the last
    most_drift: float = 3.0  # from the search's result: beyond, the steps ran away and are dropped
    tukey: float = 4.685  # of the biweight, in standard deviations: 95 % efficiency (Holland and Welsch 1977)
    reweightings: int = 4
    independent: float = 25.0  # neighbouring cells that err alike, and count as one
    most_uncertain: float = 0.5  # standard deviation of the shift: beyond, the relief is too little
    cap_nmad: float = 3.0  # differences are truncated here in the last search, in NMADs ...
    least_cap_m: float = 0.05  # ... and not below
    first_step: float = 0.32  # of the last search, which halves it ...
    last_step: float = 0.009  # ... down to this


@dataclass(frozen=True)
class IcpParameters(Parameters):
    """How points are laid onto points (evaluation/icp.py); chosen by `make bench-answers`. Its robust weights and its
    least certainty are those of :class:`CoregistrationParameters`."""

    points: int = 200_000  # of the DSM, at most
    reference_points: int = 1_000_000  # and of the reference
    least_points: int = 100  # that lie on flat parts near each other: fewer are refused
    neighbours: int = 12  # whose plane a point's normal is taken from
    at_once: int = 50_000  # points whose planes are found at once; bounds the memory
    flat_medians: float = 3.0  # times the median distance of neighbours from their plane: rougher places do not count
    least_rough_m: float = 0.001  # of that median, and of the scale of Tukey's weights: simulated planes are exact
    alike: float = 0.9  # cosine of the angle between the planes of both sides
    reaches: Tuple[float, ...] = (8.0, 4.0, 2.0)  # for the nearest point, in distances between points: one by one
    iterations: int = 20  # for each reach, at most
    converged_m: float = 0.0005  # a step as small as this is the last
    most_apart_sides: float = 0.4  # of the reference's cells, between this shift and that of slopes; sound DSMs: 0.15


@dataclass(frozen=True)
class ComparisonParameters(Parameters):
    """How surfaces are resampled, and how errors are sampled and divided. All values are chosen."""

    least_share: float = 0.5  # of a resampling kernel's weight that must have heights: holes keep their size
    slope_edges_deg: Tuple[float, ...] = (0.0, 5.0, 15.0, 30.0, 45.0, 90.0)  # classes of the reference's slope
    sample_cells: int = 2_000_000  # the alignment uses all cells up to here, and beyond ...
    patches: int = 5  # ... so many patches along a side of the overlap ...
    patch_cells: int = 320  # ... of this side
    block_cells: int = 1024  # side of a block that is compared at once, at most
    source_cells: int = 2048  # side of the DSM's part that a block needs, about


@dataclass(frozen=True)
class GcpParameters(Parameters):
    """When control points and datums count as wrong. All values are chosen."""

    wrong_px: float = 1.5  # least residual of a wrong control point: a shift explains less than an adjustment does
    wrong_times: float = 4.0  # how many NMADs of all points' residuals it must have, too
    least_off_m: float = 2.0  # a median error from here on is a unit or a datum, where one of them explains it
    geoid_m: float = 10.0  # a median error from here on is usually a geoid ...
    geoid_times: float = 5.0  # ... where it is more than so many NMADs
    least_searched: int = 8  # points whose place is looked for: fewer fit somewhere by chance
    search_step_m: float = 2.0  # of that search; a cell, where it is wider
    search_steps: int = 16  # to each side
    search_finer: int = 4  # parts of a step, around the best place of that search
    least_misfit_m: float = 0.5  # median distance from the median error, from which on a place may be wrong
    search_gain: float = 0.3  # of that distance, at most, at a better place; and less than errors alone have, with this
    search_chance: float = 0.01  # ... probability, at any of the places


@dataclass(frozen=True)
class EvaluationParameters(Parameters):
    """The choices of all comparisons."""

    coregistration: CoregistrationParameters = field(default_factory=CoregistrationParameters)
    icp: IcpParameters = field(default_factory=IcpParameters)
    comparison: ComparisonParameters = field(default_factory=ComparisonParameters)
    gcps: GcpParameters = field(default_factory=GcpParameters)


EVALUATION = EvaluationParameters()
COREGISTRATION, COMPARISON, GCPS = EVALUATION.coregistration, EVALUATION.comparison, EVALUATION.gcps
ICP = EVALUATION.icp
