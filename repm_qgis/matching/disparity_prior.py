"""Coarse to fine: a reduced pair is matched over all altitudes, and its result is the prior of the fine matching.

The *disparity prior* is a smooth disparity of the ground (not of its houses). The second image is resampled once, with
the prior in the map: there the ground has a residual disparity of about zero, slopes are level, and the fine matcher
searches tens of px whatever the relief. The prior also gives the ground's altitude, so that the RPCs can remove the
vertical parallax that the pinhole model leaves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Optional, Tuple

import cv2
import numpy as np

from ..contracts.arrays import Bounds, FloatArray, FloatImage, Floats, Window
from ..geometry.interpolation import bilinear, interpolate_steps
from ..geometry.rectification import RectifiedPair
from ..imagery.parameters import WARPING
from ..imagery.sampling import median_of_known, median_of_neighbours
from ..imagery.warping import PixelMap
from ..numerics.robust import nmad
from ..stereo.triangulation import PairGeometry
from .disparity_map import PairMatcher
from .parameters import MATCHING, MatchingParameters, PriorParameters

STEP_PX = WARPING.node_step_px  # between the nodes of the resampled second image
_WIDEST = 4.0  # sides of an image: a Gaussian of this width is nearly constant over the image


@dataclass(frozen=True)
class DisparityPrior:
    """A disparity of the ground on nodes, and the residual disparities to search around it.

    ``nodes`` (m, n) lie ``STEP_PX`` apart in the frame of the resampled second image; bilinear between them. Its column
    c stands for the rectified column c - ``high``, both counted from the ``origin`` (column, row) of the part of the
    rectified frame that is matched. ``low`` and ``high`` are the least and greatest residual.
    """

    nodes: FloatArray
    low: int
    high: int
    origin: Tuple[int, int] = (0, 0)

    def second_original(self, pair: RectifiedPair, geometry: PairGeometry, remove_parallax: bool = True) -> FloatArray:
        """(m, n, 2) original pixels of the second image from which the nodes are sampled.

        ``remove_parallax`` removes the vertical parallax at the prior's altitude.
        """
        rows, columns = (STEP_PX * np.arange(n, dtype=np.float64) for n in self.nodes.shape)
        columns += self.origin[0] - self.high
        rows += self.origin[1]
        height = geometry.height.on_grid(columns, rows, self.nodes)
        parallax = geometry.vertical_parallax.on_grid(columns, rows, height)
        row = rows[:, None] + (parallax if remove_parallax else np.zeros_like(parallax))
        return pair.second_original(np.stack([columns[None, :] - self.nodes, row], axis=-1))

    def full_disparity(self, residual: FloatImage) -> FloatImage:
        """Disparities (H, W) from residual ones: the prior's value is that of the column where the match was found."""
        height, width = residual.shape
        wide = (height, width + self.high - self.low + 1)
        prior = interpolate_steps(self.nodes.astype(np.float32), wide, STEP_PX)
        columns = np.arange(width, dtype=np.float32) + np.float32(self.high) - np.nan_to_num(residual)
        left = np.clip(columns.astype(np.int32), 0, prior.shape[1] - 2)
        share = columns - left.astype(np.float32)
        flat = left + (np.arange(height, dtype=np.int32) * prior.shape[1])[:, None]
        here, right = prior.ravel()[flat], prior.ravel()[flat + 1]
        full: FloatImage = residual + here + (right - here) * share
        return full


class ReducedPair(NamedTuple):
    """A rectified pair at a reduced resolution, as a :class:`.disparity_map.PairMatcher` gets it; ``disparities`` are
    reduced px too."""

    first: FloatImage
    second: FloatImage
    disparities: Tuple[int, int]

    def part(self, window: Window, factor: int) -> ReducedPair:
        """The pair of a part of the frame, which begins at whole multiples of the reduction."""
        left, top, width, height = (n // factor for n in window)
        span = self.disparities[1] - self.disparities[0]
        rows, columns = slice(top, top + height), slice(left, left + width)
        return ReducedPair(self.first[rows, columns], self.second[rows, left : left + width + span], self.disparities)


@dataclass(frozen=True)
class CoarseLevel:
    """The ground in a frame, as a reduced pair shows it.

    ``disparity`` (h, w) of the reduced pixels, in px of the frame, NaN where nothing was matched; ``search`` are the
    disparities among which it was searched, and ``shape`` (height, width) is that of the frame.
    """

    disparity: FloatImage
    search: Tuple[int, int]
    shape: Tuple[int, int]

    def window(self, bounds: Bounds, geometry: PairGeometry, parameters: PriorParameters) -> Window:
        """The part of the frame that may show a ground rectangle: the rest need not be matched.

        A cell of the frame shows ground between the lines of sight at its least and its greatest disparity and those
        of its neighbours; where nothing was matched, those around it count.
        """
        step = parameters.factor * parameters.cell_px
        rows, columns = (np.minimum(step * np.arange(-(-n // step) + 1.0), n - 1.0) for n in self.shape)
        ground = []
        for disparity, more in zip(self._extremes(parameters), (-1.0, 1.0) * np.array(_more(geometry, parameters))):
            at = np.clip(disparity + more, *self.search)
            for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
                place = columns[j : len(columns) - 1 + j], rows[i : len(rows) - 1 + i]
                height = geometry.height.on_grid(*place, at)
                ground.append([table.on_grid(*place, height) for table in (geometry.x, geometry.y)])
        low, high = np.min(ground, axis=0), np.max(ground, axis=0)
        near = np.all([(high[k] >= bounds[k]) & (low[k] <= bounds[k + 2]) for k in (0, 1)], axis=0)
        across, down = np.flatnonzero(near.any(axis=0)), np.flatnonzero(near.any(axis=1))
        if not across.size:
            return Window(0, 0, self.shape[1], self.shape[0])
        left, top = step * int(across[0]), step * int(down[0])
        right, bottom = (min(step * int(of[-1] + 1), n) for of, n in zip((across, down), self.shape[::-1]))
        return Window.spanning(left, top, right, bottom)

    def _extremes(self, parameters: PriorParameters) -> Tuple[FloatArray, FloatArray]:
        """(rows, columns) least and greatest disparity of each cell and its neighbours, the last cells incomplete."""
        step, cell = parameters.factor * parameters.cell_px, parameters.cell_px
        height, width = (-(-n // step) for n in self.shape)
        padded = np.full((height * cell, width * cell), np.nan, dtype=np.float32)
        rows, columns = self.disparity.shape
        padded[:rows, :columns] = self.disparity
        blocks = padded.reshape(height, cell, width, cell)
        window = np.ones((3, 3), np.uint8)
        least, greatest = (
            fill_gaps(np.where(np.isfinite(ends), ends, np.float32(np.nan)), parameters.gap_cells)
            for ends in (np.fmin.reduce(blocks, axis=(1, 3)), np.fmax.reduce(blocks, axis=(1, 3)))
        )
        return cv2.erode(least, window).astype(np.float64), cv2.dilate(greatest, window).astype(np.float64)


def coarse_level(
    pair: ReducedPair,
    shape: Tuple[int, int],
    height_sign: float,
    match: PairMatcher,
    parameters: MatchingParameters = MATCHING,
) -> CoarseLevel:
    """Match a reduced pair of a frame of ``shape`` (height, width)."""
    p = parameters.prior
    found = match(pair.first, pair.second, pair.disparities, height_sign, parameters=parameters)
    disparity = np.where(found.filled, np.float32(np.nan), found.disparity) * np.float32(p.factor)
    return CoarseLevel(disparity, (pair.disparities[0] * p.factor, pair.disparities[1] * p.factor), shape)


def needs_coarse_level(disparities: Tuple[int, int], shape: Tuple[int, int], parameters: PriorParameters) -> bool:
    """Whether a search of these disparities in a frame (height, width) is so wide that a coarse one pays."""
    p = parameters
    return disparities[1] - disparities[0] >= p.least_span_px and min(shape) >= p.factor * p.cell_px * 4


def find_prior(
    coarse: CoarseLevel, window: Window, geometry: PairGeometry, parameters: PriorParameters = MATCHING.prior
) -> Optional[DisparityPrior]:
    """The prior of a window of the frame; None where it does not narrow the search, and for a town on a plain: it is
    smoother than a town's walls, and bends the roofs beside them."""
    p, step_px = parameters, parameters.factor * parameters.cell_px
    ground = _ground(coarse.disparity, p)
    if ground is None:
        return None
    ground = bounded_slope(ground, p.rise * step_px, p.fall * step_px)
    residual = _residual(coarse.disparity, ground, p)
    if _is_town(residual, coarse.disparity[np.isfinite(coarse.disparity)], p):
        return None
    low, high = ends = _residual_range(residual, geometry, p)
    if high - low > p.least_gain * (coarse.search[1] - coarse.search[0]):
        return None
    return DisparityPrior(_nodes(ground, window, ends, step_px), low, high, (window.col, window.row))


def _ground(coarse: FloatImage, parameters: PriorParameters) -> Optional[FloatArray]:
    """Disparity of the ground in cells: medians of cells and of their neighbours, gaps filled, smoothed."""
    cell, side = parameters.cell_px, parameters.median_cells
    height, width = (n // cell for n in coarse.shape)
    blocks = coarse[: height * cell, : width * cell].reshape(height, cell, width, cell)
    cells = median_of_known(blocks.transpose(1, 3, 0, 2).reshape(cell * cell, height, width), cell)
    if np.isfinite(cells).mean() < parameters.least_cells:
        return None
    ground = fill_gaps(median_of_neighbours(cells, side, side), parameters.gap_cells)
    smooth: FloatImage = cv2.GaussianBlur(ground, (0, 0), parameters.smooth_cells, borderType=cv2.BORDER_REFLECT)
    return smooth.astype(np.float64)


def fill_gaps(cells: FloatImage, sigma: float) -> FloatImage:
    """Gaps filled from their surroundings: Gaussian means of growing width, of which the narrowest with enough known
    cells is used. Where the known cells are few and far from the gaps, as in a strip that two frames share, no width
    has enough: these gaps get the mean of all known cells.
    """
    known = np.isfinite(cells)
    value, weight = np.where(known, cells, np.float32(0)), known.astype(np.float32)
    result, missing = value.copy(), ~known if known.any() else known
    while missing.any() and sigma <= _WIDEST * max(cells.shape):
        share = cv2.GaussianBlur(weight, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        total = cv2.GaussianBlur(value, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        near = missing & (share > 1e-3)
        result[near] = total[near] / share[near]
        missing &= ~near
        sigma *= 2
    if missing.any():
        result[missing] = cells[known].mean()
    return result


def bounded_slope(ground: FloatArray, rise: float, fall: float) -> FloatArray:
    """The mean of the lowest surface above and the highest below that rise and fall along rows by so much a step."""
    above, below = ground.copy(), ground.copy()
    columns = range(1, ground.shape[1])
    for j in columns:
        above[:, j] = np.maximum(above[:, j], above[:, j - 1] - fall)
        below[:, j] = np.minimum(below[:, j], below[:, j - 1] + rise)
    for j in reversed(columns):
        above[:, j - 1] = np.maximum(above[:, j - 1], above[:, j] - rise)
        below[:, j - 1] = np.minimum(below[:, j - 1], below[:, j] + fall)
    return (above + below) / 2


def _level_beyond(ground: FloatArray, columns: FloatArray, rows: FloatArray, step_px: int) -> FloatArray:
    """Bilinear ground at fine columns and rows of one shape; it continues level beyond its border."""
    u = np.clip((columns - (step_px - 1) / 2) / step_px, 0, ground.shape[1] - 1)
    v = np.clip((rows - (step_px - 1) / 2) / step_px, 0, ground.shape[0] - 1)
    return bilinear(ground, u, v)


def _residual(coarse: FloatImage, ground: FloatArray, parameters: PriorParameters) -> FloatArray:
    """(N,) differences of known coarse disparities from the ground at the column where the match lies."""
    i, j = np.nonzero(np.isfinite(coarse))
    factor, disparity = parameters.factor, coarse[i, j].astype(np.float64)
    rows, columns = factor * i + (factor - 1) / 2, factor * j + (factor - 1) / 2
    residual = np.zeros_like(disparity)
    for _ in range(4):  # converges, because the slope of the ground is bounded
        residual = disparity - _level_beyond(ground, columns - residual, rows, factor * parameters.cell_px)
    return residual


def _is_town(residual: FloatArray, disparity: Floats, parameters: PriorParameters) -> bool:
    """Whether the residual disparities on a prior span as wide a range as the disparities themselves because of walls:
    then few values make this range."""
    left, whole = (float(np.ptp(_tails(values, parameters))) for values in (residual, disparity))
    return left > parameters.most_rough * whole and left > parameters.walls * nmad(residual)


def _tails(values: Floats, parameters: PriorParameters) -> FloatArray:
    """(2,) between which nearly all values lie."""
    ends: FloatArray = np.percentile(values, (parameters.tail_percent, 100 - parameters.tail_percent))
    return ends


def _residual_range(residual: FloatArray, geometry: PairGeometry, parameters: PriorParameters) -> Tuple[int, int]:
    """Least and greatest residual to search."""
    low, high = _tails(residual, parameters)
    more = _more(geometry, parameters)
    return int(np.floor(low - more[0])), int(np.ceil(high + more[1]))


def _more(geometry: PairGeometry, parameters: PriorParameters) -> Tuple[float, float]:
    """Px of disparity by which heights may lie below and above what the coarse level found."""
    margin, above = parameters.margin_px, parameters.margin_px + parameters.above_m / geometry.metres_per_px
    return (margin, above) if geometry.height_sign > 0 else (above, margin)


def _nodes(ground: FloatArray, window: Window, ends: Tuple[int, int], step_px: int) -> FloatArray:
    """(m, n) ground on the nodes of the resampled second image, the last at or beyond its last pixel."""
    left, top, width, height = window
    rows = np.arange(0, height + STEP_PX, STEP_PX, dtype=np.float64) + top
    columns = np.arange(0, width + ends[1] - ends[0] + 1 + STEP_PX, STEP_PX, dtype=np.float64) - ends[1] + left
    columns, rows = np.meshgrid(columns, rows)
    return _level_beyond(ground, columns, rows, step_px)


def sampled_on(nodes: FloatArray) -> PixelMap:
    """The map of pixels whose values on the warping's own nodes are given."""

    def to_source(points: FloatArray) -> FloatArray:
        column, row = (np.rint(points[..., axis] / STEP_PX).astype(np.intp) for axis in (0, 1))
        values: FloatArray = nodes[row, column]
        return values

    return to_source
