"""Products stand in one table, which the options, the early checks, the report and the styles agree with."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import pytest

from repm_qgis.contracts import products
from repm_qgis.contracts.errors import WorkspaceError
from repm_qgis.contracts.products import PRODUCTS, STYLES, forms, products_of
from repm_qgis.reports.stage_reports import pipeline_report
from repm_qgis.scene import Scene
from repm_qgis.stages import STAGES, run_stage
from tests.engine.pages import plain

ROOT = str(Path(__file__).resolve().parents[3])


def test_every_product_is_an_option_of_its_stage_or_a_result_of_it():
    for product in PRODUCTS:
        assert product.option in STAGES[product.stage].options.names() or (product.stage, product.option) == (
            "sampledata",
            "truth",
        )


def test_every_option_that_names_something_to_write_is_a_product():
    """By their types: paths that may be left out, and that no stage reads."""
    for name, stage in STAGES.items():
        for option in stage.options.names():
            declared = stage.options.option(option)
            path = declared.type == "Optional[str]" and not declared.metadata.get("read")
            if path and option not in ("crs", "command"):
                assert any(product.option == option for product in products_of(name)) or option == "report", option


def test_an_option_is_the_same_kind_of_place_in_every_stage():
    for product in PRODUCTS:
        whole = forms()[product.option], product.form
        assert len({form for form in whole if form not in ("raster", "points", "polygons", "file")}) < 2
    assert forms()["view_heights"] == "folder" and forms()["ept"] == "built folder" and forms()["scene"] == "scene"


def test_every_style_has_its_template_and_every_template_its_style():
    templates = {name[:-4] for name in os.listdir(os.path.join(ROOT, "resources", "styles")) if name.endswith(".qml")}
    used = {name for style in STYLES if not style.plain for name in (style.template or style.kind, style.coloured)}
    assert used - {""} == templates
    layers = {style.kind for style in STYLES if not style.view_of and not style.plain}
    # Drawn over the DSM; a layer for each date in the folder of a series; layers of the model "DSM to map".
    without_product = {"hillshade", "dated", "contours", "breaklines", "slope", "ruggedness", "shading"}
    assert {product.style for product in PRODUCTS if product.style} == layers - without_product
    assert {style.view_of for style in STYLES if style.view_of} < layers


def test_no_two_reports_have_the_same_name():
    titles = [product.title for product in PRODUCTS if product.option == "report"]
    assert len(set(titles)) == len(titles) >= 8 and "Report" not in titles


def test_the_pipeline_has_the_products_of_its_stages_and_one_report():
    names = [product.option for product in products_of("pipeline")]
    assert {"tiles", "tie_points", "output", "view_heights", "workspace"} < set(names) and names.count("report") == 1
    assert products.product("pipeline", "report").stage == "pipeline"


@pytest.mark.parametrize("option", ("view_heights", "tie_points", "tiles", "output", "mesh", "ept", "report"))
def test_a_place_that_cannot_be_written_is_refused_before_the_work(urban, tmp_path, told, option):
    (tmp_path / "file").write_text("")
    suffix = {"mesh": ".ply"}.get(option, "")
    said = told()
    given = {"images": urban.images, "workspace": str(tmp_path / "w"), "output": str(tmp_path / "dsm.tif")}
    with pytest.raises(WorkspaceError, match=re.escape(str(tmp_path / "file"))):
        run_stage("pipeline", {**given, option: str(tmp_path / "file" / f"x{suffix}")}, said)
    assert not said.fractions and not (tmp_path / "w" / "scene.json").exists()


@pytest.mark.slow
def test_the_report_names_every_product_that_was_made(urban_run):
    named = {"view_heights": "/somewhere/pairs", "stac": "/somewhere/dsm.json", "water_mask": "/somewhere/water.tif"}
    made = replace(urban_run.result, **named)
    page = plain(pipeline_report(Scene.load(made.scene), made, None).html())
    for product in products_of("pipeline"):
        if product.stage == "dsmfuse":
            assert f"<td>{product.title}</td>" in page and str(getattr(made, product.option)) in page
