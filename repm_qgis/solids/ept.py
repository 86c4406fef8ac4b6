"""Point clouds as Entwine Point Tiles (EPT), which every QGIS shows; LAS and LAZ need one that is built with PDAL.

An octree over a cube around the cloud. A node keeps one point of each of its 128 x 128 x 128 voxels and passes the rest
to its eight children; a node with few points keeps them all. So every point is in exactly one node, and the upper nodes
are an even sample of everything below.

The cube's side is a power of two of the cloud's own steps (millimetres), and all numbers are integers: no point is
rounded again, and the same cloud gives the same files.

References
----------
Entwine Point Tile specification 1.0.0, entwine.io.
"""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any, Dict, Generator, Iterable, Iterator, List, Optional, Sequence, Tuple

import numpy as np
import pyproj
from numpy.typing import NDArray

from ..contracts.arrays import AnyArray, FloatArray, IntArray
from ..contracts.documents import JsonObject
from ..contracts.errors import EmptyResultError, WorkspaceError
from ..files.las import laz_backend, required_laspy
from ..runtime.progress import Progress, Silent
from ..runtime.workspace import foreign_entries, whole_folder
from .derived import FinishedDsm
from .parameters import SOLIDS, EptParameters

Points = AnyArray
"""Records of the type ``_RECORD`` or ``_COLOURED``."""
Codes = NDArray[np.uint64]
"""Morton codes."""
Node = Tuple[int, int]
"""Depth, and the Morton code of the node's place among all of that depth."""

_SPAN_BITS = 7  # 128 voxels a side of a node
_CODE_BITS = 21  # a side, of a Morton code of 63 bits: 14 levels of nodes
_RECORD = np.dtype([("xyz", "<i4", 3), ("intensity", "<u2")])
_COLOURED = np.dtype([*_RECORD.descr, ("colour", "<u2", 3)])
_ANY_DAY = date(1970, 1, 1)
"""The day in each node's header: the same cloud gives the same bytes tomorrow, and laspy writes today for none."""
_ENTRIES = ("ept.json", "ept.qml", "ept-data", "ept-hierarchy")
_DIMENSIONS = ("X", "Y", "Z", "Intensity", "Red", "Green", "Blue")


@dataclass(frozen=True)
class _Cube:
    """The root node: ``corner`` (3,) in the cloud's steps, and a side of ``2 ** bits`` steps of ``scale`` metres."""

    corner: IntArray
    bits: int
    scale: float
    offset: FloatArray

    @classmethod
    def around(cls, low: IntArray, high: IntArray, scale: float, offset: FloatArray) -> _Cube:
        bits = max(int((high - low).max()).bit_length(), _SPAN_BITS)
        return cls((low + high + 1 - (1 << bits)) // 2, bits, scale, offset)

    @property
    def code_bits(self) -> int:
        return min(self.bits, _CODE_BITS)

    @property
    def deepest(self) -> int:
        """The depth at which a voxel is one step wide: nodes of that depth keep all points."""
        return self.code_bits - _SPAN_BITS

    def codes(self, xyz: NDArray[np.int32], bits: int) -> Codes:
        """(N,) Morton codes of (N, 3) points, with the first ``bits`` bits of each coordinate."""
        codes = np.zeros(len(xyz), dtype=np.uint64)
        for axis in range(3):
            place = (xyz[:, axis] - self.corner[axis]) >> (self.bits - bits)
            codes |= _spread_bits(place.astype(np.uint64)) << np.uint64(axis)
        return codes

    def metres(self, steps: IntArray) -> List[float]:
        """Coordinates of a place that is given in steps, free of the noise of binary fractions."""
        return [round(float(offset) + int(step) * self.scale, 9) for step, offset in zip(steps, self.offset)]

    def name(self, xyz: NDArray[np.int32], depth: int) -> str:
        """D-X-Y-Z of the node of a depth that a point lies in."""
        place = (xyz.astype(np.int64) - self.corner) >> (self.bits - depth)
        return "-".join(map(str, (depth, *place)))


@dataclass
class _Statistics:
    """The statistics of each dimension that the schema states, colours only where the points have them."""

    low: FloatArray = field(default_factory=lambda: np.full(len(_DIMENSIONS), np.inf))
    high: FloatArray = field(default_factory=lambda: np.full(len(_DIMENSIONS), -np.inf))
    total: FloatArray = field(default_factory=lambda: np.zeros(len(_DIMENSIONS)))
    squares: FloatArray = field(default_factory=lambda: np.zeros(len(_DIMENSIONS)))
    count: int = 0

    def add(self, points: Points, cube: _Cube) -> None:
        """Sums are relative to the cube's corner: sums of whole coordinates would lose small differences."""
        columns = [(points["xyz"][:, axis] - cube.corner[axis]) * cube.scale for axis in range(3)]
        columns += [points["intensity"].astype(np.float64)]
        if points.dtype == _COLOURED:
            columns += list(points["colour"].T.astype(np.float64))
        for axis, values in enumerate(columns):
            self.low[axis], self.high[axis] = min(self.low[axis], values.min()), max(self.high[axis], values.max())
            self.total[axis] += values.sum()
            self.squares[axis] += (values * values).sum()
        self.count += len(points)

    def schema(self, cube: _Cube) -> List[Dict[str, object]]:
        corner = [*cube.metres(cube.corner), 0.0, 0.0, 0.0, 0.0]
        mean = self.total / self.count
        variance = np.maximum(self.squares / self.count - mean * mean, 0.0)
        dimensions: List[Dict[str, object]] = []
        for axis, name in enumerate(_DIMENSIONS):
            if not np.isfinite(self.low[axis]):
                continue
            entry: Dict[str, object] = {"name": name, "type": "unsigned", "size": 2}
            if name in "XYZ":
                entry.update({"type": "signed", "size": 4, "scale": cube.scale, "offset": float(cube.offset[axis])})
            ends = {"minimum": self.low[axis], "maximum": self.high[axis], "mean": mean[axis]}
            entry["count"] = self.count
            entry.update({key: round(corner[axis] + value, 6) for key, value in ends.items()})
            entry.update(stddev=round(float(np.sqrt(variance[axis])), 6), variance=round(float(variance[axis]), 6))
            dimensions.append(entry)
        return dimensions


@dataclass(frozen=True)
class EptFacts:
    """A written EPT; ``height_range`` has 2 to 98 % of an even sample of the points, m."""

    points: int
    nodes: int
    height_range: Tuple[float, float]


def make(finished: FinishedDsm, folder: str, progress: Progress) -> Optional[str]:
    """The points of a finished DSM as EPT; gives its ``ept.json``, None where no point lies on the DSM."""
    if finished.cloud is None:
        progress.warn("No matched point lies on the DSM: the EPT is not written.")
        return None
    tree = write_ept(finished.cloud, folder, finished.crs, progress, parameters=finished.parameters.ept)
    progress.info(f"EPT of {tree.points} points in {tree.nodes} nodes.")
    return f"{folder}/ept.json"


def write_ept(
    cloud: str, folder: str, crs: str, progress: Optional[Progress] = None, parameters: EptParameters = SOLIDS.ept
) -> EptFacts:
    """Write the points of a LAS or LAZ file as EPT: a folder with ``ept.json``, completely or not at all.

    ``cloud`` has one scale for all axes, as :func:`~.point_cloud.created_cloud` writes; ``crs`` may be compound. Memory
    does not grow with the cloud. An older EPT of that name is replaced. Raises WorkspaceError for a folder that cannot
    be written or has other files, MissingPackageError without laspy, EmptyResultError for a cloud without points.
    """
    laspy = required_laspy("EPT")
    progress = progress or Silent()
    require_ept_place(folder)
    with laspy.open(cloud, laz_backend=laz_backend(laspy)) as reader:
        header = reader.header
        if not header.point_count:
            raise EmptyResultError(f"The cloud '{cloud}' has no points: there is nothing to write into '{folder}'.")
        corners = np.array([header.mins, header.maxs])
        ends = np.rint((corners - header.offsets) / header.scales).astype(np.int64)
        cube = _Cube.around(ends[0], ends[1], float(header.scales[0]), np.asarray(header.offsets, dtype=np.float64))
        with whole_folder(folder) as whole:
            kind = _COLOURED if "red" in header.point_format.dimension_names else _RECORD
            tree = _Tree(cube, kind, whole, progress, parameters)
            tree.partition(_chunks(reader, kind, parameters.chunk), header.point_count)
            tree.build()
            return tree.describe(crs, ends)


def require_ept_place(path: str) -> None:
    """Check that a folder that an EPT replaces holds nothing else; raises WorkspaceError."""
    folder = Path(path)
    others = foreign_entries(folder, _ENTRIES.__contains__)
    if others:
        reason = f"holds '{others[0]}', which does not belong to an EPT and would be lost"
        raise WorkspaceError(f"The folder '{folder}' {reason}: choose a new or empty folder for EPT.")


def _chunks(reader: Any, kind: "np.dtype[np.void]", count: int) -> Iterator[Points]:
    for points in reader.chunk_iterator(count):
        records = np.empty(len(points), kind)
        for axis, name in enumerate("XYZ"):
            records["xyz"][:, axis] = points[name]
        records["intensity"] = points["intensity"]
        if kind is _COLOURED:
            records["colour"] = np.column_stack([points[name] for name in ("red", "green", "blue")])
        yield records


class _Tree:
    """The octree while it is written: points are divided into files first, then each part is completed on its own.

    A part is all below one node and fits into memory. Voxels of the nodes above it are as large as the part, or
    smaller, down to seven levels below the root: so each part chooses its share of the upper nodes on its own, too.
    """

    def __init__(
        self, cube: _Cube, kind: "np.dtype[np.void]", folder: Path, progress: Progress, parameters: EptParameters
    ) -> None:
        self._cube, self._kind, self._folder, self._progress, self._p = cube, kind, folder, progress, parameters
        self._parts_folder = folder / "parts"
        self._parts: Dict[Node, int] = {}
        self._upper: Dict[Node, int] = {}
        self._hierarchy: Dict[str, int] = {}
        self._statistics = _Statistics()
        self._sample = np.empty(0)
        for place in (self._parts_folder, folder / "ept-data", folder / "ept-hierarchy"):
            place.mkdir()

    def partition(self, chunks: Iterable[Points], count: int) -> None:
        """Divide the points by the node they lie in, until no part is too large."""
        limit, batch = min(_SPAN_BITS, self._cube.deepest), self._p.batch
        depth = 0
        while depth < limit and count > (batch << (2 * depth)) // 4:  # a surface: four children of eight have points
            depth += 1
        self._divide(chunks, depth if count > batch else 0)
        large = [node for node, points in self._parts.items() if points > batch and node[0] < limit]
        while large:
            node = large.pop()
            path = self._path("part", node)
            del self._parts[node]
            with closing(_read_chunks(path, self._kind, self._p.chunk)) as chunks:  # Windows removes no open file
                new = self._divide(chunks, node[0] + 1)
            path.unlink()
            large += [child for child in new if self._parts[child] > batch and child[0] < limit]

    def _divide(self, chunks: Iterable[Points], depth: int) -> List[Node]:
        found = set()
        for records in chunks:
            self._progress.check_cancelled()
            codes = self._cube.codes(records["xyz"], depth)
            order = np.argsort(codes, kind="stable")
            for code, part in _runs(codes[order], records[order]):
                node = (depth, code)
                _append(self._path("part", node), part)
                self._parts[node] = self._parts.get(node, 0) + len(part)
                found.add(node)
        return sorted(found)

    def build(self) -> None:
        """Write all nodes: part by part, small neighbours together, and the nodes above them last."""
        for node, parts in _batches(self._parts, (0, 0), self._p.batch):
            self._progress.check_cancelled()
            paths = [self._path("part", part) for part in parts]
            self._finish(node[0], np.concatenate([np.fromfile(path, self._kind) for path in paths]))
            for path in paths:
                path.unlink()
        for node in sorted(self._upper):
            path = self._path("upper", node)
            self._write(node[0], np.fromfile(path, self._kind))
            path.unlink()
        self._parts_folder.rmdir()

    def _finish(self, depth: int, points: Points) -> None:
        cube = self._cube
        codes = cube.codes(points["xyz"], cube.code_bits)
        order = np.argsort(codes, kind="stable")
        points, codes = points[order], codes[order]
        self._statistics.add(points, cube)
        depths = _depths(codes, depth, cube, self._p.leaf)
        for level in range(int(depths.max()) + 1):
            here = depths == level
            places = codes[here] >> np.uint64(3 * (cube.code_bits - level))
            for code, part in _runs(places, points[here]):
                if level >= depth:
                    self._write(level, part)
                else:
                    _append(self._path("upper", (level, code)), part)
                    self._upper[level, code] = self._upper.get((level, code), 0) + len(part)

    def _write(self, depth: int, points: Points) -> None:
        name = self._cube.name(points["xyz"][0], depth)
        _write_node(str(self._folder / "ept-data" / f"{name}.laz"), points, self._cube)
        self._hierarchy[name] = len(points)
        if depth == 0:
            self._sample = points["xyz"][:, 2] * self._cube.scale + self._cube.offset[2]

    def describe(self, crs: str, ends: Sequence[IntArray]) -> EptFacts:
        """Write the hierarchy and ``ept.json``, the last file."""
        cube, points = self._cube, self._statistics.count
        counts: JsonObject = dict(sorted(self._hierarchy.items(), key=lambda item: tuple(map(int, item[0].split("-")))))
        _write_json(self._folder / "ept-hierarchy" / "0-0-0-0.json", counts)
        about: Dict[str, object] = {"version": "1.0.0", "dataType": "laszip", "hierarchyType": "json"}
        about.update(span=1 << _SPAN_BITS, points=points)
        about["bounds"] = cube.metres(cube.corner) + cube.metres(cube.corner + (1 << cube.bits))
        about["boundsConforming"] = cube.metres(ends[0]) + cube.metres(ends[1])
        about.update(schema=self._statistics.schema(cube), srs=_srs(crs))
        _write_json(self._folder / "ept.json", about)
        low, high = np.percentile(self._sample, (2, 98))
        return EptFacts(points, len(counts), (float(low), float(high)))

    def _path(self, kind: str, node: Node) -> Path:
        return self._parts_folder / f"{kind}-{node[0]}-{node[1]}"


def _batches(parts: Dict[Node, int], node: Node, most: int) -> Iterator[Tuple[Node, List[Node]]]:
    """The largest nodes whose parts together have at most so many points, in the order of their codes."""
    if sum(parts.values()) <= most or node in parts:
        yield node, sorted(parts)
        return
    for child in range(8):
        below = (node[0] + 1, (node[1] << 3) + child)
        inside = {part: count for part, count in parts.items() if part[1] >> 3 * (part[0] - below[0]) == below[1]}
        if inside:
            yield from _batches(inside, below, most)


def _depths(codes: Codes, first: int, cube: _Cube, leaf: int) -> NDArray[np.uint8]:
    """The depth of the node that keeps each point, of sorted codes of all points below a node of depth ``first``.

    Of each voxel the point in the middle of its Morton order is kept: the first would be one from its corner.
    """
    depths = np.full(len(codes), cube.deepest, dtype=np.uint8)
    rest = np.arange(len(codes))
    for depth in range(cube.deepest):
        here = codes[rest]
        starts = _starts(here >> np.uint64(3 * (cube.code_bits - depth - _SPAN_BITS)))
        taken = np.zeros(len(rest), dtype=bool)
        taken[(starts[:-1] + starts[1:]) // 2] = True
        if depth >= first:
            sizes = np.diff(_starts(here >> np.uint64(3 * (cube.code_bits - depth))))
            taken |= np.repeat(sizes <= leaf, sizes)
        depths[rest[taken]] = depth
        rest = rest[~taken]
        if not rest.size:
            break
    return depths


def _starts(values: Codes) -> IntArray:
    """Where runs of equal values begin, and the end of the last."""
    return np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1, [len(values)]])


def _runs(values: Codes, points: Points) -> Iterator[Tuple[int, Points]]:
    """Points by the value they have in common; values are sorted."""
    if len(values):
        starts = _starts(values)
        for begin, end in zip(starts[:-1], starts[1:]):
            yield int(values[begin]), points[begin:end]


def _spread_bits(bits: Codes) -> Codes:
    """Two zero bits before each of the last 21 bits."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
    return bits


def _append(path: Path, points: Points) -> None:
    with open(path, "ab") as stream:
        stream.write(points.tobytes())


def _read_chunks(path: Path, kind: "np.dtype[np.void]", count: int) -> Generator[Points, None, None]:
    with open(path, "rb") as stream:
        while len(points := np.fromfile(stream, kind, count)):
            yield points


def _write_node(path: str, points: Points, cube: _Cube) -> None:
    """LAS 1.2, point format 3: QGIS 3.22 reads no other in an EPT."""
    laspy = required_laspy("EPT")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, cube.scale), cube.offset
    header.creation_date = _ANY_DAY
    records = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
    for axis, name in enumerate("XYZ"):
        records[name] = points["xyz"][:, axis]
    records["intensity"] = points["intensity"]
    if points.dtype == _COLOURED:
        for axis, name in enumerate(("red", "green", "blue")):
            records[name] = points["colour"][:, axis]
    records["return_number"] = records["number_of_returns"] = np.ones(len(points), dtype=np.uint8)
    with laspy.open(path, mode="w", header=header, do_compress=True, laz_backend=laspy.LazBackend.Lazrs) as writer:
        writer.write_points(records)


def _write_json(path: Path, document: Dict[str, object]) -> None:
    path.write_text(json.dumps(document, indent=1, allow_nan=False), encoding="utf-8")


def _srs(crs: str) -> Dict[str, str]:
    """Codes of the horizontal and the vertical part where they have any, and WKT of the whole."""
    parsed = pyproj.CRS.from_user_input(crs)
    srs = {"wkt": parsed.to_wkt("WKT2_2019")}
    for part, name in zip(parsed.sub_crs_list or [parsed], ("horizontal", "vertical")):
        code = part.to_authority()
        if code and srs.setdefault("authority", code[0]) == code[0]:
            srs[name] = code[1]
    return srs
