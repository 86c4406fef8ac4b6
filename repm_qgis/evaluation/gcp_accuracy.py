"""How far ground control points are from where RPCs, corrected RPCs and a DSM put them.

Errors are east, north, up in metres, found less true; pixels are measured less projected. The columns are those of the
paper's table on ISPRS-ZY3: RPC localisation (with and without image-space compensation), and the DSM's height.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray
from osgeo import gdal
from pyproj import CRS, Transformer

from ..arrays import FloatArray
from ..geometry.frames import EnuFrame, flat_crs, vertical_part
from ..progress import counted
from ..scene import View
from ..sfm.ground_control import Gcp, intersect
from .grids import Grid, HeightWarper, metres_per_unit

COLUMNS = {
    "rpc": "RPC localisation",
    "compensated": "RPC localisation, image-space compensation",
    "scene": "The scene's pointing",
    "dsm": "The DSM's height",
}
COMPONENTS = ("east", "north", "height")

_WRONG_PX = 1.5  # from here on a control point may be wrong (shifts explain less than an adjustment), ...
_WRONG_TIMES = 4.0  # ... if it is also so many times farther off than the others scatter
_METRES_A_DEGREE = 111320.0
_GEOID_M = 10.0


@dataclass(frozen=True)
class Errors:
    """Of ``count`` points, metres: median of the absolute errors, root mean square, and largest absolute error."""

    count: int
    me: float
    rmse: float
    max: float

    @classmethod
    def of(cls, values: FloatArray) -> "Errors":
        """Of signed errors of any shape; NaN are left out, and no value at all gives NaN."""
        size = np.abs(values[np.isfinite(values)])
        if not size.size:
            return cls(0, float("nan"), float("nan"), float("nan"))
        return cls(size.size, float(np.median(size)), float(np.sqrt(np.mean(size**2))), float(size.max()))


@dataclass
class GcpAccuracy:
    """What was found at each point.

    ``errors`` has (N, 3) east, north, up by the names of :data:`COLUMNS` (NaN: not known; the DSM has up only);
    ``residuals`` by "rpc", "compensated", "scene", a mapping of views to (2,) px for each point; ``shifts`` (2,) px by
    view, from all good control points; ``wrong`` the control points that contradict the others; ``dsm_heights`` (N,)
    metres above the ellipsoid.
    """

    gcps: List[Gcp]
    errors: Dict[str, FloatArray] = field(default_factory=dict)
    residuals: Dict[str, List[Dict[str, FloatArray]]] = field(default_factory=dict)
    shifts: Dict[str, FloatArray] = field(default_factory=dict)
    wrong: Tuple[str, ...] = ()
    dsm_heights: Optional[FloatArray] = None
    warnings: List[str] = field(default_factory=list)

    def rows(self, role: str = "") -> NDArray[np.bool_]:
        """(N,) points of a role ("": all) that count: those found wrong do not."""
        return np.array([gcp.id not in self.wrong and role in ("", gcp.role) for gcp in self.gcps])

    def summary(self, column: str, component: str, role: str = "") -> Errors:
        return Errors.of(self.errors[column][self.rows(role), COMPONENTS.index(component)])


def locate(found: GcpAccuracy, views: Sequence[View]) -> None:
    """Add where the images put the points: vendors' RPCs, RPCs with a shift a view, and the views' own pointing.

    The shifts are the control points' mean residuals. No point vouches for itself: a control point is located with
    the other control points' shifts. Control points that contradict the others are named and left out.
    """
    plain = [view.with_pointing(np.eye(2, 3)) for view in views]
    found.residuals["rpc"] = [_residuals(gcp, plain) for gcp in found.gcps]
    found.errors["rpc"] = _located(found.gcps, [plain] * len(found.gcps))
    control = {
        gcp.id: residual
        for gcp, residual in zip(found.gcps, found.residuals["rpc"])
        if gcp.role == "control" and residual
    }
    found.wrong = wrong_control(control)
    good = {name: residual for name, residual in control.items() if name not in found.wrong}
    found.shifts = _shifts(good)
    for name in found.wrong:
        found.warnings.append(
            f"The control point {name} contradicts the others and is left out: check its "
            "coordinates, its height's datum, and its pixels."
        )
    if good:
        shifted = [_shifted(plain, _shifts(good, gcp.id)) for gcp in found.gcps]
        found.residuals["compensated"] = [_residuals(gcp, views) for gcp, views in zip(found.gcps, shifted)]
        found.errors["compensated"] = _located(found.gcps, shifted)
    if any(np.abs(view.pointing - np.eye(2, 3)).max() > 1e-9 for view in views):
        found.residuals["scene"] = [_residuals(gcp, views) for gcp in found.gcps]
        found.errors["scene"] = _located(found.gcps, [views] * len(found.gcps))


def wrong_control(residuals: Dict[str, Dict[str, FloatArray]]) -> Tuple[str, ...]:
    """Points whose (2,) residual lies far from the median of all, in some view; with fewer than four none is."""
    size = dict.fromkeys(residuals, 0.0)
    for view in {name for residual in residuals.values() for name in residual}:
        seen = [name for name in residuals if view in residuals[name]]
        if len(seen) < 4:
            continue
        values = np.array([residuals[name][view] for name in seen])
        for name, distance in zip(seen, np.hypot(*(values - np.median(values, axis=0)).T)):
            size[name] = max(size[name], float(distance))
    limit = max(_WRONG_PX, _WRONG_TIMES * 1.4826 * float(np.median(list(size.values()) or [0.0])))
    return tuple(name for name in residuals if size[name] > limit)


def _residuals(gcp: Gcp, views: Sequence[View]) -> Dict[str, FloatArray]:
    return {view.name: gcp.pixels[view.name] - view.project(gcp.lon_lat_h) for view in views if view.name in gcp.pixels}


def _shifts(residuals: Dict[str, Dict[str, FloatArray]], without: str = "") -> Dict[str, FloatArray]:
    """(2,) mean residual of each view over all points but one."""
    values: Dict[str, List[FloatArray]] = {}
    for name, residual in residuals.items():
        if name != without:
            for view, pixel in residual.items():
                values.setdefault(view, []).append(pixel)
    return {view: np.mean(pixels, axis=0) for view, pixels in values.items()}


def _shifted(views: Sequence[View], shifts: Dict[str, FloatArray]) -> List[View]:
    """The views that have a shift, with it."""
    return [
        view.with_pointing(np.column_stack([np.eye(2), shifts[view.name]])) for view in views if view.name in shifts
    ]


def _located(gcps: Sequence[Gcp], views: Sequence[Sequence[View]]) -> FloatArray:
    """(N, 3) east, north, up; of a point in one image only east and north, at its known height."""
    errors = np.full((len(gcps), 3), np.nan)
    for row, (gcp, seen) in enumerate(zip(gcps, views)):
        offset = intersect(gcp, seen)
        if offset is not None:
            errors[row] = offset
            continue
        for view in seen:
            if view.name in gcp.pixels:
                place = view.localise(gcp.pixels[view.name], gcp.height)
                errors[row, :2] = EnuFrame(gcp.lon, gcp.lat, gcp.height).from_geodetic(place)[:2]
    return errors


def measure_dsm(found: GcpAccuracy, dsm: gdal.Dataset, points: str) -> None:
    """Add the DSM's heights at the points (bilinear, in its own vertical datum, brought to the ellipsoid).

    ``points`` is the points' file. Where less than half of the four cells' weight has a height there is none.
    Raises ImageError where the DSM has no CRS, or PROJ lacks the grid between the vertical datums.
    """
    grid = Grid.of(dsm)
    places = np.array([(gcp.lon, gcp.lat) for gcp in found.gcps])
    # Target cells no larger than the DSM's, so that the warper's kernel is the four cells around a point.
    cell = 0.5 * min(abs(grid.transform[1]), abs(grid.transform[5])) * min(metres_per_unit(grid)) / _METRES_A_DEGREE
    low, high = places.min(axis=0) - cell, places.max(axis=0) + cell
    ellipsoid = CRS.from_epsg(4979).to_wkt()
    warper = HeightWarper(
        dsm, Grid(points, (1, 1), (low[0], high[0] - low[0], 0.0, high[1], 0.0, low[1] - high[1]), ellipsoid)
    )
    heights = [
        float(
            warper.read(Grid(points, (1, 1), (lon - cell / 2, cell, 0.0, lat + cell / 2, 0.0, -cell), ellipsoid))[0, 0]
        )
        for lon, lat in places
    ]
    found.dsm_heights = np.array(heights)
    errors = np.full((len(heights), 3), np.nan)
    errors[:, 2] = found.dsm_heights - [gcp.height for gcp in found.gcps]
    found.errors["dsm"] = errors
    found.warnings += _datum_warnings(dsm, grid, warper)
    found.warnings += _missing(found, grid, places)
    _see_geoid(found)


def _datum_warnings(dsm: gdal.Dataset, grid: Grid, warper: HeightWarper) -> List[str]:
    if vertical_part(grid.crs) is not None:
        return warper.warnings
    if "ellipsoid" in (dsm.GetMetadataItem("VERTICAL_DATUM") or "").lower():
        return []
    return [
        f"'{grid.path}' does not say its vertical datum; its heights are taken to be above the WGS 84 ellipsoid. "
        "If they are above a geoid, assign it a CRS that says so (EPSG:32631+3855, say)."
    ]


def _missing(found: GcpAccuracy, grid: Grid, places: FloatArray) -> List[str]:
    """What to say of points without a height, apart by whether the DSM covers them."""
    x, y = Transformer.from_crs("EPSG:4326", flat_crs(grid.crs), always_xy=True).transform(*places.T)
    column, row = grid.cells(np.asarray(x), np.asarray(y))
    inside = (column >= 0) & (row >= 0) & (column <= grid.size[0]) & (row <= grid.size[1])
    none = ~np.isfinite(found.dsm_heights)
    said = []
    for which, why in ((none & ~inside, "outside the DSM"), (none & inside, "where the DSM has no height")):
        names = [gcp.id for gcp, yes in zip(found.gcps, which) if yes]
        if names:
            more = f" and {len(names) - 10} more" if len(names) > 10 else ""
            said.append(
                f"{counted(len(names), 'point')} {'lies' if len(names) == 1 else 'lie'} {why} and "
                f"{'is' if len(names) == 1 else 'are'} not counted: {', '.join(names[:10])}{more}."
            )
    return said


def _see_geoid(found: GcpAccuracy) -> None:
    """All heights off by the same tens of metres are rarely an accident."""
    up = found.errors["dsm"][np.isfinite(found.errors["dsm"][:, 2]), 2]
    if len(up) >= 3:
        middle = float(np.median(up))
        if abs(middle) > max(_GEOID_M, 5 * 1.4826 * float(np.median(np.abs(up - middle)))):
            found.warnings.append(
                f"The DSM's heights differ from the points' by {middle:+.1f} m as a whole: that is "
                "usually a geoid, so check GCP_DATUM and the DSM's vertical datum."
            )
