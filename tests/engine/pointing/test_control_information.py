"""How much ground control tells of a scene's place."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.pointing.control_information import control_information
from repm_qgis.pointing.ground_control import Gcp


def point(urban, name, role="control"):
    """A point that two views see."""
    rpc = urban.views[0].rpc
    place = np.array([rpc.lon_off, rpc.lat_off, 190.0])
    pixels = {view.name: view.project(place) for view in urban.views[:2]}
    return Gcp(name, *map(float, place), role, pixels)


def test_points_that_check_or_are_rejected_tell_nothing(urban):
    alone = control_information([point(urban, "A")], (), urban.views, 0.5)
    assert np.linalg.matrix_rank(alone) == 3 and (np.linalg.eigvalsh(alone) > 0).all()
    others = [point(urban, "check", "check"), point(urban, "wrong"), point(urban, "A")]
    np.testing.assert_array_equal(control_information(others, ("wrong",), urban.views, 0.5), alone)
    twice = control_information([point(urban, "A"), point(urban, "B")], (), urban.views, 0.5)
    np.testing.assert_allclose(twice, 2.0 * alone)
    np.testing.assert_allclose(control_information([point(urban, "A")], (), urban.views, 1.0), alone / 4.0)


def test_a_pixel_of_half_a_metre_tells_a_place_to_that(urban):
    """Two views, measured to one pixel: east and north are known to a pixel's ground over the root of two."""
    deviations = np.sqrt(np.diag(np.linalg.inv(control_information([point(urban, "A")], (), urban.views, 1.0))))
    gsd = urban.views[0].gsd_m
    assert deviations[0] == pytest.approx(gsd / np.sqrt(2.0), rel=0.3)
