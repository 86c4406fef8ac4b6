"""LE90 and CE90: their definition, and what reports say of them."""

import numpy as np
import pytest

from repm_qgis.contracts.options import CheckGcpsOptions
from repm_qgis.evaluation.gcp_accuracy import GcpAccuracy
from repm_qgis.evaluation.metrics import ErrorCollector, height_metrics
from repm_qgis.numerics.accuracy import CE90, LE90, distances, le90
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.pointing.ground_control import Gcp
from repm_qgis.reports.gcp_page import gcp_page
from tests.engine.pages import plain


def test_nine_of_ten_errors_are_no_larger_in_either_direction():
    assert le90(np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0, -8.0, 9.0, -10.0, np.nan, 0.0])) == 9.0
    assert np.isnan(le90(np.array([np.nan])))
    noise = np.random.default_rng(1).normal(0.0, 1.0, (400_000, 2))
    assert le90(noise[:, 0]) == pytest.approx(LE90, abs=0.01)
    assert le90(distances(noise)) == pytest.approx(CE90, abs=0.01)
    assert le90(noise[:, 0] + 3.0) > 4.0, "a bias counts, as it does in a contract"
    assert (PLANNING.promises.le90, PLANNING.promises.ce90) == (LE90, CE90)


def test_a_comparison_has_it_exactly_and_from_a_histogram():
    errors = np.random.default_rng(2).laplace(0.3, 1.0, 200_000).astype(np.float32)
    exact = height_metrics(errors, errors.size).le90
    assert exact == pytest.approx(np.quantile(np.abs(errors), 0.9), abs=1e-6)
    binned = ErrorCollector((1.0,), keep=0)
    for part in np.array_split(errors, 7):
        binned.add(part, part.size)
    assert binned.metrics().le90 == pytest.approx(exact, abs=0.0005)
    assert np.isnan(height_metrics(np.array([np.nan]), 4).le90)


def _points(count, role):
    rng = np.random.default_rng(3)
    gcps = [Gcp(str(k), 1.0 + k * 1e-3, 43.0, 200.0, role, {"a": np.zeros(2)}) for k in range(count)]
    errors = rng.normal(0.0, [0.3, 0.4, 0.5], (count, 3))
    dsm = np.column_stack([np.full((count, 2), np.nan), errors[:, 2]])
    return GcpAccuracy(gcps, {"scene": errors, "dsm": dsm}), errors


def test_control_points_are_reported_in_the_words_of_contracts():
    found, errors = _points(12, "check")
    text = plain(gcp_page(found, CheckGcpsOptions(gcps="points.csv", dsm="dsm.tif", output="o.gpkg")).html())
    height, ground = np.abs(errors[:, 2]), np.hypot(errors[:, 0], errors[:, 1])
    assert f"RMSE_V {np.sqrt((height**2).mean()):.3f} m (ASPRS 2023)" in text
    assert f"LE90 {np.quantile(height, 0.9):.3f} m (NMAS), of 12 check points." in text
    assert "ASPRS asks for at least 30 check points" in text
    assert f"{np.quantile(ground, 0.9):.3f}" in text and "CE90, m" in text
    assert found.horizontal("dsm").count == 0, "a DSM places nothing"
    many = gcp_page(_points(40, "check")[0], CheckGcpsOptions(gcps="points.csv", dsm="dsm.tif", output="o.gpkg"))
    assert "ASPRS asks for" not in plain(many.html())
