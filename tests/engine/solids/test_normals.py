"""Normals of points on known planes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.solids.normals import normals
from repm_qgis.solids.parameters import SOLIDS

MIDDLE = np.array([654321.0, 4812345.0, 100.0])  # coordinates as large as UTM's lose small differences


def plane(across, up, count=400, noise=0.0):
    numbers = np.random.default_rng(3)
    u, v = numbers.uniform(-10, 10, (2, count, 1))
    points = MIDDLE + u * np.asarray(across) + v * np.asarray(up)
    return points + noise * numbers.standard_normal(points.shape)


def degrees(found, true):
    return np.degrees(np.arccos(np.clip(found @ np.asarray(true), -1, 1)))


SLOPE = np.array([-0.6, 0.0, 0.8])
SHADED = np.array([0.8, 0.6, 0.0])


def test_planes_and_walls_have_their_normals_towards_the_satellite():
    roof, wall = plane([0.8, 0, 0.6], [0, 1, 0]), plane([-0.6, 0.8, 0], [0, 0, 1])
    xyz, on_wall = np.vstack([roof, wall]), np.repeat([False, True], 400)
    for ray, side in (((0.3, 0.1), 1), ((-0.3, -0.1), -1)):
        found = normals(xyz, on_wall, ray)
        assert np.allclose(np.linalg.norm(found, axis=1), 1)
        assert degrees(found[:400], SLOPE).max() < 0.1
        assert degrees(found[400:], side * SHADED).max() < 0.1 and (found[400:, 2] == 0).all()


def test_points_of_walls_do_not_turn_the_ground_beside_them():
    ground, wall = plane([1, 0, 0], [0, 1, 0]), plane([0, 1, 0], [0, 0, 1])
    on_wall = np.repeat([False, True], 400)
    found = normals(np.vstack([ground, wall]), on_wall, (0.2, 0.0))
    assert degrees(found[:400], [0, 0, 1]).max() < 0.1
    mixed = normals(np.vstack([ground, wall]), np.zeros(800, bool), (0.2, 0.0))
    assert degrees(mixed[:400], [0, 0, 1]).max() > 30


def test_noise_turns_walls_about_the_vertical_only():
    found = normals(plane([-0.6, 0.8, 0], [0, 0, 1], noise=0.3), np.ones(400, bool), (0.3, 0.1))
    assert (found[:, 2] == 0).all() and np.median(degrees(found, SHADED)) < 15


@pytest.mark.parametrize("count", (0, 1, 15))
def test_too_few_points_have_the_line_of_sight(count):
    xyz = plane([1, 0, 0], [0, 1, 0])[:count]
    assert np.allclose(normals(xyz, np.zeros(count, bool), (0.75, 0.0)), [0.6, 0, 0.8])
    assert np.allclose(normals(xyz, np.ones(count, bool), (0.75, 0.0)), [1, 0, 0])
    assert np.allclose(normals(xyz, np.ones(count, bool), (0.0, 0.0)), [0, 0, 1])


def test_parts_do_not_change_them():
    xyz, wall = plane([0.8, 0, 0.6], [0, 1, 0], noise=0.1), np.zeros(400, bool)
    small = replace(SOLIDS.cloud, normals_at_once=37)
    assert np.array_equal(normals(xyz, wall, (0.1, 0.1)), normals(xyz, wall, (0.1, 0.1), small))
