"""A new user's mistakes: each gives one sentence with the value and the remedy, exit code 1, and nothing half done.

The engine's own checks are tested in tests/engine; here it is what qgis_process and the dialog make of them.
"""

from __future__ import annotations

import json
import pathlib
import shutil
import subprocess
import sys

import pytest
from osgeo import gdal
from qgis.core import QgsApplication, QgsProcessingContext, QgsProcessingException, QgsProject


@pytest.fixture(scope="module")
def bad(sample, tmp_path_factory):
    """Second images, each spoilt in one way, by name."""
    folder = tmp_path_factory.mktemp("bad")
    pixels = gdal.OpenEx(sample.images[1]).ReadAsArray()
    plain = gdal.GetDriverByName("GTiff").Create(str(folder / "norpc.tif"), *pixels.shape[::-1], 1, gdal.GDT_UInt16)
    plain.GetRasterBand(1).WriteArray(pixels)
    plain = None  # noqa: F841
    (folder / "cut.tif").write_bytes(pathlib.Path(sample.images[1]).read_bytes()[:30000])
    (folder / "text.tif").write_text("no image at all")
    return {name: str(folder / f"{name.replace(' ', '')}.tif") for name in SENTENCES}


# One of each kind of error: tests/engine/stages/test_bad_input.py has them all.
SENTENCES = {
    "no rpc": ("No RPC found for", "norpc.tif'", "Looked in:", "Put the vendor's RPC file"),
    "cut": ("cut.tif'", "damaged or cut short", "get it again"),
    "text": ("text.tif'", "not recognized as", "supported file format", "Check the path"),  # GDAL 3.10: "as being in a"
    "gone": ("gone.tif'", "does not exist", "Check the path"),
}


def message_of(name, parameters, feedback):
    """The sentence that a run ends with, as the dialog's log shows it."""
    algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}").create()
    context = QgsProcessingContext()
    fine, text = algorithm.checkParameterValues(parameters, context)
    if not fine:
        return text
    with pytest.raises(QgsProcessingException) as caught:
        algorithm.run(parameters, context, feedback, catchExceptions=False)
    return str(caught.value)


def one_sentence(text, *words):
    assert "Traceback" not in text and "\n" not in text.strip(), text
    for word in words:
        assert word in text, text


@pytest.mark.parametrize("fault", SENTENCES)
@pytest.mark.long
def test_a_bad_image_is_one_sentence_and_leaves_nothing(plugin, feedback, sample, bad, tmp_path, fault):
    workspace = tmp_path / "w"
    text = message_of(
        "epmfit",
        {
            "IMAGES": [sample.images[0], bad[fault]],
            "WORKSPACE": str(workspace),
            "TILES": str(tmp_path / "t.gpkg"),
            "REPORT": str(tmp_path / "r.html"),
        },
        feedback,
    )
    one_sentence(text, *SENTENCES[fault])
    assert [path.name for path in tmp_path.rglob("*")] in ([], ["w"])


@pytest.mark.parametrize(
    ("values", "words"),
    (
        ({"RESOLUTION": 0.01}, ("RESOLUTION is 0.01", "at least 0.1", "ground sampling distance")),
        ({"RESOLUTION": 900}, ("RESOLUTION is 900", "must be at most", "cells a side")),
        ({"OUTLIER_RADIUS": 500}, ("OUTLIER_RADIUS is 500", "must be at most", "30 cells of the DSM")),
        ({"VERTICAL_DATUM": "sea level"}, ("VERTICAL_DATUM is 'sea level'", "EGM96")),
    ),
)
@pytest.mark.long
def test_an_absurd_request_is_refused_in_the_dialog(plugin, context, sample, tmp_path, values, words):
    """Before the run begins, and for a scene that was fitted earlier too."""
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    registry = QgsApplication.processingRegistry()
    fit = {"images": sample.images[:2], "workspace": str(tmp_path / "fit")}
    inputs = {
        "pipeline": {"IMAGES": sample.images[:2], "WORKSPACE": str(tmp_path / "w")},
        "dsmfuse": {"SCENE": run_stage("epmfit", fit, Silent()).scene},
    }
    for name, given in inputs.items():
        given = {**given, "OUTPUT": str(tmp_path / "dsm.tif"), **values}
        fine, text = registry.algorithmById(f"repm:{name}").create().checkParameterValues(given, context)
        assert not fine
        one_sentence(text, *words)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"EXTENT": "0,1,0,1 [EPSG:4326]"}, ("EXTENT x 0.00000 to 1.00000", "EPSG:4326", "x 1.43", "Draw it there")),
        ({"CRS": "EPSG:4326"}, ("CRS is 'EPSG:4326'", "must be a projected CRS")),
        ({"ORDER": "2.5"}, ("ORDER is '2.5'", "a whole number")),
        ({"RESOLUTION": "fine"}, ("RESOLUTION is 'fine'", "must be a number")),
        ({"DEM": "gone.tif"}, ("DEM 'gone.tif' is not there",)),
        ({"OUTPUT": "/proc/none/dsm.tif"}, ("folder '/proc/none'", "choose another one")),  # before the matching
    ],
)
@pytest.mark.slow
def test_a_wrong_value_is_one_sentence(plugin, feedback, sample, tmp_path, values, words):
    given = {
        "IMAGES": sample.images[:2],
        "WORKSPACE": str(tmp_path / "w"),
        "OUTPUT": str(tmp_path / "dsm.tif"),
        "TILES": str(tmp_path / "t.gpkg"),
        "TIE_POINTS": str(tmp_path / "p.gpkg"),
        **values,
    }
    one_sentence(message_of("pipeline", given, feedback), *words)
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".tif", ".json", ".html", ".gpkg")]


@pytest.fixture(scope="module")
def scene(plugin, ears, sample, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:epmfit")
    results, fine = algorithm.run({"IMAGES": sample.images, "WORKSPACE": str(folder)}, QgsProcessingContext(), ears())
    assert fine
    return results["SCENE"]


@pytest.mark.slow
def test_a_scene_that_will_not_do_is_one_sentence(plugin, feedback, scene, sample, tmp_path):
    out = str(tmp_path / "o.tif")
    one_sentence(
        message_of("dsmfuse", {"SCENE": scene, "OUTPUT": out}, feedback),
        scene,
        "has no height maps",
        "Reconstruct heights",
    )
    one_sentence(message_of("dsmfuse", {"SCENE": sample.images[0], "OUTPUT": out}, feedback), "is not a scene")
    one_sentence(
        message_of("refine", {"SCENE": scene, "MODEL": "terrain", "OUTPUT_SCENE": str(tmp_path / "s.json")}, feedback),
        "MODEL is 'terrain'",
        "give a DEM",
    )
    one_sentence(
        message_of("errormap", {"SCENE": scene, "VIEW": "nobody", "OUTPUT": out}, feedback),
        "'nobody'",
        "img_01, img_02, img_03",
    )
    newer = tmp_path / "newer.json"
    document = json.loads(pathlib.Path(scene).read_text(encoding="utf-8"))
    newer.write_text(json.dumps({**document, "schema": 99}))
    for name in ("errormap", "dsmfuse"):
        one_sentence(
            message_of(name, {"SCENE": str(newer), "OUTPUT": out}, feedback),
            str(newer),
            "schema 99",
            "update the plugin",
        )
    newer.write_text("{ not json")
    one_sentence(message_of("errormap", {"SCENE": str(newer), "OUTPUT": out}, feedback), str(newer), "not a JSON file")
    assert not (tmp_path / "o.tif").exists()


def test_dialogs_name_fields_and_layers_in_their_own_words(plugin, context, feedback, monkeypatch, tmp_path):
    """Commands keep the names that they are given."""
    from qgis.core import QgsProcessingUtils, QgsVectorLayer
    from repm.processing_provider import language

    project = QgsProject.instance()
    hidden = QgsProcessingUtils.generateTempFilename("0123456789abcdef.tif")
    layer = QgsVectorLayer(hidden, "Lidar of the north", "ogr")
    project.addMapLayer(layer)
    try:
        algorithm = QgsApplication.processingRegistry().algorithmById("repm:comparedsm").create()
        missing = {"DSM": None, "REFERENCE": str(tmp_path / "gone.tif"), "OTHERS": [], "ALIGN": "none"}
        plain = algorithm.checkParameterValues(missing, context)[1]
        assert plain.startswith("REFERENCE '") and "gone.tif" in plain
        monkeypatch.setattr(language, "is_desktop", lambda: True)
        assert algorithm.checkParameterValues(missing, context)[1] == plain.replace(
            "REFERENCE ", "‘Reference (DSM or point cloud)’ ", 1
        )
        words = language.dialog_words("comparedsm")
        assert words(f"'{hidden}' has no heights") == "'Lidar of the north' has no heights"
        assert words("ALIGN is 'none': it must be 3d.").startswith(
            "‘Alignment before the comparison’ is ‘None’: it must"
        )
        assert words("DSM is empty: it must be given.") == "‘DSM or point cloud to measure’ is empty: it must be given."
    finally:
        project.removeMapLayer(layer.id())


@pytest.mark.long
def test_a_slip_in_a_parameters_name_is_told(plugin, feedback, sample, tmp_path):
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:epmfit")
    _, fine = algorithm.run(
        {"IMAGES": sample.images, "WORKSPACE": str(tmp_path), "ERROR_BUGDET": 1}, QgsProcessingContext(), feedback
    )
    assert fine
    assert feedback.heard["warning"] == [
        "ERROR_BUGDET is not a parameter of repm:epmfit and has no effect: do you mean ERROR_BUDGET?"
    ]


@pytest.mark.long
def test_qgis_process_ends_with_code_1(headless, sample, bad, tmp_path):
    files = (f"IMAGES={sample.images[0]}", f"IMAGES={bad['cut']}", f"WORKSPACE={tmp_path / 'w'}")
    output = f"OUTPUT={tmp_path / 'dsm.tif'}"
    done = headless("run", "repm:pipeline", "--", *files, output, REPM_ENGINE_PYTHON=sys.executable)
    said = done.stdout + done.stderr
    assert done.returncode == 1
    assert "Traceback" not in said
    assert all(word in said for word in SENTENCES["cut"]), said
    assert not (tmp_path / "dsm.tif").exists()


@pytest.mark.long
def test_a_missing_wheel_is_one_sentence_with_the_remedy(headless, sample, tmp_path):
    own = shutil.which("python3", path="/usr/bin")  # QGIS's Python, without the wheels
    probe = subprocess.run([own or "false", "-c", "import cv2"], capture_output=True, check=False)
    if own is None or probe.returncode == 0:
        pytest.skip("QGIS's own Python has OpenCV here")
    done = headless(
        "run",
        "repm:pipeline",
        "--",
        *(f"IMAGES={path}" for path in sample.images),
        f"WORKSPACE={tmp_path / 'w'}",
        f"OUTPUT={tmp_path / 'dsm.tif'}",
        REPM_ENGINE_PYTHON=own,
    )
    said = done.stdout + done.stderr
    assert done.returncode == 1
    assert "The Python package 'cv2' is not installed" in said and "Install the engine's packages" in said, said
    assert "Traceback" not in said


@pytest.mark.long
def test_nothing_is_written_beside_inputs(plugin, feedback, sample, tmp_path):
    for name in ("dsm.tif", "reference.tif"):
        shutil.copy(sample.truth, tmp_path / name)
    dataset = gdal.Open(str(tmp_path / "dsm.tif"), gdal.GA_Update)
    dataset.GetRasterBand(1).SetOffset(0.25)  # else it would be a copy of its reference
    dataset = None  # noqa: F841
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:comparedsm")
    _, fine = algorithm.run(
        {"DSM": str(tmp_path / "dsm.tif"), "REFERENCE": str(tmp_path / "reference.tif")},
        QgsProcessingContext(),
        feedback,
    )
    assert fine
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dsm.tif", "reference.tif"]
