"""Gaps beside a block on level ground, seen by two views: what each pixel really shows is known."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.matching.occlusions import fill_occlusions

WEST, EAST, TALL = 60.0, 90.0, 20.0  # the block, m; a pixel is a metre
COLUMNS = np.arange(160.0)


def seen(lean):
    """(N,) height that each pixel of a view shows, whose columns move by ``lean`` px for each metre of height."""
    height = np.zeros(len(COLUMNS))
    for z in np.arange(0.0, TALL + 0.005, 0.01):
        x = COLUMNS - lean * z
        height = np.where((x > WEST) & (x < EAST), np.maximum(height, z), height)
    return height


def shown(x, height, lean):
    """Whether a view with this lean sees points: nothing stands above them on their line of sight."""
    free = np.ones(len(x), dtype=bool)
    for up in np.arange(0.3, TALL + 0.5, 0.05):
        at = x - lean * up
        free &= ~((at > WEST) & (at < EAST) & (height + up < TALL))
    return free


def pair_of(first, second):
    """Disparities of the first view where the second sees the same, and what the first really shows."""
    height = seen(first)
    both = shown(COLUMNS - first * height, height, second)
    disparity = np.where(both, (first - second) * height, np.nan).astype(np.float32)
    return np.repeat(disparity[None], 30, axis=0), height


@pytest.mark.parametrize("first, second", ((0.5, 0.0), (0.0, 0.5), (0.25, -0.25), (0.4, -0.2), (-0.1, 0.5)))
@pytest.mark.parametrize("mirrored", (False, True))
def test_hidden_ground_is_filled_and_walls_are_not(first, second, mirrored):
    first, second = (-first, -second) if mirrored else (first, second)
    disparity, height = pair_of(first, second)
    height_sign, displacement = np.sign(first - second), first / (first - second)
    filled = fill_occlusions(disparity, height_sign, displacement)[15]
    gap = np.isnan(disparity[15])
    wall, ground = gap & (height > 0.5) & (height < TALL - 0.5), gap & (height == 0)
    # Two pixels for where an edge falls within one.
    assert np.isnan(filled[wall]).sum() >= wall.sum() - 2 and np.isfinite(filled[ground]).sum() >= ground.sum() - 2
    assert np.nanmax(np.abs(filled[ground]), initial=0.0) == 0.0
    assert wall.sum() == pytest.approx(abs(first) * TALL, abs=2) and ground.sum() == pytest.approx(
        abs(second) * TALL, abs=2
    )


def test_without_its_lean_the_wall_would_be_ground():
    """Which lies under the roof then: what the lean is asked for."""
    disparity, height = pair_of(0.5, 0.0)
    wall = np.isnan(disparity[15]) & (height > 1.0) & (height < TALL - 1.0)
    assert wall.sum() >= 7 and (fill_occlusions(disparity, 1.0)[15][wall] == 0.0).all()


def test_where_surfaces_meet_a_gap_takes_what_its_pixels_say():
    """Right of a block that leans to the right, the ground is hidden from the first view: a gap there is a failure."""
    true = np.repeat((0.5 * seen(0.5)).astype(np.float32)[None], 30, axis=0)
    edge = np.flatnonzero(true[15] > 5)[-1]
    gappy = true.copy()
    gappy[5:25, edge - 3 : edge + 4] = np.nan
    own = true + np.float32(0.8)
    np.testing.assert_array_equal(fill_occlusions(gappy, 1.0, 1.0, own), true)
    short = true.copy()
    short[5:25, edge - 3 : edge + 3] = np.nan
    unknown = np.full_like(true, np.nan)
    assert (fill_occlusions(short, 1.0, 1.0, unknown)[5:25, edge - 3 : edge + 3] == 0).all()
    assert np.isnan(fill_occlusions(gappy, 1.0, 1.0, unknown)[5:25, edge - 3 : edge + 4]).all()
