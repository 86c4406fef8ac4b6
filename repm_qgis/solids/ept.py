"""Point clouds as Entwine Point Tiles (EPT), which every QGIS shows; LAS and LAZ need one that is built with PDAL.

The octree (:mod:`.octree`) counts in the cloud's own steps (millimetres) and CRS: no point is rounded again, and the
same cloud gives the same files.

References
----------
Entwine Point Tile specification 1.0.0, entwine.io.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np
import pyproj

from ..contracts.arrays import FloatArray, IntArray
from ..contracts.documents import JsonObject
from ..contracts.errors import EmptyResultError
from ..contracts.findings import Finding
from ..files.las import laz_backend, required_laspy
from ..runtime.progress import Progress, Silent
from ..runtime.workspace import require_no_strangers, whole_folder
from .derived import FinishedDsm
from .octree import COLOURED, RECORD, SPAN_BITS, Cube, Octree, Place, Points
from .parameters import SOLIDS, EptParameters

_ANY_DAY = date(1970, 1, 1)
"""The day in each node's header: the same cloud gives the same bytes tomorrow, and laspy writes today for none."""
_ENTRIES = ("ept.json", "ept.qml", "ept-data", "ept-hierarchy")
_DIMENSIONS = ("X", "Y", "Z", "Intensity", "Red", "Green", "Blue")


@dataclass
class _Statistics:
    """The statistics of each dimension that the schema states, colours only where the points have them."""

    low: FloatArray = field(default_factory=lambda: np.full(len(_DIMENSIONS), np.inf))
    high: FloatArray = field(default_factory=lambda: np.full(len(_DIMENSIONS), -np.inf))
    total: FloatArray = field(default_factory=lambda: np.zeros(len(_DIMENSIONS)))
    squares: FloatArray = field(default_factory=lambda: np.zeros(len(_DIMENSIONS)))
    count: int = 0

    def add(self, points: Points, cube: Cube) -> None:
        """Sums are relative to the cube's corner: sums of whole coordinates would lose small differences."""
        columns = [(points["xyz"][:, axis] - cube.corner[axis]) * cube.scale for axis in range(3)]
        columns += [points["intensity"].astype(np.float64)]
        if points.dtype == COLOURED:
            columns += list(points["colour"].T.astype(np.float64))
        for axis, values in enumerate(columns):
            self.low[axis], self.high[axis] = min(self.low[axis], values.min()), max(self.high[axis], values.max())
            self.total[axis] += values.sum()
            self.squares[axis] += (values * values).sum()
        self.count += len(points)

    def schema(self, cube: Cube) -> List[Dict[str, object]]:
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
        progress.warn(Finding("no-matched-point", "No matched point lies on the DSM: the EPT is not written."))
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
        cube = Cube.around(ends[0], ends[1], float(header.scales[0]), np.asarray(header.offsets, dtype=np.float64))
        with whole_folder(folder) as whole:
            kind = COLOURED if "red" in header.point_format.dimension_names else RECORD
            files = _Files(cube, whole)
            tree = Octree(cube, kind, whole, files.write, progress=progress, parameters=parameters)
            tree.partition(_chunks(reader, kind, parameters.chunk), header.point_count)
            tree.build()
            return files.describe(crs, ends)


def require_ept_place(path: str) -> None:
    """Check that a folder that an EPT replaces holds nothing else; raises WorkspaceError."""
    require_no_strangers(Path(path), _ENTRIES.__contains__, "does not belong to an EPT", option="EPT")


def _chunks(reader: Any, kind: "np.dtype[np.void]", count: int) -> Iterator[Points]:
    for points in reader.chunk_iterator(count):
        records = np.empty(len(points), kind)
        for axis, name in enumerate("XYZ"):
            records["xyz"][:, axis] = points[name]
        records["intensity"] = points["intensity"]
        if kind is COLOURED:
            records["colour"] = np.column_stack([points[name] for name in ("red", "green", "blue")])
        yield records


class _Files:
    """The nodes' files, and what ``ept.json`` says of them."""

    def __init__(self, cube: Cube, folder: Path) -> None:
        self._cube, self._folder = cube, folder
        self._hierarchy: Dict[Place, int] = {}
        self._statistics = _Statistics()
        self._sample = np.empty(0)
        for place in (folder / "ept-data", folder / "ept-hierarchy"):
            place.mkdir()

    def write(self, node: Place, points: Points) -> None:
        _write_node(str(self._folder / "ept-data" / f"{_name(node)}.laz"), points, self._cube)
        self._hierarchy[node] = len(points)
        self._statistics.add(points, self._cube)
        if node[0] == 0:
            self._sample = points["xyz"][:, 2] * self._cube.scale + self._cube.offset[2]

    def describe(self, crs: str, ends: Sequence[IntArray]) -> EptFacts:
        """Write the hierarchy and ``ept.json``, the last file."""
        cube, points = self._cube, self._statistics.count
        counts: JsonObject = {_name(node): count for node, count in sorted(self._hierarchy.items())}
        _write_json(self._folder / "ept-hierarchy" / "0-0-0-0.json", counts)
        about: Dict[str, object] = {"version": "1.0.0", "dataType": "laszip", "hierarchyType": "json"}
        about.update(span=1 << SPAN_BITS, points=points)
        about["bounds"] = cube.metres(cube.corner) + cube.metres(cube.corner + (1 << cube.bits))
        about["boundsConforming"] = cube.metres(ends[0]) + cube.metres(ends[1])
        about.update(schema=self._statistics.schema(cube), srs=_srs(crs))
        _write_json(self._folder / "ept.json", about)
        low, high = np.percentile(self._sample, (2, 98))
        return EptFacts(points, len(counts), (float(low), float(high)))


def _name(node: Place) -> str:
    """D-X-Y-Z."""
    return "-".join(map(str, node))


def _write_node(path: str, points: Points, cube: Cube) -> None:
    """LAS 1.2, point format 3: QGIS 3.22 reads no other in an EPT."""
    laspy = required_laspy("EPT")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, cube.scale), cube.offset
    header.creation_date = _ANY_DAY
    records = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
    for axis, name in enumerate("XYZ"):
        records[name] = points["xyz"][:, axis]
    records["intensity"] = points["intensity"]
    if points.dtype == COLOURED:
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
