"""Whole files or none, and fingerprints."""

from __future__ import annotations

import os

import pytest

from repm_qgis.errors import WorkspaceError
from repm_qgis.workspace import drop_temporary, ensure_folder, file_identity, fingerprint, temporary_name, write_text


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


def test_temporary_names_lie_beside_and_keep_the_extension(tmp_path):
    name = temporary_name(str(tmp_path / "a" / "dsm.tif"))
    assert os.path.dirname(name) == str(tmp_path / "a") and name.endswith(".tif") and os.path.basename(name)[0] == "."
    assert temporary_name(str(tmp_path / "a" / "dsm.tif")) == name


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


def test_what_is_left_of_a_file_can_be_dropped(tmp_path):
    path = str(tmp_path / "dsm.tif")
    with open(temporary_name(path), "w", encoding="utf-8") as stream:
        stream.write("half")
    drop_temporary(path)
    drop_temporary(path)
    assert os.listdir(tmp_path) == []
