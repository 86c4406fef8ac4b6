"""The numbers that the change between two DSMs chooses; docs/algorithms/change.md says what each is for.

"Chosen" means that the value was set by looking at simulated towns other than those of `make bench-answers`, and at
real pairs of DSMs.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Tuple

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class ErrorModelParameters(Parameters):
    """How much two DSMs differ where nothing changed."""

    slope_edges_deg: Tuple[float, ...] = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0)  # classes; chosen
    least_cells: int = 300  # of a class that counts; chosen
    stable: float = 3.0  # standard deviations: larger differences are not stable ground; the usual limit of outliers
    least_error_m: float = 0.01  # no two DSMs agree better; chosen
    least_horizontal_cells: float = 0.25  # no edge of two DSMs agrees better; chosen
    steepest: float = 30.0  # gradient, m per m, that counts: walls of one cell have any
    lags: Tuple[int, ...] = (1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90, 135, 200)  # of the variogram, cells
    long_lags: int = 20  # of the variogram beyond them, in thinned cells; to half of the extent
    thinned_side: int = 400  # cells of the overlap's longer side that are left for long lags; chosen
    least_pairs: int = 500  # that a lag of the variogram needs; chosen


@dataclass(frozen=True)
class DetectionParameters(Parameters):
    """Which differences are significant."""

    level: float = 1.96  # standard deviations: 95 % (Lane et al. 2003; Wheaton et al. 2010)
    core: float = 2.0  # levels of detection that the core of a change exceeds: errors of matching have heavy tails
    support: float = 4.0  # levels that a change must exceed where several height maps agree; chosen
    support_alone: float = 8.0  # the same where a height has one map or an unknown number: errors cannot be recognised
    support_share: float = 0.25  # of MIN_AREA: on so large an area a change has this support; chosen
    reach_cells: int = 2  # by which matching moves edges: a core is beyond the other DSM's extremes within it
    hidden_gradient: float = 3.0  # a wall hides a strip as wide as a third of its height from views beside the nadir
    hidden_steps: int = 4  # doublings of the strip's reach: 15 cells along an axis
    strip_cells: int = 15  # along a wall's foot, by which a change that ends there goes on; as hidden_steps
    coherent_radius: int = 2  # of the window in which neighbours must agree: 5 x 5 cells (Wheaton et al. 2010)
    coherent_share: float = 0.6  # of its cells; chosen
    grown_cells: int = 4  # a change reaches so far beyond its core; edges are blurred by two cells
    filled: float = 0.25  # a source above is not matched: between the codes 0 and 1, as it is interpolated
    usual_maps: float = 0.75  # of the usual number of height maps: fewer agree on a plain roof whose height is wrong
    least_maps: float = 2.0  # height maps: a single one cannot be checked
    block_cells: int = 1024  # side of a block

    @property
    def halo_cells(self) -> int:
        """The largest distance of a cell that another cell's result depends on."""
        strip = 2 << self.hidden_steps  # an axis' reach and that of both diagonals
        return self.reach_cells + 2 * strip + self.coherent_radius + 2 * self.grown_cells + self.strip_cells + 1


@dataclass(frozen=True)
class ChangeParameters(Parameters):
    """All of them."""

    errors: ErrorModelParameters = field(default_factory=ErrorModelParameters)
    detection: DetectionParameters = field(default_factory=DetectionParameters)


CHANGE = ChangeParameters()
