from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.evaluation.metrics import ErrorCollector, height_metrics

THRESHOLDS = (0.5, 1.0, 2.5)


def independent(e, n):
    v = sorted(float(x) for x in e.ravel() if np.isfinite(x))
    median = lambda s: (sorted(s)[(len(s) - 1) // 2] + sorted(s)[len(s) // 2]) / 2  # noqa: E731
    bias = median(v)
    return {
        "rmse": (sum(x * x for x in v) / len(v)) ** 0.5,
        "mae": sum(map(abs, v)) / len(v),
        "medae": median([abs(x) for x in v]),
        "bias": bias,
        "nmad": 1.4826 * median([abs(x - bias) for x in v]),
        "valid": 100 * len(v) / n,
        "completeness": [100 * sum(abs(x) < t for x in v) / n for t in THRESHOLDS],
    }


@pytest.fixture
def errors():
    rng = np.random.default_rng(5)
    e = rng.standard_t(2, (60, 51)) * 0.7 + 0.4
    e[rng.random(e.shape) < 0.2] = np.nan
    return e


def test_metrics_are_the_definitions(errors):
    got, want = height_metrics(errors, errors.size + 100, THRESHOLDS), independent(errors, errors.size + 100)
    for name in ("rmse", "mae", "medae", "bias", "nmad", "valid"):
        assert getattr(got, name) == pytest.approx(want[name], abs=1e-6), name
    assert [share for _, share in got.completeness] == pytest.approx(want["completeness"], abs=1e-6)
    assert got.cells == np.isfinite(errors).sum()


def test_metrics_mean_the_same_as_the_scoring_tool(errors, shared_data):
    import importlib.util

    tool = shared_data.parent / "tools" / "score_dsm.py"
    if not tool.exists():
        pytest.skip(f"{tool} is absent")
    spec = importlib.util.spec_from_file_location("score_dsm", tool)
    score = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(score)
    want, got = (
        score.stats(errors, errors.size + 100, THRESHOLDS),
        height_metrics(errors, errors.size + 100, THRESHOLDS),
    )
    pairs = {"valid": got.valid, "bias": got.bias, "ME": got.medae, "MAE": got.mae, "RMSE": got.rmse, "NMAD": got.nmad}
    pairs.update({f"C{t:g}": share for t, share in got.completeness})
    for name, value in pairs.items():
        assert value == pytest.approx(want[name], abs=0.00051), name


def test_blocks_give_what_the_whole_gives(errors):
    whole, parts = height_metrics(errors, errors.size, THRESHOLDS), ErrorCollector(THRESHOLDS)
    for block in np.array_split(errors, 7):
        parts.add(block, block.size)
    got = parts.metrics()
    assert (got.medae, got.nmad, got.bias, got.cells) == (whole.medae, whole.nmad, whole.bias, whole.cells)
    assert got.rmse == pytest.approx(whole.rmse, rel=1e-12)


@pytest.mark.parametrize("keep", [0, 1000])
def test_medians_of_the_histogram_are_good_to_its_bin(errors, keep):
    whole, binned = height_metrics(errors, errors.size), ErrorCollector((1.0,), keep=keep)
    for block in np.array_split(errors, 7):
        binned.add(block, block.size)
    assert not binned.exact
    got = binned.metrics()
    for name in ("medae", "nmad", "bias"):
        assert getattr(got, name) == pytest.approx(getattr(whole, name), abs=0.001), name
    assert got.rmse == pytest.approx(whole.rmse, rel=1e-9)


def test_holes_lower_completeness_but_not_accuracy():
    full, holed = np.full(100, 0.3), np.full(100, 0.3)
    holed[:40] = np.nan
    a, b = height_metrics(full, 100, (1.0,)), height_metrics(holed, 100, (1.0,))
    assert (a.rmse, a.completeness[0][1]) == (pytest.approx(0.3), 100.0)
    assert (b.rmse, b.completeness[0][1], b.valid) == (pytest.approx(0.3), 60.0, 60.0)


def test_threshold_is_exclusive_and_nothing_gives_nan():
    assert height_metrics(np.array([1.0, -0.5]), 2, (1.0,)).completeness == ((1.0, 50.0),)
    none = height_metrics(np.full(4, np.nan), 4, (1.0,))
    assert none.cells == 0 and np.isnan(none.rmse) and np.isnan(none.nmad) and none.valid == 0
    with pytest.raises(ValueError, match="3 errors cannot come from 2"):
        height_metrics(np.zeros(3), 2)
