"""Resampling against functions that can be written down."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.imagery.parameters import SAMPLING
from repm_qgis.imagery.raster import opened, write
from repm_qgis.imagery.warping import (
    coarsened,
    sample_array,
    source_pixels,
    source_positions,
    warp,
    warp_coarsened,
)

ANGLE = np.radians(7.0)


def turned(points):
    """A rotation with scale and shift, whose window stays inside a 600 x 500 image."""
    x, y = points[..., 0], points[..., 1]
    return np.stack(
        [
            60.3 + 0.9 * (np.cos(ANGLE) * x - np.sin(ANGLE) * y) + 40,
            20.7 + 0.9 * (np.sin(ANGLE) * x + np.cos(ANGLE) * y),
        ],
        axis=-1,
    )


def smooth(x, y):
    return 1000 + 300 * np.sin(x / 17.0) * np.cos(y / 23.0)


def plane(x, y):
    return 500 + 0.7 * x - 0.4 * y


@pytest.fixture(scope="module")
def images(tmp_path_factory, write_image):
    folder = tmp_path_factory.mktemp("warp")
    y, x = np.mgrid[:500, :600].astype(float)
    gap = plane(x, y).astype(np.float32)
    gap[200:230, 300:340] = -9999
    return {
        "smooth": write_image(folder / "s.tif", smooth(x, y).astype(np.float32)),
        "plane": write_image(folder / "p.tif", plane(x, y).astype(np.float32)),
        "gap": write_image(folder / "g.tif", gap, nodata=-9999.0),
    }


def resampled(path, kernel, size=(400, 380), to_source=turned):
    with opened(path) as dataset:
        return warp(dataset, 1, to_source, size, kernel)


def expected(function, size=(400, 380)):
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    source = turned(np.stack([x, y], axis=-1).astype(float))
    return function(source[..., 0], source[..., 1]), source


@pytest.mark.parametrize("kernel, px", (("bilinear", 0.001), ("cubic", 0.055), ("lanczos", 0.013)))
def test_a_plane_is_kept(images, kernel, px):
    """OpenCV rounds positions to 1/32 px, and its cubic kernel (a = -0.75) bends planes a little between pixels.

    ``px`` is what that amounts to as an error of position; it must not have a bias.
    """
    found, (truth, _) = resampled(images["plane"], kernel), expected(plane)
    known = np.isfinite(found)
    assert known.mean() > 0.95
    error = (found - truth)[known]
    assert np.abs(error).max() < (0.7 + 0.4) * (1 / 64 + px) + 0.002
    assert abs(error.mean()) < 0.003


@pytest.mark.parametrize("kernel, rms", (("bilinear", 0.45), ("cubic", 0.45), ("lanczos", 0.2)))
def test_a_smooth_function_is_kept(images, kernel, rms):
    found, (truth, _) = resampled(images["smooth"], kernel), expected(smooth)
    known = np.isfinite(found)
    assert np.sqrt(np.mean((found - truth)[known] ** 2)) < rms  # of 300: half a thousandth
    assert abs(np.mean((found - truth)[known])) < 0.1


@pytest.mark.parametrize("kernel, reach", (("bilinear", 1), ("cubic", 2), ("lanczos", 4)))
def test_nodata_does_not_bleed(images, kernel, reach):
    found, (truth, source) = resampled(images["gap"], kernel), expected(plane)
    known = np.isfinite(found)
    assert np.abs((found - truth)[known]).max() < 0.1  # a drop of -9999 would show
    x, y = source[..., 0], source[..., 1]
    inside = (x >= 300) & (x <= 339) & (y >= 200) & (y <= 229)
    assert not known[inside].any()
    far = (x < 300 - reach - 1) | (x > 339 + reach + 1) | (y < 200 - reach - 1) | (y > 229 + reach + 1)
    assert known[far & (x > 8) & (y > 8) & (x < 591) & (y < 491)].all()


def test_outside_is_nan(images):
    found = resampled(images["plane"], "bilinear", (50, 40), lambda p: p + [580.0, 480.0])
    assert np.isfinite(found[:19, :19]).all() and np.isnan(found[21:]).all() and np.isnan(found[:, 21:]).all()
    assert np.isnan(resampled(images["plane"], "cubic", (50, 40), lambda p: p + [5000.0, 0.0])).all()
    assert np.isnan(resampled(images["plane"], "cubic", (50, 40), lambda p: p * np.nan)).all()


def test_strips_do_not_show(images):
    """512 rows a pass: rows on both sides of a border are as good as all others."""
    size = (60, 1100)

    def squeezed(points):
        return np.stack([points[..., 0] + 100.25, points[..., 1] * 0.4 + 20.5], axis=-1)

    whole = resampled(images["smooth"], "cubic", size, squeezed)
    x, y = np.meshgrid(np.arange(60.0) + 100.25, np.arange(1100.0) * 0.4 + 20.5)
    assert np.isfinite(whole).all()
    error = np.abs(whole - smooth(x, y)).max(axis=1)
    assert error.max() < 1.0 and error[508:516].max() <= error.max()


@pytest.mark.parametrize("size", ((1, 1), (2, 1), (1, 3), (17, 16), (33, 513), (400, 380)))
def test_positions_are_exact_for_affine_maps(size):
    found = source_positions(turned, size)
    x, y = np.meshgrid(np.arange(float(size[0])), np.arange(float(size[1])))
    assert found.shape == (size[1], size[0], 2)
    np.testing.assert_allclose(found, turned(np.stack([x, y], axis=-1)), atol=1e-9)


def test_positions_of_a_curved_map_are_within_a_thousandth():
    def curved(points):
        u = points / 8000
        return points + np.stack([9 * u[..., 0] ** 2 + 5 * u[..., 0] * u[..., 1], -12 * u[..., 1] ** 2], axis=-1)

    found = source_positions(curved, (900, 5300))
    x, y = np.meshgrid(np.arange(900.0), np.arange(5300.0))
    assert np.abs(found - curved(np.stack([x, y], axis=-1))).max() < 1e-3


def test_whole_pixels_are_taken_as_they_are():
    source = np.random.default_rng(0).normal(size=(30, 40)).astype(np.float32)
    x, y = np.meshgrid(np.arange(5.0, 30.0), np.arange(4.0, 20.0))
    for kernel in ("bilinear", "cubic", "lanczos"):
        np.testing.assert_allclose(
            sample_array(source, np.stack([x, y], axis=-1), kernel), source[4:20, 5:30], atol=1e-5
        )


@pytest.mark.parametrize("kernel", ("bilinear", "cubic", "lanczos"))
def test_images_end_at_the_centres_of_their_outermost_pixels(kernel):
    """Kernels that reach beyond find the outermost pixels again: no pixel of the image is lost."""
    source = (10.0 + np.mgrid[:30, :40].sum(axis=0)).astype(np.float32)
    x, y = np.meshgrid(np.arange(-1.0, 41.0), np.arange(-1.0, 31.0))
    found = sample_array(source, np.stack([x, y], axis=-1), kernel)
    np.testing.assert_allclose(found[1:-1, 1:-1], source, atol=1e-4)
    found[1:-1, 1:-1] = np.nan
    assert np.isnan(found).all()
    just_within = sample_array(source, np.array([[[0.25, 0.25], [38.75, 28.75]]]), kernel)[0]
    np.testing.assert_allclose(just_within, (10.5, 77.5), atol=0.2)


@pytest.mark.parametrize("name", ["smooth", "gap"])
def test_pixels_that_are_read_once_give_what_reading_for_each_result_gives(images, name):
    """Also for a part of what they were read for, at the image's resolution and reduced."""
    with opened(images[name]) as dataset:
        source = source_pixels(dataset, 1, turned, (400, 380), lambda pixels: pixels)
        part = source.sampled(lambda at: turned(at + (32, 64)), (300, 200), "cubic")
        np.testing.assert_allclose(part, warp(dataset, 1, turned, (400, 380), "cubic")[64:264, 32:332], atol=0.1)
        assert np.isnan(part).any() == (name == "gap")
        small = source.reduced(4).sampled(lambda at: turned(4 * at + 1.5), (100, 95), "bilinear")
    expected = resampled(images[name], "cubic").reshape(95, 4, 100, 4).mean(axis=(1, 3))
    both = np.isfinite(small) & np.isfinite(expected)
    assert np.abs(small - expected)[both].max() < 4.0 and both.mean() > 0.9


def test_a_frame_beside_the_image_has_no_pixels(images):
    with opened(images["plane"]) as dataset:
        source = source_pixels(dataset, 1, lambda at: at + 9000.0, (40, 30), lambda pixels: pixels)
    assert np.isnan(source.sampled(lambda at: at + 9000.0, (40, 30), "cubic")).all()
    assert np.isnan(source.reduced(4).sampled(lambda at: 4 * at + 9000.0, (10, 7), "bilinear")).all()


def test_a_finer_image_is_seen_as_coarsely_as_another(tmp_path):
    fine = np.indices((60, 90)).sum(axis=0) % 2 * 100.0 + 50.0
    image = write(str(tmp_path / "fine.tif"), [fine.astype(np.float32)], (0.0, 1.0, 0.0, 0.0, 0.0, 1.0), "")
    with opened(image) as dataset:
        plain = warp(dataset, 1, lambda p: 3.0 * p + 1.0, (30, 20), "cubic")
        seen = warp_coarsened(dataset, 1, lambda p: 3.0 * p + 1.0, (30, 20), "cubic", 3.0)
        same = warp_coarsened(dataset, 1, lambda p: 3.0 * p + 1.0, (30, 20), "cubic", 1.0)
    assert np.array_equal(same, plain, equal_nan=True)
    # A pattern that the coarser image cannot hold is its mean there, and no pattern of another width.
    assert np.nanstd(plain) > 45.0 and np.nanstd(seen) < 3.0 and np.nanmean(seen) == pytest.approx(100.0, abs=0.5)


def test_a_coarsened_image_keeps_its_gaps():
    point = np.zeros((41, 41), np.float32)
    point[20, 20] = 1.0
    seen, offset = coarsened(point, 3.0), np.arange(41) - 20.0
    assert np.sqrt((seen.sum(axis=0) * offset**2).sum()) == pytest.approx(SAMPLING.blur * np.sqrt(8.0), rel=0.02)
    point[:, :10] = np.nan
    assert np.array_equal(np.isnan(coarsened(point, 3.0)), np.isnan(point))
    assert coarsened(point, 1.0) is point
