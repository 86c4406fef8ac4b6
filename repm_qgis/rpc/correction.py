"""An RPC with its pointing correction in its own numbers, so that software that knows nothing but RPCs has it too.

A shift of the image goes into the offsets, and nothing is lost. An affine map mixes column and row, which are quotients
with denominators of their own: it goes into the numerators, by linear least squares over a virtual grid, and is exact
where both denominators are equal. Denominators and normalisers stay the vendor's, so that the model behaves beyond the
image as it did. Fitting all eighty coefficients brings no useful gain for corrections of the usual size
(docs/algorithms/exportrpc.md has the figures).

References: Fraser and Hanley, "Bias compensation in rational functions for Ikonos satellite imagery", Photogrammetric
Engineering & Remote Sensing 69 (1), 2003; Tao and Hu, 67 (12), 2001, for the virtual grid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable, Optional

import numpy as np

from ..contracts.arrays import Altitudes, FloatArray, Size
from ..contracts.documents import Keywords
from ..contracts.errors import RpcInvalidError
from .fit import Localise, fit_rpc
from .grid import virtual_grid
from .model import Rpc, monomials
from .parameters import CORRECTION, CorrectionParameters

DELIVERED = "as delivered"
SHIFTED = "shift, in the offsets"
EXACT = "affine, in the numerators"
FITTED = "affine, numerators fitted"
JITTERED = "jitter as far as an RPC holds it, numerators fitted"
PROJECTED = "fitted to the map's pixels"
_TERMS = 20
Waves = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class CorrectedRpc:
    """An RPC that includes a pointing correction, how it was included, and its distance from the pointed model, px.

    ``max_px`` and ``rms_px`` are measured over the image and its heights, at points that no fit has used.
    """

    rpc: Rpc
    method: str
    max_px: float
    rms_px: float


def corrected(
    rpc: Rpc,
    pointing: FloatArray,
    size: Size,
    altitudes: Altitudes,
    waves: Optional[Waves] = None,
    parameters: CorrectionParameters = CORRECTION,
) -> CorrectedRpc:
    """The RPC whose pixels are ``pointing``, a (2, 3) affine map, of the pixels of ``rpc``.

    ``waves`` take pixels of a steady image to those of one with jitter: the part of them that cubic polynomials can
    follow goes into the numerators, and the rest is in the distance from the pointed model. ``size`` is the image's in
    px. The heights are the RPC's own and ``altitudes``, m above the ellipsoid.

    Raises RpcInvalidError where the RPC does not see the image's pixels on the ground.
    """
    low, high = rpc.height_range
    heights = min(low, altitudes[0]), max(high, altitudes[1])
    pixels, levels = virtual_grid(size, heights, parameters.check_nodes, parameters.check_inset)
    ground = _on_ground(rpc, pixels, levels)
    if len(ground) < _TERMS:
        raise RpcInvalidError("it gives almost none of the image's pixels a ground point.")
    linear, shift = pointing[:, :2], pointing[:, 2]
    if waves is not None:
        lines = replace(parameters, nodes=(parameters.nodes[0], parameters.wave_lines, parameters.nodes[2]))
        made, method = _with_numerators(rpc, pointing, _fit_ground(rpc, size, heights, lines), waves), JITTERED
    elif np.array_equal(linear, np.eye(2)):
        made, method = rpc.shifted(*-shift), SHIFTED if shift.any() else DELIVERED
    else:
        made = _with_numerators(rpc, pointing, _fit_ground(rpc, size, heights, parameters))
        method = EXACT if rpc.row_den == rpc.col_den else FITTED
    error = np.linalg.norm(made.project(ground) - _pointed(rpc, pointing, ground, waves), axis=1)
    return CorrectedRpc(made, method, float(error.max()), float(np.sqrt(np.mean(error**2))))


def of_projected(localise: Localise, rpc: Rpc, size: Size, altitudes: Altitudes) -> CorrectedRpc:
    """The RPC of an ortho-ready image's own pixels, its pointing correction included, over the heights of ``rpc``, that
    of its lines of sight, and ``altitudes``.

    ``localise`` is the pointed model's; the other arguments as in :func:`corrected`. Raises RpcInvalidError where the
    model has no ground point for some pixels.
    """
    low, high = rpc.height_range
    fit = fit_rpc(localise, size, (min(low, altitudes[0]), max(high, altitudes[1])))
    return CorrectedRpc(replace(fit.rpc, accuracy_m=rpc.accuracy_m), PROJECTED, fit.max_px, fit.rms_px)


def _pointed(rpc: Rpc, pointing: FloatArray, ground: FloatArray, waves: Optional[Waves]) -> FloatArray:
    pixels: FloatArray = rpc.project(ground) @ pointing[:, :2].T + pointing[:, 2]
    return pixels if waves is None else waves(pixels)


def _fit_ground(rpc: Rpc, size: Size, heights: Altitudes, parameters: CorrectionParameters) -> FloatArray:
    """Ground points (N, 3) over the image and over the RPC's own domain.

    An image that is cut out of a product is a small part of the domain: coefficients fitted to it alone diverge outside
    of it.
    """
    image = virtual_grid(size, heights, parameters.nodes, -parameters.outset)
    half = abs(rpc.col_scale), abs(rpc.row_scale)
    whole = (max(1, round(2 * half[0])), max(1, round(2 * half[1])))
    pixels, height = virtual_grid(whole, heights, parameters.nodes)
    domain = pixels + [rpc.col_off - half[0], rpc.row_off - half[1]], height
    return np.concatenate([_on_ground(rpc, each, heights) for each, heights in (image, domain)])


def _on_ground(rpc: Rpc, pixels: FloatArray, heights: FloatArray) -> FloatArray:
    """The (N, 3) ground points of those pixels that have one."""
    ground = rpc.localise(pixels, heights)
    known: FloatArray = ground[np.isfinite(ground).all(axis=1)]
    return known


def _with_numerators(rpc: Rpc, pointing: FloatArray, ground: FloatArray, waves: Optional[Waves] = None) -> Rpc:
    """The RPC with numerators that give the pointed pixels of ground points (N, 3), least squares in the image."""
    target = _pointed(rpc, pointing, ground, waves)
    terms = monomials(*rpc.normalised(ground), np.empty((_TERMS, len(ground))))
    numerators: Keywords = {}
    for axis, name in enumerate(("col", "row")):
        old, below = (np.array(getattr(rpc, f"{name}_{part}")) for part in ("num", "den"))
        offset, scale = getattr(rpc, f"{name}_off"), getattr(rpc, f"{name}_scale")
        missing = (target[:, axis] - offset) / scale - (old @ terms) / (below @ terms)
        change = np.linalg.lstsq((terms / (below @ terms)).T, missing, rcond=1e-9)[0]
        numerators[f"{name}_num"] = tuple(old + change)
    return replace(rpc, **numerators)
