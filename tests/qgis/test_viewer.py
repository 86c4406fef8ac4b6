"""The page of a surface as QGIS makes and opens it."""

from __future__ import annotations

import pathlib

import pytest
from qgis.core import QgsApplication, QgsRasterLayer


@pytest.mark.parametrize("name", ("viewer", "dsmfuse", "pipeline"))
def test_the_results_viewer_takes_the_page_for_one(plugin, name):
    """As it takes reports: a file would be listed nowhere."""
    outputs = {
        each.name(): each
        for each in QgsApplication.processingRegistry().algorithmById(f"repm:{name}").outputDefinitions()
    }
    assert outputs["VIEWER"].type() == "outputHtml"


def test_layers_of_the_project_are_draped(load, town, tmp_path):
    """Rasters in the project, not files by their names; the page is named after the DSM's folder."""
    dsm = QgsRasterLayer(town.truth, "the town")
    results, _ = load("viewer", {"DSM": dsm, "DIFFERENCE": dsm, "VIEWER": str(tmp_path / "town.html")}, {})
    page = pathlib.Path(results["VIEWER"]).read_text(encoding="utf-8")
    assert f"<h1>{pathlib.Path(town.truth).parent.name}</h1>" in page and page.count('"kind":') == 2


def test_a_page_that_nobody_named_is_html(load, town):
    results, _ = load("viewer", {"DSM": town.truth, "VIEWER": "TEMPORARY_OUTPUT"}, {})
    assert results["VIEWER"].endswith(".html") and pathlib.Path(results["VIEWER"]).stat().st_size > 100_000
