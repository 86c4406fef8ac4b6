"""3-D Tiles of a DSM, read back by a reader of the test's own and, where they are there, by other programs."""

from __future__ import annotations

import json
import pathlib

import numpy as np
import pytest
from osgeo import gdal, osr
from pyproj import Transformer

from repm_qgis.contracts.errors import EmptyResultError, MissingPackageError, OverlapError, RepmError, WorkspaceError
from repm_qgis.solids import tiles3d
from repm_qgis.solids.tiles3d import write_tiles3d
from repm_qgis.stages import run_stage
from tests.browser import PROGRAM
from tests.tilesets import drawn_by_cesium, entries, enu, gltf_issues, read_glb

CELL, WEST, NORTH = 0.5, 500_000.0, 4_900_000.0
ROWS, COLUMNS = 700, 600
TO_UTM = Transformer.from_crs(4978, 32631, always_xy=True)


def town():
    """Hills with houses on them, two holes, and no height along the left side."""
    row, column = np.indices((ROWS, COLUMNS))
    heights = 100 + 8 * np.sin(row / 90) * np.cos(column / 70) + 0.02 * column
    for r, c in ((100, 80), (240, 250), (250, 500), (500, 300), (610, 90)):
        heights[r : r + 40, c : c + 30] += 12.0
    heights[300:330, 200:260], heights[620:, 550:], heights[:, :4] = np.nan, np.nan, np.nan
    return heights.astype(np.float32)


def write(path, heights, epsg="EPSG:32631", tag="WGS 84 ellipsoid"):
    raster = gdal.GetDriverByName("GTiff").Create(str(path), heights.shape[1], heights.shape[0], 1, gdal.GDT_Float32)
    raster.SetGeoTransform((WEST, CELL, 0, NORTH, 0, -CELL))
    crs = osr.SpatialReference()
    crs.SetFromUserInput(epsg)
    raster.SetProjection(crs.ExportToWkt())
    if tag:
        raster.SetMetadataItem("VERTICAL_DATUM", tag)
    raster.GetRasterBand(1).WriteArray(np.where(np.isfinite(heights), heights, -9999))
    raster.GetRasterBand(1).SetNoDataValue(-9999)
    return str(path)


def read_tile(path):
    """(N, 3) coordinates as glTF has them, (N, 2) places in the picture, (M, 3) corners, and the picture."""
    document, views, parts = read_glb(path)
    name = f"/vsimem/{pathlib.Path(path).stem}.jpg"
    gdal.FileFromMemBuffer(name, views[document["images"][0]["bufferView"]])
    return (*parts[:2], parts[2].reshape(-1, 3), gdal.Open(name).ReadAsArray())


def on_ground(folder, entry, tileset):
    """(N, 3) UTM coordinates and ellipsoidal heights of a tile's vertices."""
    matrix = np.array(tileset["root"]["transform"]).reshape(4, 4).T
    xyz = enu(read_tile(folder / entry["content"]["uri"])[0])
    return np.column_stack(TO_UTM.transform(*(xyz @ matrix[:3, :3].T + matrix[:3, 3]).T))


def places(ground):
    row, column = (NORTH - ground[:, 1]) / CELL - 0.5, (ground[:, 0] - WEST) / CELL - 0.5
    return np.column_stack([row, column])


def level(entry):
    return int(pathlib.Path(entry["content"]["uri"]).name.split("_")[0])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tiles3d")
    facts = write_tiles3d(write(folder / "dsm.tif", town()), str(folder / "tiles"))
    tileset = json.loads((folder / "tiles" / "tileset.json").read_text())
    return folder / "tiles", tileset, facts


def test_every_vertex_is_a_cell_at_its_height_in_geocentric_coordinates(made):
    folder, tileset, facts = made
    heights, seen = town(), np.zeros((ROWS, COLUMNS), bool)
    count = 0
    for entry, _ in entries(tileset["root"]):
        ground = on_ground(folder, entry, tileset)
        cells = np.rint(places(ground)).astype(int)
        np.testing.assert_allclose(places(ground), cells, atol=0.002, err_msg="0.001 m")
        np.testing.assert_allclose(ground[:, 2], heights[cells[:, 0], cells[:, 1]], atol=0.001)
        seen[cells[:, 0], cells[:, 1]] |= level(entry) == 2
        count += len(ground)
    assert count == facts.vertices and tileset["asset"] == {"version": "1.1"}
    assert facts.tiles == len(list((folder / "tiles").iterdir())) == 1 + 4 + 9
    assert 0.02 < seen.mean() < 0.5  # cells that the triangles do not need are no vertices


@pytest.mark.long
def test_holes_stay_open_and_everything_else_is_covered(made):
    folder, tileset, _ = made
    covered = np.zeros((ROWS, COLUMNS), bool)
    for entry, _ in entries(tileset["root"]):
        if level(entry) == 2:
            covered |= np.isfinite(drawn(folder, entry, tileset))
    known = np.isfinite(town())
    assert not covered[~known].any()
    assert (covered | ~known).all()


def drawn(folder, entry, tileset):
    """(rows, columns) the heights of a tile's triangles at the cells' centres, NaN beside them."""
    found = np.full((ROWS, COLUMNS), np.nan)
    ground = on_ground(folder, entry, tileset)
    place, corners = places(ground), read_tile(folder / entry["content"]["uri"])[2]
    for triangle in corners:
        (r, c), z = np.rint(place[triangle]).astype(int).T, ground[triangle, 2]
        rows, columns = np.mgrid[r.min() : r.max() + 1, c.min() : c.max() + 1]
        twice = (r[1] - r[0]) * (c[2] - c[0]) - (r[2] - r[0]) * (c[1] - c[0])
        second = ((rows - r[0]) * (c[2] - c[0]) - (r[2] - r[0]) * (columns - c[0])) / twice
        third = ((r[1] - r[0]) * (columns - c[0]) - (rows - r[0]) * (c[1] - c[0])) / twice
        inside = (second >= -1e-9) & (third >= -1e-9) & (second + third <= 1 + 1e-9)
        found[rows[inside], columns[inside]] = (z[0] + second * (z[1] - z[0]) + third * (z[2] - z[0]))[inside]
    return found


@pytest.mark.long
def test_stated_errors_are_true(made):
    folder, tileset, facts = made
    heights, step = town(), {0: 4 * CELL, 1: 2 * CELL, 2: 0.0}
    for entry, parent in entries(tileset["root"]):
        away = drawn(folder, entry, tileset) - heights
        known = np.isfinite(away)
        rms = float(np.sqrt(np.mean(away[known] ** 2)))
        assert rms <= entry["geometricError"] + 1e-3, entry["content"]
        assert step[level(entry)] <= entry["geometricError"] <= max(3 * rms, step[level(entry)]) + 0.05
        assert parent is None or entry["geometricError"] <= parent["geometricError"]
    assert facts.error_m <= tileset["root"]["geometricError"] <= tileset["geometricError"]


def test_boxes_hold_their_vertices_and_those_of_the_tiles_below(made):
    folder, tileset, _ = made

    def ends(entry):
        box = np.array(entry["boundingVolume"]["box"])
        return box[:3] - np.diag(box[3:].reshape(3, 3)), box[:3] + np.diag(box[3:].reshape(3, 3))

    for entry, parent in entries(tileset["root"]):
        xyz, (low, high) = enu(read_tile(folder / entry["content"]["uri"])[0]), ends(entry)
        assert (low <= xyz).all() and (xyz <= high).all()
        if parent is not None:
            assert (ends(parent)[0] <= low + 2e-3).all() and (high <= ends(parent)[1] + 2e-3).all()


def test_neighbours_of_one_level_meet_without_gaps(made):
    folder, tileset, _ = made
    left, right = (
        {tuple(cell) for cell in np.rint(places(on_ground(folder, entry, tileset))).astype(int) if cell[1] == 256}
        for name in ("2_0_0", "2_0_1")
        for entry, _ in entries(tileset["root"])
        if pathlib.Path(entry["content"]["uri"]).stem == name
    )
    assert left == right and len(left) == 257


def test_triangles_are_seen_from_above(made):
    folder, tileset, _ = made
    for entry, _ in entries(tileset["root"]):
        xyz, _, corners, _ = read_tile(folder / entry["content"]["uri"])
        a, b, c = (enu(xyz)[corners[:, n], :2] for n in range(3))
        assert (((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) > 0).all()


def test_the_orthophoto_lies_where_it_belongs(tmp_path):
    dsm = write(tmp_path / "dsm.tif", town())
    rows, columns = np.indices((2 * ROWS, 2 * COLUMNS))
    ramp = np.stack([rows * 255 // (2 * ROWS), columns * 255 // (2 * COLUMNS), np.full(rows.shape, 90)]).astype("u1")
    ortho = gdal.GetDriverByName("GTiff").Create(str(tmp_path / "ortho.tif"), 2 * COLUMNS, 2 * ROWS, 3, gdal.GDT_Byte)
    ortho.SetGeoTransform((WEST, CELL / 2, 0, NORTH, 0, -CELL / 2))
    ortho.SetProjection(gdal.Open(dsm).GetProjection())
    ortho.WriteArray(ramp)
    ortho = None
    folder = tmp_path / "tiles"
    write_tiles3d(dsm, str(folder), str(tmp_path / "ortho.tif"))
    tileset = json.loads((folder / "tileset.json").read_text())
    for entry, _ in entries(tileset["root"]):
        _, uv, _, picture = read_tile(folder / entry["content"]["uri"])
        cells = places(on_ground(folder, entry, tileset))
        assert picture.shape == (3, 512, 512)  # two pixels for each cell of a leaf
        pixel = np.clip((uv * 512).astype(int), 0, 511)
        shown = picture[:, pixel[:, 1], pixel[:, 0]].astype(float)
        wanted = (cells.T + 0.5) / np.array([[ROWS], [COLUMNS]]) * 255
        # A picture's pixels lie in the middle of a tile, beyond the raster's end they repeat it; JPEG is not exact.
        assert np.abs(shown[:2] - wanted).max() < 6 and np.abs(shown[2] - 90).max() < 6


def test_heights_above_a_geoid_become_ellipsoidal(tmp_path):
    dsm = write(tmp_path / "dsm.tif", town()[:200, :200], "EPSG:32631+5773", "")
    folder = tmp_path / "tiles"
    write_tiles3d(dsm, str(folder))
    tileset = json.loads((folder / "tileset.json").read_text())
    ground = on_ground(folder, tileset["root"], tileset)
    cells = np.rint(places(ground)).astype(int)
    above = ground[:, 2] - town()[cells[:, 0], cells[:, 1]]
    geoid = Transformer.from_crs("EPSG:9707", "EPSG:4979", always_xy=True)
    lon, lat = Transformer.from_crs(32631, 4326, always_xy=True).transform(ground[:, 0], ground[:, 1])
    np.testing.assert_allclose(above, geoid.transform(lon, lat, np.zeros(len(lon)))[2], atol=0.002)
    assert 40 < above.mean() < 60


def test_a_dsm_that_states_no_datum_is_taken_to_be_above_the_ellipsoid_with_a_warning(tmp_path, told):
    dsm = write(tmp_path / "dsm.tif", town()[:50, :50], tag="")
    heard = told()
    result = run_stage("tiles3d", {"dsm": dsm, "tiles3d": str(tmp_path / "tiles")}, heard)
    assert any("does not state its vertical datum" in text for text in heard.warnings)
    assert any(text.startswith("3-D Tiles: 1 tile with ") for text in heard.notes)
    assert result.tiles == 1 and result.tileset == str(tmp_path / "tiles" / "tileset.json")


def test_only_windows_of_a_tile_are_read(tmp_path, monkeypatch):
    read, sizes = tiles3d.read_heights, []

    def noted(dataset, window):
        sizes.append((window.width, window.height))
        return read(dataset, window)

    monkeypatch.setattr(tiles3d, "read_heights", noted)
    write_tiles3d(write(tmp_path / "dsm.tif", town()), str(tmp_path / "tiles"))
    assert len(sizes) == 9 and max(max(size) for size in sizes) == 257


def test_an_island_that_coarse_tiles_do_not_see_stays(tmp_path):
    heights = np.full((600, 600), np.nan, np.float32)
    heights[301:303, 301:303] = 50.0
    facts = write_tiles3d(write(tmp_path / "dsm.tif", heights), str(tmp_path / "tiles"))
    tileset = json.loads((tmp_path / "tiles" / "tileset.json").read_text())
    listed = [entry["content"]["uri"] for entry, _ in entries(tileset["root"]) if "content" in entry]
    assert listed == ["tiles/2_1_1.glb"] and (facts.tiles, facts.vertices, facts.triangles) == (1, 4, 2)


def test_what_cannot_be_written_is_said_and_nothing_is_lost(tmp_path):
    empty = write(tmp_path / "empty.tif", np.full((40, 40), np.nan))
    with pytest.raises(EmptyResultError, match="no three heights"):
        write_tiles3d(empty, str(tmp_path / "tiles"))
    assert not (tmp_path / "tiles").exists()
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "letter.txt").write_text("dear")
    with pytest.raises(WorkspaceError, match="letter.txt"):
        write_tiles3d(write(tmp_path / "dsm.tif", town()), str(mine))
    assert (mine / "letter.txt").exists()
    nowhere = gdal.GetDriverByName("GTiff").Create(str(tmp_path / "nowhere.tif"), 40, 40, 1, gdal.GDT_Float32)
    nowhere.GetRasterBand(1).Fill(1.0)
    nowhere = None
    with pytest.raises(RepmError):
        write_tiles3d(str(tmp_path / "nowhere.tif"), str(tmp_path / "tiles"))


def test_the_validator_of_gltf_finds_nothing(made):
    found = gltf_issues(sorted((made[0] / "tiles").iterdir()))
    assert {(issue["numErrors"], issue["numWarnings"]) for issue in found} == {(0, 0)}


@pytest.mark.slow
@pytest.mark.skipif(PROGRAM is None, reason="needs Chromium")
def test_cesium_draws_all_levels(made, tmp_path):
    loaded, picture = drawn_by_cesium(made[0], tmp_path)
    middle = picture[:, 150:450, 200:600].astype(int)
    assert loaded >= 5
    assert (middle.max(axis=0) > 40).mean() > 0.8 and middle.std() > 10, "the surface is in the middle of the picture"


def test_an_orthophoto_of_another_place_is_refused_and_a_part_is_named(tmp_path, told):
    dsm = write(tmp_path / "dsm.tif", town())
    for name, east, raised in (("beside", 400.0, True), ("half", 150.0, False), ("holes", 0.0, False)):
        ortho = str(tmp_path / f"{name}.tif")
        raster = gdal.GetDriverByName("GTiff").Create(ortho, COLUMNS, ROWS, 3, gdal.GDT_Byte)
        raster.SetGeoTransform((WEST + east, CELL, 0, NORTH, 0, -CELL))
        raster.SetProjection(gdal.Open(dsm).GetProjection())
        if name == "holes":
            for band in (1, 2, 3):
                raster.GetRasterBand(band).SetNoDataValue(0)
                raster.GetRasterBand(band).WriteArray(np.full((ROWS, COLUMNS // 2), 99, np.uint8))
        raster = None
        said, options = told(), {"dsm": dsm, "ortho": ortho, "tiles3d": str(tmp_path / name)}
        if raised:
            with pytest.raises(
                OverlapError, match="The orthophoto '.*beside.tif' does not lie over the DSM '.*dsm.tif'"
            ):
                run_stage("tiles3d", options, said)
            assert not (tmp_path / name).exists()
        else:
            run_stage("tiles3d", options, said)
            assert any("shows 50.0 % of the heights" in text for text in said.warnings)


@pytest.mark.parametrize("blank", (False, True))
def test_an_orthophoto_of_one_colour_is_named(tmp_path, told, blank):
    dsm, ortho = write(tmp_path / "dsm.tif", town()), str(tmp_path / "ortho.tif")
    raster = gdal.GetDriverByName("GTiff").Create(ortho, COLUMNS, ROWS, 3, gdal.GDT_Byte)
    raster.SetGeoTransform((WEST, CELL, 0, NORTH, 0, -CELL))
    raster.SetProjection(gdal.Open(dsm).GetProjection())
    shades = (np.indices((ROWS, COLUMNS)).sum(0) % 200).astype(np.uint8)
    for band in (1, 2, 3):
        raster.GetRasterBand(band).WriteArray(shades if not blank else np.zeros_like(shades))
    raster, said = None, told()
    run_stage("tiles3d", {"dsm": dsm, "ortho": ortho, "tiles3d": str(tmp_path / "t")}, said)
    assert any("has one colour nearly everywhere" in text for text in said.warnings) == blank


@pytest.mark.parametrize("shape", ((1, 1), (1, 40), (40, 40)), ids=("one height", "one row", "none"))
def test_a_dsm_without_a_triangle_is_refused_by_what_it_lacks(tmp_path, told, shape):
    dsm = write(tmp_path / "dsm.tif", np.full(shape, 50.0 if min(shape) == 1 else np.nan))
    with pytest.raises(EmptyResultError, match="dsm.tif' has no three heights beside each other"):
        run_stage("tiles3d", {"dsm": dsm, "tiles3d": str(tmp_path / "t")}, told())


def test_a_geoid_that_proj_does_not_know_is_said_with_a_remedy_that_there_is(tmp_path, told):
    dsm = write(tmp_path / "dsm.tif", town(), "EPSG:32631+5711", "")  # Australian heights in Europe
    with pytest.raises(
        MissingPackageError, match="AHD height.*: convert the heights to the ellipsoid first"
    ) as refused:
        run_stage("tiles3d", {"dsm": dsm, "tiles3d": str(tmp_path / "t")}, told())
    assert "VERTICAL_DATUM" not in str(refused.value)
