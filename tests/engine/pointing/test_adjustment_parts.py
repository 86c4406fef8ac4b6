"""The parts of the adjustment of pointing, against algebra; and the direction of the vertical parallax."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.pointing import adjustment
from repm_qgis.pointing.adjustment import _design, _huber, _log_mean, _pseudo_inverse, _reduced, _Solution, _tukey
from repm_qgis.pointing.ground_control import Gcp
from repm_qgis.pointing.parameters import POINTING
from repm_qgis.pointing.pointing import Pointing
from repm_qgis.pointing.vertical_parallax import tracks_of_pair, vertical_parallax
from repm_qgis.ties.tracks import Track

ADJUSTMENT = POINTING.adjustment


def tracks_on(views, count=80, seed=0, noise=0.0, share=(0.1, 0.9), wrong=None):
    """Ties of rugged ground as the views' RPCs have them, and the ground; ``wrong`` is added to each view's pixels."""
    rng = np.random.default_rng(seed)
    pixels = np.column_stack([rng.uniform(*share, count) * n for n in views[0].size])
    ground = views[0].localise(pixels, 200.0 + rng.uniform(-40, 40, count))
    seen = {view.name: view.project(ground) + rng.normal(0, noise, (count, 2)) for view in views}
    for name, by in (wrong or {}).items():
        seen[name] = seen[name] + by
    return [Track({name: at[k] for name, at in seen.items()}) for k in range(count)], ground


def solution(views, tracks, model="shift", gcps=()):
    return _Solution(views, tracks, 200.0, model, gcps, POINTING)


def test_a_pseudo_inverse_is_that_of_each_matrix():
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(5, 6, 3))
    found = _pseudo_inverse(jacobian)
    for each, inverse in zip(jacobian, found):
        assert inverse == pytest.approx(np.linalg.pinv(each), abs=1e-8)


def test_what_the_ground_takes_up_is_taken_away():
    rng = np.random.default_rng(1)
    jacobian, residual = rng.normal(size=(4, 6, 3)), rng.normal(size=(4, 6))
    bases = [rng.normal(size=(4, 2, 2)) for _ in range(3)]
    reduced, projector = _reduced(residual, jacobian)
    design = _design(projector, bases)
    for k in range(4):
        known = np.eye(6) - jacobian[k] @ np.linalg.pinv(jacobian[k])
        whole = np.zeros((6, 6))
        for view in range(3):
            whole[2 * view : 2 * view + 2, 2 * view : 2 * view + 2] = bases[view][k]
        assert reduced[k] == pytest.approx(known @ residual[k], abs=1e-8)
        assert design[k] == pytest.approx(known @ whole, abs=1e-8)


def test_weights_fall_as_their_authors_say():
    size = np.array([0.0, 0.35, 0.7, 1.4, 7.0])
    assert _huber(size, 9.0, ADJUSTMENT) == pytest.approx([1.0, 1.0, 1.0, 0.5, 0.1])
    found = _tukey(np.array([0.0, 0.5, 1.0, 1.1]) * 4.685 * 0.2, 0.2, ADJUSTMENT)
    assert found == pytest.approx([1.0, 0.5625, 0.0, 0.0])
    assert _log_mean(np.array([1.0, 3.0])) == pytest.approx(np.log(2.0)) and _log_mean(np.zeros(3)) < -27


def test_ties_cover_what_they_span_without_their_tails(urban):
    views = urban.views[:2]
    tracks, _ = tracks_on(views, 400, share=(0.2, 0.7))
    cover = solution(views, tracks).cover
    assert cover[0] == pytest.approx(0.5 * 0.96, abs=0.03) and len(cover) == 2
    outlier = [*tracks, Track({name: pixels * 0 + 395.0 for name, pixels in tracks[0].pixels.items()})]
    assert solution(views, outlier).cover == pytest.approx(cover, abs=0.01)
    strip = [track for track in tracks if track.pixels[views[0].name][1] < 0.3 * 400]
    assert solution(views, strip).cover[0] == pytest.approx(0.1 * 0.96, abs=0.02)
    assert solution(views, []).cover == (0.0,)


def test_the_criterion_is_schwarzs(urban):
    """Ties count with their residuals up to a limit, and each parameter with the logarithm of their number."""
    views = urban.views[:2]
    tracks, _ = tracks_on(views, 90, noise=0.3)
    for model, parameters in (("shift", 4), ("affine", 12)):
        made = solution(views, tracks, model)
        square = np.minimum(made._residuals(), 0.3) ** 2
        wanted = 90 * np.log(square.mean()) + parameters * np.log(90)
        assert made.criterion(0.3) == pytest.approx(wanted)
    gcps = control(views)
    made = solution(views, tracks, "shift", gcps)
    off = np.concatenate([made._equations(gcp).misclosure for gcp in gcps])
    assert made.criterion(0.3, gcps) == pytest.approx(
        90 * np.log((np.minimum(made._residuals(), 0.3) ** 2).mean())
        + len(off) * np.log((off**2 + POINTING.control.least_noise_px**2).mean())
        + 4 * np.log(90 + len(off))
    )
    assert made.control_misses(gcps) == pytest.approx(np.sqrt(np.mean(off**2)))
    assert made.control_misses(()) == 0.0


def control(views, wrong=(1.0, -2.0), count=8):
    """Control points that all views see, whose pixels are off alike."""
    _, ground = tracks_on(views, count, seed=7)
    return [
        Gcp(f"P{k}", *map(float, place), "control", {view.name: view.project(place) + wrong for view in views})
        for k, place in enumerate(ground)
    ]


def test_a_suspect_that_agrees_with_the_others_is_taken_back(urban, monkeypatch):
    views = urban.views[:2]
    tracks, _ = tracks_on(views, 80, noise=0.05)
    gcps = control(views)
    gcps[5] = replace(gcps[5], pixels={name: pixel + (9.0, 4.0) for name, pixel in gcps[5].pixels.items()})
    monkeypatch.setattr(adjustment, "suspects", lambda *given: [2, 5])
    found = adjustment.adjust(views, tracks, 200.0, "shift", gcps)
    assert found.rejected == ("P5",)
    for shift in found.shifts.values():
        assert shift == pytest.approx([1.0, -2.0], abs=0.1)


def test_a_trend_is_how_far_a_corner_goes_from_the_middle(urban):
    view = urban.views[0]
    drift = np.array([[1.0 + 2.0 / 199.5, 0.0, 0.0], [0.0, 1.0 - 1.0 / 199.5, 5.0]])
    made = adjustment.Adjustment({view.name: drift}, "affine", "", *(np.empty(0),) * 3, sizes={view.name: view.size})
    assert view.size == (400, 400) and made.trends_px == {view.name: pytest.approx(np.hypot(2.0, 1.0))}
    assert made.shifts[view.name] == pytest.approx([2.0, 4.0])


def test_the_vertical_parallax_is_what_no_height_takes_up(urban):
    """A shift of one image along it is the parallax itself; one along the height's own direction leaves none."""
    views = urban.views[:2]
    _, ground = tracks_on(views, 30)
    exact = [view.project(ground) for view in views]
    none, azimuth = vertical_parallax(tuple(views), tuple(exact), ground)
    assert np.abs(none).max() < 1e-6
    higher = ground + (0.0, 0.0, 8.0)
    moved, _ = vertical_parallax(tuple(views), tuple(view.project(higher) for view in views), ground)
    assert np.abs(moved).max() < 0.01
    frame = EnuFrame(*map(float, ground[0]))
    away = np.radians(azimuth[0])
    place = frame.to_geodetic(3.0 * views[0].gsd_m * np.array([np.sin(away), np.cos(away), 0.0]))
    step = views[0].project(place) - exact[0][0]
    found, _ = vertical_parallax(tuple(views), (exact[0] + step, exact[1]), ground)
    assert found == pytest.approx(np.full(30, np.linalg.norm(step)), rel=0.05)
    assert azimuth == pytest.approx(np.full(30, azimuth[0]), abs=2.0)
    right, _ = vertical_parallax(tuple(views), (exact[0] + np.array([2.0, 0.0]), exact[1]), ground)
    assert (right > 1.0).all(), "right in the first image is positive where heights move it along rows"
    # With both images moved apart by half each, one px still counts as one.
    half, _ = vertical_parallax(tuple(views), (exact[0] + step / 2, exact[1] - step / 2), ground)
    assert half == pytest.approx(found, rel=0.05)


def test_the_parallax_of_images_on_their_side_is_the_same(urban):
    """Rows and columns exchanged: it runs along the other axis of the pixels, as long and to the same side."""
    views = urban.views[:2]
    _, ground = tracks_on(views, 30)
    pixels = [view.project(ground) + shift for view, shift in zip(views, ((1.0, 2.0), (-0.5, 0.25)))]
    found, azimuth = vertical_parallax(tuple(views), tuple(pixels), ground)
    turned = []
    for view in views:
        names = [f"{{}}_{part}" for part in ("off", "scale", "num", "den")]
        changes = {name.format("row"): getattr(view.rpc, name.format("col")) for name in names}
        changes.update({name.format("col"): getattr(view.rpc, name.format("row")) for name in names})
        turned.append(replace(view, rpc=replace(view.rpc, **changes), width=view.height, height=view.width))
    other, direction = vertical_parallax(tuple(turned), tuple(pixel[:, ::-1] for pixel in pixels), ground)
    assert other == pytest.approx(found, abs=1e-6) and direction == pytest.approx(azimuth, abs=1e-3)
    assert np.abs(found).min() > 0.5


def test_only_tracks_that_both_views_see_have_one(urban):
    views = urban.views[:3]
    tracks, ground = tracks_on(views, 12)
    for k in (0, 5):
        tracks[k].pixels.pop(views[1].name)
    numbers, parallax, _ = tracks_of_pair((views[0], views[1]), tracks, ground)
    assert numbers.tolist() == [1, 2, 3, 4, 6, 7, 8, 9, 10, 11] and len(parallax) == 10
    assert len(tracks_of_pair((views[0], views[1]), [tracks[0]], ground)[0]) == 0


def test_altitudes_are_those_of_good_ties_in_and_around_a_rectangle():
    """The eastern and northern fifth is higher; ties far away and wrong matches count nothing."""
    rng = np.random.default_rng(3)
    xy = rng.uniform(0.0, 100.0, (2000, 2))
    height = np.where((xy > 80.0).any(axis=1), 200.0, 100.0)
    far, wrong = rng.uniform(200.0, 300.0, (500, 2)), rng.uniform(0.0, 100.0, (500, 2))
    ground = np.zeros((3000, 3))
    ground[:, 2] = [*height, *np.full(500, 900.0), *np.full(500, -900.0)]
    residual = np.repeat([0.3, 0.3, POINTING.good_px + 1.0], [2000, 500, 500])
    adjusted = adjustment.Adjustment({}, "shift", "", ground, residual, residual)
    pointing = Pointing([], [], adjusted, np.vstack([xy, far, wrong]), None)
    assert pointing.altitudes(Bounds(0.0, 0.0, 100.0, 100.0)) == (100.0, 200.0)
    assert POINTING.around * 40.0 <= 20.0 and pointing.altitudes(Bounds(20.0, 20.0, 60.0, 60.0)) == (100.0, 100.0)
    assert pointing.altitudes(Bounds(40.0, 40.0, 79.0, 79.0)) == (100.0, 200.0), "around it"
    assert pointing.altitudes(Bounds(-90.0, -90.0, -50.0, -50.0)) is None
    assert pointing.altitudes(Bounds(1.0, 1.0, 1.5, 1.5)) is None
