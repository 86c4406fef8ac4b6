"""Whole files or none, and fingerprints."""

from __future__ import annotations

import errno
import os
import re
import stat
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from repm_qgis.contracts.errors import WorkspaceError
from repm_qgis.imagery.raster import write as write_raster
from repm_qgis.runtime import workspace
from repm_qgis.runtime.workspace import (
    drop_temporaries,
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
from repm_qgis.stages import run_stage


def test_text_is_written_whole(tmp_path):
    path = str(tmp_path / "new" / "a.txt")
    assert write_text(path, "Höhe 3 µm\n") == path
    assert open(path, encoding="utf-8").read() == "Höhe 3 µm\n"
    write_text(path, "other")
    assert open(path, encoding="utf-8").read() == "other" and os.listdir(tmp_path / "new") == ["a.txt"]


def test_a_folder_that_another_run_has_just_removed_is_made_again(tmp_path, monkeypatch):
    """A run that is refused removes the folder that it made: in the moment between this run's folder and its file."""
    made, removals = workspace.tempfile.TemporaryFile, []

    def removed_before(**named):
        if len(removals) < 2:
            os.rmdir(tmp_path / "w")
            removals.append(True)
        return made(**named)

    monkeypatch.setattr(workspace.tempfile, "TemporaryFile", removed_before)
    assert ensure_folder(str(tmp_path / "w")).is_dir() and len(removals) == 2


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


def test_a_temporary_name_says_machine_and_process(tmp_path):
    name = os.path.basename(temporary_name(str(tmp_path / "dsm.tif")))
    assert re.fullmatch(rf"\.dsm\.part-[0-9a-f]{{8}}-{os.getpid()}-[0-9a-f]{{8}}\.tif", name)


def test_the_sentence_of_a_full_disk_says_how_much_was_written(tmp_path):
    full = OSError(errno.ENOSPC, "No space left on device")
    sentence = str(workspace.cannot_write(str(tmp_path / "a"), full, 5 << 20))
    assert re.search(r"\([\d.]+ MiB free, more than 5\.0 MiB needed\): free some space", sentence)
    assert "needed" not in str(workspace.cannot_write(str(tmp_path / "a"), full))


def test_what_a_library_could_not_write_is_asked_of_the_disk(tmp_path, monkeypatch):
    """A mebibyte is tried, in the half-written file or beside it."""
    (tmp_path / "half").write_bytes(b"")
    assert workspace._obstacle(str(tmp_path / "half")) is None and workspace._obstacle(str(tmp_path)) is None
    assert os.path.getsize(tmp_path / "half") == 2**20 and os.listdir(tmp_path) == ["half"]
    path = str(tmp_path / "a.tif")
    assert "(TIFF is sad)" in str(workspace.not_written(path, "TIFF is sad"))
    assert "(no reason given)" in str(workspace.not_written(path, ""))
    with pytest.raises(ValueError, match="^mine$"), workspace.writing(path):
        raise ValueError("mine")

    def refuse(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(workspace.os, "fsync", refuse)
    assert "the disk is full" in str(workspace.not_written(path, "TIFF is sad"))
    with pytest.raises(WorkspaceError, match="the disk is full"), workspace.writing(path):
        raise ValueError("mine")


def of_another_process(path, process):
    """A temporary file as another process of this machine would name it."""
    words = os.path.basename(temporary_name(path)).split("-")
    words[2] = str(process)
    return os.path.join(os.path.dirname(path), "-".join(words))


def test_what_dead_processes_have_left_goes_and_what_living_ones_write_stays(tmp_path):
    path = str(tmp_path / "dsm.tif")
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    running = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    dead, alive = of_another_process(path, ended.pid), of_another_process(path, running.pid)
    elsewhere = str(tmp_path / ".dsm.part-0badcafe-1-00.tif")
    for name in (dead, alive, elsewhere, str(tmp_path / "dsm2.tif")):
        with open(name, "w", encoding="utf-8") as stream:
            stream.write("half")
    other = of_another_process(str(tmp_path / "tile.json"), ended.pid)
    with open(other, "w", encoding="utf-8") as stream:
        stream.write("half")
    drop_temporary(path)
    drop_temporary(path)
    kept = [os.path.basename(name) for name in (alive, elsewhere, "dsm2.tif")]
    assert sorted(os.listdir(tmp_path)) == sorted([*kept, os.path.basename(other)])
    drop_temporaries(str(tmp_path))
    assert sorted(os.listdir(tmp_path)) == sorted(kept)
    running.communicate(b"\n")


def test_a_file_that_a_scanner_has_open_for_a_moment_is_replaced_a_little_later(tmp_path, monkeypatch):
    """As on Windows; the sharing violation of winerror.h."""
    left, real = [3], os.replace

    def busy(source, target):
        left[0] -= 1
        if left[0] > 0:
            error = PermissionError(13, "The process cannot access the file")
            error.winerror = 32
            raise error
        real(source, target)

    monkeypatch.setattr(os, "replace", busy)
    write_text(str(tmp_path / "a.txt"), "new")
    assert (tmp_path / "a.txt").read_text() == "new" and left == [0]


def test_another_error_of_a_name_is_said_at_once(tmp_path, monkeypatch):
    tries = []

    def refused(source, target):
        tries.append(target)
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refused)
    with pytest.raises(WorkspaceError, match=r"Cannot write '.*a.txt' \(Permission denied\): choose another place"):
        write_text(str(tmp_path / "a.txt"), "new")
    assert len(tries) == 1 and not list(tmp_path.iterdir())


def test_text_has_the_same_bytes_on_every_system(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "linesep", "\r\n")
    opened = []
    monkeypatch.setattr(
        "builtins.open", lambda *words, _open=open, **more: opened.append(more) or _open(*words, **more)
    )
    write_text(str(tmp_path / "a.txt"), "one\ntwo\n")
    assert opened[0]["newline"] == "\n" and (tmp_path / "a.txt").read_bytes() == b"one\ntwo\n"


@pytest.mark.skipif(os.name == "nt", reason="Windows knows neither pipes with names nor links for everybody")
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


def without_exchange(monkeypatch, failure=None):
    """As on Windows: names cannot be exchanged; and with a failure, the second renaming of a swap meets it."""
    monkeypatch.setattr(workspace, "_exchange", lambda *_: False)
    replace, seen = os.replace, []

    def watched(source, target):
        seen.append(os.path.basename(target))
        if failure is not None and len(seen) == 2:
            raise failure
        replace(source, target)

    monkeypatch.setattr(workspace.os, "replace", watched)
    return seen


def swapped(place):
    with whole_folder(str(place)) as folder:
        (folder / "a").write_text("new")


@pytest.fixture
def older(tmp_path):
    (tmp_path / "ept").mkdir()
    (tmp_path / "ept" / "a").write_text("old")
    return tmp_path / "ept"


def test_a_swap_without_exchange_puts_the_older_folder_aside_first(older, monkeypatch):
    names = without_exchange(monkeypatch)
    swapped(older)
    assert names == [".ept.aside", "ept"] and (older / "a").read_text() == "new"
    assert os.listdir(older.parent) == ["ept"]


def test_a_swap_that_fails_halfway_leaves_the_older_folder(older, monkeypatch):
    without_exchange(monkeypatch, OSError(errno.EACCES, "Permission denied"))
    with pytest.raises(WorkspaceError, match=r"Cannot write '.*ept' \(Permission denied\)"):
        swapped(older)
    assert (older / "a").read_text() == "old" and os.listdir(older.parent) == ["ept"]


def test_a_swap_that_is_killed_halfway_leaves_the_older_folder_to_the_next_run(older, monkeypatch):
    without_exchange(monkeypatch, KeyboardInterrupt())  # nothing in the way of it, as of a kill
    with pytest.raises(KeyboardInterrupt):
        swapped(older)
    assert (older.parent / ".ept.aside" / "a").read_text() == "old"
    with pytest.raises(OSError), whole_folder(str(older)):  # the next run finds the older folder, even if it fails too
        raise OSError(errno.EIO, "Input/output error")
    assert (older / "a").read_text() == "old" and os.listdir(older.parent) == ["ept"]


def test_a_backup_beside_the_newer_folder_goes(older):
    """A kill between the second renaming and the removal: the folder of that name is whole, and newer."""
    (older.parent / ".ept.aside").mkdir()
    recover_folder(str(older))
    assert (older / "a").read_text() == "old" and os.listdir(older.parent) == ["ept"]


def test_a_full_disk_is_named_with_what_is_free(tmp_path):
    with pytest.raises(WorkspaceError, match=r"'.*a\.txt': the disk is full \([\d.]+ MiB free\): free some space"):
        with whole_file(str(tmp_path / "a.txt")):
            raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(WorkspaceError, match="too many open files"), whole_file(str(tmp_path / "a.txt")):
        raise OSError(errno.EMFILE, "Too many open files")


@pytest.mark.parametrize("fact", ("st_size", "st_mtime_ns", "st_ino", "st_ctime_ns"))
def test_each_fact_alone_tells_a_changed_file(tmp_path, fact, monkeypatch):
    """On a disk they mostly change together: here one at a time."""
    path = str(tmp_path / "a.tif")
    facts = {"st_size": 5, "st_mtime_ns": 10**18, "st_ino": 77, "st_ctime_ns": 10**18}
    found = []
    for changed in (facts, dict(facts), {**facts, fact: facts[fact] + 1}):
        with monkeypatch.context() as patch:
            patch.setattr(workspace.os, "stat", lambda _, now=changed: SimpleNamespace(**now))
            found.append(file_identity(path))
    assert found[0] == found[1] != found[2]
    (tmp_path / "b.tif").write_text("x")
    os.link(tmp_path / "b.tif", tmp_path / "c.tif")
    assert file_identity(str(tmp_path / "b.tif")) != file_identity(str(tmp_path / "c.tif"))


def test_free_space_is_that_of_the_nearest_folder_and_may_be_unknown(tmp_path, monkeypatch):
    asked = []

    def usage(place):
        asked.append(place)
        return SimpleNamespace(free=5 * 1024 * 1024)

    monkeypatch.setattr(workspace.shutil, "disk_usage", usage)
    assert workspace.free_bytes(str(tmp_path / "not" / "yet" / "a.tif")) == 5 << 20 and asked == [str(tmp_path)]
    full = OSError(errno.ENOSPC, "No space left on device")
    assert "(5.0 MiB free)" in str(workspace.cannot_write(str(tmp_path / "a"), full))

    def refuse(_):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(workspace.shutil, "disk_usage", refuse)
    assert workspace.free_bytes(str(tmp_path)) is None


def test_another_users_process_exists(monkeypatch):
    assert workspace.process_exists(os.getpid())
    if os.name == "nt":  # where a signal would end it: its handle is asked
        return

    def refuse(number, signal):
        assert signal == 0
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(workspace.os, "kill", refuse)
    assert workspace.process_exists(77)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="renameat2 is Linux's")
def test_linux_exchanges_two_folders_in_one_step(tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / name).touch()
    assert workspace._exchange(tmp_path / "a", tmp_path / "b")
    assert os.listdir(tmp_path / "a") == ["b"] and os.listdir(tmp_path / "b") == ["a"]
    assert not workspace._exchange(tmp_path / "a", tmp_path / "none")


@pytest.fixture
def ending(monkeypatch):
    """As if this process wrote nothing else, so that it may remove all that it writes."""
    monkeypatch.setattr(workspace, "_own_temporaries", set())


def test_a_name_that_cannot_be_taken_is_said(tmp_path, ending):
    temporary = workspace.temporary_name(str(tmp_path / "a.txt"))
    with open(temporary, "w", encoding="utf-8") as stream:
        stream.write("text")
    (tmp_path / "folder").mkdir()
    with pytest.raises(WorkspaceError, match=r"Cannot write '.*folder' \(Is a directory\): choose another place"):
        workspace.take_name(temporary, str(tmp_path / "folder"))
    workspace.remove_own_temporaries()
    assert os.listdir(tmp_path) == ["folder"]


def test_what_a_process_is_writing_goes_with_it(tmp_path, ending):
    whole, half, folder = (workspace.temporary_name(str(tmp_path / name)) for name in ("a.txt", "b.txt", "c"))
    for name in (whole, half):
        with open(name, "w", encoding="utf-8") as stream:
            stream.write("text")
    os.makedirs(os.path.join(folder, "deep"))
    workspace.take_name(whole, str(tmp_path / "a.txt"))
    workspace.remove_own_temporaries()
    assert os.listdir(tmp_path) == ["a.txt"]


@pytest.mark.parametrize(
    "number, passes", ((errno.EINVAL, True), (errno.ENOTSUP, True), (errno.EROFS, True), (errno.EIO, False))
)
def test_file_systems_that_know_no_fsync(tmp_path, number, passes, monkeypatch):
    def refuse(_):
        raise OSError(number, "fsync failed")

    monkeypatch.setattr(workspace.os, "fsync", refuse)
    if passes:
        write_text(str(tmp_path / "a.txt"), "text")
        assert os.listdir(tmp_path) == ["a.txt"]
    else:
        with pytest.raises(WorkspaceError, match="fsync failed"):
            write_text(str(tmp_path / "a.txt"), "text")
        assert os.listdir(tmp_path) == []


@pytest.mark.skipif(not hasattr(os, "statvfs"), reason="Windows does not tell of inodes")
def test_a_disk_without_inodes_is_said(tmp_path, monkeypatch):
    full = OSError(errno.ENOSPC, "No space left on device")
    there = os.statvfs(tmp_path)
    for files, left, words in ((1000, 0, "takes no more files"), (0, 0, "the disk is full"), (9, 1, "is full")):
        status = SimpleNamespace(
            f_files=files,
            f_favail=left,
            f_bavail=there.f_bavail,
            f_frsize=there.f_frsize,
            f_blocks=there.f_blocks,
            f_bfree=there.f_bfree,
        )
        monkeypatch.setattr(os, "statvfs", lambda path, status=status: status)
        assert words in str(workspace.cannot_write(str(tmp_path / "a.tif"), full))


def test_what_a_library_could_not_write_is_a_full_disk_though_it_has_space_again(tmp_path):
    said = str(workspace.not_written(str(tmp_path / "a.tif"), "TIFFAppendToStrip:Write error at scanline 17"))
    assert "the disk did not take all of it (TIFFAppendToStrip:Write error at scanline 17; " in said
    assert "free some space, or choose a place on another disk" in said
    assert "(no driver): choose another place" in str(workspace.not_written(str(tmp_path / "a.tif"), "no driver"))


def test_a_quota_is_a_full_disk(tmp_path):
    with pytest.raises(WorkspaceError, match="the disk is full"), whole_file(str(tmp_path / "a.txt")):
        raise OSError(errno.EDQUOT, "Disk quota exceeded")


def test_a_temporary_folder_lives_within_the_block(tmp_path):
    with pytest.raises(ValueError), workspace.temporary_folder(str(tmp_path / "work")) as folder:
        assert os.path.isdir(folder) and os.path.dirname(folder) == str(tmp_path)
        (tmp_path / os.path.basename(folder) / "a").write_text("text")
        raise ValueError
    assert os.listdir(tmp_path) == []


def test_errors_of_the_engine_stay_what_they_are(tmp_path):
    for block in (whole_file, whole_folder):
        with pytest.raises(WorkspaceError, match="^mine$"), block(str(tmp_path / "a")):
            raise WorkspaceError("mine")
    assert os.listdir(tmp_path) == []


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


@pytest.mark.skipif(os.name == "nt", reason="Windows keeps permissions with the folder")
@pytest.mark.parametrize("mode", (0o600, 0o640, 0o664, 0o400))
def test_what_replaces_a_file_has_its_permissions(tmp_path, mode):
    """Of a text, a raster and a folder; files of new names have what the umask says."""
    text, raster, folder = tmp_path / "a.txt", tmp_path / "a.tif", tmp_path / "ept"
    for place in (text, raster):
        place.write_text("old")
        place.chmod(mode)
    folder.mkdir(mode=mode | 0o300)
    folder.chmod(mode | 0o300)
    write_text(str(text), "new")
    write_raster(str(raster), [np.ones((4, 4), np.float32)], None, "")
    with whole_folder(str(folder)) as whole:
        (whole / "a").write_text("new")
    found = [stat.S_IMODE(place.stat().st_mode) for place in (text, raster, folder)]
    assert found == [mode, mode, mode | 0o300]
    assert text.read_text() == "new" and raster.stat().st_size > 100 and (folder / "a").read_text() == "new"
    write_text(str(tmp_path / "b.txt"), "new")
    (tmp_path / "c.txt").write_text("new")
    assert (tmp_path / "b.txt").stat().st_mode == (tmp_path / "c.txt").stat().st_mode


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
@pytest.mark.parametrize("name", ("report.html", "scene.json", "equivalent_error.html", "refinement.html"))
@pytest.mark.long
def test_a_link_that_came_with_a_workspace_is_replaced_and_not_followed(urban, told, tmp_path, name):
    precious, workspace_folder = tmp_path / "precious", tmp_path / "received"
    precious.write_text("years of work")
    workspace_folder.mkdir()
    (workspace_folder / name).symlink_to(precious)
    (tmp_path / "disk.tif").write_text("old")
    (tmp_path / "dsm.tif").symlink_to(tmp_path / "disk.tif")
    job = {"images": urban.images[:2], "workspace": str(workspace_folder), "output": str(tmp_path / "dsm.tif")}
    range_m = {"altitude_min": urban.height_range[0], "altitude_max": urban.height_range[1]}
    run_stage("pipeline", {**job, **range_m, "resolution": 2.0, "workers": 1}, told())
    assert precious.read_text() == "years of work"
    assert (workspace_folder / name).is_file() and not (workspace_folder / name).is_symlink()
    assert (tmp_path / "dsm.tif").is_symlink() and (tmp_path / "disk.tif").stat().st_size > 1000  # which a user named


def test_a_path_that_is_too_long_for_windows_is_said(tmp_path, monkeypatch):
    """Windows says no more of it than that nothing is there."""
    monkeypatch.setattr(workspace, "_LONGEST_PATH", 210)
    deep = tmp_path / ("a" * 100) / ("b" * 100)

    def refuse(self, *_, **__):
        raise FileNotFoundError(errno.ENOENT, "The system cannot find the path specified")

    monkeypatch.setattr(workspace.Path, "mkdir", refuse)
    words = rf"the path has {len(str(deep))} characters, and Windows takes 259.*choose a shorter place"
    with pytest.raises(WorkspaceError, match=words):
        ensure_folder(str(deep))
    with pytest.raises(WorkspaceError, match="Cannot write into the folder"):
        ensure_folder("short")
