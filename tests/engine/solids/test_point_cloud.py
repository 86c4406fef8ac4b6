"""LAS and LAZ files read again by laspy."""

from __future__ import annotations

import os
import sys

import laspy
import numpy as np
import pyproj
import pytest

from repm_qgis.contracts.errors import MissingPackageError, OptionError, WorkspaceError
from repm_qgis.solids.ply import header
from repm_qgis.solids.point_cloud import created_cloud

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


@pytest.mark.parametrize("name", ("a.ply.gz", "a.xyz", "a", "a.laz.txt"))
def test_other_formats_are_refused_before_anything_is_written(tmp_path, name):
    with pytest.raises(OptionError) as caught, created_cloud(str(tmp_path / name), "EPSG:32631", ORIGIN):
        pass
    assert "CLOUD" in str(caught.value) and "must end with .laz, .las or .ply" in str(caught.value)
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


def read_ply(path):
    """The header's lines, and the points as records."""
    data = open(path, "rb").read()
    head, body = data.split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    kinds = {"double": "<f8", "float": "<f4", "uchar": "u1"}
    fields = [(line.split()[2], kinds[line.split()[1]]) for line in lines if line.startswith("property")]
    return lines, np.frombuffer(body, np.dtype(fields))


@pytest.mark.parametrize("coloured", (False, True))
@pytest.mark.parametrize("normals", (False, True))
def test_ply_has_all_of_the_points(tmp_path, coloured, normals):
    x, y, z = points(999)
    score, path = np.linspace(0, 1, 999), str(tmp_path / "a.PLY")
    colours = np.random.default_rng(1).integers(0, 1 << 16, (999, 3)).astype(np.uint16)
    turned = np.tile([0.6, 0.0, 0.8], (999, 1))
    with created_cloud(path, "EPSG:32631", ORIGIN, coloured, normals, "EGM96 geoid") as cloud:
        for part in np.array_split(np.arange(999), 3):
            more = colours[part] if coloured else None, turned[part] if normals else None
            cloud.write(x[part], y[part], z[part], score[part], *more)
    lines, found = read_ply(path)
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"] and "element vertex 999" in lines
    assert "comment heights: metres above the EGM96 geoid" in lines
    assert any(line.startswith("comment crs: PROJCRS") or line.startswith("comment crs: PROJCS") for line in lines)
    assert len(found) == 999
    assert all(np.array_equal(found[name], values) for name, values in zip("xyz", (x, y, z)))
    np.testing.assert_allclose(found["score"], score, atol=1e-6)
    assert ("red" in found.dtype.names) == coloured and ("nx" in found.dtype.names) == normals
    if coloured:
        assert np.array_equal(found["green"], colours[:, 1] >> 8)
    if normals:
        np.testing.assert_allclose(found["nz"], 0.8, atol=1e-6)
    assert os.listdir(tmp_path) == ["a.PLY"]


@pytest.mark.parametrize("name", ("a.las", "a.laz"))
def test_normals_are_extra_bytes_that_compress(tmp_path, name):
    turned = np.random.default_rng(2).normal(size=(5000, 3)) * [0.1, 0.1, 0] + [0, 0, 1]
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    sizes = []
    for normals in (None, turned):
        with created_cloud(str(tmp_path / name), "EPSG:32631", ORIGIN, normals=normals is not None) as cloud:
            cloud.write(*points(), np.ones(5000), normals=normals)
        sizes.append((tmp_path / name).stat().st_size)
    las = laspy.read(tmp_path / name)
    assert list(las.point_format.extra_dimension_names) == ["NormalX", "NormalY", "NormalZ"]
    found = np.column_stack([las[f"Normal{axis}"] for axis in "XYZ"])
    assert np.abs(found - turned).max() <= 0.5 / 256 + 1e-6
    assert (sizes[1] - sizes[0]) / 5000 < (13 if name.endswith("s") else 5)


@pytest.mark.parametrize("crs", ("EPSG:32631", "EPSG:32631+5773", "EPSG:6346+6360", "EPSG:25832+7837"))
def test_no_line_of_a_ply_is_longer_than_readers_take(tmp_path, crs):
    """CloudCompare 2.11 ends with "buffer overflow detected" at a line of 1024 bytes."""
    path = str(tmp_path / "a.ply")
    with created_cloud(path, crs, ORIGIN) as cloud:
        cloud.write(*points(), np.ones(5000))
    lines, _ = read_ply(path)
    assert max(len(line.encode()) for line in lines) < 1024
    (named,) = (line.split(": ", 1)[1] for line in lines if line.startswith("comment crs: "))
    assert pyproj.CRS.from_wkt(named).equals(pyproj.CRS(crs), ignore_axis_order=True)


def test_a_long_compound_crs_leaves_its_vertical_part_to_the_heights():
    whole = pyproj.CRS("EPSG:32631+5773").to_wkt().replace("EGM96 height", "EGM96 height" + 600 * "x")
    line = next(one for one in header(whole, "EGM96 geoid", []).decode().splitlines() if "crs" in one)
    assert len(line) < 1024 and pyproj.CRS.from_wkt(line.split(": ", 1)[1]).to_epsg() == 32631


def test_ply_needs_no_laspy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "laspy", None)
    with created_cloud(str(tmp_path / "a.ply"), "EPSG:32631", ORIGIN) as cloud:
        cloud.write(*points(), np.ones(5000))
    assert len(read_ply(str(tmp_path / "a.ply"))[1]) == 5000
