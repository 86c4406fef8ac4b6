"""The products of a run appear together or not at all, also after a cancel and after a kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from repm_qgis.contracts.errors import Cancelled
from repm_qgis.runtime.together import recover, together
from repm_qgis.runtime.workspace import whole_folder, write_text
from repm_qgis.stages import run_stage
from tests.engine.change.test_change import BUILT, ground, write


def contents(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()
    }


def written(folder, text):
    """Three products: two files, and a folder."""
    write_text(str(folder / "a.txt"), text)
    write_text(str(folder / "b.txt"), text)
    with whole_folder(str(folder / "built")) as new:
        (new / f"{text}.txt").write_text(text)


def places(folder):
    return [str(folder / name) for name in ("a.txt", "b.txt", "built")]


@pytest.mark.parametrize("before", (False, True))
@pytest.mark.parametrize("links", (True, False))
def test_a_run_that_fails_leaves_what_was_there(tmp_path, monkeypatch, before, links):
    if not links:  # as on disks of cameras and some networks

        def refuse(*_, **__):
            raise OSError("no links here")

        monkeypatch.setattr(os, "link", refuse)
    if before:
        written(tmp_path, "old")
    state = contents(tmp_path)
    with pytest.raises(Cancelled), together(places(tmp_path)):
        written(tmp_path, "new")
        raise Cancelled
    assert contents(tmp_path) == state
    with together(places(tmp_path)):
        written(tmp_path, "new")
    assert sorted(contents(tmp_path)) == ["a.txt", "b.txt", "built/new.txt"]
    assert set(contents(tmp_path).values()) == {b"new"}


def test_a_run_that_does_not_write_a_product_leaves_the_old_one(tmp_path):
    written(tmp_path, "old")
    with together(places(tmp_path)):
        write_text(str(tmp_path / "a.txt"), "new")
    assert contents(tmp_path) == {"a.txt": b"new", "b.txt": b"old", "built/old.txt": b"old"}


_KILLED = """
import os, signal, sys
from pathlib import Path
from tests.engine.runtime.test_together import places, written
from repm_qgis.runtime.together import together
folder = Path(sys.argv[1])
with together(places(folder)):
    written(folder, "new")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
@pytest.mark.parametrize("before", (False, True))
def test_what_a_kill_left_is_undone(tmp_path, before):
    if before:
        written(tmp_path, "old")
    state = contents(tmp_path)
    ended = subprocess.run([sys.executable, "-c", _KILLED, str(tmp_path)], cwd=Path(__file__).parents[3])
    assert ended.returncode == -signal.SIGKILL and contents(tmp_path) != state
    recover(places(tmp_path))
    assert contents(tmp_path) == state


@pytest.mark.parametrize("before", (False, True))
def test_a_cancelled_change_leaves_the_products_of_the_one_before(tmp_path, told, before):
    after = ground()
    after[BUILT] += 6
    options = {
        "before": write(tmp_path / "before.tif", [ground()]),
        "after": write(tmp_path / "after.tif", [after]),
        "align": "none",
        **{name: str(tmp_path / name) for name in ()},
        "output": str(tmp_path / "change.tif"),
        "significant": str(tmp_path / "significant.tif"),
        "volumes": str(tmp_path / "volumes.gpkg"),
        "report": str(tmp_path / "report.html"),
    }
    if before:
        run_stage("change", {**options, "min_area": 10.0}, told())
    state = contents(tmp_path)

    class Late(told):
        def step(self, fraction, text=""):
            if text == "Report":
                assert contents(tmp_path) != state
                raise Cancelled

    with pytest.raises(Cancelled):
        run_stage("change", options, Late())
    assert contents(tmp_path) == state
