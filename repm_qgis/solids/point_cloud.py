"""Matched points as a LAS or LAZ file, or as PLY, which 3-D programs read that know neither."""

from __future__ import annotations

from contextlib import contextmanager
from typing import Any, BinaryIO, Iterator, Optional, Protocol, Sequence

import numpy as np
import pyproj

from ..contracts.arrays import FloatArray
from ..contracts.file_kinds import is_ply
from ..contracts.options import require_cloud
from ..files.las import laz_backend, required_laspy
from ..geometry.vertical import ELLIPSOID
from ..runtime.workspace import whole_file
from . import ply
from .painting import Colours

_NORMALS = ("NormalX", "NormalY", "NormalZ")  # as CloudCompare and PDAL name a LAS file's extra bytes
_NORMAL_STEPS = 256  # of normals in LAS: 0.2 degrees; finer ones are noise that LAZ cannot compress


class PointCloudWriter:
    """Writes points in parts; :func:`created_cloud` opens and closes it."""

    def __init__(self, file: _File) -> None:
        self._file, self.count = file, 0

    def write(
        self,
        x: FloatArray,
        y: FloatArray,
        height: FloatArray,
        score: FloatArray,
        colours: Optional[Colours] = None,
        normals: Optional[FloatArray] = None,
    ) -> None:
        """(N,) coordinates in the cloud's CRS, heights in metres, and scores 0..1.

        ``colours`` (N, 3) and unit ``normals`` (N, 3) where the cloud was created for them.
        """
        if len(x):
            self._file.write(np.column_stack([x, y, height]), np.clip(np.nan_to_num(score), 0, 1), colours, normals)
            self.count += len(x)


@contextmanager
def created_cloud(
    path: str,
    crs: str,
    origin: Sequence[float],
    coloured: bool = False,
    normals: bool = False,
    heights: str = ELLIPSOID,
) -> Iterator[PointCloudWriter]:
    """A LAS 1.4, LAZ or PLY file, by extension, to fill in parts: it gets its name if the block ends without error.

    LAS: format 6, or 7 where the points are ``coloured``; coordinates to the millimetre, relative to ``origin`` (x, y,
    height); scores as intensities 0..65535; ``normals`` as extra bytes. PLY: coordinates in double precision, colours
    of 8 bits, and scores 0..1; ``heights`` names their datum. Raises OptionError for another extension,
    MissingPackageError without laspy for LAS, WorkspaceError where the file cannot be written.
    """
    require_cloud(path)
    if is_ply(path):
        with whole_file(path) as temporary, open(temporary, "wb") as stream:
            file = _Ply(stream, crs, heights, coloured, normals)
            writer = PointCloudWriter(file)
            yield writer
            file.finish(writer.count)
        return
    laspy = required_laspy("CLOUD")
    header = laspy.LasHeader(point_format=7 if coloured else 6, version="1.4")
    header.scales = np.array([0.001, 0.001, 0.001])
    header.offsets = np.floor(np.asarray(origin, dtype=np.float64))
    header.add_crs(pyproj.CRS.from_user_input(crs))
    if normals:
        header.add_extra_dims([laspy.ExtraBytesParams(name, np.float32) for name in _NORMALS])
    way = {"mode": "w", "header": header, "laz_backend": laz_backend(laspy)}
    with whole_file(path) as temporary, laspy.open(temporary, **way) as las:
        yield PointCloudWriter(_Las(las, header))


class _File(Protocol):
    def write(
        self, xyz: FloatArray, score: FloatArray, colours: Optional[Colours], normals: Optional[FloatArray]
    ) -> None:
        """Points (N, 3) and scores (N,) 0..1."""


class _Las:
    def __init__(self, writer: Any, header: Any) -> None:
        self._writer, self._header = writer, header

    def write(
        self, xyz: FloatArray, score: FloatArray, colours: Optional[Colours], normals: Optional[FloatArray]
    ) -> None:
        points = required_laspy("CLOUD").ScaleAwarePointRecord.zeros(len(xyz), header=self._header)
        points.x, points.y, points.z = xyz.T
        points.intensity = (score * 65535).astype(np.uint16)
        if colours is not None:
            points.red, points.green, points.blue = colours.T
        if normals is not None:
            for name, values in zip(_NORMALS, np.rint(normals.T * _NORMAL_STEPS) / _NORMAL_STEPS):
                points[name] = values.astype(np.float32)
        self._writer.write_points(points)


class _Ply:
    def __init__(self, stream: BinaryIO, crs: str, heights: str, coloured: bool, normals: bool) -> None:
        self._stream, self._crs, self._heights = stream, crs, heights
        self._properties = [*ply.PLACE, *(ply.NORMAL if normals else ()), *(ply.COLOUR if coloured else ())]
        self._properties.append("property float score")
        fields = [("place", "<f8", 3), ("normal", "<f4", 3), ("colour", "u1", 3), ("score", "<f4")]
        there = {"place", "score", *(("normal",) if normals else ()), *(("colour",) if coloured else ())}
        self._record = np.dtype([field for field in fields if field[0] in there])
        stream.write(self._header(0))

    def _header(self, count: int) -> bytes:
        return ply.header(self._crs, self._heights, [("vertex", count, self._properties)])

    def write(
        self, xyz: FloatArray, score: FloatArray, colours: Optional[Colours], normals: Optional[FloatArray]
    ) -> None:
        records = np.empty(len(xyz), self._record)
        records["place"], records["score"] = xyz, score
        if colours is not None:
            records["colour"] = colours >> 8
        if normals is not None:
            records["normal"] = normals
        self._stream.write(records.tobytes())

    def finish(self, count: int) -> None:
        """Write the header again, with the number of points."""
        self._stream.seek(0)
        self._stream.write(self._header(count))
