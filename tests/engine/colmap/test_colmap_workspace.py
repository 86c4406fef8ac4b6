"""The folder that COLMAP gets: it opens there, its pixels are ours, and its own fusion finds the truth again."""

from __future__ import annotations

import os
import re

import numpy as np
import pycolmap
import pytest

from repm_qgis.colmap.projective_frame import ProjectiveFrame
from repm_qgis.colmap.workspace import image_name, map_path, view_intensity, write_workspace
from repm_qgis.geometry.frames import projected_from_geodetic
from repm_qgis.imagery.enhancement import view_stretch
from tests.engine.colmap.emulation import Workspace, write_map
from tests.engine.colmap.truth_depths import depths_of, surface_at, true_frame, true_heights
from tests.engine.versions import needs_pycolmap_4


@pytest.fixture(scope="module")
def made(urban, tmp_path_factory):
    """A tile of the simulated town as a workspace: scene, tile, folder, view_intensity of the views."""
    scene, tile = true_frame(urban, 60.0)
    folder = str(tmp_path_factory.mktemp("colmap"))
    images = [view_intensity(view, view_stretch(view.view.image, view.view.band)) for view in tile.views]
    names = [view.view.name for view in tile.views]
    write_workspace(folder, scene, tile, images, {name: [other for other in names if other != name] for name in names})
    return scene, tile, folder, images


@needs_pycolmap_4
def test_colmap_opens_it(made):
    scene, tile, folder, images = made
    model = pycolmap.Reconstruction(os.path.join(folder, "sparse"))
    assert model.num_images() == len(tile.views) == 3
    for index, view in enumerate(tile.views):
        image = model.images[index + 1]
        camera, pose = model.cameras[image.camera_id], image.cam_from_world()
        assert (image.name, camera.model.name) == (image_name(index), "PINHOLE")
        assert (camera.width, camera.height) == view.size == images[index].shape[::-1]
        np.testing.assert_allclose(camera.calibration_matrix(), view.camera.K, rtol=1e-12)
        np.testing.assert_allclose(pose.rotation.matrix(), view.camera.R, atol=1e-12)
        np.testing.assert_allclose(np.asarray(pose.translation), view.camera.t, atol=1e-12)
        for place in image.points2D:
            seen = view.camera.project(np.asarray(model.points3D[place.point3D_id].xyz))
            np.testing.assert_allclose(np.asarray(place.xy), seen, atol=1e-6)
    assert model.num_points3D() > 100 and model.compute_mean_track_length() > 2
    low, high = tile.depths(scene)
    assert 0.9 < low < high < 2.2


@needs_pycolmap_4
def test_lists_name_references_and_sources(made):
    workspace = Workspace(made[2])
    assert workspace.problems == {
        "0000.png": ["0001.png", "0002.png"],
        "0001.png": ["0000.png", "0002.png"],
        "0002.png": ["0000.png", "0001.png"],
    }
    with open(os.path.join(made[2], "stereo", "fusion.cfg"), encoding="utf-8") as stream:
        assert stream.read().split() == ["0000.png", "0001.png", "0002.png"]


@needs_pycolmap_4
def test_images_are_the_original_resampled_once(made):
    """Each pixel is the original's value where the exact map leads, to what 8 bits can tell."""
    from repm_qgis.imagery.raster import opened
    from repm_qgis.imagery.warping import sample_source

    _, tile, folder, _ = made
    workspace = Workspace(folder)
    view = tile.views[1]
    rows, columns = np.indices(view.size[::-1])
    at = view.to_original(np.stack([columns, rows], axis=-1).astype(np.float64))
    stretch = view_stretch(view.view.image, view.view.band)
    with opened(view.view.image) as dataset:
        direct = stretch.apply(sample_source(dataset, view.view.band, at, "cubic"))
    known = np.isfinite(direct)
    assert np.abs(direct - workspace.images["0001.png"])[known].max() < 1.5 / 255
    assert (workspace.images["0001.png"][~known] == 0).all()


@needs_pycolmap_4
def test_masked_pixels_are_none(made, tmp_path, write_image):
    """A mask over the image's left half: no view_intensity there, and black for COLMAP."""
    from dataclasses import replace

    _, tile, _, _ = made
    view = tile.views[1]
    mask = np.zeros((view.view.height, view.view.width), dtype=np.uint8)
    mask[:, : mask.shape[1] // 2] = 1
    masked = replace(view, view=replace(view.view, mask=write_image(tmp_path / "mask.tif", mask)))
    found = view_intensity(masked, view_stretch(view.view.image, view.view.band))
    rows, columns = np.indices(view.size[::-1])
    original = view.to_original(np.stack([columns, rows], axis=-1).astype(np.float64))[..., 0]
    assert np.isnan(found[original < mask.shape[1] // 2 - 1]).all()
    assert np.isfinite(found[(original > mask.shape[1] // 2 + 4) & (original < mask.shape[1] - 8)]).mean() > 0.9


def write_maps(folder, index, view, depth, normal=(0.0, 0.0, 1.0)):
    """A view's depths, with one normal of the world where there are any."""
    normals = np.where(depth[..., None] > 0, view.camera.R @ np.array(normal), 0.0)
    path = map_path(folder, index, True)
    write_map(path, depth)
    write_map(path.replace("depth_maps", "normal_maps"), normals)


def fused(folder, **options):
    settings = pycolmap.StereoFusionOptions()
    for name, value in {"min_num_pixels": 2, "num_threads": 1, **options}.items():
        setattr(settings, name, value)
    found = pycolmap.stereo_fusion(os.path.join(folder, "fused.ply"), folder, options=settings, output_type="ply")
    return np.array([point.xyz for point in found.points3D.values()]).reshape(-1, 3)


@needs_pycolmap_4
def test_the_installed_colmap_counts_from_pixel_centres_here(made):
    """One pixel with a depth, through COLMAP's own fusion: its point must lie on our ray, not half a pixel beside."""
    _, tile, folder, _ = made
    for index, view in enumerate(tile.views):
        depth = np.zeros(view.size[::-1], dtype=np.float32)
        if index == 0:
            depth[37, 91] = 1.3
        write_maps(folder, index, view, depth, (0.36, -0.48, 0.8))
    point = fused(folder, min_num_pixels=1)
    np.testing.assert_allclose(tile.views[0].camera.project(point), [[91.0, 37.0]], atol=0.01)
    np.testing.assert_allclose(tile.views[0].camera.depth(point), [1.3], atol=1e-5)
    with open(os.path.join(folder, "fused.ply"), "rb") as stream:
        numbers = np.frombuffer(re.split(b"end_header\r?\n", stream.read(), maxsplit=1)[1][:24], dtype="<f4")
    np.testing.assert_allclose(numbers, [*point[0], 0.36, -0.48, 0.8], atol=1e-5)


@pytest.mark.parametrize("kind", ("urban", "mountains"))
@pytest.mark.slow
def test_fusion_of_true_depths_is_the_true_surface(request, made, kind, tmp_path):
    truth = request.getfixturevalue(kind)
    scene, tile = true_frame(truth, 60.0 if kind == "urban" else 120.0)
    images = [np.full(view.size[::-1], 0.5, dtype=np.float32) for view in tile.views]
    names = [view.view.name for view in tile.views]
    folder = str(tmp_path)
    write_workspace(folder, scene, tile, images, {name: [other for other in names if other != name] for name in names})
    for index, view in enumerate(tile.views):
        write_maps(folder, index, view, depths_of(scene, tile, view, true_heights(scene, tile, view, truth)))
    points = fused(folder)
    ground = scene.frame.to_geodetic(ProjectiveFrame(np.linalg.inv(tile.frame.matrix)).from_enu(points))
    x, y = projected_from_geodetic(scene.crs, ground).T
    error = ground[:, 2] - surface_at(truth, x, y)
    error = error[np.isfinite(error)]
    nmad = 1.4826 * np.median(np.abs(error - np.median(error)))
    assert len(error) > 0.4 * tile.views[0].size[0] * tile.views[0].size[1]
    assert nmad < 0.05 and abs(np.median(error)) < 0.05
