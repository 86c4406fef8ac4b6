"""Measuring control points by hand: predictions, residuals, and nothing that cannot be taken back."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.errors import InputTableError
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.pointing.gcp_measuring import GcpMeasuring, check_point
from repm_qgis.pointing.ground_control import read_gcps


@pytest.fixture
def measuring(urban):
    """A list with the truth scene's points, not measured yet."""
    found = GcpMeasuring(urban.views)
    for gcp in read_gcps(urban.made.gcps, None):
        found.add({"id": gcp.id, "lon": gcp.lon, "lat": gcp.lat, "height": gcp.height, "role": gcp.role})
    return found


def test_pixels_of_the_rpc_itself_have_no_residual(urban, measuring):
    gcp = measuring.points[0]
    for view in urban.views:
        measuring.measure(gcp.id, view.name, view.project(gcp.lon_lat_h))
    check = check_point(measuring.point(gcp.id), urban.views)
    assert check.distance_m < 1e-6 and check.largest_miss_px < 1e-6
    assert all(np.abs(residual).max() < 1e-9 for residual in check.residuals.values())


def test_a_click_on_a_higher_place_shows_as_an_offset_upwards_and_a_wrong_click_as_a_miss(urban, measuring):
    gcp = measuring.points[0]
    above = EnuFrame(gcp.lon, gcp.lat, gcp.height).to_geodetic(np.array([0.0, 0.0, 5.0]))
    for view in urban.views:
        measuring.measure(gcp.id, view.name, view.project(above))
    check = check_point(measuring.point(gcp.id), urban.views)
    np.testing.assert_allclose(check.offset, [0, 0, 5], atol=1e-3)
    assert check.largest_miss_px < 1e-3
    first = urban.views[0]
    measuring.measure(gcp.id, first.name, first.project(above) + [4.0, 0.0])
    assert check_point(measuring.point(gcp.id), urban.views).largest_miss_px > 0.5


def test_one_image_alone_has_a_residual_and_no_intersection(urban, measuring):
    gcp, view = measuring.points[0], urban.views[0]
    measuring.measure(gcp.id, view.name, view.project(gcp.lon_lat_h) + [1.5, -2.0])
    check = check_point(measuring.point(gcp.id), urban.views)
    np.testing.assert_allclose(check.residuals[view.name], [1.5, -2.0], atol=1e-9)
    assert check.offset is None and check.distance_m is None and not check.misses


def test_the_prediction_learns_the_pointing_error_from_the_other_points(urban, measuring):
    (first, second), view = measuring.points[:2], urban.views[1]
    np.testing.assert_allclose(measuring.predicted(second, view), view.project(second.lon_lat_h))
    measuring.measure(first.id, view.name, view.project(first.lon_lat_h) + [3.0, -7.0])
    np.testing.assert_allclose(measuring.predicted(second, view), view.project(second.lon_lat_h) + [3.0, -7.0])
    np.testing.assert_allclose(measuring.predicted(first, view), view.project(first.lon_lat_h))  # not from itself
    far = measuring.add({"id": "far", "lon": second.lon + 1, "lat": second.lat, "height": 0, "role": "check"})
    assert measuring.predicted(far, view) is None


def test_every_change_can_be_taken_back(urban, measuring):
    name, view = measuring.points[0].id, urban.views[0].name
    before = measuring.points
    measuring.measure(name, view, np.array([10.0, 20.0]))
    measuring.measure(name, view, np.array([11.0, 20.0]))
    measuring.skip(name, view)
    assert measuring.is_skipped(name, view) and view not in measuring.point(name).pixels
    measuring.undo()
    assert not measuring.is_skipped(name, view) and measuring.point(name).pixels[view][0] == 11.0
    measuring.edit(name, id="renamed", height=123.0)
    assert measuring.point("renamed").height == 123.0 and view in measuring.point("renamed").pixels
    measuring.remove("renamed")
    assert len(measuring.points) == len(before) - 1
    for _ in range(4):
        assert measuring.undo()
    assert measuring.points == before
    measuring.load([])
    measuring.undo()
    assert measuring.points == before
    assert not GcpMeasuring(urban.views).undo()


def test_what_is_saved_is_what_gcps_reads(urban, measuring, tmp_path):
    name = measuring.points[0].id
    for view in urban.views[:2]:
        measuring.measure(name, view.name, np.array([12.3456, 78.9012]))
    assert measuring.unsaved
    measuring.save(str(tmp_path / "points.csv"))
    assert not measuring.unsaved
    again = read_gcps(str(tmp_path / "points.csv"), urban.views)
    assert [gcp.id for gcp in again] == [gcp.id for gcp in measuring.points]
    assert {gcp.id: set(gcp.pixels) for gcp in again if gcp.pixels} == {name: {v.name for v in urban.views[:2]}}
    np.testing.assert_allclose(again[0].pixels[urban.views[0].name], [12.3456, 78.9012])
    for old, new in zip(measuring.points, again):
        assert old.role == new.role
        np.testing.assert_allclose(old.lon_lat_h, new.lon_lat_h, atol=1e-4)


@pytest.mark.parametrize(
    "fields, words",
    [({"id": ""}, "'id' is empty"), ({"lat": "north"}, "'lat' is 'north'"), ({"height": 1e6}, "give degrees")],
)
def test_what_a_table_could_not_hold_is_refused_in_a_sentence(measuring, fields, words):
    before = measuring.points
    with pytest.raises(InputTableError, match=words):
        measuring.edit(before[0].id, **fields)
    with pytest.raises(InputTableError, match="already a point"):
        measuring.edit(before[0].id, id=before[1].id)
    assert measuring.points == before


def test_new_points_get_names_that_are_free():
    measuring = GcpMeasuring()
    for _ in range(3):
        measuring.add({"id": measuring.new_name(), "lon": 2, "lat": 3, "height": 4, "role": "control"})
    measuring.remove("P02")
    assert measuring.new_name() == "P02"


def test_a_new_name_keeps_what_was_skipped(urban, measuring):
    (first, second), (here, there) = measuring.points[:2], [view.name for view in urban.views[:2]]
    measuring.skip(first.id, here)
    measuring.skip(second.id, there)
    measuring.edit(first.id, id="new")
    assert measuring._state.skipped == {("new", here), (second.id, there)}
    assert measuring.can_undo and measuring.undo()
    assert measuring._state.skipped == {(first.id, here), (second.id, there)}
