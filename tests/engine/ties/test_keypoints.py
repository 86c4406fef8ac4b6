"""Keypoints lie where they are, whoever finds them; and a GPU that fails costs a warning and nothing else."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.planning.pair_selection import choose_pairs
from repm_qgis.pointing.pointing import point_views
from repm_qgis.runtime import environment
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.ties import keypoints
from repm_qgis.ties.keypoints import CPU_DETECTOR, ColmapSift, DetectorError, OpenCvSift
from repm_qgis.ties.tie_points import find_ties
from tests.engine.versions import needs_pycolmap_4

BOTH = (OpenCvSift(), ColmapSift("cpu"))
EACH = (BOTH[0], pytest.param(BOTH[1], marks=needs_pycolmap_4))


class BrokenGpu(ColmapSift):
    """COLMAP's detector on a device that answers at first and fails then."""

    def detect(self, grey, mask, most, choose=None):
        raise DetectorError("out of memory on device 0")


def blobs(places, size=128, sigma=4.0):
    rows, cols = np.indices((size, size))
    return (30 + sum(150 * np.exp(-((cols - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2)) for x, y in places)).astype(
        np.uint8
    )


@pytest.fixture(scope="module")
def grey(urban):
    pixels = gdal.Open(urban.images[0]).ReadAsArray()
    return (view_stretch(urban.images[0], 1).apply(pixels.astype(np.float32)) * 255).astype(np.uint8)


@pytest.fixture
def scene(urban, tmp_path, told):
    return Scene.load(run_stage("epmfit", {"images": urban.images, "workspace": str(tmp_path)}, told())["scene"])


@pytest.mark.parametrize("detector", EACH, ids=lambda d: d.name)
def test_blobs_are_found_at_their_middles(detector):
    places = np.array([(x, y) for x in (26.25, 63.0, 101.75) for y in (25.0, 64.25, 100.5)])
    found = detector.detect(blobs(places), np.ones((128, 128), np.uint8), 200)
    away = np.linalg.norm(found.points[None] - places[:, None], axis=2).min(axis=1)
    assert np.median(away) < 0.05 and away.max() < 0.25


@pytest.mark.parametrize("detector", EACH, ids=lambda d: d.name)
def test_keypoints_of_an_image(detector, grey):
    mask = np.zeros(grey.shape, np.uint8)
    mask[50:300, 100:350] = 1
    found = detector.detect(grey, mask, 2000)
    assert len(found.points) == len(found.strength) == len(found.descriptors) > 100
    assert (found.points > (99, 49)).all() and (found.points < (350, 300)).all()
    assert found.descriptors.shape[1] == 128 and found.descriptors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1, atol=1e-3)
    assert len(np.unique(found.points, axis=0)) == len(found.points)
    again = copy.deepcopy(detector).detect(grey, mask, 2000)
    np.testing.assert_array_equal(found.points, again.points)
    np.testing.assert_array_equal(found.descriptors, again.descriptors)


@needs_pycolmap_4
@pytest.mark.long
def test_both_detectors_count_pixels_alike(grey):
    ours, theirs = (d.detect(grey, np.ones(grey.shape, np.uint8), 4000).points for d in BOTH)
    offset = theirs[:, None] - ours[None]
    nearest = offset[np.arange(len(theirs)), np.linalg.norm(offset, axis=2).argmin(axis=1)]
    close = nearest[np.linalg.norm(nearest, axis=1) < 0.4]
    assert len(close) > 0.3 * len(theirs)
    assert np.abs(np.median(close, axis=0)).max() < 0.02


@needs_pycolmap_4
def test_an_empty_image_has_no_keypoints():
    for detector in BOTH:
        found = detector.detect(np.full((64, 64), 90, np.uint8), np.ones((64, 64), np.uint8), 100)
        assert found.points.shape == (0, 2) and found.descriptors.shape[0] == 0


@needs_pycolmap_4
def test_the_device_is_asked_in_a_process_of_its_own():
    assert keypoints.answers("cpu")
    assert not keypoints.answers("no such device")


@needs_pycolmap_4
def test_a_device_that_counts_pixels_otherwise_does_not_pass():
    class FromCorner(ColmapSift):
        def detect(self, *arguments):
            found = super().detect(*arguments)
            return replace(found, points=found.points + 0.5)

    assert keypoints.self_test(ColmapSift("cpu"))
    assert not keypoints.self_test(FromCorner("cpu"))


@pytest.mark.parametrize(
    "usable, answers, expected",
    ((False, True, CPU_DETECTOR), (True, False, CPU_DETECTOR), (True, True, ColmapSift("cuda"))),
)
def test_the_gpu_is_taken_where_one_answers(monkeypatch, usable, answers, expected):
    monkeypatch.setattr(environment, "cuda_usable", lambda: usable)
    monkeypatch.setattr(keypoints, "answers", lambda device, parameters: answers)
    assert keypoints.best_detector() == expected


def test_processes_that_share_a_gpu_are_few():
    assert ColmapSift("cuda").workers(16) == 4 and ColmapSift("cuda").workers(2) == 2
    assert ColmapSift("cpu").workers(16) == OpenCvSift().workers(16) == 16


@needs_pycolmap_4
def test_only_what_is_chosen_gets_the_descriptors_it_has_among_all(grey):
    mask = np.ones(grey.shape, np.uint8)
    for detector in BOTH:
        whole = detector.detect(grey, mask, 2000)
        part = detector.detect(grey, mask, 2000, lambda points, strength: np.flatnonzero(strength > 0)[::3])
        np.testing.assert_array_equal(part.points, whole.points[::3])
        np.testing.assert_array_equal(part.descriptors, whole.descriptors[::3])


def test_a_build_without_cuda_is_an_error_of_the_detector(grey):
    import pycolmap

    if pycolmap.has_cuda:
        pytest.skip("this pycolmap has CUDA")
    with pytest.raises(DetectorError, match="on the GPU failed"):
        ColmapSift("cuda").detect(grey, np.ones(grey.shape, np.uint8), 100)


@pytest.mark.parametrize("failure", (DetectorError("device lost"), EmptyResultError("no ties on 3 patches")))
def test_a_gpu_that_fails_is_told_once_and_the_cpu_goes_on(monkeypatch, told, failure):
    monkeypatch.setattr(keypoints, "best_detector", lambda parameters: ColmapSift("cuda"))
    asked, said = [], told()

    def work(detector):
        asked.append(detector)
        if len(asked) == 1:
            raise failure
        return "ties"

    assert keypoints.with_best_detector(work, said) == ("ties", CPU_DETECTOR)
    assert asked == [ColmapSift("cuda"), CPU_DETECTOR]
    assert len(said.warnings) == 1 and str(failure) in said.warnings[0]


def test_errors_on_the_cpu_are_not_tried_again(monkeypatch, told):
    monkeypatch.setattr(keypoints, "best_detector", lambda parameters: CPU_DETECTOR)
    said, asked = told(), []

    def work(detector):
        asked.append(detector)
        raise EmptyResultError("nothing")

    with pytest.raises(EmptyResultError):
        keypoints.with_best_detector(work, said)
    assert len(asked) == 1 and not said.warnings


@needs_pycolmap_4
@pytest.mark.long
def test_the_detector_is_recorded_and_colmaps_gives_ties_as_good(monkeypatch, scene):
    """The way of the GPU, with COLMAP's detector on the CPU in its place."""
    stretches = {view.name: view_stretch(view.image, view.band) for view in scene.views}
    pairs = choose_pairs(scene)
    monkeypatch.setattr(keypoints, "best_detector", lambda parameters: ColmapSift("cpu"))
    found = point_views(scene, pairs, stretches, model="shift", gcps=(), progress=Silent())
    assert found.figures.detector == "SIFT of COLMAP, on the CPU"
    assert found.figures.count > 60 and found.figures.after_px < 0.1


def test_a_gpu_that_breaks_while_it_works(monkeypatch, scene, told):
    stretches = {view.name: view_stretch(view.image, view.band) for view in scene.views}
    names = tuple(view.name for view in scene.views[:2])
    monkeypatch.setattr(keypoints, "best_detector", lambda parameters: BrokenGpu("cuda"))
    said = told()
    matches, detector = keypoints.with_best_detector(
        lambda best: find_ties(scene, [names], stretches, progress=Silent(), workers=1, detector=best), said
    )
    assert detector == CPU_DETECTOR and len(said.warnings) == 1 and "out of memory" in said.warnings[0]
    plain = find_ties(scene, [names], stretches, progress=Silent(), workers=1)
    np.testing.assert_array_equal(matches[0].first_px, plain[0].first_px)
