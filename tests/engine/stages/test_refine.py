"""Refined images show what the zero-skew camera sees: the original's brightness where M says."""

from __future__ import annotations

import os

import numpy as np
import pytest
from osgeo import gdal
from scipy import ndimage

from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage


@pytest.mark.parametrize("model", ("none", "homography", "polynomial"))
def test_refined_images(urban, tmp_path, told, model):
    fitted = run_stage(
        "epmfit",
        {"images": urban.images[:2], "workspace": str(tmp_path), "altitude_min": 150.0, "altitude_max": 260.0},
        told(),
    )
    result = run_stage(
        "refine", {"scene": fitted.scene, "output_scene": str(tmp_path / "refined.json"), "model": model}, told()
    )
    scene = Scene.load(result.output_scene)
    assert scene.refinement == model and result.rmse <= result.max_error < 0.2
    for tile in scene.tiles:
        for name, seen in tile.views.items():
            dataset = gdal.Open(os.path.join(tmp_path, seen.image))
            refined = dataset.ReadAsArray().astype(float)
            assert (dataset.RasterXSize, dataset.RasterYSize) == seen.refined.size
            assert dataset.GetRasterBand(1).GetNoDataValue() == 0
            dataset = gdal.Open(scene.view(name).image)
            original = dataset.ReadAsArray().astype(float)
            dataset = None
            cols, rows = np.meshgrid(np.arange(refined.shape[1]), np.arange(refined.shape[0]))
            source = seen.refined.to_original.original_from_refined(np.stack([cols, rows], axis=-1).astype(float))
            expected = ndimage.map_coordinates(original, [source[..., 1], source[..., 0]], order=1, cval=np.nan)
            known = (refined > 0) & np.isfinite(expected)
            assert known.mean() > 0.9
            # OpenCV rounds positions to 1/32 px: steep edges of roofs show it.
            difference = np.abs(refined - expected)[known]
            assert np.median(difference) < 2 and np.percentile(difference, 99) < 40
            assert seen.refined.camera.K[0, 1] == 0


def test_the_polynomial_is_the_better_the_larger_the_error(mountains, tmp_path, told):
    fitted = run_stage(
        "epmfit",
        {"images": mountains.images[:2], "workspace": str(tmp_path), "altitude_min": 800.0, "altitude_max": 1400.0},
        told(),
    )
    rmse = {
        model: run_stage(
            "refine",
            {
                "scene": fitted.scene,
                "output_scene": str(tmp_path / f"{model}.json"),
                "model": model,
                "write_images": False,
            },
            told(),
        ).rmse
        for model in ("none", "homography", "polynomial")
    }
    assert rmse["polynomial"] <= rmse["homography"] * 1.0001 <= rmse["none"] * 1.001
    assert rmse["none"] == pytest.approx(fitted.rmse, rel=0.01)


@pytest.mark.long
def test_the_number_of_workers_changes_no_byte(urban, tmp_path, told):
    """Of the maps, by both models, and of the images."""
    area = {"altitude_min": 150.0, "altitude_max": 260.0, "tile_size": 256}
    fitted = run_stage("epmfit", {"images": urban.images[:2], "workspace": str(tmp_path), **area}, told())
    assert len(Scene.load(fitted.scene).tiles) > 3  # or no worker would be started
    made = []
    for workers in (1, 2):
        result = run_stage(
            "refine",
            {"scene": fitted.scene, "output_scene": str(tmp_path / f"{workers}.json"), "workers": workers},
            told(),
        )
        seen = [view for tile in Scene.load(result.output_scene).tiles for view in tile.views.values()]
        images = [open(view.image, "rb").read() for view in seen]
        made.append(([view.refined.to_mapping() for view in seen], images))
    assert made[0] == made[1]
