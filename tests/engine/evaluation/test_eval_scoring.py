"""Scores in memory mean the same as those of the stage."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.evaluation.scoring import score, score_aligned, score_files
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage


@pytest.mark.parametrize("method", ["none", "vertical", "3d"])
def test_files_are_scored_as_by_the_stage(make_raster, terrain, method):
    rng = np.random.default_rng(2)
    heights = terrain(150, 170, 0.7, -0.4) + rng.normal(1.0, 0.3, (150, 170))
    heights[30:60, 40:70] = np.nan
    heights[rng.uniform(size=heights.shape) < 0.01] = np.nan  # a hole of one cell here and there
    a, b = make_raster("dsm.tif", heights), make_raster("ref.tif", terrain(150, 170))
    found = score_files(a, b, method)
    stage = run_stage("comparedsm", {"dsm": a, "reference": b, "align": method}, Silent())
    assert (found.alignment.dx, found.alignment.dy) == pytest.approx((stage.dx, stage.dy), abs=1e-9)
    for name in ("rmse", "medae", "mae", "nmad", "bias", "valid"):
        assert getattr(found.metrics, name) == pytest.approx(getattr(stage, name), abs=1e-6), name
    assert dict(found.metrics.completeness)[1.0] == pytest.approx(stage.completeness, abs=1e-6)


def test_whole_cells_leave_out_what_they_uncover():
    rng = np.random.default_rng(0)
    reference = rng.normal(0, 20, (60, 70))
    dsm = np.roll(reference, (2, -3), (0, 1)) + 5
    found = score(dsm, reference, "cells")
    assert (found.alignment.dx, found.alignment.dy) == (3, 2) and found.alignment.dz == pytest.approx(-5, abs=1e-5)
    assert found.metrics.reference_cells == found.metrics.cells == 58 * 67
    assert found.metrics.rmse < 1e-4 and np.isfinite(found.error).sum() == 58 * 67
    other = score_aligned(found.alignment, dsm + 1, reference)
    assert other.metrics.bias == pytest.approx(1, abs=1e-4)
