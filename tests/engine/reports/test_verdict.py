"""The first thing on a report: whether the figures are as usual, and which ones to look at."""

from __future__ import annotations

import copy
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from repm_qgis.contracts.checks import Misfit
from repm_qgis.contracts.findings import Finding
from repm_qgis.contracts.options import CheckGcpsOptions
from repm_qgis.contracts.records import FusionFacts, StageRecord
from repm_qgis.evaluation.gcp_accuracy import GcpAccuracy
from repm_qgis.evaluation.metrics import height_metrics
from repm_qgis.fusion.rasters import overlap_m2
from repm_qgis.geometry.height_causes import likely_cause
from repm_qgis.imagery.raster import opened, read
from repm_qgis.pointing.ground_control import Gcp
from repm_qgis.reports import verdict
from repm_qgis.reports.gcp_page import gcp_page
from repm_qgis.reports.parameters import VERDICT
from repm_qgis.reports.report import Report
from repm_qgis.reports.stage_reports import errormap_report, fit_report, pipeline_report, refine_report
from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.runtime.translation import Translator, written_in
from repm_qgis.scene import Scene
from tests.engine.pages import plain

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def made(urban_run):
    scene = Scene.load(urban_run.result.scene)
    history = [replace(entry, warnings=()) for entry in scene.history]
    return replace(scene, history=tuple(history)), FusionFacts.from_mapping(urban_run.result.to_mapping())


def test_a_good_run_is_called_good_and_says_why(urban_run, made):
    scene, facts = made
    assert verdict.of_run(scene, facts) == []
    page = plain(pipeline_report(scene, urban_run.result, None).html())
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
    }
    for text, case in cases.items():
        (finding,) = verdict.of_run(*case)
        assert text in finding
    worst = verdict.largest_error_px(scene)
    (finding,) = verdict.of_run(scene, facts, replace(VERDICT, most_equivalent_px=worst / 2))
    assert "The cameras of a tile differ from the RPC" in finding


@pytest.mark.long
def test_no_page_is_good_where_a_stage_or_the_run_has_warned(urban_run, made, tmp_path):
    scene, _ = made
    early = replace(scene.history[0], warnings=(Finding("a", "An early warning."),))
    warned = replace(scene, history=(early, *scene.history[1:]))
    pages = {"run": pipeline_report(warned, urban_run.result, None), "fit": fit_report(warned)}
    for name, top in tops({**pages, "refinement": refine_report(warned)}).items():
        assert "<li>An early warning.</li>" in top and "Good." not in top, name
    run = Recorder(Silent())
    run.warn(Finding("b", "A late warning.", "doubt"))
    run.warn(Finding("b", "A late warning.", "doubt"))
    pipeline_report(scene, urban_run.result, None).write(tmp_path / "r.html", run)
    page = plain((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert page.count("<li>A late warning.</li>") == 1 and "Good." not in page
    assert "<strong>Do not use it before you have looked at:</strong>" in page


def test_findings_survive_a_scene_file_and_a_copy(made, tmp_path):
    scene, _ = made
    finding = Finding("dem-apart", "The DSM lies 42.0 m above the DEM.", "doubt")
    entry = replace(scene.history[0], warnings=(finding,))
    (again,) = StageRecord.from_mapping(json.loads(json.dumps(entry.to_mapping()))).warnings
    for each in (again, copy.copy(finding)):
        assert (each, each.id, each.level) == (finding, "dem-apart", "doubt")
    for wrong in ("x", {"id": "a", "text": "b", "level": "c"}):
        with pytest.raises(Misfit, match="an id, a level and a text"):
            StageRecord.from_mapping({**entry.to_mapping(), "warnings": [wrong]})


def test_a_report_lists_what_to_look_at(urban_run, made):
    scene, facts = made
    result = replace(urban_run.result, valid_percent=12.0)
    page = plain(pipeline_report(scene, result, None).html())
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


def test_a_comparison_is_judged_by_spread():
    rng = np.random.default_rng(0)
    errors = rng.normal(0, 51.0, 1000)
    (finding,) = verdict.of_comparison(height_metrics(errors, 1000), 0.5)
    assert "do not show the same surface" in finding and "at most 10 m" in finding
    # A DEM with cells of 90 m is off by the relief within them, and is sound.
    assert verdict.of_comparison(height_metrics(errors, 1000), 90.0) == []


def test_the_share_of_heights_is_that_of_the_ground_which_two_images_see(urban_run, made):
    scene, facts = made
    assert facts.valid_percent > 90  # of the rectangle around it, about 70: the images are turned
    with opened(urban_run.result.output) as dataset:
        seen = overlap_m2(scene, float(np.nanmedian(read(dataset))))
    assert facts.cells == pytest.approx(max(seen / facts.resolution**2, facts.valid), rel=1e-3)
    # The images of the town are 400 px of 0.5 m, and see nearly the same ground.
    assert 0.8 * 200**2 < seen < 1.02 * 200**2


def tops(pages):
    """What each page shows above its first section."""
    return {name: plain(page.html()).split("<h2")[0] for name, page in pages.items()}


def test_the_pages_of_cameras_begin_with_a_verdict(made, urban_run, tmp_path):
    scene, _ = made
    raster = urban_run.result.output  # its picture is all that the page takes of it
    worst = verdict.fitted_error_px(scene)
    pages = {
        "fit": fit_report(scene),
        "refinement": refine_report(scene),
        "map": errormap_report(scene, scene.views[0], raster, 0.01, 0.02, 200.0),
    }
    for name, top in tops(pages).items():
        assert "<strong>Good.</strong>" in top and "from the RPC" in top, name
    assert verdict.of_fit(scene) == verdict.of_refinement(scene) == []
    (finding,) = verdict.of_fit(scene, replace(VERDICT, most_equivalent_px=worst / 2))
    assert "refine the images, or choose a smaller TILE_SIZE" in finding
    (finding,) = verdict.of_refinement(scene, replace(VERDICT, most_equivalent_px=1e-9))
    assert "see 'Equivalent error'" in finding
    assert verdict.of_error_map(0.3, False) == verdict.of_error_map(0.3, True) == []
    (finding,) = verdict.of_error_map(0.31, False)
    assert "by 0.31 px" in finding and "refine the images" in finding
    assert "another MODEL" in verdict.of_error_map(1, True)[0]
    bad = errormap_report(scene, scene.views[0], raster, 0.5, 0.9, 200.0)
    top = plain(bad.html(verdict.of_error_map(0.5, False))).split("<h2")[0]
    assert "<strong>Look at:</strong>" in top


def test_the_words_of_the_page_are_in_the_language_of_each():
    for language, words in (
        ("en", ("Good.", "Look at:")),
        ("de", ("Gut.", "Zu prüfen:")),
        ("en", ("Good.", "Look at:")),
    ):
        with written_in(language):
            pages = Report("x").verdict("y", []).html(), Report("x").verdict("y", [Finding("z", "z")]).html()
        assert all(f"<strong>{word}</strong>" in page for word, page in zip(words, pages)), language


def points(count, up, residual=0.3):
    """Points whose DSM is wrong by ``up``, and which miss the images by ``residual`` px."""
    pixels = [{"a": np.array([residual, 0.0])} for _ in range(count)]
    gcps = [Gcp(f"P{k}", 1.0 + k / 1e4, 43.0, 100.0, "check", {"a": np.zeros(2)}) for k in range(count)]
    errors = np.full((count, 3), np.nan)
    errors[:, 2] = np.resize(np.asarray(up, dtype=float), count)
    return GcpAccuracy(gcps, {"dsm": errors}, {"rpc": pixels, "scene": pixels})


def test_a_check_of_points_is_judged():
    good = points(6, [0.2, -0.1, 0.05])
    assert verdict.of_points(good) == []
    top = tops({"": gcp_page(good, CheckGcpsOptions(gcps="p.csv", dsm="dsm.tif"))})[""]
    assert "<strong>Good.</strong>" in top and "Half of the DSM&#39;s heights are within 0.100 m" in top
    cases = {
        "differ from the points' by +3.10 m as a whole": points(6, [3.1, 3.0, 3.2]),
        "Points that can be used: 3 (with fewer than 4": points(3, [0.1]),
        "in the images is 2.00 px (usual: at most 1.5 px)": points(6, [0.1], 2.0),
    }
    for text, found in cases.items():
        (finding,) = verdict.of_points(found)
        assert text in finding
    # What the vendors' pointing misses by is no finding: it is what the points are for.
    vendors = replace(points(6, [0.1], 9.0), residuals={"rpc": points(6, [0.1], 9.0).residuals["rpc"]})
    assert verdict.of_points(vendors) == []


def test_a_mosaic_is_judged_by_what_the_offsets_leave():
    fine = [verdict.Difference(1, 2, 0.4, 0.1), verdict.Difference(2, 3, -0.9, 0.5)]
    assert verdict.of_mosaic(fine) == []
    wide = verdict.Difference(1, 3, -1.2, 0.5)
    (finding,) = verdict.of_mosaic([*fine, wide])
    assert "1 of 3, at most 1.20 m (DSMs 1 and 3)" in finding
    (finding,) = verdict.of_mosaic([*fine, verdict.Difference(2, 3, 0.1, 31.0)])
    assert "do not show the same surface: 1 of 3; those of DSMs 2 and 3 differ by 31.0 m (NMAD" in finding


def test_what_contradicts_a_result_stands_before_what_was_taken_for_granted():
    run = [
        Finding("datum-unknown", "No datum is stated."),
        Finding("coverage-low", "Few heights."),
        Finding("relief-other", "Another town.", "doubt"),
    ]
    page = plain(Report("A check", "of a DSM").verdict("Good.", run[:1]).html(run))
    assert page.index("Another town.") < page.index("Few heights.") < page.index("No datum is stated.")
    assert page.count("No datum is stated.") == 1


def test_findings_have_no_english_part_in_german():
    cause = likely_cause(0.3048 * 100 - 100, 100.0, 8.0, 50.0, 1.0)
    german = Translator.of("de").translate
    for text in (
        str(*verdict.of_changed(0.4)),
        "The DSM's heights differ from the points' by -69.5 m as a whole, which is usually a geoid or a unit. The "
        f"points' heights would change by {cause}: check their unit, GCP_DATUM and the DSM's datum.",
        "DSMs are moved by more than 5 m: 'a.tif' (+7.1 m), 'b.tif' (-3.2 m); check their vertical datums and units, "
        "and name those that are right in FIXED.",
    ):
        assert not re.search(r"\b(the|of|if|by|are|in feet)\b", german(text)), german(text)


def test_quotation_marks_and_terms_are_german():
    """Commands and code keep theirs."""
    texts = json.loads((ROOT / "i18n" / "engine_de.json").read_text(encoding="utf-8")).values()
    code = ("sudo", "apt-get", "__name__", "QGIS' ")
    assert not [text for text in texts if re.search(r"'[^']+'", text) and not any(each in text for each in code)]
    assert not [text for text in texts if re.search("Höhendat(um|en)|Koordinatenbezugssystem|das Bezugssystem", text)]
