"""Headers of binary PLY files: meshes, which QGIS shows, and points, which 3-D programs read.

References
----------
Turk, The PLY Polygon File Format, 1994.
"""

from __future__ import annotations

from typing import Sequence, Tuple

PLACE = ("property double x", "property double y", "property double z")
NORMAL = ("property float nx", "property float ny", "property float nz")
COLOUR = ("property uchar red", "property uchar green", "property uchar blue")

_DIGITS = 20  # of a number of elements, which may be known last


def header(wkt: str, heights: str, elements: Sequence[Tuple[str, int, Sequence[str]]]) -> bytes:
    """The header of elements: their names, numbers and lines of properties. It is as long for any numbers.

    MDAL, which reads meshes for QGIS, takes the CRS from a comment "crs: WKT". ``heights`` is what they are above.
    """
    lines = ["ply", "format binary_little_endian 1.0", f"comment crs: {wkt}"]
    lines.append(f"comment heights: metres above the {heights}")
    digits = 0
    for name, count, properties in elements:
        lines += [f"element {name} {count}", *properties]
        digits += _DIGITS - len(str(count))
    lines.insert(2, f"comment {'-' * digits}")
    return "\n".join([*lines, "end_header", ""]).encode("utf-8")
