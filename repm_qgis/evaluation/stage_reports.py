"""What each stage's HTML report says; the page itself is made by :mod:`repm_qgis.evaluation.report`."""

from __future__ import annotations

from typing import Any, List, Mapping, Optional

import numpy as np

from ..geometry.footprints import footprint
from ..scene import Scene, View
from . import charts, pictures
from .report import Report


def add_inputs(report: Report, scene: Scene) -> None:
    """Images, area and a map of the footprints."""
    report.section("Images")
    report.table(["view", "file", "size, px", "GSD, m", "RPC heights, m"],
                 [[v.name, v.image, f"{v.width} x {v.height}", v.gsd_m, "{:.0f} to {:.0f}".format(*v.rpc.height_range)]
                  for v in scene.views])
    middle = sum(scene.altitudes) / 2
    report.svg(charts.footprints({v.name: footprint(v.localise, v.size, middle) for v in scene.views}),
               f"Footprints at {middle:.0f} m above the ellipsoid.")
    report.facts([("Coordinate reference system", scene.crs),
                  ("Altitudes", f"{scene.altitudes[0]:.0f} to {scene.altitudes[1]:.0f} m above the WGS 84 ellipsoid"),
                  ("Tiles", len(scene.tiles))])


def add_history(report: Report, scene: Scene) -> None:
    """Time, warnings and options of each stage."""
    report.section("What was done")
    report.table(["stage", "seconds", "engine", "fingerprint"],
                 [[entry["stage"], entry["seconds"], entry["engine"], entry["fingerprint"]] for entry in scene.history])
    for entry in scene.history:
        for text in entry.get("warnings", []):
            report.warning(text)
    for entry in scene.history:
        given = {k: v for k, v in entry["options"].items() if v not in (None, "", [])}
        report.table(["option", "value"], [[k, str(v)] for k, v in given.items()], f"Options of {entry['stage']}.")


def _error_row(*first: Any, error: Any) -> List[Any]:
    return [*first, error.samp_rmse, error.line_rmse, error.rmse, error.max, error.predicted]


_ERROR_HEADERS = ["Samp RMSE, px", "Line RMSE, px", "RMSE, px", "Max, px", "predicted, px"]


def fit_report(scene: Scene) -> Report:
    """Equivalent errors of the fitted cameras, measured and predicted."""
    report = Report("Equivalent pinhole cameras", f"{len(scene.views)} images, {len(scene.tiles)} tiles")
    add_inputs(report, scene)
    report.section("Equivalent error")
    report.paragraph("How far the pinhole camera's pixel of a ground point lies from the RPC's, over a grid of 25 x 25 "
                     "pixels and 11 altitudes of each tile, before any refinement. 'Predicted' is the paper's bound "
                     "|x (Z - Zmean) / Zmean| at the tile's corner.")
    rows = [_error_row(tile.id, name, error=view.error) for tile in scene.tiles for name, view in tile.views.items()]
    report.table(["tile", "view", *_ERROR_HEADERS], rows[:500])
    report.svg(charts.histogram(np.array([row[4] for row in rows]), "px", "RMSE of tiles and views"),
               "Distribution over tiles and views.")
    add_history(report, scene)
    return report


def refine_report(scene: Scene) -> Report:
    """Equivalent errors before and after refinement."""
    report = Report("Refined images", f"model: {scene.refinement}")
    report.section("Equivalent error after refinement")
    rows = []
    for tile in scene.tiles:
        for name, view in tile.views.items():
            rows.append([tile.id, name, view.error.rmse, view.error.max, view.refined.error.samp_rmse,
                         view.refined.error.line_rmse, view.refined.error.rmse, view.refined.error.max])
    report.table(["tile", "view", "RMSE before, px", "Max before, px", "Samp RMSE, px", "Line RMSE, px", "RMSE, px",
                  "Max, px"], rows[:500])
    add_history(report, scene)
    return report


def reconstruct_report(scene: Scene) -> Report:
    """Tie points, relative pointing and height maps."""
    report = Report("Reconstruction", f"{len(scene.views)} images, {len(scene.tiles)} tiles")
    add_reconstruction(report, scene)
    add_history(report, scene)
    return report


def add_reconstruction(report: Report, scene: Scene) -> None:
    """Pairs, ties and what was matched, as sections of a report."""
    facts = scene.facts("reconstruct")
    report.section("Pairs and tie points")
    ties = {tuple(entry["pair"]): entry for entry in facts["ties"]["pairs"]}
    report.table(
        ["first", "second", "convergence, degrees", "B/H", "ties", "rows apart before, px", "spread, px"],
        [[p["first"], p["second"], p["angle_deg"], p["base_to_height"], ties[p["first"], p["second"]]["count"],
          ties[p["first"], p["second"]]["rows_before_px"], ties[p["first"], p["second"]]["rows_spread_px"]]
         for p in facts["pairs"]],
        "'Rows apart' is by how much the vendors' RPCs disagree across the parallax.")
    report.table(["view", "column shift, px", "row shift, px"],
                 [[name, *shift] for name, shift in facts["ties"]["shifts_px"].items()],
                 "Relative pointing: corrections of the vendors' RPCs. They sum to zero: without ground control points "
                 "the position and height of the whole stay where the vendors put them, which may be metres off.")
    report.facts([("Tie points", facts["ties"]["count"]), ("Median residual before, px", facts["ties"]["before_px"]),
                  ("Median residual after, px", facts["ties"]["after_px"]), ("Matcher", facts["backend"])])
    report.section("Height maps")
    report.table(["tile", "first", "second", "size, px", "heights, %", "m of height a px", "rows left, px"],
                 [[tile.id, *record["pair"], "{} x {}".format(*record["size"]),
                   100.0 * record["valid"] / (record["size"][0] * record["size"][1]), record["metres_per_px"],
                   record["row_px"]] for tile in scene.tiles for record in tile.heights][:500])


def errormap_report(scene: Scene, view: View, path: str, facts: Mapping[str, float]) -> Report:
    """An error map's picture and figures."""
    report = Report("Equivalent error on the ground", f"{view.name} at {facts['altitude']:.0f} m above the ellipsoid")
    report.facts([("Refinement", scene.refinement or "uncorrected"), ("RMSE, px", facts["rmse"]),
                  ("Max, px", facts["max_error"])])
    values, _ = pictures.preview(path, 900)
    report.png(pictures.png_bytes(pictures.colour_map(values, 0.0, max(facts["max_error"], 1e-6), "viridis")),
               f"Magnitude of the equivalent error, dark 0 to bright {facts['max_error']:.3f} px.")
    report.svg(charts.histogram(values[np.isfinite(values)], "px", "Magnitude of the equivalent error"),
               "Distribution.")
    return report


def pipeline_report(scene: Scene, products: Mapping[str, Any], seconds: Mapping[str, float],
                    command: Optional[str]) -> Report:
    """The whole run on one page: inputs, geometry, ties, surface, and the command that repeats it."""
    report = Report("Surface model from satellite images", str(products["output"]))
    values, cell = pictures.preview(products["output"], 1200)
    report.png(pictures.png_bytes(pictures.shaded_relief(values, cell)), "The DSM, shaded from the north-west.")
    report.facts([("Cells", products["cells"]), ("Cell size, m", products["resolution"]),
                  ("Cells with a height, %", products["valid_percent"]), ("CRS", products["crs"]),
                  ("Heights", "metres above the WGS 84 ellipsoid")])
    report.table(["stage", "seconds"], [[name, value] for name, value in seconds.items()], "Wall time of this run.")
    add_inputs(report, scene)
    rows = [[tile.id, name, view.error.rmse, view.error.max, view.refined.error.rmse, view.refined.error.max]
            for tile in scene.tiles for name, view in tile.views.items() if view.refined]
    report.section("Equivalent error")
    report.table(["tile", "view", "RMSE before, px", "Max before, px", f"RMSE {scene.refinement}, px", "Max, px"],
                 rows[:200])
    add_reconstruction(report, scene)
    if command:
        report.section("Repeat this run")
        report.command(command)
    add_history(report, scene)
    return report
