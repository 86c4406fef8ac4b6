"""Headers of binary PLY files: meshes, which QGIS shows, and points, which 3-D programs read.

References
----------
Turk, The PLY Polygon File Format, 1994.
"""

from __future__ import annotations

from typing import Sequence, Tuple

from osgeo import osr

PLACE = ("property double x", "property double y", "property double z")
NORMAL = ("property float nx", "property float ny", "property float nz")
COLOUR = ("property uchar red", "property uchar green", "property uchar blue")

_DIGITS = 20  # of a number of elements, which may be known last
_LONGEST = 1000  # bytes of a line: CloudCompare 2.11 ends at 1024


def header(crs: str, heights: str, elements: Sequence[Tuple[str, int, Sequence[str]]]) -> bytes:
    """The header of elements: their names, numbers and lines of properties. It is as long for any numbers.

    MDAL, which reads meshes for QGIS, takes the CRS from a comment "crs: WKT". ``heights`` names their datum.
    """
    lines = ["ply", "format binary_little_endian 1.0", f"comment crs: {_wkt(crs)}"]
    lines.append(f"comment heights: metres above the {heights}")
    digits = 0
    for name, count, properties in elements:
        lines += [f"element {name} {count}", *properties]
        digits += _DIGITS - len(str(count))
    lines.insert(2, f"comment {'-' * digits}")
    return "\n".join([*lines, "end_header", ""]).encode("utf-8")


def _wkt(crs: str) -> str:
    """The CRS as GDAL's WKT, without its vertical part where that is too long for a line; the heights have their own.

    WKT of 2019 is longer in any case: it names the area of use and the members of the datum.
    """
    whole = osr.SpatialReference()
    whole.SetFromUserInput(crs)
    wkt = str(whole.ExportToWkt())
    if len(wkt.encode("utf-8")) > _LONGEST and whole.IsCompound():
        whole.StripVertical()
        wkt = str(whole.ExportToWkt())
    return wkt
