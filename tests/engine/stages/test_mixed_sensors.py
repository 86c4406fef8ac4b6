"""Images of two sensors: a pair is matched at the ground sampling distance of its coarser image."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.planning.pair_selection import choose_pairs, pair_cost
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.scene import Scene, common_gsd_m, finest_gsd_m, load_views
from repm_qgis.stages import run_stage
from repm_qgis.stereo.pairing import rectified_pair, reductions

RATIO = 2


@pytest.fixture(scope="module")
def coarse(urban, tmp_path_factory):
    """The town's images with pixels of twice the width and height, which are means of four."""
    folder, images = tmp_path_factory.mktemp("coarse"), []
    for view, path in zip(urban.views, urban.images):
        images.append(str(folder / f"coarse_{view.name}.tif"))
        size = [side // RATIO for side in view.size]
        gdal.Translate(images[-1], path, width=size[0], height=size[1], resampleAlg="average")
        made = gdal.Open(images[-1], gdal.GA_Update)
        made.SetMetadata(rpc_tags(view.rpc.resampled(RATIO, RATIO)), "RPC")
        made = None  # noqa: F841
    return images


def score(dsm, truth, cell):
    """The NMAD and completeness of a DSM against the truth in cells of its own, after the median is removed."""
    heights = gdal.Open(dsm).ReadAsArray()
    west, _, _, north, _, _ = gdal.Open(dsm).GetGeoTransform()
    rows, columns = heights.shape
    bounds = west, north - rows * cell, west + columns * cell, north
    frame = {"format": "MEM", "outputBounds": bounds, "xRes": cell, "yRes": cell, "resampleAlg": "average"}
    true = gdal.Warp("", truth, dstNodata=-9999, **frame).ReadAsArray()
    seen = true > -9000
    error = np.where(heights > -9000, heights - true, np.nan)[seen]
    known = error[np.isfinite(error)]
    return 1.4826 * np.median(np.abs(known - np.median(known))), len(known) / seen.sum()


@pytest.mark.long
def test_mixed_pairs_are_as_good_as_the_coarser_sensors_own(urban, coarse, tmp_path, told):
    """On average over both orders: with rounding alone the scatter of one such pair moves by 0.02 m."""
    mixed = {"fine": [urban.images[0], coarse[2]], "coarse": [coarse[0], urban.images[2]]}  # named by the first image
    scores = {}
    for name, images in (("own", [coarse[0], coarse[2]]), *mixed.items()):
        made = {"images": images, "workspace": str(tmp_path / name), "output": str(tmp_path / f"{name}.tif")}
        said = told()
        run_stage("pipeline", {**made, "resolution": 1.0, "workers": 1}, said)
        scores[name] = score(made.output, urban.truth, 1.0)
        if name in mixed:
            assert any("each pair is matched at that of its coarser image" in note for note in said.notes)
            scene = Scene.load(str(tmp_path / name / "reconstructed.json"))
            assert scene.gsd_m == pytest.approx(RATIO * 0.5, rel=0.1)
            assert scene.pairs[0].gsd_m == scene.gsd_m
            assert scores[name][1] > scores["own"][1] - 0.03
    assert np.mean([scores[name][0] for name in mixed]) < 1.15 * scores["own"][0] + 0.03


def test_the_frame_of_a_pair_has_the_coarser_pixels(urban, coarse, tmp_path, told):
    made = run_stage("epmfit", {"images": [*urban.images[:2], *coarse[:1]], "workspace": str(tmp_path)}, told())
    scene = replace(Scene.load(made.scene), refinement="polynomial")
    wide, fine, other = scene.views  # coarser first
    assert reductions(fine, other) == (1.0, 1.0)
    assert reductions(fine, wide)[1] == 1.0 and reductions(other, wide)[0] == pytest.approx(RATIO, rel=0.1)
    bounds, altitudes = scene.tiles[0].bounds, scene.tiles[0].altitudes
    whole = rectified_pair(scene, fine, other, bounds, altitudes)
    mixed = rectified_pair(scene, other, wide, bounds, altitudes)
    assert np.array(mixed.size) == pytest.approx(np.array(whole.size) / RATIO, rel=0.15)
    step = np.array([[50.0, 50.0], [51.0, 50.0], [50.0, 51.0]])
    for to_original, pixels in ((mixed.first_original, RATIO), (mixed.second_original, 1.0)):
        corner, right, down = to_original(step)
        area = abs(np.linalg.det(np.array([right - corner, down - corner])))
        assert np.sqrt(area) == pytest.approx(pixels, rel=0.12)
    # Two fine images are matched at their own, and only pairs with the coarse one at its.
    assert scene.gsd_m == min(fine.gsd_m, other.gsd_m)
    assert scene.matched_gsd_m((fine.name, other.name)) == scene.gsd_m
    assert scene.matched_gsd_m((other.name, wide.name)) == wide.gsd_m


def test_a_mixed_scene_is_the_same_whichever_image_is_named_first(urban, coarse, tmp_path, told):
    scenes = []
    for number, images in enumerate(([urban.images[0], coarse[2]], [coarse[2], urban.images[0]])):
        made = run_stage("epmfit", {"images": images, "workspace": str(tmp_path / str(number))}, told())
        scenes.append(json.loads(Path(made.scene).read_text(encoding="utf-8")))
    one, other = scenes
    assert [view["image"] for view in one["views"]] == [coarse[2], urban.images[0]]
    for scene in scenes:
        del scene["history"], scene["folder"]  # which names the images as they were given
    assert one == other
    alike = run_stage("epmfit", {"images": urban.images[1::-1], "workspace": str(tmp_path / "alike")}, told())
    assert [view.image for view in Scene.load(alike.scene).views] == list(urban.images[1::-1])


def test_one_fine_image_makes_no_fine_scene(urban, coarse):
    views = load_views((urban.images[0], *coarse[1:]))
    assert finest_gsd_m(views) == min(view.gsd_m for view in views[1:]) > 0.9
    assert finest_gsd_m(views[:1]) == views[0].gsd_m


def test_coarse_pairs_cost_more(urban, coarse, tmp_path, told):
    made = run_stage("epmfit", {"images": [*urban.images, *coarse], "workspace": str(tmp_path)}, told())
    pairs = choose_pairs(Scene.load(made.scene))
    best = pairs[0]
    assert best.gsd_m < 0.7
    worse = replace(best, gsd_m=2.6 * best.gsd_m)
    assert pair_cost(worse, finest=best.gsd_m) - pair_cost(best, finest=best.gsd_m) == pytest.approx(np.log(2.0))
    assert pair_cost(worse) == pair_cost(best)


def test_keypoints_are_found_at_few_scales():
    assert common_gsd_m([0.5, 0.52, 0.5]) == (0.52, 0.52, 0.52)
    assert common_gsd_m([0.5, 1.5, 1.4, 0.6]) == (0.6, 1.5, 1.5, 0.6)
