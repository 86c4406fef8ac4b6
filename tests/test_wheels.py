"""Every package of the engine has a wheel for the systems that nothing was run on: the package index says so."""

from __future__ import annotations

import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
PLATFORMS = ("macosx_14_0_arm64", "win_amd64")


@pytest.mark.parametrize("platform", PLATFORMS)
def test_the_index_has_wheels_of_all_packages(platform, tmp_path):
    """For Python 3.12, which QGIS 3.40 has on Windows; nothing is downloaded but what describes the packages."""
    options = "--dry-run --no-deps --ignore-installed --only-binary=:all: --python-version 3.12 --retries 1 --timeout 5"
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pip", "install", *options.split(), "--platform", platform),
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
