"""The provider: what the toolbox and qgis_process see."""

from __future__ import annotations

import os
import pathlib
import re

import pytest
from qgis.core import QgsApplication, QgsProcessingParameterDefinition
from qgis.PyQt.QtCore import QUrl

ROOT = pathlib.Path(__file__).resolve().parents[2]

# Issue 2's table: models and scripts rely on these names.
PARAMETERS = {
    "inspect": "IMAGES RPCS FOOTPRINTS OVERLAPS REPORT",
    "epmfit": "IMAGES EXTENT DEM RPCS MASKS ALTITUDE_MIN ALTITUDE_MAX ORTHO_READY_HEIGHT TILE_SIZE ERROR_BUDGET "
    "WORKSPACE TILES REPORT",
    "errormap": "SCENE VIEW ALTITUDE OUTPUT REPORT",
    "refine": "SCENE MODEL DEM ORDER KERNEL OUTPUT_SCENE REPORT",
    "exportcameras": "SCENE FORMAT TILE CENTRE BITS KERNEL FOLDER",
    "exportrpc": "SCENE GCPS GCP_DATUM RPC_FOLDER REPORT",
    "reconstruct": "SCENE BACKEND GCPS GCP_DATUM QUALITY PAIRS MATCHING_COST POINTING ADJUSTMENT GEOMETRIC "
    "COLMAP_FUSION WINDOW_RADIUS GPU_MEMORY CLUSTER OUTPUT_SCENE TIE_POINTS HEIGHTS",
    "register": "SCENE REFERENCE REFERENCE_DATUM MODEL STABLE OTHERS CLUSTER OUTPUT_SCENE DIFFERENCES OFFSETS REPORT",
    "dsmfuse": "SCENE RESOLUTION CRS VERTICAL_DATUM METHOD FILL WATER OUTLIER_RADIUS MESH_VERTICES ORTHO_RESOLUTION "
    "COLOUR XS PANSHARPEN CLOUD_NORMALS CLUSTER OUTPUT CONFIDENCE ORTHO WATER_MASK CLOUD EPT MESH VIEW_HEIGHTS "
    "VIEWER STAC REPORT",
    "mosaic": "DSMS SCENES FIXED RESOLUTION CRS CONFIDENCES CLUSTER OUTPUT SOURCES REPORT",
    "batch": "FOLDER TABLE PRODUCTS REFERENCE RESOLUTION VERTICAL_DATUM PRESET QUALITY ORTHO_READY_HEIGHT CRS EXTENT "
    "DEM ALTITUDE_MIN ALTITUDE_MAX GCP_DATUM REFERENCE_DATUM STABLE TILE_SIZE ERROR_BUDGET MODEL ORDER PAIRS "
    "MATCHING_COST POINTING ADJUSTMENT BACKEND GEOMETRIC COLMAP_FUSION WINDOW_RADIUS GPU_MEMORY METHOD FILL WATER "
    "OUTLIER_RADIUS MESH_VERTICES ORTHO_RESOLUTION COLOUR PANSHARPEN CLOUD_NORMALS CLUSTER WORKSPACE OUTPUT "
    "MOSAIC REPORT",
    "pipeline": "IMAGES EXTENT GCPS REFERENCE RESOLUTION VERTICAL_DATUM PRESET QUALITY RPCS MASKS ORTHO_READY_HEIGHT "
    "CRS DEM ALTITUDE_MIN ALTITUDE_MAX GCP_DATUM REFERENCE_DATUM STABLE TILE_SIZE ERROR_BUDGET MODEL ORDER "
    "PAIRS MATCHING_COST POINTING ADJUSTMENT BACKEND GEOMETRIC COLMAP_FUSION WINDOW_RADIUS GPU_MEMORY METHOD FILL "
    "WATER OUTLIER_RADIUS MESH_VERTICES ORTHO_RESOLUTION COLOUR XS PANSHARPEN CLOUD_NORMALS CLUSTER OUTPUT WORKSPACE "
    "REPORT TILES TIE_POINTS CONFIDENCE ORTHO WATER_MASK CLOUD EPT MESH VIEW_HEIGHTS VIEWER STAC",
    "dtm": "DSM SCENE CONFIDENCE LARGEST SLOPE VOIDS CLUSTER OUTPUT HEIGHTS MASK REPORT",
    "buildings": "DSM DTM CONFIDENCE ORTHO MIN_HEIGHT MIN_AREA CLUSTER OUTPUT CITYJSON REPORT",
    "editdsm": "DSM EDITS CONFIDENCE OUTPUT EDITED_CONFIDENCE",
    "comparedsm": "DSM REFERENCE ALIGN THRESHOLDS OTHERS CLASSES PROFILES CLUSTER ERROR REPORT",
    "change": "BEFORE AFTER BEFORE_CONFIDENCE AFTER_CONFIDENCE ALIGN MIN_AREA CLUSTER "
    "OUTPUT SIGNIFICANT VOLUMES REPORT",
    "series": "DSMS DATES AREAS ALIGN MIN_AREA CONFIDENCES CLUSTER OUTPUT TREND CHANGED VOLUMES LAYERS TABLE REPORT",
    "checkgcps": "GCPS SCENE DSM GCP_DATUM OUTPUT REPORT",
    "viewer": "DSM ORTHO CONFIDENCE DIFFERENCE CELLS VIEWER",
    "tiles3d": "DSM ORTHO TILES3D",
    "sampledata": "KIND SIZE SEED FOLDER",
    "environment": "INSTALL WHEELS REMOVE REPORT",
}
OUTPUTS = {
    "inspect": "FOOTPRINTS OVERLAPS REPORT N_IMAGES N_PAIRS PAIR TRIPLET",
    "epmfit": "SCENE TILES REPORT RMSE MAX_ERROR WORKSPACE",
    "errormap": "OUTPUT REPORT RMSE MAX_ERROR",
    "refine": "OUTPUT_SCENE REPORT RMSE MAX_ERROR",
    "exportcameras": "FOLDER IMAGES",
    "exportrpc": "RPC_FOLDER REPORT IMAGES MAX_ERROR",
    "reconstruct": "OUTPUT_SCENE TIE_POINTS HEIGHTS REPORT N_TIE_POINTS",
    "register": "OUTPUT_SCENE DIFFERENCES OFFSETS REPORT EAST NORTH UP EAST_DEVIATION NORTH_DEVIATION UP_DEVIATION",
    "dsmfuse": "OUTPUT CONFIDENCE ORTHO WATER_MASK CLOUD EPT MESH VIEW_HEIGHTS VIEWER STAC REPORT VALID_PERCENT",
    "mosaic": "OUTPUT SOURCES REPORT VALID_PERCENT SEAM",
    "batch": "WORKSPACE OUTPUT MOSAIC REPORT DSMS N_SCENES N_FAILED N_REUSED",
    "pipeline": "OUTPUT SCENE REPORT TILES TIE_POINTS CONFIDENCE ORTHO WATER_MASK CLOUD EPT MESH VIEW_HEIGHTS VIEWER "
    "STAC WORKSPACE N_TIE_POINTS VALID_PERCENT FOOTPRINTS OVERLAPS MATCHED_IMAGES LOWEST HIGHEST",
    "dtm": "OUTPUT HEIGHTS MASK REPORT OBJECTS_PERCENT VALID_PERCENT",
    "buildings": "OUTPUT CITYJSON REPORT N_BUILDINGS N_ROOFED AREA_M2 VOLUME_M3",
    "comparedsm": "ERROR REPORT RMSE MEDAE MAE NMAD LE90 COMPLETENESS",
    "editdsm": "OUTPUT EDITED_CONFIDENCE EDITS EDITED_CELLS",
    "change": "OUTPUT SIGNIFICANT VOLUMES REPORT CHANGES GAINED_M3 GAINED_DEVIATION_M3 LOST_M3 LOST_DEVIATION_M3 "
    "LEVEL_M",
    "series": "OUTPUT TREND CHANGED VOLUMES LAYERS TABLE REPORT MAPS N_DATES RISING_M2 FALLING_M2 VOLUME_M3 "
    "VOLUME_DEVIATION_M3",
    "checkgcps": "OUTPUT REPORT "
    + " ".join(
        f"{by}_{figure}" for by in ("RPC", "COMPENSATED", "SCENE", "DSM") for figure in ("MEDAE", "RMSE", "LE90", "MAX")
    )
    + " RPC_CE90 COMPENSATED_CE90 SCENE_CE90",
    "viewer": "VIEWER",
    "tiles3d": "TILES3D TILESET",
    "sampledata": "FOLDER IMAGES TRUTH GCPS",
    "environment": "REPORT",
}


def algorithm(name):
    found = QgsApplication.processingRegistry().algorithmById(f"repm:{name}")
    assert found is not None, f"repm:{name} is not in the registry"
    return found


def test_every_algorithm_and_every_model_is_there(provider):
    names = {entry.name() for entry in provider.algorithms()}
    assert names == set(PARAMETERS) | {"dsm_by_stages", "dsm_to_map"}
    assert provider.id() == "repm"
    assert provider.versionInfo() in provider.longName()


@pytest.mark.parametrize("name", PARAMETERS)
def test_parameters_and_outputs_are_those_that_scripts_rely_on(plugin, name):
    found = algorithm(name)
    assert [entry.name() for entry in found.parameterDefinitions()] == PARAMETERS[name].split()
    assert {entry.name() for entry in found.outputDefinitions()} == set(OUTPUTS[name].split())


@pytest.mark.parametrize("name", PARAMETERS)
def test_every_parameter_is_an_option_of_the_engine_with_its_default(plugin, name):
    import dataclasses

    from repm_qgis.stages import STAGES

    for definition in algorithm(name).parameterDefinitions():
        option = definition.name().lower()
        assert option in STAGES[name].options.names()
        default = STAGES[name].options.option(option).default
        if definition.isDestination() or default is dataclasses.MISSING or definition.name() == "THRESHOLDS":
            continue
        default = (list(default) or None) if isinstance(default, tuple) else default  # as Qt has it
        assert definition.defaultValue() == default, f"{name}.{option}"


@pytest.mark.parametrize("name", PARAMETERS)
def test_identity_and_help_are_complete(plugin, name):
    found = algorithm(name)
    assert found.create().id() == f"repm:{name}"
    assert type(found.create()) is type(found)
    assert len(found.shortHelpString()) > 400
    assert "<h3>Outputs</h3>" in found.shortHelpString()
    assert found.shortDescription().endswith(".")
    number, title = found.displayName().split(" ", 1)
    assert number.startswith(found.group().split(" ")[0] + ".")
    assert title[0].isupper() and title != found.name()
    assert (ROOT / "resources" / "icons" / f"{name}.svg").samefile(found.svgIconPath())
    assert not found.icon().isNull()
    assert "DSM" in found.tags()
    assert found.group()


def test_the_toolbox_shows_the_order_of_the_work(provider):
    """QGIS sorts groups and names by their words, so these are what it shows, from top to bottom."""
    shown = [entry.name() for entry in sorted(provider.algorithms(), key=lambda a: (a.group(), a.displayName()))]
    work = (
        "environment",
        "sampledata",
        "inspect",
        "pipeline",
        "dsm_by_stages",
        "batch",
        *("comparedsm", "checkgcps", "viewer", "change", "series", "tiles3d"),
        *("editdsm", "dtm", "dsm_to_map", "buildings", "mosaic"),
        "epmfit",
        "errormap",
        "refine",
        "exportcameras",
        "exportrpc",
    )
    work += ("reconstruct", "dsmfuse")
    assert [name for name in shown if name in work] == list(work)
    assert len({entry.displayName().split(" ")[0] for entry in provider.algorithms()}) == len(shown)


@pytest.mark.parametrize("name", PARAMETERS)
def test_every_input_and_output_has_a_tooltip(plugin, name):
    entries = algorithm(name).parameterDefinitions()
    assert not [entry.name() for entry in entries if not entry.help()]


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_dialog_stays_readable(plugin, name):
    advanced = QgsProcessingParameterDefinition.Flag.FlagAdvanced
    inputs = [entry for entry in algorithm(name).parameterDefinitions() if not entry.isDestination()]
    assert len([entry for entry in inputs if not entry.flags() & advanced]) <= 8
    for entry in inputs:
        assert entry.description() and entry.description() != entry.name()


def test_what_is_not_built_is_not_offered(plugin):
    assert algorithm("refine").parameterDefinition("MODEL").options() == ["none", "homography", "polynomial", "terrain"]
    assert algorithm("reconstruct").parameterDefinition("BACKEND").options() == ["auto", "sgm", "colmap"]
    assert algorithm("pipeline").parameterDefinition("MODEL").defaultValue() == "polynomial"


def test_the_model_is_valid_and_of_our_stages(provider):
    model = next(entry for entry in provider.algorithms() if entry.name() == "dsm_by_stages")
    assert model.validate()[0], model.validate()[1]
    stages = {child.algorithmId() for child in model.childAlgorithms().values()}
    assert stages == {f"repm:{name}" for name in ("epmfit", "errormap", "refine", "reconstruct", "dsmfuse")}
    assert model.displayName() == "1.2 Make a DSM stage by stage (model)"
    assert model.groupId() == algorithm("pipeline").groupId()
    assert "dsmfuse:DSM" in [entry.name() for entry in model.parameterDefinitions()]
    assert model.create().parameterDefinition("RESOLUTION").defaultValue() == 0


def test_settings_come_and_go_with_the_provider(plugin):
    from processing.core.ProcessingConfig import ProcessingConfig
    from repm.processing_provider import settings

    assert {settings.ENGINE_PYTHON, settings.WORKERS, settings.MEMORY} <= set(ProcessingConfig.settings)
    settings.unregister()
    assert not {settings.ENGINE_PYTHON, settings.WORKERS, settings.MEMORY} & set(ProcessingConfig.settings)
    assert settings.workers() == 0
    settings.register(plugin.provider.svgIconPath())
    assert settings.ENGINE_PYTHON in ProcessingConfig.settings


def test_outputs_are_of_formats_that_the_engine_writes(provider):
    assert provider.defaultVectorFileExtension() == "gpkg"
    assert provider.defaultRasterFileExtension() == "tif"
    assert provider.supportedOutputVectorLayerExtensions() == ["gpkg"]
    assert not provider.supportsNonFileBasedOutput()


def test_helps_markdown_becomes_html(plugin):
    from repm.processing_provider.helptext import to_html

    assert to_html("One <b> & `two`.\n## Head\n- **a**: x\n  y\n- *b*") == (
        '</p><div style="margin-bottom: 8px">One &lt;b&gt; &amp; <code>two</code>.</div><h3>Head</h3>'
        "<ul><li><strong>a</strong>: x y</li><li><i>b</i></li></ul>"
    )


def test_help_shows_pictures_where_they_pay(plugin):
    from repm.processing_provider.helptext import to_html

    found = {name: re.findall(r'<img src="([^"]*)"', algorithm(name).shortHelpString()) for name in PARAMETERS}
    assert {"pipeline", "errormap", "inspect", "mosaic", "checkgcps"} <= {name for name, each in found.items() if each}
    assert all(os.path.exists(QUrl(each).toLocalFile()) for several in found.values() for each in several)
    assert not [name for name in PARAMETERS if "![" in algorithm(name).shortHelpString()]
    assert "gone" in to_html("![gone](gone.png)") and "<img" not in to_html("![gone](gone.png)")


@pytest.mark.parametrize("name", PARAMETERS)
def test_help_has_no_colours_that_a_dark_theme_hides(plugin, name):
    """QGIS's own style sheet of the help panel makes <p>, <b> and <h2> dark grey, whatever the theme."""
    text = algorithm(name).shortHelpString()
    assert text.startswith("</p>")
    assert not re.search(r"<(p|b|h2)\b", text)


def test_the_engine_imports_itself_relatively_only():
    """In a profile the engine is repm.repm_qgis: an absolute import of itself would not be found there."""
    for path in (ROOT / "repm_qgis").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"^\s*(from|import) repm_qgis", text, re.MULTILINE), path
        assert not re.search(r"^\s*(from|import) (qgis|PyQt)", text, re.MULTILINE), path
