"""Learned features of image windows, whose cosine says how alike two windows are, whatever the season.

MC-CNN fast (Zbontar and LeCun 2016, JMLR 17) in the depthwise-separable form of CNES's package ``mccnn`` (Cournet et
al. 2020, ISPRS Archives XLIII-B2): 64 features for each pixel, from the 11 x 11 px around it. ``scripts/make_network``
writes the file beside this module; its licence and origin are in ``networks/README.md``.
"""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import numpy as np

from ..contracts.arrays import FloatImage

FEATURES = 64
REACH_PX = 5  # to each side of a pixel

_STRIP_COLUMNS = 512  # whose layers fit into the caches


_of_thread = threading.local()  # a network keeps its input and its layers: threads must not share one


def _network() -> cv2.dnn.Net:
    """The network of this thread."""
    if not hasattr(_of_thread, "network"):
        name = "mc_cnn_fast_dw.onnx"
        data = np.frombuffer((Path(__file__).parent / "networks" / name).read_bytes(), dtype=np.uint8)
        _of_thread.network = cv2.dnn.readNetFromONNX(data)
    network: cv2.dnn.Net = _of_thread.network
    return network


def normalised(image: FloatImage) -> FloatImage:
    """(H + 10, W + 10) intensities of mean 0 and deviation 1 with a rim for the windows; 0 where there are none."""
    known = np.isfinite(image)
    values = image[known].astype(np.float64)
    mean, deviation = (values.mean(), values.std()) if values.size else (0.0, 1.0)
    scaled = np.where(known, (image - np.float32(mean)) / np.float32(deviation or 1.0), np.float32(0))
    padded: FloatImage = cv2.copyMakeBorder(scaled, *[REACH_PX] * 4, cv2.BORDER_REFLECT_101)
    return padded


def features_of_rows(padded: FloatImage, rows: slice, columns: slice) -> FloatImage:
    """(64, h, w) features of unit length of a part of an image, whose :func:`normalised` form is given."""
    reach = 2 * REACH_PX
    padded = padded[rows.start : rows.stop + reach, columns.start : columns.stop + reach]
    height, width = (side - reach for side in padded.shape)
    result = np.empty((FEATURES, height, width), dtype=np.float32)
    network = _network()
    for left in range(0, width, _STRIP_COLUMNS):
        right = min(left + _STRIP_COLUMNS, width)
        network.setInput(np.ascontiguousarray(padded[:, left : right + reach])[None, None])
        raw = network.forward()[0]
        length = np.sqrt(np.einsum("fhw,fhw->hw", raw, raw))
        np.divide(raw, np.maximum(length, np.float32(1e-12)), out=result[:, :, left:right])
    return result
