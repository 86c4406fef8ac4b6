"""The first thing on a report: whether the figures are as usual, and which ones to look at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.dsm.products import overlap_m2
from repm_qgis.evaluation import verdict
from repm_qgis.evaluation.metrics import height_metrics
from repm_qgis.evaluation.parameters import VERDICT
from repm_qgis.evaluation.stage_reports import pipeline_report
from repm_qgis.records import FusionFacts
from repm_qgis.scene import Scene


@pytest.fixture(scope="module")
def made(urban_run):
    scene = Scene.load(urban_run.result["scene"])
    history = [replace(entry, warnings=()) for entry in scene.history]
    return replace(scene, history=tuple(history)), FusionFacts.from_mapping(urban_run.result)


def test_a_good_run_is_called_good_and_says_why(urban_run, made):
    scene, facts = made
    assert verdict.of_run(scene, facts) == []
    page = pipeline_report(scene, urban_run.result, urban_run.result["seconds"], None).html()
    top = page[: page.index("<img")]
    assert 'class="warning good"' in top and "<strong>Good.</strong>" in top
    assert f"{facts.valid_percent:.0f} % of the ground that two images see has a height." in top
    assert "Nothing here measures the absolute position" in top


def test_each_figure_beyond_its_bound_is_a_finding(made):
    scene, facts = made
    ties = scene.pointing
    pairs = (replace(ties.pairs[0], after_px=0.9), *ties.pairs[1:])
    cases = {
        "Only 79 % of the ground": (scene, replace(facts, valid_percent=79.0)),
        "tie points is 0.60 px (usual: at most 0.5 px)": (replace(scene, pointing=replace(ties, after_px=0.6)), facts),
        "keep a vertical parallax of 0.90 px": (replace(scene, pointing=replace(ties, pairs=pairs)), facts),
        "contradict the others (P1)": (replace(scene, pointing=replace(ties, rejected_gcps=("P1",))), facts),
        "Warnings of the stages, which stand below: 1.": (
            replace(scene, history=(replace(scene.history[0], warnings=("x",)), *scene.history[1:])),
            facts,
        ),
    }
    for text, case in cases.items():
        (finding,) = verdict.of_run(*case)
        assert text in finding
    worst = verdict.largest_error_px(scene)
    (finding,) = verdict.of_run(scene, facts, replace(VERDICT, most_equivalent_px=worst / 2))
    assert "The cameras of a tile differ from the RPC" in finding


def test_a_report_lists_what_to_look_at(urban_run, made):
    scene, facts = made
    result = {**urban_run.result, "valid_percent": 12.0}
    page = pipeline_report(scene, result, result["seconds"], None).html()
    top = page[: page.index("<img")]
    assert "<strong>Look at:</strong>" in top and "<li>Only 12 % of the ground" in top and "Good." not in top


def test_a_comparison_is_judged_by_bias_and_cover():
    rng = np.random.default_rng(0)
    errors = rng.normal(0, 0.2, 1000)
    assert verdict.of_comparison(height_metrics(errors, 1000)) == []
    (finding,) = verdict.of_comparison(height_metrics(errors + 3, 1000))
    assert "differ by +2.99 m" in finding
    (finding,) = verdict.of_comparison(height_metrics(errors, 3000))
    assert "covers only 33.3 %" in finding


def test_the_share_of_heights_is_that_of_the_ground_which_two_images_see(urban_run, made):
    scene, facts = made
    assert facts.valid_percent > 90  # of the rectangle around it, about 70: the images are turned
    seen = overlap_m2(scene)
    assert facts.cells == max(round(seen / facts.resolution**2), facts.valid)
    # The images of the town are 400 px of 0.5 m, and see nearly the same ground.
    assert 0.8 * 200**2 < seen < 1.02 * 200**2
