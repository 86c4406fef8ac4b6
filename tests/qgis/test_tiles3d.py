"""3-D Tiles in QGIS: the algorithm, and the tileset as a layer where QGIS has tiled scenes (3.34)."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest
from qgis.core import Qgis, QgsMapRendererParallelJob, QgsMapSettings, QgsRasterLayer
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor


def test_the_algorithm_writes_a_tileset(load, town, tmp_path, feedback):
    results, _ = load("tiles3d", {"DSM": town["truth"], "TILES3D": str(tmp_path / "tiles")}, {})
    assert pathlib.Path(results["TILESET"]) == tmp_path / "tiles" / "tileset.json"
    assert len(list((tmp_path / "tiles" / "tiles").glob("*.glb"))) >= 1
    assert any(text.startswith("3-D Tiles: ") for text in feedback.heard["info"])


def test_qgis_draws_the_tileset_where_the_dsm_lies(load, town, tmp_path):
    if Qgis.QGIS_VERSION_INT < 33400:
        pytest.skip(f"QGIS {Qgis.QGIS_VERSION} has no tiled scenes: they came with 3.34")
    from qgis.core import QgsTiledSceneLayer

    results, _ = load("tiles3d", {"DSM": town["truth"], "TILES3D": str(tmp_path / "tiles")}, {})
    layer = QgsTiledSceneLayer(results["TILESET"], "tiles", "cesiumtiles")
    assert layer.isValid(), layer.error().message()
    dsm = QgsRasterLayer(town["truth"], "dsm")
    settings = QgsMapSettings()
    settings.setDestinationCrs(dsm.crs())
    settings.setExtent(dsm.extent())
    settings.setOutputSize(QSize(200, 200))
    settings.setBackgroundColor(QColor(255, 0, 255))
    settings.setLayers([layer])
    job = QgsMapRendererParallelJob(settings)
    job.start()
    job.waitForFinished()
    image = job.renderedImage()
    pixels = np.array([[image.pixelColor(x, y).getRgb()[:3] for x in range(0, 200, 4)] for y in range(0, 200, 4)])
    background = (pixels == (255, 0, 255)).all(axis=2)
    assert background.mean() < 0.05, "the tileset covers the DSM"
    assert pixels[~background].std() > 10, "its pictures are the hillshade"
