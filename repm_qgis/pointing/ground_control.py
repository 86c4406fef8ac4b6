"""Ground control points: reading them, and intersecting the rays of their pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Counter, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import pyproj

from ..contracts.arrays import FloatArray
from ..contracts.errors import InputTableError
from ..contracts.findings import Finding
from ..files.tables import CsvTable, LayerTable, Limits, csv_text, number_in
from ..files.vector import file_and_layer
from ..geometry.frames import EnuFrame, install_grid, vertical_operations
from ..geometry.vertical import vertical_crs, with_wgs84
from ..runtime.progress import counted, listed
from ..runtime.workspace import write_text
from ..scene import View

ROLES = ("control", "check")
FIELDS = ("id", "lon", "lat", "height", "view", "col", "row", "role")

_LIMITS = Limits(bytes=64 << 20, rows=200_000, what="the list of ground control points")


@dataclass(frozen=True)
class Gcp:
    """A point with known longitude, latitude (degrees) and height (m above the ellipsoid), and its (2,) pixels.

    ``pixels`` has the names of views as keys. It may be empty: then the point can only check the heights of a DSM.
    ``role`` is control (the adjustment uses the point) or check (it only measures the accuracy of the result).
    """

    id: str
    lon: float
    lat: float
    height: float
    role: str
    pixels: Dict[str, FloatArray]

    @property
    def lon_lat_h(self) -> FloatArray:
        return np.array([self.lon, self.lat, self.height])

    def to_mapping(self) -> Dict[str, object]:
        """The point's members, as JSON takes them."""
        return {**vars(self), "pixels": {view: pixel.tolist() for view, pixel in sorted(self.pixels.items())}}


def read_gcps(
    path: str,
    views: Optional[Sequence[View]],
    datum: Optional[str] = None,
    warn: Callable[[Finding], None] = lambda text: None,
) -> List[Gcp]:
    """Read points from a CSV file or a file with a layer of points that OGR opens, one row for each observation.

    Fields ``id, lon, lat, height, view, col, row, role``: ``view`` is the image's file name (with or without its
    extension; empty for a point without image measurements), col and row count from the first pixel's centre (0, 0).
    A layer may have points as geometry instead of lon and lat. ``views`` None reads positions and heights only.
    ``datum`` is the vertical datum: a name of :data:`repm_qgis.geometry.vertical.DATUMS`, or any vertical CRS that PROJ
    knows; None or "" is the WGS 84 ellipsoid. Measurements in images that are not among the views are left out, and
    ``warn`` gets a sentence about them.

    Raises InputTableError with the file, the row and the wrong value, or where no measurement is left; OptionError for
    an unknown datum.
    """
    vertical = vertical_crs(datum, "GCP_DATUM")
    file, layer = file_and_layer(path)
    _LIMITS.require_size(file)
    points: Dict[str, Gcp] = {}
    aliases = [(view.name, Path(view.image).name, Path(view.image).stem) for view in views or ()]
    names = {alias: known[0] for known in aliases for alias in known}
    elsewhere: Counter[str] = Counter()
    for line, row in _rows(file, layer):
        _LIMITS.require_count(path, line)
        place = f"'{path}', row {line}"
        gcp = point_of(place, row)
        at = f"{place}: point '{gcp.id}'"
        known = points.setdefault(gcp.id, gcp)
        if np.abs(known.lon_lat_h - gcp.lon_lat_h).max() > 1e-6 or known.role != gcp.role:
            raise InputTableError(
                f"{at} has another place or role than in an earlier row; give each point one place and one role."
            )
        view = str(row.get("view") or "").strip()
        if not view or views is None:
            continue
        if view not in names:
            elsewhere[view] += 1
            continue
        pixel = np.array([_number(place, row, "col"), _number(place, row, "row")])
        if np.abs(known.pixels.setdefault(names[view], pixel) - pixel).max() > 1e-6:
            raise InputTableError(
                f"{at} has another pixel in '{view}' than in an earlier row; give each point one row for each image."
            )
    if not points:
        raise InputTableError(f"'{path}' holds no point: it needs rows with {', '.join(FIELDS)}.")
    if elsewhere:
        _measured_elsewhere(path, points.values(), elsewhere, views or (), warn)
    return _ellipsoidal(list(points.values()), vertical, path)


def _measured_elsewhere(
    path: str, points: Iterable[Gcp], elsewhere: Counter[str], views: Sequence[View], warn: Callable[[Finding], None]
) -> None:
    """Report measurements (a count for each name) in images that are not among the views; raise InputTableError where
    there are no others."""
    ours, theirs = listed([view.name for view in views]), listed(list(elsewhere))
    if not any(gcp.pixels for gcp in points):
        raise InputTableError(
            f"The points of '{path}' were measured in {theirs}, and in none of the images ({ours}): use the images' "
            "file names in its field 'view'."
        )
    count = counted(sum(elsewhere.values()), "measurement")
    text = f"{count} in images that are not used here ({theirs}); those in {ours} are used. If a name is misspelt"
    warn(Finding("points-elsewhere", f"Left out of '{path}': {text}, correct it in the field 'view'."))


def point_of(place: str, row: Mapping[str, object]) -> Gcp:
    """A point without pixels from the fields of a row; ``place`` says in messages where the row is.

    Raises InputTableError for a missing id, a wrong role, and a position that is not on the Earth.
    """
    identity = str(row.get("id") or "").strip()
    if not identity:
        raise InputTableError(f"{place}: the field 'id' is empty; name every point.")
    role = str(row.get("role") or "control").strip().lower()
    if role not in ROLES:
        text = f"the role of point '{identity}' is '{role}'; it must be control or check."
        raise InputTableError(f"{place}: {text}")
    lon, lat, height = (_number(place, row, name) for name in ("lon", "lat", "height"))
    if not (-360 <= lon <= 360 and -90 <= lat <= 90 and -12000 < height < 10000):
        raise InputTableError(
            f"{place}: point '{identity}' lies at longitude {lon:g}, latitude {lat:g}, "
            f"height {height:g} m; give degrees (WGS 84) and metres."
        )
    return Gcp(identity, lon, lat, height, role, {})


def _number(place: str, row: Mapping[str, object], name: str) -> float:
    value = row.get(name)
    number = math.nan if value is None else number_in(place, name, value)
    if not math.isfinite(number):
        raise InputTableError(f"{place}: the field '{name}' is {value!r}, which is not a number.")
    return number


def _check_fields(path: str, fields: Iterable[str], with_place: bool = False) -> None:
    needed = [name for name in ("id", "lon", "lat", "height") if not (with_place and name in ("lon", "lat"))]
    missing = [name for name in needed if name not in fields]
    if missing:
        fields_missing = f"field{'s' if len(missing) > 1 else ''} {', '.join(missing)}"
        raise InputTableError(f"'{path}' lacks the {fields_missing}; a table of points needs {', '.join(FIELDS)}.")


def _rows(path: str, name: str) -> Iterator[Tuple[int, Mapping[str, object]]]:
    """Rows of a table, with lon and lat from the points of a layer that has no such fields."""
    if Path(path).suffix.lower() in (".csv", ".txt"):
        table = CsvTable(path)
        _check_fields(path, table.fields)
        yield from table.rows()
        return
    layer = LayerTable(path, name)
    _check_fields(path, layer.fields, layer.placed)
    _LIMITS.require_count(path, layer.known_count)
    transform = pyproj.Transformer.from_crs(layer.crs, "EPSG:4326", always_xy=True) if layer.crs else None
    for line, row, place in layer.rows():
        if place is not None and ("lon" not in row or "lat" not in row):
            x, y, _ = place
            row["lon"], row["lat"] = transform.transform(x, y) if transform else (x, y)
        yield line, row


def _ellipsoidal(gcps: List[Gcp], vertical: Optional[pyproj.CRS], path: str) -> List[Gcp]:
    """The points with heights above the ellipsoid; raises InputTableError where PROJ lacks the grid."""
    if vertical is None:
        return gcps
    places = np.array([gcp.lon_lat_h for gcp in gcps])
    bounds = (*(places[:, :2].min(axis=0) - 0.01), *(places[:, :2].max(axis=0) + 0.01))
    group, missing = vertical_operations(with_wgs84(vertical), pyproj.CRS.from_user_input("EPSG:4979"), bounds)
    name = vertical.name
    if not group.transformers:
        grids = f"its grid {' or '.join(missing)} is not installed" if missing else "it knows no operation for that"
        remedy = f"{install_grid(missing)}, or give" if missing else "give"
        raise InputTableError(
            f"PROJ cannot transform the heights of '{path}' from {name} to the ellipsoid: {grids}: {remedy} "
            "ellipsoidal heights."
        )
    heights = np.asarray(group.transformers[0].transform(*places.T)[2])
    if not np.isfinite(heights).all():
        uncovered = f"PROJ's grid for {name} does not cover all points of '{path}'"
        raise InputTableError(f"{uncovered}: check their places, or give heights above the ellipsoid.")
    return [replace(gcp, height=float(height)) for gcp, height in zip(gcps, heights)]


def write_gcps(path: str, gcps: Sequence[Gcp]) -> str:
    """Write the table that :func:`read_gcps` reads, heights above the ellipsoid: one row for each point and view.

    A point that was measured in no view has one row whose view, col and row are empty. Raises WorkspaceError.
    """
    table: List[Sequence[object]] = [FIELDS]
    for gcp in gcps:
        place = [gcp.id, f"{gcp.lon:.10f}", f"{gcp.lat:.10f}", f"{gcp.height:.4f}"]
        rows = [[view, *(f"{number:.4f}" for number in pixel)] for view, pixel in gcp.pixels.items()]
        table += [[*place, *measured, gcp.role] for measured in rows or [["", "", ""]]]
    return write_text(path, csv_text(table))


def residuals(gcp: Gcp, views: Sequence[View], place: Optional[FloatArray] = None) -> Dict[str, FloatArray]:
    """(2,) px by view, measured minus projected (pointing included), where the point was measured.

    ``place`` (3,) longitude, latitude, height replaces the point's own.
    """
    ground = gcp.lon_lat_h if place is None else place
    return {view.name: gcp.pixels[view.name] - view.project(ground) for view in views if view.name in gcp.pixels}


def intersect(gcp: Gcp, views: Sequence[View]) -> Optional[FloatArray]:
    """(3,) east, north, up in metres from a point's true place to the intersection of its rays (pointing included).

    None where fewer than two views see it.
    """
    seen = [view for view in views if view.name in gcp.pixels]
    if len(seen) < 2:
        return None
    frame = EnuFrame(gcp.lon, gcp.lat, gcp.height)
    place = np.zeros(3)
    for _ in range(6):
        ground = frame.to_geodetic(place)
        moved = [frame.to_geodetic(place + delta) for delta in np.eye(3)]
        base = [view.project(ground) for view in seen]
        residual = np.concatenate([gcp.pixels[v.name] - b for v, b in zip(seen, base)])
        jacobian = np.concatenate([np.stack([v.project(m) - b for m in moved], axis=-1) for v, b in zip(seen, base)])
        step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        place = place + step
        if np.abs(step).max() < 1e-4:
            break
    return place
