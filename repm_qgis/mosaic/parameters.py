"""The numbers that mosaics choose; docs/method.md, "Mosaics", says what each is for."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class OffsetParameters(Parameters):
    """Differences of two DSMs where both have heights, and offsets from them. Chosen, unless a source is given."""

    patch_cells: int = 128  # side of a part of an overlap that is read at once
    patches: int = 64  # of an overlap, evenly spread, at most: a million cells
    least_cells: int = 400  # with both heights: fewer determine no offset
    independent: float = 25.0  # neighbouring cells that err alike, and count as one (as in co-registration)
    least_deviation_m: float = 0.001  # of an overlap's median: no overlap counts for more
    most_m: float = 10.0  # by which a DSM is moved without a warning: without ground control images are off by metres
    apart_m: float = 250.0  # of two DSMs' medians, at most: vertical datums differ by 107 m, and nothing else by more
    unexpected: float = 3.0  # standard deviations that two DSMs state, by which they may differ without a warning; with
    other_m: float = 1.0  # the errors that no DSM states, such as leaves that have grown and errors of matching
    displaced_patch_cells: int = 128  # side of a part in which a horizontal shift is searched: up to a quarter of it
    displaced_cell_m: float = 2.0  # width of its cells, at least, so that shifts of 60 m are found
    displaced_patches: int = 6  # of an overlap, evenly spread, at most
    displaced_gain: float = 0.8  # of the mean deviation, at most, after a shift; otherwise it explains nothing
    most_displaced_m: float = 2.0  # to the side without a warning; and so many cells of the mosaic
    most_displaced_cells: float = 2.0
    most_left_m: float = 1.0  # spread of the differences of one surface: DSMs of WorldView-3 have 0.2 to 0.4 m, and
    most_left_cells: float = 1.5  # at most 0.8 cells; more are of another relief, where they leave more than this
    unexplained: float = 0.5  # of the heights' own spread: DSMs of WorldView-3 leave 0.02 to 0.25
    most_alike_scaled: float = 1.2  # times as high, of reliefs that are alike: two dates of a town have 1.16
    huber: float = 1.345  # standard deviations: 95 % efficiency (Huber and Ronchetti, Robust Statistics)
    reweightings: int = 30


@dataclass(frozen=True)
class SeamParameters(Parameters):
    """From which DSM a cell has its height, and how neighbouring DSMs are blended. All are chosen."""

    tolerance: float = 2.5  # expected errors of both together: heights this close mean the same surface (as in fusion)
    least_error_m: float = 0.02  # of a height: no DSM is better
    unknown_error_m: float = 0.5  # where neither a confidence raster nor an overlap says it
    object_cells: int = 32  # seams go around smaller objects, where two DSMs show these differently
    feather_cells: int = 6  # radius of the mean that is taken twice: a seam is four times as wide
    closed_cells: int = 4  # radius within which half of the cells have heights in a DSM without a hole
    interior_px: int = 1000  # side of the map of how far inside a DSM a place lies


@dataclass(frozen=True)
class MosaicParameters(Parameters):
    """All choices of mosaics."""

    offsets: OffsetParameters = OffsetParameters()
    seams: SeamParameters = SeamParameters()
    finest_cell: float = 0.25  # of the finest DSM's: a mosaic of smaller cells is refused
    block_cells: int = 512  # side of a block, at most
    tile_blocks: int = 8  # along the side of a tile of a VRT: 4096 cells
    stack_cells: int = 4_000_000  # of all DSMs of a block with their margins together, about: bounds the memory


MOSAIC = MosaicParameters()
