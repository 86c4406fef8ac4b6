"""The cloud of a finished DSM: what the DSM refuted is gone, walls stay, and each point is there once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.options import DsmFuseOptions
from repm_qgis.fusion.finished import FinishedSurface
from repm_qgis.fusion.layout import DsmLayout
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.scene import Scene
from repm_qgis.solids.cloud import gathered_points
from repm_qgis.stages import run_stage
from tests.engine.rasters import bands


@pytest.fixture
def gathered(urban_run, tmp_path, told):
    """A function that gathers the points on a DSM: (N, 4) x, y, height, score."""
    scene = Scene.load(urban_run.result.scene)

    def made(dsm, crs=scene.crs, tiles=scene.tiles):
        datum = HeightDatum.of("")
        layout = DsmLayout.of(scene, tiles, crs, datum, 0.5)
        options = DsmFuseOptions(scene=str(scene.path), output=dsm, cloud=str(tmp_path / "c.laz"), workers=1)
        part, surface = replace(scene, tiles=tiles), FinishedSurface.of(dsm, crs, datum)
        found = gathered_points(part, surface, layout, options=options, folder=str(tmp_path), progress=told())
        return np.concatenate([points for tile in found for points in tile])

    return made


def places(points, dsm):
    """Rows and columns of the points in a DSM."""
    x, cell, _, y, _, down = gdal.Open(dsm).GetGeoTransform()
    return ((points[:, 1] - y) // down).astype(int), ((points[:, 0] - x) // cell).astype(int)


def test_the_points_lie_on_the_written_dsm_or_on_its_walls(urban_run, gathered):
    dsm = urban_run.options["output"]
    points, height = gathered(dsm), bands(dsm)[0][0]
    assert len(points) == urban_run.result.points
    off = np.abs(points[:, 2] - height[places(points, dsm)])
    scene = Scene.load(urban_run.result.scene)
    px = max(record.metres_per_px for tile in scene.tiles for record in tile.heights)
    assert 0.8 < (off < px).mean() < 1.0  # the others lie on walls


def test_roofs_that_the_dsm_cut_are_gone_and_walls_stay(urban_run, gathered, tmp_path):
    dsm, cut = urban_run.options["output"], str(tmp_path / "cut.tif")
    gdal.Translate(cut, dsm, format="GTiff")
    dataset = gdal.Open(cut, gdal.GA_Update)
    height = dataset.ReadAsArray()
    known = height > -9000
    ground = np.percentile(height[known], 10)
    half = np.zeros(height.shape, bool)
    half[:, : height.shape[1] // 2] = True
    high = known & (height > ground + 8.0)
    height[high & half] = ground
    dataset.GetRasterBand(1).WriteArray(height)
    del dataset
    before, after = gathered(dsm), gathered(cut)

    def counted(points, cells):
        there = cells[places(points, cut)] & (points[:, 2] > ground + 8.0)
        return int(there.sum())

    inside = np.zeros(height.shape, bool)  # roofs far from the middle, where the cut half meets roofs that stay
    inside[:, : height.shape[1] // 2 - 3] = True
    assert counted(before, high & inside) > 1000
    assert counted(after, high & inside) < 0.001 * counted(before, high & inside)
    east = ~half
    east[:, : height.shape[1] // 2 + 3] = False
    assert counted(after, east) == counted(before, east)  # with the walls of roofs that stay
    off = np.abs(after[:, 2] - height[places(after, cut)])
    assert ((off > 2.0) & east[places(after, cut)]).sum() > 100


@pytest.mark.long
def test_in_another_crs_each_point_is_there_once(urban_run, gathered, tmp_path, told):
    """Tiles are turned there, and their windows overlap."""
    scene = Scene.load(urban_run.result.scene)
    zone = int(scene.crs.split(":")[1])
    crs = f"EPSG:{zone + 1 if zone % 100 < 60 else zone - 1}"
    turned = str(tmp_path / "turned.tif")
    run_stage("dsmfuse", {"scene": urban_run.result.scene, "output": turned, "crs": crs, "resolution": 0.5}, told())
    points = gathered(turned, crs)
    assert len(np.unique(points, axis=0)) == len(points)
    assert len(scene.tiles) == 4 and abs(len(points) / urban_run.result.points - 1) < 0.02
