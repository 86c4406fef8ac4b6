"""The shifts of several scenes together: what sources say of them by hand calculation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.records import GroundShift
from repm_qgis.planning.height_uncertainty import usual_height_deviation
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.planning.promises import promised
from repm_qgis.registration.adjustment import Observation, contradictions, place_scenes
from repm_qgis.registration.laying import prior_of
from repm_qgis.registration.parameters import REGISTRATION
from repm_qgis.registration.solve import Prior, Shift
from repm_qgis.scene import Scene

PRIOR = Prior(8.0, 5.0, 60.0)


def shift(moved, deviations=(0.2, 0.3, 0.1), tilt=(0.0, 0.0), determined=((1.0, 0.0), (0.0, 1.0))):
    covariance = np.diag(np.array([*deviations, 1e-3, 2e-3]) ** 2)
    none = np.empty(0)
    return Shift(GroundShift(moved, tilt), covariance, np.reshape(determined, (-1, 2)), none, none, none, none, 10.0)


def placed(*observations, count=1):
    return place_scenes([(0.0, 0.0)] * count, [PRIOR] * count, observations)


def test_one_reference_is_taken_as_it_is():
    (found,) = placed(Observation.of_shift("dem", shift((3.0, -4.0, 2.0), tilt=(1e-4, -2e-4)), 0))
    assert found.ground.moved == pytest.approx((3.0, -4.0, 2.0)) and found.ground.tilt == pytest.approx((1e-4, -2e-4))
    assert found.deviations == pytest.approx([0.2, 0.3, 0.1]) and len(found.determined) == 2


def test_two_references_count_by_their_inverse_variances():
    first, second = shift((1.0, 0.0, 5.0)), shift((1.3, 0.2, 5.1), (0.4, 0.3, 0.2))
    (found,) = placed(Observation.of_shift("a", first, 0), Observation.of_shift("b", second, 0))
    assert found.ground.moved == pytest.approx((1.0 + 0.3 / 5, 0.1, 5.0 + 0.1 / 5))
    wanted = [(1 / 0.04 + 1 / 0.16) ** -0.5, 0.3 / 2**0.5, (1 / 0.01 + 1 / 0.04) ** -0.5]
    assert found.deviations == pytest.approx(wanted)
    assert found.ground.tilt == (0.0, 0.0)


def test_what_nobody_tells_stays_with_the_promised_uncertainty():
    (found,) = placed(Observation.of_shift("dem", shift((3.0, 0.0, 2.0), determined=((1.0, 0.0),)), 0))
    assert found.ground.moved == pytest.approx((3.0, 0.0, 2.0), abs=1e-9)
    assert found.deviations == pytest.approx([0.2, 8.0, 0.1]) and np.abs(found.determined) == pytest.approx(
        np.array([[1.0, 0.0]])
    )
    (alone,) = placed(Observation.of_control(np.diag([0.0, 0.0, 4.0]), 0))
    assert alone.deviations == pytest.approx([8.0, 8.0, 0.5]) and len(alone.determined) == 0
    assert not alone.covariance[3:].any(), "a scene that nobody tilts lies level"


def test_what_rounding_leaves_of_an_information_tells_nothing():
    control = Observation.of_control(np.diag([1e-12, 1e-11, 4.0]), 0)
    assert np.abs(control.basis).tolist() == [[0.0], [0.0], [1.0], [0.0], [0.0]] and control.covariance == 0.25


def test_an_overlap_hands_a_reference_on():
    """The second scene lies where the first one does, as uncertain as the reference and the overlap together."""
    told = Observation.of_shift("dem", shift((3.0, -4.0, 2.0)), 0)
    overlap = Observation.of_shift("overlap", shift((1.0, 1.0, 0.5), (0.1, 0.1, 0.1)), 1, 0)
    first, second = placed(told, overlap, count=2)
    assert first.ground.moved == pytest.approx((3.0, -4.0, 2.0))
    assert second.ground.moved == pytest.approx((4.0, -3.0, 2.5))
    assert second.deviations == pytest.approx(np.hypot([0.2, 0.3, 0.1], 0.1))


def test_without_a_reference_the_scenes_move_as_little_as_possible():
    overlap = Observation.of_shift("overlap", shift((2.0, -4.0, 1.0), (0.1, 0.1, 0.1)), 0, 1)
    first, second = placed(overlap, count=2)
    assert first.ground.moved == pytest.approx((1.0, -2.0, 0.5)) and second.ground.moved == pytest.approx(
        (-1.0, 2.0, -0.5)
    )
    # What both share is as uncertain as promised: half of the variance is each one's own.
    assert first.deviations[0] == pytest.approx(np.sqrt(0.1**2 / 4 + 8.0**2 / 2))


def test_control_points_keep_the_place_that_they_gave():
    control = Observation.of_control(np.diag([25.0, 100.0, 4.0]), 0)
    (found,) = placed(control)
    assert found.ground.moved == (0.0, 0.0, 0.0) and found.deviations == pytest.approx([0.2, 0.1, 0.5])
    assert control.source == "the ground control points" and control.second == -1


@pytest.mark.parametrize(("up", "named"), ((1.04, False), (1.06, True), (-1.06, True)))
def test_contradictions_are_beyond_three_deviations_of_both(up, named):
    """0.19 and 0.25 m: three deviations of their difference are 0.94 m, and a tenth of a metre is forgiven."""
    assert REGISTRATION.contradiction == 3.0 and REGISTRATION.least_contradiction_m == 0.1
    first = Observation.of_shift("dem", shift((0.0, 0.0, 0.0), (0.2, 0.2, 0.19)), 0)
    second = Observation.of_shift("lidar", shift((0.1, 0.1, up), (0.2, 0.2, 0.25)), 0)
    found = contradictions([first, second])
    assert len(found) == named and all("in height" in text and "dem" in text and "lidar" in text for text in found)
    elsewhere = Observation.of_shift("lidar", shift((0.0, 0.0, 50.0)), 1)
    between = Observation.of_shift("overlap", shift((0.0, 0.0, 50.0)), 0, 1)
    assert contradictions([first, elsewhere, between]) == []


def test_only_what_both_tell_can_contradict():
    east = shift((0.0, 0.0, 0.0), determined=((1.0, 0.0),))
    far = shift((0.0, 40.0, 0.0))
    assert contradictions([Observation.of_shift("a", east, 0), Observation.of_shift("b", far, 0)]) == []
    (text,) = contradictions([Observation.of_shift("a", far, 0), Observation.of_shift("b", shift((0.0, 0.0, 0.0)), 0)])
    assert "to the north" in text and "40" in text


def test_what_is_known_before_is_what_vendors_promise_and_what_is_usual(urban_run):
    scene = Scene.load(urban_run.result.scene)
    horizontal, up = promised(scene.views)
    usual = usual_height_deviation(scene.pairs, scene.pointing, scene.gsd_m)
    assert usual < up and prior_of(scene).up_m == usual and prior_of(scene).horizontal_m == horizontal
    controlled = replace(scene.pointing, height_uncertainty_m=None, control_information=np.eye(3))
    assert prior_of(replace(scene, pointing=controlled)).up_m == up == prior_of(replace(scene, pointing=None)).up_m
    reach = REGISTRATION.search * PLANNING.promises.ce90 * horizontal
    assert prior_of(scene).most_m == pytest.approx(max(reach, 40.0))
    near = replace(REGISTRATION, least_search_m=1e4)
    assert prior_of(scene, parameters=near).most_m == 1e4
