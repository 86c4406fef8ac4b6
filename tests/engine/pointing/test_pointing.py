"""Pointing: absolute with ground control, affine where images drift, and what is said of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.records import ViewPair
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.planning.advice import advice, ties_by_tile
from repm_qgis.planning.pair_selection import choose_pairs
from repm_qgis.pointing.adjustment import adjust
from repm_qgis.pointing.ground_control import Gcp, intersect, read_gcps
from repm_qgis.pointing.pointing import point_views
from repm_qgis.pointing.vertical_parallax import largest_parallax, vertical_parallax
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.ties.tracks import Track


@pytest.fixture(params=("urban", "mountains"))
def scene(request):
    return request.getfixturevalue(request.param)


def places(scene, count, seed):
    """(N, 3) ground points on the true surface, away from its border."""
    numbers = np.random.default_rng(seed)
    rows, cols = (numbers.integers(10, n - 10, count) for n in scene.surface.shape)
    x, cell, _, y, _, _ = scene.transform
    lon_lat = geodetic_from_projected(scene.crs, np.column_stack([x + (cols + 0.5) * cell, y - (rows + 0.5) * cell]))
    return np.column_stack([lon_lat, scene.surface[rows, cols]])


def tracks_of(scene, count, noise, seed, warp=None):
    """Ties as the true sensors see them; ``warp`` moves each view's pixels."""
    numbers = np.random.default_rng([seed, 1])
    seen = [
        {view.name: view.project(point) + numbers.normal(0, noise, 2) for view in scene.true_views}
        for point in places(scene, count, seed)
    ]
    return [Track({name: warp(name, pixel) if warp else pixel for name, pixel in pixels.items()}) for pixels in seen]


def control(scene, noise, seed, role="control", count=12):
    numbers = np.random.default_rng([seed, 2])
    return [
        Gcp(
            f"P{k}",
            *map(float, point),
            role,
            {view.name: view.project(point) + numbers.normal(0, noise, 2) for view in scene.true_views},
        )
        for k, point in enumerate(places(scene, count, seed + 100))
    ]


def moved(gcp, by):
    return replace(gcp, pixels={name: pixel + by for name, pixel in gcp.pixels.items()})


def absolute_error(scene, found):
    """(views, 2) by how much corrected views miss the true pixels of ground points, px."""
    ground = places(scene, 300, 9)
    corrected = [view.with_pointing(found.pointing[view.name]) for view in scene.views]
    return np.array(
        [
            np.median(view.project(ground) - true.project(ground), axis=0)
            for view, true in zip(corrected, scene.true_views)
        ]
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.long
def test_control_points_make_the_pointing_absolute(scene, seed):
    """12 points with 0.3 px of noise: their mean is good to 0.09 px."""
    ties = tracks_of(scene, 400, 0.05, seed)
    assert np.abs(absolute_error(scene, adjust(scene.views, ties, 500.0))).max() > 0.5
    found = adjust(scene.views, ties, 500.0, "auto", control(scene, 0.3, seed))
    error = absolute_error(scene, found)
    assert np.sqrt(np.mean(error**2)) < 0.15
    assert found.rejected == () and found.model == "shift"
    # The biases in the truth scene's record are what is taken out.
    np.testing.assert_allclose([found.shifts[view.name] for view in scene.views], -scene.biases, atol=0.3)


def test_without_noise_control_is_exact(scene):
    found = adjust(scene.views, tracks_of(scene, 300, 0.0, 3), 500.0, "shift", control(scene, 0.0, 3))
    assert np.abs(absolute_error(scene, found)).max() < 0.01
    np.testing.assert_allclose(found.ground, places(scene, 300, 3), atol=0.01)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.long
def test_two_wrong_points_of_twelve_are_named_and_harmless(scene, seed):
    gcps = control(scene, 0.3, seed)
    gcps[2], gcps[7] = moved(gcps[2], (6.0, -3.0)), moved(gcps[7], (-2.0, 9.0))
    found = adjust(scene.views, tracks_of(scene, 400, 0.05, seed), 500.0, "auto", gcps)
    assert set(found.rejected) == {"P2", "P7"}
    assert np.sqrt(np.mean(absolute_error(scene, found) ** 2)) < 0.15


def test_a_point_of_a_wrong_height_is_named(scene):
    """20 m: the geoid was forgotten for one point; its images agree on another place."""
    gcps = control(scene, 0.3, 1)
    gcps[4] = replace(gcps[4], height=gcps[4].height + 20.0)
    found = adjust(scene.views, tracks_of(scene, 400, 0.05, 1), 500.0, "shift", gcps)
    assert found.rejected == ("P4",)


def test_check_points_change_nothing(scene):
    ties, gcps = tracks_of(scene, 300, 0.05, 5), control(scene, 0.3, 5)
    checks = [replace(moved(gcp, (40.0, 40.0)), id=f"C{k}") for k, gcp in enumerate(control(scene, 0.3, 6, "check"))]
    alone, both = (adjust(scene.views, ties, 500.0, "shift", points) for points in (gcps, gcps + checks))
    for name in alone.pointing:
        np.testing.assert_array_equal(alone.pointing[name], both.pointing[name])
    assert both.rejected == ()


def test_control_points_without_measurements_are_passed_over(urban):
    ties = tracks_of(urban, 300, 0.05, 5)
    bare = [replace(gcp, pixels={}) for gcp in control(urban, 0.3, 5)]
    for name, pointing in adjust(urban.views, ties, 500.0, "shift", bare).pointing.items():
        np.testing.assert_array_equal(pointing, adjust(urban.views, ties, 500.0).pointing[name])


def drifts(seed, size=400, most=3.0):
    """Each view's (2, 2) drift: up to ``most`` px over the image."""
    numbers = np.random.default_rng([seed, 7])
    maps = {f"img_{k:02d}": numbers.uniform(-1, 1, (2, 2)) for k in (1, 2, 3)}
    return {name: m / np.abs(m).sum(axis=1).max() * most / size for name, m in maps.items()}


def rows_left(scene, found, maps):
    """(pairs, N) what is left across the parallax of drifting images' true pixels, px."""
    ground = places(scene, 300, 9)
    views = [view.with_pointing(found.pointing[view.name]) for view in scene.views]
    pixels = [true.project(ground) for true in scene.true_views]
    pixels = [p + (p - 199.5) @ maps[view.name].T for p, view in zip(pixels, views)]
    return np.array(
        [
            vertical_parallax((views[i], views[j]), (pixels[i], pixels[j]), ground)[0]
            for i, j in ((0, 1), (0, 2), (1, 2))
        ]
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.long
def test_drift_over_the_image_is_found_and_affine_chosen(scene, seed):
    maps = drifts(seed)
    ties = tracks_of(scene, 600, 0.1, seed, lambda name, pixel: pixel + maps[name] @ (pixel - 199.5))
    found, plain = (adjust(scene.views, ties, 500.0, model) for model in ("auto", "shift"))
    assert found.model == "affine" and "trend" in found.reason
    assert np.abs(rows_left(scene, plain, maps)).max() > 0.5
    left = np.abs(rows_left(scene, found, maps))
    assert np.median(left) < 0.05 and np.percentile(left, 95) < 0.1


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.long
def test_without_drift_shift_is_chosen(scene, seed):
    found = adjust(scene.views, tracks_of(scene, 600, 0.1, seed), 500.0, "auto", control(scene, 0.3, seed))
    assert found.model == "shift" and "does not improve the fit" in found.reason
    for pointing in found.pointing.values():
        np.testing.assert_array_equal(pointing[:, :2], np.eye(2))


def test_few_ties_carry_no_affine_correction(urban):
    maps = drifts(1)
    ties = tracks_of(urban, 40, 0.1, 1, lambda name, pixel: pixel + maps[name] @ (pixel - 199.5))
    found = adjust(urban.views, ties, 500.0, "auto")
    assert found.model == "shift" and "40 ties" in found.reason


def test_vertical_parallax_is_what_no_height_and_no_place_explains(scene):
    """Moving the ground point changes nothing; moving one image across its parallax changes all, by as much."""
    ground = places(scene, 50, 4)
    views = tuple(scene.true_views[:2])
    pixels = [view.project(ground) for view in views]
    rows, azimuth = vertical_parallax(views, tuple(pixels), ground)
    assert np.abs(rows).max() < 1e-6
    away = ground + [2e-5, -1e-5, 6.0]
    assert np.abs(vertical_parallax(views, tuple(pixels), away)[0]).max() < 0.01
    # The parallax in the second image, and the direction across it.
    along = _parallax(views, ground)
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    for direction, size in ((along, 0.0), (across, 1.0)):
        moved_rows, _ = vertical_parallax(views, (pixels[0], pixels[1] + 0.5 * direction), ground)
        np.testing.assert_allclose(np.abs(moved_rows), 0.5 * size, atol=0.02)
    assert ((azimuth >= 0) & (azimuth < 360)).all()


def _parallax(views, ground):
    """(N, 2) unit vectors: where the second view's pixel goes as the first view's ray is climbed."""
    pixels = views[0].project(ground)
    ends = [views[1].project(views[0].localise(pixels, ground[:, 2] + h)) for h in (0.0, 10.0)]
    step = ends[1] - ends[0]
    return step / np.linalg.norm(step, axis=1, keepdims=True)


def test_the_worst_pair_of_a_track_counts(urban):
    ground = places(urban, 30, 4)
    tracks = [Track({view.name: view.project(point) for view in urban.true_views}) for point in ground]
    along = _parallax(urban.true_views[:2], ground)
    for track, direction in zip(tracks[:10], along):
        track.pixels["img_02"] += 2.0 * np.array([-direction[1], direction[0]])
    tracks.append(Track({"img_01": tracks[20].pixels["img_01"], "img_03": tracks[20].pixels["img_03"]}))
    rows, azimuth = largest_parallax(urban.true_views, tracks, np.vstack([ground, ground[20]]))
    assert (np.abs(rows[:10]) > 1.9).all() and np.abs(rows[10:]).max() < 1e-3 and len(azimuth) == 31


@pytest.fixture(scope="module")
def pointed(urban, tmp_path_factory, told):
    """The town's refined scene, pointed with its own noisy control points."""
    folder = tmp_path_factory.mktemp("pointed")
    fitted = run_stage("epmfit", {"images": urban.images, "workspace": str(folder), "tile_size": 256}, told())
    scene = Scene.load(fitted.scene)
    scene = replace(scene, refinement="polynomial")
    pairs = choose_pairs(scene)
    stretches = {view.name: view_stretch(view.image, view.band) for view in scene.views}
    gcps = read_gcps(urban.made.gcps, scene.views)
    said = told()
    before = [view.pointing.copy() for view in scene.views]
    found = point_views(scene, pairs, stretches, model="auto", gcps=gcps, progress=said)
    assert all(np.array_equal(view.pointing, pointing) for view, pointing in zip(scene.views, before))
    return replace(scene, views=found.views), pairs, gcps, found, said


@pytest.mark.long
def test_real_ties_and_the_tables_points_give_the_true_place(urban, pointed):
    """The scene's six control points (0.3 px of noise): check points are where they are, to half a metre in plane."""
    scene, _, gcps, found, said = pointed
    error = np.median(
        [
            view.project(places(urban, 200, 9)) - true.project(places(urban, 200, 9))
            for view, true in zip(scene.views, urban.true_views)
        ],
        axis=1,
    )
    assert np.sqrt(np.mean(error**2)) < 0.25  # 0.3 px / sqrt(6), and the ties
    figures = found.figures
    assert {point.id for point in figures.gcps} == {gcp.id for gcp in gcps}
    assert figures.height_uncertainty_m is None and figures.rejected_gcps == ()
    for point in figures.gcps:
        gcp = next(gcp for gcp in gcps if gcp.id == point.id)
        np.testing.assert_allclose([point.east_m, point.north_m, point.up_m], intersect(gcp, scene.views))
        assert np.hypot(point.east_m, point.north_m) < 0.5 and abs(point.up_m) < 2.0
    assert not [text for text in said.warnings if "control point" in text]
    for pair in figures.pairs:
        assert pair.after_px < 0.15 and pair.count <= pair.candidates


def test_ties_are_counted_around_every_tile(pointed):
    scene, pairs, _, found, _ = pointed
    counts = ties_by_tile(scene, found.xy)
    assert list(counts) == [tile.id for tile in scene.tiles]
    tile = scene.tiles[0]
    x0, y0, x1, y1 = tile.bounds
    inside = (found.xy[:, 0] >= x0) & (found.xy[:, 0] <= x1) & (found.xy[:, 1] >= y0) & (found.xy[:, 1] <= y1)
    assert counts[tile.id] == inside.sum() > 50  # these tiles are larger than a fifth of the scene


def test_advice_names_the_pair_the_tile_and_the_remedy(pointed):
    scene, pairs, _, found, _ = pointed
    fine = replace(found.figures, ties_by_tile=ties_by_tile(scene, found.xy))
    assert advice(scene, pairs, fine) == []
    narrow, wide = ViewPair("img_01", "img_02", 3.4, 0.06, 1), ViewPair("img_01", "img_03", 52.0, 1.02, 1)
    few = replace(fine, ties_by_tile={"r000c000": 80, "r000c001": 2}, height_uncertainty_m=6.4)
    said = advice(scene, [narrow, wide], few)
    assert len(said) == 3  # heights that are as uncertain as always are no reason to warn
    for text, words in zip(
        said,
        (
            ("img_01 and img_02", "B/H 0.06", "m only"),
            ("img_01 and img_03", "1.02", "a direction between"),
            ("1 tile of 2: r000c001", "of the overlap", "EXTENT"),
        ),
    ):
        assert all(word in text for word in words), text


def all_errors(scene, found, maps=None):
    """(views, N, 2) by how much corrected views miss the pixels of ground points that (drifting) images show."""
    ground = places(scene, 300, 9)
    corrected = [view.with_pointing(found.pointing[view.name]) for view in scene.views]
    seen = [true.project(ground) for true in scene.true_views]
    if maps:
        seen = [pixels + (pixels - 199.5) @ maps[view.name].T for pixels, view in zip(seen, scene.views)]
    return np.array([view.project(ground) - pixels for view, pixels in zip(corrected, seen)])


def drifting(gcps, maps):
    return [
        replace(gcp, pixels={name: pixel + maps[name] @ (pixel - 199.5) for name, pixel in gcp.pixels.items()})
        for gcp in gcps
    ]


@pytest.mark.parametrize("noise", (0.1, 0.3, 1.0))
def test_the_noise_of_control_points_is_estimated(scene, noise):
    found = adjust(scene.views, tracks_of(scene, 300, 0.05, 1), 500.0, "shift", control(scene, noise, 1, count=20))
    assert found.control_noise_px == pytest.approx(noise, rel=0.25) and found.rejected == ()


def test_without_control_there_is_no_noise_of_it(urban):
    assert adjust(urban.views, tracks_of(urban, 100, 0.05, 1), 500.0).control_noise_px is None


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.long
def test_exact_control_outweighs_ties_in_what_these_hardly_tell(scene, seed):
    """A tilt of the ground, which ties see through the curvature of the RPCs only: 0.1 px was passed here before."""
    maps = drifts(seed)
    ties = tracks_of(scene, 500, 0.1, seed, lambda name, pixel: pixel + maps[name] @ (pixel - 199.5))
    gcps = drifting(control(scene, 0.0, seed), maps)
    gcps[0], gcps[1] = moved(gcps[0], (6.0, -8.0)), moved(gcps[1], (9.0, 5.0))
    found = adjust(scene.views, ties, 500.0, "auto", gcps)
    assert found.model == "affine" and set(found.rejected) == {"P0", "P1"}
    assert np.linalg.norm(all_errors(scene, found, maps), axis=2).max() < 0.06


def test_one_control_point_is_better_than_none(scene):
    ties = tracks_of(scene, 300, 0.05, 2)
    free = np.sqrt(np.mean(all_errors(scene, adjust(scene.views, ties, 500.0)) ** 2))
    one = np.sqrt(np.mean(all_errors(scene, adjust(scene.views, ties, 500.0, "auto", control(scene, 0.3, 2)[:1])) ** 2))
    assert one < 0.5 < free


def test_a_point_two_pixels_off_among_good_ones_is_named(scene):
    gcps = control(scene, 0.1, 3)
    gcps[5] = moved(gcps[5], (1.4, -1.4))
    found = adjust(scene.views, tracks_of(scene, 300, 0.05, 3), 500.0, "shift", gcps)
    assert found.rejected == ("P5",)


@pytest.mark.parametrize("seed", range(3))
def test_four_wrong_points_of_twelve_are_named_though_they_agree(scene, seed):
    """The same error in all four, as by another datum: no average of all would tell."""
    gcps = control(scene, 0.3, seed)
    for k in (1, 4, 8, 9):
        gcps[k] = moved(gcps[k], (5.0, -6.0))
    found = adjust(scene.views, tracks_of(scene, 300, 0.05, seed), 500.0, "shift", gcps)
    assert set(found.rejected) == {"P1", "P4", "P8", "P9"}


def tilted(gcps, size=2.0):
    """Control points of ground that is tilted by up to some px in all views alike: ties hardly see it."""
    lon, lat = np.array([gcp.lon for gcp in gcps]), np.array([gcp.lat for gcp in gcps])
    east, north = (2 * (v - v.min()) / np.ptp(v) - 1 for v in (lon, lat))
    return [replace(gcp, height=gcp.height + size * 2 * e - size * n) for gcp, e, n in zip(gcps, east, north)]


@pytest.mark.long
def test_control_points_may_ask_for_affine_corrections_where_ties_do_not(scene):
    ties, gcps = tracks_of(scene, 400, 0.1, 1), tilted(control(scene, 0.2, 1))
    assert adjust(scene.views, ties, 500.0).model == "shift"
    found = adjust(scene.views, ties, 500.0, "auto", gcps)
    assert found.model == "affine" and "control points show a trend" in found.reason and found.rejected == ()
    # Four cannot ask: they would explain themselves.
    assert adjust(scene.views, ties, 500.0, "auto", gcps[:4]).model == "shift"


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.long
def test_noisy_control_points_do_not_ask_for_affine_corrections(scene, seed):
    gcps = control(scene, 1.5, seed)
    assert adjust(scene.views, tracks_of(scene, 300, 0.05, seed), 500.0, "auto", gcps).model == "shift"
