"""EPT and PLY as QGIS reads them: points counted, place, CRS, what is drawn; triangles and heights of a mesh."""

from __future__ import annotations

import json

import numpy as np
import pytest
from qgis.core import QgsMesh, QgsMeshLayer, QgsPointCloudLayer, QgsRectangle

from tests.qgis.drawing import drawn

UTM = "EPSG:32631"
WEST, NORTH = 654321.0, 4812345.0


def crs_of(vertical):
    from repm_qgis.geometry.vertical import HeightDatum

    return HeightDatum.of(vertical).file_crs(UTM)


@pytest.fixture(params=["", "EGM96"])
def ept(request, tmp_path):
    """A slope that rises to the east, as EPT of several levels: folder and points."""
    from repm_qgis.solids.ept import write_ept
    from repm_qgis.solids.parameters import EptParameters
    from repm_qgis.solids.point_cloud import created_cloud

    numbers = np.random.default_rng(0)
    x, y = WEST + numbers.uniform(0, 200, 60000), NORTH - numbers.uniform(0, 100, 60000)
    z = 100 + (x - WEST) / 2
    with created_cloud(str(tmp_path / "c.laz"), crs_of(request.param), (WEST, NORTH, 0)) as cloud:
        cloud.write(x, y, z, np.ones(len(x)))
    files = str(tmp_path / "c.laz"), str(tmp_path / "e")
    facts = write_ept(*files, crs_of(request.param), parameters=EptParameters(leaf=3000))
    assert facts.nodes > 10
    return tmp_path / "e", np.column_stack([x, y, z])


def test_an_ept_opens_with_all_its_points_in_their_place(plugin, ept):
    folder, points = ept
    layer = QgsPointCloudLayer(str(folder / "ept.json"), "cloud", "ept")
    assert layer.isValid() and layer.pointCount() == len(points)
    assert layer.crs().isValid() and "UTM zone 31N" in layer.crs().description()
    if "vertical" not in json.loads((folder / "ept.json").read_text())["srs"]:
        assert layer.crs().authid() == UTM
    box = layer.extent()
    np.testing.assert_allclose(
        [box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum()],
        [*points[:, :2].min(axis=0), *points[:, :2].max(axis=0)],
        atol=0.001,
    )


def test_an_ept_is_drawn_where_its_points_are_and_coloured_by_height(plugin, ept):
    from repm_qgis.reports.styles import write_style

    folder, points = ept
    style = write_style("ept", str(folder / "ept.json"), (100.0, 200.0))
    layer = QgsPointCloudLayer(str(folder / "ept.json"), "cloud", "ept")
    assert layer.loadNamedStyle(style)[1]
    pixels = drawn(layer, QgsRectangle(WEST - 100, NORTH - 100, WEST + 200, NORTH), (300, 100))
    assert (pixels[:, :95] == 255).all()  # nothing west of the points
    land = pixels[5:95, 105:295]
    assert (land == 255).all(axis=2).mean() < 0.02
    west, east = land[:, :20].reshape(-1, 3).mean(axis=0), land[:, -20:].reshape(-1, 3).mean(axis=0)
    assert (east - west > 40).any()  # not of one colour: dark green below, bright above


@pytest.mark.parametrize("vertical", ("", "EGM96"))
def test_a_mesh_opens_with_its_triangles_and_heights(plugin, tmp_path, vertical):
    from repm_qgis.imagery.raster import write
    from repm_qgis.solids.mesh import write_mesh

    heights = np.random.default_rng(0).uniform(100, 130, (20, 30)).astype(np.float32)
    heights[5:9, 10:12] = np.nan
    dsm = write(str(tmp_path / "d.tif"), [heights], (WEST, 0.5, 0, NORTH, 0, -0.5), crs_of(vertical))
    facts = write_mesh(dsm, str(tmp_path / "m.ply"))
    layer = QgsMeshLayer(str(tmp_path / "m.ply"), "mesh", "mdal")
    assert layer.isValid() and layer.crs().isValid() and "UTM zone 31N" in layer.crs().description()
    assert vertical or layer.crs().authid() == UTM
    provider = layer.dataProvider()
    assert (provider.vertexCount(), provider.faceCount()) == (facts.vertices, facts.faces)
    read = QgsMesh()
    provider.populateMesh(read)
    known = np.isfinite(heights)
    assert [read.vertex(i).z() for i in range(read.vertexCount())] == heights[known].astype(float).tolist()
    rows, columns = np.nonzero(known)
    places = [(read.vertex(i).x(), read.vertex(i).y()) for i in range(read.vertexCount())]
    np.testing.assert_allclose(places, np.column_stack([WEST + 0.25 + columns / 2, NORTH - 0.25 - rows / 2]), atol=1e-6)
    assert all(len(read.face(i)) == 3 for i in range(read.faceCount()))
