"""Two runs that would write the same files: the second waits, and no lock outlives its process."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from repm_qgis.contracts.errors import Cancelled, WorkspaceError
from repm_qgis.runtime.locks import exclusive
from repm_qgis.runtime.workspace import write_text

ROOT = Path(__file__).resolve().parents[3]
HOLD = """
import sys, time
from repm_qgis.runtime.locks import exclusive
from repm_qgis.runtime.progress import Silent
with exclusive("pipeline", Silent(), folders=[sys.argv[1]], files=[sys.argv[2]]):
    print("held", flush=True)
    time.sleep(float(sys.argv[3]))
"""


@pytest.fixture
def holder(tmp_path):
    """holder(seconds): another process that holds the folder 'w' and the file 'dsm.tif' for so long."""
    started = []

    def hold(seconds):
        places = [str(tmp_path / "w"), str(tmp_path / "dsm.tif")]
        process = subprocess.Popen(
            [sys.executable, "-c", HOLD, *places, str(seconds)], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield hold
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.parametrize("asked", ("folders", "files"))
def test_the_second_run_says_whom_it_waits_for_and_goes_on_after_it(holder, told, tmp_path, asked):
    other, said = holder(1.0), told()
    place = str(tmp_path / ("w" if asked == "folders" else "dsm.tif"))
    with exclusive("dsmfuse", said, **{asked: [place]}):
        assert other.wait() == 0
    words = rf"is in use by process {other.pid} on \S+ \(pipeline, since \d\d:\d\d:\d\d on .*\): this run waits"
    assert len(said.notes) == 1 and re.search(words, said.notes[0])
    assert os.listdir(tmp_path) == []


def test_a_killed_run_holds_nothing(holder, told, tmp_path):
    other, said = holder(60.0), told()
    other.kill()
    other.wait()
    start = time.monotonic()
    with exclusive("pipeline", said, folders=[str(tmp_path / "w")], files=[str(tmp_path / "dsm.tif")]):
        assert time.monotonic() - start < 1.0
    assert said.warnings == [] and os.listdir(tmp_path) == ["w"]


def test_waiting_can_be_cancelled(holder, told, tmp_path):
    other = holder(60.0)
    with pytest.raises(Cancelled), exclusive("pipeline", told(cancel_at=3), folders=[str(tmp_path / "w")]):
        raise AssertionError("the other process has it")
    assert other.poll() is None


def test_a_run_holds_what_its_stages_ask_for(told, tmp_path):
    said, folder = told(), str(tmp_path)
    with exclusive("pipeline", said, folders=[folder]):
        with exclusive("epmfit", said, folders=[folder]):
            assert os.listdir(folder) == [".repm.lock"]
        assert os.listdir(folder) == [".repm.lock"]
    assert said.warnings == [] and os.listdir(folder) == []


@pytest.mark.skipif(os.name == "nt", reason="Windows removes no folder with an open file in it: see the next test")
@pytest.mark.parametrize("removed", (False, True))
def test_a_folder_that_loses_its_name_amid_a_run_is_not_made_again(told, tmp_path, removed):
    folder = tmp_path / "w"
    with pytest.raises(WorkspaceError, match="w' was renamed, moved or removed while this run wrote there: give it"):
        with exclusive("pipeline", told(), folders=[str(folder)]):
            write_text(str(folder / "heights" / "a.txt"), "whole")
            if removed:
                shutil.rmtree(folder)
            else:
                os.rename(folder, tmp_path / "renamed")
            write_text(str(folder / "heights" / "b.txt"), "half")
    assert not folder.exists() and (removed or os.listdir(tmp_path / "renamed" / "heights") == ["a.txt"])
    with exclusive("pipeline", told(), folders=[str(folder)]):
        (folder / ".repm.lock").unlink()  # somebody takes it for a leftover: the folder is the same
        write_text(str(folder / "a.txt"), "whole")


@pytest.mark.skipif(os.name != "nt", reason="elsewhere open files can be removed")
def test_windows_does_not_let_a_lock_be_removed_amid_a_run(told, tmp_path):
    folder = tmp_path / "w"
    with exclusive("pipeline", told(), folders=[str(folder)]):
        with pytest.raises(PermissionError):
            os.unlink(folder / ".repm.lock")
        with pytest.raises(PermissionError):
            shutil.rmtree(folder)
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(os.name == "nt", reason="Windows removes no folder with an open file in it: see the test before")
def test_what_is_missed_in_a_folder_that_lost_its_name_is_not_blamed(told, tmp_path):
    with pytest.raises(WorkspaceError, match="w' was renamed, moved or removed"):
        with exclusive("pipeline", told(), folders=[str(tmp_path / "w")]):
            os.rename(tmp_path / "w", tmp_path / "renamed")
            os.listdir(tmp_path / "w")


def _link(lock, precious):
    lock.symlink_to(precious)


def _hard_link(lock, precious):
    os.link(precious, lock)


def _own_file(lock, precious):
    lock.write_bytes(precious.read_bytes())


def _pipe(lock, _):
    os.mkfifo(lock)


@pytest.mark.skipif(os.name == "nt", reason="Windows knows neither pipes with names nor links for everybody")
@pytest.mark.parametrize("taken", (_link, _hard_link, _own_file, _pipe))
@pytest.mark.parametrize("asked, name", (("folders", ".repm.lock"), ("files", ".dsm.tif.lock")))
def test_what_is_no_lock_is_refused_and_stays_as_it_is(told, tmp_path, taken, asked, name):
    precious = tmp_path / "precious"
    precious.write_text("years of work")
    folder = tmp_path / "received"
    folder.mkdir()
    taken(folder / name, precious)
    before = os.lstat(folder / name)
    place = folder if asked == "folders" else folder / "dsm.tif"
    with pytest.raises(WorkspaceError, match=rf"^'[^']*{name}' is a link, a pipe or a file [^(]* remove it"):
        with exclusive("pipeline", told(), **{asked: [str(place)]}):
            raise AssertionError("there is no lock to hold")
    assert precious.read_text() == "years of work"
    after = os.lstat(folder / name)
    assert (after.st_mode, after.st_ino, after.st_size) == (before.st_mode, before.st_ino, before.st_size)


@pytest.mark.parametrize("left", ("", '{"proc', '{"process": 12, "computer": "a", "stage": "pipeline", "since": ""}'))
def test_what_a_killed_run_has_left_is_a_lock(told, tmp_path, left):
    (tmp_path / ".repm.lock").write_text(left)
    with exclusive("pipeline", told(), folders=[str(tmp_path)]):
        assert f'"process": {os.getpid()}' in (tmp_path / ".repm.lock").read_text()
    assert os.listdir(tmp_path) == []
