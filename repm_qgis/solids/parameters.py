"""The numbers that point clouds and meshes choose; docs/method.md says more about each subject."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class CloudParameters(Parameters):
    """Which matched points are in the cloud (solids/cloud_points.py); part "solids" of `make bench-answers`."""

    surface_px: float = 1.0  # of disparity from the height of its own cell: such a point lies on the surface; chosen
    wall_cells: int = 2  # around a point, whose lowest and highest are the ends of a wall; measured against 1
    wall_px: float = 0.5  # of disparity from both ends: a point of a wall lies between them; measured against 0 and 1
    normal_neighbours: int = 16  # of a point, whose plane gives its normal; measured against 9 and 24
    normals_at_once: int = 1 << 15  # points; bounds the memory


@dataclass(frozen=True)
class PaintingParameters(Parameters):
    """Colours of points and vertices (solids/painting.py); both values are chosen."""

    percents: Tuple[float, float] = (2.0, 98.0)  # shown as black and white, of orthophotos of more than 8 bits
    preview_px: int = 1200  # side of the reduced orthophoto from which these are taken


@dataclass(frozen=True)
class EptParameters(Parameters):
    """Sizes of Entwine Point Tiles and of 3-D Tiles of clouds (solids/octree.py), in points."""

    leaf: int = 1 << 16  # a node with so many keeps all: files of about 300 kB, as Entwine writes
    batch: int = 1 << 21  # sorted in memory at once: about 200 MB
    chunk: int = 1 << 20  # read at once


@dataclass(frozen=True)
class SimplificationParameters(Parameters):
    """Meshes of fewer vertices than the DSM has cells."""

    cells: int = 1 << 22  # from which vertices are chosen; bounds time and memory; measured against 1 << 24
    strip_cells: int = 1 << 18  # simplified at once: about 250 MB
    spare: float = 1.5  # strips have so many times the vertices that are wanted, and all together fewer; chosen
    joined: int = 1 << 20  # wanted vertices up to which all strips are simplified together: 2 GB
    tight: float = 0.95  # of more, strips have so many times what is wanted: their seams are kept


@dataclass(frozen=True)
class Tiles3dParameters(Parameters):
    """3-D Tiles of a surface (solids/tiles3d.py) or a cloud (solids/cloud_tiles.py); other values are chosen."""

    cells: int = 256  # from the first to the last cell of a tile's side; a power of two
    tolerance: float = 0.25  # of a cell's side: a cell that is so much off on its own is not left out
    lost: float = 0.3  # squared distance, in its triangle's, that counts for a cell which is lost to a hole; tuned
    most_texels: int = 4  # of the picture for each cell's side
    jpeg_quality: int = 85
    spacings: float = 8.0  # of a cloud's points: its tiles' geometric error; at 16 px, points are 2 px apart


@dataclass(frozen=True)
class SolidsParameters(Parameters):
    """From a finished DSM to point clouds and meshes."""

    cloud: CloudParameters = CloudParameters()
    painting: PaintingParameters = PaintingParameters()
    ept: EptParameters = EptParameters()
    simplification: SimplificationParameters = SimplificationParameters()
    tiles3d: Tiles3dParameters = Tiles3dParameters()
    mesh_block_cells: int = 1 << 18  # of the mesh that are read at once; bounds the memory


SOLIDS = SolidsParameters()
