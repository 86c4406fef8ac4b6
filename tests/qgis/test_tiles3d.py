"""3-D Tiles in QGIS: the algorithm, and the tileset as a layer where QGIS has tiled scenes (3.34)."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest
from qgis.core import Qgis, QgsMapRendererParallelJob, QgsMapSettings, QgsRasterLayer
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor


@pytest.mark.long
def test_the_algorithm_writes_a_tileset(load, town, tmp_path, feedback):
    results, _ = load("tiles3d", {"DSM": town.truth, "TILES3D": str(tmp_path / "tiles")}, {})
    assert pathlib.Path(results["TILESET"]) == tmp_path / "tiles" / "tileset.json"
    assert len(list((tmp_path / "tiles" / "tiles").glob("*.glb"))) >= 1
    assert any(text.startswith("3-D Tiles: ") for text in feedback.heard["info"])


def test_a_point_cloud_is_written_too(load, tmp_path, feedback):
    from repm_qgis.solids.point_cloud import created_cloud

    numbers = np.random.default_rng(0)
    with created_cloud(str(tmp_path / "c.laz"), "EPSG:32631", (5e5, 4.8e6, 0.0)) as cloud:
        x, y = numbers.uniform(0, 100, (2, 700))
        cloud.write(5e5 + x, 4.8e6 + y, 50 + x / 10, np.ones(700))
    results, _ = load("tiles3d", {"DSM": str(tmp_path / "c.laz"), "TILES3D": str(tmp_path / "tiles")}, {})
    assert pathlib.Path(results["TILESET"]) == tmp_path / "tiles" / "tileset.json"
    assert "3-D Tiles: 1 tile with 700 points." in feedback.heard["info"]
    with pytest.raises(AssertionError, match="ORTHO"):
        load("tiles3d", {"DSM": str(tmp_path / "c.laz"), "ORTHO": results["TILESET"], "TILES3D": str(tmp_path)}, {})


def test_qgis_draws_the_tileset_where_the_dsm_lies(load, town, tmp_path):
    if Qgis.QGIS_VERSION_INT < 33400:
        pytest.skip(f"QGIS {Qgis.QGIS_VERSION} has no tiled scenes: they came with 3.34")
    from qgis.core import QgsTiledSceneLayer

    results, _ = load("tiles3d", {"DSM": town.truth, "TILES3D": str(tmp_path / "tiles")}, {})
    layer = QgsTiledSceneLayer(results["TILESET"], "tiles", "cesiumtiles")
    assert layer.isValid(), layer.error().message()
    dsm = QgsRasterLayer(town.truth, "dsm")
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
