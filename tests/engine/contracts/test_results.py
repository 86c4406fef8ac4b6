"""What stages return: complete, read from JSON as strictly as it was written, and described where a reader looks."""

from __future__ import annotations

import dataclasses
import importlib.util
import pathlib

import pytest

from repm_qgis.contracts.checks import Misfit
from repm_qgis.contracts.products import products_of
from repm_qgis.contracts.results import FusedSurface, RefineResult, Tiles3dResult
from repm_qgis.contracts.stages import REFINE, STAGES

ROOT = pathlib.Path(__file__).resolve().parents[3]
REFINED = {"output_scene": "refined.json", "report": "page.html", "rmse": 0.25, "max_error": 1.5}


@pytest.fixture(scope="module")
def tables():
    spec = importlib.util.spec_from_file_location("result_tables", ROOT / "scripts" / "result_tables.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("stage", STAGES.values(), ids=STAGES)
def test_a_field_is_a_product_or_says_what_it_means(stage):
    fields = {each.name for each in dataclasses.fields(stage.result)}
    paths = fields - set(stage.result.meanings())
    products = {each.option for each in products_of(stage.name)}
    assert paths <= products | {"heights", "folder", "workspace"}
    # The pipeline passes no scene of a stage on but the last, which is 'scene'; a truth is a figure of sampledata.
    assert products - fields <= {"output_scene"}
    for name, meaning in stage.result.meanings().items():
        assert meaning.text and not meaning.text.endswith("."), name


@pytest.mark.parametrize("stage", STAGES.values(), ids=STAGES)
def test_no_field_has_a_default(stage):
    """A stage that forgets a field fails at once."""
    assert all(each.default is each.default_factory is dataclasses.MISSING for each in dataclasses.fields(stage.result))
    with pytest.raises(TypeError, match="missing"):
        stage.result()


@pytest.mark.parametrize("stage", STAGES)
def test_the_page_has_the_table_of_results(stage, tables):
    path = ROOT / "docs" / "algorithms" / f"{stage}.md"
    text = path.read_text(encoding="utf-8")
    assert tables.page(stage, text) == text, "run 'make tables'"


def test_a_page_without_a_place_for_the_table_is_named(tables):
    with pytest.raises(ValueError, match="dtm.md has no place"):
        tables.page("dtm", "# Words")


def test_a_result_is_what_its_json_says():
    result = REFINE.result.from_mapping(REFINED)
    assert result == RefineResult(output_scene="refined.json", report="page.html", rmse=0.25, max_error=1.5)
    assert result.to_mapping() == REFINED


@pytest.mark.parametrize(
    "wrong, words",
    (
        ({"rmse": None}, "rmse"),
        ({"rmse": "0.25"}, "rmse"),
        ({"report": 3}, "report"),
    ),
)
def test_a_wrong_value_is_refused(wrong, words):
    with pytest.raises(Misfit, match=words):
        RefineResult.from_mapping({**REFINED, **wrong})


@pytest.mark.parametrize("name", REFINED)
def test_a_result_that_lacks_a_field_is_refused(name):
    with pytest.raises(Misfit, match=f"{name} is missing"):
        RefineResult.from_mapping({key: value for key, value in REFINED.items() if key != name})


def test_lists_of_json_become_tuples_and_back():
    values = {"tiles3d": "t", "tileset": "t/tileset.json", "tiles": 3, "vertices": 4, "triangles": 2, "points": None}
    assert Tiles3dResult.from_mapping(values).to_mapping() == values
    images = {"folder": "f", "images": ["a", "b"], "truth": "t", "gcps": "g", "rpc_fit_max_px": 1e-6}
    made = STAGES["sampledata"].result.from_mapping(images)
    assert made.images == ("a", "b") and made.to_mapping() == images


def test_a_fused_surface_lends_its_fields_to_the_pipeline():
    names = {each.name for each in dataclasses.fields(FusedSurface)}
    assert names < {each.name for each in dataclasses.fields(STAGES["pipeline"].result)}
    assert names < {each.name for each in dataclasses.fields(STAGES["dsmfuse"].result)}
