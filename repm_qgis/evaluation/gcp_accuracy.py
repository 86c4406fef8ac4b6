"""How far ground control points are from where RPCs, corrected RPCs and a DSM put them.

Errors are east, north, up in metres, found minus true; pixels are measured minus projected. The columns are those of
the paper's table on ISPRS-ZY3: RPC localisation (with and without image-space compensation), and the DSM's height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal
from pyproj import CRS, Transformer

from ..contracts.arrays import FloatArray, Mask
from ..contracts.checks import as_text
from ..contracts.findings import Finding
from ..geometry.frames import EnuFrame, flat_crs, on_earth, vertical_part
from ..geometry.height_causes import likely_cause
from ..numerics.accuracy import distances, le90
from ..numerics.robust import nmad
from ..pointing.ground_control import Gcp, intersect, residuals
from ..scene import View
from .grids import Grid, HeightWarper, cell_sides, metres_per_unit
from .parameters import GCPS, GcpParameters

COLUMNS = {
    "rpc": "RPC localisation",
    "compensated": "RPC localisation, image-space compensation",
    "scene": "The scene's pointing",
    "dsm": "The DSM's height",
}
COMPONENTS = ("east", "north", "height")

_METRES_PER_DEGREE = 111320.0


@dataclass(frozen=True)
class ErrorSummary:
    """Of ``count`` points, metres: median of the absolute errors, root mean square, largest absolute error, and the
    error that nine of ten points do not exceed (LE90 of heights, CE90 of horizontal distances)."""

    count: int
    medae: float
    rmse: float
    max: float
    le90: float

    @classmethod
    def of(cls, values: FloatArray) -> "ErrorSummary":
        """Of signed errors of any shape; NaN are left out, and no value at all gives NaN."""
        size = np.abs(values[np.isfinite(values)])
        if not size.size:
            return cls(count=0, medae=math.nan, rmse=math.nan, max=math.nan, le90=math.nan)
        return cls(
            count=size.size,
            medae=float(np.median(size)),
            rmse=float(np.sqrt(np.mean(size**2))),
            max=float(size.max()),
            le90=float(le90(size)),
        )


@dataclass
class GcpAccuracy:
    """What was found at each point.

    ``errors`` are (N, 3) east, north, up by the names of :data:`COLUMNS` (NaN: not known; a DSM has up only).
    ``residuals``, by "rpc", "compensated" and "scene", map views to (2,) px for each point. ``shifts`` are (2,) px by
    view, from all good control points. ``wrong`` names the control points that contradict the others. ``dsm_heights``
    are (N,) metres above the ellipsoid, and ``cell_m`` is the side of its cells.
    """

    gcps: List[Gcp]
    errors: Dict[str, FloatArray] = field(default_factory=dict)
    residuals: Dict[str, List[Dict[str, FloatArray]]] = field(default_factory=dict)
    shifts: Dict[str, FloatArray] = field(default_factory=dict)
    wrong: Tuple[str, ...] = ()
    dsm_heights: Optional[FloatArray] = None
    cell_m: float = 0.0
    warnings: List[Finding] = field(default_factory=list)

    def rows(self, role: str = "") -> Mask:
        """(N,) which points of a role ("": all) count: those found wrong do not."""
        return np.array([gcp.id not in self.wrong and role in ("", gcp.role) for gcp in self.gcps])

    def summary(self, column: str, component: str, role: str = "") -> ErrorSummary:
        return ErrorSummary.of(self.errors[column][self.rows(role), COMPONENTS.index(component)])

    def horizontal(self, column: str, role: str = "") -> ErrorSummary:
        """Of the horizontal distances from the true places."""
        return ErrorSummary.of(distances(self.errors[column][self.rows(role), :2]))


def measure_images(found: GcpAccuracy, views: Sequence[View], parameters: GcpParameters = GCPS) -> None:
    """Add where the images put the points: vendors' RPCs, RPCs with a shift per view, and the views' own pointing.

    The shifts are the control points' mean residuals. No point is used for its own check: a control point is located
    with the shifts of the other control points. Control points that contradict the others are named and left out.
    """
    plain = [view.with_pointing(np.eye(2, 3)) for view in views]
    found.residuals["rpc"] = [residuals(gcp, plain) for gcp in found.gcps]
    found.errors["rpc"] = _located(found.gcps, [plain] * len(found.gcps))
    seen = [(gcp, residual) for gcp, residual in zip(found.gcps, found.residuals["rpc"]) if residual]
    control = {gcp.id: residual for gcp, residual in seen if gcp.role == "control"}
    found.wrong = wrong_control(control, parameters)
    good = {name: residual for name, residual in control.items() if name not in found.wrong}
    found.shifts = _shifts(good)
    for name in found.wrong:
        found.warnings.append(
            Finding(
                "gcp-contradicts",
                f"The control point {name} contradicts the others and is left out: check its coordinates, the datum "
                "of its height, and its pixels.",
            )
        )
    if good:
        without = [_shifts(good, gcp.id) for gcp in found.gcps]
        moved = [[view for view in shifted(plain, shifts) if view.name in shifts] for shifts in without]
        found.residuals["compensated"] = [residuals(gcp, views) for gcp, views in zip(found.gcps, moved)]
        found.errors["compensated"] = _located(found.gcps, moved)
    if any(np.abs(view.pointing - np.eye(2, 3)).max() > 1e-9 or view.jitter is not None for view in views):
        found.residuals["scene"] = [residuals(gcp, views) for gcp in found.gcps]
        found.errors["scene"] = _located(found.gcps, [views] * len(found.gcps))


def wrong_control(residuals: Dict[str, Dict[str, FloatArray]], parameters: GcpParameters = GCPS) -> Tuple[str, ...]:
    """Points whose (2,) residual lies far from the median of all in some view; with fewer than four points none."""
    size = dict.fromkeys(residuals, 0.0)
    for view in {name for residual in residuals.values() for name in residual}:
        seen = [name for name in residuals if view in residuals[name]]
        if len(seen) < 4:
            continue
        values = np.array([residuals[name][view] for name in seen])
        for name, distance in zip(seen, np.hypot(*(values - np.median(values, axis=0)).T)):
            size[name] = max(size[name], float(distance))
    typical = nmad(np.array(list(size.values()) or [0.0]), 0.0)
    limit = max(parameters.wrong_px, parameters.wrong_times * typical)
    return tuple(name for name in residuals if size[name] > limit)


def _shifts(residuals: Dict[str, Dict[str, FloatArray]], without: str = "") -> Dict[str, FloatArray]:
    """(2,) mean residual of each view over all points but one."""
    values: Dict[str, List[FloatArray]] = {}
    for name, residual in residuals.items():
        if name != without:
            for view, pixel in residual.items():
                values.setdefault(view, []).append(pixel)
    return {view: np.mean(pixels, axis=0) for view, pixels in values.items()}


def shifted(views: Sequence[View], shifts: Dict[str, FloatArray]) -> List[View]:
    """The views with the shift of each, (2,) px, in the place of its pointing; those without one as they are."""

    def moved(view: View) -> View:
        shift = shifts.get(view.name)
        return view if shift is None else view.with_pointing(np.column_stack([np.eye(2), shift]))

    return list(map(moved, views))


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


def measure_dsm(found: GcpAccuracy, dsm: gdal.Dataset, points: str, parameters: GcpParameters = GCPS) -> None:
    """Add the DSM's heights at the points (bilinear, in its own vertical datum, transformed to the ellipsoid).

    ``points`` is the points' file. Where less than half of the four cells' weight has a height there is none.
    Raises ImageError where the DSM has no CRS, or PROJ lacks the grid between the vertical datums.
    """
    grid = Grid.of(dsm)
    places = np.array([(gcp.lon, gcp.lat) for gcp in found.gcps])
    # Target cells no larger than the DSM's, so that the warper's kernel is the four cells around a point.
    cell = 0.5 * min(abs(grid.transform[1]), abs(grid.transform[5])) * min(metres_per_unit(grid)) / _METRES_PER_DEGREE
    low, high = places.min(axis=0) - cell, places.max(axis=0) + cell
    ellipsoid = CRS.from_epsg(4979).to_wkt()

    def one_cell(west: float, north: float, width: float, height: float) -> Grid:
        return Grid(points, (1, 1), (west, width, 0.0, north, 0.0, -height), ellipsoid)

    warper = HeightWarper(dsm, one_cell(low[0], high[1], high[0] - low[0], high[1] - low[1]))
    parts = [one_cell(lon - cell / 2, lat + cell / 2, cell, cell) for lon, lat in places]
    heights = np.array([float(warper.read(part)[0, 0]) for part in parts])
    found.dsm_heights, found.cell_m = heights, max(cell_sides(grid))
    found.errors["dsm"] = np.full((len(heights), 3), np.nan)
    found.errors["dsm"][:, 2] = heights - [gcp.height for gcp in found.gcps]
    found.warnings += _datum_warnings(dsm, grid, warper)
    found.warnings += _missing(found, grid, places, ~np.isfinite(heights))
    found.warnings += _displaced(found, warper, points, ellipsoid, parameters)
    _warn_of_heights(found, parameters)


def _displaced(
    found: GcpAccuracy, warper: HeightWarper, points: str, ellipsoid: str, parameters: GcpParameters
) -> List[Finding]:
    """Whether the points fit to the DSM much better beside their place, up to so many steps, than chance lets as few of
    them fit somewhere."""
    known = [gcp for gcp, up in zip(found.gcps, found.errors["dsm"][:, 2]) if np.isfinite(up)]
    if len(known) < parameters.least_searched:
        return []
    step, reach, places = max(parameters.search_step_m, found.cell_m), parameters.search_steps, 0
    here, by, least = math.nan, np.zeros(2), math.inf
    for step_m, steps in ((step, reach), (step / parameters.search_finer, parameters.search_finer)):
        misfit = _misfits(known, warper, points, ellipsoid, by, step_m, steps)
        here = float(misfit[steps, steps]) if math.isnan(here) else here
        places += int(np.isfinite(misfit).sum())
        if misfit.min() < least:  # finer steps see more of the noise
            row, column = np.unravel_index(int(misfit.argmin()), misfit.shape)
            by, least = by + step_m * np.array([column - steps, steps - row]), float(misfit.min())
    gain = min(parameters.search_gain, _chance_of_median(len(known), parameters.search_chance / places))
    if here < parameters.least_misfit_m or least > gain * here or np.hypot(*by) < step:
        return []
    text = f"The points of '{points}' fit to the DSM better {np.hypot(*by):.1f} m beside their place"
    return [Finding("points-displaced", f"{text}: check the CRS and the place of both.", "doubt")]


def _misfits(
    gcps: Sequence[Gcp], warper: HeightWarper, points: str, ellipsoid: str, by: FloatArray, step_m: float, steps: int
) -> FloatArray:
    """The median distance of the errors from their median, m, with all points moved by (2,) metres to the east and
    north and by so many steps around: (2n + 1, 2n + 1), the north first; infinite where a point has no height."""
    high, side, away = step_m / _METRES_PER_DEGREE, 2 * steps + 1, []
    for gcp in gcps:
        wide = high / math.cos(math.radians(gcp.lat))
        west, north = gcp.lon + (by[0] / step_m - side / 2) * wide, gcp.lat + (by[1] / step_m + side / 2) * high
        around = Grid(points, (side, side), (west, wide, 0.0, north, 0.0, -high), ellipsoid)
        away.append(warper.read(around) - gcp.height)
    inside = np.isfinite(away).all(axis=0)  # with fewer points the misfit would be less by chance
    misfit = np.full(inside.shape, np.inf)
    heights = np.stack(away)[:, inside]
    misfit[inside] = np.median(np.abs(heights - np.median(heights, axis=0)), axis=0)  # towns have points at walls
    return misfit


def _chance_of_median(count: int, chance: float) -> float:
    """Which share of its usual size the median of so many absolute normal errors falls below with this probability."""
    from scipy.stats import beta, norm

    half = (count + 1) // 2
    return float(norm.ppf(0.5 + beta.ppf(chance, half, count - half + 1) / 2) / norm.ppf(0.75))


def _datum_warnings(dsm: gdal.Dataset, grid: Grid, warper: HeightWarper) -> List[Finding]:
    if vertical_part(grid.crs) is not None:
        return warper.warnings
    if "ellipsoid" in as_text(dsm.GetMetadataItem("VERTICAL_DATUM") or "").lower():
        return []
    return [
        Finding(
            "datum-unknown",
            f"'{grid.path}' does not state its vertical datum; its heights are assumed to be above the WGS 84 "
            "ellipsoid. If they are above a geoid, assign it a CRS that states it (for example EPSG:32631+3855).",
        )
    ]


def _missing(found: GcpAccuracy, grid: Grid, places: FloatArray, none: Mask) -> List[Finding]:
    """Warnings of points that have no height, outside the DSM and inside."""
    x, y = Transformer.from_crs("EPSG:4326", flat_crs(on_earth(grid.crs, grid.path)), always_xy=True).transform(
        *places.T
    )
    column, row = grid.to_cells(np.asarray(x), np.asarray(y))
    inside = (column >= 0) & (row >= 0) & (column <= grid.size[0]) & (row <= grid.size[1])
    warnings = []
    for which, why in ((none & ~inside, "outside the DSM"), (none & inside, "where the DSM has no height")):
        names = [gcp.id for gcp, yes in zip(found.gcps, which) if yes]
        if names:
            more = f" and {len(names) - 10} more" if len(names) > 10 else ""
            lie = "1 point lies" if len(names) == 1 else f"{len(names)} points lie"
            counted = "is not counted" if len(names) == 1 else "are not counted"
            warnings.append(
                Finding("points-without-height", f"{lie} {why} and {counted}: {', '.join(names[:10])}{more}.")
            )
    return warnings


def _warn_of_heights(found: GcpAccuracy, parameters: GcpParameters) -> None:
    """Errors of the same metres at all points are rarely an accident, where they are those of feet or of a geoid."""
    known = np.isfinite(found.errors["dsm"][:, 2])
    up = found.errors["dsm"][known, 2]
    if len(up) < 3:
        return
    middle, spread = float(np.median(up)), parameters.geoid_times * nmad(up)
    if abs(middle) <= max(parameters.least_off_m, spread):
        return
    lon, lat, height = np.median([gcp.lon_lat_h for gcp, yes in zip(found.gcps, known) if yes], axis=0)
    cause = likely_cause(middle, float(height), float(lon), float(lat), max(parameters.least_off_m / 2.0, spread))
    if cause:
        text = (
            f"The DSM's heights differ from the points' by {middle:+.1f} m as a whole, which is usually a geoid or a "
            f"unit. The points' heights would change by {cause}: check their unit, GCP_DATUM and the DSM's datum."
        )
        found.warnings.append(Finding("geoid-likely", text, "doubt"))
    elif abs(middle) > parameters.geoid_m:
        text = f"The DSM's heights differ from the points' by {middle:+.1f} m as a whole, which is usually a geoid: "
        found.warnings.append(Finding("geoid-likely", text + "check GCP_DATUM and the DSM's vertical datum."))
