"""The numbers that orthophotos choose; docs/method.md says more about each subject."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from ..contracts.parameters import Parameters
from ..fusion.parameters import VisibilityParameters
from ..geometry.parameters import GriddingParameters


@dataclass(frozen=True)
class BalanceParameters(Parameters):
    """Colours that are made equal between views (ortho/colour_balance.py). All values are chosen."""

    samples: int = 40_000  # places on the DSM, at most, where the views' colours are compared
    least_common: int = 200  # of them that two views must both see
    quantiles: Tuple[float, ...] = (0.1, 0.3, 0.5, 0.7, 0.9)  # that are made equal
    pull: float = 1e-3  # weight of no change, against 1 of two views that both see everything
    mean: float = 1e3  # weight of the mean of all gains and offsets: it holds
    largest_gain: float = 4.0  # and the smallest is its inverse


@dataclass(frozen=True)
class SeamParameters(Parameters):
    """Which view a cell is taken from (ortho/view_choice.py). Costs in standard deviations of a band; all chosen."""

    steepness: float = 1.0  # of a view that goes 1 m sideways for each m, above the most vertical one
    hidden: float = 50.0  # of a view that does not see the cell
    edge_cells: int = 2  # this near to ground that a view does not see, the DSM's edges may be wrong
    edge: float = 1.0  # of a cell there
    least_views: int = 3  # views that see a cell, for a median of their colours
    odd: float = 0.3  # of one standard deviation from that
    oddest: float = 2.0  # and colours farther away count as that
    seam: float = 0.3  # of a cell of a seam
    apart: float = 2.0  # of a seam where two views differ by one standard deviation
    most_apart: float = 1.0  # and larger differences count as that
    feather_cells: int = 2  # on both sides of a seam
    blended: float = 0.5  # standard deviations from the chosen colour: colours that differ by more are not mixed in


@dataclass(frozen=True)
class PansharpeningParameters(Parameters):
    """A multispectral image beside a panchromatic one (ortho/pansharpening.py). All values are chosen."""

    window_px: int = 192  # side of a window of the multispectral image in which both are compared
    windows: int = 4  # along each side of the image
    least_known: float = 0.5  # share of a window that both show
    highpass_px: float = 4.0  # wider structures do not count for the shift
    least_response: float = 0.1  # of a window's phase correlation
    largest_shift_px: float = 3.0  # px of the multispectral image: more is no shift, but a mistake
    least_correlation: float = 0.5  # of the bands' weighted sum with the panchromatic image: less is worth a warning
    largest_turn: float = 0.02  # between the lines of sight of one acquisition, m sideways for each m: 1 degree
    largest_lapse_s: float = 60.0  # between the times of one acquisition


@dataclass(frozen=True)
class ColourParameters(Parameters):
    """The orthophoto in colour (ortho/colour_ortho.py)."""

    halo_cells: int = 32  # around it, so that seams go on from block to block
    most_views: int = 6  # of a block; the time grows with their square
    least_views: int = 3  # of a block, so that there is a choice of seams
    worthwhile: float = 0.002  # share of the block's cells that a further view must add


@dataclass(frozen=True)
class OrthoParameters(Parameters):
    """From a finished DSM and its images to orthophotos."""

    visibility: VisibilityParameters = VisibilityParameters()
    gridding: GriddingParameters = GriddingParameters()
    colour: ColourParameters = ColourParameters()
    balance: BalanceParameters = BalanceParameters()
    seams: SeamParameters = SeamParameters()
    sharpening: PansharpeningParameters = PansharpeningParameters()
    block_cells: int = 512  # side of what is made at once; bounds the memory
    reach_cells: int = 512  # of the DSM; how far away objects are tested for hiding a cell, at most
    kernel: str = "cubic"  # of pixels, where the orthophoto's cells are finer than the DSM's (`make bench-orthophoto`)
    nested: float = 0.05  # of the images' GSD: so far may cells be from it that divide the DSM's; chosen


ORTHO = OrthoParameters()
