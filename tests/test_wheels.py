"""Every package of the engine has a wheel for the systems that nothing was run on: the package index says so."""

from __future__ import annotations

import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
PLATFORMS = ("macosx_14_0_arm64", "macosx_14_0_x86_64", "win_amd64")


@pytest.mark.parametrize("python", ("3.9", "3.12"))
@pytest.mark.parametrize("platform", PLATFORMS)
@pytest.mark.slow
def test_the_index_has_wheels_of_all_packages(platform, python, tmp_path):
    """For the Pythons of QGIS 3.22 and 3.40 on Windows; nothing is downloaded but what describes the packages."""
    options = "--dry-run --no-deps --ignore-installed --only-binary=:all: --retries 1 --timeout 5 --python-version"
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pip", "install", *options.split(), python, "--platform", platform),
            *("--target", str(tmp_path), "-r", str(ROOT / "requirements.txt")),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    if "No module named pip" in done.stderr:
        pytest.skip("this Python has no pip")
    if done.returncode and "connection" in done.stderr.lower():
        pytest.skip("the package index cannot be reached")
    assert done.returncode == 0 and "Would install" in done.stdout, done.stderr
    for line in (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            name = line.split(">")[0]
            assert f" {name}-" in done.stdout.replace("_", "-"), done.stdout


def test_the_engines_own_wheel_needs_what_the_installer_installs():
    """Who has the engine without QGIS gets the same packages."""
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    needs = project.partition("\ndependencies = [\n")[2].partition("]")[0]
    lines = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()
    missing = [line for line in lines if line and not line.startswith("#") and f'"{line}"' not in needs]
    assert needs and not missing
