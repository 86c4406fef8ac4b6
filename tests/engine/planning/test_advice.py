"""Warnings: what is wrong, where, and what to do."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from osgeo import ogr

from repm_qgis.contracts.records import PairFigures, PointingFigures, ViewPair
from repm_qgis.geometry.footprints import box
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.planning.advice import absolute_height, advice, ties_by_part
from repm_qgis.planning.height_uncertainty import height_uncertainty
from repm_qgis.planning.pair_selection import choose_pairs
from repm_qgis.scene import Scene, Tile

PAIR = ViewPair("img_01", "img_02", 20.0, 0.35, 4, days=0.0001, sun_deg=0.1, shadow=0.01)
NO_TIES = PointingFigures(0, 0.0, 0.0, "", "", {}, ())


@pytest.fixture
def scene(urban):
    """The town's views over nine square tiles of 100 m."""
    x, y = urban.bounds[0], urban.bounds[1]
    tiles = [
        Tile(
            f"r{r:03d}c{c:03d}",
            (x + 100 * c, y + 100 * (2 - r), x + 100 * (c + 1), y + 100 * (3 - r)),
            (150.0, 250.0),
            {view.name: None for view in urban.views},
        )
        for r in range(3)
        for c in range(3)
    ]
    lon, lat = urban.views[0].rpc.lon_off, urban.views[0].rpc.lat_off
    return Scene(
        list(urban.views),
        EnuFrame(lon, lat),
        urban.crs,
        box((x, y, x + 300, y + 300)).ExportToWkt(),
        (150.0, 250.0),
        tiles,
    )


def only(said):
    assert len(said) == 1, said
    # One sentence: a full stop at its end alone, and a remedy after a colon or semicolon.
    assert said[0].endswith(".") and ". " not in said[0] and (";" in said[0] or ":" in said[0])
    return said[0]


def all_three(*pairs):
    return [*pairs, ViewPair("img_02", "img_03", 20.0, 0.35, 4), ViewPair("img_01", "img_03", 20.0, 0.35, 4)]


def test_good_pairs_and_unknown_times_need_no_advice(scene):
    assert advice(scene, all_three(PAIR), NO_TIES) == []


def test_narrow_pairs_tell_their_accuracy_in_metres(scene):
    text = only(advice(scene, all_three(replace(PAIR, base_to_height=0.06, angle_deg=3.4)), NO_TIES))
    assert f"accurate to about {0.25 * scene.gsd_m / 0.06:.1f} m only; add an image" in text and "3.4 degrees" in text


def test_another_sun_tells_how_far_shadows_moved(scene):
    other = replace(PAIR, days=183.0, sun_deg=47.0, shadow=1.42)
    text = only(advice(scene, all_three(other), NO_TIES))
    assert "img_01 and img_02 (183 days, 47 degrees between the suns" in text
    assert "10 m building ends 14 m elsewhere" in text and "take images of one pass" in text
    hours = replace(PAIR, days=0.125, sun_deg=40.0, shadow=1.0)
    assert "(3 h, 40 degrees" in only(advice(scene, all_three(hours), NO_TIES))
    many = [replace(other, second=f"b{k}") for k in range(9)]
    scene = replace(scene, views=[*scene.views, *(replace(scene.views[2], name=pair.second) for pair in many)])
    assert "and 3 more:" in advice(scene, all_three(PAIR, *many), NO_TIES)[0]


@pytest.mark.parametrize(("days", "said"), [(30.0, False), (100.0, True), (360.0, False), (731.0, True)])
def test_other_seasons_and_years_under_the_same_sun(scene, days, said):
    found = advice(scene, all_three(replace(PAIR, days=days, sun_deg=5.0)), NO_TIES)
    assert bool(found) == said
    if said:
        assert f"img_01 and img_02 ({days:.0f} days)" in only(found) and "one pass" in found[0]


@pytest.mark.parametrize(
    "change",
    (
        {"base_to_height": 0.06, "angle_deg": 3.4},
        {"days": 183.0, "sun_deg": 47.0, "shadow": 1.42},
        {"days": 731.0, "sun_deg": 5.0},
    ),
)
def test_of_two_images_none_can_be_left_out(scene, change):
    odd = replace(PAIR, **change)
    assert re.search(r", or leave (out )?one", only(advice(scene, all_three(odd), NO_TIES)))
    two = replace(scene, views=scene.views[:2], tiles=[])
    assert ", or leave" not in only(advice(two, [odd], NO_TIES))


def test_times_of_the_night_are_named(scene):
    midnight = datetime(2012, 6, 20, 0, 0, tzinfo=timezone.utc) - timedelta(hours=scene.frame.lon / 15)
    second = replace(scene.views[1], acquired=midnight.isoformat())
    scene = replace(scene, views=(scene.views[0], second, scene.views[2]))
    text = only(advice(scene, all_three(PAIR), NO_TIES))
    assert (
        text.startswith(f"img_02 ({midnight:%Y-%m-%d %H:%M} UTC): the sun had set")
        and "check the sidecar files" in text
    )


def test_unused_views_and_groups_without_a_pair_between_them(scene):
    assert "img_03: not used" in only(advice(scene, [PAIR], NO_TIES))
    scene = replace(scene, views=(*scene.views, replace(scene.views[2], name="img_04")))
    text = only(advice(scene, [PAIR, ViewPair("img_03", "img_04", 20.0, 0.35, 4)], NO_TIES))
    assert "2 groups that no pair connects (img_01, img_02; img_03, img_04)" in text and "GCPS" in text


def test_ties_are_counted_by_compass(scene):
    x, y = scene.tiles[6].bounds[:2]
    rng = np.random.default_rng(1)
    xy = rng.uniform((x, y), (x + 300, y + 300), (500, 2))
    counts = ties_by_part(scene, xy)
    assert len(counts) == 9 and sum(counts.values()) == 500
    assert counts["north-west"] == ((xy[:, 0] < x + 100) & (xy[:, 1] > y + 200)).sum()
    assert counts["south"] == ((np.abs(xy[:, 0] - x - 150) < 50) & (xy[:, 1] < y + 100)).sum()
    triangle = ogr.CreateGeometryFromWkt(f"POLYGON(({x} {y}, {x + 300} {y}, {x} {y + 300}, {x} {y}))")
    assert list(ties_by_part(replace(scene, area=triangle.ExportToWkt()), xy)) == [
        "north-west",
        "west",
        "middle",
        "south-west",
        "south",
        "south-east",
    ]


def test_a_corner_without_ties_is_told_by_compass_and_tile(scene):
    parts = dict.fromkeys(ties_by_part(scene, np.empty((0, 2))), 60)
    tiles = {tile.id: 60 for tile in scene.tiles}

    def said(parts, tiles):
        return advice(scene, all_three(PAIR), replace(NO_TIES, ties_by_tile=tiles, ties_by_part=parts))

    assert said(parts, tiles) == []
    bare = {**parts, "north-west": 0}
    text = only(said(bare, {**tiles, "r000c000": 1}))
    assert "in the north-west of the overlap (1 tile of 9: r000c000)" in text and "'row'" in text and "EXTENT" in text
    # One tile for all: the part alone tells.
    text = only(said(bare, {"r000c000": 480}))
    assert "in the north-west of the overlap, because of water" in text
    # A small tile of a large part.
    assert "in the south-east of the overlap (1 tile of 9: r002c002)" in only(said(parts, {**tiles, "r002c002": 0}))


def test_few_ties_everywhere_are_no_place(scene):
    parts = dict.fromkeys(ties_by_part(scene, np.empty((0, 2))), 3)
    for ties in (27, 1):
        figures = replace(NO_TIES, ties_by_tile={"r000c000": ties}, ties_by_part=parts)
        assert advice(scene, all_three(PAIR), figures) == []


def test_advice_of_real_pairs_under_two_suns(scene):
    """Through the choice of pairs: noon in summer and in winter, one place and two looks."""
    noon = datetime(2012, 6, 20, 12, 0, tzinfo=timezone.utc) - timedelta(hours=scene.frame.lon / 15)
    times = [(noon + timedelta(days=days)).isoformat() for days in (0, 0, 183)]
    scene = replace(scene, views=tuple(replace(view, acquired=time) for view, time in zip(scene.views, times)))
    pairs = choose_pairs(scene)
    text = only([said for said in advice(scene, pairs, NO_TIES) if "sun" in said])
    assert "img_01 and img_03 (183 days, 47 degrees" in text and "img_02 and img_03" in text
    assert "img_01 and img_02 (" not in text


def disagreeing(scene, first_px, third_px, sensor="Pleiades 1A", uncertain=40.0):
    """The scene's views of one satellite, and figures of three pairs whose RPCs disagree so much."""
    scene = replace(scene, views=tuple(replace(view, sensor=sensor) for view in scene.views))
    names = ("img_01", "img_02"), ("img_02", "img_03"), ("img_01", "img_03")
    apart = first_px, 0.5, third_px
    pairs = tuple(PairFigures(pair, 99, 90, px, 0.1, 0.1) for pair, px in zip(names, apart))
    return scene, replace(NO_TIES, pairs=pairs, height_uncertainty_m=uncertain)


@pytest.mark.parametrize(
    ("figures", "words"),
    (
        (replace(NO_TIES, height_uncertainty_m=455.8), "the absolute height is uncertain by 375 m instead of"),
        (
            replace(NO_TIES, height_uncertainty_m=10.0, shifts_px={"img_02": (60.0, 30.0)}),
            "the pointing of img_02 is corrected by 33.5 m on the ground (CE90 8.5 m, ",
        ),
        (
            replace(NO_TIES, height_uncertainty_m=10.0, shifts_px={"img_01": (70.0, 90.0), "img_02": (-80.0, 90.0)}),
            "times what the promised errors would cause",
        ),
        (replace(NO_TIES, trends_px={"img_01": 0.2, "img_02": 4.3}), "by more than 1 px: img_02 (4.3 px)"),
    ),
)
def test_rpcs_that_are_worse_than_promised_are_named(scene, figures, words):
    """Such figures stood in reports that said "Good."; any warning takes that word away (reports/test_verdict.py)."""
    scene = replace(scene, views=tuple(replace(view, sensor="Pleiades 1A", gsd_m=0.5) for view in scene.views))
    (said,) = advice(scene, all_three(PAIR), figures)
    assert words in said and "check that each RPC belongs to its image" in said


@pytest.mark.parametrize(
    ("sensor", "ce90_m"), (("Pleiades 1A", 8.5), ("WorldView-3", 3.5), ("SPOT 6", 35.0), ("", 20.0))
)
def test_rpcs_may_disagree_as_the_vendors_promise(scene, sensor, ce90_m):
    """The promises of both images count, and only pairs beyond them are named."""
    limit_m = np.sqrt(2) * ce90_m
    limit_px = limit_m / scene.gsd_m
    fine, figures = disagreeing(scene, limit_px * 0.99, -limit_px * 0.99, sensor, uncertain=10.0)
    assert advice(fine, all_three(PAIR), figures) == []
    wrong, figures = disagreeing(scene, limit_px * 1.02, -0.5, sensor)
    text = only(advice(wrong, all_three(PAIR), figures))
    for words in (
        f"img_01 and img_02 ({limit_px * 1.02:.1f} px, {limit_m * 1.02:.1f} m on the ground",
        f"where at most {limit_m:.1f} m are expected",
        f"CE90 {ce90_m:.1f} m ({sensor or 'assumed'}",
        "uncertain by 32.9 m (LE90)",
        "each RPC belongs to its image, give ground control points (GCPS)",
        "ALIGN=3d",
    ):
        assert words in text, text
    assert "img_03" not in text


def test_the_image_that_contradicts_all_others_is_named(scene):
    wrong, figures = disagreeing(scene, -60.0, 58.0)
    assert "(img_01 is in all of these pairs)" in only(advice(wrong, all_three(PAIR), figures))
    # With ground control, or where a pair has no ties, there is nothing to say.
    assert advice(wrong, all_three(PAIR), replace(figures, height_uncertainty_m=None)) == []
    bare = replace(figures, pairs=tuple(replace(pair, count=0) for pair in figures.pairs))
    assert advice(wrong, all_three(PAIR), bare) == []


def test_the_height_is_said_to_be_uncertain_with_its_source(scene):
    seen, figures = disagreeing(scene, 1.0, -1.5, uncertain=5.7)
    stated, promise, measured = absolute_height(seen.views, figures)
    assert "uncertain by 4.7 m (LE90" in stated and "by 1.08 px across the parallax" in measured
    known = height_uncertainty(seen.views, figures)
    assert f"cause height errors of LE90 {1.645 * known.promised_m:.1f} m" in promise
    assert f"{known.disagreement:.2f} times what such errors would cause" in measured
    assert "at most CE90 8.5 m (Pleiades 1A: Astrium," in promise and "LE90" in promise and "independent" in promise
    published = absolute_height(disagreeing(scene, 1.0, 1.0, "IKONOS")[0].views, figures)[1]
    assert "LE90 22.0 m" in published and "in common" not in published
    assert absolute_height(seen.views, replace(figures, height_uncertainty_m=None)) == []
    apart = absolute_height(seen.views, replace(figures, pairs=()))[2]
    assert "by 0.00 px across the parallax" in apart, "without a pair nothing disagrees"
