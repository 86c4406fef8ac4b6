"""Control points whose heights are wrong as a whole are named, with the unit or the datum that explains it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.geometry.height_causes import geoid_height, likely_cause
from repm_qgis.pointing.control_heights import heights_off
from repm_qgis.pointing.ground_control import Gcp
from repm_qgis.scene import Scene, middle_of

PLACE = (144.97, -37.81)  # where the geoid lies 4.7 m above the ellipsoid


@pytest.fixture(scope="module")
def controlled(urban_run):
    """A scene, and points that lie exactly where its RPCs see them."""
    scene = Scene.load(urban_run.result.scene)
    lon, lat = middle_of(scene.views)
    height = sum(scene.altitudes) / 2
    points = []
    for number, (east, north) in enumerate(np.random.default_rng(0).uniform(-2e-4, 2e-4, (6, 2))):
        place = np.array([lon + east, lat + north, height])
        pixels = {view.name: view.model.project(place) for view in scene.views}
        points.append(Gcp(f"G{number}", *map(float, place), "control", pixels))
    return scene, points


@pytest.mark.parametrize(
    ("change", "words"),
    (
        (lambda height: height, None),
        (lambda height: height + 2.0, None),
        (lambda height: height / 0.3048, "in feet and were read as metres"),
        (lambda height: height * 0.3048, "in metres and were read as feet"),
        (lambda height: height + 400.0, "Check the unit of their heights and GCP_DATUM"),
    ),
)
def test_heights_of_points_are_compared_with_the_rpcs(controlled, change, words):
    scene, points = controlled
    wrong = [replace(gcp, height=change(gcp.height)) for gcp in points]
    found = heights_off(wrong, scene.views, scene.pairs, scene.pointing)
    assert (found is None) == (words is None)
    assert words is None or (words in found and found.id == "gcp-heights-off")
    assert heights_off([replace(gcp, role="check") for gcp in wrong], scene.views, scene.pairs, scene.pointing) is None


def test_points_above_a_geoid_are_named(controlled):
    scene, points = controlled
    above = geoid_height("EGM2008", *middle_of(scene.views))
    above = geoid_height("EGM96", *middle_of(scene.views)) if np.isnan(above) else above
    if np.isnan(above):
        pytest.skip("PROJ has no geoid's grid")
    wrong = [replace(gcp, height=gcp.height - above) for gcp in points]
    found = heights_off(wrong, scene.views, scene.pairs, scene.pointing)
    assert "above the geoid" in found and f"{abs(above):.1f} m" in found


def test_a_cause_explains_nearly_all_of_an_offset():
    assert "in feet" in likely_cause(-0.6952 * 300.0, 300.0, *PLACE, 3.0)
    assert likely_cause(-0.6952 * 300.0 + 4.0, 300.0, *PLACE, 3.0) == ""
    assert likely_cause(0.5, 0.0, *PLACE, 3.0) == ""
    above = geoid_height("EGM96", *PLACE)
    if np.isfinite(above):
        assert above == pytest.approx(4.67, abs=0.1)
        assert "above the geoid" in likely_cause(4.6, 25.0, *PLACE, 1.0)
        assert "read as above the geoid" in likely_cause(-4.6, 0.0, *PLACE, 1.0)
