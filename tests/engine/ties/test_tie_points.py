"""Tie points of simulated views: true correspondences, and row differences that go away with the shifts found."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from osgeo import gdal, ogr

from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.geometry.footprints import box
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.pointing.adjustment import adjust
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stereo.pairing import rectified_pair
from repm_qgis.ties.parameters import TIES
from repm_qgis.ties.tie_alignment import align_ties, clusters
from repm_qgis.ties.tie_patches import ranked_patches, texture_of
from repm_qgis.ties.tie_points import (
    PairMatches,
    consistent_matches,
    evenly_spread,
    find_ties,
    parallax_trend,
    supported,
)
from repm_qgis.ties.tracks import Track, tracks_from


@pytest.fixture(scope="module", params=("urban", "mountains"))
def found(request, tmp_path_factory, told):
    """The truth scene, its REPM scene, and the ties of its pairs."""
    truth = request.getfixturevalue(request.param)
    folder = tmp_path_factory.mktemp("ties")
    result = run_stage("epmfit", {"images": truth.images, "workspace": str(folder)}, told())
    scene = Scene.load(result.scene)
    stretches = {view.name: view_stretch(view.image, view.band) for view in scene.views}
    names = [view.name for view in scene.views]
    return (
        truth,
        scene,
        find_ties(scene, [(names[0], names[1]), (names[1], names[2])], stretches, progress=told()),
        stretches,
    )


def epipolar(truth, match):
    """Distance of the second pixel from the true epipolar line of the first, px: needs no surface."""
    first, second = (next(v for v in truth.true_views if v.name == name) for name in (match.first, match.second))
    low, high = truth.height_range
    ends = [
        second.rpc.project(first.rpc.localise(match.first_px, np.full(len(match.first_px), h))) for h in (low, high)
    ]
    along = ends[1] - ends[0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    offset = match.second_px - ends[0]
    return offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0]


@pytest.mark.long
def test_ties_are_true(found):
    truth, _, matches, _ = found
    for match in matches:
        distance = epipolar(truth, match)
        assert len(distance) > 150
        assert np.median(np.abs(distance)) < 0.25
        assert abs(np.median(distance)) < 0.1
        assert (np.abs(distance) > 2.0).mean() < 0.02


def test_the_shifts_bring_rows_together(found):
    """Random points of space, seen by the true sensors, lie on one row once the views have their shifts."""
    truth, scene, matches, _ = found
    adjusted = adjust(scene.views, tracks_from(matches), sum(scene.altitudes) / 2)
    views = {
        view.name: view.with_pointing(np.column_stack([np.eye(2), adjusted.shifts[view.name]])) for view in scene.views
    }
    tile = scene.tiles[0]
    numbers = np.random.default_rng(6)
    points = np.column_stack(
        [
            truth.true_views[1].localise(numbers.uniform(40, 360, (500, 2)), 0.0)[:, :2] * 0,
            numbers.uniform(*scene.altitudes, 500),
        ]
    )
    points = truth.true_views[1].localise(numbers.uniform(40, 360, (500, 2)), points[:, 2])
    for match in matches:
        pair = rectified_pair(scene, views[match.first], views[match.second], tile.bounds, tile.altitudes)
        true = {view.name: view for view in truth.true_views}
        rows = (
            pair.first_rectified(true[match.first].project(points))[:, 1]
            - pair.second_rectified(true[match.second].project(points))[:, 1]
        )
        assert np.median(np.abs(rows)) < 0.1  # the issue asks for 0.3
        before = rectified_pair(
            scene, *(scene.view(n) for n in (match.first, match.second)), tile.bounds, tile.altitudes
        )
        raw = (
            before.first_rectified(true[match.first].project(points))[:, 1]
            - before.second_rectified(true[match.second].project(points))[:, 1]
        )
        assert np.median(np.abs(rows)) < np.median(np.abs(raw))


def test_the_same_every_time(found, told):
    import cv2

    truth, scene, matches, stretches = found
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        again = find_ties(scene, [(m.first, m.second) for m in matches], stretches, progress=told())
    finally:
        cv2.setNumThreads(threads)
    for a, b in zip(matches, again):
        np.testing.assert_array_equal(a.first_px, b.first_px)
        np.testing.assert_array_equal(a.second_px, b.second_px)


def test_too_few_ties_are_an_error_with_the_counts(found, told, tmp_path, write_image):
    """A view of noise: nothing in it is anywhere else."""
    truth, scene, matches, stretches = found
    noise = np.random.default_rng(0).integers(100, 1000, (400, 400)).astype(np.uint16)
    other = write_image(tmp_path / "noise.tif", noise, truth.views[1].rpc)
    blind = Scene(
        [scene.views[0], scene.views[1].__class__(**{**vars(scene.views[1]), "image": other})],
        scene.frame,
        scene.crs,
        scene.area,
        scene.altitudes,
        scene.tiles,
    )
    names = [view.name for view in blind.views]
    with pytest.raises(EmptyResultError) as caught:
        find_ties(blind, [tuple(names)], {name: stretches[name] for name in names}, progress=told())
    assert all(name in str(caught.value) for name in names) and "needed: 12" in str(caught.value)
    low, high = scene.altitudes
    assert f"for ground from {low:.0f} to {high:.0f} m above the ellipsoid" in str(caught.value)


def test_alignment_brings_ties_to_a_tenth_of_a_pixel(found, told):
    truth, scene, matches, stretches = found
    names = [view.name for view in scene.views]
    pairs = [(match.first, match.second) for match in matches]
    tracks = align_ties(scene, tracks_from(matches), pairs, stretches=stretches, progress=told())
    for first, second in ((names[0], names[1]), (names[0], names[2])):
        # Tracks that begin with the pair's first view were aligned with it.
        own = [t for t in tracks if first in t.pixels and second in t.pixels]
        distance = epipolar(
            truth,
            PairMatches(
                first, second, *(np.array([t.pixels[n] for t in own]) for n in (first, second)), np.zeros(len(own))
            ),
        )
        assert len(own) > 40
        assert 1.4826 * np.median(np.abs(distance - np.median(distance))) < 0.18
        assert abs(np.median(distance)) < 0.05 and (np.abs(distance) > 1.0).mean() < 0.05


def test_alignment_follows_the_pairs_of_a_track(found, told):
    """The last view is aligned with the middle one: the first and the last were never compared."""
    truth, scene, matches, stretches = found
    pairs = [(match.first, match.second) for match in matches]
    first, middle, last = (view.name for view in scene.views)
    assert pairs == [(first, middle), (middle, last)]
    tracks = [track for track in tracks_from(matches) if len(track.pixels) == 3]
    aligned = [
        track
        for track in align_ties(scene, tracks, pairs, stretches=stretches, progress=told())
        if len(track.pixels) == 3
    ]
    assert len(aligned) > 40
    for a, b in ((first, middle), (middle, last), (first, last)):
        pixels = [np.array([track.pixels[name] for track in aligned]) for name in (a, b)]
        distance = epipolar(truth, PairMatches(a, b, *pixels, np.zeros(len(aligned))))
        assert 1.4826 * np.median(np.abs(distance - np.median(distance))) < 0.18
        assert abs(np.median(distance)) < 0.05


def test_views_beyond_a_pixel_that_cannot_be_aligned_stay_together(found, told):
    _, scene, matches, stretches = found
    pairs = [(match.first, match.second) for match in matches]
    first, middle, last = (view.name for view in scene.views)
    whole = [track for track in tracks_from(matches) if len(track.pixels) == 3]
    wrong = [Track({**track.pixels, first: track.pixels[first] + (0.0, 9.0)}) for track in whole]
    aligned = align_ties(scene, wrong, pairs, stretches=stretches, progress=told())
    assert len(aligned) > 40
    assert sum(set(track.pixels) == {middle, last} for track in aligned) > 0.9 * len(aligned)


@pytest.mark.parametrize("errors", (((15, -11), (-12, 15), (4, -14)), ((-3, 25), (3, -25), (0, 0))))
@pytest.mark.long
def test_rpcs_that_are_wrong_by_tens_of_pixels(found, told, errors):
    truth, scene, _, stretches = found
    wrong = [
        view.__class__(**{**vars(view), "rpc": true.rpc.shifted(*error)})
        for view, true, error in zip(scene.views, truth.true_views, errors)
    ]
    lost = Scene(**{**vars(scene), "views": wrong})
    names = [view.name for view in wrong]
    pairs = [(names[0], names[1]), (names[1], names[2]), (names[0], names[2])]
    tracks = align_ties(
        lost,
        tracks_from(find_ties(lost, pairs, stretches, progress=told())),
        pairs,
        stretches=stretches,
        progress=told(),
    )
    pointing = adjust(wrong, tracks, sum(scene.altitudes) / 2).pointing
    right = [view.with_pointing(pointing[view.name]) for view in wrong]
    ground = truth.true_views[1].localise(np.random.default_rng(5).uniform(50, 350, (200, 2)), sum(scene.altitudes) / 2)
    for i, j in ((0, 1), (1, 2), (0, 2)):
        pair = rectified_pair(scene, right[i], right[j], scene.tiles[0].bounds, scene.altitudes)
        rows = (
            pair.first_rectified(truth.true_views[i].project(ground))
            - pair.second_rectified(truth.true_views[j].project(ground))
        )[:, 1]
        assert np.abs(rows).max() < 0.1


# With these the small scene is searched like a large one.
IN_CELLS = dataclasses.replace(TIES, patches=dataclasses.replace(TIES.patches, whole_px=150, least_px=130, most_px=130))


@pytest.mark.long
def test_a_large_scene_is_searched_in_patches_the_same_on_any_number_of_workers(found, told):
    truth, scene, _, stretches = found
    pair = tuple(view.name for view in scene.views[:2])
    one, two = (
        find_ties(scene, [pair], stretches, progress=told(), workers=workers, parameters=IN_CELLS)[0]
        for workers in (1, 2)
    )
    np.testing.assert_array_equal(one.first_px, two.first_px)
    np.testing.assert_array_equal(one.second_px, two.second_px)
    distance = epipolar(truth, one)
    assert len(distance) > 60 and np.median(np.abs(distance)) < 0.3
    assert (np.ptp(one.first_px, axis=0) > 250).all()


@pytest.mark.long
def test_of_every_cell_the_place_with_most_texture_comes_first(urban, found, told, tmp_path, write_image):
    """Water everywhere but around one place: its patch leads its cell's list, and the ties come from there."""
    truth, scene, _, _ = found
    if truth is not urban:
        pytest.skip("one scene is enough")
    x0, y0, x1, y1 = truth.bounds
    land = np.array([x0 + 0.6 * (x1 - x0), y0 + 0.62 * (y1 - y0)])
    ground = np.append(geodetic_from_projected(truth.crs, land[None])[0], np.median(truth.surface))
    views, numbers = [], np.random.default_rng(2)
    for view, true in zip(scene.views, truth.true_views):
        pixels = gdal.Open(view.image).ReadAsArray()
        centre = true.project(ground)
        rows, cols = np.indices(pixels.shape)
        water = np.hypot(cols - centre[0], rows - centre[1]) > 70
        pixels[water] = np.rint(200 + numbers.normal(0, 4, pixels.shape))[water].astype(np.uint16)
        image = write_image(tmp_path / f"{view.name}.tif", pixels, view.rpc)
        views.append(view.__class__(**{**vars(view), "image": image}))
    wet = dataclasses.replace(scene, views=views)
    stretches = {view.name: view_stretch(view.image, view.band) for view in views}

    def texture(place):
        return texture_of(wet, stretches, place, IN_CELLS.patches)

    cells = ranked_patches(wet, texture, told(), IN_CELLS.patches)
    size = np.array([(np.array(cell[0][2:]) - cell[0][:2]).max() for cell in cells])
    assert len(cells) > 4 and (size <= 130 * scene.gsd_m + 1).all()
    best = max((texture(cell[0]), cell) for cell in cells)[1]
    assert best[0][0] - 40 < land[0] < best[0][2] + 40 and best[0][1] - 40 < land[1] < best[0][3] + 40
    ties = find_ties(wet, [(views[0].name, views[1].name)], stretches, progress=told(), parameters=IN_CELLS)[0]
    assert len(ties.first_px) >= 12
    off = np.linalg.norm(ties.first_px - truth.true_views[0].project(ground), axis=1)
    assert np.quantile(off, 0.9) < 110


@pytest.mark.parametrize("side", (2000, 4000))
def test_of_a_small_scene_a_quarter_is_searched(found, told, side):
    """Nine patches, none of which overlap, and less where the scene is larger."""
    scene = found[1]
    x, y = scene.tiles[0].bounds[:2]
    end = side * scene.gsd_m
    area = f"POLYGON (({x} {y}, {x + end} {y}, {x + end} {y + end}, {x} {y + end}, {x} {y}))"
    tile = dataclasses.replace(scene.tiles[0], bounds=(x, y, x + end, y + end))
    small = dataclasses.replace(scene, tiles=[tile], area=area)
    cells = ranked_patches(small, lambda place: 1.0, told(), TIES.patches)
    first = np.array([cell[0] for cell in cells])
    share = ((first[:, 2] - first[:, 0]) * (first[:, 3] - first[:, 1])).sum() / end**2
    assert len(cells) == 9 and share == pytest.approx(0.25 if side == 2000 else 9 * (500 / 4000) ** 2)
    for a, b in itertools.combinations(first, 2):
        assert (a[:2] >= b[2:]).any() or (b[:2] >= a[2:]).any()


@pytest.mark.parametrize("shape", ("square", "slanted"))
def test_a_scene_of_40000_px_is_searched_all_over_and_little_of_it(found, told, shape):
    """Geometry alone: texture is drawn by lot. Every part of the overlap has a patch not far away, and all patches of
    a round are 1 % of it."""
    scene = found[1]
    side, gsd = 40000, scene.gsd_m
    x, y = scene.tiles[0].bounds[:2]
    tiles = [
        dataclasses.replace(
            scene.tiles[0], bounds=(x + i * gsd, y + j * gsd, x + (i + 5000) * gsd, y + (j + 5000) * gsd)
        )
        for i in range(0, side, 5000)
        for j in range(0, side, 5000)
    ]
    corners = {"square": ((0, 0), (1, 0), (1, 1), (0, 1)), "slanted": ((0.3, 0), (1, 0.2), (0.7, 1), (0, 0.8))}[shape]
    ring = ", ".join(f"{x + u * side * gsd} {y + v * side * gsd}" for u, v in (*corners, corners[0]))
    large = Scene(**{**vars(scene), "tiles": tiles, "area": f"POLYGON (({ring}))"})
    asked, numbers = [], np.random.default_rng(7)

    def drawn(place):
        asked.append(place)
        return float(numbers.uniform())

    cells = ranked_patches(large, drawn, told(), TIES.patches)
    assert len(cells) == 25 if shape == "square" else 15 <= len(cells) < 25
    assert len(asked) <= 25 * 36
    first = np.array([cell[0] for cell in cells])
    share = ((first[:, 2] - first[:, 0]) * (first[:, 3] - first[:, 1])).sum() / (side * gsd) ** 2
    assert share < 0.01
    area = ogr.CreateGeometryFromWkt(large.area)
    middles = (first[:, :2] + first[:, 2:]) / 2
    for u, v in np.random.default_rng(8).uniform(0, 1, (300, 2)):
        place = np.array([x + u * side * gsd, y + v * side * gsd])
        if area.Contains(ogr.CreateGeometryFromWkt(f"POINT ({place[0]} {place[1]})")):
            assert np.linalg.norm(middles - place, axis=1).min() < 0.3 * side * gsd  # one cell and a half
    for cell in cells:
        assert len(set(cell)) == len(cell) <= 36
        for place in cell:
            assert area.Intersects(box(place))


def test_matches_that_no_neighbour_shares_are_dropped():
    """A slope of half a pixel of disparity a pixel at most, houses of 5 px on it; every tenth took the next house."""
    numbers = np.random.default_rng(4)
    points = numbers.uniform(0, 800, (600, 2))
    disparity = 0.1 * points[:, 0] + numbers.choice((0.0, 5.0), 600)
    wrong = np.zeros(600, dtype=bool)
    wrong[::10] = True
    disparity[wrong] += numbers.choice((-36.0, 36.0, 48.0), wrong.sum())
    kept = supported(points, disparity, TIES.matches)
    assert kept[~wrong].mean() > 0.98 and kept[wrong].mean() < 0.1
    assert supported(points[:8], disparity[:8], TIES.matches).all()


def test_a_trend_is_known_between_and_beside_its_matches():
    numbers = np.random.default_rng(5)
    pixels, elsewhere = numbers.uniform(0, 800, (200, 2)), numbers.uniform(-50, 850, (50, 2))
    rows = 3.0 + pixels @ [0.004, -0.003] + numbers.normal(0, 0.3, 200)
    np.testing.assert_allclose(
        parallax_trend(pixels, rows, TIES.matches, elsewhere), 3.0 + elsewhere @ [0.004, -0.003], atol=0.25
    )
    few = parallax_trend(pixels[:20], rows[:20], TIES.matches, elsewhere)
    assert few.shape == (50,) and np.ptp(few) == 0


def test_features_are_spread_evenly():
    numbers = np.random.default_rng(1)
    points = np.concatenate([numbers.uniform(0, 40, (2000, 2)), numbers.uniform(0, 480, (800, 2))])
    strength = np.concatenate([numbers.uniform(5, 6, 2000), numbers.uniform(0, 1, 800)])
    chosen = evenly_spread(points, strength, (480, 480), 500, 12)
    assert len(chosen) == len(set(chosen)) == 500
    corner = (points[chosen] < 40).all(axis=1).sum()
    assert corner < 20  # of 2000 stronger ones
    np.testing.assert_array_equal(evenly_spread(points, strength, (480, 480), 4000, 12), np.arange(2800))


@pytest.mark.parametrize("slope", (0.0, 0.006))
def test_rows_follow_a_trend_whatever_else_is_there(slope):
    """4.8 px of trend over 800 px, half a pixel of noise, and as many wrong matches as right ones."""
    numbers = np.random.default_rng(3)
    pixels = numbers.uniform(0, 800, (600, 2))
    true = 12.0 + pixels @ [slope, -slope / 2]
    rows = true + numbers.normal(0, 0.4, 600)
    rows[::2] = numbers.uniform(-64, 64, 300)
    part = PairMatches("a", "b", pixels, pixels, rows)
    np.testing.assert_allclose(parallax_trend(pixels, rows, TIES.matches), true, atol=0.3)
    kept = consistent_matches("a", "b", [part], TIES.matches)
    good = np.isin(rows, kept.vertical_parallax_px)
    assert good[1::2].mean() > 0.97 and good[::2].mean() < 0.06


def test_clusters_hold_every_point_once_and_are_no_larger_than_asked():
    numbers = np.random.default_rng(0)
    islands = [numbers.uniform(0, 300, (50, 2)) + corner for corner in ((0, 0), (2000, 100), (900, 3000))]
    xy = np.concatenate([*islands, numbers.uniform(5000, 7000, (200, 2))])
    found = clusters(xy, np.arange(len(xy)), 400.0, 0.1)
    assert sorted(np.concatenate(found)) == list(range(len(xy)))
    assert all((np.ptp(xy[part], axis=0) <= 400).all() for part in found)
    for number in range(3):  # what lies together stays together
        assert any(set(range(50 * number, 50 * number + 50)) == set(part) for part in found)
