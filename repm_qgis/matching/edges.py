"""Where surfaces meet: each pixel near a step in height is given anew to the upper or the lower surface.

Semi-global matching leaves steps a few pixels off: roofs are fattened, their corners rounded, alleys bridged. But it
knows both surfaces there. So the question is only which of the two a pixel belongs to, and both images answer it:
the differences of brightness and gradient of the two hypotheses are compared, and averaged in a window that follows
the edges of the image (guided filter, He, Sun and Tang 2013; the idea of support weights is Yoon's and Kweon's,
2006).
"""

from __future__ import annotations

from typing import Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatImage
from ..imagery.sampling import mean_of_known

_MEDIAN = 5
_REACH = 5  # px to each side of a step that are looked at
_JUMP_PX = 1.5  # of disparity: less is a slope
_NEIGHBOURHOOD = 9  # window in which a surface's disparity is averaged, px
_BRIGHTNESS, _GRADIENT = 0.045, 0.022  # differences count up to these, of a brightness of 0..1
_SUPPORT = 7  # window of the guided filter, px
_CONTRAST = 0.02  # edges of the image much weaker than this do not bound it
_STRIP = 1024


def at_edges(
    disparity: FloatImage, image: FloatImage, other: FloatImage, towards: Tuple[float, float], nearer: float
) -> FloatImage:
    """Disparities without outliers, and with the steps where the images have them.

    Parameters
    ----------
    disparity : (H, W) px, of ``image``; NaN where there is none, and it stays so.
    image, other : (H, W) and (H, V) brightness in 0..1, rows aligned.
    towards : factor and offset, so that column + factor * disparity + offset is the column of ``other``.
    nearer : +1 if greater disparities are higher ground, -1 if lower.
    """
    known = np.isfinite(disparity)
    surface = cv2.medianBlur(_without_gaps(np.float32(nearer) * disparity, known), _MEDIAN)
    upper, lower, near = _surfaces(surface)
    near &= known
    chosen = surface
    if near.any():
        a, b = np.nan_to_num(image), np.nan_to_num(other)
        rows, columns = np.nonzero(near)
        cost = _Cost(a, b, rows, columns, towards)
        evidence = np.zeros_like(surface)
        evidence[near] = cost.of(nearer * upper[near]) - cost.of(nearer * lower[near])
        chosen = np.where(near, np.where(_guided(a, evidence) < 0, upper, lower), surface)
    return np.where(known, np.float32(nearer) * chosen, np.float32(np.nan)).astype(np.float32)


def _mean(image: FloatImage, size: int) -> FloatImage:
    return cv2.blur(image, (size, size), borderType=cv2.BORDER_REFLECT)


def _without_gaps(surface: FloatImage, known: NDArray[np.bool_]) -> FloatImage:
    """Unknown pixels take the mean of what is known around them."""
    if known.all():
        return surface
    around, _ = mean_of_known(surface, known, lambda image: _mean(image, 2 * _REACH + 5), 1e-3)
    return np.where(known, surface, around).astype(np.float32)


def _surfaces(surface: FloatImage) -> Tuple[FloatImage, FloatImage, NDArray[np.bool_]]:
    """The upper and the lower surface around each pixel, its own value being one of them; and where there are two."""
    window = np.ones((2 * _REACH + 1, 2 * _REACH + 1), np.uint8)
    top, bottom = cv2.dilate(surface, window), cv2.erode(surface, window)
    beside = top - bottom > _JUMP_PX
    on_top = surface > (top + bottom) / 2
    above, some_above = _mean_where(surface, beside & on_top)
    below, some_below = _mean_where(surface, beside & ~on_top)
    upper, lower = np.where(on_top, surface, above), np.where(on_top, below, surface)
    return upper, lower, beside & some_above & some_below & (upper - lower > _JUMP_PX)


def _mean_where(surface: FloatImage, chosen: NDArray[np.bool_]) -> Tuple[FloatImage, NDArray[np.bool_]]:
    """The mean of the chosen pixels around each pixel, and whether there are any."""
    mean, share = mean_of_known(surface, chosen, lambda image: _mean(image, _NEIGHBOURHOOD), 1e-3)
    return mean, share > 0.5 / _NEIGHBOURHOOD**2


class _Cost:
    """How badly chosen pixels of an image look like where disparities place them in the other image: 0..1."""

    def __init__(
        self,
        image: FloatImage,
        other: FloatImage,
        rows: NDArray[np.intp],
        columns: NDArray[np.intp],
        towards: Tuple[float, float],
    ) -> None:
        self._own, self._other, self._towards = _features(image)[rows, columns], _features(other), towards
        self._rows, self._columns = rows.astype(np.float32), columns.astype(np.float32)

    def of(self, disparity: FloatImage) -> FloatImage:
        """(N,) costs of the pixels' disparities."""
        factor, offset = (np.float32(value) for value in self._towards)
        there = self._columns + factor * disparity.astype(np.float32) + offset
        found = cv2.remap(
            self._other, _folded(there), _folded(self._rows), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        ).reshape(-1, 3)[: len(there)]
        off = np.abs(self._own - found)
        brightness = np.minimum(off[:, 0], np.float32(_BRIGHTNESS)) / np.float32(2 * _BRIGHTNESS)
        return brightness + np.minimum(off[:, 1] + off[:, 2], np.float32(_GRADIENT)) / np.float32(2 * _GRADIENT)


def _features(image: FloatImage) -> FloatImage:
    """(H, W, 3) brightness and its gradient along columns and rows, per px."""
    return cv2.merge(
        [image, cv2.Sobel(image, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(image, cv2.CV_32F, 0, 1, scale=0.125)]
    )


def _folded(values: FloatImage) -> FloatImage:
    """A list as an image of 1024 columns: OpenCV's maps may have no more than 32767 to a side."""
    return np.pad(values, (0, -len(values) % _STRIP)).reshape(-1, _STRIP)


def _guided(guide: FloatImage, values: FloatImage) -> FloatImage:
    """Values averaged in a window that the guide's edges bound."""
    mean_guide, mean_values = _mean(guide, _SUPPORT), _mean(values, _SUPPORT)
    variance = _mean(guide * guide, _SUPPORT) - mean_guide * mean_guide
    slope = (_mean(guide * values, _SUPPORT) - mean_guide * mean_values) / (variance + np.float32(_CONTRAST**2))
    return _mean(slope, _SUPPORT) * guide + _mean(mean_values - slope * mean_guide, _SUPPORT)
