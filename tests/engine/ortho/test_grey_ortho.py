"""The orthophoto in greys is that of the finished DSM, whatever its heights were before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Window
from repm_qgis.contracts.options import DsmFuseOptions
from repm_qgis.fusion.finished import FinishedSurface
from repm_qgis.fusion.visible import nadir_first, orthophoto
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.ortho.grey_ortho import make_grey_ortho
from repm_qgis.ortho.parameters import ORTHO
from repm_qgis.scene import Scene
from tests.engine.rasters import bands


@pytest.fixture
def painted(urban_run, tmp_path, told):
    """A function that makes the orthophoto of a DSM: its values, NaN where there are none, and the surface."""
    scene = Scene.load(urban_run.result.scene)

    def made(dsm, workers=1, parameters=ORTHO):
        surface, path = FinishedSurface.of(dsm, scene.crs, HeightDatum.of("")), str(tmp_path / "ortho.tif")
        options = DsmFuseOptions(scene=str(scene.path), output=dsm, workers=workers)
        make_grey_ortho(
            nadir_first(scene),
            surface,
            options,
            path=path,
            folder=str(tmp_path),
            progress=told(),
            parameters=parameters,
        )
        return bands(path)[0][0], surface

    return made


@pytest.fixture
def mended(urban_run, tmp_path):
    """A DSM in whose middle a tower of 30 m was mended into the town's heights, and the tower's rows and columns."""
    path = str(tmp_path / "mended.tif")
    gdal.Translate(path, urban_run.options["output"], format="GTiff")
    dataset = gdal.Open(path, gdal.GA_Update)
    height = dataset.ReadAsArray()
    row, column = height.shape[0] // 2, height.shape[1] // 2
    tower = slice(row, row + 20), slice(column, column + 20)
    height[tower] = np.median(height[height > -9000]) + 30.0
    dataset.GetRasterBand(1).WriteArray(height)
    del dataset
    return path, tower


def test_the_run_made_that_of_its_dsm(urban_run, painted):
    found, _ = painted(urban_run.options["output"])
    np.testing.assert_array_equal(found, bands(urban_run.options["ortho"])[0][0])


def test_what_changed_in_the_dsm_changes_the_orthophoto(urban_run, painted, mended):
    dsm, tower = mended
    before, _ = painted(urban_run.options["output"])
    found, surface = painted(dsm)
    scene = Scene.load(urban_run.result.scene)
    grid = surface.grid
    whole = orthophoto(nadir_first(scene), grid, surface.heights(Window(0, 0, *grid.size)), scene.crs)
    np.testing.assert_allclose(found[tower], whole[tower], atol=2.0)
    assert (np.abs(found - before)[tower] > 1.0).mean() > 0.5
    assert np.isfinite(found[tower]).mean() > 0.9


@pytest.mark.parametrize("workers", (1, 2))
@pytest.mark.long
def test_a_tower_hides_ground_in_other_blocks(painted, mended, workers):
    """Blocks of 40 cells, in which a tower of 30 m hides what lies in the next ones."""
    whole, _ = painted(mended[0])
    found, _ = painted(mended[0], workers, replace(ORTHO, block_cells=40))
    assert (np.isnan(found) == np.isnan(whole)).mean() > 0.99
    both = np.isfinite(found) & np.isfinite(whole)
    assert (np.abs(found - whole)[both] < 2.0).mean() > 0.99
