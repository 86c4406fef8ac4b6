"""The numbers that reading and warping images choose."""

from __future__ import annotations

from dataclasses import dataclass

from ..parameters import Parameters


@dataclass(frozen=True)
class StretchParameters(Parameters):
    """The stretch of intensities to 0..1 (paper, Section 3.1, which gives no numbers). All values are chosen."""

    sample_px: int = 1024  # side of the reduced image that the limits are taken from
    least_pixels: int = 100  # with data in it: fewer are an error
    low_percent: float = 0.1  # of its pixels are darker than 0
    high_percent: float = 99.5  # of its pixels are below the threshold, where the compressed tail begins
    knee: float = 0.9  # the value of the threshold: the rest is for the tail


@dataclass(frozen=True)
class WarpingParameters(Parameters):
    """Resampling in strips, with a map that is exact at nodes and bilinear between them."""

    node_step_px: int = 16  # between nodes: homographies and low polynomials cost less than 1e-3 px (test_warping)
    strip_rows: int = 512  # a pass; bounds the memory
    block_columns: int = 1024  # a pass; whole node steps


@dataclass(frozen=True)
class DemParameters(Parameters):
    """Reading elevation models; both sizes only bound the memory."""

    range_cells: int = 512  # side of the reduced DEM that the altitude range is taken from
    surface_cells: int = 2000  # side of the surface that images are refined on, at most


STRETCH = StretchParameters()
WARPING = WarpingParameters()
DEM = DemParameters()
