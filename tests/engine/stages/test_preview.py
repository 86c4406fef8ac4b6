"""The preview: reduced images with their own RPCs, a DSM of all the ground, and what it says for the run in full."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal, ogr

from repm_qgis.contracts.errors import OptionError
from repm_qgis.contracts.findings import Finding
from repm_qgis.contracts.options import PipelineOptions
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.scene import Scene, load_views
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE
from repm_qgis.stages.preview import _altitudes, with_reduced_images
from tests.engine.rasters import bands
from tests.engine.stages.test_ortho_ready import project

STEP = 4  # of images of 400 px


@pytest.fixture(scope="module")
def previewed(mountains, tmp_path_factory, told):
    folder = tmp_path_factory.mktemp("previewed")
    options = {"images": mountains.images, "workspace": str(folder / "ws"), "output": str(folder / "dsm.tif")}
    said = told()
    return run_stage("pipeline", {**options, "preset": "preview"}, said), {**options, "preset": "preview"}, said


def test_the_surface_is_the_true_one_in_cells_of_a_reduced_pixel(previewed, mountains, told):
    result, _, _ = previewed
    gsd = min(view.gsd_m for view in mountains.views)
    assert result.resolution == pytest.approx(STEP * gsd, rel=0.02)
    found = run_stage("comparedsm", {"dsm": result.output, "reference": mountains.truth, "align": "3d"}, told())
    assert found.nmad < 0.5 * result.resolution and result.valid_percent > 85  # measured: 1.7 m of 4 m, 88 %


def test_reduced_images_are_rounded_means_and_their_rpcs_see_the_same_ground(previewed, mountains):
    result, _, _ = previewed
    names = [os.path.join(result.workspace, "images", f"{view.name}.tif") for view in mountains.views]
    xmin, ymin, xmax, ymax = mountains.bounds
    spread = np.random.default_rng(1).uniform((xmin, ymin), (xmax, ymax), (200, 2))
    heights = np.random.default_rng(2).uniform(*mountains.height_range, (200, 1))
    ground = np.hstack([geodetic_from_projected(mountains.crs, spread), heights])
    for view, small in zip(mountains.views, load_views(tuple(names))):
        assert small.size == (view.width // STEP, view.height // STEP)
        assert np.allclose(small.project(ground), (view.project(ground) + 0.5) / STEP - 0.5, atol=1e-6)
        whole, reduced = (gdal.Open(each.image).ReadAsArray().astype(float) for each in (view, small))
        assert np.allclose(reduced, whole.reshape(100, STEP, 100, STEP).mean(axis=(1, 3)), atol=0.51)
        assert (small.acquired, small.sensor) == (view.acquired, view.sensor)


def test_altitudes_hold_the_ground_and_the_overlaps_lie_at_its_height(previewed, mountains):
    result, _, _ = previewed
    assert result.lowest < mountains.surface.min() and result.highest > mountains.surface.max()
    outlines, overlaps = ogr.Open(result.footprints), ogr.Open(result.overlaps)
    altitudes = {feature.GetField("altitude") for feature in outlines.GetLayer(0)}
    assert len(altitudes) == 1 and abs(altitudes.pop() - np.median(mountains.surface)) < 10
    assert overlaps.GetLayer(0).GetFeatureCount() == 3
    assert result.matched_images == mountains.images


def test_it_has_a_folder_and_a_report_of_its_own(previewed):
    result, options, said = previewed
    assert result.workspace == os.path.join(options["workspace"], "preview")
    assert os.listdir(options["workspace"]) == ["preview"]
    with open(result.report, encoding="utf-8") as stream:
        page = stream.read()
    assert "Preview of the surface" in page and "What the preview shows" in page and "Altitudes for the DSM" in page
    scene = Scene.load(result.scene)
    assert scene.preset == "preview" and {view.name for view in scene.views} == {"img_01", "img_02", "img_03"}
    assert any(f"at {STEP} times" in text for text in said.notes)


def test_a_run_again_keeps_the_reduced_images_and_gives_the_same_bytes(previewed, told):
    result, options, _ = previewed
    files = [os.path.join(result.workspace, "images", name) for name in ("img_01.tif", "img_02.tif", "img_03.tif")]
    before = [os.stat(file).st_mtime_ns for file in files]
    with open(result.output, "rb") as stream:
        made = stream.read()
    run_stage("pipeline", {**options, "workers": 2}, told())
    assert [os.stat(file).st_mtime_ns for file in files] == before
    with open(result.output, "rb") as stream:
        assert stream.read() == made


@pytest.mark.parametrize("stated", (True, False))
def test_reduced_ortho_ready_images_see_the_same_ground(mountains, tmp_path, told, stated):
    images = [project(view, tmp_path / f"{view.name}.tif", mountains.crs, 1000.0, 1.0) for view in mountains.views[:2]]
    for path in images if stated else ():
        (tmp_path / f"{os.path.basename(path)[:-4]}.IMD").write_text(
            'imageDescriptor = "ORStandard2A";\nterrainHAE = 1000;\n'
        )
    files = {"images": images, "workspace": str(tmp_path / "ws"), "output": str(tmp_path / "dsm.tif")}
    options, reduced = with_reduced_images(PipelineOptions.from_json({**files, "preset": "preview"}), told())
    small = load_views(options.fit.images)
    middle = [(low + high) / 2 for low, high in zip(mountains.bounds[:2], mountains.bounds[2:])]
    ground = [*geodetic_from_projected(mountains.crs, np.array(middle)), 950.0]
    for view, each in zip(reduced.views, small):
        assert each.plane.height == view.plane.height and bool(each.plane.source) is stated
        expected = (view.project(np.array(ground)) + 0.5) / reduced.step - 0.5
        assert np.allclose(each.project(np.array(ground)), expected, atol=1e-3)


def test_a_mask_excludes_each_reduced_pixel_that_it_touches(mountains, tmp_path, told):
    mask = np.zeros((400, 400), np.uint8)
    mask[17, 203] = 1
    path = str(tmp_path / "mask.tif")
    dataset = gdal.GetDriverByName("GTiff").Create(path, 400, 400, 1, gdal.GDT_Byte)
    dataset.GetRasterBand(1).WriteArray(mask)
    dataset = None
    options = {"images": mountains.images[:2], "masks": [path, ""], "workspace": str(tmp_path / "ws")}
    result = run_stage("pipeline", {**options, "output": str(tmp_path / "a.tif"), "preset": "preview"}, told())
    (values,), _ = bands(os.path.join(result.workspace, "images", "img_01.tif"))
    assert np.argwhere(np.isnan(values)).tolist() == [[17 // STEP, 203 // STEP]]


def test_control_points_in_pixels_of_whole_images_are_refused():
    files = {"images": ["a.tif", "b.tif"], "workspace": "w", "output": "dsm.tif", "gcps": "points.csv"}
    assert PipelineOptions.from_json(files).reconstruct.gcps == "points.csv"
    with pytest.raises(OptionError, match="GCPS is 'points.csv'.*PRESET preview"):
        PipelineOptions.from_json({**files, "preset": "preview"})


def test_altitudes_are_never_narrower_than_those_of_the_sweep_nor_made_up(previewed):
    scene = Scene.load(previewed[0].scene)
    scene = replace(scene, altitudes=(150.0, 400.0))
    low, high = _altitudes(scene, 95.0, (200.0, 220.0, 300.0), ENGINE.altitudes)
    assert low == 150.0 and high == 400.0
    wide = _altitudes(scene, 95.0, (100.0, 220.0, 500.0), ENGINE.altitudes)
    assert wide[0] <= 80.0 and wide[1] >= 540.0  # towers that the preview does not show
    record = replace(scene.record_of("epmfit"), warnings=(Finding("altitudes-of-rpcs", "unknown"),))
    blind = replace(scene, history=(record,))  # its range is that of the RPCs: only a surface narrows it
    assert _altitudes(blind, 95.0, (200.0, 220.0, 300.0), ENGINE.altitudes) == (180.0, 360.0)
    assert _altitudes(blind, 20.0, (200.0, 220.0, 300.0), ENGINE.altitudes) is None
