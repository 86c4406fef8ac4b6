"""Ground control points against RPCs, corrected RPCs and a DSM: numbers, a point layer and a report."""

from __future__ import annotations

from typing import Dict, List, Optional, Tuple

import numpy as np
from osgeo import ogr

from ..contracts.errors import EmptyResultError
from ..contracts.findings import Finding
from ..contracts.options import CheckGcpsOptions
from ..contracts.results import CheckGcpsResult, PointErrors
from ..evaluation.gcp_accuracy import COLUMNS, COMPONENTS, GcpAccuracy, measure_dsm, measure_images
from ..files.vector import Features, file_and_layer, write_layer
from ..geometry.frames import projected_from_geodetic, utm_crs
from ..imagery.raster import opened
from ..names import scene_title, surface_title
from ..pointing.control_heights import heights_off
from ..pointing.control_places import require_places
from ..pointing.ground_control import Gcp, read_gcps
from ..reports import verdict
from ..reports.gcp_page import gcp_page
from ..reports.styles import write_style
from ..runtime.progress import Progress, Recorder, counted, warn_all
from ..scene import Scene
from .errormap import error_at

_SHORT = {"east": "e", "north": "n", "height": "h"}


def run(options: CheckGcpsOptions, progress: Progress) -> CheckGcpsResult:
    """Measure; see :mod:`repm_qgis.evaluation.gcp_accuracy` for what the errors mean.

    Raises SceneError, InputTableError, OptionError, ImageError, EmptyResultError, WorkspaceError.
    """
    scene = Scene.load(options.scene) if options.scene else None
    elsewhere: List[Finding] = []
    gcps = read_gcps(options.gcps, scene.views if scene else None, options.gcp_datum, elsewhere.append)
    found = GcpAccuracy(gcps, warnings=elsewhere)
    if scene is not None:
        progress.step(0.1, "points in the images")
        _measure_images(scene, found, options)
    progress.check_cancelled()
    if options.dsm:
        progress.step(0.4, "points on the DSM")
        with opened(options.dsm) as dsm:
            measure_dsm(found, dsm, options.gcps)
        if found.dsm_heights is None or not np.isfinite(found.dsm_heights).any():
            raise EmptyResultError(
                f"No point of '{options.gcps}' (points: {len(found.gcps)}) lies where the DSM '{options.dsm}' has a "
                "height: choose points of the same area."
            )
    run = Recorder(progress)
    warn_all(run, [*found.warnings, *verdict.of_points(found)])
    if options.output:
        _write_points(scene, found, options.output)
    if options.report:
        name = scene_title(scene, options.scene) if scene and options.scene else surface_title(str(options.dsm))
        gcp_page(found, options).of(name).write(options.report, run)
    _log_heights(found, progress)
    progress.step(1.0, "points checked")
    return _result(options, found)


def _measure_images(scene: Scene, found: GcpAccuracy, options: CheckGcpsOptions) -> None:
    if any(gcp.pixels for gcp in found.gcps):
        require_places(found.gcps, scene.views, options.gcps, warn=found.warnings.append)
        measure_images(found, scene.views)
        tied = [pair for pair in scene.pairs if pair.tied]
        off = heights_off(found.gcps, scene.views, tied, scene.pointing)
        found.warnings += [] if off is None else [off]
        if "compensated" not in found.errors:
            points = f"No point of '{file_and_layer(options.gcps)[0]}' with image measurements has the role control"
            found.warnings.append(
                Finding("no-compensation", f"{points}: there is no image-space compensation to show.")
            )
    elif not options.dsm:
        remedy = "fill the fields view, col and row, or give a DSM to check its heights"
        raise EmptyResultError(f"No point of '{options.gcps}' was measured in an image: {remedy}.")
    else:
        found.warnings.append(
            Finding(
                "points-unmeasured", f"No point of '{options.gcps}' was measured in an image: only the DSM is checked."
            )
        )


def _result(options: CheckGcpsOptions, found: GcpAccuracy) -> CheckGcpsResult:
    components: Dict[str, Dict[str, PointErrors]] = {}
    ce90: Dict[str, float] = {}
    for column in found.errors:
        for component in COMPONENTS:
            errors = found.summary(column, component)
            if errors.count:
                components.setdefault(column, {})[component] = PointErrors(
                    medae=errors.medae, rmse=errors.rmse, max=errors.max, le90=errors.le90, count=errors.count
                )
        around = found.horizontal(column)
        if around.count:
            ce90[column] = around.le90

    def heights(column: str) -> Optional[PointErrors]:
        return components.get(column, {}).get("height")

    rpc, compensated, scene, dsm = map(heights, ("rpc", "compensated", "scene", "dsm"))
    return CheckGcpsResult(
        output=options.output,
        report=options.report,
        points=len(found.gcps),
        wrong=tuple(found.wrong),
        components=components,
        rpc_medae=rpc.medae if rpc else None,
        rpc_rmse=rpc.rmse if rpc else None,
        rpc_le90=rpc.le90 if rpc else None,
        rpc_max=rpc.max if rpc else None,
        compensated_medae=compensated.medae if compensated else None,
        compensated_rmse=compensated.rmse if compensated else None,
        compensated_le90=compensated.le90 if compensated else None,
        compensated_max=compensated.max if compensated else None,
        scene_medae=scene.medae if scene else None,
        scene_rmse=scene.rmse if scene else None,
        scene_le90=scene.le90 if scene else None,
        scene_max=scene.max if scene else None,
        dsm_medae=dsm.medae if dsm else None,
        dsm_rmse=dsm.rmse if dsm else None,
        dsm_le90=dsm.le90 if dsm else None,
        dsm_max=dsm.max if dsm else None,
        rpc_ce90=ce90.get("rpc"),
        compensated_ce90=ce90.get("compensated"),
        scene_ce90=ce90.get("scene"),
    )


def _log_heights(found: GcpAccuracy, progress: Progress) -> None:
    for column in found.errors:
        errors = found.summary(column, "height")
        if errors.count:
            figures = (
                f"heights MedAE {errors.medae:.3f} m, RMSE {errors.rmse:.3f} m, LE90 {errors.le90:.3f} m, "
                f"Max {errors.max:.3f} m"
            )
            points = f"{counted(errors.count, 'point')}{_checked(found, column)}"
            progress.info(f"{COLUMNS[column]}: {figures} of {points}.")


def _checked(found: GcpAccuracy, column: str) -> str:
    """The errors of check points alone, where there are control points too: these may have been used to make the
    product."""
    check = found.summary(column, "height", "check")
    if not check.count or check.count == found.summary(column, "height").count:
        return ""
    return f" ({counted(check.count, 'check point')}: MedAE {check.medae:.3f} m, RMSE {check.rmse:.3f} m)"


def _shown(found: GcpAccuracy) -> str:
    """The column whose planimetric errors the arrows show: the best that there is."""
    return next((column for column in ("scene", "compensated", "rpc") if column in found.errors), "")


def _write_points(scene: Optional[Scene], found: GcpAccuracy, path: str) -> None:
    """The point layer: each column's errors, the image residuals, and what the style shows."""
    places = np.array([gcp.lon_lat_h for gcp in found.gcps])
    crs = scene.crs if scene is not None else utm_crs(*map(float, places[:, :2].mean(axis=0)))
    fields: Dict[str, type] = {"id": str, "role": str, "wrong": int, "height": float, "views": str, "camera_px": float}
    for column in ("rpc", "compensated", "scene"):
        fields.update({f"{column}_{_SHORT[name]}": float for name in COMPONENTS})
        fields[f"{column}_px"] = float
    fields.update(dsm_height=float, dsm_error=float, shown=str, east=float, north=float, height_error=float)

    def features() -> Features:
        for row, (x, y) in enumerate(projected_from_geodetic(crs, places)):
            point = ogr.Geometry(ogr.wkbPoint)
            point.AddPoint_2D(float(x), float(y))
            yield point, _values(found, row, _camera_px(scene, found.gcps[row], (float(x), float(y))))

    write_layer(path, crs, ogr.wkbPoint, fields, features())
    write_style("gcps", path, (0.0, _arrow_length(found)))


def _arrow_length(found: GcpAccuracy) -> float:
    """Metres for an arrow of 10 mm: a round number near the larger planimetric errors."""
    shown = _shown(found)
    lengths = np.hypot(*found.errors[shown][found.rows(), :2].T) if shown else np.empty(0)
    lengths = lengths[np.isfinite(lengths) & (lengths > 0)]
    if not lengths.size:
        return 1.0
    typical = float(np.quantile(lengths, 0.9))
    power = 10.0 ** np.floor(np.log10(typical))
    return float(next(factor * power for factor in (1, 2, 5, 10) if factor * power >= typical * 0.999))


def _camera_px(scene: Optional[Scene], gcp: Gcp, place: Tuple[float, float]) -> Optional[float]:
    """The largest equivalent error of the images' cameras at a point, px: what the error map has there, over all views.

    None where the point lies in no tile's image. ``place`` is in the scene's CRS.
    """
    if scene is None:
        return None
    errors = []
    for tile in scene.tiles:
        xmin, ymin, xmax, ymax = tile.bounds
        if not (xmin <= place[0] <= xmax and ymin <= place[1] <= ymax):
            continue
        for name in tile.views:
            view = scene.view(name)
            error, pixel = error_at(scene, view, tile, np.array([[gcp.lon, gcp.lat]]), gcp.height)
            if ((pixel > -1) & (pixel < view.size)).all():
                errors.append(float(np.hypot(*error[0])))
    return max(errors, default=None)


def _values(found: GcpAccuracy, row: int, camera_px: Optional[float]) -> List[object]:
    gcp: Gcp = found.gcps[row]
    views = ", ".join(sorted(gcp.pixels))
    values: List[object] = [gcp.id, gcp.role, int(gcp.id in found.wrong), gcp.height, views, camera_px]
    for column in ("rpc", "compensated", "scene"):
        values += [*_known(found, column, row), _pixels(found, column, row)]
    shown = _shown(found)
    east, north, up = _known(found, shown, row) if shown else (None,) * 3
    error = _known(found, "dsm", row)[2]
    if found.dsm_heights is None:
        return [*values, None, error, shown, east, north, up]
    return [*values, _number(found.dsm_heights[row]), error, shown, east, north, error]


def _known(found: GcpAccuracy, column: str, row: int) -> Tuple[Optional[float], ...]:
    if column not in found.errors:
        return (None,) * 3
    return tuple(_number(value) for value in found.errors[column][row])


def _pixels(found: GcpAccuracy, column: str, row: int) -> Optional[float]:
    """Root mean square distance of a point's residuals over the images, px."""
    residuals = list(found.residuals[column][row].values()) if column in found.residuals else []
    return float(np.sqrt(np.mean([residual @ residual for residual in residuals]))) if residuals else None


def _number(value: float) -> Optional[float]:
    return float(value) if np.isfinite(value) else None
