"""Tie points of simulated views: true correspondences, and row differences that go away with the shifts found."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.errors import EmptyResultError
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.mvs.pairing import rectified_pair
from repm_qgis.scene import Scene
from repm_qgis.sfm.adjustment import adjust, tracks_from
from repm_qgis.sfm.tie_points import find_ties
from repm_qgis.stages import run_stage


@pytest.fixture(scope="module", params=("urban", "mountains"))
def found(request, tmp_path_factory, told):
    """The truth scene, its REPM scene, and the ties of its pairs."""
    truth = request.getfixturevalue(request.param)
    folder = tmp_path_factory.mktemp("ties")
    result = run_stage("epmfit", {"images": truth.images, "workspace": str(folder)}, told())
    scene = Scene.load(result["scene"])
    stretches = {view.name: view_stretch(view.image, view.band) for view in scene.views}
    names = [view.name for view in scene.views]
    return truth, scene, find_ties(scene, [(names[0], names[1]), (names[1], names[2])], stretches, told()), stretches


def epipolar(truth, match):
    """Distance of the second pixel from the true epipolar line of the first, px: needs no surface."""
    first, second = (next(v for v in truth.true_views if v.name == name) for name in (match.first, match.second))
    low, high = truth.height_range
    ends = [second.rpc.project(first.rpc.localise(match.first_px, np.full(len(match.first_px), h))) for h in (low,
                                                                                                              high)]
    along = ends[1] - ends[0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    offset = match.second_px - ends[0]
    return offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0]


def test_ties_are_true(found):
    truth, _, matches, _ = found
    for match in matches:
        distance = epipolar(truth, match)
        assert len(distance) > 150
        assert np.median(np.abs(distance)) < 0.25
        assert abs(np.median(distance)) < 0.1
        assert (np.abs(distance) > 2.0).mean() < 0.02


def test_the_shifts_bring_rows_together(found):
    """Random points of space, seen by the true sensors, lie on one row once the views have their shifts."""
    truth, scene, matches, _ = found
    adjusted = adjust(scene.views, tracks_from(matches), sum(scene.altitudes) / 2)
    views = {view.name: view.with_pointing(np.column_stack([np.eye(2), adjusted.shifts[view.name]]))
             for view in scene.views}
    tile = scene.tiles[0]
    numbers = np.random.default_rng(6)
    points = np.column_stack([truth.true_views[1].localise(numbers.uniform(40, 360, (500, 2)), 0.0)[:, :2] * 0,
                              numbers.uniform(*scene.altitudes, 500)])
    points = truth.true_views[1].localise(numbers.uniform(40, 360, (500, 2)), points[:, 2])
    for match in matches:
        pair = rectified_pair(scene, views[match.first], views[match.second], tile.bounds, tile.altitudes)
        true = {view.name: view for view in truth.true_views}
        rows = (pair.first_rectified(true[match.first].project(points))[:, 1]
                - pair.second_rectified(true[match.second].project(points))[:, 1])
        assert np.median(np.abs(rows)) < 0.1  # the issue asks for 0.3
        before = rectified_pair(scene, *(scene.view(n) for n in (match.first, match.second)), tile.bounds,
                                tile.altitudes)
        raw = (before.first_rectified(true[match.first].project(points))[:, 1]
               - before.second_rectified(true[match.second].project(points))[:, 1])
        assert np.median(np.abs(rows)) < np.median(np.abs(raw))


def test_the_same_every_time(found, told):
    import cv2

    truth, scene, matches, stretches = found
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        again = find_ties(scene, [(m.first, m.second) for m in matches], stretches, told())
    finally:
        cv2.setNumThreads(threads)
    for a, b in zip(matches, again):
        np.testing.assert_array_equal(a.first_px, b.first_px)
        np.testing.assert_array_equal(a.second_px, b.second_px)


def test_too_few_ties_are_an_error_with_the_counts(found, told, tmp_path, write_image):
    """A view of noise: nothing in it is anywhere else."""
    truth, scene, matches, stretches = found
    noise = np.random.default_rng(0).integers(100, 1000, (400, 400)).astype(np.uint16)
    other = write_image(tmp_path / "noise.tif", noise, truth.views[1].rpc)
    blind = Scene([scene.views[0], scene.views[1].__class__(**{**vars(scene.views[1]), "image": other})], scene.frame,
                  scene.crs, scene.area, scene.altitudes, scene.tiles)
    names = [view.name for view in blind.views]
    with pytest.raises(EmptyResultError) as caught:
        find_ties(blind, [tuple(names)], {name: stretches[name] for name in names}, told())
    assert all(name in str(caught.value) for name in names) and "needed: 12" in str(caught.value)
