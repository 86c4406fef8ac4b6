"""The STAC item beside a DSM, against what the core specification and its extensions ask for."""

import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import OptionError
from repm_qgis.contracts.options import DsmFuseOptions
from repm_qgis.exports.stac import write_item
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage

pytestmark = pytest.mark.long

TIMES = ("2013-04-17T10:37:19.100Z", "2013-04-17T10:37:45.300Z", "2013-04-17T10:38:11Z")


@pytest.fixture
def timed(urban_run):
    scene = Scene.load(urban_run.result.scene)
    views = (replace(view, acquired=time, sensor="Pleiades 1A") for view, time in zip(scene.views, TIMES))
    return replace(scene, views=tuple(views))


def item_of(path):
    return json.loads(Path(path).read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_item_has_what_stac_asks_for(urban_run, timed, tmp_path):
    files = {name: getattr(urban_run.result, name) for name in ("output", "confidence", "ortho", "cloud")}
    for name, file in files.items():
        files[name] = shutil.copy(file, tmp_path / f"{name}{Path(file).suffix}")
    gdal.Translate(str(files["ortho"]), urban_run.result.ortho, widthPct=200, heightPct=200)  # finer than the DSM
    products = {name: (name.title(), str(file)) for name, file in files.items()}
    products["mesh"] = ("Mesh", str(tmp_path / "not there.glb"))
    item = item_of(write_item(str(tmp_path / "sub.json"), timed, products))
    assert (item["type"], item["stac_version"], item["id"], item["links"]) == ("Feature", "1.0.0", "output", [])
    facts = item["properties"]
    assert facts["datetime"] is None
    assert (facts["start_datetime"], facts["end_datetime"]) == (TIMES[0], TIMES[2])
    assert facts["platform"] == "pleiades 1a" and facts["processing:software"]["REPM"]
    for name in ("projection", "raster", "processing"):
        assert f"https://stac-extensions.github.io/{name}/v1.1.0/schema.json" in item["stac_extensions"]

    dataset = gdal.Open(str(files["output"]))
    x, cell, _, y, _, down = dataset.GetGeoTransform()
    columns, rows = dataset.RasterXSize, dataset.RasterYSize
    assert facts["proj:shape"] == [rows, columns] and facts["proj:epsg"] == 32631
    assert facts["proj:transform"] == [cell, 0.0, x, 0.0, down, y]
    assert facts["proj:bbox"] == [x, y + rows * down, x + columns * cell, y]
    ring = np.array(item["geometry"]["coordinates"][0])
    area = (ring[:-1, 0] * ring[1:, 1] - ring[1:, 0] * ring[:-1, 1]).sum()
    assert (ring[0] == ring[-1]).all() and area > 0, "against the clock, as GeoJSON asks"
    assert item["bbox"] == [*ring.min(axis=0), *ring.max(axis=0)]
    assert 1.4 < item["bbox"][0] < item["bbox"][2] < 1.5 and 43.5 < item["bbox"][1] < item["bbox"][3] < 43.7

    assets = item["assets"]
    assert list(assets) == ["output", "confidence", "ortho", "cloud"], "what is not there is left out"
    assert all((tmp_path / asset["href"]).exists() and asset["href"].startswith("./") for asset in assets.values())
    band = assets["output"]["raster:bands"][0]
    heights = dataset.ReadAsArray()
    known = heights[heights != band["nodata"]]
    assert band["data_type"] == "float32" and band["unit"] == "m" and band["spatial_resolution"] == cell
    assert band["statistics"]["minimum"] == pytest.approx(known.min(), abs=1e-3)
    assert band["statistics"]["mean"] == pytest.approx(known.mean(), abs=1e-3)
    assert len(assets["confidence"]["raster:bands"]) == 6
    assert assets["output"]["type"].endswith("profile=cloud-optimized")
    assert assets["cloud"]["type"] == "application/vnd.laszip" and assets["ortho"]["roles"] == ["visual"]
    assert assets["ortho"]["proj:shape"] == [2 * rows, 2 * columns]
    assert assets["ortho"]["proj:transform"] == [cell / 2, 0.0, x, 0.0, down / 2, y]
    assert "proj:bbox" not in assets["ortho"] and "proj:shape" not in assets["confidence"], "those of the item"
    assert not re.search(r'"/|[A-Z]:\\\\', Path(tmp_path / "sub.json").read_text()), "no path of this machine"


def test_one_time_is_the_items_time(urban_run, timed, tmp_path):
    scene = replace(timed, views=tuple(replace(view, acquired=TIMES[0]) for view in timed.views))
    item = item_of(write_item(str(tmp_path / "a.json"), scene, {"output": ("DSM", urban_run.result.output)}))
    assert item["properties"]["datetime"] == TIMES[0]
    assert os.path.samefile(tmp_path / item["assets"]["output"]["href"], urban_run.result.output)


def test_without_a_time_there_is_no_item_and_nothing_is_fused(urban_run, tmp_path, told):
    options = {
        "scene": urban_run.result.scene,
        "output": str(tmp_path / "dsm.tif"),
        "stac": str(tmp_path / "d.json"),
    }
    with pytest.raises(OptionError, match="STAC .* needs the time of acquisition, which no image states"):
        run_stage("dsmfuse", options, told())
    assert not list(tmp_path.iterdir())
    with pytest.raises(OptionError, match="must end with .json"):
        DsmFuseOptions(scene="s", output="o", stac="dsm.stac")


def test_fusion_writes_it_beside_the_dsm(urban_run, timed, tmp_path, told):
    scene = tmp_path / "timed.json"
    timed.save(str(scene))
    options = {"scene": str(scene), "output": str(tmp_path / "town.tif"), "stac": str(tmp_path / "town.json")}
    made = run_stage("dsmfuse", {**options, "resolution": 2.0, "workers": 1}, told())
    item = item_of(made.stac)
    assert item["id"] == "town" and list(item["assets"]) == ["output"] and item["properties"]["gsd"] == 2.0
