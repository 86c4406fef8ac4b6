"""One image is enough for its camera, its equivalent error, its refinement and its control points; heights need two."""

from __future__ import annotations

import json

import numpy as np
import pytest

from repm_qgis.contracts.errors import OptionError, SceneError
from repm_qgis.scene import load_views
from repm_qgis.stages import run_stage
from tests.engine.gcp_tables import ground_points, write_gcps
from tests.engine.pages import plain

SENSORS = {
    "WorldView-3": "jax_068/JAX_068_001_RGB.tif",
    "Pleiades": "pleiades_pair/img_01.tif",
    "ZY-3": "whu_tlc/block0066_view0.tif",
}


@pytest.fixture(scope="module")
def scene(urban, tmp_path_factory, told):
    """Of the town's first image, whose RPC is off by a known bias."""
    folder, said = tmp_path_factory.mktemp("one"), told()
    low, high = np.nanmin(urban.surface) - 5.0, np.nanmax(urban.surface) + 5.0
    given = {"altitude_min": float(low), "altitude_max": float(high)}
    result = run_stage("epmfit", {"images": urban.images[:1], "workspace": str(folder), **given}, said)
    assert not said.warnings
    return result.scene


@pytest.fixture(scope="module")
def points(urban):
    return ground_points(urban)


@pytest.fixture(scope="module")
def gcps(urban, points, tmp_path_factory):
    """Where the true sensor sees the points."""
    path = tmp_path_factory.mktemp("points") / "gcps.csv"
    return write_gcps(path, urban, points, role=lambda number: "control", views=1)


def test_its_error_shrinks_when_it_is_refined(scene, tmp_path, told):
    folder = str(tmp_path)
    before = run_stage("errormap", {"scene": scene, "output": f"{folder}/before.tif"}, told())
    refined = run_stage("refine", {"scene": scene, "output_scene": f"{folder}/refined.json"}, told())
    after = run_stage("errormap", {"scene": refined.output_scene, "output": f"{folder}/after.tif"}, told())
    assert after.rmse < 0.5 * before.rmse
    run_stage("exportcameras", {"scene": refined.output_scene, "folder": f"{folder}/cameras"}, told())
    assert [path for path in (tmp_path / "cameras").rglob("*") if path.is_file()]
    with pytest.raises(SceneError, match="has one image.*and heights need two"):
        run_stage("reconstruct", {"scene": refined.output_scene, "output_scene": f"{folder}/r.json"}, told())
    assert not (tmp_path / "r.json").exists()


def test_control_points_correct_its_rpc(urban, scene, points, gcps, tmp_path, told):
    said, report = told(), tmp_path / "rpcs.html"
    options = {"scene": scene, "gcps": gcps, "rpc_folder": str(tmp_path / "rpcs"), "report": str(report)}
    result = run_stage("exportrpc", options, said)
    true = urban.true_views[0].project(points)
    delivered, exported = (load_views([path])[0].project(points) for path in (urban.images[0], result.images[0]))
    assert np.linalg.norm(delivered - true, axis=1).min() > 0.3  # there is something to correct
    assert np.linalg.norm(exported - true, axis=1).max() < 0.02
    assert not said.warnings
    bias = (true - delivered).mean(axis=0)
    words = plain(report.read_text(encoding="utf-8"))
    assert f"was shifted by {bias[0]:+.2f}, {bias[1]:+.2f} px by 12 control points" in words


def test_its_rpc_is_checked(urban, scene, points, gcps, tmp_path, told):
    said = told()
    run_stage("checkgcps", {"gcps": gcps, "scene": scene, "output": str(tmp_path / "p.gpkg")}, said)
    shift = np.linalg.norm((urban.true_views[0].project(points) - load_views(urban.images[:1])[0].project(points))[0])
    from osgeo import ogr

    source = ogr.Open(str(tmp_path / "p.gpkg"))
    fields = json.loads(source.GetLayer(0).GetNextFeature().ExportToJson())["properties"]
    assert fields["rpc_px"] == pytest.approx(shift, abs=0.02)


def test_points_are_refused_where_a_pointing_is(urban_run, gcps, tmp_path, told):
    scene = str(urban_run.workspace / "reconstructed.json")
    with pytest.raises(OptionError, match="GCPS.*must be empty for a scene that has a pointing"):
        run_stage("exportrpc", {"scene": scene, "gcps": gcps, "rpc_folder": str(tmp_path / "rpcs")}, told())
    assert not (tmp_path / "rpcs").exists()


@pytest.mark.slow
@pytest.mark.parametrize("sensor", SENSORS)
def test_a_real_image_of_each_sensor(sensor, shared_data, tmp_path, told):
    """Without a DEM the altitudes are those of the RPC, which is said."""
    said, folder = told(), str(tmp_path)
    image = str(shared_data / SENSORS[sensor])
    fitted = run_stage("epmfit", {"images": [image], "workspace": folder}, said)
    assert "altitudes-of-rpcs" in {each.id for each in said.warnings}
    refined = run_stage("refine", {"scene": fitted.scene, "output_scene": f"{folder}/refined.json"}, told())
    figures = [
        run_stage("errormap", {"scene": each, "output": f"{folder}/{number}.tif"}, told()).rmse
        for number, each in enumerate((fitted.scene, refined.output_scene))
    ]
    assert figures[1] < 0.01 and figures[1] < figures[0], figures
