"""repm:buildings from the command line, as a user of QGIS would run it, and its layer on the map."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from qgis.core import QgsVectorLayer


@pytest.fixture(scope="module")
def houses(tmp_path_factory):
    """Level ground with nine flat houses of 14 x 18 m and 6 m."""
    from repm_qgis.imagery import raster

    rows, columns = np.indices((120, 120))
    house = (abs(rows % 40 - 20) < 7) & (abs(columns % 40 - 20) < 9)
    folder, place = tmp_path_factory.mktemp("houses"), (500000.0, 1.0, 0.0, 4800000.0, 0.0, -1.0)
    heights = {"dsm": 100.0 + 6.0 * house, "dtm": np.full(house.shape, 100.0)}
    paths = {name: str(folder / f"{name}.tif") for name in heights}
    for name, values in heights.items():
        raster.write(paths[name], [values.astype(np.float32)], place, "EPSG:32631", unit="m")
    return paths, house


def test_houses_become_a_styled_layer_and_solids(headless, houses, tmp_path):
    paths, house = houses
    out = {"OUTPUT": tmp_path / "b.gpkg", "CITYJSON": tmp_path / "b.json", "REPORT": tmp_path / "b.html"}
    given = [f"DSM={paths['dsm']}", f"DTM={paths['dtm']}", *(f"{name}={path}" for name, path in out.items())]
    done = headless("--json", "run", "repm:buildings", "--", *given, REPM_ENGINE_PYTHON=sys.executable)
    assert done.returncode == 0, done.stderr + done.stdout
    results = json.loads(done.stdout)["results"]
    assert (results["N_BUILDINGS"], results["N_ROOFED"]) == (9, 0)
    assert results["AREA_M2"] == pytest.approx(house.sum(), rel=0.01)
    assert results["VOLUME_M3"] == pytest.approx(6.0 * house.sum(), rel=0.01)
    layer = QgsVectorLayer(str(out["OUTPUT"]), "buildings")
    assert layer.isValid() and layer.featureCount() == 9
    assert {each["roof"] for each in layer.getFeatures()} == {"flat"}
    assert all(each["height_m"] == pytest.approx(6.0, abs=0.01) for each in layer.getFeatures())
    assert layer.renderer().type() == "graduatedSymbol" and layer.labelsEnabled()
    assert len(json.loads(out["CITYJSON"].read_text(encoding="utf-8"))["CityObjects"]) == 9
    assert "9 buildings" in out["REPORT"].read_text(encoding="utf-8")
