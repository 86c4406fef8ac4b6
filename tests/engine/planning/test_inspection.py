"""What images and RPCs alone say: places, overlaps, angles, and which pairs are worth matching."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal
from pyproj import Geod

from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.planning.advice import expected_accuracy_m
from repm_qgis.planning.inspection import CARE, NO, YES, inspect_views
from repm_qgis.planning.pair_selection import choose_pairs
from repm_qgis.scene import load_views


@pytest.fixture(scope="module")
def place(urban):
    (found,) = inspect_views(urban.views, 64)
    return found


def test_what_each_image_is(urban, place):
    """Against the truth: the sensors' own directions and the corners that their RPCs give."""
    for facts, view in zip(place.images, urban.views):
        lon, lat = geodetic_from_projected(place.crs, facts.outline).T
        corners = view.localise(np.array([[-0.5, -0.5], [view.width - 0.5, view.height - 0.5]]), place.altitude)
        for corner in corners:
            apart = Geod(ellps="WGS84").inv(lon, lat, np.full_like(lon, corner[0]), np.full_like(lat, corner[1]))[2]
            assert min(apart) < 0.01
        # A point that rises by 100 m moves away from the satellite's azimuth, by the tangent of the incidence.
        pixel = np.array([view.width / 2, view.height / 2])
        low, high = (view.localise(pixel, place.altitude + z) for z in (0.0, 100.0))
        azimuth, _, metres = Geod(ellps="WGS84").inv(low[0], low[1], high[0], high[1])
        assert np.degrees(np.arctan(metres / 100)) == pytest.approx(facts.incidence_deg, abs=0.05)
        if facts.incidence_deg > 1:
            assert abs((azimuth - facts.azimuth_deg + 180) % 360 - 180) < 0.5


def test_the_altitude_is_that_of_the_ground(urban, place):
    truth = gdal.Open(urban.truth).ReadAsArray()
    assert place.shown and place.altitude == pytest.approx(np.median(truth[truth > -9000]), abs=10)


def test_pairs_are_those_that_the_pipeline_takes(urban_run, place):
    from repm_qgis.scene import Scene

    scene = Scene.load(urban_run.result.scene)
    taken = {(pair.first, pair.second): pair for pair in choose_pairs(scene)}
    found = {(facts.pair.first, facts.pair.second): facts for facts in place.pairs}
    assert {names for names, facts in found.items() if facts.chosen} == set(taken)
    for names, pair in taken.items():
        assert found[names].pair.angle_deg == pytest.approx(pair.angle_deg, abs=0.05)
        assert found[names].pair.base_to_height == pytest.approx(pair.base_to_height, abs=0.002)
        smaller = min(view.width * view.height * view.gsd_m**2 for view in scene.views)
        assert found[names].ground.GetArea() == pytest.approx(found[names].percent / 100 * smaller, rel=0.05)


def test_the_pixels_that_a_pair_sees_are_its_ground_in_those_of_the_finest_image(place):
    pair = next(facts for facts in place.pairs if facts.chosen)
    finest = min(image.view.gsd_m for image in place.images if image.view.name in pair.pair.names)
    assert place.seen_px(pair.pair.names) == [pytest.approx(pair.ground.GetArea() / finest**2)]
    assert finest < 0.9, "else squares tell nothing"


def test_a_first_area_lies_in_the_best_pairs_overlap(place):
    from repm_qgis.geometry.footprints import box

    area = place.first_area()
    assert place.pairs[0].ground.Contains(box(area))
    assert 0.2 < (area.xmax - area.xmin) / np.sqrt(place.pairs[0].ground.GetArea()) < 0.501


def reasons(views, **changes):
    (place,) = inspect_views([replace(view, **changes.get(view.name, {})) for view in views], 64)
    return {(facts.pair.first, facts.pair.second): (facts.worth, facts.reason) for facts in place.pairs}


def at(moment):
    return {"acquired": moment}


def test_time_and_sun_make_a_pair_one_for_care(urban):
    pair = urban.views[:2]
    names = (pair[0].name, pair[1].name)
    assert reasons(pair)[names] == (YES, "angle and overlap fit, times are unknown")
    same = {view.name: at("2024-06-01T10:40:00Z") for view in pair}
    assert reasons(pair, **same)[names] == (YES, "angle, overlap and sun fit")
    later = {**same, names[1]: at("2024-06-01T15:40:00Z")}
    worth, why = reasons(pair, **later)[names]
    assert worth == CARE and "the sun stood" in why and "shadows do not match" in why
    other_year = {**same, names[1]: at("2022-06-01T10:40:00Z")}
    worth, why = reasons(pair, **other_year)[names]
    assert worth == CARE and why.startswith("731 days apart")


def test_two_images_from_one_direction_are_worth_nothing(urban):
    one = urban.views[0]
    (place,) = inspect_views([one, replace(one, name="again")], 64)
    (facts,) = place.pairs
    assert expected_accuracy_m(facts.pair, one.gsd_m) == np.inf and not place.shown
    assert (facts.worth, facts.chosen) == (NO, False) and "no heights" in facts.reason and facts.percent > 99.9
    assert place.first_area() is None


def test_a_strip_is_named_and_less_is_no_overlap(urban):
    one, two = urban.views[:2]
    for columns, count in ((0.8, 1), (0.99, 0)):
        moved = replace(two, rpc=two.rpc.shifted(-columns * two.width, 0.0))
        found = inspect_views([one, moved], 64)
        assert [len(place.pairs) for place in found] == ([1] if count else [0, 0])
        if count:
            pair = found[0].pairs[0]
            assert pair.worth == CARE and "% of the smaller image is shared" in pair.reason


def test_places_are_apart_also_across_the_date_line(urban, mountains, synthetic_rpc):
    """Two scenes far from each other; and two images that meet at 180 degrees, given as 179.99 and -179.99."""
    here = urban.views
    far = [replace(v, name=f"far_{v.name}", rpc=replace(v.rpc, lon_off=v.rpc.lon_off + 60)) for v in here[:2]]
    places = inspect_views([far[0], *here, far[1]], 64)
    assert [len(place.images) for place in places] == [3, 2] and [len(place.pairs) for place in places] == [3, 1]
    assert places[0].crs != places[1].crs
    first, second = here[:2]
    moved = 180 - first.rpc.lon_off
    pair = [
        replace(view, rpc=replace(view.rpc, lon_off=view.rpc.lon_off + moved - turn))
        for view, turn in ((first, 0), (second, 360))
    ]
    (place,) = inspect_views(pair, 64)
    (plain,) = inspect_views([first, second], 64)
    assert place.pairs[0].percent == pytest.approx(plain.pairs[0].percent, abs=0.5)
    assert place.pairs[0].pair.base_to_height == pytest.approx(plain.pairs[0].pair.base_to_height, abs=0.01)


def test_real_images_of_one_place(shared_data):
    views = load_views([str(path) for path in sorted((shared_data / "jax_068").glob("*RGB.tif"))])
    (place,) = inspect_views(views, 64)
    assert len(place.images) == 19 and len(place.pairs) == 171
    # The vendor's off-nadir angles are below 31 degrees, and the incidence is a tenth more.
    assert 5 < min(facts.incidence_deg for facts in place.images) < max(f.incidence_deg for f in place.images) < 36
    good = [facts for facts in place.pairs if facts.worth == YES]
    assert 10 < len(good) < 100 and good == list(place.pairs[: len(good)])
    assert all(0.1 <= facts.pair.base_to_height <= 0.9 for facts in good)
