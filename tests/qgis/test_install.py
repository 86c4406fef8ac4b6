"""The engine's packages installed from QGIS: by the dialog in the desktop (Xvfb), and by repm:environment headless."""

from __future__ import annotations

import os
import pathlib
import shutil
import subprocess
import sys
import zipfile
from types import SimpleNamespace

import pytest

from repm_qgis.contracts.errors import INSTALL_REMEDY

ROOT = pathlib.Path(__file__).resolve().parents[2]

WHEELS = {"opencv_python_headless": ("cv2", "4.9"), "pycolmap": ("pycolmap", "4.0"), "laspy": ("laspy", "2.6")}
WHEELS["lazrs"] = ("lazrs", "0.7")
WHEELS["pyfqmr"] = ("pyfqmr", "0.5")
_own = subprocess.run(["/usr/bin/python3", "-c", "import cv2"], capture_output=True, check=False).returncode == 0
pytestmark = pytest.mark.skipif(_own, reason="QGIS's own Python has OpenCV here, so nothing is missing")


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """Tiny wheels in place of the engine's packages."""
    folder = tmp_path_factory.mktemp("wheels")
    for name, (module, version) in WHEELS.items():
        info = f"{name}-{version}.dist-info"
        with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w") as archive:
            archive.writestr(f"{module}.py", "has_cuda = False\n")
            archive.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
            archive.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
            archive.writestr(f"{info}/RECORD", f"{module}.py,,\n{info}/METADATA,,\n{info}/WHEEL,,\n{info}/RECORD,,\n")
    return folder


@pytest.mark.slow
def test_headless_it_installs_from_a_folder_of_wheels_and_an_update_keeps_it(
    headless, unpacked_profile, wheels, tmp_path
):
    home = unpacked_profile / "profiles" / "default" / "repm"
    quiet = {"config": unpacked_profile, "REPM_ENGINE_PYTHON": "", "HOME": str(tmp_path)}
    done = headless("run", "repm:environment", **quiet)
    assert done.returncode == 0 and INSTALL_REMEDY in done.stdout and "opencv-python-headless" in done.stdout
    done = headless("run", "repm:environment", "--", "INSTALL=true", f"WHEELS={wheels}", **quiet)
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    (folder,) = [path for path in home.iterdir() if path.is_dir()]
    for words in (
        "MB are free there",
        f"from the folder '{wheels}'",
        "has every package that the engine uses",
        str(folder),
    ):
        assert words in said, said
    plugin = unpacked_profile / "profiles" / "default" / "python" / "plugins" / "repm"
    shutil.copytree(plugin, tmp_path / "update")
    shutil.rmtree(plugin)  # as QGIS does it
    shutil.move(tmp_path / "update", plugin)
    done = headless("run", "repm:environment", **quiet)
    assert "has every package that the engine uses" in done.stdout and str(folder) in done.stdout
    done = headless("run", "repm:environment", "--", "REMOVE=true", **quiet)
    assert done.returncode == 0 and not home.exists() and INSTALL_REMEDY in done.stdout


@pytest.mark.long
def test_scripts_setup_of_an_unpacked_zip_serves_qgis(headless, unpacked_profile, wheels, tmp_path):
    """The execute bit is lost, so it is started by bash; an environment goes into the profile."""
    plugin = unpacked_profile / "profiles" / "default" / "python" / "plugins" / "repm"
    assert not os.access(plugin / "scripts" / "setup", os.X_OK)
    variables = {
        "PIP_NO_INDEX": "1",
        "PIP_FIND_LINKS": str(wheels),
        "PIP_CONFIG_FILE": os.devnull,
        "HOME": str(tmp_path),
    }
    done = subprocess.run(
        ["bash", str(plugin / "scripts" / "setup")],
        env={**os.environ, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert not (plugin / ".venv").exists()
    done = headless("run", "repm:environment", config=unpacked_profile, REPM_ENGINE_PYTHON="", HOME=str(tmp_path))
    assert "has every package that the engine uses" in done.stdout, done.stdout


desktop = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


@desktop
@pytest.mark.slow
def test_the_desktop_offers_installs_and_removes(plugin, desktop_start, wheels):
    from repm.processing_provider.provider import ALGORITHMS

    found = desktop_start("drive_install.py", {"wheels": str(wheels)}, seconds=90, engine=False)
    models = len(list((ROOT / "resources" / "models").glob("*.model3")))  # all are shown where packages are missing
    assert found["algorithms"] == len(ALGORITHMS) + models
    assert (found["state"], found["offered"]) == ("missing", ["Install the packages…"])
    assert [name.split(">")[0] for name in found["packages"]] == [name.replace("_", "-") for name in WHEELS]
    assert "about 90 MB" in found["where"] and "profiles/default/repm/engine-" in found["where"]
    assert "about 0 MB" in found["where then"]
    assert found["enabled while running"] == [False, True]
    assert found["ended"].startswith("The packages are installed"), found["log"]
    assert found["state then"] == "fine" and len(found["folders"]) == 1
    assert found["longest pause"] < 2 and not found["offered still"]
    assert found["left"] == [] and not found["home"] and found["state at the end"] == "missing"


@desktop
@pytest.mark.long
def test_cancel_in_the_desktop_leaves_nothing(desktop_start, wheels, monkeypatch):
    # An address that takes the connection and never answers.
    import socket

    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        monkeypatch.setenv("PIP_INDEX_URL", f"http://127.0.0.1:{mute.getsockname()[1]}/simple")
        found = desktop_start("drive_install.py", {"cancel": True}, seconds=60, engine=False)
    assert found["ended"] == "Cancelled by the user." and found["cancel seconds"] < 3, found["log"]
    assert found["folders"] == [] and found["state then"] == "missing"


@desktop
@pytest.mark.skipif(not os.environ.get("REPM_FIRST_HOUR"), reason="downloads 90 MB: set REPM_FIRST_HOUR=1 to run it")
def test_from_the_zip_to_a_dsm_in_seven_clicks(desktop_start, tmp_path):
    """The pictures of docs/guide.md come from here: REPM_KEEP_PICTURES=FOLDER."""
    subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "package"), str(tmp_path)], check=True, stdout=subprocess.PIPE
    )
    plan = {"zip": str(next(tmp_path.glob("*.zip")))}
    found = desktop_start("drive_first_hour.py", plan, seconds=600, settings="", engine=None)
    assert found["success"] and len(found["clicks"]) <= 7, found["clicks"]
    assert any(name.startswith("DSM sample town") for name in found["layers"])


def test_the_dialog_does_not_vouch_for_an_interpreter_that_the_user_chose(plugin, monkeypatch):
    """A run with one that lacks packages sends its user here, and an installation would not change what it uses."""
    from repm.desktop.install import InstallDialog

    said = []
    for chosen in ("/opt/mine/python", ""):
        monkeypatch.setenv("REPM_ENGINE_PYTHON", chosen)
        dialog = InstallDialog(SimpleNamespace(mainWindow=lambda: None))
        dialog.show()
        said.append(dialog.intro.text())
        dialog.close()
    assert "You have chosen /opt/mine/python" in said[0] and "clear it in Settings" in said[0]
    assert "Nothing has to be done" not in said[0]
    assert "chosen" not in said[1]
