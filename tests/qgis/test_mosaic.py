"""repm:mosaic from the command line, as a user of QGIS would run it."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from qgis.core import QgsApplication, QgsPointXY, QgsRasterLayer


@pytest.fixture(scope="module")
def dsms(tmp_path_factory):
    from repm_qgis.imagery import raster

    folder, rows_columns = tmp_path_factory.mktemp("dsms"), np.indices((80, 80))
    found = []
    for number, (start, offset) in enumerate(((0, 0.0), (50, 2.0))):
        heights = (100 + 0.1 * (rows_columns[1] + start) + offset).astype(np.float32)
        place = (500000.0 + start, 1.0, 0.0, 4800000.0, 0.0, -1.0)
        found.append(raster.write(str(folder / f"{number}.tif"), [heights], place, "EPSG:32631", unit="m"))
    return found


@pytest.mark.long
def test_two_dsms_become_one(headless, dsms, tmp_path):
    out = {name: str(tmp_path / f"{name.lower()}.tif") for name in ("OUTPUT", "SOURCES")}
    given = [*(f"DSMS={path}" for path in dsms), f"FIXED={dsms[0]}", *(f"{n}={p}" for n, p in out.items())]
    given.append(f"REPORT={tmp_path / 'report.html'}")
    done = headless("--json", "run", "repm:mosaic", "--", *given, REPM_ENGINE_PYTHON=sys.executable)
    assert done.returncode == 0, done.stderr + done.stdout
    results = json.loads(done.stdout)["results"]
    assert results["VALID_PERCENT"] == 100 and results["SEAM"] < 0.02
    from repm_qgis.imagery import raster

    with raster.opened(out["OUTPUT"]) as dataset:
        heights = raster.read(dataset)
    assert heights == pytest.approx(np.broadcast_to(100 + 0.1 * np.arange(130), (80, 130)), abs=1e-3)
    assert (tmp_path / "output.qml").exists() and (tmp_path / "sources.qml").exists()


@pytest.mark.long
def test_a_vrt_with_tiles_beside_it(headless, dsms, tmp_path):
    """QGIS takes the name in commands and dialogs, and the VRT as a layer; other algorithms write no VRT."""
    given = [*(f"DSMS={path}" for path in dsms), f"OUTPUT={tmp_path / 'm.vrt'}"]
    done = headless("--json", "run", "repm:mosaic", "--", *given, REPM_ENGINE_PYTHON=sys.executable)
    assert done.returncode == 0, done.stderr + done.stdout
    assert json.loads(done.stdout)["results"]["OUTPUT"] == str(tmp_path / "m.vrt")
    layer = QgsRasterLayer(str(tmp_path / "m.vrt"), "m", "gdal")
    assert layer.isValid() and (layer.width(), layer.height()) == (130, 80)
    assert layer.dataProvider().sample(QgsPointXY(500000.5, 4799999.5), 1)[0] == pytest.approx(101, abs=0.01)
    assert {path.name for path in tmp_path.iterdir()} >= {"m.vrt", "m.qml", "m_tiles"}


def test_the_dialog_takes_a_vrt_for_mosaics_alone(plugin, context, tmp_path):
    registry = QgsApplication.processingRegistry()
    for name, taken in (("mosaic", True), ("dsmfuse", False)):
        output = registry.algorithmById(f"repm:{name}").parameterDefinition("OUTPUT")
        assert output.isSupportedOutputValue(str(tmp_path / "m.vrt"), context)[0] is taken
        assert output.isSupportedOutputValue(str(tmp_path / "m.tif"), context)[0]
        assert not output.isSupportedOutputValue(str(tmp_path / "m.png"), context)[0]
        assert ("(*.vrt)" in output.createFileFilter()) is taken


def test_bad_input_is_one_sentence_before_the_run(plugin, dsms, context, tmp_path):
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:mosaic")
    scene = str(tmp_path / "scene.json")
    open(scene, "w").close()
    for given, words in (
        ({"DSMS": dsms[:1]}, "must name at least two DSMs"),
        ({"DSMS": [dsms[0], str(tmp_path / "gone.tif")]}, "gone.tif' is not there"),
        ({"DSMS": dsms, "CONFIDENCES": [str(tmp_path / "gone.tif")]}, "gone.tif' is not there"),
        ({"DSMS": [*dsms, dsms[0]]}, "is named twice"),
        ({"DSMS": dsms, "SCENES": [str(tmp_path / "gone.json")]}, "gone.json' is not there"),
        ({"DSMS": dsms, "FIXED": [str(tmp_path / "gone.json")]}, "gone.json' is not there"),
        ({"DSMS": dsms, "FIXED": [scene]}, "it must be one of DSMS or SCENES"),
    ):
        fine, text = algorithm.create().checkParameterValues({**given, "OUTPUT": str(tmp_path / "m.tif")}, context)
        assert not fine and words in text, text
