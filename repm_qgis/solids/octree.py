"""Points that need not fit into memory, as an octree with levels of detail: for tiles of a point cloud.

A node keeps one point of each of its 128 x 128 x 128 voxels and passes the rest to its eight children; a node with few
points keeps them all. So every point is in exactly one node, and the upper nodes are an even sample of everything
below.

The cube's side is a power of two of the points' own steps, and all coordinates are whole numbers: no point is rounded
again, and the same points give the same nodes.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, Generator, Iterable, Iterator, List, Tuple

import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import AnyArray, FloatArray, IntArray
from ..runtime.progress import Progress
from .parameters import EptParameters

Points = AnyArray
"""Records of the type :data:`RECORD` or :data:`COLOURED`."""
Codes = NDArray[np.uint64]
"""Morton codes."""
Node = Tuple[int, int]
"""Depth, and the Morton code of the node's place among all of that depth."""
Place = Tuple[int, int, int, int]
"""Depth, and the node's place among all of that depth along x, y and z."""

SPAN_BITS = 7  # 128 voxels a side of a node
_CODE_BITS = 21  # a side, of a Morton code of 63 bits: 14 levels of nodes
RECORD = np.dtype([("xyz", "<i4", 3), ("intensity", "<u2")])
COLOURED = np.dtype([*RECORD.descr, ("colour", "<u2", 3)])


@dataclass(frozen=True)
class Cube:
    """The root node: ``corner`` (3,) in the points' steps, and a side of ``2 ** bits`` steps of ``scale`` metres."""

    corner: IntArray
    bits: int
    scale: float
    offset: FloatArray

    @classmethod
    def around(cls, low: IntArray, high: IntArray, scale: float, offset: FloatArray) -> Cube:
        bits = max(int((high - low).max()).bit_length(), SPAN_BITS)
        return cls((low + high + 1 - (1 << bits)) // 2, bits, scale, offset)

    @property
    def code_bits(self) -> int:
        return min(self.bits, _CODE_BITS)

    @property
    def deepest(self) -> int:
        """The depth at which a voxel is one step wide: nodes of that depth keep all points."""
        return self.code_bits - SPAN_BITS

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

    def node(self, xyz: NDArray[np.int32], depth: int) -> Place:
        """The node of a depth that a point lies in."""
        x, y, z = map(int, (xyz.astype(np.int64) - self.corner) >> (self.bits - depth))
        return depth, x, y, z


class Octree:
    """The octree while it is made: points are divided into files first, then each part is completed on its own.

    A part is all below one node and fits into memory. Voxels of the nodes above it are as large as the part, or
    smaller, down to seven levels below the root: so each part chooses its share of the upper nodes on its own, too.
    """

    def __init__(
        self,
        cube: Cube,
        kind: "np.dtype[np.void]",
        folder: Path,
        write: Callable[[Place, Points], None],
        *,
        progress: Progress,
        parameters: EptParameters,
    ) -> None:
        """Parts are in ``folder`` / "parts" until they are done; ``write`` takes each node with its points."""
        self._cube, self._kind, self._write_node, self._progress, self._p = cube, kind, write, progress, parameters
        self._parts_folder = folder / "parts"
        self._parts: Dict[Node, int] = {}
        self._upper: Dict[Node, int] = {}
        self._parts_folder.mkdir()

    def partition(self, chunks: Iterable[Points], count: int) -> None:
        """Divide the points by the node they lie in, until no part is too large."""
        limit, batch = min(SPAN_BITS, self._cube.deepest), self._p.batch
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
        self._write_node(self._cube.node(points["xyz"][0], depth), points)

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


def _depths(codes: Codes, first: int, cube: Cube, leaf: int) -> NDArray[np.uint8]:
    """The depth of the node that keeps each point, of sorted codes of all points below a node of depth ``first``.

    Of each voxel the point in the middle of its Morton order is kept: the first would be one from its corner.
    """
    depths = np.full(len(codes), cube.deepest, dtype=np.uint8)
    rest = np.arange(len(codes))
    for depth in range(cube.deepest):
        here = codes[rest]
        starts = _starts(here >> np.uint64(3 * (cube.code_bits - depth - SPAN_BITS)))
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
