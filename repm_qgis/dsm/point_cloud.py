"""Matched points as a LAS or LAZ file."""

from __future__ import annotations

from contextlib import contextmanager
from typing import Any, Iterator, Optional, Sequence

import numpy as np
import pyproj

from ..arrays import FloatArray
from ..errors import OptionError
from ..las import is_cloud, laz_backend, required_laspy
from ..workspace import whole_file
from .painting import Colours


class PointCloudWriter:
    """Writes points in parts; :func:`created_cloud` opens and closes it."""

    def __init__(self, writer: Any, header: Any) -> None:
        self._writer, self._header, self.count = writer, header, 0

    def write(
        self, x: FloatArray, y: FloatArray, height: FloatArray, score: FloatArray, colours: Optional[Colours] = None
    ) -> None:
        """(N,) coordinates in the cloud's CRS, heights in metres, and scores 0..1, which become intensities.

        ``colours`` (N, 3) where the cloud was created for them.
        """
        if not len(x):
            return
        points = required_laspy("CLOUD").ScaleAwarePointRecord.zeros(len(x), header=self._header)
        points.x, points.y, points.z = x, y, height
        points.intensity = np.clip(np.nan_to_num(score) * 65535, 0, 65535).astype(np.uint16)
        if colours is not None:
            points.red, points.green, points.blue = colours.T
        self._writer.write_points(points)
        self.count += len(x)


@contextmanager
def created_cloud(path: str, crs: str, origin: Sequence[float], coloured: bool = False) -> Iterator[PointCloudWriter]:
    """A LAS 1.4 (or LAZ, by extension) file to fill in parts: it gets its name only if the block ends without error.

    Points have format 6, or 7 where they are ``coloured``.
    Coordinates are stored to the millimetre, relative to ``origin`` (x, y, height). Raises OptionError for another
    extension, MissingPackageError without laspy, WorkspaceError where the file cannot be written.
    """
    if not is_cloud(path):
        raise OptionError("CLOUD", path, "must end with .laz or .las")
    laspy = required_laspy("CLOUD")
    header = laspy.LasHeader(point_format=7 if coloured else 6, version="1.4")
    header.scales = np.array([0.001, 0.001, 0.001])
    header.offsets = np.floor(np.asarray(origin, dtype=np.float64))
    header.add_crs(pyproj.CRS.from_user_input(crs))
    way = {"mode": "w", "header": header, "laz_backend": laz_backend(laspy)}
    with whole_file(path) as temporary, laspy.open(temporary, **way) as writer:
        yield PointCloudWriter(writer, header)
