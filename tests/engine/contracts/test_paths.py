"""Paths where Windows does not tell where a file really lies."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from repm_qgis.contracts.paths import real_path

REALPATH = os.path.realpath


@pytest.fixture
def as_on_such_drives(monkeypatch, tmp_path):
    """Below the folder "far", the system says of no file where it lies, as GetFinalPathNameByHandle then does."""
    far = tmp_path / "far"
    far.mkdir()

    def realpath(path, **keywords):
        if os.path.abspath(path).startswith(str(far)):
            raise OSError(22, "More data is available", os.fspath(path), 234)
        return REALPATH(path, **keywords)

    monkeypatch.setattr(os.path, "realpath", realpath)
    return far


def test_a_path_stays_as_it_is_where_the_system_does_not_tell(as_on_such_drives, monkeypatch):
    path = as_on_such_drives / "a" / "b.tif"
    assert real_path(path) == str(Path(REALPATH(as_on_such_drives.parent)) / "far" / "a" / "b.tif")
    monkeypatch.chdir(as_on_such_drives.parent)
    assert real_path(os.path.join("far", "a", "..", "b.tif")) == real_path(as_on_such_drives / "b.tif")


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
def test_links_above_are_followed(as_on_such_drives, tmp_path):
    (tmp_path / "near").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "near")
    assert real_path(tmp_path / "link" / "a.tif") == REALPATH(tmp_path / "near" / "a.tif")


def test_products_are_written_there(as_on_such_drives, told):
    from repm_qgis.stages import run_stage

    folder = as_on_such_drives / "town"
    made = run_stage("sampledata", {"folder": str(folder), "size": 128}, told())
    assert all(Path(image).stat().st_size for image in made.images)


def test_the_engine_asks_nowhere_else():
    """Every other module goes through real_path; the text in the installer is a program for another Python."""
    engine = Path(__file__).resolve().parents[3] / "repm_qgis"
    asking = {
        path.relative_to(engine).as_posix()
        for path in engine.rglob("*.py")
        if "path.realpath(" in path.read_text(encoding="utf-8") or "path.realpath)" in path.read_text(encoding="utf-8")
    }
    assert asking == {"contracts/paths.py", "installer/install.py"}
