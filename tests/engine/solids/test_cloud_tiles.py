"""3-D Tiles of a point cloud, compared with its LAZ file by laspy and PROJ, and read by other programs."""

from __future__ import annotations

import hashlib
import json
import os
import struct
from dataclasses import replace

import laspy
import numpy as np
import pyproj
import pytest
from pyproj import Transformer
from scipy.spatial import cKDTree

from repm_qgis.contracts.errors import Cancelled, EmptyResultError, ImageError, OptionError, WorkspaceError
from repm_qgis.contracts.results import Tiles3dResult
from repm_qgis.solids.cloud_tiles import write_cloud_tiles
from repm_qgis.solids.parameters import SOLIDS, EptParameters
from repm_qgis.solids.point_cloud import created_cloud
from repm_qgis.stages import run_stage
from tests.browser import PROGRAM
from tests.tilesets import drawn_by_cesium, entries, enu, gltf_issues, read_glb

COUNT, WEST, SOUTH = 60_000, 654_321.0, 4_812_345.0
SMALL = replace(SOLIDS, ept=EptParameters(leaf=1000, batch=5000, chunk=7000))  # out of core with few points


def town(count=COUNT, seed=0):
    """(N, 3) points of hills and of walls, in no order, a tenth of them on a small place: deep in the octree."""
    numbers = np.random.default_rng(seed)
    x, y = numbers.uniform(0, 1, (2, count)) * [[400.0], [150.0]]
    x[::10], y[::10] = 200 + x[::10] / 40, 60 + y[::10] / 40
    z = 80 + 10 * np.sin(x / 30) + np.where(numbers.uniform(size=count) < 0.1, numbers.uniform(0, 60, count), 0)
    return np.column_stack([x + WEST, y + SOUTH, z])


def write(path, xyz, crs="EPSG:32631", colours=None, classes=0, scale=0.001, kind=7):
    """A LAZ file whose intensities are the points' numbers."""
    header = laspy.LasHeader(point_format=kind if colours is not None else 6, version="1.4")
    header.scales, header.offsets = [scale, scale, 0.001], np.floor(xyz[0])
    if crs:
        header.add_crs(pyproj.CRS.from_user_input(crs))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = xyz.T
    cloud.intensity = np.arange(len(xyz))
    cloud.classification = np.broadcast_to(classes, len(xyz))
    if colours is not None:
        cloud.red, cloud.green, cloud.blue = colours.T
    cloud.write(str(path))
    return str(path)


def shades(count=COUNT):
    return np.random.default_rng(1).integers(0, 65536, (count, 3)).astype(np.uint16)


def read(folder):
    """The tileset, and for each tile its entry, the entry above, and of its points the numbers, (N, 3) east, north, up
    and (N, 4) colours."""
    tileset, tiles = json.loads((folder / "tileset.json").read_text()), []
    for entry, above in entries(tileset["root"]):
        document, _, (place, colour, intensity) = read_glb(folder / entry["content"]["uri"])
        assert document["meshes"][0]["primitives"][0]["mode"] == 0  # points
        xyz = enu(place.astype(float) + document["nodes"][0]["translation"])
        tiles.append((entry, above, np.rint(intensity[:, 0].astype(float) * 65535).astype(int), xyz, colour))
    return tileset, tiles


def in_order(tileset, tiles):
    """The points of all tiles by their numbers: (N, 3) geocentric coordinates and (N, 4) colours."""
    numbers, xyz, colours = (np.concatenate([tile[part] for tile in tiles]) for part in (2, 3, 4))
    order = np.argsort(numbers)
    np.testing.assert_array_equal(numbers[order], np.arange(len(numbers)), err_msg="each point is in one tile")
    matrix = np.array(tileset["root"]["transform"]).reshape(4, 4).T
    return (xyz @ matrix[:3, :3].T + matrix[:3, 3])[order], colours[order]


def digest(folder):
    found = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            found.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return found.hexdigest()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cloud_tiles")
    cloud = write(folder / "c.laz", town(), colours=shades())
    facts = write_cloud_tiles(cloud, str(folder / "tiles"), parameters=SMALL)
    return folder / "tiles", *read(folder / "tiles"), facts


def test_each_point_is_in_one_tile_at_its_geocentric_place(made):
    _, tileset, tiles, facts = made
    found, _ = in_order(tileset, tiles)
    wanted = np.column_stack(Transformer.from_crs("EPSG:32631", "EPSG:4978", always_xy=True).transform(*town().T))
    assert np.abs(found - wanted).max() < 0.0025  # half a millimetre in the file, half one in each axis of the tiles
    assert (facts.points, facts.tiles) == (COUNT, len(tiles)) and len(tiles) > 50
    assert tileset["asset"] == {"version": "1.1"} and tileset["root"]["refine"] == "ADD"
    assert sorted(os.listdir(made[0])) == ["tiles", "tileset.json"]
    assert len(list((made[0] / "tiles").iterdir())) == len(tiles)


def test_colours_are_linear_as_gltf_has_them(made):
    _, tileset, tiles, _ = made
    _, found = in_order(tileset, tiles)
    shown = shades() / 65535
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    assert np.abs(found[:, :3] / 65535 - linear).max() < 1e-5 and (found[:, 3] == 65535).all()


def test_each_level_is_an_even_sample_of_what_is_below(made):
    _, tileset, tiles, facts = made
    spacing = {id(entry): entry["geometricError"] / SOLIDS.tiles3d.spacings for entry, *_ in tiles}
    own = {id(entry): xyz for entry, _, _, xyz, _ in tiles}
    assert spacing[id(tiles[0][0])] == pytest.approx(facts.spacing_m)
    inner = [entry for entry, *_ in tiles if "children" in entry]
    assert len(inner) > 10 and max(len(entry["content"]["uri"].split("_")[0]) for entry in inner)
    for entry in inner:
        side, near = spacing[id(entry)], own[id(entry)]
        _, many = np.unique(np.floor(near / side), axis=0, return_counts=True)
        assert many.max() <= 8, "one point a voxel: any cell as wide as one meets eight of them"
        below = np.concatenate([own[id(part)] for part, above in entries(entry) if above is not None])
        away, _ = cKDTree(near).query(below)
        assert away.max() <= side * np.sqrt(3) + 0.002, "and each voxel with points below has one"
        for child in entry["children"]:
            assert spacing[id(child)] in (0, side / 2) and (spacing[id(child)] > 0) == ("children" in child)


def test_boxes_hold_their_points_and_those_of_the_tiles_below(made):
    def ends(entry):
        box = np.array(entry["boundingVolume"]["box"])
        return box[:3] - np.diag(box[3:].reshape(3, 3)), box[:3] + np.diag(box[3:].reshape(3, 3))

    _, tileset, tiles, _ = made
    for entry, above, _, xyz, _ in tiles:
        low, high = ends(entry)
        assert (low <= xyz).all() and (xyz <= high).all()
        if above is not None:
            assert (ends(above)[0] <= low + 2e-3).all() and (high <= ends(above)[1] + 2e-3).all()
    assert tileset["geometricError"] >= tileset["root"]["geometricError"]


def test_the_same_bytes_however_the_work_is_parted(made, tmp_path):
    cloud = str(made[0].parent / "c.laz")
    for name, sizes in (("again", SMALL.ept), ("whole", replace(SMALL.ept, batch=1 << 21, chunk=1 << 20))):
        write_cloud_tiles(cloud, str(tmp_path / name), parameters=replace(SMALL, ept=sizes))
        assert digest(tmp_path / name) == digest(made[0])


def test_heights_above_a_geoid_become_ellipsoidal(tmp_path, told):
    heard = told()
    cloud = write(tmp_path / "c.laz", town(500), "EPSG:32631+5773")
    write_cloud_tiles(cloud, str(tmp_path / "tiles"), progress=heard)
    found, _ = in_order(*read(tmp_path / "tiles"))
    lon, lat, height = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*found.T)
    geoid = Transformer.from_crs("EPSG:9707", "EPSG:4979", always_xy=True).transform(lon, lat, np.zeros(len(lon)))[2]
    np.testing.assert_allclose(height, town(500)[:, 2] + geoid, atol=0.003)
    assert 40 < np.mean(geoid) < 60 and heard.warnings == []


@pytest.mark.parametrize(("crs", "scale"), [("EPSG:4326", 1e-8), ("EPSG:2264", 0.001)], ids=["degrees", "US feet"])
def test_clouds_in_any_crs_lie_where_they_belong(tmp_path, crs, scale):
    middle = (2.3, 48.9) if crs == "EPSG:4326" else (1_450_000.0, 540_000.0)
    size = 1e-5 if crs == "EPSG:4326" else 3.0
    xyz = (town(500) - [WEST, SOUTH, 0]) * [size, size, 1] + [*middle, 0]
    write_cloud_tiles(write(tmp_path / "c.laz", xyz, crs, scale=scale), str(tmp_path / "tiles"))
    found, _ = in_order(*read(tmp_path / "tiles"))
    lon, lat = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(*xyz[:, :2].T)
    wanted = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True).transform(lon, lat, xyz[:, 2])
    np.testing.assert_allclose(found, np.column_stack(wanted), atol=0.003)


def test_points_without_colours_have_those_of_their_heights(tmp_path):
    xyz = town(2000)
    for name, colours in (("none", None), ("black", np.zeros((2000, 3), np.uint16))):
        write_cloud_tiles(write(tmp_path / f"{name}.laz", xyz, colours=colours), str(tmp_path / name))
        _, found = in_order(*read(tmp_path / name))
        low, high = np.percentile(xyz[:, 2], (2, 98))
        ends = found[xyz[:, 2] < low - 0.01, :3], found[xyz[:, 2] > high + 0.01, :3]
        assert all(len(end) > 10 and (end == end[0]).all() for end in ends) and (ends[0][0] != ends[1][0]).any()
        between = found[(xyz[:, 2] > low) & (xyz[:, 2] < high), :3]
        assert len(np.unique(between, axis=0)) > 100


def test_colours_of_eight_bits_are_not_black(tmp_path):
    colours = (shades(300) >> 8).astype(np.uint16)
    write_cloud_tiles(write(tmp_path / "c.laz", town(300), colours=colours), str(tmp_path / "tiles"))
    _, found = in_order(*read(tmp_path / "tiles"))
    bright = colours == 255
    assert bright.any() and (found[:, :3][bright] == 65535).all()


def test_noise_and_withheld_points_are_left_out(tmp_path):
    path = write(tmp_path / "c.laz", town(900), classes=np.repeat([2, 7, 18], 300))
    cloud = laspy.read(path)
    cloud.withheld = np.arange(900) == 299
    cloud.write(path)
    facts = write_cloud_tiles(path, str(tmp_path / "tiles"))
    _, tiles = read(tmp_path / "tiles")
    assert facts.points == 299 and facts.spacing_m == 0.0
    np.testing.assert_array_equal(np.sort(tiles[0][2]), np.arange(299))
    path = write(tmp_path / "noise.laz", town(50), classes=7)
    with pytest.raises(EmptyResultError, match="no points"):
        write_cloud_tiles(path, str(tmp_path / "none"))
    assert not (tmp_path / "none").exists()


def test_points_on_one_spot_and_a_single_point(tmp_path):
    spot = np.tile(town(1), (300, 1))
    for name, xyz in (("one", town(1)), ("spot", spot)):
        cloud = write(tmp_path / f"{name}.laz", xyz)
        write_cloud_tiles(cloud, str(tmp_path / name), parameters=replace(SMALL, ept=EptParameters(10, 20, 50)))
        found, _ = in_order(*read(tmp_path / name))
        assert len(found) == len(xyz) and np.ptp(found, axis=0).max() < 0.001


def test_the_stage_says_what_it_wrote(tmp_path, told):
    heard = told()
    cloud = write(tmp_path / "c.laz", town(500))
    result = run_stage("tiles3d", {"dsm": cloud, "tiles3d": str(tmp_path / "tiles")}, heard)
    assert result == Tiles3dResult(
        tiles3d=str(tmp_path / "tiles"),
        tileset=str(tmp_path / "tiles" / "tileset.json"),
        tiles=1,
        vertices=None,
        triangles=None,
        points=500,
    )
    assert heard.notes == ["3-D Tiles: 1 tile with 500 points."]
    assert any("does not state its vertical datum" in text for text in heard.warnings)
    with pytest.raises(OptionError, match="ORTHO"):
        run_stage("tiles3d", {"dsm": cloud, "tiles3d": str(tmp_path / "tiles"), "ortho": "o.tif"}, heard)


def test_what_cannot_be_written_is_said_and_nothing_is_lost(made, tmp_path, told):
    place = str(tmp_path / "tiles")
    with pytest.raises(ImageError, match="no coordinate reference system"):
        write_cloud_tiles(write(tmp_path / "nowhere.laz", town(50), crs=""), place)
    with created_cloud(str(tmp_path / "empty.laz"), "EPSG:32631", (WEST, SOUTH, 0)):
        pass
    with pytest.raises(EmptyResultError, match="no points"):
        write_cloud_tiles(str(tmp_path / "empty.laz"), place)
    for cancel_at in (2, 9, 30):
        with pytest.raises(Cancelled):
            write_cloud_tiles(
                str(made[0].parent / "c.laz"), place, progress=told(cancel_at=cancel_at), parameters=SMALL
            )
    assert not os.path.exists(place)
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "letter.txt").write_text("dear")
    with pytest.raises(WorkspaceError, match="letter.txt"):
        write_cloud_tiles(write(tmp_path / "c.laz", town(50)), str(mine))
    assert (mine / "letter.txt").exists()


@pytest.mark.parametrize(("east", "match"), [(WEST + 1.0, "beyond the bounds"), (9e6, "no place on the ground")])
def test_a_header_with_wrong_bounds_is_refused(tmp_path, east, match):
    path = tmp_path / "c.las"
    write(path, town(500))
    data = bytearray(path.read_bytes())
    struct.pack_into("<d", data, 179, east)  # the greatest x (LAS 1.4 R15, table 3)
    path.write_bytes(data)
    with pytest.raises(ImageError, match=match):
        write_cloud_tiles(str(path), str(tmp_path / "tiles"))
    assert os.listdir(tmp_path) == ["c.las"]


def test_the_validator_of_gltf_finds_nothing(made):
    found = gltf_issues([made[0] / entry["content"]["uri"] for entry, *_ in made[2][:20]])
    assert {(issue["numErrors"], issue["numWarnings"]) for issue in found} == {(0, 0)}
    said = {message["message"].split("'")[1] for issue in found for message in issue["messages"]}
    assert said <= {"EXT_structural_metadata"}, "an extension that this validator does not know"


@pytest.mark.slow
@pytest.mark.skipif(PROGRAM is None, reason="needs Chromium")
def test_cesium_draws_all_points_in_their_colours(tmp_path):
    numbers = np.random.default_rng(3)
    xyz = np.column_stack([*numbers.uniform(0, 60, (2, COUNT)) + [[WEST], [SOUTH]], np.full(COUNT, 100.0)])
    colours = np.tile(np.array([[200, 100, 50]], np.uint16) * 257, (COUNT, 1))
    facts = write_cloud_tiles(
        write(tmp_path / "c.laz", xyz, colours=colours), str(tmp_path / "tiles"), parameters=SMALL
    )
    loaded, picture = drawn_by_cesium(tmp_path / "tiles", tmp_path)
    middle = picture[:, 250:350, 350:450].reshape(3, -1).T.astype(int)
    drawn = middle[middle.max(axis=1) > 40]
    assert loaded == facts.tiles and len(drawn) > 0.3 * len(middle), "the points are in the middle of the picture"
    whole = drawn[drawn[:, 0] > 190]  # pixels that a point does not fill are darker
    assert len(whole) > 200 and np.abs(whole - [200, 100, 50]).max() <= 4
