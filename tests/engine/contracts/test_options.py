"""Options: each stated once, given by name, and checked in the engine alone."""

from __future__ import annotations

import ast
from dataclasses import fields
from pathlib import Path

import pytest

from repm_qgis.contracts import options as all_options
from repm_qgis.contracts.errors import OptionError
from repm_qgis.contracts.options import (
    DsmFuseOptions,
    EpmFitOptions,
    Options,
    PipelineOptions,
    ReconstructOptions,
    RefineOptions,
    RegisterOptions,
    SampleDataOptions,
)
from repm_qgis.stages import STAGES

ROOT = Path(__file__).resolve().parents[3]
FILES = {"images": ["a.tif", "b.tif"], "workspace": "w", "output": "dsm.tif"}


@pytest.mark.long
def test_no_options_class_is_called_with_positions():
    """Neither where a checker of types would see it, nor in tests and scripts."""
    names = {stage.options.__name__ for stage in STAGES.values()}
    folders = ("repm_qgis", "processing_provider", "benchmarks", "scripts", "tests")
    found, calls = [], 0
    for path in (path for folder in folders for path in (ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = getattr(node.func, "id", getattr(node.func, "attr", "")) if isinstance(node, ast.Call) else ""
            if name in names:
                calls += 1
                found += [f"{path}:{node.lineno}"] if node.args else []
    assert calls > 10 and not found


def test_a_position_is_refused():
    with pytest.raises(TypeError, match="by name"):
        STAGES["refine"].options("scene.json", "refined.json")


def test_the_pipeline_has_every_option_of_its_stages_but_those_that_it_sets():
    flat = set(PipelineOptions.names())
    for stage in PipelineOptions.STAGES:
        assert {each.name for each in fields(stage)} - set(PipelineOptions.SET_HERE) <= flat
    assert not flat & set(PipelineOptions.SET_HERE)


def test_a_scene_without_a_name_lies_beside_the_one_before_it():
    place, given = Path("w", "scene.json"), {"scene": str(Path("w", "scene.json"))}
    for absent in ({}, {"output_scene": None}, {"output_scene": ""}):
        assert RefineOptions.from_json({**given, **absent}).output_scene == str(place.with_name("refined.json"))
        made = ReconstructOptions.from_json({**given, **absent})
        assert made.output_scene == str(place.with_name("reconstructed.json"))
        made = RegisterOptions.from_json({**given, "reference": ["r.tif"], **absent})
        assert made.output_scene == str(place.with_name("registered.json"))
    assert RefineOptions.from_json({**given, "output_scene": "x.json"}).output_scene == "x.json"
    with pytest.raises(OptionError, match="SCENE"):
        RefineOptions.from_json({"scene": 3})


def test_the_pipelines_stages_take_each_others_scenes():
    made = PipelineOptions.from_json({**FILES, "crs": "EPSG:32631", "workers": 2, "report": "r.html", "order": 3})
    assert made.fit.images == ("a.tif", "b.tif") and made.fit.report is None and made.report == "r.html"
    assert made.refine.scene == str(Path("w", "scene.json")) and not made.refine.write_images
    assert made.refine.output_scene == made.reconstruct.scene and made.reconstruct.output_scene == made.fuse.scene
    assert made.fit.crs == made.fuse.crs == "EPSG:32631" and made.reconstruct.workers == made.fuse.workers == 2
    assert (made.refine.model, made.refine.order, made.fit.tile_size) == ("polynomial", 3, 0)


@pytest.mark.parametrize(
    "given, model, surface, own",
    (({}, "polynomial", None, True), ({"dem": "d.tif"}, "terrain", "d.tif", False)),
)
def test_the_terrain_model_takes_the_dem_or_finds_its_surface(given, model, surface, own):
    made = PipelineOptions.from_json({**FILES, "model": "terrain", **given})
    assert (made.refine.model, made.refine.dem, made.reconstruct.own_surface) == (model, surface, own)
    assert made.fit.tile_size == all_options.TERRAIN_TILE_PX
    assert PipelineOptions.from_json({**FILES, "model": "terrain", "tile_size": 500}).fit.tile_size == 500


@pytest.mark.parametrize(
    "stage, wrong, words",
    (
        ("pipeline", {"order": 9}, "ORDER is 9: it must be a whole number between 2 and 5."),
        ("pipeline", {"order": 2.5}, "a whole number"),
        ("pipeline", {"scene": "s.json"}, "not an option of this stage"),
        ("pipeline", {"output": ""}, "OUTPUT is empty: it must be the path of a file or folder."),
        ("pipeline", {"resolution": float("nan")}, "between 0.01 and 1000 m, or 0 for automatic"),
        ("pipeline", {"geometric": "yes"}, "GEOMETRIC is 'yes': it must be true or false."),
        ("pipeline", {"workers": True}, "WORKERS is True"),
        ("pipeline", {"tile_size": 10}, "TILE_SIZE is 10: it must be a whole number between 256 and 20000 px, or 0"),
        ("pipeline", {"model": "bent"}, "MODEL is 'bent': it must be one of none, homography, polynomial, terrain."),
        ("pipeline", {"altitude_min": 300.0, "altitude_max": 200}, "must be below ALTITUDE_MAX (200 m)"),
        ("dsmfuse", {"scene": "s.json", "output": "d.tif", "cloud": "c.xyz"}, "must end with .laz, .las or .ply"),
        ("comparedsm", {"dsm": "a", "reference": "b", "thresholds": [1, 0]}, "THRESHOLDS"),
        ("checkgcps", {"gcps": "p.csv"}, "there is nothing to check"),
        ("sampledata", {}, "FOLDER is empty: it must be given."),
    ),
)
def test_wrong_values_are_one_sentence(stage, wrong, words):
    with pytest.raises(OptionError) as caught:
        STAGES[stage].options.from_json({**(FILES if stage == "pipeline" else {}), **wrong})
    assert words in str(caught.value) and str(caught.value).endswith(".") and "\n" not in str(caught.value)


def test_values_at_the_bounds_are_fine():
    assert SampleDataOptions(folder="f", size=128, seed=0).size == 128
    assert EpmFitOptions(images=("a", "b"), workspace="w", tile_size=256, altitude_min=-12000).tile_size == 256
    assert DsmFuseOptions(scene="s", output="o", resolution=0, outlier_radius=0.0).outlier_radius == 0.0


def test_json_there_and_back():
    for stage, needed in ((RefineOptions, {"scene": "s", "output_scene": "o"}), (EpmFitOptions, FILES)):
        made = stage.from_json({name: value for name, value in needed.items() if name in stage.names()})
        assert isinstance(made, Options) and stage.from_json(made.to_json()) == made


@pytest.mark.parametrize(
    "wrong, words",
    (
        ({"dem": 5}, "DEM is 5: it must be a text."),
        ({"crs": ["EPSG:32631"]}, "CRS is "),
        ({"images": ["a", 5]}, "IMAGES is ('a', 5): it must be a list, and entry 1 of it must be a text."),
        ({"images": "a"}, "must be a list"),
        ({"extent": [0, 0, 1]}, "EXTENT is (0, 0, 1): it must have 4 entries."),
        ({"extent": [1, 0, 0, 1]}, "xmin < xmax"),
        ({"workspace": "a\0b"}, "WORKSPACE is 'a\\x00b': it must be the path of a file or folder."),
        ({"gcps": "a\0b"}, "without the character 0"),
        ({"masks": {"a": 1}}, "must be a list"),
    ),
)
def test_values_of_other_types_are_refused(wrong, words):
    with pytest.raises(OptionError) as caught:
        STAGES["pipeline"].options.from_json({**FILES, **wrong})
    assert words in str(caught.value)
