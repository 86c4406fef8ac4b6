"""Means over coarse cells, summed tile by tile, are those of the whole raster."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Window
from repm_qgis.fusion.coarse_means import CoarseMeans
from repm_qgis.geometry.cell_grid import CellGrid


@pytest.mark.parametrize(("shape", "most"), (((40, 60), 100), ((41, 53), 90), ((7, 9), 1000)))
def test_tiles_that_begin_anywhere_give_the_means_of_the_whole(shape, most):
    rng = np.random.default_rng(3)
    height = rng.normal(200.0, 9.0, shape)
    height[rng.random(shape) < 0.3] = np.nan
    means = CoarseMeans(CellGrid(1000.0, 5000.0, 0.5, shape), most)
    factor = means.factor
    for row, rows in ((0, 13), (13, 0), (13, shape[0] - 13)) if shape[0] > 13 else ((0, shape[0]),):
        for col, columns in ((0, 19), (19, shape[1] - 19)) if shape[1] > 19 else ((0, shape[1]),):
            means.add(height[row : row + rows, col : col + columns], Window(col, row, columns, rows))
    assert means.grid.cell == 0.5 * factor and (factor == 1) == (most == 1000)
    assert np.prod(means.grid.shape) <= 1.3 * most
    for (row, col), value in np.ndenumerate(means.means(0.6)):
        block = height[row * factor : (row + 1) * factor, col * factor : (col + 1) * factor]
        enough = np.isfinite(block).sum() >= 0.6 * factor**2
        assert np.isnan(value) != enough
        assert not enough or value == pytest.approx(np.nanmean(block), abs=1e-9)
