"""LAS and LAZ files read again by laspy."""

from __future__ import annotations

import os
import sys

import laspy
import numpy as np
import pytest

from repm_qgis.dsm.point_cloud import created_cloud
from repm_qgis.errors import MissingPackageError, OptionError, WorkspaceError

ORIGIN = (654321.0, 4812345.0, 0.0)


def points(count=5000):
    return (np.random.default_rng(0).uniform(-1, 1, (count, 3)) * [4000, 3000, 900] + [*ORIGIN[:2], 1000]).T


@pytest.mark.parametrize("extension", (".las", ".laz", ".LAZ"))
def test_points_come_back_to_the_millimetre(tmp_path, extension):
    x, y, z = points()
    score = np.linspace(0, 1, len(x))
    path = str(tmp_path / f"a{extension}")
    with created_cloud(path, "EPSG:32631", ORIGIN) as cloud:
        for part in np.array_split(np.arange(len(x)), 3):
            cloud.write(x[part], y[part], z[part], score[part])
        cloud.write(*np.empty((4, 0)))
        assert cloud.count == len(x)
    with laspy.open(path) as reader:
        header, found = reader.header, reader.read()
    assert str(header.version) == "1.4" and header.point_format.id == 6 and header.point_count == len(x)
    for ours, theirs in ((x, found.x), (y, found.y), (z, found.z)):
        assert np.abs(np.asarray(theirs) - ours).max() < 0.00051
    np.testing.assert_allclose(np.asarray(found.intensity) / 65535, score, atol=1e-4)
    assert header.parse_crs().to_epsg() == 32631
    np.testing.assert_allclose(header.mins, [x.min(), y.min(), z.min()], atol=0.001)
    assert os.listdir(tmp_path) == [f"a{extension}"]
    with open(path, "rb") as stream:  # compressed is compressed
        size = len(stream.read())
    assert (size < 25 * len(x)) == (extension.lower() == ".laz")


@pytest.mark.parametrize("name", ("a.ply", "a.xyz", "a", "a.laz.txt"))
def test_other_formats_are_refused_before_anything_is_written(tmp_path, name):
    with pytest.raises(OptionError) as caught, created_cloud(str(tmp_path / name), "EPSG:32631", ORIGIN):
        pass
    assert "CLOUD" in str(caught.value) and "must end with .laz or .las" in str(caught.value)
    assert os.listdir(tmp_path) == []


def test_an_exception_leaves_nothing(tmp_path):
    with pytest.raises(KeyError), created_cloud(str(tmp_path / "a.laz"), "EPSG:32631", ORIGIN) as cloud:
        cloud.write(*points(), np.ones(5000))
        raise KeyError
    assert os.listdir(tmp_path) == []


def test_where_it_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.laz").mkdir()
    for path in (str(tmp_path / "file" / "a.laz"), str(tmp_path / "folder.laz")):
        with pytest.raises(WorkspaceError), created_cloud(path, "EPSG:32631", ORIGIN) as cloud:
            cloud.write(*points(), np.ones(5000))
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.laz"]


def test_without_laspy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "laspy", None)
    with (
        pytest.raises(MissingPackageError, match="laspy.*Plugins > REPM.*or leave CLOUD empty"),
        created_cloud(str(tmp_path / "a.laz"), "EPSG:32631", ORIGIN),
    ):
        pass
    assert os.listdir(tmp_path) == []
