"""Tiles that differ by an offset meet without a step."""

from __future__ import annotations

import numpy as np

from repm_qgis.contracts.arrays import Window
from repm_qgis.fusion.feathering import feathered
from repm_qgis.fusion.parameters import FUSION
from repm_qgis.fusion.tile_fusion import StoredTile, wide_file

MARGIN = FUSION.feather_cells
SHAPE = (60, 100)
WINDOWS = [Window(0, 0, 40, 30), Window(40, 0, 60, 30), Window(0, 30, 40, 30), Window(40, 30, 60, 30)]
OFFSETS = (0.0, 0.4, -0.3, 0.2)


def surface():
    rows, cols = np.indices(SHAPE)
    return 100 + 0.3 * cols - 0.2 * rows


def stored(folder, offsets, spoil=None):
    """Tiles on disk, each with its margin, and the DSM that they are put together to."""
    tiles, own = [], []
    for number, ((col, row, width, height), offset) in enumerate(zip(WINDOWS, offsets)):
        whole = surface() + offset
        if spoil:
            spoil(number, whole)
        r0, c0 = max(row - MARGIN, 0), max(col - MARGIN, 0)
        wide = whole[r0 : row + height + MARGIN, c0 : col + width + MARGIN]
        path = str(folder / f"{number}.npz")
        np.save(wide_file(path), wide.astype(np.float32))
        tiles.append(StoredTile(path, 0, 0, 0, None, ""))
        own.append(whole[row : row + height, col : col + width])
    result = np.full(SHAPE, np.nan)
    for index, (col, row, width, height) in enumerate(WINDOWS):
        result[row : row + height, col : col + width] = feathered(
            own[index], index, WINDOWS, stored=tiles, size=SHAPE[::-1], tolerance=1.0
        )
    return result


def test_an_offset_is_spread_over_the_margins(tmp_path):
    error = stored(tmp_path, OFFSETS) - surface()
    largest = 0.7 / (2 * MARGIN) * 1.5
    for axis in (0, 1):
        assert np.abs(np.diff(error, axis=axis)).max() < largest < 0.4
    np.testing.assert_allclose(error[:20, :30], 0.0, atol=1e-4)
    np.testing.assert_allclose(error[40:, 50:], 0.2, atol=1e-4)
    # Half way between two tiles: the mean of both.
    np.testing.assert_allclose(error[5, 39:41].mean(), 0.2, atol=1e-4)


def test_equal_tiles_are_left_alone(tmp_path):
    np.testing.assert_allclose(stored(tmp_path, (0.0,) * 4), surface(), atol=1e-4)


def test_other_surfaces_and_holes_are_not_mixed_in(tmp_path):
    def spoil(number, heights):
        if number == 0:
            heights[:10, 35:40] = np.nan
        if number == 1:
            heights[12:20, 34:40] += 20.0

    found = stored(tmp_path, (0.0,) * 4, spoil)
    assert np.isnan(found[:10, 35:40]).all() and np.isnan(found).sum() == 50
    np.testing.assert_allclose(found[12:20, 34:40], surface()[12:20, 34:40], atol=1e-4)


def test_the_order_of_tiles_does_not_matter(tmp_path):
    """Every tile looks at what its neighbours were, not at what became of them."""
    first = stored(tmp_path, OFFSETS)
    again = stored(tmp_path, OFFSETS)
    assert (first == again).all()
