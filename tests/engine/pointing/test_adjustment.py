"""Relative pointing: known errors are found again where they can be, whatever else is in the tie points."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.pointing.adjustment import adjust, with_shifts
from repm_qgis.ties.tie_points import PairMatches
from repm_qgis.ties.tracks import Track, tracks_from


def points_on(scene, count, seed=0):
    """(N, 3) ground points on the true surface, away from its border."""
    numbers = np.random.default_rng(seed)
    rows, cols = (numbers.integers(10, n - 10, count) for n in scene.surface.shape)
    x, cell, _, y, _, _ = scene.transform
    lon_lat = geodetic_from_projected(scene.crs, np.column_stack([x + (cols + 0.5) * cell, y - (rows + 0.5) * cell]))
    return np.column_stack([lon_lat, scene.surface[rows, cols]])


def exact_tracks(scene, count=300, noise=0.0, seed=0):
    """Tracks as the true sensors see them, in half of the cases by two views only."""
    numbers = np.random.default_rng(seed + 1)
    ground = points_on(scene, count, seed)
    tracks = []
    for number, point in enumerate(ground):
        pixels = {view.name: view.rpc.project(point) + numbers.normal(0, noise, 2) for view in scene.true_views}
        if number % 2:
            pixels.pop(scene.views[number // 2 % 3].name)
        tracks.append(Track(pixels))
    return tracks, ground


def left_over(scene, shifts, count=200):
    """(N, 3) residual across the parallax of each pair of views, px: what no error of height or place can hide.

    Ground points are seen where the true sensors see them; each pair's shifted vendor RPCs must be able to meet there.
    """
    ground = points_on(scene, count, 9)
    result = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        misfit, moves = [], []
        for k in (i, j):
            view, true = scene.views[k], scene.true_views[k]
            seen = view.rpc.project(ground) + shifts[view.name]
            misfit.append(true.rpc.project(ground) - seen)
            step = 1e-5
            moves.append(
                np.stack(
                    [
                        (view.rpc.project(ground + delta) - view.rpc.project(ground)) / step
                        for delta in ([step, 0, 0], [0, step, 0], [0, 0, step * 1e5])
                    ],
                    axis=-1,
                )
            )
        residual, jacobian = np.concatenate(misfit, axis=1), np.concatenate(moves, axis=1)
        # Four equations, three unknowns: one direction stays.
        across = np.linalg.svd(jacobian)[0][:, :, 3]
        result.append(np.sqrt(2) * (across * residual).sum(axis=1))
    return np.stack(result, axis=1)


@pytest.fixture(params=("urban", "mountains"))
def scene(request):
    return request.getfixturevalue(request.param)


def test_without_correction_the_pairs_do_not_meet(scene):
    none = {view.name: np.zeros(2) for view in scene.views}
    assert np.abs(np.median(left_over(scene, none), axis=0)).max() > 0.3


def test_known_pointing_errors_are_found(scene):
    tracks, _ = exact_tracks(scene)
    found = adjust(scene.views, tracks, 500.0)
    assert np.abs(left_over(scene, found.shifts)).max() < 0.01
    assert found.residual_px.max() < 0.01
    assert np.median(found.before_px) > 10 * np.median(found.residual_px)


def test_the_mean_of_the_shifts_stays_zero(scene):
    tracks, _ = exact_tracks(scene)
    shifts = np.array(list(adjust(scene.views, tracks, 500.0).shifts.values()))
    assert np.abs(shifts.mean(axis=0)).max() < 0.02
    # The smallest shifts that do: no longer than the errors themselves, freed of what all views share.
    free = scene.biases - scene.biases.mean(axis=0)
    assert np.linalg.norm(shifts) <= np.linalg.norm(free) + 0.02


def test_ground_points_are_where_they_are_but_for_what_all_views_share(scene):
    tracks, ground = exact_tracks(scene)
    found = adjust(scene.views, tracks, 500.0)
    offset = scene_metres(scene, found.ground) - scene_metres(scene, ground)
    # The common pointing error moves all points alike.
    assert np.abs(offset - offset.mean(axis=0)).max() < 0.02
    assert np.linalg.norm(offset.mean(axis=0)) < 8.0


def scene_metres(scene, lon_lat_h):
    from repm_qgis.geometry.frames import projected_from_geodetic

    return np.column_stack([projected_from_geodetic(scene.crs, lon_lat_h), lon_lat_h[:, 2]])


@pytest.mark.parametrize("kind", ("scattered", "one way"))
@pytest.mark.long
def test_a_fifth_of_gross_outliers_moves_nothing(scene, kind):
    clean, _ = exact_tracks(scene, 600, noise=0.1)
    straight = adjust(scene.views, clean, 500.0).shifts
    numbers = np.random.default_rng(3)
    dirty = []
    for number, track in enumerate(clean):
        pixels = {name: pixel.copy() for name, pixel in track.pixels.items()}
        if number % 5 == 0:
            name = sorted(pixels)[number // 5 % len(pixels)]
            pixels[name] += numbers.uniform(-30, 30, 2) if kind == "scattered" else [4.0, -12.0]
        dirty.append(Track(pixels))
    found = adjust(scene.views, dirty, 500.0).shifts
    moved = left_over(scene, found) - left_over(scene, straight)
    assert np.abs(moved).max() < 0.05
    assert max(np.abs(found[name] - straight[name]).max() for name in found) < 0.05


def test_two_views_are_enough(scene):
    tracks, _ = exact_tracks(scene)
    names = [view.name for view in scene.views[:2]]
    pairs = [Track({name: track.pixels[name] for name in names}) for track in tracks if set(names) <= set(track.pixels)]
    found = adjust(scene.views[:2], pairs, 500.0)
    assert found.residual_px.max() < 0.01
    assert np.abs(sum(found.shifts.values())).max() < 0.02


def bent(tracks, views, size=1.2):
    """The tracks as images see them that are also stretched and turned by up to ``size`` px at their border."""
    numbers = np.random.default_rng(12)
    maps = {view.name: numbers.uniform(-size / 400, size / 400, (2, 2)) for view in views}
    return [
        Track({name: pixel + maps[name] @ (pixel - 200) for name, pixel in track.pixels.items()}) for track in tracks
    ]


def test_affine_errors_need_the_affine_model(scene):
    tracks = bent(exact_tracks(scene, 400, noise=0.05)[0], scene.views)
    shift, affine = (adjust(scene.views, tracks, 500.0, model) for model in ("shift", "affine"))
    assert np.median(affine.residual_px) < 0.06 and np.median(shift.residual_px) > 0.12
    assert adjust(scene.views, tracks, 500.0, "auto").model == "affine"


def test_pure_shifts_stay_shifts(scene):
    tracks, _ = exact_tracks(scene, 400, noise=0.1)
    found = adjust(scene.views, tracks, 500.0, "auto")
    assert found.model == "shift" and found.reason
    for pointing in found.pointing.values():
        np.testing.assert_array_equal(pointing[:, :2], np.eye(2))


@pytest.mark.parametrize("model", ("shift", "affine"))
def test_errors_of_fifteen_pixels_are_found(scene, model):
    tracks, _ = exact_tracks(scene, 400, noise=0.1)
    errors = {view.name: np.array(error) for view, error in zip(scene.views, ((15, -11), (-12, 15), (4, -14)))}
    far = [Track({name: pixel + errors[name] for name, pixel in track.pixels.items()}) for track in tracks]
    near, found = adjust(scene.views, tracks, 500.0, model), adjust(scene.views, far, 500.0, model)
    assert np.median(found.residual_px) == pytest.approx(np.median(near.residual_px), abs=0.01)
    extra = {name: found.shifts[name] - near.shifts[name] - errors[name] for name in errors}
    free = left_over(scene, {name: near.shifts[name] + extra[name] for name in errors}) - left_over(scene, near.shifts)
    assert np.abs(free).max() < 0.03


def test_what_ties_cannot_tell_stays_where_the_vendors_put_it(scene):
    """Affine corrections mimic a tilt of the ground: noise must not make one of many pixels."""
    tracks, _ = exact_tracks(scene, 300, noise=0.15)
    for pointing in adjust(scene.views, tracks, 500.0, "affine").pointing.values():
        corners = np.array([[0, 0], [399, 0], [0, 399], [399, 399]], dtype=float)
        moved = corners @ pointing[:, :2].T + pointing[:, 2] - corners
        assert np.abs(moved - moved.mean(axis=0)).max() < 0.6


def test_shifts_found_otherwise_get_their_ground_points(scene):
    tracks, _ = exact_tracks(scene)
    ours = adjust(scene.views, tracks, 500.0)
    other = with_shifts(scene.views, tracks, 500.0, ours.shifts, "taken over")
    assert other.reason == "taken over" and other.model == "shift"
    np.testing.assert_allclose(scene_metres(scene, other.ground), scene_metres(scene, ours.ground), atol=0.02)
    np.testing.assert_allclose(other.residual_px, ours.residual_px, atol=2e-3)


def test_rays_from_one_place_do_no_harm(scene):
    """Two views with the same RPC see no height; their ties say nothing, and break nothing."""
    tracks, _ = exact_tracks(scene, 200)
    twin = scene.views[0].__class__(**{**vars(scene.views[0]), "name": "twin"})
    more = [
        Track({scene.views[0].name: np.array([50.0 + k, 60.0]), "twin": np.array([50.0 + k, 60.0])}) for k in range(30)
    ]
    found = adjust([*scene.views, twin], tracks + more, 500.0)
    assert np.isfinite(found.ground).all() and found.residual_px[:200].max() < 0.02


def matches(first, second, a, b):
    return PairMatches(first, second, np.array(a, float), np.array(b, float), np.zeros(len(a)))


def test_tracks_are_joined_over_pairs():
    tracks = tracks_from(
        [
            matches("a", "b", [[10, 20], [50, 60]], [[11, 20], [52, 60]]),
            matches("b", "c", [[11.02, 20.01], [99, 99]], [[13, 20], [98, 99]]),
        ]
    )
    seen = sorted(tuple(sorted(track.pixels)) for track in tracks)
    assert seen == [("a", "b"), ("a", "b", "c"), ("b", "c")]
    joined = next(track for track in tracks if len(track.pixels) == 3)
    np.testing.assert_allclose(joined.pixels["c"], [13, 20])


def test_contradictions_are_dropped():
    tracks = tracks_from(
        [
            matches("a", "b", [[10, 20]], [[11, 20]]),
            matches("b", "c", [[11, 20]], [[13, 20]]),
            matches("a", "c", [[30, 20], [70, 70]], [[13, 20], [72, 70]]),
        ]
    )
    assert [sorted(track.pixels) for track in tracks] == [["a", "c"]]
    np.testing.assert_allclose(tracks[0].pixels["a"], [70, 70])
