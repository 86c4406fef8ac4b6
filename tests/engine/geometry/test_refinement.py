"""The map M and its inverse, on full scenes and in closed form."""

from __future__ import annotations

import json

import numpy as np
import pytest

from repm_qgis.contracts.checks import Misfit
from repm_qgis.contracts.errors import OptionError
from repm_qgis.geometry.equivalent_error import fit_pinhole, refine_pinhole, virtual_grid
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.geometry.refinement import (
    HomographyMap,
    PolynomialMap,
    apply_homography,
    fit_map,
    map_from_mapping,
    polynomial_terms,
    translation,
    whole_pixels,
)
from repm_qgis.rpc.readers import read_rpc_file

H = np.array([[1.02, 0.03, 40.0], [-0.02, 0.97, -25.0], [2e-6, -1e-6, 1.0]])


def pixels(count=400, side=8000):
    return np.random.default_rng(2).uniform(0, side, (count, 2))


def bent(p):
    """A map whose inverse is not a polynomial."""
    u = p / 8000
    return p + np.stack([6 + 12 * u[:, 0] * u[:, 1] - 9 * u[:, 1] ** 2, -3 + 14 * u[:, 0] ** 2 - 5 * u[:, 0]], axis=1)


def test_homography_is_found_and_inverted():
    p = pixels()
    found = fit_map("homography", p, apply_homography(H, p), np.eye(3))
    np.testing.assert_allclose(found.matrix, H, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(found.refined_from_original(found.original_from_refined(p)), p, atol=1e-6)


def test_quadratic_map_is_found_and_inverted():
    p = pixels()
    found = fit_map("polynomial", p, bent(p), np.eye(3))
    np.testing.assert_allclose(found.original_from_refined(p), bent(p), atol=1e-6)
    np.testing.assert_allclose(found.refined_from_original(bent(p)), p, atol=1e-5)
    np.testing.assert_allclose(found.refined_from_original(bent(p).reshape(20, 20, 2)), p.reshape(20, 20, 2), atol=1e-5)


def test_none_only_takes_the_skew_out():
    skew = np.array([[1, 0.01, 3.0], [0, 1, 0], [0, 0, 1]])
    p = pixels(10)
    np.testing.assert_allclose(
        fit_map("none", p, p + 99, skew).original_from_refined(p),
        p + np.column_stack([0.01 * p[:, 1] + 3, np.zeros(10)]),
        atol=1e-9,
    )


@pytest.mark.parametrize("site", ("giza", "calanques", "ubaye", "ossoue"))
def test_round_trip_over_full_scenes(shared_data, site):
    rpc = read_rpc_file(sorted((shared_data / "rpc" / "pleiades").glob(f"{site}__*.XML"))[0])
    window = (0, 0, int(2 * rpc.col_off), int(2 * rpc.row_off))
    grid = virtual_grid(rpc.localise, window, rpc.height_range, EnuFrame(rpc.lon_off, rpc.lat_off, 0.0))
    fitted = fit_pinhole(grid)
    for model in ("none", "homography", "polynomial"):
        refined = refine_pinhole(model, fitted.camera, grid, window=window)
        again = refined.to_original.original_from_refined(refined.to_original.refined_from_original(grid.pixels))
        assert np.abs(again - grid.pixels).max() < 1e-3


@pytest.mark.parametrize("make", (lambda p: HomographyMap(H), lambda p: fit_map("polynomial", p, bent(p), np.eye(3))))
def test_moved_is_the_same_map_from_another_corner(make):
    p = pixels()
    whole = make(p)
    part = whole.moved(123, 456)
    np.testing.assert_allclose(part.original_from_refined(p - [123, 456]), whole.original_from_refined(p), atol=1e-6)
    original = whole.original_from_refined(p)
    np.testing.assert_allclose(part.refined_from_original(original), p - [123, 456], atol=1e-5)
    again = map_from_mapping(json.loads(json.dumps(part.to_mapping())), None, None)
    np.testing.assert_array_equal(again.original_from_refined(p), part.original_from_refined(p))


def test_terms_are_the_papers():
    assert polynomial_terms(np.array([2.0, 3.0]), 2).tolist() == [1, 2, 3, 6, 4, 9]
    assert polynomial_terms(np.array([2.0, 3.0]), 3).tolist() == [1, 2, 3, 6, 4, 9, 8, 12, 18, 27]


def test_where_m_cannot_be_inverted_it_says_nan():
    wild = PolynomialMap(2, np.zeros(2), 1.0, np.array([[0, 0], [0, 0], [0, 0], [0, 0], [5.0, 0], [0, 5.0]]))
    with np.errstate(over="ignore", invalid="ignore"):
        found = wild.refined_from_original(np.array([[0.001, 0.001], [-50.0, 7.0]]))
    assert np.isfinite(found[0]).all() and np.isnan(found[1]).all()


@pytest.mark.parametrize(
    "target, found",
    (
        (0.2, True),  # steps shrink by 0.34 each
        (-0.05, True),
        (0.6525, False),  # by 0.9: after all steps some hundredths of a px are left
        (1.3, False),  # the iteration runs through four places for ever, all finite
        (-0.5, False),  # no pixel has this image
    ),
)
def test_an_inverse_that_is_not_found_is_nan_and_not_the_last_guess(target, found):
    """M(x, y) = (x + x^2, y), whose inverse is known: (sqrt(1 + 4 x) - 1) / 2."""
    square = PolynomialMap(2, np.zeros(2), 1.0, np.array([[0, 0], [0, 0], [0, 0], [0, 0], [1.0, 0], [0, 0]]))
    with np.errstate(over="ignore", invalid="ignore"):
        near, asked = square.refined_from_original(np.array([[0.0, 7.0], [target, -3.0]]))
    np.testing.assert_allclose(near, [0.0, 7.0], atol=1e-9)
    if found:
        np.testing.assert_allclose(asked, [(np.sqrt(1 + 4 * target) - 1) / 2, -3.0], atol=1e-6)
    else:
        assert np.isnan(asked).all()


@pytest.mark.parametrize("wrong", (5.0, 1e4, 1e10))
def test_a_stored_map_without_an_inverse_is_refused(wrong):
    """A damaged scene was read, and an export of its cameras ended in "cannot convert float NaN to integer"."""
    stored = PolynomialMap(2, np.array([50.0, 40.0]), 50.0, np.zeros((6, 2))).to_mapping()
    assert isinstance(map_from_mapping(stored, None, None), PolynomialMap)
    stored["coefficients"] = [[0, 0], [0, 0], [0, 0], [0, 0], [wrong * 50.0, 0], [0, wrong]]
    with pytest.raises(Misfit, match="coefficients without an inverse"):
        map_from_mapping(stored, None, None)


def test_unknown_models_and_kinds():
    with pytest.raises(OptionError, match="MODEL is 'cubic'"):
        fit_map("cubic", pixels(10), pixels(10), np.eye(3))
    with pytest.raises(Misfit, match="to_original.kind is 'spline': it must be homography, polynomial or terrain"):
        map_from_mapping({"kind": "spline"}, None, None)
    np.testing.assert_array_equal(apply_homography(translation(3, 4), np.zeros(2)), [3, 4])


def test_a_frame_does_not_hang_on_the_last_bits_of_its_corners():
    """Sums of other orders, as of another number of threads, differ by so much."""
    for bits in (-1e-12, 0.0, 1e-12):
        low, high = whole_pixels(np.array([3.0 + bits, -2.0 - bits]), np.array([900.0 - bits, 7.25]))
        assert (*low, *high) == (3.0, -2.0, 900.0, 8.0)
