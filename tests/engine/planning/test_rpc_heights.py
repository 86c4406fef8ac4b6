"""Ground outside the heights that the RPCs were made for: what it tells of the height, and where it tells nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.records import PairFigures, PointingFigures
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.planning.advice import absolute_height, advice
from repm_qgis.planning.height_uncertainty import height_uncertainty
from repm_qgis.planning.pair_selection import choose_pairs
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.planning.rpc_heights import outside_rpc_heights
from repm_qgis.pointing.pointing import point_views
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage

ROOM = PLANNING.rpc_heights.room_m
GROUND = (200.0, 210.0, 250.0)


def views_of(views, low, high, sensor="Pleiades 1A"):
    """The views with RPCs that say that they were made for these heights."""
    made = {"height_off": (low + high) / 2, "height_scale": (high - low) / 2}
    return [replace(view, rpc=replace(view.rpc, **made), sensor=sensor) for view in views]


def figures_of(views, ground, uncertain=0.0):
    names = [view.name for view in views]
    pairs = tuple(PairFigures((a, b), 40, 40, 0.0, 0.0, 0.0) for a, b in zip(names, names[1:]))
    shifts = {name: (0.0, 0.0) for name in names}
    made = PointingFigures(40, 0.0, 0.0, "shift", "", shifts, pairs, ground_m=ground)
    return replace(made, height_uncertainty_m=uncertain)


@pytest.fixture(scope="module")
def fitted(urban, tmp_path_factory):
    """The scene of the town's first two images, under true RPCs."""
    options = {"images": urban.images[:2], "workspace": str(tmp_path_factory.mktemp("fitted"))}
    scene = replace(Scene.load(run_stage("epmfit", options, Silent()).scene), refinement="polynomial")
    true = {view.name: view.rpc for view in urban.true_views}
    views = (replace(view, rpc=true[view.name], sensor="Pleiades 1A") for view in scene.views)
    return replace(scene, views=tuple(views))


def test_the_error_lies_between_what_brings_the_ground_back(urban):
    views = views_of(urban.views[:2], 400.0, 600.0)
    found = outside_rpc_heights(views, figures_of(views, GROUND))
    assert found is not None and (found.ground, found.rpc) == ((200.0, 250.0), (400.0, 600.0))
    # The lowest ground may lie under the RPCs' heights by the room, and the middle above them.
    assert (found.least_m, found.most_m) == (200.0 - ROOM, 390.0 + ROOM)
    views = views_of(urban.views[:2], 20.0, 120.0)
    found = outside_rpc_heights(views, figures_of(views, GROUND))
    assert found is not None and (found.least_m, found.most_m) == (90.0 - ROOM, 180.0 + ROOM)
    views = views_of(urban.views[:2], 80.0, 209.5 - ROOM)  # the middle half a metre above the room
    found = outside_rpc_heights(views, figures_of(views, GROUND))
    assert found is not None and found.least_m == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("low", "high"),
    (
        (190.0, 260.0),
        (200.0 + ROOM, 260.0),  # ground below them as far as that of good RPCs may lie
        (100.0, 210.0 - ROOM),  # and above
        (100.0, 185.0),  # a town whose roofs are higher than any terrain
        (1000.0, 2000.0),  # WorldView: 500 m, whatever the relief
        (1000.0, 2002.0),
        (215.0 + ROOM, 170.0 - ROOM + 50),  # too little room for the ground's relief
    ),
)
def test_nothing_is_told_where_it_may_be_right(urban, low, high):
    views = views_of(urban.views[:2], low, high)
    assert outside_rpc_heights(views, figures_of(views, GROUND)) is None
    stated, bare = (height_uncertainty(views, figures_of(views, ground)) for ground in (GROUND, None))
    assert stated == bare


def test_one_rpc_that_holds_the_ground_is_enough(urban):
    first, second = views_of(urban.views[:2], 400.0, 600.0)
    (own,) = views_of([second], 150.0, 300.0)
    assert outside_rpc_heights([first, second], figures_of([first, second], GROUND)) is not None
    assert outside_rpc_heights([first, own], figures_of([first, own], GROUND)) is None
    (default,) = views_of([second], 1000.0, 2000.0)
    assert outside_rpc_heights([first, default], figures_of([first, default], GROUND)) is None


@pytest.mark.parametrize("over", (1.0, 20.0, 100.0, 1000.0, 4000.0))
@pytest.mark.parametrize("span", (100.0, 2600.0))
def test_the_stated_deviation_holds_whatever_the_error_is(urban, over, span):
    """No possible error is more than three stated deviations, unless the heights leave much room: then 95 of 100."""
    low = GROUND[0] + ROOM + over
    views = views_of(urban.views[:2], low, low + span)
    figures = figures_of(views, GROUND)
    stated, without = (height_uncertainty(views, each) for each in (figures, replace(figures, ground_m=None)))
    assert stated.outside is not None and stated.outside.least_m == pytest.approx(over)
    assert stated.outside.least_m < 2 * stated.deviation_m < stated.outside.most_m
    assert stated.deviation_m > without.deviation_m
    if span == 100.0:
        assert stated.outside.most_m < 3 * stated.deviation_m


def test_it_is_a_warning_with_both_ranges_and_a_remedy(urban, fitted):
    views = views_of(urban.views[:2], 400.0, 600.0)
    scene = replace(fitted, views=tuple(views))
    figures = figures_of(views, GROUND, 123.4)
    (text,) = [said for said in advice(scene, [], figures) if "its RPCs were made" in said]
    for words in (
        "at 200 to 250 m, but its RPCs were made for 400 to 600 m",
        "uncertain by 101.5 m (LE90)",
        "DEM",
        "GCPS",
        "REFERENCE",
    ):
        assert words in text, text
    assert "ground lies outside the heights that they were made for" in absolute_height(views, figures)[2]
    # With ground control, a DEM, or ground inside, nothing is said.
    for fine in (replace(figures, height_uncertainty_m=None), replace(figures, ground_m=None)):
        assert not any("were made for" in said for said in (*advice(scene, [], fine), *absolute_height(views, fine)))


def pointed(scene, told):
    pairs, stretches = choose_pairs(scene), {view.name: view_stretch(view.image, view.band) for view in scene.views}
    found = point_views(scene, pairs, stretches, model="shift", gcps=[], progress=told())
    warned = [text for text in advice(scene, pairs, found.figures) if "its RPCs were made" in text]
    return float(np.median(found.adjusted.ground[:, 2])), found.figures.height_uncertainty_m / 2.0, warned


def test_an_rpc_that_is_wrong_along_the_parallax_is_warned_of(fitted, told):
    """Through tie points: heights that are far too small, no vertical parallax, and a deviation that holds them."""
    up, usual, warned = pointed(fitted, told)
    assert warned == []
    first, second = fitted.views
    place = np.array([fitted.frame.lon, fitted.frame.lat, up])
    apart = second.project(first.localise(first.project(place), up + 10.0)) - second.project(place)
    shift = -60.0 * apart / np.linalg.norm(apart)
    wrong = replace(fitted, views=(first, replace(second, rpc=second.rpc.shifted(*shift))))
    found, stated, warned = pointed(wrong, told)
    assert abs(found - up) > 3.0 * usual and abs(found - up) < 2.5 * stated and len(warned) == 1, (found, up, stated)
    # A DEM tells more than the RPCs' heights do: its offset is said with the finished surface.
    assert pointed(replace(wrong, dem="dem.tif"), told)[1:] == (pytest.approx(usual, rel=0.02), [])
