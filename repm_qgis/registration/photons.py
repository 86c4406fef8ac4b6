"""Which photons of low confidence lie where photons are dense: ground and vegetation in the noise of daylight.

ATL03 says of each photon how likely it comes back from a surface. By day, and from weak beams, most of these are of low
confidence, though they lie on a surface: noise is scattered over hundreds of metres of height, and a surface is not. A
photon counts where so many lie around it, along the track and in height, as noise alone hardly ever puts there (the
density that Neuenschwander and Pitts 2019, Remote Sens. Environ. 221, find signal by).
"""

from __future__ import annotations

import numpy as np

from ..contracts.arrays import FloatArray, IntArray, Mask
from .parameters import REGISTRATION, RegistrationParameters

_EARTH_M = 6_371_000.0
_BLOCK = 2_000  # cells along the track that are counted at once


def dense(
    lon: FloatArray,
    lat: FloatArray,
    height: FloatArray,
    noise: Mask,
    parameters: RegistrationParameters = REGISTRATION,
) -> Mask:
    """(N,) which photons of one beam lie among many.

    ``lon`` and ``lat`` are degrees, ``height`` m, ``noise`` (N,) which photons are assumed to be noise: they give the
    density of noise in a window.
    """
    if not len(height):
        return np.zeros(0, dtype=bool)
    p = parameters
    along = _along(lon, lat)
    cells = p.photon_cells
    i = np.floor(along / (p.photon_window_m[0] / cells[0])).astype(np.int64)
    j = np.floor((height - height.min()) / (p.photon_window_m[1] / cells[1])).astype(np.int64)
    found = np.zeros(len(height), dtype=bool)
    for first in range(0, int(i.max()) + 1, _BLOCK):
        inside = (i >= first) & (i < first + _BLOCK)
        near = (i >= first - cells[0]) & (i < first + _BLOCK + cells[0])
        if inside.any():
            count = _around(i[near] - first + cells[0], j[near], cells)[inside[near]]
            rows, levels = (np.ptp(axis[inside]) + 1 for axis in (i, j))
            expected = np.count_nonzero(noise & inside) * cells[0] * cells[1] / (rows * levels)
            least = max(float(p.photon_least), expected + p.photon_sigma * np.sqrt(expected))
            found[inside] = count >= least
    return found


def _along(lon: FloatArray, lat: FloatArray) -> FloatArray:
    """(N,) metres along the track, from its southern end on: tracks run within 45 degrees of north but near the poles,
    where they turn to the east."""
    north = np.radians(lat - lat.min()) * _EARTH_M
    east = np.radians((lon - lon[0] + 180.0) % 360.0 - 180.0) * _EARTH_M * np.cos(np.radians(lat.mean()))
    away: FloatArray = north if np.ptp(north) >= np.ptp(east) else east - east.min()
    return away * float(np.hypot(np.ptp(north), np.ptp(east)) / max(float(np.ptp(away)), 1e-9))


def _around(i: IntArray, j: IntArray, cells: tuple[int, int]) -> IntArray:
    """(N,) how many photons lie in the window of cells around each."""
    half = cells[0] // 2, cells[1] // 2
    counts = np.zeros((int(i.max()) + 1 + 2 * half[0], int(j.max()) + 1 + 2 * half[1]), dtype=np.int32)
    np.add.at(counts, (i + half[0], j + half[1]), 1)
    for axis, size in enumerate(cells):
        total = np.insert(np.cumsum(counts, axis=axis, dtype=np.int32), 0, 0, axis=axis)
        ends, begins = [slice(None)] * 2, [slice(None)] * 2
        ends[axis], begins[axis] = slice(size, None), slice(None, -size)
        counts = total[tuple(ends)] - total[tuple(begins)]
    return np.asarray(counts[i, j])
