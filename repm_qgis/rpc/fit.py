"""The RPC of any sensor model: regularised, iteratively reweighted least squares on a virtual grid.

Reference: Tao and Hu, "A comprehensive study of the rational function model for photogrammetric processing",
Photogrammetric Engineering & Remote Sensing 67 (12), 2001: the terrain-independent, iterative solution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, FloatArray, Size
from ..contracts.documents import Keywords
from ..contracts.errors import RpcInvalidError
from .grid import virtual_grid
from .model import Rpc, monomials
from .parameters import RPC_FIT, RpcFitParameters

Localise = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class RpcFit:
    """An RPC, and how far it is from the sensor on an independent grid, px."""

    rpc: Rpc
    max_px: float
    rms_px: float


def fit_rpc(localise: Localise, size: Size, heights: Altitudes, parameters: RpcFitParameters = RPC_FIT) -> RpcFit:
    """Fit an RPC to a sensor model, and measure its residuals on another, denser grid.

    ``localise`` takes (N, 2) columns and rows and (N,) heights, and returns (N, 3) longitudes, latitudes, heights.

    Raises RpcInvalidError if it returns ground points that are not finite, or if the range of heights is empty.
    """
    nodes = parameters.nodes
    if not heights[1] > heights[0]:
        raise RpcInvalidError(f"no RPC can be fitted to heights from {heights[0]} to {heights[1]} m: it needs a range.")
    pixels, height = virtual_grid(size, heights, nodes)
    ground = localise(pixels, height)
    if not np.isfinite(ground).all():
        raise RpcInvalidError("no RPC can be fitted: the sensor model has no ground point for some of its pixels.")
    offset, scale = _normaliser(ground)
    pixel_offset, pixel_scale = _normaliser(pixels)
    lon, lat, height = ((ground - offset) / scale).T
    terms = monomials(lon, lat, height, np.empty((20, ground.shape[0]))).T
    col, row = ((pixels - pixel_offset) / pixel_scale).T
    (col_num, col_den), (row_num, row_den) = (_rational(terms, value, parameters) for value in (col, row))
    names = ("lon", "lat", "height", "col", "row")
    fields: Keywords = {f"{name}_off": off for name, off in zip(names, (*offset, *pixel_offset))}
    fields.update({f"{name}_scale": one for name, one in zip(names, (*scale, *pixel_scale))})
    fields.update(row_num=tuple(row_num), row_den=tuple(row_den), col_num=tuple(col_num), col_den=tuple(col_den))
    rpc = Rpc(**fields)
    dense = (2 * nodes[0] + 1, 2 * nodes[1] + 1, 2 * nodes[2] + 1)
    check, check_height = virtual_grid(size, heights, dense, inset=0.3)
    error = np.linalg.norm(rpc.project(localise(check, check_height)) - check, axis=1)
    return RpcFit(rpc, float(error.max()), float(np.sqrt(np.mean(error**2))))


def _normaliser(values: FloatArray) -> Tuple[FloatArray, FloatArray]:
    """Offset and scale of each column that take its values to -1..1."""
    low, high = values.min(axis=0), values.max(axis=0)
    return (low + high) / 2, (high - low) / 2


def _rational(terms: FloatArray, value: FloatArray, parameters: RpcFitParameters) -> Tuple[FloatArray, FloatArray]:
    """Twenty numerator and twenty denominator coefficients (the first is 1) with num / den = value.

    The equations num - value den = 0 are linear; dividing each by the last pass's denominator makes their residuals
    those of the quotient.
    """
    design = np.concatenate([terms, -value[:, None] * terms[:, 1:]], axis=1)
    weight = np.ones_like(value)
    for _ in range(parameters.reweights):
        left, singular, right = np.linalg.svd(design * weight[:, None], full_matrices=False)
        damped = singular / (singular**2 + (parameters.ridge * singular[0]) ** 2)
        solution = right.T @ (damped * (left.T @ (value * weight)))
        denominator = np.concatenate([[1.0], solution[20:]])
        weight = 1.0 / (terms @ denominator)
    return solution[:20], denominator
