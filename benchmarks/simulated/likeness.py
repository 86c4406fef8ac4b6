"""How alike two images of a scene are where both show the same place: real ones and simulated ones, by one number.

Each cell of the true surface is looked up in both images, so that neither a matcher nor a rectification has a part in
it: only the pointing, of which the best shift between the two images is taken.
"""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np
from osgeo import gdal
from scipy import ndimage

from repm_qgis.contracts.arrays import FloatArray, FloatImage, Mask
from repm_qgis.evaluation.coregistration import Alignment
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.scene import View

from ..scoring import heights_of
from .chips import grey_of

WINDOW_M = 4.5  # side of the patches that are correlated
_HIDDEN_M = 1.0  # by which something stands above the line of sight


def correlations(views: Sequence[View], truth: str, alignment: Alignment) -> FloatArray:
    """(N,) correlations of patches of two images at the true heights, where both see all of the patch.

    ``alignment`` is that of a DSM of these views onto the truth, whose cells are squares.
    """
    dataset = gdal.Open(truth)
    west, cell, _, north, _, _ = dataset.GetGeoTransform()
    height = heights_of(dataset)
    filled = np.where(np.isfinite(height), height, np.nanmedian(height))
    x = west + (np.arange(filled.shape[1]) + 0.5) * cell - alignment.dx
    y = north - (np.arange(filled.shape[0]) + 0.5) * cell - alignment.dy
    place = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    lon_lat = geodetic_from_projected(dataset.GetProjection(), place)[:, :2]
    ground = np.column_stack([lon_lat, filled.ravel() - alignment.dz])
    seen, pixels, images = np.isfinite(height), [], []
    for view in views:
        pixels.append(view.project(ground).reshape(*filled.shape, 2))
        seen &= _visible(view, ground, filled, cell)
        bands = np.atleast_3d(gdal.Open(view.image).ReadAsArray().astype(np.float32).T).T
        images.append(grey_of(bands) if len(bands) == 3 else bands[0])
        inside = (pixels[-1] >= 4) & (pixels[-1] <= np.array(view.size) - 5)
        seen &= inside.all(axis=-1)
    side = int(round(WINDOW_M / cell)) | 1
    whole = ndimage.minimum_filter(seen, side, mode="constant")
    first = _sampled(images[0], pixels[0])
    best, found = np.zeros(2), None
    for step in (1.0, 0.5, 0.25):
        while True:
            tries = [best + step * np.array([i, j]) for i in (0, -1, 1) for j in (0, -1, 1)]
            every = [_correlation(first, _sampled(images[1], pixels[1] + by), side)[whole] for by in tries]
            at = int(np.argmax([np.median(values) for values in every]))
            best, found = tries[at], every[at]
            if at == 0:
                break
    return np.asarray(found, np.float64)


def _sampled(image: FloatImage, pixels: FloatArray) -> FloatImage:
    found: FloatImage = ndimage.map_coordinates(image, (pixels[..., 1], pixels[..., 0]), order=1, mode="nearest")
    return found


def _visible(view: View, ground: FloatArray, height: FloatArray, cell: float) -> Mask:
    """Which cells of a surface a view sees, from its direction in the middle."""
    middle = ground[len(ground) // 2][None]
    pixel = view.project(middle)
    low, high = (view.localise(pixel, float(middle[0, 2]) + up)[0] for up in (0.0, 50.0))
    metre = np.radians(6371.0e3)
    east = (high[0] - low[0]) * metre * np.cos(np.radians(low[1])) / 50 / cell  # cells for each metre up
    south = (low[1] - high[1]) * metre / 50 / cell
    hidden = np.zeros(height.shape, bool)
    step = 1.0 / max(abs(east), abs(south), 1.0 / 50)
    for up in np.arange(step, float(np.ptp(height)) + step, step):
        moved = ndimage.shift(height, (-south * up, -east * up), order=0, mode="nearest")
        hidden |= moved > height + up + _HIDDEN_M
    return ~hidden


def _correlation(first: FloatImage, second: FloatImage, side: int) -> FloatArray:
    """(R, C) correlations of square windows of two images."""

    def mean(values: FloatArray) -> FloatArray:
        found: FloatArray = ndimage.uniform_filter(values, side, mode="nearest")
        return found

    a, b = first.astype(np.float64), second.astype(np.float64)
    both = mean(a * b) - mean(a) * mean(b)
    own = [np.maximum(mean(v * v) - mean(v) ** 2, 1e-3) for v in (a, b)]
    result: FloatArray = both / np.sqrt(own[0] * own[1])
    return result


def quartiles(values: FloatArray) -> Tuple[float, float, float]:
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
    return float(low), float(middle), float(high)
