"""Orthophotos on cells finer than their DSM's, against what the images' RPCs and the ground itself say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal
from scipy import ndimage

from repm_qgis.contracts.errors import OptionError
from repm_qgis.contracts.options import DsmFuseOptions
from repm_qgis.fusion.finished import FinishedSurface
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.footprints import ray_slope
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.imagery.raster import write
from repm_qgis.ortho.grey_ortho import make_grey_ortho
from repm_qgis.ortho.parameters import ORTHO
from repm_qgis.ortho.view_choice import chosen_views
from repm_qgis.scene import load_views
from repm_qgis.stages import run_stage
from repm_qgis.stages.early import require_ortho_cell
from repm_qgis.stages.parameters import ENGINE
from tests.engine.rasters import bands


@pytest.fixture
def seen(urban, tmp_path, write_image, told):
    """A function from heights on cells of 0.6 m and cells of an orthophoto to that orthophoto of the town's first view,
    whose brightness is made to tell the column or the row that it was taken from; and the view."""
    x0, y0, x1, y1 = urban.bounds
    grid = CellGrid(np.floor((x0 + x1) / 2) - 30, np.floor((y0 + y1) / 2) + 30, 0.6, (100, 100))
    rows, cols = np.mgrid[:400, :400].astype(np.float32)
    import pyproj

    def made(heights, cell, told_by="col", parameters=ORTHO, workers=1):
        dsm, path = str(tmp_path / "dsm.tif"), str(tmp_path / "ortho.tif")
        wkt = pyproj.CRS(urban.crs).to_wkt()
        write(dsm, [heights(grid).astype(np.float32)], grid.geotransform, wkt)
        image = write_image(tmp_path / "i.tif", 10 * (cols if told_by == "col" else rows) + 100, urban.views[0].rpc)
        views = load_views((image,))
        options = DsmFuseOptions(scene="s", output=dsm, workers=workers)
        surface = FinishedSurface.of(dsm, urban.crs, HeightDatum.of(""))
        given = {"path": path, "folder": str(tmp_path), "progress": told(), "cell": cell, "parameters": parameters}
        make_grey_ortho(views, surface, options, **given)
        (values,), transform = bands(path)
        return values, CellGrid(transform[0], transform[3], transform[1], values.shape), views[0]

    return made


def on_ground(urban, grid, height):
    xs, ys = grid.centres()
    lon_lat = geodetic_from_projected(urban.crs, np.stack(np.meshgrid(xs, ys), axis=-1))
    return np.concatenate([lon_lat, np.broadcast_to(height, grid.shape)[..., None]], axis=-1)


@pytest.mark.parametrize(("cell", "told_by"), [(0.3, "col"), (0.3, "row"), (0.2, "col"), (0.5, "row")])
def test_each_cell_has_the_brightness_of_its_own_pixel(urban, seen, cell, told_by):
    """Hills of 8 m, whose heights are known everywhere: the RPC alone says where each fine cell is seen."""

    def hills(grid):
        x, y = grid.centres()
        return 200 + 8 * np.sin(x / 9)[None] * np.cos(y / 11)[:, None]

    found, grid, view = seen(hills, cell, told_by)
    assert abs(grid.cell - cell) < 1e-9
    expected = view.rpc.project(on_ground(urban, grid, hills(grid)))[..., 0 if told_by == "col" else 1]
    known = np.isfinite(found)
    assert known.mean() > 0.95
    off = np.abs((found - 100) / 10 - expected)
    assert off[3:-3, 3:-3][known[3:-3, 3:-3]].max() < 0.1  # px
    assert off[known].max() < 0.3, "at the rim heights are known on one side only"


def test_what_a_tower_hides_ends_where_its_line_of_sight_does(urban, seen):
    """To a fine cell, not to one of the DSM: 30 m of a tower hide as much ground as the RPC says."""

    def tower(grid):
        height = np.full(grid.shape, 180.0)
        height[40:60, 40:60] = 210.0
        return height

    found, grid, view = seen(tower, 0.2)
    coarse = CellGrid(grid.west, grid.north, 0.6, (100, 100))
    east, north = ray_slope(view, on_ground(urban, coarse, 195.0)[50, 50, :2], 195.0)
    x, y = grid.centres()
    box = coarse.west + 24, coarse.west + 36, coarse.north - 36, coarse.north - 24
    hidden, nearly = (np.zeros(grid.shape, bool) for _ in range(2))
    for lift in np.arange(0.02, 30.0, 0.02):
        at_x, at_y = x[None] + lift * east, y[:, None] + lift * north
        for margin, mask in ((-0.6, hidden), (0.6, nearly)):
            across = (at_x > box[0] - margin) & (at_x < box[1] + margin)
            within = across & (at_y > box[2] - margin) & (at_y < box[3] + margin)
            if margin > 0 or lift < 29.0 - 0.6 / np.hypot(east, north):  # what must pass is a metre higher
                mask |= within
    roof = (x[None] > box[0]) & (x[None] < box[1]) & (y[:, None] > box[2]) & (y[:, None] < box[3])
    assert np.isfinite(found[roof]).all()
    assert np.isnan(found[hidden & ~roof]).all() and (hidden & ~roof).sum() > 1500
    assert np.isfinite(found[~nearly]).all()


def test_walls_are_not_smeared(urban, seen):
    """Beside a wall every cell shows the pixel of the roof or of the ground, and never one between them."""

    def step(grid):
        height = np.full(grid.shape, 180.0)
        height[:, 50:] = 200.0
        return height

    for told_by, axis in (("col", 0), ("row", 1)):
        found, grid, view = seen(step, 0.2, told_by)
        low, high = (view.rpc.project(on_ground(urban, grid, level))[..., axis] for level in (180.0, 200.0))
        pixel, known = (found - 100) / 10, np.isfinite(found)
        west = np.arange(grid.shape[1]) < 150
        assert np.abs(pixel - low)[known & west[None]].max() < 0.1
        assert np.abs(pixel - high)[known & ~west[None]].max() < 0.1


def test_blocks_and_workers_change_no_byte(seen):
    def rough(grid):
        return 200 + np.random.default_rng(3).uniform(0, 6, grid.shape)

    whole, _, _ = seen(rough, 0.3)
    small = replace(ORTHO, block_cells=64)
    blocks = [seen(rough, 0.3, parameters=small, workers=workers)[0] for workers in (1, 2)]
    np.testing.assert_array_equal(*blocks)
    assert (np.isnan(blocks[0]) == np.isnan(whole)).mean() > 0.995
    both = np.isfinite(blocks[0]) & np.isfinite(whole)
    assert np.abs(blocks[0] - whole)[both].max() < 1.0  # a tenth of a px


# --- in colour, with all that is made of it ---


@pytest.fixture(scope="module")
def orthophotos(town, tmp_path_factory, told):
    """The town's orthophotos in colour by their cells (0: of the finest image), with what is painted with them."""
    folder, results = tmp_path_factory.mktemp("resolution"), {}
    for cell in (0.0, 1.0):
        name = folder / f"o{cell:g}"
        name.mkdir()
        more = {"mesh": str(name / "m.glb"), "cloud": str(name / "c.laz"), "confidence": str(name / "c.tif")}
        results[cell] = fuse(town["scene"], name, told, xs=town["xs"], ortho_resolution=cell, **more)
    return results


def fuse(scene, folder, told, parameters=ENGINE, **options):
    made = {"output": str(folder / "dsm.tif"), "ortho": str(folder / "ortho.tif"), "colour": "all", "resolution": 1.0}
    return run_stage("dsmfuse", {"scene": scene, **made, **options}, told(), parameters)


def pixels(path):
    return gdal.Open(path).ReadAsArray().astype(float)


@pytest.mark.slow
@pytest.mark.long
def test_by_default_it_has_the_finest_images_ground_sampling_distance(orthophotos):
    fine, coarse = (gdal.Open(orthophotos[cell].ortho) for cell in (0.0, 1.0))
    assert fine.GetGeoTransform()[1] == 0.5 and coarse.GetGeoTransform()[1] == 1.0
    assert (fine.RasterXSize, fine.RasterYSize) == (2 * coarse.RasterXSize, 2 * coarse.RasterYSize)
    assert fine.GetGeoTransform()[0] == coarse.GetGeoTransform()[0]
    assert fine.GetRasterBand(1).GetDescription() == "red" and fine.GetRasterBand(1).DataType == gdal.GDT_UInt16


@pytest.mark.long
def test_it_shows_the_true_detail_that_the_cells_of_the_dsm_do_not(town, orthophotos):
    """Structures of a few pixels, of both against the true ground in cells of 0.5 m, on which GDAL interpolates the
    coarser one. The scene has no control points: its place, that of the RPCs, is looked for."""
    paths = [orthophotos[cell].ortho for cell in (0.0, 1.0)]
    dataset = gdal.Open(paths[0])
    x, cell, _, y, _, down = dataset.GetGeoTransform()
    ends = np.array((x, y + down * dataset.RasterYSize, x + cell * dataset.RasterXSize, y))

    def on_cells(path, way, margin=0.0):
        frame = {"format": "MEM", "xRes": cell, "yRes": cell, "outputType": gdal.GDT_Float32, "resampleAlg": way}
        bounds = tuple(ends + margin * np.array((-1, -1, 1, 1)))
        return gdal.Warp("", path, outputBounds=bounds, **frame).ReadAsArray()[1]

    greens = [on_cells(path, "cubic") for path in paths]
    known = ndimage.binary_erosion((greens[0] > 0) & (greens[1] > 0), iterations=3)
    detail = [_detail(green)[known] for green in greens]
    best, wide = [0.0, 0.0], _detail(on_cells(town["truth"], "average", 1.5))
    for top, left in np.ndindex(7, 7):  # cells of 0.5 m
        true = wide[top:, left:][: known.shape[0], : known.shape[1]][known]
        best = [max(found, float(np.corrcoef(each, true)[0, 1])) for found, each in zip(best, detail)]
    assert best[0] > 0.55 and best[0] > best[1] + 0.08, best  # it was 0.597 and 0.483


def _detail(image):
    return image - ndimage.gaussian_filter(image, 1.0)


@pytest.mark.long
def test_it_is_as_complete_as_on_the_cells_of_the_dsm(orthophotos):
    fine, coarse = (pixels(orthophotos[cell].ortho)[0] > 0 for cell in (0.0, 1.0))
    apart = fine != coarse.repeat(2, axis=0).repeat(2, axis=1)
    assert apart.mean() < 0.02 and fine.mean() > coarse.mean() - 0.01


@pytest.mark.slow
def test_workers_change_no_byte_of_its_colours(town, orthophotos, tmp_path, told):
    small = replace(ENGINE, ortho=replace(ENGINE.ortho, block_cells=100))
    found = []
    for workers in (1, 3):
        (tmp_path / str(workers)).mkdir()
        found.append(fuse(town["scene"], tmp_path / str(workers), told, small, workers=workers, xs=town["xs"]))
    assert Path(found[0].ortho).read_bytes() == Path(found[1].ortho).read_bytes()
    blocks, whole = (pixels(path) for path in (found[0].ortho, orthophotos[0.0].ortho))
    assert ((blocks == 0) == (whole == 0)).mean() > 0.99


@pytest.mark.long
def test_what_is_painted_with_it_has_the_colours_of_its_place(orthophotos):
    """A mesh's picture is the orthophoto, finer than the mesh; the cloud's points have its cells."""
    import laspy

    made = orthophotos[0.0]
    data = Path(made.mesh).read_bytes()
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    picture = Path(made.mesh).with_suffix(".jpg")
    start = 20 + length + 8 + view.get("byteOffset", 0)
    picture.write_bytes(data[start : start + view["byteLength"]])
    shown, ortho = gdal.Open(str(picture)), gdal.Open(made.ortho)
    assert (shown.RasterXSize, shown.RasterYSize) == (ortho.RasterXSize, ortho.RasterYSize)
    cloud = laspy.read(made.cloud)
    x, cell, _, y, _, down = ortho.GetGeoTransform()
    column, row = ((cloud.x - x) // cell).astype(int), ((cloud.y - y) // down).astype(int)
    values = pixels(made.ortho)[0][row, column]
    low, high = np.percentile(values[values > 0], (10, 90))
    middle = (values > low) & (values < high)
    assert np.corrcoef(values[middle], np.asarray(cloud.red)[middle])[0, 1] > 0.999


@pytest.mark.long
def test_vertices_take_the_mean_of_their_cell(orthophotos, tmp_path):
    """The PLY has a vertex for each cell of the DSM: four cells of the orthophoto."""
    from repm_qgis.solids.mesh import write_mesh

    made = orthophotos[0.0]
    write_mesh(made.output, str(tmp_path / "m.ply"), ortho=made.ortho)
    header, _, rest = (tmp_path / "m.ply").read_bytes().partition(b"end_header\n")
    vertices = int(header.split(b"element vertex ")[1].split()[0])
    record = np.frombuffer(rest, [("place", "<f8", 3), ("colour", "u1", 3)], vertices)
    x, cell, _, y, _, down = gdal.Open(made.output).GetGeoTransform()
    column, row = ((record["place"][:, i] - start) // step for i, start, step in ((0, x, cell), (1, y, down)))
    fine = pixels(made.ortho)[0]
    parts = np.where(fine > 0, fine, np.nan).reshape(fine.shape[0] // 2, 2, fine.shape[1] // 2, 2)
    means = parts.mean(axis=(1, 3))[row.astype(int), column.astype(int)]
    known = np.isfinite(means)
    assert known.mean() > 0.9
    low, high = np.nanpercentile(means, (10, 90))
    middle = known & (means > low) & (means < high)
    assert np.corrcoef(means[middle], record["colour"][middle, 0])[0, 1] > 0.97


@pytest.mark.long
def test_reports_and_pages_lay_it_on_the_cells_of_the_dsm(orthophotos, tmp_path, told):
    from repm_qgis.reports.report import Report
    from repm_qgis.reports.stage_reports import _confidence

    made = orthophotos[0.0]
    _confidence(Report("t", "s"), made.confidence, made.ortho, made.output)
    page = {"dsm": made.output, "ortho": made.ortho, "viewer": str(tmp_path / "p.html")}
    run_stage("viewer", page, told())
    assert (tmp_path / "p.html").stat().st_size > 10_000


# --- the choice of views goes on across blocks ---


def test_a_choice_that_was_made_before_is_kept_and_continued():
    rng = np.random.default_rng(4)
    ground = rng.normal(100, 10, (40, 60)).astype(np.float32)
    colours = np.stack([ground, ground + 40])[:, None]
    held = np.full(ground.shape, -1, np.int8)
    held[:, :20] = 1
    assert (chosen_views(colours, (0.1, 0.3), (10.0,)) == 0).mean() > 0.99
    labels = chosen_views(colours, (0.1, 0.3), (10.0,), held=held)
    assert (labels[:, :20] == 1).all() and set(np.unique(labels)) <= {0, 1}


# --- what is refused ---


def test_cells_that_make_no_sense_are_refused():
    with pytest.raises(OptionError, match="ORTHO_RESOLUTION is 2.0: it must be at most 1 m, the DSM's resolution"):
        require_ortho_cell(2.0, 1.0, 0.5, ENGINE.tiles)
    with pytest.raises(OptionError, match="ORTHO_RESOLUTION is 0.1: it must be at least 0.12 m"):
        require_ortho_cell(0.1, 1.0, 0.5, ENGINE.tiles)
    for cell in (0.0, 1.0, 0.5, 0.13):
        require_ortho_cell(cell, 1.0, 0.5, ENGINE.tiles)
