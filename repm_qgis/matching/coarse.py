"""Coarse to fine: a reduced pair is matched over all altitudes, and what it finds guides the fine one.

The *guide* is a smooth disparity of the ground (not of its houses). The second image is resampled once, with the guide
in the map: there the ground lies at a residual disparity of about zero, slopes are level, and the fine matcher
searches tens of px whatever the relief. The guide also knows the ground's altitude, so that the rows which the
pinhole model leaves apart are put right by the RPCs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

import cv2
import numpy as np

from ..altitudes import ALTITUDES
from ..arrays import FloatArray, FloatImage
from ..geometry.interpolation import bilinear, interpolate_steps
from ..imagery.parameters import WARPING
from ..imagery.sampling import median_of_known, median_of_neighbours
from ..stereo.rectification import RectifiedPair
from ..stereo.triangulation import PairGeometry
from .disparity_map import PairMatcher

STEP_PX = WARPING.node_step_px  # between the nodes of the resampled second image

FACTOR = 4  # fine px a coarse one, along each side
_CELL = 4  # coarse px a cell of the guide, along each side: 16 fine px
_LEAST_SPAN = 48  # px of disparity below which there is nothing to gain
_WORTH = 0.8  # of the whole span: a guide that leaves more is not used
_LEAST_CELLS = 0.05  # of all cells must be matched, or there is no guide
_MEDIAN_CELLS = 5  # a side: houses are smaller, hills are not
_RISE, _FALL = 0.7, 1.75  # px of disparity a px, at most: rising by 1 the second image would fold, falling never
_TAIL = 0.05  # percent of the coarse residuals on either side that may be blunders
_MARGIN_PX = 8  # beyond what the coarse level saw


@dataclass(frozen=True)
class Guide:
    """A disparity of the ground on nodes, and the residual disparities to search around it.

    ``nodes`` (m, n) lie 16 px apart in the frame of the resampled second image, whose column c stands for
    the rectified column c - ``high``; bilinear between them. ``low`` and ``high`` are the least and greatest residual.
    """

    nodes: FloatArray
    low: int
    high: int

    def second_original(self, pair: RectifiedPair, geometry: PairGeometry) -> FloatArray:
        """(m, n, 2) original pixels of the second image that the nodes are sampled from.

        What the pinhole model leaves of the rows at the guide's altitude is taken out.
        """
        rows, columns = (STEP_PX * np.arange(n, dtype=np.float64) for n in self.nodes.shape)
        columns -= self.high
        height = geometry.height.on_grid(columns, rows, self.nodes)
        row = rows[:, None] + geometry.row.on_grid(columns, rows, height)
        return pair.second_original(np.stack([columns[None, :] - self.nodes, row], axis=-1))

    def whole(self, residual: FloatImage) -> FloatImage:
        """Disparities (H, W) from residual ones: the guide counts at the column where the match was found."""
        height, width = residual.shape
        wide = (height, width + self.high - self.low + 1)
        guide = interpolate_steps(self.nodes.astype(np.float32), wide, STEP_PX)
        columns = np.arange(width, dtype=np.float32) + np.float32(self.high) - np.nan_to_num(residual)
        left = np.clip(columns.astype(np.int32), 0, guide.shape[1] - 2)
        share = columns - left.astype(np.float32)
        flat = left + (np.arange(height, dtype=np.int32) * guide.shape[1])[:, None]
        at, beside = guide.ravel()[flat], guide.ravel()[flat + 1]
        return residual + at + (beside - at) * share


def guide_of(
    first: FloatImage, second: FloatImage, disparities: Tuple[int, int], geometry: PairGeometry, match: PairMatcher
) -> Optional[Guide]:
    """Match a pair at a quarter of its resolution; None where that does not narrow the search.

    Parameters are those of :func:`repm_qgis.matching.sgm.match`; ``disparities`` must be whole multiples of ``FACTOR``.
    """
    low, high = disparities
    if high - low < _LEAST_SPAN or min(first.shape) < FACTOR * _CELL * 4:
        return None
    found = match(reduced(first), reduced(second), (low // FACTOR, high // FACTOR), geometry.nearer)
    coarse = np.where(found.filled, np.float32(np.nan), found.disparity) * np.float32(FACTOR)
    ground = _ground(coarse)
    if ground is None:
        return None
    ground = _bounded_slope(ground, _RISE * FACTOR * _CELL, _FALL * FACTOR * _CELL)
    residual = _residual(coarse, ground)
    ends = _ends(residual, geometry)
    if ends[1] - ends[0] > _WORTH * (high - low):
        return None
    return Guide(_nodes(ground, first.shape, ends), *ends)


def reduced(image: FloatImage) -> FloatImage:
    """Means over ``FACTOR`` x ``FACTOR`` px; NaN where one of them is, and what is left over at the ends dropped."""
    height, width = (n // FACTOR for n in image.shape)
    return cv2.resize(image[: height * FACTOR, : width * FACTOR], (width, height), interpolation=cv2.INTER_AREA)


def _ground(coarse: FloatImage) -> Optional[FloatArray]:
    """Disparity of the ground in cells of 16 px: medians of cells and of their neighbours, gaps filled, smoothed."""
    height, width = (n // _CELL for n in coarse.shape)
    blocks = coarse[: height * _CELL, : width * _CELL].reshape(height, _CELL, width, _CELL)
    cells = median_of_known(blocks.transpose(1, 3, 0, 2).reshape(_CELL * _CELL, height, width), _CELL)
    if np.isfinite(cells).mean() < _LEAST_CELLS:
        return None
    ground = _without_gaps(median_of_neighbours(cells, _MEDIAN_CELLS, _MEDIAN_CELLS))
    return cv2.GaussianBlur(ground, (0, 0), 1.0, borderType=cv2.BORDER_REFLECT).astype(np.float64)


def _without_gaps(cells: FloatImage) -> FloatImage:
    """Gaps filled from around them: means over ever wider neighbourhoods, the narrowest that knows something."""
    known = np.isfinite(cells)
    value, weight = np.where(known, cells, np.float32(0)), known.astype(np.float32)
    result, open_ = value.copy(), ~known
    sigma = 2.0
    while open_.any():
        share = cv2.GaussianBlur(weight, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        total = cv2.GaussianBlur(value, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        near = open_ & (share > 1e-3)
        result[near] = total[near] / share[near]
        open_ &= ~near
        sigma *= 2
    return result


def _bounded_slope(ground: FloatArray, rise: float, fall: float) -> FloatArray:
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


def _at(ground: FloatArray, columns: FloatArray, rows: FloatArray) -> FloatArray:
    """Bilinear ground at fine columns and rows of one shape; its border goes on level."""
    cell = FACTOR * _CELL
    u = np.clip((columns - (cell - 1) / 2) / cell, 0, ground.shape[1] - 1)
    v = np.clip((rows - (cell - 1) / 2) / cell, 0, ground.shape[0] - 1)
    return bilinear(ground, u, v)


def _residual(coarse: FloatImage, ground: FloatArray) -> FloatArray:
    """(N,) what known coarse disparities differ from the ground, counted where the match lies."""
    i, j = np.nonzero(np.isfinite(coarse))
    disparity = coarse[i, j].astype(np.float64)
    rows, columns = FACTOR * i + (FACTOR - 1) / 2, FACTOR * j + (FACTOR - 1) / 2
    residual = np.zeros_like(disparity)
    for _ in range(4):
        residual = disparity - _at(ground, columns - residual, rows)
    return residual


def _ends(residual: FloatArray, geometry: PairGeometry) -> Tuple[int, int]:
    """Least and greatest residual to search."""
    low, high = np.percentile(residual, (_TAIL, 100 - _TAIL))
    above = ALTITUDES.prior_above_m / geometry.metres_per_px
    more = (_MARGIN_PX, _MARGIN_PX + above) if geometry.nearer > 0 else (_MARGIN_PX + above, _MARGIN_PX)
    return int(np.floor(low - more[0])), int(np.ceil(high + more[1]))


def _nodes(ground: FloatArray, shape: Tuple[int, int], ends: Tuple[int, int]) -> FloatArray:
    """(m, n) ground on the nodes of the resampled second image, the last at or beyond its last pixel."""
    rows = np.arange(0, shape[0] + STEP_PX, STEP_PX, dtype=np.float64)
    columns = np.arange(0, shape[1] + ends[1] - ends[0] + 1 + STEP_PX, STEP_PX, dtype=np.float64) - ends[1]
    return _at(ground, *np.meshgrid(columns, rows))


def sampled_on(nodes: FloatArray):
    """The map of pixels whose values on the warping's own nodes are given."""

    def to_source(points: FloatArray) -> FloatArray:
        column, row = (np.rint(points[..., axis] / STEP_PX).astype(np.intp) for axis in (0, 1))
        return nodes[row, column]

    return to_source
