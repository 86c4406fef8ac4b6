"""Holes filled on known surfaces."""

from __future__ import annotations

import numpy as np

from repm_qgis.fusion.holes import fill_holes
from repm_qgis.fusion.parameters import FUSION


def surface(shape=(120, 140)):
    rows, cols = np.indices(shape)
    return 100 + 0.2 * cols - 0.1 * rows


def test_a_hole_in_a_plane_takes_the_plane():
    """Inverse distance is no plane, but in the middle of a hole it must be, and at its rim nearly."""
    truth = surface()
    holed = truth.copy()
    holed[50:61, 60:71] = np.nan
    found, filled = fill_holes(holed)
    assert filled.sum() == 121 and filled[50:61, 60:71].all()
    np.testing.assert_allclose(found[55, 65], truth[55, 65], atol=1e-3)
    assert np.abs(found - truth)[filled].max() < 0.6
    np.testing.assert_array_equal(found[~filled], holed[~filled].astype(np.float32))


def test_what_lies_beyond_the_border_stays_empty():
    holed = surface()
    holed[:, :20] = np.nan
    holed[:15] = np.nan
    holed[100:, 110:] = np.nan
    found, filled = fill_holes(holed)
    assert not filled.any() and np.isnan(found[:, :20]).all() and np.isnan(found[105:, 115:]).all()


def test_holes_too_wide_stay_partly_empty():
    """A band 135 cells wide: its middle has heights within reach on both sides, the rest on one side only."""
    holed = np.full((150, 3 * FUSION.holes.reach_cells), 50.0)
    holed[5:140, 5:-5] = np.nan
    found, filled = fill_holes(holed)
    assert filled[70:75, 110:190].all() and np.isnan(found[20, 110:190]).all()
    assert np.abs(found[filled] - 50).max() < 1e-4


def test_the_terrain_model_gives_the_relief():
    """A ridge within the hole: unknown to the border, but the model has it; the model's own offset does not matter."""
    rows, cols = np.indices((100, 100))
    ridge = 20 * np.exp(-(((cols - 50) / 6.0) ** 2))
    holed = 300 + ridge
    truth = holed.copy()
    holed[20:80, 20:80] = np.nan
    plain, _ = fill_holes(holed)
    shaped, filled = fill_holes(holed, ridge + 1234.5)
    assert filled[20:80, 20:80].all()
    assert np.abs(shaped - truth)[filled].max() < 0.01 < 5 < np.abs(plain - truth)[filled].max()
    # Where the model has nothing, the border's heights must do.
    ridge[:, 50:] = np.nan
    partly, again = fill_holes(holed, ridge)
    assert (again == filled).all() and np.isfinite(partly).all()


def test_all_or_nothing_known():
    full, empty = surface(), np.full((10, 10), np.nan)
    assert not fill_holes(full)[1].any()
    found, filled = fill_holes(empty)
    assert not filled.any() and np.isnan(found).all()
