"""The products of a run appear together or not at all, also after a cancel and after a kill."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from repm_qgis.contracts.errors import Cancelled
from repm_qgis.contracts.stages import STAGES
from repm_qgis.runtime import together as together_module
from repm_qgis.runtime.together import join, recover, together
from repm_qgis.runtime.workspace import whole_folder, write_text
from repm_qgis.stages import provisional, run_stage
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


_KILLED_WITHIN = """
import os, signal, sys
from pathlib import Path
from tests.engine.runtime.test_together import places, written
from repm_qgis.runtime.together import join, together
from repm_qgis.runtime.workspace import write_text
folder = Path(sys.argv[1])
with together(places(folder), [str(folder / "shared")]):
    (folder / "shared").mkdir(exist_ok=True)
    join(str(folder / "shared"), ["a.txt", "b.txt", "built"])
    written(folder / "shared", "new")
    written(folder, "new")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
@pytest.mark.parametrize("before", (False, True))
def test_what_a_kill_left_in_a_shared_folder_is_undone(tmp_path, before):
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared" / "others.txt").write_text("mine")
    if before:
        written(tmp_path, "old")
        written(tmp_path / "shared", "old")
    state = contents(tmp_path)
    ended = subprocess.run([sys.executable, "-c", _KILLED_WITHIN, str(tmp_path)], cwd=Path(__file__).parents[3])
    assert ended.returncode == -signal.SIGKILL and contents(tmp_path) != state
    recover(places(tmp_path), [str(tmp_path / "shared")])
    assert contents(tmp_path) == state


@pytest.mark.parametrize("left", range(1, 7))
def test_a_kill_while_marks_go_keeps_what_is_new(tmp_path, monkeypatch, left):
    """A run that has ended well is never undone, however many of its marks are left."""
    (tmp_path / "shared").mkdir()
    written(tmp_path, "old")
    written(tmp_path / "shared", "old")
    marks = []

    def interrupted(self):
        marks.extend(
            sorted(tmp_path.rglob(".*-*"), key=lambda path: ("within" in path.name, path.parent.name == "shared"))
        )
        assert self.settled

    monkeypatch.setattr(together_module._Marks, "remove", interrupted)
    with together(places(tmp_path), [str(tmp_path / "shared")]):
        join(str(tmp_path / "shared"), ["a.txt", "b.txt"])
        written(tmp_path, "new")
        written(tmp_path / "shared", "new")
    monkeypatch.undo()
    monkeypatch.setattr(together_module, "process_exists", lambda number: False)
    files = [mark for mark in marks if mark.is_file() and "before-" not in mark.parent.name]
    assert len(files) == 6
    for mark in files[: len(files) - left]:  # a run removes those of its own paths first, and the list last
        mark.unlink()
    recover(places(tmp_path), [str(tmp_path / "shared")])
    whole = left >= len(files)  # as if nothing had gone yet: then it was not settled
    assert (tmp_path / "a.txt").read_text() == ("old" if whole else "new")
    assert (tmp_path / "shared" / "a.txt").read_text() == ("old" if whole else "new")
    assert not [path for path in tmp_path.rglob(".*-*") if path.is_file()]


_KILLED_STAGE = """
import json, os, signal, sys
from repm_qgis.runtime import workspace
from repm_qgis.stages import provisional, run_stage
from tests.engine.conftest import Told
stage, last, options = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
def killed_after(take):
    def named(temporary, target):
        take(temporary, target)
        if target.name == last and str(temporary) != str(target):
            os.kill(os.getpid(), signal.SIGKILL)
    return named
workspace._replace, workspace._take_place = map(killed_after, (workspace._replace, workspace._take_place))
run_stage(stage, options, Told())
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
@pytest.mark.long
def test_a_killed_run_leaves_scenes_and_folders_as_they_were(urban_run, tmp_path, told):
    """The scene stood beside an older report, new DSMs of pairs beside the older one, and new cameras of some tiles."""
    workspace = urban_run.workspace
    fitted, refined, done = (str(workspace / f"{name}.json") for name in ("scene", "refined", "reconstructed"))
    pair = "_".join(sorted(view.name for view in urban_run.scene.views)[:2])
    folders = {name: tmp_path / name for name in ("refine", "exportcameras", "dsmfuse")}
    own, dsm, pairs = folders["refine"] / "own.json", folders["dsmfuse"] / "dsm.tif", folders["dsmfuse"] / "pairs"
    fuse = {"scene": done, "output": str(dsm), "view_heights": str(pairs), "resolution": 2.0, "workers": 1}
    cases = (
        ("refine", {"scene": fitted, "output_scene": str(own), "model": "homography", "workers": 1}, "own.json"),
        ("exportcameras", {"scene": refined, "folder": str(folders["exportcameras"]), "format": "colmap"}, ""),
        ("dsmfuse", fuse, f"{pair}_confidence.tif"),
    )
    changes = {"refine": {"model": "polynomial"}, "exportcameras": {"bits": "16"}, "dsmfuse": {"resolution": 3.0}}

    def files(stage):
        found = contents(folders[stage])  # half-written files go when the next run begins
        return {name: data for name, data in found.items() if ".part-" not in name and not name.endswith(".lock")}

    for stage, options, last in cases:
        folders[stage].mkdir()
        made = run_stage(stage, options, told())
        state = files(stage)
        job = json.dumps({**options, **changes[stage]})
        command = [sys.executable, "-c", _KILLED_STAGE, stage, last or Path(made.models[-1]).name, job]
        ended = subprocess.run(command, cwd=Path(__file__).parents[3], capture_output=True, text=True)
        assert ended.returncode == -signal.SIGKILL, ended.stderr
        changed = files(stage)
        assert any(changed[name] != state[name] for name in state), stage
        products, shared = provisional(stage, STAGES[stage].options.from_json(options))
        recover(products, shared)
        assert sorted(files(stage)) == sorted(state) and files(stage) == state, stage
