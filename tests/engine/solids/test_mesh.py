"""The DSM's mesh, read again by a reader of its own: heights, holes, orientation, edges, and the limit."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import struct
from dataclasses import replace

import numpy as np
import pyproj
import pytest
from osgeo import gdal
from scipy.ndimage import map_coordinates

from repm_qgis.contracts.errors import Cancelled, EmptyResultError, OptionError, WorkspaceError
from repm_qgis.contracts.options import DsmFuseOptions
from repm_qgis.imagery.raster import RasterFrame, created, write
from repm_qgis.solids.mesh import write_mesh
from repm_qgis.solids.parameters import SOLIDS, SolidsParameters
from repm_qgis.stages.collisions import require_distinct

TRANSFORM = (500000.0, 0.5, 0.0, 4800000.0, 0.0, -0.5)


def dsm_of(path, heights, **options):
    return write(
        str(path), [np.asarray(heights, dtype=np.float32)], TRANSFORM, pyproj.CRS("EPSG:32631").to_wkt(), **options
    )


def read_ply(path):
    """Header, (N, 3) vertices, (M, 3) faces."""
    with open(path, "rb") as stream:
        data = stream.read()
    head, body = data.split(b"end_header\n", 1)
    n, m = (int(re.search(rb"element %s (\d+)" % name, head).group(1)) for name in (b"vertex", b"face"))
    size = 27 if b"uchar red" in head else 24  # with colours
    kind = np.dtype({"names": ["place"], "formats": [("<f8", 3)], "itemsize": size})
    vertices = np.frombuffer(body, kind, n)["place"]
    faces = np.frombuffer(body, np.dtype([("n", "u1"), ("v", "<i4", 3)]), m, size * n)
    assert len(body) == size * n + 13 * m
    assert (faces["n"] == 3).all()
    return head.decode(), vertices, faces["v"]


def areas(vertices, faces):
    """Signed areas in plan: positive where counter-clockwise from above."""
    a, b, c = (vertices[faces[:, i], :2] for i in range(3))
    return ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2


def test_a_full_surface_is_covered_once(tmp_path):
    heights = np.random.default_rng(0).uniform(100, 130, (40, 61))
    path = str(tmp_path / "m.ply")
    facts = write_mesh(dsm_of(tmp_path / "d.tif", heights), path)
    head, vertices, faces = read_ply(path)
    assert (facts.vertices, facts.faces, facts.cells) == (40 * 61, 2 * 39 * 60, 40 * 61)
    assert "comment crs: PROJCS" in head and "comment heights: metres above the WGS 84 ellipsoid" in head
    rows, columns = np.mgrid[0:40, 0:61]
    np.testing.assert_array_equal(
        vertices,
        np.column_stack(
            [500000.25 + 0.5 * columns.ravel(), 4799999.75 - 0.5 * rows.ravel(), heights.astype(np.float32).ravel()]
        ),
    )
    found = areas(vertices, faces)
    np.testing.assert_allclose(found, 0.125, atol=1e-9)  # all the same way round, none degenerate
    assert found.sum() == pytest.approx(39 * 60 * 0.25)
    assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces)
    edges, counts = np.unique(
        np.sort(np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0, return_counts=True
    )
    assert counts.max() == 2 and (counts == 1).sum() == 2 * (39 + 60)  # closed but for the border


def test_holes_stay_open(tmp_path):
    heights = np.full((30, 30), 50.0)
    heights[10:20, 12:16] = np.nan
    heights[0, 0] = heights[29, 3] = np.nan
    write_mesh(dsm_of(tmp_path / "d.tif", heights), str(tmp_path / "m.ply"))
    _, vertices, faces = read_ply(tmp_path / "m.ply")
    assert len(vertices) == np.isfinite(heights).sum()
    known = np.isfinite(heights)
    corners = sum(np.roll(np.roll(known, -r, 0), -c, 1)[:-1, :-1].astype(int) for r in (0, 1) for c in (0, 1))
    assert len(faces) == 2 * (corners == 4).sum() + (corners == 3).sum()
    assert areas(vertices, faces).sum() == pytest.approx(0.25 * ((corners == 4).sum() + 0.5 * (corners == 3).sum()))
    longest = max(np.linalg.norm(vertices[faces[:, i]] - vertices[faces[:, i - 1]], axis=1).max() for i in range(3))
    assert longest < 0.5 * np.sqrt(2) + 1e-9


def test_a_roofs_edge_is_straight(tmp_path):
    """Across a diagonal step the triangles' sides follow it: each is level on either side."""
    rows, columns = np.mgrid[0:12, 0:12]
    for step in (rows + columns, rows - columns + 11):
        heights = np.where(step < 11, 10.0, 40.0)
        write_mesh(dsm_of(tmp_path / "d.tif", heights), str(tmp_path / "m.ply"))
        _, vertices, faces = read_ply(tmp_path / "m.ply")
        heights_of = vertices[faces, 2]
        along = np.linalg.norm(vertices[faces] - np.roll(vertices[faces], 1, axis=1), axis=2) > 3  # sides up the wall
        assert along.sum() and (np.ptp(heights_of, axis=1) > 0).sum() <= 2 * 2 * 11
        diagonals = np.abs(vertices[faces[:, [0, 1, 2]], 2] - vertices[faces[:, [1, 2, 0]], 2])
        plan = np.linalg.norm(vertices[faces, :2] - vertices[faces[:, [1, 2, 0]], :2], axis=2)
        assert not (diagonals[plan > 0.6] > 0).any()  # no diagonal of a square climbs


def town(rows, columns, seed=0):
    """Sloping ground with level roofs, m, and a map of the roofs' numbers."""
    numbers = np.random.default_rng(seed)
    row, column = np.mgrid[0:rows, 0:columns]
    heights, roofs = 40 + 0.02 * row + 0.01 * column, np.zeros((rows, columns), dtype=int)
    for n in range(rows * columns // 1500):
        top, left = numbers.integers(0, rows - 12), numbers.integers(0, columns - 12)
        place = slice(top, top + numbers.integers(6, 30)), slice(left, left + numbers.integers(6, 30))
        heights[place], roofs[place] = 50 + numbers.integers(0, 30), n + 1
    return heights, roofs


def cells_of(vertices):
    """Row and column of vertices in their DSM, with fractions where they lie between cells."""
    return (TRANSFORM[3] - vertices[:, 1]) / 0.5 - 0.5, (vertices[:, 0] - TRANSFORM[0]) / 0.5 - 0.5


def drawn(vertices, faces, shape):
    """The highest height on each cell's centre, NaN without a triangle, and how many triangles lie on inner points."""
    row, column = cells_of(vertices)
    heights, times = np.full(shape, np.nan), np.zeros((shape[0] - 1, shape[1] - 1), dtype=int)
    for corners in faces:
        r, c, z = row[corners], column[corners], vertices[corners, 2]
        whole = (c[1] - c[0]) * (r[2] - r[0]) - (c[2] - c[0]) * (r[1] - r[0])
        if abs(whole) < 1e-9:
            continue
        for inner, (shift_r, shift_c) in enumerate(((0.0, 0.0), (0.3, 0.6))):  # centres, and points on no side
            lines = (range(max(int(np.floor(k.min())), 0), int(np.ceil(k.max() + 1e-9)) + 1) for k in (r, c))
            i, j = np.meshgrid(*lines, indexing="ij")
            fits = (i < shape[0] - inner) & (j < shape[1] - inner)
            i, j = i[fits], j[fits]
            y, x = i + shift_r, j + shift_c
            second = ((x - c[0]) * (r[2] - r[0]) - (c[2] - c[0]) * (y - r[0])) / whole
            third = ((c[1] - c[0]) * (y - r[0]) - (x - c[0]) * (r[1] - r[0])) / whole
            inside = (second >= -1e-9) & (third >= -1e-9) & (second + third <= 1 + 1e-9)
            i, j = i[inside], j[inside]
            if inner:
                times[i, j] += 1
            else:
                heights[i, j] = np.fmax(heights[i, j], (z[0] + (z[1] - z[0]) * second + (z[2] - z[0]) * third)[inside])
    return heights, times


def assert_sound(vertices, faces, heights):
    """No crack, hardly a fold, no triangle on a hole, rims of cells; gives the mesh's heights and what it covers."""
    assert (areas(vertices, faces) < -1e-9).mean() < 0.015
    edges = np.concatenate([faces[:, [n, (n + 1) % 3]] for n in range(3)])
    assert len(np.unique(edges, axis=0)) == len(edges)  # two triangles on an edge have it in opposite directions
    both = {tuple(edge) for edge in edges.tolist()}
    rim = np.unique([edge for edge in both if edge[::-1] not in both])
    row, column = (np.rint(place).astype(int) for place in cells_of(vertices[rim]))
    np.testing.assert_allclose(cells_of(vertices[rim]), (row, column), atol=1e-6)
    np.testing.assert_array_equal(vertices[rim, 2], heights[row, column].astype(np.float32))
    beside = np.pad(np.isfinite(heights), 1)  # a rim's vertex lies beside a hole, or on the DSM's rim: no cracks
    around = [beside[row + dr, column + dc] for dr in range(3) for dc in range(3)]
    assert not np.all(around, axis=0).any()
    shown, times = drawn(vertices, faces, heights.shape)
    assert (times > 1).mean() < 0.02 and not np.isfinite(shown[~np.isfinite(heights)]).any()
    return shown, times


def simplified(tmp_path, heights, limit, **options):
    facts = write_mesh(dsm_of(tmp_path / "d.tif", heights), str(tmp_path / "m.ply"), limit, **options)
    _, vertices, faces = read_ply(tmp_path / "m.ply")
    assert (facts.vertices, facts.faces) == (len(vertices), len(faces)) and len(vertices) <= limit
    assert facts.cells == np.isfinite(heights).sum() and len(np.unique(faces)) == len(vertices)
    return vertices, faces


@pytest.mark.parametrize("shape", ((97, 129), (101, 203), (40, 300)))
@pytest.mark.slow
def test_fewer_vertices_cover_the_surface_once_without_cracks(tmp_path, shape):
    heights, _ = town(*shape)
    heights += np.random.default_rng(5).normal(0, 0.05, shape)
    for limit in (shape[0] * shape[1] // 2, 2500):
        vertices, faces = simplified(tmp_path, heights, limit)
        assert len(vertices) > 0.99 * limit
        shown, times = assert_sound(vertices, faces, heights)
        assert (times >= 1).mean() > 0.999
        # The cells that are not where they belong are fewer than with every n-th row and column.
        step = next(n for n in range(2, 99) if heights[::n, ::n].size <= limit)
        coarser = map_coordinates(heights[::step, ::step], np.indices(shape) / step, order=1, mode="nearest")
        assert (np.abs(shown - heights) > 0.3).sum() < 0.3 * (np.abs(coarser - heights) > 0.3).sum()


@pytest.mark.long
def test_holes_stay_open_in_a_simplified_mesh(tmp_path):
    heights, _ = town(120, 150)
    numbers = np.random.default_rng(4)
    heights[30:60, 20:70] = heights[90:, 100:] = np.nan
    heights[numbers.integers(0, 120, 40), numbers.integers(0, 150, 40)] = np.nan
    known = np.isfinite(heights)
    shown, _ = assert_sound(*simplified(tmp_path, heights, 6000), heights)
    assert np.isfinite(shown)[known].mean() > 0.99
    # Rims alone have more vertices than these, so rows and columns are left out.
    vertices, faces = simplified(tmp_path, heights, 1000)
    assert not np.isfinite(drawn(vertices, faces, heights.shape)[0][32:58, 22:68]).any() and len(vertices) > 990


def test_a_plane_stays_a_plane(tmp_path):
    row, column = np.mgrid[0:97, 0:133]
    for heights in (np.full(row.shape, 7.0), 123 + 0.137 * row + 0.0731 * column):
        vertices, faces = simplified(tmp_path, heights, 2000)
        assert areas(vertices, faces).min() > 0 and areas(vertices, faces).sum() == pytest.approx(96 * 132 * 0.25)
        down, right = cells_of(vertices)
        expected = heights[0, 0] + down * (heights[1, 0] - heights[0, 0]) + right * (heights[0, 1] - heights[0, 0])
        np.testing.assert_allclose(vertices[:, 2], expected, atol=2e-5)  # a DSM's heights are single precision


def test_steps_stay_sharp_where_few_vertices_are_left(tmp_path):
    """A block on level ground takes vertices around it and on the DSM's rim, and its wall is one cell wide."""
    heights = np.full((257, 257), 10.0)
    heights[60:131, 90:201] = 40.0
    vertices, faces = simplified(tmp_path, heights, 2500)
    np.testing.assert_allclose(assert_sound(vertices, faces, heights)[0], heights, atol=1e-3)


@pytest.mark.long
def test_strips_join_without_cracks_and_leave_no_lines(tmp_path):
    heights, _ = town(120, 150)
    heights += np.random.default_rng(6).normal(0, 0.05, heights.shape)
    heights[50:70, 20:40] = np.nan
    off = {}
    for cells in (150 * 30, 1 << 18):
        small = replace(SOLIDS, simplification=replace(SOLIDS.simplification, strip_cells=cells))
        shown, _ = assert_sound(*simplified(tmp_path, heights, 6000, parameters=small), heights)
        known = np.isfinite(shown)
        assert known.sum() > 0.999 * np.isfinite(heights).sum()
        off[cells] = np.sqrt(np.mean((shown - heights)[known] ** 2))
    assert off[150 * 30] < 1.1 * off[1 << 18]


def test_without_the_package_rows_and_columns_are_left_out(tmp_path, monkeypatch, told):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    heights, said = town(80, 90)[0], told()
    facts = write_mesh(dsm_of(tmp_path / "d.tif", heights), str(tmp_path / "m.ply"), 2000, said)
    _, vertices, _ = read_ply(tmp_path / "m.ply")
    assert facts.vertices == 40 * 45 and not (np.array(cells_of(vertices)) % 2).any()
    assert "package 'pyfqmr', which chooses better vertices, is missing" in said.warnings[0]


@pytest.mark.parametrize("limit", (1, 3, 10))
def test_a_limit_of_a_few_vertices_holds(tmp_path, limit):
    heights = np.random.default_rng(1).uniform(0, 9, (101, 203))
    heights[40:60, :50] = np.nan
    write_mesh(dsm_of(tmp_path / "d.tif", heights), str(tmp_path / "m.ply"), limit)
    assert 0 < len(read_ply(tmp_path / "m.ply")[1]) <= limit


def test_scattered_cells_are_thinned_by_rows_and_columns(tmp_path):
    heights = np.full((60, 60), np.nan)
    heights[::2, ::2] = 5.0
    facts = write_mesh(dsm_of(tmp_path / "d.tif", heights), str(tmp_path / "m.ply"), 500)
    assert 0 < facts.vertices <= 500 and facts.cells == 900


def test_simplified_meshes_of_all_kinds_are_one_surface_with_its_picture(tmp_path):
    heights, _ = town(60, 90)
    heights[10:20, 70:80] = np.nan
    vertices, faces = simplified(tmp_path, heights, 900, ortho=picture_of(tmp_path, 60, 90))
    row, column = cells_of(vertices)
    body = (tmp_path / "m.ply").read_bytes().split(b"end_header\n", 1)[1]
    colours = np.frombuffer(body, np.dtype([("place", "<f8", 3), ("colour", "u1", 3)]), len(vertices))["colour"]
    shown = np.where((column < 44.5)[:, None], (200, 90, 30), (20, 90, 180))
    clear = np.abs(column - 44.5) > 0.1
    np.testing.assert_array_equal(colours[clear], shown[clear])
    dsm, ortho = str(tmp_path / "d.tif"), str(tmp_path / "o.tif")
    write_mesh(dsm, str(tmp_path / "m.glb"), 900, ortho=ortho)
    _, positions, places, triangles, picture = read_glb(tmp_path / "m.glb")
    np.testing.assert_array_equal(triangles, faces)
    np.testing.assert_allclose(places * (90, 60), np.column_stack([column, row]) + 0.5, atol=1e-4)
    np.testing.assert_allclose(positions[:, 1], vertices[:, 2], atol=1e-5)
    write_mesh(dsm, str(tmp_path / "m.obj"), 900, ortho=ortho)
    _, found, on_picture, corners, used = read_obj(tmp_path / "m.obj")
    np.testing.assert_array_equal(corners, faces)
    np.testing.assert_array_equal(used, faces)
    np.testing.assert_allclose(on_picture * (1, -1) + (0, 1), places, atol=1e-5)
    assert picture and len(found) == len(vertices)


def test_vertices_of_a_large_dsm_are_chosen_from_fewer_rows_and_columns(tmp_path):
    heights, _ = town(200, 260)
    small = replace(SOLIDS, simplification=replace(SOLIDS.simplification, cells=200 * 260 // 4))
    vertices, _ = simplified(tmp_path, heights, 3000, parameters=small)
    rim = np.isin(np.array(cells_of(vertices)), (0, 198, 258)).any(axis=0)  # of every second row and column
    assert not (np.array(cells_of(vertices))[:, rim] % 1).any() and len(vertices) > 2970
    assert np.isclose(vertices[:, 0].max(), 500000.25 + 0.5 * 258) and np.isclose(vertices[:, 1].min(), 4799999.75 - 99)


@pytest.mark.parametrize("cells", (1, 300, 3000))
def test_blocks_of_rows_join(tmp_path, cells):
    heights = np.random.default_rng(2).uniform(0, 9, (50, 70))
    heights[np.random.default_rng(3).uniform(size=heights.shape) < 0.2] = np.nan
    heights[20:23] = np.nan
    dsm = dsm_of(tmp_path / "d.tif", heights)
    for limit in (0, 1000):
        write_mesh(dsm, str(tmp_path / "whole.ply"), limit)
        small = SolidsParameters(mesh_block_cells=cells)
        write_mesh(dsm, str(tmp_path / "blocks.ply"), limit, parameters=small)
        assert (tmp_path / "whole.ply").read_bytes() == (tmp_path / "blocks.ply").read_bytes()


def test_the_datum_is_named(tmp_path):
    dsm = dsm_of(tmp_path / "d.tif", np.ones((4, 4)), metadata={"VERTICAL_DATUM": "EGM96 height"})
    write_mesh(dsm, str(tmp_path / "m.ply"))
    assert "comment heights: metres above the EGM96 height\n" in read_ply(tmp_path / "m.ply")[0]


def test_what_cannot_be_written_leaves_nothing(tmp_path, told):
    dsm = dsm_of(tmp_path / "d.tif", np.ones((9, 9)))
    with pytest.raises(OptionError, match="must end with .ply, .glb or .obj"):
        write_mesh(dsm, str(tmp_path / "m.stl"))
    with pytest.raises(EmptyResultError, match="no heights"):
        write_mesh(dsm_of(tmp_path / "e.tif", np.full((9, 9), np.nan)), str(tmp_path / "m.ply"))
    with pytest.raises(Cancelled):
        write_mesh(dsm, str(tmp_path / "m.ply"), 0, told(cancel_at=3))
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(WorkspaceError):
        write_mesh(dsm, str(tmp_path / "folder.ply"))
    assert sorted(os.listdir(tmp_path)) == ["d.tif", "e.tif", "folder.ply"]


def read_glb(path):
    """The JSON part, (N, 3) positions, (N, 2) places in the picture or None, (M, 3) triangles, and the picture."""
    data = path.read_bytes()
    magic, version, length, size, kind = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON") and size % 4 == 0
    document = json.loads(data[20 : 20 + size])
    rest, kind = struct.unpack("<I4s", data[20 + size : 28 + size])
    body = data[28 + size :]
    assert kind == b"BIN\0" and rest == len(body) and rest % 4 == 0
    views = [body[v.get("byteOffset", 0) :][: v["byteLength"]] for v in document["bufferViews"]]
    (primitive,) = document["meshes"][0]["primitives"]

    def values(accessor, kind, width):
        found = document["accessors"][accessor]
        array = np.frombuffer(views[found["bufferView"]], kind).reshape(-1, width)
        assert array.size == found["count"] * {"VEC3": 3, "VEC2": 2, "SCALAR": 1}[found["type"]]
        return array

    attributes = primitive["attributes"]
    places = values(attributes["TEXCOORD_0"], "<f4", 2) if "TEXCOORD_0" in attributes else None
    picture = views[document["images"][0]["bufferView"]] if "images" in document else None
    triangles = values(primitive["indices"], "<u4", 3) if "indices" in primitive else None
    return document, values(attributes["POSITION"], "<f4", 3), places, triangles, picture


def test_gltf_has_the_same_surface_as_the_ply(tmp_path):
    heights = np.random.default_rng(0).uniform(100, 130, (40, 61))
    heights[5:9, 20:30] = np.nan
    dsm = dsm_of(tmp_path / "d.tif", heights)
    facts = write_mesh(dsm, str(tmp_path / "m.glb"))
    assert facts == write_mesh(dsm, str(tmp_path / "m.ply"))
    _, vertices, faces = read_ply(tmp_path / "m.ply")
    document, positions, places, triangles, picture = read_glb(tmp_path / "m.glb")
    assert places is None and picture is None
    np.testing.assert_array_equal(triangles, faces)
    about = document["asset"]["extras"]
    back = np.column_stack([positions[:, 0], -positions[:, 2], positions[:, 1]]) + about["origin"]
    assert np.abs(back - vertices).max() < 1e-5 and np.abs(positions[:, [0, 2]]).max() < 20
    assert "WGS 84 / UTM zone 31N" in about["crs"] and about["heights"] == "metres above the WGS 84 ellipsoid"
    accessor = document["accessors"][0]
    np.testing.assert_array_equal([accessor["min"], accessor["max"]], [positions.min(axis=0), positions.max(axis=0)])
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 1] > 0).all()  # turned up


def test_gltf_has_the_orthophoto_in_its_place(tmp_path):
    rows, columns = np.mgrid[0:60, 0:90]
    dsm = dsm_of(tmp_path / "d.tif", 10 + 0.1 * rows)
    colours = [np.where(columns < 45, 200, 20), np.where(rows < 30, 180, 30), np.full(rows.shape, 90)]
    wkt, ortho = pyproj.CRS("EPSG:32631").to_wkt(), str(tmp_path / "o.tif")
    with created(ortho, RasterFrame(rows.shape, np.uint8, 3, TRANSFORM, wkt)) as raster:
        for band, values in enumerate(colours, start=1):
            raster.write(values.astype(np.uint8), 0, 0, band)
    write_mesh(dsm, str(tmp_path / "m.glb"), ortho=ortho)
    document, positions, places, _, picture = read_glb(tmp_path / "m.glb")
    (tmp_path / "p.jpg").write_bytes(picture)
    pixels = gdal.Open(str(tmp_path / "p.jpg")).ReadAsArray()
    column, row = (places * [pixels.shape[2], pixels.shape[1]]).astype(int).T
    np.testing.assert_array_equal(column, columns.ravel())
    np.testing.assert_array_equal(row, rows.ravel())
    shown = pixels[:, row, column].reshape(3, *rows.shape).astype(int)
    inner = (np.abs(columns - 44.5) > 16) & (np.abs(rows - 29.5) > 16)  # JPEG blurs edges
    assert all(np.abs(band - true)[inner].max() < 6 for band, true in zip(shown, colours))
    assert document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0}


def test_gltf_in_blocks_thinned_and_of_single_cells(tmp_path):
    heights = np.random.default_rng(2).uniform(0, 9, (50, 70))
    dsm = dsm_of(tmp_path / "d.tif", heights)
    write_mesh(dsm, str(tmp_path / "whole.glb"), 1000)
    write_mesh(dsm, str(tmp_path / "blocks.glb"), 1000, parameters=SolidsParameters(mesh_block_cells=300))
    assert (tmp_path / "whole.glb").read_bytes() == (tmp_path / "blocks.glb").read_bytes()
    alone = np.full((5, 5), np.nan)
    alone[1, 1] = alone[3, 3] = 4.0
    write_mesh(dsm_of(tmp_path / "a.tif", alone), str(tmp_path / "a.glb"))
    document, positions, _, triangles, _ = read_glb(tmp_path / "a.glb")
    assert len(positions) == 2 and triangles is None and document["meshes"][0]["primitives"][0]["mode"] == 0


def read_obj(path):
    """The comments' lines, (N, 3) vertices, (N, 2) places in the picture, (M, 3) triangles and (M, 3) their places."""
    rows = {"v": [], "vt": [], "f": [], "#": [], "mtllib": [], "usemtl": []}
    for line in path.read_text().splitlines():
        word, rest = line.split(" ", 1)
        rows[word].append(rest)
    corners = [[part.split("/") for part in row.split()] for row in rows["f"]]
    faces = np.array([[int(part[0]) for part in row] for row in corners]) - 1
    used = np.array([[int(part[-1]) for part in row] for row in corners]) - 1
    v, vt = ([[float(part) for part in row.split()] for row in rows[word]] for word in ("v", "vt"))
    return rows, np.array(v), np.array(vt), faces, used


def picture_of(tmp_path, rows, columns):
    """An orthophoto of a red and a dark half, in the cells of a DSM."""
    wkt, ortho = pyproj.CRS("EPSG:32631").to_wkt(), str(tmp_path / "o.tif")
    with created(ortho, RasterFrame((rows, columns), np.uint8, 3, TRANSFORM, wkt)) as raster:
        for band, (left, right) in enumerate(((200, 20), (90, 90), (30, 180)), start=1):
            values = np.full((rows, columns), left, np.uint8)
            values[:, columns // 2 :] = right
            raster.write(values, 0, 0, band)
    return ortho


def test_obj_has_the_same_surface_as_the_ply_and_the_orthophoto_beside_it(tmp_path):
    heights = np.random.default_rng(0).uniform(100, 130, (40, 64))
    heights[5:9, 20:30] = np.nan
    dsm, target = dsm_of(tmp_path / "d.tif", heights), tmp_path / "my mesh.obj"
    facts = write_mesh(dsm, str(target), ortho=picture_of(tmp_path, 40, 64))
    assert facts == write_mesh(dsm, str(tmp_path / "m.ply"))
    _, vertices, faces = read_ply(tmp_path / "m.ply")
    rows, found, places, triangles, used = read_obj(target)
    np.testing.assert_array_equal(triangles, faces)
    np.testing.assert_array_equal(used, faces)
    origin = np.array(rows["#"][0].split(":")[1].split(",")[0].split(), dtype=float)
    assert np.abs(found + origin - vertices).max() < 1e-4 and np.abs(found[:, :2]).max() < 20
    assert rows["#"][1] == "heights: metres above the WGS 84 ellipsoid" and "UTM zone 31N" in rows["#"][2]
    (material,), (name,) = rows["mtllib"], rows["usemtl"]
    assert material == "my_mesh.obj.mtl"  # many readers take no spaces
    lines = (tmp_path / material).read_text().splitlines()
    assert lines[0] == f"newmtl {name}" and lines[-1] == "map_Kd my_mesh.obj.jpg"
    pixels = gdal.Open(str(tmp_path / "my_mesh.obj.jpg")).ReadAsArray().astype(int)
    row, column = ((1 - places[:, 1]) * 40).astype(int), (places[:, 0] * 64).astype(int)
    known = np.nonzero(np.isfinite(heights))
    np.testing.assert_array_equal(np.array([row, column]), known)
    assert (pixels[0, row, column] > 150)[column < 24].all() and (pixels[0, row, column] < 70)[column > 40].all()


@pytest.mark.parametrize("kind", ("jpg", "mtl"))
def test_obj_replaces_no_picture_or_material_of_the_user(tmp_path, kind):
    heights = np.fromfunction(lambda row, col: 100 + 0.1 * row * col, (20, 20))
    dsm, target = dsm_of(tmp_path / "d.tif", heights), tmp_path / "m.obj"
    ortho = picture_of(tmp_path, 20, 20)
    before = sorted(os.listdir(tmp_path))
    theirs = tmp_path / f"m.obj.{kind}"
    theirs.write_text("years of work")
    for attempt in (
        lambda: write_mesh(dsm, str(target), 0, ortho=ortho),
        lambda: require_distinct("dsmfuse", DsmFuseOptions(scene="s.json", output="a.tif", mesh=str(target))),
    ):
        with pytest.raises(WorkspaceError, match=f"m.obj.{kind}' is not of an earlier mesh.*: move it, or choose"):
            attempt()
    assert theirs.read_text() == "years of work" and sorted([*before, theirs.name]) == sorted(os.listdir(tmp_path))
    theirs.unlink()
    for _ in range(2):  # its own are replaced
        write_mesh(dsm, str(target), 0, ortho=ortho)
    assert (tmp_path / "m.obj.jpg").stat().st_size > 100


def test_obj_without_an_orthophoto_is_one_file_and_blocks_do_not_change_it(tmp_path):
    dsm = dsm_of(tmp_path / "d.tif", np.random.default_rng(1).uniform(0, 9, (30, 30)))
    write_mesh(dsm, str(tmp_path / "a.obj"), 200)
    write_mesh(dsm, str(tmp_path / "b.obj"), 200, parameters=SolidsParameters(mesh_block_cells=90))
    assert (tmp_path / "a.obj").read_bytes() == (tmp_path / "b.obj").read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["a.obj", "b.obj", "d.tif"]
    rows, vertices, places, triangles, _ = read_obj(tmp_path / "a.obj")
    assert not len(places) and not rows["mtllib"] and triangles.max() == len(vertices) - 1


def test_a_cancelled_obj_leaves_neither_picture_nor_material(tmp_path, told):
    dsm, ortho = dsm_of(tmp_path / "d.tif", np.ones((9, 8))), picture_of(tmp_path, 9, 8)
    for check in range(1, 5):
        with pytest.raises(Cancelled):
            write_mesh(dsm, str(tmp_path / "m.obj"), 0, told(cancel_at=check), ortho=ortho)
        assert sorted(os.listdir(tmp_path)) == ["d.tif", "o.tif"]
