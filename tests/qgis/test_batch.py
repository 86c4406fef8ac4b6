"""repm:batch in QGIS: from the command line as a user runs it, its layer with its style, and early refusals."""

from __future__ import annotations

import json
import shutil
import sys

import pytest
from qgis.core import QgsApplication, QgsVectorLayer


@pytest.fixture(scope="module")
def sites(tmp_path_factory):
    """Two subfolders: a small pair, and one image alone."""
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    folder = tmp_path_factory.mktemp("sites")
    made = run_stage("sampledata", {"folder": str(folder / "pair"), "size": 160, "seed": 5}, Silent())
    (folder / "single").mkdir()
    shutil.move(made.images[2], folder / "single")
    return folder


@pytest.mark.long
def test_many_scenes_from_the_command_line(headless, sites, tmp_path):
    given = [f"FOLDER={sites}", f"WORKSPACE={tmp_path / 'ws'}", f"OUTPUT={tmp_path / 'all.gpkg'}", "FILL=none"]
    given += ["PRODUCTS=confidence,ortho", f"REPORT={tmp_path / 'all.html'}"]
    for reused in (0, 1):
        done = headless("--json", "run", "repm:batch", "--", *given, REPM_ENGINE_PYTHON=sys.executable)
        assert done.returncode == 0, done.stderr + done.stdout
        results = json.loads(done.stdout)["results"]
        assert (results["N_SCENES"], results["N_FAILED"], results["N_REUSED"]) == (2, 1, reused)
        assert results["DSMS"] == [str(tmp_path / "ws" / "pair" / "dsm.tif")]
    assert (tmp_path / "ws" / "pair" / "ortho.tif").exists() and "MOSAIC" not in results
    page = (tmp_path / "all.html").read_text(encoding="utf-8")
    assert 'href="ws/pair/report.html"' in page and "one image has no heights" in page
    layer = QgsVectorLayer(results["OUTPUT"], "all", "ogr")
    assert layer.isValid() and layer.crs().authid() == "EPSG:4326"
    assert {row["scene"]: row["verdict"] == "failed" for row in layer.getFeatures()} == {"pair": False, "single": True}
    layer.loadNamedStyle(str(tmp_path / "all.qml"))
    words = {category.value(): category.label() for category in layer.renderer().categories()}
    assert list(words) == ["good", "look", "doubt", "failed"] and words["failed"] == "Failed"
    field = layer.fields().indexOf("report")
    assert layer.editorWidgetSetup(field).type() == "ExternalResource" and "report" in layer.mapTipTemplate()


def test_the_panel_of_scenes_knows_the_folders_afterwards(plugin, context, sites, tmp_path, monkeypatch):
    import processing
    from repm.processing_provider import batch, last_scene

    outcome = {"workspace": "", "output": None, "report": None, "mosaic": None, "scenes": [], "seconds": 1.0}
    counts = {"n_scenes": 3, "n_failed": 1, "n_reused": 0}
    dsms = [str(tmp_path / name / "dsm.tif") for name in ("a", "b")]

    class Result:
        def to_mapping(self):
            return {**outcome, **counts, "dsms": dsms}

    monkeypatch.setattr(batch.Batch, "run_stage", lambda *arguments: Result())
    made = processing.run("repm:batch", {"FOLDER": str(sites), "WORKSPACE": str(tmp_path / "ws")})
    assert made["DSMS"] == dsms and made["N_FAILED"] == 1
    assert last_scene.workspaces()[:2] == [str(tmp_path / "a"), str(tmp_path / "b")]


def test_bad_tables_are_one_sentence_before_the_run(plugin, context, sites, tmp_path):
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:batch")
    table = tmp_path / "sites.csv"
    table.write_text(f"scene,images,resolutoin\na,{sites / 'pair'},1\n", encoding="utf-8")
    for given, words in (
        ({}, "FOLDER is empty: it must be given, or TABLE"),
        ({"FOLDER": str(sites), "TABLE": str(table)}, "not both"),
        ({"FOLDER": str(tmp_path / "gone")}, "cannot be read"),
        ({"TABLE": str(tmp_path / "gone.csv")}, "gone.csv' is not there"),
        ({"TABLE": str(table)}, "do you mean 'resolution'"),
        ({"FOLDER": str(sites), "PRODUCTS": "dsm"}, "PRODUCTS is 'dsm'"),
        ({"FOLDER": str(sites), "RESOLUTION": -3}, "RESOLUTION"),
    ):
        fine, text = algorithm.create().checkParameterValues({"WORKSPACE": str(tmp_path / "ws"), **given}, context)
        assert not fine and words in text, text
    for products in (["confidence", "mesh"], "confidence,mesh", [], None):
        given = {"FOLDER": str(sites), "WORKSPACE": str(tmp_path / "ws"), "PRODUCTS": products}
        fine, text = algorithm.create().checkParameterValues(given, context)
        assert fine, text


def test_the_preset_decides_what_is_not_given(plugin, context):
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:batch")
    assert algorithm.left_to_engine({"PRESET": "fast", "FILL": "all"}) == {"quality", "pointing"}


def test_a_workspace_is_proposed_beside_the_scenes_and_stays(plugin, sites):
    from repm.processing_provider.kept import is_lasting, propose_for_many

    proposed = propose_for_many(str(sites))
    if is_lasting(str(sites)):
        assert proposed == str(sites.parent / "repm" / sites.name)
    assert propose_for_many(str(sites)) == proposed and propose_for_many("") == ""
