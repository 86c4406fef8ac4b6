from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.geometry.levels import doubled, halved


@pytest.mark.parametrize("shape", ((4, 6), (5, 3), (1, 1)))
def test_halved_keeps_the_sum_and_the_precision(shape):
    values = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    found = halved(values)
    assert found.shape == tuple((side + 1) // 2 for side in shape) and found.dtype == np.float32
    assert found.sum() == values.sum() and found[0, 0] == values[:2, :2].sum()
    assert found[-1, -1] == values[shape[0] - (shape[0] % 2 or 2) :, shape[1] - (shape[1] % 2 or 2) :].sum()


def test_doubled_is_linear_between_the_centres_of_cells():
    def plane(rows, columns, side, first):
        """2 x - 3 y at the centres of cells."""
        y, x = (first + np.arange(count) * side + side / 2 for count in (rows, columns))
        return 2 * x - 3 * y[:, None]

    found = doubled(plane(6, 7, 2.0, -2.0), (7, 10))
    assert found.shape == (7, 10)
    np.testing.assert_allclose(found, plane(7, 10, 1.0, 0.0), atol=1e-12)
    assert doubled(np.zeros((4, 4), np.float32), (4, 4)).dtype == np.float32
