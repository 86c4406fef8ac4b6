"""Known cameras are found again: the fit and the factorisation against what was put in."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.errors import RpcInvalidError
from repm_qgis.geometry.pinhole import PinholeCamera, factorise, fit_projection


def rotation(*angles):
    result = np.eye(3)
    for axis, angle in enumerate(np.radians(angles)):
        i, j = [(1, 2), (0, 2), (0, 1)][axis]
        turn = np.eye(3)
        turn[[i, j], [i, j]] = np.cos(angle)
        turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
        result = turn @ result
    return result


def close_camera():
    """A wide camera a kilometre away: every parameter is well determined."""
    R = rotation(170.0, 12.0, 30.0)
    return PinholeCamera(
        np.array([[1500.0, 3.0, 700.0], [0, 1400.0, 500.0], [0, 0, 1]]), R, -R @ np.array([150.0, -200.0, 1000.0])
    )


def satellite():
    """Half a metre a pixel from 700 km, 20 degrees off nadir."""
    R = rotation(180.0 - 12.0, 16.0, 11.0)
    return PinholeCamera(
        np.array([[1.4e6, 250.0, 9000.0], [0, 1.395e6, 12000.0], [0, 0, 1]]), R, -R @ np.array([2.1e5, -1.4e5, 6.9e5])
    )


def ground(width, relief, count=500):
    return np.random.default_rng(5).uniform(-1, 1, (count, 3)) * [width, width, relief]


@pytest.mark.parametrize("camera", (close_camera(), satellite()), ids=("close", "satellite"))
def test_factorise_finds_k_r_t(camera):
    found = factorise(3.7 * camera.P / np.linalg.norm(camera.P[2, :3]))
    np.testing.assert_allclose(found.K, camera.K, rtol=1e-8, atol=1e-8 * camera.K[0, 0])
    np.testing.assert_allclose(found.R, camera.R, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.centre, camera.centre, rtol=1e-8)
    np.testing.assert_allclose(found.R @ found.R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found.R) == pytest.approx(1.0) and (np.diag(found.K) > 0).all() and found.K[2, 2] == 1


def test_fit_finds_a_known_camera():
    camera = close_camera()
    points = ground(300.0, 100.0)
    found = factorise(fit_projection(points, camera.project(points)))
    np.testing.assert_allclose(found.K, camera.K, rtol=1e-8, atol=1e-5)
    np.testing.assert_allclose(found.R, camera.R, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.centre, camera.centre, rtol=1e-8)
    assert (found.depth(points) > 0).all()
    np.testing.assert_allclose(found.depth(points), camera.depth(points), rtol=1e-8)


def test_fit_of_a_satellite_projects_as_it_does():
    """K and t trade places over a field of view of a degree: what must hold is every pixel."""
    camera = satellite()
    points = ground(9000.0, 300.0)
    P = fit_projection(points, camera.project(points))
    found = factorise(P)
    other = ground(9000.0, 300.0, 900)
    assert np.abs(found.project(other) - camera.project(other)).max() < 1e-6
    homogeneous = np.column_stack([other, np.ones(len(other))]) @ P.T
    assert np.abs(homogeneous[:, :2] / homogeneous[:, 2:] - camera.project(other)).max() < 1e-6
    assert np.linalg.norm(found.centre - camera.centre) < 1.0


def test_a_mirrored_image_still_projects_right():
    camera = close_camera()
    points = ground(300.0, 100.0)
    pixels = camera.project(points) * [1, -1]
    found = factorise(fit_projection(points, pixels))
    np.testing.assert_allclose(found.project(points), pixels, atol=1e-6)
    assert np.linalg.det(found.R) == pytest.approx(1.0) and (found.depth(points) > 0).all()
    assert found.K[1, 1] < 0 < found.K[0, 0]
    again = PinholeCamera.from_mapping(found.to_mapping())  # a scene with it can be read again
    np.testing.assert_array_equal(again.P, found.P)


def test_moved_and_straightened():
    camera, points = satellite(), ground(5000.0, 200.0, 20)
    np.testing.assert_allclose(camera.moved(100, 250).project(points), camera.project(points) - [100, 250], atol=1e-6)
    straight = camera.without_skew()
    assert straight.K[0, 1] == 0
    skew = camera.K @ np.linalg.inv(straight.K)
    np.testing.assert_allclose(
        straight.project(points) @ skew[:2, :2].T + skew[:2, 2], camera.project(points), atol=1e-6
    )
    again = PinholeCamera.from_mapping(camera.to_mapping())
    np.testing.assert_array_equal(again.P, camera.P)


def test_points_that_determine_nothing_are_refused():
    camera = close_camera()
    flat = ground(300.0, 0.0)
    with pytest.raises(RpcInvalidError, match="too small to determine a camera"):
        fit_projection(flat, camera.project(flat))
    line = ground(300.0, 100.0) * [1.0, 0.0, 0.0]
    with pytest.raises(RpcInvalidError, match="too small to determine a camera"):
        fit_projection(line, camera.project(line))
    points = ground(300.0, 100.0)
    pixels = camera.project(points)
    pixels[3] = np.nan
    with pytest.raises(RpcInvalidError, match="no finite pixels"):
        fit_projection(points, pixels)
    with pytest.raises(RpcInvalidError, match="singular"):
        factorise(np.array([[1.0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]]))
