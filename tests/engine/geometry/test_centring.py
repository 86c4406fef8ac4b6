"""Cameras towards the middles of their images: another view from the same place, with square pixels."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.geometry.centring import centred, image_nodes
from repm_qgis.geometry.pinhole import PinholeCamera

R = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])  # straight down, rows run south
CAMERAS = {
    "principal point far outside": PinholeCamera(
        np.array([[1.4e6, 300.0, -250000.0], [0, 1.3e6, 180000.0], [0, 0, 1]]), R, -R @ np.array([0, 0, 7e5])
    ),
    "wide and turned": PinholeCamera(
        np.array([[1500.0, 20.0, 700.0], [0, 1300.0, 500.0], [0, 0, 1]]),
        R @ np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]),
        np.array([30.0, -40.0, 1000.0]),
    ),
}
SIZES = ((1200, 800), (500, 901))


@pytest.fixture(params=CAMERAS)
def camera(request):
    return CAMERAS[request.param]


def rays(camera, pixels):
    """(N, 3) unit directions in the world."""
    found = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.K @ camera.R).T
    return found / np.linalg.norm(found, axis=1, keepdims=True)


@pytest.mark.parametrize("size", SIZES)
def test_the_axis_goes_through_the_middle_and_the_centre_stays(camera, size):
    turned, _ = centred(camera, size)
    np.testing.assert_allclose(turned.centre, camera.centre, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(turned.R @ turned.R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turned.R) == pytest.approx(1.0)
    middle = np.array([[(size[0] - 1) / 2, (size[1] - 1) / 2]])
    np.testing.assert_allclose(turned.R[2], rays(camera, middle)[0], atol=1e-12)
    assert turned.K[0, 0] == turned.K[1, 1] > 0 and turned.K[0, 1] == turned.K[1, 0] == 0 and turned.K[2, 2] == 1


@pytest.mark.parametrize("size", SIZES)
def test_it_is_the_smallest_turn(camera, size):
    """The turn from one axis to the other has their angle and no rotation about them."""
    turned, _ = centred(camera, size)
    turn = turned.R @ camera.R.T
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    assert angle == pytest.approx(np.arccos(np.clip(turned.R[2] @ camera.R[2], -1, 1)), abs=1e-7)


@pytest.mark.parametrize("size", SIZES)
def test_the_new_image_holds_the_old_one_and_no_more(camera, size):
    turned, new_size = centred(camera, size)
    edge = np.linspace(0, 1, 41)
    around = np.concatenate([[(t, 0.0), (t, 1.0), (0.0, t), (1.0, t)] for t in edge]) * (np.array(size) - 1)
    seen = turned.project(turned.centre + 1000.0 * rays(camera, around))
    assert seen.min() > -0.01 and (seen.max(axis=0) < np.array(new_size) - 1 + 0.01).all()
    assert seen.min(axis=0).max() < 1.0 and (seen.max(axis=0) > np.array(new_size) - 2).all()


@pytest.mark.parametrize("size", SIZES)
def test_pixels_keep_their_area_at_the_middle(camera, size):
    turned, _ = centred(camera, size)
    middle = (np.array(size) - 1) / 2
    steps = middle + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]])
    seen = turned.project(turned.centre + 1000.0 * rays(camera, steps))
    assert abs(np.linalg.det([seen[0] - seen[1], seen[2] - seen[3]])) == pytest.approx(1.0, rel=1e-3)


def test_nodes_spread_over_the_image_with_its_corners():
    nodes = image_nodes((100, 50))
    assert nodes.shape == (81, 2) and len(np.unique(nodes, axis=0)) == 81
    assert nodes.min(axis=0).tolist() == [0, 0] and nodes.max(axis=0).tolist() == [99, 49]
    np.testing.assert_allclose(np.unique(nodes[:, 0]), np.arange(9) * 99 / 8)
    np.testing.assert_allclose(image_nodes((5, 3), 2), [[0, 0], [4, 0], [0, 2], [4, 2]])
