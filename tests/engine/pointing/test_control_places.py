"""Control points of another place, in another order or far from their pixels stop the run; single ones do not."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from repm_qgis.contracts.errors import InputTableError
from repm_qgis.pointing import control_places
from repm_qgis.pointing.control_places import misplaced, placed_points, require_places
from repm_qgis.pointing.ground_control import Gcp, read_gcps
from repm_qgis.scene import Scene, View
from repm_qgis.stages import run_stage

FOUR_KM = 0.036  # degrees of latitude


@pytest.fixture
def changed(urban, tmp_path):
    """changed(change): the truth scene's points with each row (a dictionary of texts) changed; the table's path."""

    def write(change):
        with open(urban.made.gcps, newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        path = tmp_path / "gcps.csv"
        with open(path, "w", newline="", encoding="utf-8") as stream:
            table = csv.DictWriter(stream, list(rows[0]))
            table.writeheader()
            table.writerows({**row, **change(row)} for row in rows)
        return str(path)

    return write


def melbourne(row):
    return {"lon": float(row["lon"]) + 143.5, "lat": float(row["lat"]) - 81.4}


def shifted(row):
    return {"lat": float(row["lat"]) + FOUR_KM}


def swapped(row):
    return {"lon": row["lat"], "lat": row["lon"]}


def test_the_truth_scenes_own_points_are_believed(urban):
    gcps = read_gcps(urban.made.gcps, urban.views)
    placed = placed_points(gcps, urban.views)
    assert len(placed) == len(gcps) and all(point.inside and not point.is_far for point in placed)
    # The RPCs are wrong by a few px, and nothing else makes a distance.
    assert max(point.distance_m for point in placed) < np.abs(urban.biases).max() * 0.5 * 1.5 + 1.0
    require_places(gcps, urban.views, "gcps.csv")


@pytest.mark.parametrize(
    ("change", "words"),
    (
        (melbourne, (" km in the median", "check that lon and lat are degrees")),
        (shifted, ("4.0 km in the median", "4.0 km at the worst", "outside the images' footprints")),
        (swapped, ("the columns lon and lat are swapped",)),
    ),
)
@pytest.mark.long
def test_points_of_another_place_stop_every_stage_that_takes_them(urban, changed, tmp_path, told, change, words):
    path, count = changed(change), urban.record["gcp_points"]
    fitted = run_stage("epmfit", {"images": urban.images, "workspace": str(tmp_path / "fit")}, told()).scene
    jobs = {
        "pipeline": {"images": urban.images, "workspace": str(tmp_path / "w"), "output": str(tmp_path / "dsm.tif")},
        "reconstruct": {"scene": fitted, "output_scene": str(tmp_path / "r" / "r.json")},
        "checkgcps": {"scene": fitted},
    }
    for stage, options in jobs.items():
        with pytest.raises(InputTableError) as caught:
            run_stage(stage, {**options, "gcps": path}, told())
        text = str(caught.value)
        assert text.startswith(f"{count} of {count} points of '{path}' lie too far"), text
        assert "\n" not in text and text.endswith(".") and text.count(". ") == 0, text
        for word in ("at most 70 m", f"and {count} of them outside", *words):
            assert word in text, text
    assert not (tmp_path / "w" / "scene.json").exists() and not (tmp_path / "r" / "r.json").exists()


@pytest.mark.long
def test_one_wrong_point_among_good_ones_is_named_and_left_out(urban, changed, tmp_path, told):
    path, said = changed(lambda row: shifted(row) if row["id"] == "P01" else {"role": "control"}), told()
    job = {"images": urban.images, "workspace": str(tmp_path / "w"), "output": str(tmp_path / "dsm.tif")}
    result = run_stage("pipeline", {**job, "gcps": path, "resolution": 2.0}, said)
    pointing = Scene.load(result.scene).pointing
    assert pointing.rejected_gcps == ("P01",) and pointing.control_noise_px < 1.0
    assert any("The control point P01 contradicts all others" in text for text in said.warnings)


def test_points_that_are_near_but_off_are_measured_and_the_report_warns(urban, changed, tmp_path, told):
    """120 m: the points are in the images, so that somebody may want to know by how much they are off."""
    path, said = changed(lambda row: {"lat": float(row["lat"]) + 120 / 111_000}), told()
    fitted = run_stage("epmfit", {"images": urban.images, "workspace": str(tmp_path / "fit")}, told()).scene
    report = tmp_path / "report.html"
    result = run_stage("checkgcps", {"scene": fitted, "gcps": path, "report": str(report)}, said)
    assert result.components["rpc"]["north"].medae == pytest.approx(120, abs=5)
    assert any("lie too far from where the vendors' RPCs put their pixels: 12" in text for text in said.warnings)
    assert "lie too far" in report.read_text(encoding="utf-8")
    with pytest.raises(InputTableError, match="lie too far"):
        run_stage("reconstruct", {"scene": fitted, "output_scene": str(tmp_path / "r.json"), "gcps": path}, told())


@pytest.fixture
def wide(synthetic_rpc):
    """A view of 20 km a side, and points that it sees exactly."""
    view = View("wide", "wide.tif", 1, 41500, 38000, synthetic_rpc(), 0.5)
    pixels = np.random.default_rng(4).uniform(1000, 37000, (9, 2))
    ground = view.localise(pixels, 500.0)
    return view, [
        Gcp(f"P{k}", *place, "control", {"wide": pixel}) for k, (place, pixel) in enumerate(zip(ground, pixels))
    ]


def test_swapped_columns_of_pixels_are_told(wide):
    view, gcps = wide
    assert misplaced(gcps, [view], "t.csv") == ""
    text = misplaced([replace(gcp, pixels={"wide": gcp.pixels["wide"][::-1]}) for gcp in gcps], [view], "t.csv")
    assert "the columns col and row are swapped, so exchange their names in the table" in text


@pytest.mark.parametrize(
    ("count", "far", "stops"), ((1, 1, True), (2, 1, True), (3, 1, False), (5, 2, False), (5, 3, True))
)
def test_as_many_may_be_wrong_as_the_others_can_accuse(wide, count, far, stops):
    view, gcps = wide
    moved = [replace(gcp, lat=gcp.lat + FOUR_KM) if k < far else gcp for k, gcp in enumerate(gcps[:count])]
    assert bool(misplaced(moved, [view], "t.csv")) is stops


@pytest.mark.parametrize(
    ("accuracy", "sensor", "promise"),
    ((None, "", 20.0), (None, "SPOT 6", 35.0), (26.68, "SPOT 6", 57.26)),
)
def test_points_are_believed_up_to_the_vendors_promise_and_50_m(wide, accuracy, sensor, promise):
    view, gcps = wide
    view = replace(view, sensor=sensor, rpc=replace(view.rpc, accuracy_m=accuracy))
    for metres, stops in ((promise + 49, False), (promise + 51, True)):
        moved = [replace(gcp, lat=gcp.lat + metres / 111_130) for gcp in gcps]
        assert bool(misplaced(moved, [view], "t.csv")) is stops


def test_the_vendors_figure_goes_with_the_scene(urban, tmp_path, told):
    path = Path(run_stage("epmfit", {"images": urban.images, "workspace": str(tmp_path)}, told()).scene)
    document = json.loads(path.read_text())
    assert document["views"][0]["rpc"]["accuracy_m"] is None
    document["views"][0]["rpc"]["accuracy_m"] = 2.5
    path.write_text(json.dumps(document))
    assert Scene.load(str(path)).views[0].rpc.accuracy_m == 2.5


def test_pixels_that_the_rpc_cannot_place_are_too_far(wide):
    view, gcps = wide
    lost = [replace(gcp, pixels={"wide": np.array([1e8, -1e8])}) for gcp in gcps]
    assert "farther than the RPC reaches in the median" in misplaced(lost, [view], "t.csv")


@pytest.mark.parametrize(
    ("metres", "words"),
    ((3.4, "3 m"), (999.4, "999 m"), (1000.0, "1.0 km"), (float("inf"), "farther than the RPC reaches")),
)
def test_distances_are_said_as_people_read_them(metres, words):
    assert control_places._length(metres) == words
