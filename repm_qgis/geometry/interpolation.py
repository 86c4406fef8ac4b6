"""Bilinear interpolation of grids, in numpy alone: the light stages have no OpenCV."""

from __future__ import annotations

from typing import Callable, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, Floats, Size


def bilinear(grid: Floats, columns: Floats, rows: Floats) -> Floats:
    """Values of a (height, width) grid at positions within it, in the grid's precision; node (0, 0) is at (0, 0)."""
    height, width = grid.shape
    left, top = (np.minimum(at.astype(np.intp), max(n - 2, 0)) for at, n in ((columns, width), (rows, height)))
    right, down = (columns - left).astype(grid.dtype), (rows - top).astype(grid.dtype)
    flat, index = grid.ravel(), top * width + left
    beside, below = min(1, width - 1), width * min(1, height - 1)
    upper = flat[index] * (1 - right) + flat[index + beside] * right
    lower = flat[index + below] * (1 - right) + flat[index + below + beside] * right
    result: Floats = upper * (1 - down) + lower * down
    return result


def upsample_grid(grid: Floats, shape: Tuple[int, int]) -> Floats:
    """Bilinear interpolation of a coarse (m, n, ...) grid, corners on corners, to (height, width, ...)."""
    m, n = grid.shape[:2]
    return interpolate_grid(grid, np.linspace(0, m - 1, shape[0]), np.linspace(0, n - 1, shape[1]))


def interpolate_grid(grid: Floats, rows: Floats, columns: Floats) -> Floats:
    """Bilinear interpolation of a (m, n, ...) grid at (H,) rows and (W,) columns, in units of nodes; ends extended."""
    m, n = grid.shape[:2]
    i = np.clip(rows.astype(int), 0, m - 2)
    j = np.clip(columns.astype(int), 0, n - 2)
    extra, dtype = (1,) * (grid.ndim - 2), np.result_type(grid, np.float32)
    fi, fj = ((rows - i).astype(dtype).reshape(-1, 1, *extra), (columns - j).astype(dtype).reshape(1, -1, *extra))
    # Rows first: they are few, and the wide passes that follow run along memory.
    tall = grid[i] * (1 - fi) + grid[i + 1] * fi
    wide: Floats = tall[:, j] * (1 - fj) + tall[:, j + 1] * fj
    return wide


def interpolate_steps(nodes: Floats, shape: Tuple[int, int], step: int) -> Floats:
    """(rows, columns) bilinear interpolation of (m, n) nodes that lie ``step`` px apart: faster than any positions."""
    share = np.arange(step, dtype=nodes.dtype) / nodes.dtype.type(step)
    down = nodes[:-1, None, :] + np.diff(nodes, axis=0)[:, None, :] * share[None, :, None]
    down = down.reshape(-1, nodes.shape[1])[: shape[0]]
    across: Floats = down[:, :-1, None] + np.diff(down, axis=1)[:, :, None] * share
    return across.reshape(shape[0], -1)[:, : shape[1]]


def on_lattice(
    x: FloatArray, y: FloatArray, function: Callable[[FloatArray], FloatArray], nodes: Size = (17, 17)
) -> FloatArray:
    """(H, W, ...) values of a smooth function at (W,) x and (H,) y, which lie evenly spaced.

    ``function`` takes (m, n, 2) positions to (m, n, ...). It is evaluated on a lattice of ``nodes`` (across, down)
    only, and interpolated bilinearly between them.
    """
    lattice = np.meshgrid(np.linspace(x[0], x[-1], nodes[0]), np.linspace(y[0], y[-1], nodes[1]))
    return upsample_grid(function(np.stack(lattice, axis=-1)), (len(y), len(x)))
