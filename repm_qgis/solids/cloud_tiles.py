"""A point cloud as 3-D Tiles 1.1: the octree of its points, one GLB of points for each node.

Each point is in one tile, and the tiles below a tile add theirs to it (refine ADD). So nothing is read twice, and each
level is an even sample: one point for each voxel, half as wide as those of the level above. Vertices of a surface could
not be left to the level above, as triangles need them all: there tiles replace each other (solids/tiles3d.py).

The octree's steps are millimetres of the tileset's own axes, in which boxes are upright. Memory does not grow with the
cloud, but for the list of tiles.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Callable, Dict, Generator, List, Optional, Tuple

import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import FloatArray
from ..contracts.documents import JsonObject
from ..contracts.errors import EmptyResultError, ImageError
from ..registration.clouds import meant, opened_cloud
from ..reports.pictures import ramp_table
from ..runtime.progress import Progress, Silent
from ..runtime.workspace import whole_folder
from .gltf import points_glb
from .octree import COLOURED, SPAN_BITS, Cube, Octree, Place, Points
from .painting import Colours
from .parameters import SOLIDS, SolidsParameters, Tiles3dParameters
from .tileset import Globe, box, require_tiles3d_place, write_tileset

_STEP_M = 0.001  # of coordinates in the octree
_WIDEST_BITS = 30  # of the cube's side in these steps: 1074 km
_POINT = np.dtype([*COLOURED.descr, ("level", "<u2")])  # the height in the range of the cloud's
_MOST = 65535  # of colours, intensities and levels
_ALONG = 9  # places along a side of the cloud's bounds, between which the axes are as good as straight
_SPARE = 0.01  # of its size, around the cloud
_OPTION = "DSM"


@dataclass(frozen=True)
class CloudTilesFacts:
    """A written tileset: its tiles and points, and how far apart the points of the coarsest tile are, m."""

    tiles: int
    points: int
    spacing_m: float


def write_cloud_tiles(
    cloud: str, folder: str, *, progress: Optional[Progress] = None, parameters: SolidsParameters = SOLIDS
) -> CloudTilesFacts:
    """Write a LAS or LAZ file as 3-D Tiles: a folder with ``tileset.json`` and GLB files, completely or not at all.

    Heights become metres above the WGS 84 ellipsoid; those of a cloud that does not state its datum are taken to be
    that, with a warning. Points of the classes for noise, and withheld ones, are left out. Points without colours have
    those of their heights.

    Raises ImageError for a cloud that cannot be read or has no CRS, EmptyResultError for one without points,
    MissingPackageError without laspy or the grid of its geoid, WorkspaceError where the folder has other files or
    cannot be written.
    """
    progress = progress or Silent()
    require_tiles3d_place(folder)
    source = _Source.of(cloud, progress)
    with whole_folder(folder) as whole:
        tiles = _Tiles(whole, source, parameters.tiles3d, progress)
        tree = Octree(source.cube, _POINT, whole, tiles.write, progress=progress, parameters=parameters.ept)
        with closing(source.points()) as points:
            tree.partition(points, source.count)
        if not source.used:
            raise EmptyResultError(f"The cloud '{cloud}' has no points: there is nothing to write into '{folder}'.")
        tree.build()
        return tiles.finish()


@dataclass
class _Source:
    """A cloud to be read: what its header says, where its points go, and what was found in those that were read."""

    path: str
    count: int
    heights: Tuple[float, float]
    unit_m: float
    globe: Globe
    cube: Cube
    progress: Progress
    used: int = 0
    brightest: int = 0
    levels: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_MOST + 1, np.int64))

    @classmethod
    def of(cls, path: str, progress: Progress) -> _Source:
        with opened_cloud(path, _OPTION) as cloud:
            header, unit, system = cloud.reader.header, cloud.unit_m, cloud.system
            low, high, count = np.array(header.mins, float), np.array(header.maxs, float), int(header.point_count)
        low, high = low if count else np.zeros(3), high if count else np.zeros(3)
        globe = Globe.at(((low + high) / 2)[:2].tolist(), path, system, "", progress)
        x, y, z = (part.ravel() for part in np.meshgrid(*np.linspace(low, high, _ALONG).T))
        around = globe.enu(np.column_stack([x, y]), z * unit)
        low_m, high_m = around.min(axis=0), around.max(axis=0)
        spare = 1 + _SPARE * (high_m - low_m).max()
        if not np.isfinite(spare) or (high_m - low_m).max() + 2 * spare > _STEP_M * (1 << _WIDEST_BITS):
            raise ImageError(
                f"The point cloud '{path}' states bounds that are no place on the ground: write it anew (PDAL)."
            )
        ends = [np.rint(end / _STEP_M).astype(np.int64) for end in (low_m - spare, high_m + spare)]
        cube = Cube.around(ends[0], ends[1], _STEP_M, np.zeros(3))
        # A surface lies in four children of eight where none of their sides goes through the middle of its heights.
        cube = replace(cube, corner=np.append(cube.corner[:2], ends[0][2]))
        return cls(path, count, (float(low[2]), float(high[2])), unit, globe, cube, progress)

    def points(self) -> Generator[Points, None, None]:
        """The records of the octree, some at a time."""
        with opened_cloud(self.path, _OPTION) as cloud:
            done = 0
            for read in cloud.records(self.progress.check_cancelled):
                done += len(read)
                self.progress.step(0.4 * done / max(self.count, 1), "reading points")
                use = meant(read)
                if use.any():
                    yield self._records(read, use)

    def _records(self, read: Any, use: NDArray[np.bool_]) -> Points:
        x, y, z = (np.asarray(each)[use].astype(np.float64) for each in (read.x, read.y, read.z))
        steps = np.rint(self.globe.enu(np.column_stack([x, y]), z * self.unit_m) / _STEP_M)
        inside = (steps >= self.cube.corner) & (steps < self.cube.corner + (1 << self.cube.bits))
        if not inside.all():  # NaN, too
            raise ImageError(f"The point cloud '{self.path}' has points beyond the bounds in its header: get it again.")
        records = np.zeros(len(x), _POINT)
        records["xyz"], records["intensity"] = steps, np.asarray(read.intensity)[use]
        if "red" in read.point_format.dimension_names:
            records["colour"] = np.column_stack([np.asarray(read[name])[use] for name in ("red", "green", "blue")])
            self.brightest = max(self.brightest, int(records["colour"].max()))
        low, high = self.heights
        records["level"] = np.clip((z - low) / ((high - low) or 1.0), 0, 1) * _MOST
        self.levels += np.bincount(records["level"], minlength=len(self.levels))
        self.used += len(x)
        return records

    def painter(self) -> Callable[[Points], Colours]:
        """What gives (N, 3) colours of records, after all were read: their own, of 16 bits or of 8 as some programs
        write, or else those of their heights, of which 2 to 98 % have different ones."""
        if self.brightest:
            scale = np.uint16(1 if self.brightest > 255 else 257)
            return lambda points: points["colour"] * scale
        low, high = np.searchsorted(np.cumsum(self.levels), np.array([0.02, 0.98]) * self.used)
        ramp = ramp_table("elevation", 1 << 10).astype(np.uint16) * np.uint16(257)
        place = np.clip((np.arange(_MOST + 1) - low) / max(int(high - low), 1), 0, 1)
        table = ramp[np.rint(place * (len(ramp) - 1)).astype(np.int64)]
        return lambda points: table[points["level"]]


@dataclass
class _Tiles:
    """The tiles that are written, with the corners of the boxes around their points, m."""

    folder: Path
    source: _Source
    parameters: Tiles3dParameters
    progress: Progress
    ends: Dict[Place, Tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    paint: Optional[Callable[[Points], Colours]] = None
    done: int = 0

    def __post_init__(self) -> None:
        (self.folder / "tiles").mkdir()

    def write(self, node: Place, points: Points) -> None:
        """Write the tile of a node."""
        self.progress.check_cancelled()
        self.paint = self.paint or self.source.painter()
        xyz = points["xyz"] * _STEP_M
        data = points_glb(xyz, self.paint(points), points["intensity"] / _MOST)
        (self.folder / _name(node)).write_bytes(data)
        self.ends[node] = xyz.min(axis=0), xyz.max(axis=0)
        self.done += len(points)
        self.progress.step(0.4 + 0.6 * self.done / self.source.used, "writing tiles")

    def finish(self) -> CloudTilesFacts:
        """List the tiles, from the leaves upwards."""
        below: Dict[Place, List[JsonObject]] = {}
        for node in sorted(self.ends, reverse=True):  # the deepest first
            depth, x, y, z = node
            low, high = self.ends[node]
            entry: JsonObject = {"boundingVolume": box(low, high), "geometricError": 0.0}
            entry["content"] = {"uri": _name(node)}
            if node in below:
                entry["geometricError"] = self.parameters.spacings * self._spacing(depth)
                entry["children"] = below.pop(node)[::-1]
            if not depth:
                break
            above = depth - 1, x >> 1, y >> 1, z >> 1
            below.setdefault(above, []).append(entry)
            self.ends[above] = np.minimum(self.ends[above][0], low), np.maximum(self.ends[above][1], high)
        write_tileset(self.folder, self.source.globe.frame, entry, "ADD", float(np.linalg.norm(high - low)))
        return CloudTilesFacts(len(self.ends), self.source.used, self._spacing(0) if "children" in entry else 0.0)

    def _spacing(self, depth: int) -> float:
        """The side of a voxel of a depth, of which one point is kept, m."""
        return _STEP_M * (1 << self.source.cube.bits) / (1 << (depth + SPAN_BITS))


def _name(node: Place) -> str:
    return f"tiles/{'_'.join(map(str, node))}.glb"
