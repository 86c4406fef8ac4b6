"""The steps from view to view along which ties are aligned, and the parts that register them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.ties import tie_alignment
from repm_qgis.ties.parameters import TIES
from repm_qgis.ties.tie_alignment import _evened, _registered, _steps, _tracks

ALIGNMENT = TIES.alignment


def test_each_view_is_reached_by_as_few_pairs_as_possible():
    pairs = [("c", "d"), ("a", "b"), ("b", "c"), ("a", "c"), ("x", "a")]
    assert _steps(["a", "b", "c", "d"], pairs) == [(0, "a", "b"), (0, "a", "c"), (1, "c", "d")]
    chain = [("a", "b"), ("b", "c"), ("c", "d")]
    assert _steps(["a", "b", "c", "d"], chain) == [(0, "a", "b"), (1, "b", "c"), (2, "c", "d")]
    assert _steps(["b", "c"], chain) == [(0, "b", "c")] and _steps(["a", "d"], chain) == []
    assert _steps(["d", "c"], chain) == [(0, "d", "c")]


def test_views_beyond_a_failed_step_are_tracks_of_their_own():
    pixels = {name: np.array([float(k), 0.0]) for k, name in enumerate("abcde")}
    made = _tracks(pixels, {"a": "a", "b": "a", "c": "c", "d": "c", "e": "e"})
    assert [sorted(track.pixels) for track in made] == [["a", "b"], ["c", "d"]]


def texture(seed=0, side=160):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(side, side)), 1.5)
    return 128.0 + 40.0 * noise / noise.std()


def as_bytes(image):
    return np.clip(image, 0, 255).astype(np.uint8)


def places(step=16, side=160):
    at = np.arange(24.0, side - 24.0, step)
    return np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)


def test_places_are_found_to_hundredths_of_a_pixel():
    here = places()
    source, target = texture(), ndimage.shift(texture(), (-0.4, 0.7), order=3, mode="nearest")
    found, good = _registered(as_bytes(source), as_bytes(target), here, here + (0.5, 0.0), ALIGNMENT)
    assert good.mean() > 0.5 and found[good] - here[good] == pytest.approx(
        np.tile([0.7, -0.4], (good.sum(), 1)), abs=0.05
    )


def test_what_is_too_far_or_does_not_come_back_is_dropped():
    here = places()
    source = texture()
    for by, share in ((1.2, 0.5), (1.8, 0.0)):
        target = ndimage.shift(source, (0.0, by), order=3, mode="nearest")
        _, good = _registered(as_bytes(source), as_bytes(target), here, here, ALIGNMENT)
        assert (good.mean() > share) if share else not good.any(), by
    _, good = _registered(as_bytes(source), as_bytes(texture(9)), here, here, ALIGNMENT)
    assert good.mean() < 0.2


def test_of_many_ties_the_most_alike_stay():
    here = places(8)
    target = texture() + np.random.default_rng(3).normal(0, 6, (160, 160))
    _, good = _registered(as_bytes(texture()), as_bytes(target), here, here, ALIGNMENT)
    assert 0.6 < good.sum() / len(here) <= ALIGNMENT.most_alike + 0.02
    few = here[::20]
    _, good = _registered(as_bytes(texture()), as_bytes(target), few, few, ALIGNMENT)
    assert len(few) < ALIGNMENT.enough and good.all()


def test_images_that_share_half_of_their_texture_are_aligned_in_wider_windows():
    """As across seasons, where few of the small windows agree."""
    here = places(8, 320)
    mixed = ndimage.shift(texture(side=320), (-0.4, 0.7), order=3, mode="nearest") + texture(7, 320) - 128.0
    target = 128.0 + 40.0 * (mixed - 128.0) / mixed.std()
    found, good = _registered(as_bytes(texture(side=320)), as_bytes(target), here, here + (0.5, 0.0), ALIGNMENT)
    error = np.hypot(*(found - here - (0.7, -0.4))[good].T)
    assert good.mean() > 0.5 and np.median(error) < 0.4


def test_evened_images_have_one_contrast_and_do_not_wrap(monkeypatch, urban):
    """A black or white spot on even ground is black or white: numbers beyond a byte would come in at its other end."""
    pixels = texture(5) / 255.0 * np.linspace(0.2, 1.0, 160)  # contrast that grows to the east
    spots = np.full((160, 160), 0.5)
    spots[80, 40], spots[80, 120] = 1.0, 0.0

    class AsIs:
        @staticmethod
        def apply(values):
            return values

    for image in (pixels, spots):
        monkeypatch.setattr(tie_alignment, "warp_coarsened", lambda *given, image=image: image)
        evened = _evened(urban.views[0], AsIs, None, (160, 160), 1.0, ALIGNMENT).astype(float)
        if image is pixels:
            halves = [evened[20:140, part].std() for part in (slice(20, 60), slice(100, 140))]
            assert halves[0] == pytest.approx(halves[1], rel=0.15) and evened.mean() == pytest.approx(128, abs=4)
            assert halves[1] == pytest.approx(ALIGNMENT.even_contrast, rel=0.35)
        else:
            assert evened[80, 40] == 255 and evened[80, 120] == 0 and evened[10, 10] == 128
