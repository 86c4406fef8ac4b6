"""The dock that measures control points, driven by mouse and keys in the desktop itself (Xvfb)."""

from __future__ import annotations

import csv
import io
import shutil

import numpy as np
import pytest

from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.pointing.ground_control import read_gcps
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import load_views
from repm_qgis.stages import run_stage

pytestmark = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


@pytest.mark.slow
def test_points_are_measured_by_mouse_and_keys_and_taken_by_gcps(desktop_start, town, tmp_path):
    views = load_views(town.images)
    known = [gcp for gcp in read_gcps(town.gcps, views) if len(gcp.pixels) == 3]
    places = tmp_path / "places.csv"  # without pixels
    lines = [f"{gcp.id},{gcp.lon!r},{gcp.lat!r},{gcp.height!r},{gcp.role}" for gcp in known]
    places.write_text("\n".join(["id,lon,lat,height,role", *lines]))
    pixels = {gcp.id: {view: list(pixel) for view, pixel in gcp.pixels.items()} for gcp in known}
    elsewhere = tmp_path / "elsewhere.csv"
    elsewhere.write_text("id,lon,lat,height,view,col,row\nA,1.44,43.6,190,img_01,9,9\nA,1.44,43.6,190,img_09,9,9\n")
    plan = {"made": vars(town), "points": str(places), "pixels": pixels, "elsewhere": str(elsewhere)}
    plan["one"] = str(tmp_path / "one.csv")
    found = desktop_start("drive_control_points.py", plan)
    assert found["first words"].startswith("Choose the images")
    assert "1 measurement in images that are not used here (img_09)" in found["elsewhere"]
    before, after, beside = found["one image"]
    of_two = {gcp.id: gcp.pixels["img_01"] for gcp in read_gcps(plan["one"], views[:1]) if gcp.pixels}
    assert sorted(of_two) == sorted(gcp.id for gcp in known[:2])
    off = known[1].pixels["img_01"] - views[0].project(known[1].lon_lat_h)
    assert before == f"Point {known[0].id}: mark it in the image."
    told = f"Point {known[1].id}: the image shows it {np.hypot(*off):.2f} px from where the RPC has it"
    assert after.startswith(told)
    assert beside.startswith("from the RPC: ")
    assert found["views"] == ["img_01", "img_02", "img_03"] and found["points"] == len(known)
    first, second = known[:2]
    for view, pixel in found["clicked"].items():
        assert np.abs(np.array(pixel) - first.pixels[view]).max() <= 0.5 / 4 + 1e-9  # a screen px is a quarter px
    assert len(found["clicked"]) == 3
    np.testing.assert_allclose(found["nudged"], [0.1, -1.0], atol=1e-9)
    np.testing.assert_allclose(found["undone"], [0, 0], atol=1e-9)
    assert not found["deleted"] and found["skipped"] == "not visible here"
    assert found["summary"].startswith(f"Point {first.id}: the images see it")
    assert 0.1 < np.linalg.norm(found["offset"]) < 20  # the sample's RPCs are wrong by some pixels
    assert found["zoom"] == 2.0
    np.testing.assert_allclose(found["zoom keeps"], [0, 0], atol=1e-9)
    assert found["next"] == second.id
    assert found["tool"]
    name, lon, lat, height = found["new"]
    assert name not in pixels
    check_height(town, lon, lat, height)
    assert "not saved" in found["title"] and "measured.csv" in found["title saved"] and "*" not in found["title saved"]
    assert found["renamed"] == "roof" and not found["refused"] and "'lat' is 'north'" in found["why"]
    assert found["saved"] and "roof" not in found["file"]  # the later removal was written at once
    rows = list(csv.DictReader(io.StringIO(found["file"])))
    assert sum(bool(row["view"]) for row in rows) == 3 * len(known)
    assert all(views == found["views"] for views in found["again"].values()) and first.id in found["again"]
    assert not found["left"]
    # Reconstruction takes what was saved: the position becomes absolute.
    measured = tmp_path / "measured.csv"
    measured.write_text(found["file"])
    options = {"images": town.images, "workspace": str(tmp_path / "work"), "gcps": str(measured)}
    made = run_stage("pipeline", {**options, "output": str(tmp_path / "dsm.tif")}, Silent())
    judged = run_stage("checkgcps", {"gcps": town.gcps, "scene": made.scene}, Silent()).components
    for component in ("east", "north"):
        assert judged["scene"][component].rmse < 0.25 * judged["rpc"][component].rmse


def check_height(town, lon, lat, height):
    """The height of a new point is that of the layer that was chosen for it."""
    from osgeo import gdal

    from repm_qgis.geometry.frames import projected_from_geodetic

    truth = gdal.Open(town.truth)
    crs = truth.GetProjection()
    x, y = projected_from_geodetic(crs, np.array([lon, lat]))
    left, step, _, top, _, down = truth.GetGeoTransform()
    col, row = int((x - left) / step), int((y - top) / down)
    around = truth.ReadAsArray(col - 1, row - 1, 3, 3)
    assert around.min() - 0.01 <= height <= around.max() + 0.01
    assert np.isfinite(geodetic_from_projected(crs, np.array([x, y]))).all()
