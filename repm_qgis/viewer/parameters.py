"""The numbers that the page of a surface chooses."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class ViewerParameters(Parameters):
    """The size and precision of a page's surface and of the rasters draped over it. Chosen, unless a source is
    given."""

    most_side: int = 4096  # cells: the largest picture that every device with WebGL 2 shows in practice
    quantum_m: float = 0.01  # of a height, where 16 bit reach over the DSM's range; larger where they do not
    jpeg_quality: int = 85  # of the orthophoto
    block_cells: int = 4_000_000  # of a raster that is read at once where it has other cells than the page
    level: int = 6  # of deflate


VIEWER = ViewerParameters()
