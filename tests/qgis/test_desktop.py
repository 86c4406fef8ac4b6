"""The desktop itself, under Xvfb: the algorithm is found in the toolbox, its dialog run, its layers looked at.

REPM_KEEP_PICTURES=FOLDER keeps the screenshots (docs/ shows some of them).
"""

from __future__ import annotations

import json
import os
import pathlib
import shutil
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


@pytest.fixture
def desktop(tmp_path):
    """Runs an algorithm in a new desktop with an empty profile; gives what the driver found."""
    profile = tmp_path / "profiles" / "profiles" / "default"
    (profile / "python" / "plugins").mkdir(parents=True)
    (profile / "python" / "plugins" / "repm").symlink_to(ROOT)
    (profile / "QGIS").mkdir()
    (profile / "QGIS" / "QGIS3.ini").write_text(
        "[PythonPlugins]\nrepm=true\nprocessing=true\n[locale]\nuserLocale=en\noverrideFlag=true\n"
    )
    out = tmp_path / "out"
    out.mkdir()

    def run(title, parameters, seconds=150):
        plan = tmp_path / "plan.json"
        plan.write_text(json.dumps({"title": title, "parameters": parameters, "folder": str(out), "seconds": seconds}))
        environment = {
            name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "QGIS_", "QT_QPA"))
        }
        environment.update(REPM_DESKTOP_PLAN=str(plan), REPM_ENGINE_PYTHON=sys.executable)
        runtime = tmp_path / "runtime"
        runtime.mkdir(mode=0o700)
        environment.setdefault("XDG_RUNTIME_DIR", str(runtime))
        done = subprocess.run(
            [
                "xvfb-run",
                "-a",
                "-s",
                "-screen 0 1400x900x24",
                "qgis",
                "--nologo",
                "--noversioncheck",
                "--profiles-path",
                str(tmp_path / "profiles"),
                "--code",
                str(ROOT / "tests" / "qgis" / "desktop_driver.py"),
            ],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=seconds + 30,
            check=False,
        )
        found = json.loads((out / "found.json").read_text())
        assert done.returncode == 0 and "error" not in found, f"{found}\n{done.stdout}"
        keep = os.environ.get("REPM_KEEP_PICTURES")
        for picture in out.glob("*.png") if keep else ():
            os.makedirs(keep, exist_ok=True)
            shutil.copy(picture, pathlib.Path(keep) / f"{found['chosen'].split(':')[1]}_{picture.name}")
        return found

    return run


def test_the_pipeline_in_the_desktop_brings_styled_layers(desktop, town, tmp_path):
    found = desktop(
        "Make a DSM from satellite",
        {
            "IMAGES": town["images"],
            "WORKSPACE": str(tmp_path / "old town"),
            "CONFIDENCE": "TEMPORARY_OUTPUT",
            "ORTHO": "TEMPORARY_OUTPUT",
            "EPT": str(tmp_path / "points"),
            "MESH": str(tmp_path / "mesh.ply"),
        },
    )
    assert found["chosen"] == "repm:pipeline"
    assert found["success"]
    layers = {layer["name"]: layer for layer in found["layers"]}
    assert {"DSM old town (WGS 84 ellipsoid)", "Tiles old town", "Tie points old town"} <= set(layers)
    assert layers["DSM old town (WGS 84 ellipsoid)"]["renderer"] == "QgsSingleBandPseudoColorRenderer"
    assert layers["Tiles old town"]["renderer"] == "QgsGraduatedSymbolRenderer"
    assert layers["Tie points old town"]["renderer"] != "QgsSingleSymbolRenderer"
    # In one group, in an order in which nothing hides what matters.
    assert [(layer["name"].replace(" old town", ""), layer["shown"]) for layer in found["layers"]] == [
        ("Tie points", True),
        ("Tiles", True),
        ("Point cloud", False),
        ("Orthophoto", False),
        ("Confidence", False),
        ("Mesh", False),
        ("Hillshade", True),
        ("DSM (WGS 84 ellipsoid)", True),
    ]
    assert {layer["group"] for layer in found["layers"]} == {"old town"}
    assert layers["Point cloud old town"]["renderer"] == "QgsPointCloudAttributeByRampRenderer"
    assert all(layer["valid"] and layer["crs"].startswith("EPSG:326") for layer in layers.values())


def test_the_first_stage_in_the_desktop(desktop, sample, tmp_path):
    found = desktop("Fit equivalent", {"IMAGES": sample["images"], "WORKSPACE": str(tmp_path / "old town")})
    assert (found["chosen"], found["success"]) == ("repm:epmfit", True)
    (layer,) = found["layers"]
    assert (layer["name"], layer["valid"]) == ("Tiles old town", True)
    assert layer["renderer"] == "QgsGraduatedSymbolRenderer"


def test_an_error_map_in_the_desktop(desktop, town, tmp_path):
    from repm_qgis.progress import Silent
    from repm_qgis.stages import run_stage

    fitted = run_stage("epmfit", {"images": town["images"], "workspace": str(tmp_path / "old town")}, Silent())
    found = desktop("Map the equivalent error", {"SCENE": fitted["scene"], "ALTITUDE": 180})
    assert (found["chosen"], found["success"]) == ("repm:errormap", True)
    (layer,) = found["layers"]
    assert (layer["name"], layer["valid"]) == ("Equivalent error old town", True)
    assert layer["renderer"] == "QgsSingleBandPseudoColorRenderer"
    assert layer["crs"] == "EPSG:32631"
