"""The desktop itself, under Xvfb: the algorithm is found in the toolbox, its dialog run, its layers looked at."""

from __future__ import annotations

import shutil

import pytest

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        not (shutil.which("xvfb-run") and shutil.which("qgis")),
        reason="needs QGIS's desktop and xvfb-run ('make setup')",
    ),
]


@pytest.fixture
def desktop(desktop_start):
    """Runs an algorithm in a new desktop with an empty profile; gives what the driver found."""

    def run(title, parameters):
        return desktop_start("desktop_driver.py", {"title": title, "parameters": parameters})

    return run


def test_the_pipeline_in_the_desktop_brings_styled_layers(desktop, town, tmp_path):
    found = desktop(
        "Make a DSM from satellite",
        {
            "IMAGES": town.images,
            "WORKSPACE": str(tmp_path / "old town"),
            "CONFIDENCE": "TEMPORARY_OUTPUT",
            "ORTHO": "TEMPORARY_OUTPUT",
            "EPT": str(tmp_path / "points"),
            "MESH": str(tmp_path / "mesh.ply"),
        },
    )
    assert found["chosen"] == "repm:pipeline"
    assert found["success"]
    layers = {layer["name"]: layer for layer in found["layers"]}
    assert {"DSM old town (WGS 84 ellipsoid)", "Tiles old town", "Tie points old town"} <= set(layers)
    assert layers["DSM old town (WGS 84 ellipsoid)"]["renderer"] == "QgsSingleBandPseudoColorRenderer"
    assert layers["Tiles old town"]["renderer"] == "QgsGraduatedSymbolRenderer"
    assert layers["Tie points old town"]["renderer"] != "QgsSingleSymbolRenderer"
    # In one group, in an order in which nothing hides what matters.
    assert [(layer["name"].replace(" old town", ""), layer["shown"]) for layer in found["layers"]] == [
        ("Tie points", False),
        ("Tiles", False),
        ("Point cloud", False),
        ("Orthophoto", False),
        ("Confidence", False),
        ("Mesh", False),
        ("Hillshade of DSM (WGS 84 ellipsoid)", True),  # hidden in the tree: see test_hillshades.py
        ("DSM (WGS 84 ellipsoid)", True),
    ]
    assert {layer["group"] for layer in found["layers"]} == {"old town"}
    assert found["links"] == ['<a href="confidence">Expected errors (confidence)</a>']  # in the legend of the DSM
    assert found["linked"] == [["Confidence old town", True], ["Confidence old town", False]]
    assert layers["Point cloud old town"]["renderer"] == "QgsPointCloudAttributeByRampRenderer"
    assert (layers["Point cloud old town"]["in_3d"], layers["Mesh old town"]["in_3d"]) == ("pointcloud", "mesh")
    assert all(layer["valid"] and layer["crs"].startswith("EPSG:326") for layer in layers.values())


@pytest.mark.slow
def test_images_on_an_empty_map(desktop, town):
    """What the area is drawn over: styled layers in the images' UTM zone, before anything is computed."""
    found = desktop("Inspect images", {"IMAGES": town.images})
    assert (found["chosen"], found["success"]) == ("repm:inspect", True)
    assert [(layer["name"].split()[0], layer["renderer"], layer["shown"]) for layer in found["layers"]] == [
        ("Footprints", "QgsSingleSymbolRenderer", True),
        ("Overlaps", "QgsCategorizedSymbolRenderer", True),
    ]
    assert all(layer["valid"] and layer["crs"].startswith("EPSG:326") for layer in found["layers"])


def test_the_first_stage_in_the_desktop(desktop, sample, tmp_path):
    found = desktop("Fit equivalent", {"IMAGES": sample.images, "WORKSPACE": str(tmp_path / "old town")})
    assert (found["chosen"], found["success"]) == ("repm:epmfit", True)
    (layer,) = found["layers"]
    assert (layer["name"], layer["valid"]) == ("Tiles old town", True)
    assert layer["renderer"] == "QgsGraduatedSymbolRenderer"


@pytest.mark.slow
def test_a_mosaic_of_scenes_in_the_desktop(desktop, town, tmp_path):
    """Two halves of the town, as reconstructed scenes; the mosaic is a VRT."""
    from osgeo import gdal

    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    truth = gdal.Info(town.truth, format="json")
    (west, south), (east, north) = (truth["cornerCoordinates"][name] for name in ("lowerLeft", "upperRight"))
    middle, crs = (west + east) / 2, gdal.Open(town.truth).GetSpatialRef()
    scenes = []
    for name, ends in (("west", (west, middle + 30)), ("east", (middle - 30, east))):
        folder = tmp_path / name
        area = {"extent": [ends[0], south, ends[1], north], "extent_crs": f"EPSG:{crs.GetAuthorityCode(None)}"}
        job = {"images": town.images, "workspace": str(folder), "output": str(folder / "dsm.tif"), "resolution": 1.0}
        scenes.append(run_stage("pipeline", {**job, **area}, Silent()).scene)
    vrt = tmp_path / "mosaic.vrt"
    found = desktop("Make a mosaic", {"SCENES": scenes, "OUTPUT": str(vrt), "REPORT": str(tmp_path / "mosaic.html")})
    assert (found["chosen"], found["success"]) == ("repm:mosaic", True)
    layers = {layer["source"]: layer for layer in found["layers"]}
    assert layers[str(vrt)]["renderer"] == "QgsSingleBandPseudoColorRenderer"
    assert all(layer["valid"] and layer["shown"] for layer in found["layers"])
    heights = gdal.Open(str(vrt)).ReadAsArray()
    assert heights.shape[1] > 150 and (heights > -1000).mean() > 0.5  # both halves, in one raster
    page = (tmp_path / "mosaic.html").read_text(encoding="utf-8")
    assert all(scene in page for scene in scenes)


@pytest.mark.slow
def test_an_error_map_in_the_desktop(desktop, town, tmp_path):
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    fitted = run_stage("epmfit", {"images": town.images, "workspace": str(tmp_path / "old town")}, Silent())
    found = desktop("Map the equivalent error", {"SCENE": fitted.scene, "ALTITUDE": 180})
    assert (found["chosen"], found["success"]) == ("repm:errormap", True)
    (layer,) = found["layers"]
    name = "Equivalent error old town (img_01, 180 m, before refinement)"
    assert (layer["name"], layer["valid"]) == (name, True)
    assert layer["renderer"] == "QgsSingleBandPseudoColorRenderer"
    assert layer["crs"] == "EPSG:32631"


@pytest.mark.slow
def test_a_registration_in_the_desktop_shows_what_it_did(desktop, town, tmp_path):
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.scene import Scene
    from repm_qgis.stages import run_stage

    workspace = tmp_path / "old town"
    options = {"images": town.images, "workspace": str(workspace), "output": str(tmp_path / "dsm.tif")}
    scene = run_stage("pipeline", {**options, "resolution": 1.0, "workers": 1}, Silent()).scene
    values = {"SCENE": scene, "REFERENCE": [town.truth], "REFERENCE_DATUM": "ellipsoid"}
    found = desktop("Register to a reference", {**values, "OUTPUT_SCENE": str(workspace / "registered.json")})
    assert (found["chosen"], found["success"]) == ("repm:register", True)
    assert [(layer["name"].replace(" old town", ""), layer["renderer"]) for layer in found["layers"]] == [
        ("Offsets of the scene's parts", "QgsRuleBasedRenderer"),
        ("Differences from the reference", "QgsSingleBandPseudoColorRenderer"),
    ]
    assert {layer["group"] for layer in found["layers"]} == {"old town"} and all(
        layer["valid"] for layer in found["layers"]
    )
    assert Scene.load(str(workspace / "registered.json")).registration.references[0].file == town.truth


def test_a_dsm_in_the_elevation_profile_tool(desktop_start, town, tmp_path):
    from qgis.core import Qgis

    if Qgis.QGIS_VERSION_INT < 32600:
        pytest.skip(f"QGIS {Qgis.QGIS_VERSION}: the elevation profile tool is there from 3.26 on")
    from osgeo import gdal

    from repm_qgis.reports.styles import write_style

    dsm = str(tmp_path / "dsm.tif")
    shutil.copyfile(town.truth, dsm)
    write_style("dsm", dsm)
    found = desktop_start("drive_profile.py", {"dsm": dsm}, seconds=60)
    assert found["elevation"] and found["offered"] == ["DSM"]
    heights = gdal.Open(dsm).ReadAsArray()
    low, high = heights[heights > -1000].min(), heights.max()
    # The tool leaves a margin around the line that it has drawn; without heights it shows 0 to 100 m.
    margin = 0.2 * (high - low)
    assert low - margin <= found["heights"][0] < found["heights"][1] <= high + margin


@pytest.mark.slow
def test_the_terrain_of_a_town_in_the_desktop(desktop, town, tmp_path):
    given = {"DSM": town.truth, "LARGEST": 60, "MASK": "TEMPORARY_OUTPUT", "REPORT": str(tmp_path / "dtm.html")}
    found = desktop("Find the terrain", given)
    assert (found["chosen"], found["success"]) == ("repm:dtm", True)
    renderers = [layer["renderer"] for layer in found["layers"]]
    ramps = ["QgsSingleBandPseudoColorRenderer"] * 2
    assert sorted(renderers) == ["QgsHillshadeRenderer", "QgsPalettedRasterRenderer", *ramps]
    assert all(layer["valid"] for layer in found["layers"])
    assert [layer["shown"] for layer in found["layers"]].count(True) == 2  # the terrain and its hillshade
    assert "DSM − terrain" in (tmp_path / "dtm.html").read_text(encoding="utf-8")
