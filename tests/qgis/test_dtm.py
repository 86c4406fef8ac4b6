"""repm:dtm from the command line, as a user of QGIS would run it."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest


@pytest.fixture(scope="module")
def houses(tmp_path_factory):
    """A DSM of sloping ground with houses of 5 m."""
    from repm_qgis.imagery import raster

    rows, columns = np.indices((120, 160))
    house = (abs(rows % 40 - 20) < 7) & (abs(columns % 40 - 20) < 9)
    heights = (100 + 0.05 * columns + 5.0 * house).astype(np.float32)
    path = str(tmp_path_factory.mktemp("houses") / "dsm.tif")
    place = (500000.0, 1.0, 0.0, 4800000.0, 0.0, -1.0)
    return raster.write(path, [heights], place, "EPSG:32631", unit="m"), house


@pytest.mark.long
def test_the_terrain_below_houses(headless, houses, tmp_path):
    dsm, house = houses
    out = {name: str(tmp_path / f"{name.lower()}.tif") for name in ("OUTPUT", "HEIGHTS", "MASK")}
    given = [f"DSM={dsm}", "LARGEST=30", f"REPORT={tmp_path / 'report.html'}", *(f"{n}={p}" for n, p in out.items())]
    done = headless("--json", "run", "repm:dtm", "--", *given, REPM_ENGINE_PYTHON=sys.executable)
    assert done.returncode == 0, done.stderr + done.stdout
    results = json.loads(done.stdout)["results"]
    assert results["VALID_PERCENT"] == 100 and results["OBJECTS_PERCENT"] == pytest.approx(100 * house.mean(), abs=0.5)
    from repm_qgis.imagery import raster

    with raster.opened(out["OUTPUT"]) as dataset:
        terrain = raster.read(dataset)
    assert terrain == pytest.approx(np.broadcast_to(100 + 0.05 * np.arange(160), (120, 160)), abs=0.3)
    with raster.opened(out["MASK"]) as dataset:
        assert (dataset.ReadAsArray() == house).all()
    assert all((tmp_path / f"{name.lower()}.qml").exists() for name in out)


@pytest.mark.long
def test_a_dsm_or_a_scene_must_be_given(headless, tmp_path):
    done = headless("run", "repm:dtm", "--", f"OUTPUT={tmp_path / 'dtm.tif'}", REPM_ENGINE_PYTHON=sys.executable)
    assert done.returncode and "must be given, or SCENE" in done.stderr + done.stdout
