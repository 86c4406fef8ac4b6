"""Coarse to fine: priors on pairs of known disparity, and the rows that they put right against GDAL's RPCs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from repm_qgis.contracts.arrays import Bounds, Window
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.geometry.interpolation import interpolate_steps
from repm_qgis.imagery.warping import reduced, sample_array
from repm_qgis.matching import sgm
from repm_qgis.matching.disparity_prior import (
    STEP_PX,
    CoarseLevel,
    DisparityPrior,
    bounded_slope,
    coarse_level,
    fill_gaps,
    find_prior,
    needs_coarse_level,
)
from repm_qgis.matching.parameters import MATCHING
from repm_qgis.stereo.pairing import rectified_pair
from repm_qgis.stereo.triangulation import NodeTable, pair_geometry
from tests.engine.matching.pairs import reduced_pair

HEIGHT, WIDTH = 384, 512
LOW, HIGH = -80, 80
LEVEL = SimpleNamespace(height_sign=1.0, metres_per_px=3.0)


def hills(columns):
    """Disparity of the ground, rising by up to 0.45 px a px."""
    return 60 * np.sin(2 * np.pi * columns / 840.0)


class Known:
    """A pair whose second image is painted, and the first sampled from it at columns less the disparity."""

    def __init__(self, tower=0.0, seed=0, relief=1.0, side=40):
        rng = np.random.default_rng(seed)
        grain = cv2.GaussianBlur(rng.normal(size=(HEIGHT, WIDTH + 400)), (0, 0), 1.2)
        self.painted = np.clip(0.5 + 0.35 * grain, 0, 1).astype(np.float32)
        columns = np.repeat(np.arange(WIDTH, dtype=np.float64)[None], HEIGHT, axis=0)
        self.disparity = relief * hills(columns)
        half = side // 2
        self.disparity[190 - half : 190 + half, 270 - half : 270 + half] += tower
        self.first = self.second_at(columns - self.disparity)

    def second_at(self, columns):
        rows = np.repeat(np.arange(columns.shape[0], dtype=np.float64)[:, None], columns.shape[1], axis=1)
        return sample_array(self.painted, np.stack([columns + 200, rows], axis=-1), "cubic")

    def second(self, high, low):
        """Column c shows the rectified column c - high."""
        return self.second_at(np.repeat(np.arange(WIDTH + high - low, dtype=np.float64)[None] - high, HEIGHT, axis=0))


def prior_of(first, second, search=(LOW, HIGH), parameters=MATCHING):
    if not needs_coarse_level(search, first.shape, parameters.prior):
        return None
    coarse = coarse_level(reduced_pair(first, second, search), first.shape, 1.0, sgm.match, parameters)
    return find_prior(coarse, Window(0, 0, *first.shape[::-1]), LEVEL, parameters.prior)


def test_a_prior_leaves_a_small_search_and_gives_the_whole_disparity():
    known = Known(tower=15.0)
    prior = prior_of(known.first, known.second(HIGH, LOW))
    assert prior is not None and prior.high - prior.low < 0.5 * (HIGH - LOW)
    assert prior.low < -3 and prior.high > 18  # the tower has its room, though the coarse level loses it
    nodes = interpolate_steps(prior.nodes, (HEIGHT, WIDTH + prior.high - prior.low), STEP_PX)
    columns = np.arange(nodes.shape[1], dtype=np.float64)[None] - prior.high
    residual = sgm.match(known.first, known.second_at(columns - nodes), (prior.low, prior.high), 1.0)
    error = (prior.full_disparity(residual.disparity) - known.disparity)[16:-16, 16:-16]
    error[residual.filled[16:-16, 16:-16]] = np.nan
    plain = sgm.match(known.first, known.second(HIGH, LOW), (LOW, HIGH), 1.0)
    before = (np.where(plain.filled, np.nan, plain.disparity) - known.disparity)[16:-16, 16:-16]
    assert np.nanmedian(np.abs(error)) < min(0.05, np.nanmedian(np.abs(before)))
    assert (np.abs(error) < 0.5).mean() > max(0.93, (np.abs(before) < 0.5).mean())
    tower = error[170 - 16 + 6 : 210 - 16 - 6, 250 - 16 + 6 : 290 - 16 - 6]
    assert np.nanmedian(np.abs(tower)) < 0.1


def test_whole_disparities_count_the_prior_where_the_match_lies():
    rng = np.random.default_rng(1)
    nodes = np.cumsum(rng.uniform(-8, 8, (5, 9)), axis=1)
    prior = DisparityPrior(nodes, -20, 30)
    residual = rng.uniform(-19, 29, (60, 70)).astype(np.float32)
    residual[3, 5] = np.nan
    full = prior.full_disparity(residual)
    fine = interpolate_steps(nodes, (60, 128), STEP_PX)
    for row, column in ((0, 0), (17, 40), (59, 69), (31, 8)):
        place = column - residual[row, column] + prior.high
        expected = residual[row, column] + np.interp(place, np.arange(128), fine[row])
        assert full[row, column] == pytest.approx(expected, abs=1e-4)
    assert full.dtype == np.float32 and np.isnan(full[3, 5]) and np.isfinite(full).sum() == full.size - 1


def test_where_the_search_cannot_be_narrowed_there_is_no_prior():
    known = Known()
    assert prior_of(known.first, known.second(24, -16), (-16, 24)) is None
    blank = np.full((HEIGHT, WIDTH), 0.5, np.float32)
    wide = np.full((HEIGHT, WIDTH + HIGH - LOW), 0.5, np.float32)
    assert prior_of(blank, wide) is None


def test_a_town_on_a_plain_has_no_prior_and_one_on_hills_has():
    """What a smooth prior leaves of a town is as rough as the town: it would only bend the roofs."""
    for relief, wanted in ((0.05, False), (1.0, True)):
        known = Known(tower=24.0, relief=relief, side=120)
        prior = prior_of(known.first, known.second(HIGH, LOW))
        assert (prior is not None) == wanted
        allowed = replace(MATCHING, prior=replace(MATCHING.prior, most_rough=np.inf))
        assert prior_of(known.first, known.second(HIGH, LOW), parameters=allowed) is not None


def test_slopes_are_bounded_and_gentle_ones_kept():
    rng = np.random.default_rng(2)
    gentle = np.cumsum(rng.uniform(-0.9, 0.9, (20, 50)), axis=1)
    assert bounded_slope(gentle, 1.0, 1.0) == pytest.approx(gentle)
    steep = gentle.copy()
    steep[:, 25:] += 12
    bounded = bounded_slope(steep, 1.0, 1.0)
    assert np.abs(np.diff(bounded, axis=1)).max() <= 1 + 1e-9
    assert np.abs(bounded[:, :8] - steep[:, :8]).max() < 1e-9 and np.abs(bounded[:, -5:] - steep[:, -5:]).max() < 1e-9


def test_the_ground_may_fall_more_steeply_than_it_rises():
    """Slopes that lean away from the first image of a wide pair fall by more than a px a px: only rises could fold."""
    wall = np.zeros((3, 60))
    wall[:, 20:] -= 24
    bounded = bounded_slope(wall, 0.5, 2.0)
    assert np.diff(bounded, axis=1).min() == pytest.approx(-2.0)
    assert np.diff(bounded, axis=1).max() <= 1e-9
    steps = np.diff(bounded_slope(-wall, 0.5, 2.0), axis=1)
    assert steps.max() == pytest.approx(0.5) and steps.min() >= -1e-9


def test_gaps_of_the_ground_are_filled_from_around_them():
    rows, columns = np.indices((40, 60), dtype=np.float32)
    ground = 3 * columns + rows
    holed = ground.copy()
    holed[10:20, 20:34] = np.nan
    filled = fill_gaps(holed, 2.0)
    assert np.isfinite(filled).all() and (filled[np.isfinite(holed)] == ground[np.isfinite(holed)]).all()
    assert np.abs(filled - ground).max() < 16  # of 42 across the gap
    assert filled[10:20, 20:34].min() > ground[10:20, 20:34].min() - 9


def test_reduced_images_are_means_and_know_no_half_pixels():
    image = np.arange(9 * 14, dtype=np.float32).reshape(9, 14)
    image[1, 1] = np.nan
    small = reduced(image, 4)
    assert small.shape == (2, 3) and np.isnan(small[0, 0])
    assert small[1, 2] == pytest.approx(image[4:8, 8:12].mean())


def test_rows_are_those_that_the_rpcs_say(case, gdal_pixels):
    """On the prior, the second image is sampled where its RPC sees the first one's pixel, whatever the model."""
    pair = rectified_pair(replace(case.scene, refinement="none"), *case.views, case.bounds, case.altitudes)
    geometry = pair_geometry(pair, *case.views, case.altitudes, case.crs)
    columns, rows = (np.arange(0, size, STEP_PX, dtype=np.float64) for size in pair.size)
    prior = np.add.outer(0.1 * rows, 0.2 * columns)
    prior = np.clip(prior - prior.mean(), *geometry.disparities)
    sampled = DisparityPrior(prior, 0, 0).second_original(pair, geometry)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    height = geometry.height.on_grid(columns, rows, prior)
    x, y = (table.on_grid(columns, rows, height) for table in (geometry.x, geometry.y))
    ground = np.column_stack(
        [geodetic_from_projected(case.crs, np.column_stack([x.ravel(), y.ravel()])), height.ravel()]
    )
    assert np.abs(gdal_pixels(case.views[0].rpc, ground) - pair.first_original(pixels).reshape(-1, 2)).max() < 0.02
    assert np.abs(gdal_pixels(case.views[1].rpc, ground) - sampled.reshape(-1, 2)).max() < 0.02


def table(value):
    """A table whose value is a function of column, row and a third variable, linear in the last."""
    columns, rows = np.linspace(0, 640, 21), np.linspace(0, 480, 16)
    c, r = np.meshgrid(columns, rows)
    third = np.broadcast_to(np.linspace(-100, 100, 5)[:, None, None], (5, *c.shape))
    return NodeTable.fit(columns, rows, third, value(c, r, third) + np.zeros(third.shape))[0]


def test_what_shows_the_tile_is_matched_and_little_beside_it():
    """Lines of sight that lean by half a px a px of disparity, over a hill: each pixel that shows the tile stays."""
    geometry = SimpleNamespace(
        height_sign=1.0,
        metres_per_px=10.0,
        height=table(lambda c, r, d: 10.0 * d),
        x=table(lambda c, r, z: 1000.0 + c + 0.05 * z),
        y=table(lambda c, r, z: 5000.0 - r),
    )
    shape, (height, width) = (480, 640), (120, 160)
    rows, columns = np.indices(shape)
    hill = 70.0 * np.exp(-(((columns - 300) / 150.0) ** 2) - ((rows - 200) / 120.0) ** 2)
    coarse = hill.reshape(height, 4, width, 4).mean(axis=(1, 3)).astype(np.float32)
    coarse[40:44, 60:70] = np.nan
    bounds = Bounds(1200.0, 4700.0, 1400.0, 4900.0)
    window = CoarseLevel(coarse, (-100, 100), shape).window(bounds, geometry, MATCHING.prior)
    x, y = 1000.0 + columns + 0.5 * hill, 5000.0 - rows
    shown = (x >= bounds.xmin) & (x <= bounds.xmax) & (y >= bounds.ymin) & (y <= bounds.ymax)
    assert shown[window.inside(Window(0, 0, 640, 480))].sum() == shown.sum() > 0
    assert window.width * window.height < 0.4 * shown.size < 480 * 640
    assert all(edge % 16 == 0 for edge in (window.col, window.row))


def test_a_frame_of_which_nothing_is_known_is_matched_as_a_whole():
    geometry = SimpleNamespace(
        height_sign=1.0,
        metres_per_px=10.0,
        height=table(lambda c, r, d: 10.0 * d),
        x=table(lambda c, r, z: c + 9000.0),
        y=table(lambda c, r, z: -r),
    )
    nothing = CoarseLevel(np.full((120, 160), np.nan, np.float32), (-100, 100), (480, 640))
    assert nothing.window(Bounds(0.0, 0.0, 10.0, 10.0), geometry, MATCHING.prior) == Window(0, 0, 640, 480)


def test_gaps_of_a_narrow_strip_end():
    """One known cell of a strip: no Gaussian knows enough of the other end, and the search for one had no end."""
    strip = np.full((60, 2), np.nan, np.float32)
    strip[0, 0] = 7.0
    filled = fill_gaps(strip, 2.0)
    assert np.isfinite(filled).all() and np.abs(filled - 7.0).max() < 1e-3
