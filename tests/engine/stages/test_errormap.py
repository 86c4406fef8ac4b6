"""The error map against the error computed here, cell by cell, with PROJ and GDAL."""

from __future__ import annotations

import os

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.geometry.frames import EnuFrame, geodetic_from_projected
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage


@pytest.fixture(scope="module")
def scene(mountains, tmp_path_factory, told):
    """The mountains' cameras, over 600 m of altitude so that there is an error to see."""
    folder = tmp_path_factory.mktemp("map")
    return run_stage(
        "epmfit",
        {
            "images": mountains.images[:2],
            "workspace": str(folder),
            "altitude_min": 800.0,
            "altitude_max": 1400.0,
            "tile_size": 300,
        },
        told(),
    ).scene


@pytest.mark.parametrize("refined", (False, True))
@pytest.mark.parametrize("altitude", (850.0, None, 1390.0))
@pytest.mark.long
def test_cells_hold_pinhole_minus_rpc(scene, tmp_path, told, refined, altitude):
    path = scene
    if refined:
        path = run_stage(
            "refine", {"scene": scene, "output_scene": str(tmp_path / "refined.json"), "write_images": False}, told()
        ).output_scene
    output = str(tmp_path / "error.tif")
    result = run_stage("errormap", {"scene": path, "output": output, "view": "img_02", "altitude": altitude}, told())
    loaded = Scene.load(path)
    view = loaded.view("img_02")
    dataset = gdal.Open(output)
    magnitude, column, row, worst = bands = dataset.ReadAsArray().astype(float)
    transform = dataset.GetGeoTransform()
    assert dataset.GetSpatialRef().GetAuthorityCode(None) == loaded.crs.split(":")[1]
    dataset = None
    known = magnitude > -9000
    rows, cols = np.nonzero(known)
    pick = np.random.default_rng(0).permutation(len(rows))[:400]
    rows, cols = rows[pick], cols[pick]
    x, y = transform[0] + (cols + 0.5) * transform[1], transform[3] + (rows + 0.5) * transform[5]
    z = 1100.0 if altitude is None else altitude
    ground = np.column_stack([geodetic_from_projected(loaded.crs, np.column_stack([x, y])), np.full(len(x), z)])
    memory = gdal.GetDriverByName("MEM").Create("", 10, 10, 1)
    memory.SetMetadata(rpc_tags(view.rpc), "RPC")
    transformer = gdal.Transformer(memory, None, ["METHOD=RPC"])
    pixels = np.array(transformer.TransformPoints(1, ground.tolist())[0])[:, :2] - 0.5
    transformer = memory = None
    enu = EnuFrame(loaded.frame.lon, loaded.frame.lat, loaded.frame.height).from_geodetic(ground)
    expected = np.full((len(x), 2), np.nan)
    for tile in loaded.tiles:
        x0, y0, x1, y1 = tile.bounds
        mine = (x >= x0) & (x < x1) & (y > y0) & (y <= y1)
        fitted = tile.views["img_02"]
        seen = (
            fitted.refined.to_original.original_from_refined(fitted.refined.camera.project(enu[mine]))
            if refined
            else fitted.camera.project(enu[mine])
        )
        expected[mine] = seen - pixels[mine]
    found = np.column_stack([column[rows, cols], row[rows, cols]])
    assert np.nanmax(np.abs(found - expected)) < 2e-3 and np.isfinite(expected).all()
    np.testing.assert_allclose(magnitude[rows, cols], np.hypot(*found.T), atol=1e-5)
    assert (worst[known] >= magnitude[known] - 1e-5).all()
    assert result.rmse == pytest.approx(np.sqrt((magnitude[known] ** 2).mean()), rel=1e-4)
    assert result.max_error == pytest.approx(magnitude[known].max(), rel=1e-4)
    assert os.path.exists(str(tmp_path / "error.qml")) and bands.shape[0] == 4


def test_refinement_makes_the_map_fainter(scene, tmp_path, told):
    refined = run_stage(
        "refine", {"scene": scene, "output_scene": str(tmp_path / "refined.json"), "write_images": False}, told()
    ).output_scene
    rmse = [
        run_stage("errormap", {"scene": path, "output": str(tmp_path / f"{i}.tif")}, told()).rmse
        for i, path in enumerate((scene, refined))
    ]
    assert rmse[1] <= rmse[0] * 1.001
