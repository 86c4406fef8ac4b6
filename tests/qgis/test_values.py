"""Parameters' values become the engine's options; wrong ones are refused in a sentence before anything runs."""

from __future__ import annotations

import json
import os
import shlex
import shutil

import pytest
from osgeo import gdal
from qgis.core import (
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsProject,
    QgsRasterLayer,
    QgsRectangle,
    QgsReferencedRectangle,
    QgsVectorLayer,
)


def algorithm(name):
    return QgsApplication.processingRegistry().algorithmById(f"repm:{name}").create()


def options(name, parameters, context, feedback):
    """What the algorithm would hand to the engine, and its destinations."""
    found = algorithm(name)
    assert found.prepareAlgorithm(parameters, context, feedback)
    return found._inputs


@pytest.fixture
def rasters(tmp_path):
    """Two georeferenced rasters of 4 x 4 px."""
    paths = [str(tmp_path / f"a b{i}.tif") for i in range(2)]
    for path in paths:
        dataset = gdal.GetDriverByName("GTiff").Create(path, 4, 4)
        dataset.SetGeoTransform((0, 1, 0, 4, 0, -1))
        dataset = None  # noqa: F841 - closes the file
    return paths


def test_inputs_become_options_of_the_engine(plugin, context, feedback, rasters):
    from repm_qgis.contracts.options import EpmFitOptions

    area = QgsReferencedRectangle(QgsRectangle(1.5, 2.5, 3.5, 4.5), QgsCoordinateReferenceSystem("EPSG:32631"))
    found = options(
        "epmfit",
        {"IMAGES": rasters, "EXTENT": area, "ALTITUDE_MIN": -5.5, "TILE_SIZE": 512, "DEM": rasters[0]},
        context,
        feedback,
    )
    assert found == {
        "images": rasters,
        "extent": [1.5, 2.5, 3.5, 4.5],
        "extent_crs": "EPSG:32631",
        "dem": rasters[0],
        "altitude_min": -5.5,
        "altitude_max": None,
        "ortho_ready_height": None,
        "tile_size": 512,
        "error_budget": 0.1,
        "rpcs": [],
        "masks": [],
    }
    EpmFitOptions.from_json(json.loads(json.dumps({**found, "workspace": "w"})))


def test_an_extent_as_text_is_in_degrees_unless_it_says_more(plugin, context, feedback, rasters):
    plain = options("epmfit", {"IMAGES": rasters, "EXTENT": "7,8,45,46"}, context, feedback)
    assert (plain["extent"], plain["extent_crs"]) == ([7, 45, 8, 46], "EPSG:4326")
    named = options("epmfit", {"IMAGES": rasters, "EXTENT": "7,8,45,46 [EPSG:2056]"}, context, feedback)
    assert (named["extent"], named["extent_crs"]) == ([7, 45, 8, 46], "EPSG:2056")


def test_layers_of_the_project_give_their_files(plugin, context, feedback, rasters):
    project = QgsProject()
    layer = QgsRasterLayer(rasters[0], "first", "gdal")
    project.addMapLayer(layer)
    context.setProject(project)
    found = options("epmfit", {"IMAGES": [layer.id(), rasters[1]]}, context, feedback)
    assert found["images"] == rasters
    assert options("epmfit", {"IMAGES": [layer, rasters[1]]}, context, feedback)["images"] == rasters


def test_numbers_that_are_not_given_have_their_defaults_and_a_crs_is_named(plugin, context, feedback):
    found = options("dsmfuse", {"SCENE": "/s/scene.json", "OUTLIER_RADIUS": "", "CRS": "EPSG:32632"}, context, feedback)
    assert found == {
        "scene": "/s/scene.json",
        "resolution": 0.0,
        "crs": "EPSG:32632",
        "vertical_datum": "",
        "method": "mean",
        "fill": "occlusions",
        "water": "keep",
        "outlier_radius": 0.0,
        "mesh_vertices": 500000,
        "ortho_resolution": 0.0,
        "colour": "auto",
        "xs": [],
        "pansharpen": True,
        "cloud_normals": False,
        "cluster": "",
        "workers": 0,
        "memory": 0,
    }
    assert options("dsmfuse", {"SCENE": "/s/scene.json"}, context, feedback)["crs"] is None


def test_workers_come_from_the_settings(plugin, context, feedback):
    from processing.core.ProcessingConfig import ProcessingConfig

    ProcessingConfig.settings["REPM_WORKERS"].setValue(3)
    try:
        assert options("reconstruct", {"SCENE": "/s/scene.json"}, context, feedback)["workers"] == 3
    finally:
        ProcessingConfig.settings["REPM_WORKERS"].setValue(0)


def test_memory_comes_from_the_settings(plugin, context, feedback):
    from processing.core.ProcessingConfig import ProcessingConfig

    ProcessingConfig.settings["REPM_MEMORY"].setValue(2000)
    try:
        assert options("pipeline", {}, context, feedback)["memory"] == 2000
    finally:
        ProcessingConfig.settings["REPM_MEMORY"].setValue(0)


def test_a_cluster_comes_from_the_parameter_or_the_settings(plugin, context, feedback, rasters):
    from processing.core.ProcessingConfig import ProcessingConfig

    given = {"DSM": rasters[0], "REFERENCE": rasters[1]}
    ProcessingConfig.settings["REPM_CLUSTER"].setValue("tcp://10.0.0.1:8786")
    try:
        assert options("comparedsm", given, context, feedback)["cluster"] == "tcp://10.0.0.1:8786"
        found = options("comparedsm", {**given, "CLUSTER": "/shared/scheduler.json"}, context, feedback)
        assert found["cluster"] == "/shared/scheduler.json"
        assert "cluster" not in options("epmfit", {"IMAGES": rasters}, context, feedback)
    finally:
        ProcessingConfig.settings["REPM_CLUSTER"].setValue("")


@pytest.mark.long
def test_a_comparison_on_a_cluster_runs_apart(plugin, context, feedback, rasters):
    """QGIS's own Python need not have Dask: the engine's has, and says what is wrong with the address."""
    from qgis.core import QgsProcessingException

    given = {"DSM": rasters[0], "REFERENCE": rasters[1], "CLUSTER": "tcp://127.0.0.1:1", "THRESHOLDS": "1"}
    with pytest.raises(QgsProcessingException, match="No Dask scheduler answers at 'tcp://127.0.0.1:1'"):
        algorithm("comparedsm").run(given, context, feedback, {}, False)


def test_masks_keep_their_places(plugin, context, feedback, rasters):
    """An image without a mask leaves its place in the list empty."""
    assert options("epmfit", {"IMAGES": rasters, "MASKS": ["", rasters[1]]}, context, feedback)["masks"] == [
        "",
        rasters[1],
    ]
    assert options("epmfit", {"IMAGES": rasters, "MASKS": []}, context, feedback)["masks"] == []
    fine, text = check("epmfit", {"IMAGES": rasters, "WORKSPACE": "/w", "MASKS": ["/gone.tif", ""]}, context)
    assert not fine and "MASKS '/gone.tif' is not there" in text


def test_the_command_repeats_the_run(plugin, context, feedback, rasters):
    given = {"IMAGES": rasters, "EXTENT": "7.1,8,45,46 [EPSG:4326]", "ALTITUDE_MAX": 1200.5, "METHOD": "median"}
    found = options("pipeline", given, context, feedback)
    products = {"output": "/o/my dsm.tif", "workspace": "/w", "cloud": None}
    command = algorithm("pipeline").complete({**found, **products})["command"]
    words = shlex.split(command)
    assert words[:4] == ["qgis_process", "run", "repm:pipeline", "--"]
    again = {}
    for word in words[4:]:
        name, value = word.split("=", 1)
        again[name] = (
            [*again[name], value] if name == "IMAGES" and name in again else ([value] if name == "IMAGES" else value)
        )
    assert (again["OUTPUT"], again["WORKSPACE"], "CLOUD" in again) == ("/o/my dsm.tif", "/w", False)
    assert options("pipeline", again, context, feedback) == found


def check(name, parameters, context):
    return algorithm(name).checkParameterValues(parameters, context)


def test_what_colmaps_adjustment_cannot_do_is_refused_before_anything_runs(plugin, context, sample, tmp_path):
    table = tmp_path / "gcps.csv"
    table.write_text("id,lon,lat,height\n")
    scene = tmp_path / "scene.json"
    scene.write_text("{}")
    for name, given in (
        ("pipeline", {"IMAGES": sample.images, "WORKSPACE": "/w", "OUTPUT": "/w/d.tif"}),
        ("reconstruct", {"SCENE": str(scene), "OUTPUT_SCENE": "/w/r.json"}),
    ):
        colmap = {**given, "ADJUSTMENT": "colmap"}
        fine, text = check(name, {**colmap, "POINTING": "affine"}, context)
        assert not fine and "POINTING is 'affine'" in text and text.count(".") == 1
        fine, text = check(name, {**colmap, "GCPS": str(table)}, context)
        assert not fine and "must be rpc where there are GCPS" in text and text.count(".") == 1
        for right in (colmap, {**colmap, "POINTING": "shift"}, {**given, "POINTING": "affine", "GCPS": str(table)}):
            fine, text = check(name, right, context)
            assert fine, text
    fine, text = check("reconstruct", {"SCENE": str(scene), "ADJUSTMENT": "ceres"}, context)
    assert not fine and "must be one of rpc, colmap" in text


def test_the_adjustment_is_an_option_of_the_engine(plugin, context, feedback, rasters):
    from repm_qgis.contracts.options import PipelineOptions

    assert options("reconstruct", {"SCENE": "/s/scene.json"}, context, feedback)["adjustment"] == "rpc"
    found = options("pipeline", {"IMAGES": rasters, "ADJUSTMENT": "colmap"}, context, feedback)
    made = PipelineOptions.from_json(json.loads(json.dumps({**found, "workspace": "w", "output": "d.tif"})))
    assert made.reconstruct.adjustment == "colmap"
    command = algorithm("pipeline").complete({**found, "workspace": "/w", "output": "/w/d.tif"})["command"]
    assert "ADJUSTMENT=colmap" in command


@pytest.mark.long
def test_colmap_without_cuda_is_refused_in_the_dialog(plugin, context, tmp_path, monkeypatch):
    from repm.processing_provider import engine

    scene = tmp_path / "scene.json"
    scene.write_text("{}")
    given = {"SCENE": str(scene), "OUTPUT_SCENE": str(tmp_path / "out.json"), "BACKEND": "colmap"}
    if engine.backend_remedy("colmap"):
        fine, text = check("reconstruct", given, context)
        assert not fine and "BACKEND is 'colmap'" in text and "pycolmap-cuda12" in text and "\n" not in text
    monkeypatch.setattr(engine, "backend_remedy", lambda name: "")
    assert check("reconstruct", given, context)[0]
    monkeypatch.setattr(engine, "backend_remedy", lambda name: f"{name} needs a device")
    assert check("reconstruct", {**given, "BACKEND": "auto"}, context)[0]
    assert "which colmap needs a device; or choose auto" in check("reconstruct", given, context)[1]


def test_a_backend_that_needs_nothing_costs_no_start_of_the_engine(plugin, monkeypatch):
    from repm.processing_provider import engine

    def never(*arguments, **options):
        raise AssertionError("the engine was started")

    monkeypatch.setattr(engine, "_quiet_process", never)
    assert engine.backend_remedy("sgm") == ""
    with pytest.raises(AssertionError):
        engine.backend_remedy("colmap")


def test_options_of_colmap_reach_the_engine(plugin, context, feedback):
    given = {"SCENE": "/s/scene.json", "GEOMETRIC": False, "WINDOW_RADIUS": 7}
    found = options("reconstruct", given, context, feedback)
    assert (found["geometric"], found["window_radius"], found["gpu_memory"]) == (False, 7, 0.0)
    assert found["colmap_fusion"] is False


def test_one_image_has_no_heights(plugin, context, rasters):
    for images in (rasters[:1], rasters[0], [], None):
        fine, text = check("pipeline", {"IMAGES": images, "WORKSPACE": "/w", "OUTPUT": "/w/dsm.tif"}, context)
        assert not fine
        assert "at least two images" in text


def test_one_image_has_a_camera(plugin, context, rasters):
    for images in (rasters, rasters[:1], rasters[0]):
        fine, text = check("epmfit", {"IMAGES": images, "WORKSPACE": "/w", "TILES": "/w/t.gpkg"}, context)
        assert fine, text
    for images in ([], None):
        fine, text = check("epmfit", {"IMAGES": images, "WORKSPACE": "/w"}, context)
        assert not fine and "IMAGES" in text


def test_layers_that_are_no_files_are_refused_by_name(plugin, context, rasters):
    memory = QgsVectorLayer("Point", "my points", "memory")
    fine, text = check("pipeline", {"IMAGES": [memory, rasters[0]], "OUTPUT": "o.tif", "WORKSPACE": "/w"}, context)
    assert not fine
    assert "'my points'" in text and "'memory'" in text


def test_altitudes_must_rise(plugin, context, rasters):
    given = {"IMAGES": rasters, "WORKSPACE": "/w", "ALTITUDE_MIN": 300, "ALTITUDE_MAX": "200"}
    assert check("epmfit", given, context) == (
        False,
        "ALTITUDE_MIN is 300.0: it must be below ALTITUDE_MAX (200 m).",
    )


def test_a_raster_that_is_not_there_or_damaged_is_named(plugin, context, rasters, tmp_path):
    gone = str(tmp_path / "gone.tif")
    fine, text = check("comparedsm", {"DSM": gone, "REFERENCE": rasters[0], "THRESHOLDS": "1"}, context)
    assert not fine and f"DSM '{gone}' is not there" in text
    damaged = tmp_path / "damaged.tif"
    damaged.write_bytes(b"II*\0garbage")
    fine, text = check("comparedsm", {"DSM": rasters[0], "REFERENCE": str(damaged), "THRESHOLDS": "1"}, context)
    assert not fine and f"REFERENCE '{damaged}' cannot be read" in text


def test_clouds_and_points_are_taken_where_they_are_read(plugin, context, rasters, tmp_path):
    cloud, other, table, scene = (tmp_path / name for name in ("cloud.laz", "other.laz", "points.csv", "scene.json"))
    for path in (cloud, other, table):
        path.write_text("x,y,z\n")  # what is in it is the engine's to judge
    scene.write_text("{}")
    compared = {"DSM": rasters[0], "REFERENCE": str(cloud), "ALIGN": "icp", "THRESHOLDS": "1"}
    assert check("comparedsm", compared, context) == (True, "")
    assert check("comparedsm", {**compared, "DSM": str(other)}, context) == (True, "")
    assert "is the same file as DSM" in check("comparedsm", {**compared, "DSM": str(cloud)}, context)[1]
    assert not check("comparedsm", {**compared, "REFERENCE": str(table)}, context)[0]
    gone = str(tmp_path / "gone.laz")
    assert f"REFERENCE '{gone}' is not there" in check("comparedsm", {**compared, "REFERENCE": gone}, context)[1]
    assert check("comparedsm", {**compared, "OTHERS": [rasters[0], str(other)]}, context) == (True, "")
    assert f"OTHERS '{gone}' is not there" in check("comparedsm", {**compared, "OTHERS": [gone]}, context)[1]
    for reference in (cloud, table):
        given = {"SCENE": str(scene), "REFERENCE": [str(reference)], "OUTPUT_SCENE": str(tmp_path / "r.json")}
        assert "cannot be read as a raster" not in check("register", given, context)[1]
    assert "cannot be read as a raster" in check("mosaic", {"DSMS": [rasters[0], str(cloud)]}, context)[1]


@pytest.mark.parametrize("name", ("comparedsm", "change", "series"))
def test_what_reads_whole_surfaces_runs_in_a_process_of_its_own(plugin, name):
    """Its memory is not QGIS's, and clouds need packages that QGIS's own Python may lack."""
    assert algorithm(name).runs_apart({})


@pytest.mark.parametrize("text", ["", "high", "1; -2", "0", "nan", "inf"])
def test_thresholds_must_be_heights(plugin, context, rasters, text):
    fine, problem = check("comparedsm", {"DSM": rasters[0], "REFERENCE": rasters[1], "THRESHOLDS": text}, context)
    assert not fine
    assert "THRESHOLDS" in problem


def test_thresholds_are_read_with_any_separator(plugin):
    from repm.processing_provider.comparedsm import thresholds

    assert thresholds("1;2.5; 5") == thresholds("1, 2.5 5") == [1.0, 2.5, 5.0]


def test_further_rasters_are_checked_one_by_one(plugin, context, rasters, tmp_path):
    gone = str(tmp_path / "gone.tif")
    given = {"DSM": rasters[0], "REFERENCE": rasters[1], "THRESHOLDS": "1"}
    assert check("comparedsm", {**given, "OTHERS": [rasters[0]]}, context)[0]  # one is enough: these are no images
    fine, text = check("comparedsm", {**given, "OTHERS": [rasters[0], gone]}, context)
    assert not fine and f"OTHERS '{gone}' is not there" in text
    fine, text = check("comparedsm", {**given, "PROFILES": gone}, context)
    assert not fine and f"PROFILES '{gone}' is not there" in text


def test_the_command_is_quoted_for_the_shell_of_the_system(plugin, monkeypatch):
    from repm.processing_provider import values

    options = {"images": ["/data/a b.tif"], "output": "dsm.tif", "workers": 4, "crs": None}
    assert values.command_line("repm:x", options) == "qgis_process run repm:x -- 'IMAGES=/data/a b.tif' OUTPUT=dsm.tif"
    monkeypatch.setattr(values.os, "name", "nt")
    options["images"] = [r"D:\data\a b.tif"]
    quoted = r'qgis_process run repm:x -- "IMAGES=D:\data\a b.tif" OUTPUT=dsm.tif'
    assert values.command_line("repm:x", options) == quoted


def test_a_number_that_is_left_out_has_its_default(plugin, context, feedback, rasters):
    """A model passes None on for what its command does not name."""
    given = {"SCENE": "scene.json", "RESOLUTION": None, "OUTLIER_RADIUS": None, "OUTPUT": "dsm.tif"}
    found = options("dsmfuse", given, context, feedback)
    assert found["resolution"] == found["outlier_radius"] == 0
    assert algorithm("sampledata").checkParameterValues({"SIZE": None, "FOLDER": "f"}, context) == (True, "")


def test_one_folder_is_accepted_as_images(plugin, context, sample, tmp_path):
    """QGIS counts paths: a folder is one, and holds many images."""
    folder = tmp_path / "as delivered"
    folder.mkdir()
    for path in sample.images[:2]:
        shutil.copy(path, folder)
    given = {"IMAGES": [str(folder)], "WORKSPACE": str(tmp_path / "w"), "OUTPUT": str(tmp_path / "dsm.tif")}
    assert algorithm("pipeline").checkParameterValues(given, context) == (True, "")
    (folder / os.path.basename(sample.images[1])).unlink()
    fine, text = algorithm("pipeline").checkParameterValues(given, context)
    assert not fine and "must name at least two images" in text
