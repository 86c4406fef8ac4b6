"""Whole files or none, and fingerprints."""

from __future__ import annotations

import errno
import os
import subprocess
import sys

import pytest

from repm_qgis import workspace
from repm_qgis.errors import WorkspaceError
from repm_qgis.workspace import (
    drop_temporary,
    ensure_folder,
    file_identity,
    fingerprint,
    recover_folder,
    temporary_name,
    whole_file,
    whole_folder,
    write_text,
)


def test_text_is_written_whole(tmp_path):
    path = str(tmp_path / "new" / "a.txt")
    assert write_text(path, "Höhe 3 µm\n") == path
    assert open(path, encoding="utf-8").read() == "Höhe 3 µm\n"
    write_text(path, "other")
    assert open(path, encoding="utf-8").read() == "other" and os.listdir(tmp_path / "new") == ["a.txt"]


def test_what_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("kept")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "file" / "a.txt", tmp_path / "folder", "/proc/nowhere/a.txt"):
        with pytest.raises(WorkspaceError) as caught:
            write_text(str(path), "text")
        assert "Cannot write" in str(caught.value) and "choose another" in str(caught.value)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"] and (tmp_path / "file").read_text() == "kept"
    for path in (tmp_path / "file", tmp_path / "file" / "deep", "/proc/nowhere"):
        with pytest.raises(WorkspaceError):
            ensure_folder(str(path))


def test_temporary_names_lie_beside_keep_the_extension_and_are_never_shared(tmp_path):
    path = str(tmp_path / "a" / "dsm.tif")
    names = [temporary_name(path) for _ in range(3)]
    assert all(os.path.dirname(name) == str(tmp_path / "a") and name.endswith(".tif") for name in names)
    assert all(os.path.basename(name).startswith(".dsm.part-") for name in names) and len(set(names)) == 3


def of_another_process(path, process):
    """A temporary file as another process of this machine would name it."""
    words = os.path.basename(temporary_name(path)).split("-")
    words[2] = str(process)
    return os.path.join(os.path.dirname(path), "-".join(words))


def test_what_dead_processes_have_left_goes_and_what_living_ones_write_stays(tmp_path):
    path = str(tmp_path / "dsm.tif")
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    dead, alive = of_another_process(path, ended.pid), of_another_process(path, os.getppid())
    elsewhere = str(tmp_path / ".dsm.part-0badcafe-1-00.tif")
    for name in (dead, alive, elsewhere, str(tmp_path / "dsm2.tif")):
        with open(name, "w", encoding="utf-8") as stream:
            stream.write("half")
    drop_temporary(path)
    drop_temporary(path)
    assert sorted(os.listdir(tmp_path)) == sorted(map(os.path.basename, (alive, elsewhere, "dsm2.tif")))


def test_links_stay_links_and_devices_stay_devices(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "a.txt").write_text("old")
    (tmp_path / "a.txt").symlink_to(tmp_path / "disk" / "a.txt")
    write_text(str(tmp_path / "a.txt"), "new")
    assert (tmp_path / "a.txt").is_symlink() and (tmp_path / "disk" / "a.txt").read_text() == "new"
    os.mkfifo(tmp_path / "pipe")
    for path in (str(tmp_path / "pipe"), os.devnull):
        with pytest.raises(WorkspaceError, match="is a device or a pipe, not a file"):
            write_text(path, "text")
    assert (tmp_path / "pipe").is_fifo() and not os.path.isfile(os.devnull)


@pytest.mark.parametrize("exchange", (True, False))
def test_a_folder_takes_the_place_of_another_and_a_killed_swap_is_put_right(tmp_path, exchange, monkeypatch):
    if not exchange:  # as on Windows, and on file systems that cannot exchange two names
        monkeypatch.setattr(workspace.ctypes, "CDLL", lambda *_, **__: object())
    place = tmp_path / "ept"
    for text in ("old", "new"):
        with whole_folder(str(place)) as folder:
            (folder / "a").write_text(text)
    assert (place / "a").read_text() == "new" and os.listdir(tmp_path) == ["ept"]
    os.replace(place, tmp_path / ".ept.aside")  # what a kill between the two steps leaves
    recover_folder(str(place))
    assert (place / "a").read_text() == "new" and os.listdir(tmp_path) == ["ept"]
    with pytest.raises(WorkspaceError), whole_folder(str(place)) as folder:
        (folder / "a").write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert (place / "a").read_text() == "new" and os.listdir(tmp_path) == ["ept"]


def test_a_full_disk_is_named_with_what_is_free(tmp_path):
    with pytest.raises(WorkspaceError, match=r"'.*a\.txt': the disk is full \([\d.]+ MiB free\): free some space"):
        with whole_file(str(tmp_path / "a.txt")):
            raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(WorkspaceError, match="too many open files"), whole_file(str(tmp_path / "a.txt")):
        raise OSError(errno.EMFILE, "Too many open files")


def test_fingerprints_tell_changes(tmp_path):
    assert fingerprint("a", {"x": 1, "y": 2}) == fingerprint("a", {"y": 2, "x": 1})
    assert fingerprint("a", {"x": 1}) != fingerprint("a", {"x": 2}) != fingerprint("b", {"x": 2})
    path = tmp_path / "a"
    path.write_text("12")
    first = file_identity(str(path))
    assert first == file_identity(str(path))
    path.write_text("123")
    assert file_identity(str(path)) != first
    assert file_identity(str(tmp_path / "gone")) == [str(tmp_path / "gone")]
