"""Colours of a panchromatic view from the multispectral image beside it: weighted Brovey on the orthophoto's cells.

The multispectral image has an RPC and pixels of its own. Both images are of one pass, so that their RPCs have the same
error: the panchromatic view's pointing is carried over, by way of the ground that its own RPC gives for the pixel where
a point is really seen. The shift that remains between the two images is measured and removed.

Brovey's transform multiplies each band with the panchromatic value over the weighted sum of the bands, as GDAL's
pansharpening does (Gillespie, Kahle and Walker 1987, Remote Sensing of Environment 22; gdal.org, "gdal_pansharpen").
The weights are those of a non-negative regression of the panchromatic image, averaged to multispectral pixels, on the
bands, so that the sum has the panchromatic mean, and the product the bands' own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Iterator, List, Sequence, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Mask, Window
from ..contracts.errors import OverlapError
from ..imagery.raster import opened_masked, read
from ..imagery.warping import sample_source
from ..scene import View
from .parameters import ORTHO, PansharpeningParameters


@dataclass(frozen=True)
class Multispectral:
    """A multispectral image as a panchromatic view sees it, and how the two are combined.

    ``weights`` (of all ``bands``) make a panchromatic value; ``shift`` is the image's displacement, (column, row) in
    its own px. ``correlation`` is that of the weighted sum with the panchromatic image. ``misplaced_px`` is a
    displacement that is too large for one, and is not applied; 0 where there is none.
    """

    pan: View
    image: View
    bands: Tuple[int, ...]
    weights: Tuple[float, ...] = ()
    shift: Tuple[float, float] = (0.0, 0.0)
    correlation: float = 0.0
    misplaced_px: float = 0.0

    def project(self, lon_lat_h: FloatArray) -> FloatArray:
        """(..., 3) longitude, latitude, height to (..., 2) column, row of the multispectral image."""
        ground = self.pan.model.localise(self.pan.project(lon_lat_h), lon_lat_h[..., 2])
        pixels: FloatArray = self.image.model.project(ground) + np.array(self.shift)
        return pixels

    def pan_pixels(self, col_row: FloatArray, height: float) -> FloatArray:
        """(..., 2) pixels of the multispectral image, without its shift, to those of the panchromatic image."""
        pixels: FloatArray = self.pan.model.project(self.image.model.localise(col_row, height))
        return pixels


def brovey(bands: FloatImage, pan: FloatImage, weights: Sequence[float]) -> FloatImage:
    """(B, H, W) bands with the detail of the panchromatic (H, W); NaN where either has no value, or the sum is not
    positive."""
    total = np.tensordot(np.asarray(weights, np.float32), bands, axes=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(total > 0, pan / total, np.float32(np.nan))
        sharpened: FloatImage = bands * ratio
    return sharpened


def fitted(pair: Multispectral, height: float, parameters: PansharpeningParameters = ORTHO.sharpening) -> Multispectral:
    """The pair with its weights and its shift, measured in windows of both images.

    ``height`` is the ground's, m above the ellipsoid: the images see it from one direction, so that it need not be
    exact. Raises OverlapError where the images have no pixels in common.
    """
    from scipy import optimize

    windows = list(_windows(pair, height, parameters))
    if not windows:
        raise OverlapError(
            f"The multispectral image '{pair.image.image}' shows nothing that '{pair.pan.image}' shows: give XS of the "
            "same acquisition as the images."
        )
    design = np.concatenate([bands[:, known].T for bands, _, known in windows]).astype(np.float64)
    target = np.concatenate([pan[known] for _, pan, known in windows]).astype(np.float64)
    weights, _ = optimize.nnls(design, target)
    if not weights.any():
        weights = np.full(len(pair.bands), float(target.mean()) / max(float(design.sum(axis=1).mean()), 1e-9))
    correlation = float(np.nan_to_num(np.corrcoef(design @ weights, target)[0, 1]))
    found = [_shift(np.tensordot(weights, bands, axes=1), pan, known, parameters) for bands, pan, known in windows]
    trusted = [shift for shift, response in found if response > parameters.least_response]
    right, down = map(float, np.median(trusted, axis=0)) if trusted else (0.0, 0.0)
    misplaced = 0.0
    if max(abs(right), abs(down)) > parameters.largest_shift_px:
        misplaced, right, down = float(np.hypot(right, down)), 0.0, 0.0
    shares = tuple(map(float, weights))
    return replace(pair, weights=shares, shift=(right, down), correlation=correlation, misplaced_px=misplaced)


def _windows(
    pair: Multispectral, height: float, parameters: PansharpeningParameters
) -> Iterator[Tuple[FloatImage, FloatImage, Mask]]:
    """Windows of the multispectral image: its bands, the panchromatic image averaged to its pixels, and the pixels that
    both know."""
    size, side = pair.image.size, parameters.window_px
    ratio = max(1, round(pair.image.gsd_m / pair.pan.gsd_m))
    # Places of panchromatic pixels in a multispectral one, from its middle.
    offsets = np.arange(ratio) - (ratio - 1) / 2.0
    with (
        opened_masked(pair.image.image, pair.image.mask) as spectral,
        opened_masked(pair.pan.image, pair.pan.mask) as sharp,
    ):
        for window in _spread(size, side, parameters.windows):
            columns, rows = np.arange(window.width), np.arange(window.height)
            pixels = np.stack(np.meshgrid(columns + window.col, rows + window.row), axis=-1).astype(np.float64)
            places = pair.pan_pixels(pixels, height)
            within = [places + np.array([right, down]) for down in offsets for right in offsets]
            values = [sample_source(sharp, pair.pan.band, moved, "bilinear") for moved in within]
            pan = np.mean(values, axis=0, dtype=np.float32)
            bands = np.stack([read(spectral, window, band) for band in pair.bands])
            known = np.isfinite(pan) & np.isfinite(bands).all(axis=0)
            if known.mean() > parameters.least_known:
                yield bands, pan, known


def _spread(size: Tuple[int, int], side: int, across: int) -> List[Window]:
    """Up to ``across`` squared windows, evenly spread over an image."""
    ends = []
    for length in size:
        count = max(1, min(across, length // side))
        own = min(side, length)
        ends.append([(round((i + 0.5) * length / count - own / 2), own) for i in range(count)])
    return [Window(col, row, width, height) for row, height in ends[1] for col, width in ends[0]]


def _shift(
    total: FloatImage, pan: FloatImage, known: Mask, parameters: PansharpeningParameters
) -> Tuple[FloatArray, float]:
    """How far the multispectral window lies from the panchromatic one (column, row, px), and how sure that is."""
    from scipy import ndimage

    parts = []
    for image in (pan, total):
        filled = np.where(known, image, np.mean(image[known]))
        parts.append(filled - ndimage.gaussian_filter(filled, parameters.highpass_px))
    shape = parts[0].shape
    window = cv2.createHanningWindow((shape[1], shape[0]), cv2.CV_64F)
    (right, down), response = cv2.phaseCorrelate(*(part.astype(np.float64) for part in parts), window)
    return np.array([right, down]), float(response)
