"""Removes from a disparity map, scale by scale, the detail that noise explains.

The map is taken apart into bilateral means of growing width and the details between them (Fattal, Agrawala and
Rusinkiewicz, Multiscale shape and detail enhancement, 2007). Each detail is multiplied by Wiener's gain from local
statistics (Lee 1980): the share of its local mean square that the noise does not explain. The noise of a detail follows
from the variance that the images give each disparity. So a plane roof in noisy images becomes plane, and natural relief
in clear images stays.
"""

from __future__ import annotations

from functools import reduce
from typing import List, Optional, Sequence

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, Size
from ..imagery.warping import gaussian_mean
from ..numerics.robust import nmad
from ..runtime.spare_cores import spread
from .parameters import DetailParameters, SubpixelParameters

_HALF = 2  # px between the pixels that wide means are made of


def without_noise(
    disparity: FloatImage,
    variance: FloatImage,
    area_px: float,
    parameters: SubpixelParameters,
    chosen: Optional[DetailParameters] = None,
) -> FloatImage:
    """(H, W) disparities without the detail that is no more than their noise; unknown ones (NaN) stay unknown.

    ``variance`` (H, W), px^2, is the variance that the images give each disparity; ``noise_share`` of it is left. The
    noise is correlated like white noise after a Gaussian window whose variance is ``area_px``, px^2: less of it is left
    in wider means. ``chosen`` replaces the parameters' choice of the detail that is kept.
    """
    p = chosen or parameters.detail
    known = np.isfinite(disparity)
    if not known.any():
        return disparity
    sigmas = (0.0, *p.scales_px)
    means = _means(disparity, p.scales_px, parameters)

    def explained(scale: int) -> FloatImage:
        """The detail between two means without what noise explains of it."""
        fine, coarse = sigmas[scale : scale + 2]
        narrow, wide = means[scale : scale + 2]
        # Means over sigma a and b have the covariance area / (area + (a^2 + b^2) / 2) of the variance.
        part = [area_px / (area_px + square) for square in (fine**2, coarse**2, (fine**2 + coarse**2) / 2)]
        noise = variance * np.float32(p.noise_share * (part[0] + part[1] - 2 * part[2]))
        detail = np.where(known, narrow - wide, np.float32(0))
        power = gaussian_mean(known, parameters.power_window * coarse)(detail * detail)
        share = np.minimum(noise / np.maximum(power, np.float32(1e-9)), np.float32(1))
        return np.asarray((1 - reduce(np.multiply, [share] * p.power)) * detail)

    kept = reduce(np.add, spread(explained, range(len(means) - 1)), means[-1])
    return np.where(known, kept, np.float32(np.nan)).astype(np.float32)


def tail(disparity: FloatImage, parameters: SubpixelParameters) -> float:
    """How heavy the tails of the detail are: its mean square in robust variances, which is about 1 for noise and
    natural relief. Planes that end at walls have detail at their edges only, and so a larger value; 1 where nothing is
    known."""
    p = parameters.planes
    known = np.isfinite(disparity)
    scales = p.kept.scales_px[: p.tail_scale + 1]
    narrow, wide = _means(disparity, scales, parameters)[-2:]
    detail = (narrow - wide)[known].astype(np.float64)
    robust = nmad(detail) ** 2 if detail.size else 0.0
    return float(np.mean(detail**2)) / robust if robust > 0 else 1.0


def _means(disparity: FloatImage, scales_px: Sequence[float], parameters: SubpixelParameters) -> List[FloatImage]:
    """The disparities and their bilateral means over all scales; wide ones of every second pixel of a narrow one.

    Near edges the coarser grid mixes surfaces. The detail is large there, and is kept.
    """
    means, full = [disparity], [sigma for sigma in scales_px if sigma <= parameters.full_scale_px]
    means += spread(lambda sigma: bilateral_mean(disparity, sigma, parameters.alike_detail_px), full)
    height, width = disparity.shape
    small = means[-1][::_HALF, ::_HALF]
    known = np.isfinite(small)
    weight = _doubled(known.astype(np.float32), (width, height))
    found = weight > 0
    share = np.where(found, weight, np.float32(1))

    def wide(sigma: float) -> FloatImage:
        rest = np.sqrt(sigma**2 - (full[-1] ** 2 if full else 0.0)) / _HALF
        mean = bilateral_mean(small, rest, parameters.alike_detail_px)
        return np.asarray(_doubled(np.where(known, mean, np.float32(0)), (width, height)) / share)

    for value in spread(wide, scales_px[len(full) :]):
        means.append(np.where(found, value, means[-1]))
    return means


def _doubled(small: FloatImage, size: Size) -> FloatImage:
    """An image of ``size`` (width, height) whose every second pixel a small one has; linear between them."""
    half = np.array([[1 / _HALF, 0, 0], [0, 1 / _HALF, 0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image: FloatImage = cv2.warpAffine(small, half, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return image


def bilateral_mean(disparity: FloatImage, sigma_px: float, alike_px: float, window_px: int = 0) -> FloatImage:
    """The mean of neighbours with similar disparities: bilateral filter of Tomasi and Manduchi (1998).

    ``sigma_px`` is the standard deviation of the weights in space, ``alike_px`` that in disparity; ``window_px`` the
    side of the window, 0 for two standard deviations to each side. Unknown pixels (NaN) stay unknown.
    """
    known = np.isfinite(disparity)
    if not known.any():
        return disparity
    # Ten deviations below the least disparity: such pixels have no weight, and the filter's table stays fine.
    absent = np.float32(disparity[known].min() - 10 * alike_px)
    side = window_px or 2 * int(np.ceil(2 * sigma_px)) + 1
    mean = cv2.bilateralFilter(np.where(known, disparity, absent).astype(np.float32), side, alike_px, sigma_px)
    return np.where(known, mean, np.float32(np.nan)).astype(np.float32)
