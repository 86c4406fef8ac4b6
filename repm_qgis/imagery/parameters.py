"""The numbers that reading and warping images choose."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class StretchParameters(Parameters):
    """The stretch of intensities to 0..1 (paper, Section 3.1, which gives no numbers). All values are chosen."""

    sample_px: int = 1024  # side of the reduced image that the limits are taken from
    overviews_px: int = 30_000_000  # larger images, or parts of them, are read from overviews where there are any
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
class SamplingParameters(Parameters):
    """Images of different ground sampling distances (GSD)."""

    alike: float = 1.3  # times a GSD, up to which two images are taken as equally fine: nadir and 40 degrees. Chosen
    blur: float = 0.45  # px of the coarser image, of a Gaussian before the reduction; `make bench-frames`


@dataclass(frozen=True)
class DemParameters(Parameters):
    """Reading elevation models; both sizes only bound the memory."""

    range_cells: int = 512  # side of the reduced DEM that the altitude range is taken from
    surface_cells: int = 2000  # side of the surface that images are refined on, at most


@dataclass(frozen=True)
class CollarParameters(Parameters):
    """What is a black end of an image, and not dark ground. All values are chosen."""

    black: float = 3.0  # of whole numbers: zeros, and what lossy JPEG 2000 makes of them
    fill: float = math.nan  # another value that fills an image's ends; found in each image
    least_rows: int = 3  # of those looked at that must begin or end with such a value
    beyond_share: float = 1e-4  # of the pixels that may be larger, or smaller, than such a value, or have it inside ...
    sure_share: float = 0.25  # ... unless so many ends of rows have it: saturated ground has fewer (jax_068: 0.07)
    least_px: int = 16  # of a run of black pixels: shadows at an image's border are shorter
    least_share: float = 0.0005  # of the image: less does no harm
    looked_at: int = 256  # rows, of which one must have a black end before the whole image is read ...
    end_px: int = 64  # ... and how much of each end is looked at
    strip_rows: int = 512  # a pass; bounds the memory


COLLARS = CollarParameters()
STRETCH = StretchParameters()
WARPING = WarpingParameters()
SAMPLING = SamplingParameters()
DEM = DemParameters()
