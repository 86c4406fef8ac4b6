"""The colour chip that a vendor makes of a panchromatic band and of coarser colours: pansharpening and a tone curve.

Pansharpening is Brovey's: each colour, resampled to the panchromatic grid, times the ratio of the panchromatic band to
the same band as coarse as the colours are (Gillespie et al., Remote Sensing of Environment 22 (3), 1987).
"""

from __future__ import annotations

from typing import Sequence, Union

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from repm_qgis.contracts.arrays import FloatImage
from repm_qgis.simulation.sensor import Sensor

from .parameters import DistrictParameters, EffectParameters

_LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601, the grey in which colour images are matched


def grey_of(bands: Union[Sequence[FloatImage], NDArray[np.float32]]) -> FloatImage:
    """The panchromatic band (R, C) of red, green and blue."""
    grey: FloatImage = np.tensordot(_LUMA, np.asarray(bands), 1).astype(np.float32)
    return grey


def sensed(fine: FloatImage, sensor: Sensor, oversample: int, blur_px: float = 0.0) -> FloatImage:
    """Point spread and aperture of pixels that are ``oversample`` times as large as those of ``fine``."""
    deviation = np.hypot(sensor.blur_px, blur_px) * oversample
    blurred = ndimage.gaussian_filter(fine, deviation, truncate=3.5, mode="nearest")
    rows, cols = (n // oversample for n in fine.shape)
    cut = blurred[: rows * oversample, : cols * oversample]
    mean: FloatImage = cut.reshape(rows, oversample, cols, oversample).mean(axis=(1, 3))
    return mean


def pansharpened(
    fine: Sequence[FloatImage],
    sensor: Sensor,
    oversample: int,
    rng: np.random.Generator,
    own: DistrictParameters,
    effects: EffectParameters,
) -> NDArray[np.float32]:
    """(3, rows, columns) digital numbers of red, green and blue, from the light on a grid ``oversample`` times denser.

    With a ratio of 1 each colour has the panchromatic band's pixels and noise.
    """
    ratio = effects.colour_ratio

    def noisy(signal: FloatImage) -> FloatImage:
        deviation = np.sqrt(sensor.read_noise_dn**2 + sensor.photon_gain * np.maximum(signal, 0))
        found: FloatImage = signal + deviation * rng.standard_normal(signal.shape, dtype=np.float32)
        return found

    sharp = [sensed(band, sensor, oversample, effects.chip_blur_px) for band in fine]
    if ratio == 1:
        return np.stack([noisy(band) for band in sharp]).astype(np.float32)
    pan = noisy(grey_of(sharp))
    coarse = []
    for band in fine:
        signal = sensed(band, sensor, oversample * ratio)
        coarse.append(signal + own.colour_noise_dn * rng.standard_normal(signal.shape, dtype=np.float32))
    colours = [_finer(band, ratio, pan.shape) for band in coarse]
    grey = grey_of(colours)
    result: NDArray[np.float32] = np.stack([band * pan / np.maximum(grey, 1.0) for band in colours]).astype(np.float32)
    return result


def _finer(band: FloatImage, ratio: int, shape: Sequence[int]) -> FloatImage:
    """A coarse band on the finer grid, by cubic convolution's equal: cubic splines; the edge goes on outside."""
    rows, cols = ((np.arange(n) + 0.5) / ratio - 0.5 for n in shape)
    grid = np.meshgrid(rows, cols, indexing="ij")
    finer: FloatImage = ndimage.map_coordinates(band, grid, order=3, mode="nearest", output=np.float32)
    return finer


def toned(bands: NDArray[np.float32], own: DistrictParameters) -> NDArray[np.uint8]:
    """8 bits: each band between its own black and white, with a gamma; what is brighter is saturated.

    Zero is left to what has no data, as in vendors' images.
    """
    result = np.empty(bands.shape, np.uint8)
    for number, band in enumerate(bands):
        darkest, white = np.quantile(band, (0.002, own.tone_white))
        black = own.tone_black * darkest
        share = np.clip((band - black) / max(white - black, 1.0), 0, 1)
        result[number] = np.clip(np.rint(255 * share ** (1 / own.tone_gamma)), 1, 255)
    return result
