"""Which pairs are matched."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from osgeo import ogr

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.contracts.records import ViewPair
from repm_qgis.geometry.footprints import bounds_of, footprint, geometry_of, seen_twice
from repm_qgis.geometry.frames import EnuFrame, projected_from_geodetic, utm_crs
from repm_qgis.imagery.acquisition import moment, time_of_name
from repm_qgis.planning.pair_selection import (
    best_pairs,
    change_cost,
    choose_pairs,
    days_off_season,
    is_good,
    pair_cost,
    places_seen,
    sun_over,
    usual_change,
)
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.rpc.readers import read_rpc_file
from repm_qgis.scene import Scene, Tile, View
from repm_qgis.stereo.pairing import convergence

NOON = datetime(2012, 6, 20, 12, 0, tzinfo=timezone.utc)


def scene_of(views, urban):
    lon, lat = views[0].rpc.lon_off, views[0].rpc.lat_off
    tile = Tile("r000c000", urban.bounds, (150.0, 250.0), {view.name: None for view in views})
    return Scene(list(views), EnuFrame(lon, lat), urban.crs, "", (150.0, 250.0), [tile])


def named(view, name, days=None):
    return replace(view, name=name, acquired="" if days is None else (NOON + timedelta(days=days)).isoformat())


@pytest.fixture(scope="module")
def melbourne(shared_data):
    """17 full scenes of one pass: RPCs, and times from the files' names; one tile over what two of them see."""
    views = []
    for path in sorted((shared_data / "rpc" / "pleiades").glob("melbourne__*.XML")):
        rpc = read_rpc_file(str(path))
        taken = moment(time_of_name(path.name.partition("__")[2]))
        views.append(
            View(
                path.stem[-8:],
                "",
                1,
                round(2 * rpc.col_off),
                round(2 * rpc.row_off),
                rpc,
                0.7,
                acquired=taken.isoformat(),
            )
        )
    lon, lat = (float(np.median([getattr(view.rpc, name) for view in views])) for name in ("lon_off", "lat_off"))
    crs = utm_crs(lon, lat)
    area = seen_twice([[projected_from_geodetic(crs, footprint(v.localise, v.size, 50.0)) for v in views]])
    tile = Tile("r000c000", bounds_of(area), (0.0, 100.0), {view.name: None for view in views})
    return Scene(views, EnuFrame(lon, lat), crs, area.ExportToWkt(), (0.0, 100.0), [tile])


def connected(pairs, names):
    group = {names[0]}
    for _ in names:
        for pair in pairs:
            if {pair.first, pair.second} & group:
                group |= {pair.first, pair.second}
    return group == set(names)


def test_convergence_is_the_angle_between_the_looks(urban):
    """Rays from the middle up, in ECEF, by another path than ENU."""
    from repm_qgis.geometry.frames import ecef_from_geodetic

    a, b = urban.true_views[0], urban.true_views[2]
    place = a.localise(np.array([200.0, 200.0]), 200.0)
    rays = []
    for view in (a, b):
        pixel = view.project(place)
        ends = ecef_from_geodetic(view.localise(np.array([pixel, pixel]), np.array([190.0, 210.0])))
        rays.append((ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]))
    angle, ratio = convergence(a, b, place[0], place[1], 200.0)
    assert angle == pytest.approx(np.degrees(np.arccos(rays[0] @ rays[1])), abs=1e-3)
    looks = urban.record["views"]
    slopes = np.tan(np.radians([look["pitch_deg"] for look in looks]))
    assert ratio == pytest.approx(abs(slopes[0] - slopes[2]), rel=0.25)


@pytest.mark.parametrize("days", [(None, None, None), (0.0, 400.0, 183.0)])
def test_three_views_make_three_pairs_whatever_their_times(urban, days):
    views = [named(view, view.name, day) for view, day in zip(urban.views, days)]
    pairs = choose_pairs(scene_of(views, urban))
    assert [(p.first, p.second) for p in pairs] == [
        (p.first, p.second) for p in choose_pairs(scene_of(urban.views, urban))
    ]
    assert len(pairs) == 3
    ratios = [abs(np.log(pair.base_to_height / 0.35)) for pair in pairs]
    assert ratios == sorted(ratios)


def test_many_views_stay_few_pairs_and_connected(urban):
    views = [named(urban.views[i % 3], f"v{i}") for i in range(9)]
    pairs = choose_pairs(scene_of(views, urban))
    assert len(pairs) <= 3 * 9 / 2 and all(pair.base_to_height >= 0.05 for pair in pairs)
    assert connected(pairs, [view.name for view in views])


def test_views_from_the_same_place_are_refused_with_their_angle(urban):
    with pytest.raises(EmptyResultError, match="again: 0.0 degrees"):
        choose_pairs(scene_of([urban.views[0], named(urban.views[0], "again")], urban))


def test_a_block_of_narrow_frames_is_refused_in_one_short_sentence_with_its_widest_angle():
    """As PlanetScope's frames of one pass: they look straight down, side by side."""
    names = [f"f{number}" for number in range(20)]
    narrow = [
        ViewPair(a, b, 0.05 * (j - i), 0.00087 * (j - i), 1)
        for i, a in enumerate(names)
        for j, b in enumerate(names)
        if i < j
    ]
    with pytest.raises(EmptyResultError) as refused:
        best_pairs(narrow, {}, names)
    text = str(refused.value)
    assert "(f0 and f19: 1.0 degrees" in text and "and 184 more): choose images with" in text and len(text) < 320


def test_seventeen_real_views(melbourne):
    pairs = choose_pairs(melbourne)
    names = [view.name for view in melbourne.views]
    every = [
        convergence(a, b, melbourne.frame.lon, melbourne.frame.lat, 50.0)[0]
        for i, a in enumerate(melbourne.views)
        for b in melbourne.views[i + 1 :]
    ]
    assert len(names) == 17 and min(every) < 6 and max(every) > 90  # there is much to choose wrongly
    assert all(PLANNING.pairs.narrow < pair.base_to_height < PLANNING.pairs.wide for pair in pairs)
    assert sorted(pair.angle_deg for pair in pairs)[1] > 12 and max(pair.angle_deg for pair in pairs) < 32
    count = Counter(name for pair in pairs for name in (pair.first, pair.second))
    assert set(count) == set(names) and min(count.values()) >= 2 and max(count.values()) <= 4
    assert connected(pairs, names) and pairs == choose_pairs(melbourne)
    assert all(pair.days < 100 / 86400 and pair.sun_deg < 0.5 and 0.4 < pair.share < 0.8 for pair in pairs)
    # The summer sun of Melbourne at 11.24 in the morning stands high in the north-east.
    azimuth, elevation = sun_over(melbourne, melbourne.views[0])
    assert 30 < azimuth < 70 and 45 < elevation < 60
    scores = [pair_cost(pair) for pair in pairs]
    assert scores == sorted(scores)


def test_the_order_of_the_images_does_not_choose(melbourne):
    chosen = {frozenset((pair.first, pair.second)) for pair in choose_pairs(melbourne)}
    turned = replace(melbourne, views=melbourne.views[::-1])
    assert {frozenset((pair.first, pair.second)) for pair in choose_pairs(turned)} == chosen


@pytest.fixture(scope="module")
def twice(melbourne):
    """The same 17 looks half a year later, under another sun."""
    later = [
        replace(view, name=f"later_{view.name}", acquired=(view.time + timedelta(days=183)).isoformat())
        for view in melbourne.views
    ]
    views = (*melbourne.views, *later)
    tile = replace(melbourne.tiles[0], views={view.name: None for view in views})
    return replace(melbourne, views=views, tiles=(tile,))


NO_MORE = replace(PLANNING.pairs, uncovered=1.0)  # without pairs for ground that no other one covers


@pytest.mark.long
def test_ground_that_no_pair_covers_gets_one(melbourne):
    """The two best pairs of each image leave out a seventh of what good pairs of Melbourne's images see."""
    few, pairs = choose_pairs(melbourne, NO_MORE), choose_pairs(melbourne)
    added = [pair for pair in pairs if pair not in few]
    assert len(added) == 1 and all(is_good(pair) for pair in added) and len(pairs) == len(few) + 1
    # Its images have ties in better pairs: too few in this one must not stop the run.
    assert [pair for pair in pairs if not pair.tied] == added
    outlines = {
        view.name: projected_from_geodetic(melbourne.crs, footprint(view.localise, view.size, 50.0))
        for view in melbourne.views
    }
    seen = places_seen(outlines, melbourne.tiles[0].bounds)

    def covered(chosen):
        return np.any([seen[pair.first] & seen[pair.second] for pair in chosen], axis=0)

    gain = covered(pairs) & ~covered(few)
    assert gain.sum() > 0.1 * covered(pairs).sum()
    # No limit: whatever one more good pair would add is little.
    most = choose_pairs(melbourne, replace(PLANNING.pairs, uncovered=0.0))
    assert len(most) > len(pairs) and {pair.names for pair in pairs} <= {pair.names for pair in most}


def test_places_in_an_outline():
    """Against GDAL's own test of points in polygons, on an outline that is not convex."""
    outline = np.array([[0.0, 0.0], [10.0, 1.0], [4.0, 4.0], [9.0, 10.0], [-3.0, 8.0]])
    seen = places_seen({"a": outline}, Bounds(-4.0, -2.0, 12.0, 12.0))["a"].reshape(64, 64)
    shape = geometry_of(outline)
    for row in range(0, 64, 3):
        for column in range(0, 64, 3):
            place = ogr.Geometry(ogr.wkbPoint)
            place.AddPoint_2D(-4.0 + (column + 0.5) * 0.25, -2.0 + (row + 0.5) * 14.0 / 64)
            assert seen[row, column] == shape.Contains(place)


@pytest.mark.long
def test_pairs_that_no_view_needs_go_where_there_are_many(melbourne, twice):
    names = [view.name for view in twice.views]
    every = choose_pairs(twice, replace(NO_MORE, enough=np.inf))
    pairs = choose_pairs(twice, NO_MORE)
    gone = [pair for pair in every if pair not in pairs]
    assert len(gone) >= 3 and [pair for pair in every if pair in pairs] == pairs
    count = Counter(name for pair in pairs for name in (pair.first, pair.second))
    assert min(count[name] for name in names) >= 2 and connected(pairs, names)
    assert sum(pair.share for pair in pairs) >= PLANNING.pairs.enough
    # The best of those that went is no better than the worst that could have gone in its place.
    last = min(pair_cost(pair) for pair in gone)
    for pair in pairs:
        if pair_cost(pair) > last and min(count[pair.first], count[pair.second]) > 2:
            assert not connected([other for other in pairs if other is not pair], names)
    # Seventeen images cover the ground no more than enough.
    assert choose_pairs(melbourne, NO_MORE) == choose_pairs(melbourne, replace(NO_MORE, enough=np.inf))


@pytest.mark.long
def test_two_passes_are_matched_each_by_itself_and_joined_once(melbourne, twice):
    """Pairs are of one pass but where that connects them."""
    scene, pairs = twice, choose_pairs(twice, replace(NO_MORE, enough=np.inf))
    across = [pair for pair in pairs if pair.days > 1]
    assert len(across) == 1 and connected(pairs, [view.name for view in scene.views])
    assert 19 < across[0].sun_deg < 21 and 12 < across[0].angle_deg < 32
    assert len(pairs) == 2 * len(choose_pairs(melbourne, NO_MORE)) + 1


def test_of_equal_geometry_the_closer_in_time_wins(urban):
    """Looks a and b; b also nine days, three months, and unknown when: a's first partner is the closest."""
    a, b = urban.views[0], urban.views[2]
    views = [
        named(a, "a", 0),
        named(b, "summer", 92),
        named(b, "near", 9),
        named(b, "same", 0.001),
        named(b, "undated"),
        named(b, "winter", 182),
    ]
    pairs = [pair for pair in choose_pairs(scene_of(views, urban)) if pair.first == "a"]
    assert np.ptp([pair.angle_deg for pair in pairs]) == 0
    order = [pair.second for pair in pairs]
    assert order[:2] == ["same", "near"] and order[-1] == "winter" and order.index("undated") == 2


def test_unknown_times_speak_neither_for_nor_against():
    pair = ViewPair("a", "b", 20.0, 0.35, 1)
    assert pair_cost(pair) == 0.0 and change_cost(pair) is None and usual_change([pair]) == 0.0
    dated = [replace(pair, days=days, sun_deg=sun) for days, sun in ((0.001, 0.1), (30.0, 8.0), (183.0, 45.0))]
    assert usual_change([pair, *dated]) == change_cost(dated[1])
    assert pair_cost(dated[0], 9.0) < pair_cost(pair, usual_change(dated)) < pair_cost(dated[2], 9.0)


def test_what_speaks_against_a_pair():
    best = ViewPair("a", "b", 20.0, 0.35, 1, days=0.0, sun_deg=0.0)
    assert pair_cost(best) == 0.0
    for worse, cost in (
        (replace(best, angle_deg=40.0), np.log(2)),
        (replace(best, angle_deg=10.0), np.log(2)),
        (replace(best, share=0.5), np.log(2)),
        (replace(best, sun_deg=10.0), 1.0),
        (replace(best, days=365.25), 0.5 * np.log10(366.25)),
        (replace(best, days=365.25 / 2), 0.5 * np.log10(1 + 365.25 / 2) + 0.5),
    ):
        assert pair_cost(worse) == pytest.approx(cost)
    assert days_off_season(365.25 * 3 + 10) == pytest.approx(10) and days_off_season(355.25) == pytest.approx(10)


def test_the_sun_below_the_horizon_leaves_the_date(urban):
    views = [named(urban.views[0], "day", 0), named(urban.views[2], "later", 10.5)]
    pair = choose_pairs(scene_of(views, urban))[0]
    lon = urban.views[0].rpc.lon_off
    assert abs(lon) < 60 and pair.days == 10.5 and pair.sun_deg is None and pair.shadow is None
