"""The DSM's mesh, read again by a reader of its own: heights, holes, orientation, edges, and the limit."""

from __future__ import annotations

import os
import re

import numpy as np
import pytest

from repm_qgis.dsm.mesh import write_mesh
from repm_qgis.dsm.parameters import FusionParameters
from repm_qgis.errors import Cancelled, EmptyResultError, OptionError, WorkspaceError
from repm_qgis.imagery.raster import write

TRANSFORM = (500000.0, 0.5, 0.0, 4800000.0, 0.0, -0.5)


def dsm_of(path, heights, **options):
    import pyproj

    return write(
        str(path), [np.asarray(heights, dtype=np.float32)], TRANSFORM, pyproj.CRS("EPSG:32631").to_wkt(), **options
    )


def read_ply(path):
    """Header, (N, 3) vertices, (M, 3) faces."""
    with open(path, "rb") as stream:
        data = stream.read()
    head, body = data.split(b"end_header\n", 1)
    n, m = (int(re.search(rb"element %s (\d+)" % name, head).group(1)) for name in (b"vertex", b"face"))
    vertices = np.frombuffer(body, "<f8", 3 * n).reshape(n, 3)
    faces = np.frombuffer(body, np.dtype([("n", "u1"), ("v", "<i4", 3)]), m, 24 * n)
    assert len(body) == 24 * n + 13 * m
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
    assert (facts.vertices, facts.faces, facts.step) == (40 * 61, 2 * 39 * 60, 1)
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


def test_the_limit_thins_evenly_and_keeps_true_heights(tmp_path):
    heights = np.random.default_rng(1).uniform(0, 9, (101, 203))
    heights[40:60, :50] = np.nan
    dsm = dsm_of(tmp_path / "d.tif", heights)
    for limit in (20000, 5000, 1000, 10):
        facts = write_mesh(dsm, str(tmp_path / "m.ply"), limit)
        _, vertices, faces = read_ply(tmp_path / "m.ply")
        assert len(vertices) == facts.vertices <= limit
        step = facts.step
        part = heights[::step, ::step]
        finer = heights[:: step - 1, :: step - 1] if step > 1 else None
        assert finer is None or np.isfinite(finer).sum() > limit or limit == 10
        np.testing.assert_array_equal(vertices[:, 2], part[np.isfinite(part)].astype(np.float32))
        assert (areas(vertices, faces) > 0).all()


@pytest.mark.parametrize("cells", (1, 300, 3000))
def test_blocks_of_rows_join(tmp_path, cells):
    heights = np.random.default_rng(2).uniform(0, 9, (50, 70))
    heights[np.random.default_rng(3).uniform(size=heights.shape) < 0.2] = np.nan
    heights[20:23] = np.nan
    dsm = dsm_of(tmp_path / "d.tif", heights)
    for limit in (0, 1000):
        write_mesh(dsm, str(tmp_path / "whole.ply"), limit)
        small = FusionParameters(mesh_block_cells=cells)
        write_mesh(dsm, str(tmp_path / "blocks.ply"), limit, parameters=small)
        assert (tmp_path / "whole.ply").read_bytes() == (tmp_path / "blocks.ply").read_bytes()


def test_the_datum_is_named(tmp_path):
    dsm = dsm_of(tmp_path / "d.tif", np.ones((4, 4)), metadata={"VERTICAL_DATUM": "EGM96 height"})
    write_mesh(dsm, str(tmp_path / "m.ply"))
    assert "comment heights: metres above the EGM96 height\n" in read_ply(tmp_path / "m.ply")[0]


def test_what_cannot_be_written_leaves_nothing(tmp_path, told):
    dsm = dsm_of(tmp_path / "d.tif", np.ones((9, 9)))
    with pytest.raises(OptionError, match="must end with .ply"):
        write_mesh(dsm, str(tmp_path / "m.obj"))
    with pytest.raises(EmptyResultError, match="no heights"):
        write_mesh(dsm_of(tmp_path / "e.tif", np.full((9, 9), np.nan)), str(tmp_path / "m.ply"))
    with pytest.raises(Cancelled):
        write_mesh(dsm, str(tmp_path / "m.ply"), 0, told(cancel_at=3))
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(WorkspaceError):
        write_mesh(dsm, str(tmp_path / "folder.ply"))
    assert sorted(os.listdir(tmp_path)) == ["d.tif", "e.tif", "folder.ply"]
