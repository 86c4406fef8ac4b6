"""Every package of the engine has a wheel for the systems that nothing was run on: the package index says so."""

from __future__ import annotations

import ast
import json
import pathlib
import re
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


# Debian 12, Ubuntu 24.04, Debian 13, and the newest of conda's channels.
INSTALLED = (("3.11", "1.24.2"), ("3.12", "1.26.4"), ("3.13", "2.2.4"), ("3.11", "2.4.6"), ("3.12", "2.5.2"))


@pytest.mark.parametrize(("python", "numpy"), INSTALLED)
@pytest.mark.slow
def test_the_numpy_that_is_there_stays(python, numpy, tmp_path):
    """pip takes the newest of each package, and replaces a numpy that it does not take."""
    version = pytest.importorskip("packaging.version").Version
    from packaging.requirements import Requirement

    words = "--dry-run --no-deps --ignore-installed --only-binary=:all: --quiet --report - --retries 1 --timeout 5"
    chosen = [need for need in map(Requirement, needed()) if not need.marker or need.marker.evaluate(marks(python))]
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pip", "install", *words.split(), "--python-version", python),
            *("--target", str(tmp_path), *(f"{each.name}{each.specifier}" for each in chosen if each.name != "numpy")),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode and re.search("no module named pip|connection|no such option", done.stderr.lower()):
        pytest.skip("no pip that reports, or no package index")
    found = json.loads(done.stdout)["install"]
    assert len(found) == len(chosen) - 1
    for each in found:
        for need in map(Requirement, each["metadata"].get("requires_dist", ())):
            if need.name == "numpy" and (not need.marker or need.marker.evaluate(marks(python))):
                assert need.specifier.contains(version(numpy)), f"{each['metadata']['name']} {need}"


def marks(python):
    return {"python_version": python, "python_full_version": f"{python}.0", "extra": ""}


def needed():
    """The dependencies of pyproject.toml; Python 3.9 has no reader of TOML."""
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    return ast.literal_eval(f"[{project.partition(chr(10) + 'dependencies = [')[2].partition(chr(10) + ']')[0]}]")


def test_the_engines_own_wheel_needs_what_the_installer_installs():
    """Who has the engine without QGIS gets the same packages."""
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    needs = project.partition("\ndependencies = [\n")[2].partition("]")[0]
    lines = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()
    missing = [line for line in lines if line and not line.startswith("#") and f'"{line}"' not in needs]
    assert needs and not missing
