"""EPT: every point of the cloud in exactly one node, where the octree says; what QGIS makes of it: tests/qgis."""

from __future__ import annotations

import datetime
import hashlib
import json
import os
import pathlib
from dataclasses import replace

import laspy
import numpy as np
import pytest

from repm_qgis.contracts.errors import Cancelled, EmptyResultError, WorkspaceError
from repm_qgis.runtime.progress import Silent
from repm_qgis.solids.ept import write_ept
from repm_qgis.solids.parameters import EptParameters
from repm_qgis.solids.point_cloud import created_cloud

CRS = "EPSG:32631"
ORIGIN = (654321.7, 4812345.2, 0.0)


def surface(count, seed=0, size=(400.0, 150.0)):
    """Points of hills and of a wall, in no order: more than one in many voxels."""
    numbers = np.random.default_rng(seed)
    x, y = numbers.uniform(0, 1, (2, count)) * np.array(size)[:, None]
    z = 80 + 10 * np.sin(x / 30) + np.where(numbers.uniform(size=count) < 0.1, numbers.uniform(0, 60, count), 0)
    return np.column_stack([x + ORIGIN[0], y + ORIGIN[1], z]), numbers.uniform(0, 1, count)


def cloud_of(path, points, score, crs=CRS):
    with created_cloud(str(path), crs, ORIGIN) as cloud:
        for part in np.array_split(np.arange(len(points)), 5):
            cloud.write(*points[part].T, score[part])
    return str(path)


def steps(path):
    """(N, 4) whole numbers that a LAS file stores: x, y, z and intensity; and its header."""
    with laspy.open(str(path)) as reader:
        found = reader.read()
        return np.column_stack([found.X, found.Y, found.Z, found.intensity]).astype(np.int64), reader.header


def read(folder):
    folder = pathlib.Path(folder)
    return (
        json.loads((folder / "ept.json").read_text()),
        json.loads((folder / "ept-hierarchy" / "0-0-0-0.json").read_text()),
        {path.stem: path for path in (folder / "ept-data").glob("*.laz")},
    )


def in_order(rows):
    return rows[np.lexsort(rows.T)]


def check(folder, cloud):
    """The whole specification, on one EPT; gives its nodes with their points."""
    about, hierarchy, files = read(folder)
    assert set(files) == set(hierarchy)
    low, side = np.array(about["bounds"][:3]), about["bounds"][3] - about["bounds"][0]
    np.testing.assert_allclose(np.array(about["bounds"][3:]) - low, side, atol=1e-9)
    nodes = {}
    for name, path in files.items():
        points, header = steps(path)
        assert len(points) == hierarchy[name] > 0
        assert str(header.version) == "1.2" and header.point_format.id == 3
        depth, *place = map(int, name.split("-"))
        corner = low + np.array(place) * side / 2**depth
        xyz = points[:, :3] * header.scales + header.offsets
        assert (xyz >= corner - 1e-6).all() and (xyz < corner + side / 2**depth - 1e-6).all(), name
        if depth:  # no node without its parent
            assert "-".join(map(str, (depth - 1, *(p >> 1 for p in place)))) in hierarchy
        nodes[name] = points
    ours, header = steps(cloud)
    np.testing.assert_array_equal(in_order(np.vstack(list(nodes.values()))), in_order(ours))  # none lost, none twice
    assert about["points"] == len(ours)
    xyz = ours[:, :3] * header.scales + header.offsets
    np.testing.assert_allclose(about["boundsConforming"], [*xyz.min(axis=0), *xyz.max(axis=0)], atol=1e-6)
    values = np.column_stack([xyz, ours[:, 3]])
    for axis, dimension in enumerate(about["schema"]):
        assert (dimension["count"], dimension["name"]) == (len(ours), ("X", "Y", "Z", "Intensity")[axis])
        for figure, function in (("minimum", np.min), ("maximum", np.max), ("mean", np.mean), ("stddev", np.std)):
            assert dimension[figure] == pytest.approx(function(values[:, axis]), abs=2e-6)
    return about, hierarchy, nodes


def digest(folder):
    found = hashlib.sha256()
    for path in sorted(pathlib.Path(folder).rglob("*")):
        if path.is_file():
            found.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return found.hexdigest()


def test_a_small_cloud_is_one_node(tmp_path):
    points, score = surface(5000)
    cloud = cloud_of(tmp_path / "c.laz", points, score)
    facts = write_ept(cloud, str(tmp_path / "ept"), CRS)
    about, hierarchy, nodes = check(tmp_path / "ept", cloud)
    assert hierarchy == {"0-0-0-0": 5000}
    assert (facts.points, facts.nodes) == (5000, 1)
    np.testing.assert_allclose(facts.height_range, np.percentile(points[:, 2], (2, 98)), atol=0.001)
    root = nodes["0-0-0-0"]
    with laspy.open(str(tmp_path / "ept" / "ept-data" / "0-0-0-0.laz")) as reader:
        header = reader.header
    xyz = root[:, :3] * header.scales + header.offsets
    nearest = np.abs(in_order(xyz) - in_order(np.round(points, 3)))
    assert nearest.max() < 0.00101  # to the millimetre
    assert about["srs"]["authority"] == "EPSG" and about["srs"]["horizontal"] == "32631"
    assert "vertical" not in about["srs"]
    assert sorted(os.listdir(tmp_path)) == ["c.laz", "ept"]
    assert sorted(os.listdir(tmp_path / "ept")) == ["ept-data", "ept-hierarchy", "ept.json"]


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """300000 points; with the sizes below they are parted twice, and one part is too large at first."""
    points, score = surface(200000)
    dense, more = surface(100000, 1, (20.0, 20.0))
    folder = tmp_path_factory.mktemp("large")
    return cloud_of(folder / "c.laz", np.vstack([points, dense]), np.hstack([score, more]))


SMALL = EptParameters(leaf=4000, batch=20000, chunk=30000)  # out of core with few points


@pytest.mark.long
def test_each_point_is_in_one_node_however_the_work_is_parted(tmp_path, large):
    write_ept(large, str(tmp_path / "parts"), CRS, parameters=SMALL)
    _, hierarchy, nodes = check(tmp_path / "parts", large)
    depths = [int(name.split("-")[0]) for name in hierarchy]
    assert len(hierarchy) > 50 and max(depths) >= 4
    write_ept(large, str(tmp_path / "whole"), CRS, parameters=replace(SMALL, batch=1 << 21))
    assert read(tmp_path / "whole")[1] == hierarchy
    for name, points in nodes.items():  # the same nodes, too
        np.testing.assert_array_equal(
            in_order(steps(tmp_path / "whole" / "ept-data" / f"{name}.laz")[0]), in_order(points)
        )


def test_a_node_with_children_has_one_point_a_voxel(tmp_path, large):
    write_ept(large, str(tmp_path / "e"), CRS, parameters=SMALL)
    about, hierarchy, nodes = check(tmp_path / "e", large)
    offset = np.array([dimension["offset"] for dimension in about["schema"][:3]])
    corner, opposite = (np.rint((np.array(about["bounds"][i : i + 3]) - offset) / 0.001).astype(int) for i in (0, 3))
    inner = {
        "-".join(map(str, (int(d) - 1, *(int(p) >> 1 for p in place))))
        for d, *place in (name.split("-") for name in hierarchy)
        if int(d)
    }
    assert len(inner) > 10
    for name in inner:
        voxel = (opposite - corner)[0] // 2 ** int(name.split("-")[0]) // about["span"]
        place = (nodes[name][:, :3] - corner) // voxel
        assert len(np.unique(place, axis=0)) == len(place), name


class Tomorrow(datetime.date):
    @classmethod
    def today(cls):
        return datetime.date.today() + datetime.timedelta(days=1)


def test_the_same_cloud_gives_the_same_bytes_tomorrow_too(tmp_path, large, monkeypatch):
    for name, day in (("a", datetime.date), ("b", Tomorrow)):
        monkeypatch.setattr(laspy.header, "date", day)
        write_ept(large, str(tmp_path / name), CRS, parameters=SMALL)
    assert digest(tmp_path / "a") == digest(tmp_path / "b")


def test_points_on_one_spot_and_a_single_point(tmp_path):
    for name, points in (
        ("one", np.array([[*ORIGIN]])),
        ("spot", np.tile([[*ORIGIN]], (100, 1))),
        ("far", np.vstack([np.tile([[*ORIGIN]], (50, 1)), [[ORIGIN[0] + 90000, ORIGIN[1], 9000.0]]])),
    ):
        cloud = cloud_of(tmp_path / f"{name}.laz", points, np.ones(len(points)))
        write_ept(cloud, str(tmp_path / name), CRS, parameters=EptParameters(leaf=10, batch=20))
        check(tmp_path / name, cloud)


def test_a_compound_crs_names_both_parts(tmp_path):
    from repm_qgis.geometry.vertical import HeightDatum

    points, score = surface(100)
    crs = HeightDatum.of("EGM96").file_crs(CRS)
    cloud = cloud_of(tmp_path / "c.laz", points, score, crs)
    write_ept(cloud, str(tmp_path / "e"), crs)
    srs = read(tmp_path / "e")[0]["srs"]
    assert (srs["authority"], srs["horizontal"], srs["vertical"]) == ("EPSG", "32631", "5773")
    assert srs["wkt"].startswith("COMPOUNDCRS[")


def test_an_older_ept_gives_way_and_another_folder_does_not(tmp_path):
    points, score = surface(300)
    cloud = cloud_of(tmp_path / "c.laz", points, score)
    folder = tmp_path / "e"
    folder.mkdir()  # QGIS may have made it
    write_ept(cloud, str(folder), CRS)
    (folder / "ept.qml").touch()
    write_ept(cloud, str(folder), CRS)
    check(folder, cloud)
    (folder / "thesis.odt").touch()
    with pytest.raises(WorkspaceError, match="thesis.odt"):
        write_ept(cloud, str(folder), CRS)
    assert (folder / "thesis.odt").exists() and (folder / "ept.json").exists()
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "e"):
        with pytest.raises(WorkspaceError):
            write_ept(cloud, str(place), CRS)


class FullDisk(Silent):
    """The disk is full when the work asks for the third time whether it is cancelled."""

    asked = 0

    def check_cancelled(self):
        self.asked += 1
        if self.asked == 3:
            raise OSError(28, "No space left on device")


def test_half_an_ept_never_stays(tmp_path, large, told):
    for cancel_at in (2, 12, 20):
        with pytest.raises(Cancelled):
            write_ept(large, str(tmp_path / "e"), CRS, told(cancel_at=cancel_at), SMALL)
        assert os.listdir(tmp_path) == []
    with pytest.raises(WorkspaceError, match="the disk is full"):
        write_ept(large, str(tmp_path / "e"), CRS, FullDisk(), SMALL)
    assert os.listdir(tmp_path) == []


def test_a_cloud_without_points(tmp_path):
    with created_cloud(str(tmp_path / "c.laz"), CRS, ORIGIN):
        pass
    with pytest.raises(EmptyResultError, match="no points"):
        write_ept(str(tmp_path / "c.laz"), str(tmp_path / "e"), CRS)
    assert os.listdir(tmp_path) == ["c.laz"]
