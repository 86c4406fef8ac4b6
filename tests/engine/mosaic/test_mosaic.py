"""Many DSMs to one, from files to files."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest
from osgeo import gdal
from scipy import ndimage

from repm_qgis.contracts.errors import (
    Cancelled,
    ImageError,
    OptionError,
    OverlapError,
    RepmError,
    SceneError,
    WorkspaceError,
)
from repm_qgis.geometry.vertical import DEVIATION_TAG, ELLIPSOID, PLACED, PLACED_TAG, TAG
from repm_qgis.imagery import raster
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE

UTM31, UTM32 = "EPSG:32631", "EPSG:32632"
ROOT = Path(__file__).resolve().parents[3]
SMALL = replace(ENGINE, mosaic=replace(ENGINE.mosaic, block_cells=96, tile_blocks=2))
WEST, NORTH = 740000.0, 4850000.0  # where both zones have a place
STARTS = ((0, 0), (110, 0), (0, 110), (110, 110))  # columns and rows of the first cells of four DSMs
SIDE = 190
ADDED = (2.5, -3.0, 0.75, -0.25)  # what must be added to each; their mean is zero


def ground(x, y):
    """A slope with houses every 30 m, at places in UTM 31."""
    u, v = x - WEST, NORTH - y
    house = (np.mod(u, 30.0) > 16.0) & (np.mod(v, 30.0) > 18.0)
    return 200.0 + 0.05 * u - 0.02 * v + 8.0 * house


def write(path, start, side, values=None, crs=UTM31, cell=1.0, tags=None, unit="m", vertical=None):
    """A DSM whose first cell lies at columns and rows from the corner of all, in its own CRS; gives its path."""
    place = (WEST + start[0], cell, 0.0, NORTH - start[1], 0.0, -cell)
    if crs != UTM31:
        x, y = pyproj.Transformer.from_crs(UTM31, crs, always_xy=True).transform(place[0], place[3])
        place = (round(x), cell, 0.0, round(y), 0.0, -cell)
    rows, columns = np.indices((side, side)) + 0.5
    x, y = place[0] + columns * cell, place[3] - rows * cell
    if crs != UTM31:
        x, y = pyproj.Transformer.from_crs(crs, UTM31, always_xy=True).transform(x, y)
    heights = (values or ground)(x, y)
    tags = {TAG: ELLIPSOID} if tags is None else tags
    wkt = pyproj.CRS.from_user_input(f"{crs}+{vertical}" if vertical else crs).to_wkt()
    return raster.write(str(path), [heights.astype(np.float32)], place, wkt, metadata=tags, unit=unit)


def noisy(number, noise=0.06):
    """A DSM's surface: the ground with its offset, noise with a grain of two cells, and a hole."""

    def surface(x, y):
        rng = np.random.default_rng(number)
        grain = ndimage.gaussian_filter(rng.normal(0, 1, x.shape), 1.0)
        heights = ground(x, y) - ADDED[number] + noise * grain / grain.std()
        heights[20:40, 100 + 8 * number : 115 + 8 * number] = np.nan
        return heights

    return surface


@pytest.fixture(scope="module")
def four(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dsms")
    return [write(folder / f"dsm_{i}.tif", start, SIDE, noisy(i)) for i, start in enumerate(STARTS)]


def mosaic(told, folder, dsms, progress=None, parameters=ENGINE, **options):
    options = {"output": str(folder / "mosaic.tif"), "workers": 1, **options}
    return run_stage("mosaic", {"dsms": list(dsms), **options}, progress or told(), parameters)


def read(path, band=1):
    with raster.opened(path) as dataset:
        return raster.read(dataset, band=band)


@pytest.fixture(scope="module")
def made(four, tmp_path_factory, told):
    folder, said = tmp_path_factory.mktemp("mosaic"), told()
    more = {"sources": str(folder / "sources.tif"), "report": str(folder / "report.html")}
    return mosaic(told, folder, four, said, **more), said


def test_offsets_are_solved_and_seams_are_below_a_decimetre(made):
    result, said = made
    added, deviation = ([getattr(each, name) for each in result.offsets] for name in ("added", "deviation"))
    assert added == pytest.approx(ADDED, abs=0.01) and 0 < max(deviation) < 0.02
    assert (result.groups, result.overlaps) == (1, 6) and result.seam < 0.1
    heights, source = read(result.output), read(result.sources)
    rows, columns = np.indices(heights.shape) + 0.5
    error = heights - ground(WEST + columns, NORTH - rows)
    assert np.nanmax(np.abs(error)) < 0.6  # a roof that was averaged with the ground would be 4 m wrong
    for turned, from_dsm in ((error, source), (error.T, source.T)):
        step = np.abs(np.diff(turned, axis=1))[from_dsm[:, 1:] != from_dsm[:, :-1]]
        assert len(step) > 200 and np.nanmedian(step) < 0.06
    assert any("the mean of all offsets is zero" in text for text in said.notes)
    assert sum("m are added" in text for text in said.notes) == 4 and not said.warnings


@pytest.mark.parametrize(
    ("second", "named", "size"),
    (
        (lambda x, y: ground(x, y) + 0.03 * (x - WEST), "overlap-tilted", 0.03 * 80),
        (lambda x, y: ground(x, y) - 0.02 * (NORTH - y), "overlap-tilted", 0.02 * SIDE),
        (lambda x, y: ground(x, y) + 0.006 * (x - WEST), "overlap-tilted", 0.006 * 80),
        (lambda x, y: 200.0 + 0.05 * (x - WEST) - 0.02 * (NORTH - y), "overlap-bare", 0),
        (lambda x, y: ground(x, y) + 0.002 * (x - WEST), "", 0),
        (lambda x, y: ground(x, y) + 6.0 * ((abs(x - WEST - 126) < 6) & (abs(NORTH - y - 6) < 6)), "", 0),
    ),
    ids=("tilted east", "tilted north", "tilted beyond", "terrain", "hardly tilted", "new house"),
)
def test_a_tilted_dsm_and_a_terrain_are_named(tmp_path, told, second, named, size):
    """The far end of a tilted DSM was 7 m off, and half of a town had no houses, under "Good."."""
    dsms = [write(tmp_path / "a.tif", (0, 0), SIDE), write(tmp_path / "b.tif", (110, 0), SIDE, second)]
    said = told()
    mosaic(told, tmp_path, dsms, said, report=str(tmp_path / "r.html"))
    assert [each.id for each in said.warnings if each.id.startswith("overlap")] == ([named] if named else [])
    if size:
        assert abs(float(re.search(r"by ([\d.]+) m over their overlap", said.warnings[0])[1]) - size) < 0.1 * size


def test_products_say_where_heights_come_from(made, four):
    result, _ = made
    heights = read(result.output)
    number, count, spread = (read(result.sources, band) for band in (1, 2, 3))
    with raster.opened(result.output) as dataset:
        assert dataset.GetMetadataItem(TAG) == ELLIPSOID and dataset.GetRasterBand(1).GetUnitType() == "m"
        assert dataset.GetMetadata("IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert dataset.GetGeoTransform() == (WEST, 1.0, 0.0, NORTH, 0.0, -1.0)
    with raster.opened(result.sources) as dataset:
        assert [dataset.GetMetadataItem(f"DSM_{i + 1}") for i in range(4)] == four
    # Where one DSM alone has heights, the mosaic has these and its offset, to the digit.
    own = read(four[0]) + np.float32(result.offsets[0].added)
    alone = (count == 1)[:100, :100]
    assert alone.sum() > 8000 and (number[:100, :100][alone] == 1).all()
    assert heights[:100, :100][alone] == pytest.approx(own[:100, :100][alone], abs=1e-4)
    assert np.nanmax(count) == 4 and (np.isnan(spread) == (np.nan_to_num(count) < 2)).all()
    assert (np.isnan(heights) == np.isnan(number)).all() and np.isnan(
        heights
    ).sum() == 20 * 25  # two holes that no other DSM sees
    page = open(result.report, encoding="utf-8").read()
    top = page[: page.index("<img")]
    assert "<strong>Good.</strong> After the offsets, the median differences" in " ".join(top.split())
    assert page.count("data:image/png") == 2 and all(path in page for path in four) and "+2.499" in page
    json.dumps(result.to_mapping(), allow_nan=False)


@pytest.mark.long
def test_fixed_dsms_keep_their_heights(four, tmp_path, told):
    said = told()
    found = mosaic(told, tmp_path, four, said, fixed=[four[1]]).offsets
    assert found[1].added == 0 and found[1].deviation == 0
    assert [each.added for each in found] == pytest.approx(np.array(ADDED) - ADDED[1], abs=0.01)
    assert any("its heights are fixed" in text for text in said.notes)


@pytest.mark.long
def test_dsms_that_were_registered_are_fixed_by_themselves(four, tmp_path, told):
    """Where the file says it, in the plugin's own words; nothing else that stands there counts."""
    for text, first in ((PLACED[0], 0.0), ("somebody says so", ADDED[1])):
        placed = str(tmp_path / "placed.tif")
        shutil.copyfile(four[1], placed)
        dataset = gdal.Open(placed, gdal.GA_Update)
        dataset.SetMetadataItem(PLACED_TAG, text)
        dataset = None
        found = mosaic(told, tmp_path, [four[0], placed, *four[2:]]).offsets
        assert found[1].added == pytest.approx(first, abs=0.01)


@pytest.mark.long
def test_neither_blocks_nor_workers_change_the_result(four, made, tmp_path, told):
    parts = mosaic(told, tmp_path, four, parameters=SMALL, workers=2)
    one, other = read(parts.output), read(made[0].output)
    assert (np.isnan(one) == np.isnan(other)).all()
    # Rounding decides for a house that both DSMs have an equal share of: these lie symmetrically.
    assert (np.abs(one - other)[np.isfinite(one)] < 1e-3).mean() > 0.999
    again = mosaic(told, tmp_path, four, parameters=SMALL, workers=1, output=str(tmp_path / "again.tif"))
    assert open(again.output, "rb").read() == open(parts.output, "rb").read()


def test_dsms_of_other_crs_and_cells_are_not_shifted(tmp_path, told):
    """A plane of 10 % slope: half a cell of 2 m would be 0.1 m."""

    def plane(x, y):
        return 0.1 * (x - WEST) + 0.07 * (y - NORTH) + 500.0

    first = write(tmp_path / "a.tif", (0, 0), 150, plane)
    second = write(tmp_path / "b.tif", (90, 20), 80, plane, UTM32, cell=2.0)
    result = mosaic(told, tmp_path, [first, second], sources=str(tmp_path / "s.tif"))
    assert [each.added for each in result.offsets] == pytest.approx([0, 0], abs=0.01)
    heights = read(result.output)
    with raster.opened(result.output) as dataset:
        x0, cell, _, y0, _, _ = dataset.GetGeoTransform()
    dataset = None  # else the file is in use, and Windows does not let it be replaced
    rows, columns = np.indices(heights.shape) + 0.5
    error = heights - plane(x0 + columns * cell, y0 - rows * cell)
    # In the outer half of its border cells a DSM has no slope.
    assert np.nanpercentile(np.abs(error), 97) < 0.02 and np.nanmax(np.abs(error)) < 0.15 and cell == 1.0
    assert (read(result.sources) == 2).sum() > 10_000
    coarse = mosaic(told, tmp_path, [first, second], resolution=3.0, crs=UTM32)
    with raster.opened(coarse.output) as dataset:
        x0, cell, _, y0, _, _ = dataset.GetGeoTransform()
        assert cell == 3.0 and pyproj.CRS.from_wkt(dataset.GetProjection()).to_epsg() == 32632
    heights = read(coarse.output)
    rows, columns = np.indices(heights.shape) + 0.5
    x, y = pyproj.Transformer.from_crs(UTM32, UTM31, always_xy=True).transform(x0 + columns * 3, y0 - rows * 3)
    assert np.nanpercentile(np.abs(heights - plane(x, y)), 95) < 0.02


@pytest.mark.long
def test_confidences_give_cells_to_the_better_dsm(four, tmp_path, told):
    """One band of errors, or the plugin's confidence with its five; one DSM has none."""
    good = write(tmp_path / "good.tif", STARTS[0], SIDE, lambda x, y: np.full(x.shape, 0.03))
    with raster.opened(four[1]) as dataset:
        place, crs = dataset.GetGeoTransform(), dataset.GetProjection()
    bands = [np.full((SIDE, SIDE), value, np.float32) for value in (0.01, 0.01, 0.01, 0.01, 0.6)]
    names = ["a", "b", "c", "d", "expected error (m): two of three errors are smaller"]
    bad = raster.write(str(tmp_path / "bad.tif"), bands, place, crs, descriptions=names)
    shares = {}
    for label, confidences in (("equal", ()), ("given", (good, bad, "", ""))):
        out = str(tmp_path / f"{label}.tif")
        result = mosaic(told, tmp_path, four, sources=out, confidences=confidences)
        shares[label] = [int((read(result.sources) == number).sum()) for number in (1, 2)]
    assert shares["given"][0] > 1.1 * shares["equal"][0] and shares["given"][1] < 0.9 * shares["equal"][1]
    several = raster.write(str(tmp_path / "several.tif"), bands[:2], place, crs)
    with pytest.raises(ImageError, match=r"several\.tif' of CONFIDENCES has 2 bands, and none is called 'expected er"):
        mosaic(told, tmp_path, four, confidences=(good, several, "", ""))


def test_groups_that_do_not_overlap_are_named(four, tmp_path, told):
    far = [write(tmp_path / f"far_{i}.tif", (600 + 40 * i, 0), 100) for i in range(2)]
    said = told()
    result = mosaic(told, tmp_path, [*four, *far], said)
    assert result.groups == 2 and "far_0.tif, far_1.tif)" in said.warnings[0]
    with raster.opened(result.output) as dataset:
        assert dataset.RasterXSize == 740


def test_vertical_datums_must_agree(four, tmp_path, told):
    silent = write(tmp_path / "silent.tif", (0, 0), 100, tags={})
    said = told()
    assert mosaic(told, tmp_path, [four[0], silent], said).vertical_datum == ELLIPSOID
    assert said.warnings == [
        f"'{silent}' does not state a vertical datum: all heights are assumed to refer to {ELLIPSOID}."
    ]
    geoid = write(tmp_path / "geoid.tif", (0, 0), 100, tags={}, vertical=5773)
    with pytest.raises(ImageError, match="convert all DSMs to one vertical datum") as caught:
        mosaic(told, tmp_path, [four[0], geoid])
    assert geoid in str(caught.value) and "EGM96" in str(caught.value)
    other = write(tmp_path / "other.tif", (50, 0), 100, tags={}, vertical=5773)
    both = mosaic(told, tmp_path, [geoid, other])
    with raster.opened(both.output) as dataset:
        assert "EGM96" in dataset.GetMetadataItem(TAG) and pyproj.CRS.from_wkt(dataset.GetProjection()).is_compound


def bad_inputs(folder, four):
    """Options, the kind of error, and the words that the one sentence must have."""
    text = folder / "notes.tif"
    text.write_text("no raster")
    feet = write(folder / "feet.tif", (0, 0), 60, unit="furlong")
    away = write(folder / "away.tif", (900, 0), 60)
    degrees = raster.write(
        str(folder / "degrees.tif"), [np.ones((50, 50), np.float32)], (6, 1e-4, 0, 43.8, 0, -1e-4), "EPSG:4326"
    )
    nowhere = raster.write(str(folder / "nowhere.tif"), [np.ones((50, 50), np.float32)], None, "")
    empty = [write(folder / f"empty_{i}.tif", (i, 0), 60, lambda x, y: np.full(x.shape, np.nan)) for i in range(2)]
    return {
        "one DSM": ({"dsms": four[:1]}, OptionError, "must name at least two DSMs"),
        "fine": ({"dsms": four, "resolution": 0.05}, OptionError, "RESOLUTION is 0.05: it must be at least 0.25 m, a"),
        "none": ({"dsms": []}, OptionError, "must name at least two DSMs"),
        "twice": ({"dsms": [four[0], four[1], four[0]]}, OptionError, f"DSMS is '{four[0]}': it is named twice"),
        "not there": ({"dsms": [four[0], "gone.tif"]}, ImageError, "'gone.tif'"),
        "no raster": ({"dsms": [four[0], str(text)]}, ImageError, "notes.tif"),
        "feet": ({"dsms": [four[0], feet]}, ImageError, f"'{feet}' has heights in 'furlong': convert them to metres"),
        "no overlap": ({"dsms": [four[0], away]}, OverlapError, "choose DSMs that overlap"),
        "no heights": ({"dsms": empty}, OverlapError, "No two of the 2 DSMs have heights in 400 common cells"),
        "degrees": ({"dsms": [degrees, four[0]]}, ImageError, "give a projected CRS, such as EPSG:32632"),
        "nowhere": ({"dsms": [nowhere, four[0]]}, ImageError, "not georeferenced"),
        "other crs": ({"dsms": four, "crs": "EPSG:4326"}, OptionError, "CRS"),
        "scene": ({"dsms": four[:1], "scenes": [str(text)]}, SceneError, "notes.tif"),
        "not among": ({"dsms": four[:2], "fixed": [four[2]]}, OptionError, f"FIXED is '{four[2]}': it must be one of"),
        "count": ({"dsms": four, "confidences": four[:2]}, OptionError, "or name 4 rasters"),
        "overwritten": ({"dsms": four, "output": four[2]}, OptionError, "is also a file of the input DSMS"),
        "no such option": ({"dsms": four, "blend": 3}, OptionError, "blend"),
    }


def test_bad_input_is_one_sentence_and_nothing_is_left(four, tmp_path, told):
    cases = bad_inputs(tmp_path, four)
    assert len(cases) == 17
    out = tmp_path / "out"
    out.mkdir()
    for label, (options, kind, words) in cases.items():
        with pytest.raises(kind) as caught:
            run_stage("mosaic", {"output": str(out / "m.tif"), **options}, told())
        message = str(caught.value)
        assert isinstance(caught.value, RepmError) and words in message and "\n" not in message, (label, message)
        assert not list(out.iterdir()), label


@pytest.mark.long
def test_cancel_leaves_what_the_next_run_takes(four, tmp_path, told):
    counting = told()
    path = Path(mosaic(told, tmp_path, four, counting, parameters=SMALL).output)
    whole, before = path.read_bytes(), set(tmp_path.iterdir())
    kept = tmp_path / "mosaic_blocks"
    for share in (0.01, 0.3, 0.6, 0.97):
        with pytest.raises(Cancelled):
            mosaic(told, tmp_path, four, told(cancel_at=max(1, int(share * counting.checks))), parameters=SMALL)
        assert set(tmp_path.iterdir()) <= before | {kept} and not list(kept.rglob("*.part*"))
        assert path.read_bytes() == whole  # the old one, until a new one is there
    said = told()
    mosaic(told, tmp_path, four, said, parameters=SMALL)
    assert any(text.startswith("Reused 16 of 16 blocks that an earlier run") for text in said.notes), said.notes
    assert path.read_bytes() == whole and set(tmp_path.iterdir()) == before


@pytest.mark.long
def test_a_killed_run_is_continued_and_damaged_blocks_are_made_again(four, tmp_path, told):
    options = {"dsms": four, "output": str(tmp_path / "m.tif"), "workers": 1}
    code = (
        "import json, os, sys, repm_qgis.mosaic.products as p; from repm_qgis.runtime.progress import Silent; "
        "from repm_qgis.stages import run_stage; p._write_files = lambda *_: os._exit(9); "
        "run_stage('mosaic', json.loads(sys.argv[1]), Silent())"
    )
    command = [sys.executable, "-c", code, json.dumps(options)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 9, done.stdout + done.stderr
    blocks = sorted((tmp_path / "m_blocks").rglob("*.npz"))
    assert len(blocks) == 1 and not (tmp_path / "m.tif").exists()
    for damage, reused in (((lambda data: data), True), ((lambda data: data[: len(data) // 2]), False)):
        said = told()
        shutil.copytree(tmp_path / "m_blocks", tmp_path / "copy_blocks", dirs_exist_ok=True)
        copied = tmp_path / "copy_blocks" / blocks[0].relative_to(tmp_path / "m_blocks")
        copied.write_bytes(damage(blocks[0].read_bytes()))
        result = mosaic(told, tmp_path, four, said, output=str(tmp_path / "copy.tif"))
        assert any("Reused 1 of 1 block " in text for text in said.notes) == reused
        fresh = mosaic(told, tmp_path, four, output=str(tmp_path / "fresh.tif"))
        assert Path(result.output).read_bytes() == Path(fresh.output).read_bytes()
        assert not (tmp_path / "copy_blocks").exists()


def test_numbers_of_dsms_are_not_averaged_in_overviews(tmp_path):
    numbers = np.where(np.indices((900, 900))[1] < 451, 1, 4).astype(np.float32)
    for overviews, found in (("NEAREST", {1, 4}), ("AVERAGE", {1, 2.5, 4})):
        path = raster.write(str(tmp_path / f"{overviews}.tif"), [numbers], None, "", cog=True, overviews=overviews)
        with raster.opened(path) as dataset:
            assert set(np.unique(dataset.GetRasterBand(1).GetOverview(0).ReadAsArray()).tolist()) == found


# A VRT and its tiles ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def both(four, tmp_path_factory, told):
    """The folders of one mosaic as GeoTIFFs, and as VRTs with tiles of 192 cells; and what the latter result in."""
    folders = [tmp_path_factory.mktemp(name) for name in ("tif", "vrt")]
    for folder, kind in zip(folders, ("tif", "vrt")):
        out = {name: str(folder / f"{name}.{kind}") for name in ("output", "sources")}
        result = mosaic(told, folder, four, parameters=SMALL, **out)
    return (*folders, result)


@pytest.mark.long
def test_a_vrt_shows_what_the_geotiff_has_also_where_both_were_moved(both, tmp_path):
    tif, vrt, result = both
    assert {path.name for path in vrt.iterdir()} == {
        f"{name}{kind}" for name in ("output", "sources") for kind in (".vrt", ".qml", "_tiles")
    }
    assert result.output == str(vrt / "output.vrt")
    shutil.move(shutil.copytree(vrt, tmp_path / "copied"), tmp_path / "moved")
    for name, bands in (("output", 1), ("sources", 3)):
        with (
            raster.opened(str(tif / f"{name}.tif")) as one,
            raster.opened(str(tmp_path / f"moved/{name}.vrt")) as other,
        ):
            assert not any(str(vrt) in file or "copied" in file for file in other.GetFileList())
            for band in range(1, bands + 1):
                assert np.array_equal(raster.read(one, band=band), raster.read(other, band=band), equal_nan=True)
                here, there = one.GetRasterBand(band), other.GetRasterBand(band)
                assert here.GetDescription() == there.GetDescription() and here.GetUnitType() == there.GetUnitType()
                assert here.GetNoDataValue() == there.GetNoDataValue()
            assert one.GetMetadata() == {**one.GetMetadata(), **other.GetMetadata()}
            assert one.GetGeoTransform() == other.GetGeoTransform() and one.GetSpatialRef().IsSame(
                other.GetSpatialRef()
            )
    tiles = sorted((vrt / "output_tiles").iterdir())
    assert len(tiles) == 5
    with raster.opened(str(tiles[0])) as tile:
        assert (tile.RasterXSize, tile.RasterYSize) == (192, 192) and tile.GetMetadataItem(TAG) == ELLIPSOID
        assert tile.GetMetadata("IMAGE_STRUCTURE")["LAYOUT"] == "COG"


@pytest.mark.long
def test_the_overview_of_a_vrt_is_the_mean_and_numbers_are_not_averaged(both):
    tif, vrt, _ = both
    with raster.opened(str(vrt / "output.vrt")) as dataset:
        band = dataset.GetRasterBand(1)
        assert band.GetOverviewCount() == 1
        small = raster.read(dataset, size=(19, 19))
    heights = np.full((304, 304), np.nan)
    heights[:300, :300] = read(str(tif / "output.tif"))
    means = np.nanmean(heights.reshape(19, 16, 19, 16).swapaxes(1, 2).reshape(19, 19, -1), axis=2)
    assert small == pytest.approx(means, abs=1e-3, nan_ok=True)
    with raster.opened(str(vrt / "sources.vrt")) as dataset:
        assert set(np.unique(dataset.GetRasterBand(1).GetOverview(0).ReadAsArray())) <= {-9999, 1, 2, 3, 4}


@pytest.mark.slow
def test_an_old_vrt_and_its_tiles_stay_until_the_new_ones_are_whole(four, tmp_path, told, monkeypatch):
    out = {"output": str(tmp_path / "m.vrt"), "sources": str(tmp_path / "s.vrt"), "parameters": SMALL}
    mosaic(told, tmp_path, four, **out)

    def state():
        return {
            path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file() and "_blocks" not in str(path)
        }

    before = state()
    mosaic(told, tmp_path, four, **out)
    assert state() == before
    counting = told()
    away = {**out, "output": str(tmp_path / "away" / "m.vrt"), "sources": str(tmp_path / "away" / "s.vrt")}
    mosaic(told, tmp_path, four[:3], counting, **away)
    shutil.rmtree(tmp_path / "away")
    for share in (0.75, 0.95):  # tiles of the one, then of the other
        with pytest.raises(Cancelled):
            mosaic(told, tmp_path, four[:3], told(cancel_at=int(share * counting.checks)), **out)
        assert state() == before

    def full(*_):
        raise WorkspaceError("The disk is full.")

    with monkeypatch.context() as changed:
        changed.setattr("repm_qgis.mosaic.products.vrt_text", full)
        with pytest.raises(WorkspaceError):
            mosaic(told, tmp_path, four[:3], **out)
    assert state() == before and not (tmp_path / "m_blocks").exists()
    with monkeypatch.context() as changed:  # the moment between the two names: the old VRT still has all its tiles
        replaced = os.replace

        def killed(source, target):
            if str(target).endswith(".vrt"):
                raise KeyboardInterrupt
            replaced(source, target)

        changed.setattr(os, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            mosaic(told, tmp_path, four[:3], **out)
        assert before.items() <= state().items()
    mosaic(told, tmp_path, four[:3], **out)
    tiles = set((tmp_path / "m_tiles").iterdir())
    assert len(tiles) == 4 and not set(before) & tiles  # three tiles with a height, and the overview


def test_a_folder_with_other_files_is_not_replaced(four, tmp_path, told):
    (tmp_path / "m_tiles").mkdir()
    (tmp_path / "m_tiles" / "thesis.doc").write_text("years of work")
    words = "m_tiles' for the tiles of .* holds 'thesis.doc', which is no tile of a mosaic"
    with pytest.raises(WorkspaceError, match=words):
        mosaic(told, tmp_path, four, output=str(tmp_path / "m.vrt"))
    inside = str(tmp_path / "n_tiles" / "dsm.tif")
    (tmp_path / "n_tiles").mkdir()
    shutil.copy(four[0], inside)
    with pytest.raises(OptionError, match="is also a file of the input DSMS"):
        mosaic(told, tmp_path, [inside, four[1]], output=str(tmp_path / "n.vrt"))
    assert os.path.exists(inside) and len(list((tmp_path / "m_tiles").iterdir())) == 1


def test_no_dsm_is_moved_by_what_no_datum_explains(tmp_path, told):
    """A DSM times 3.28 was moved by 2652 m, and the good one with it; the report said "Good."."""
    good = write(tmp_path / "good.tif", (0, 0), 100)
    scaled = write(tmp_path / "scaled.tif", (50, 0), 100, lambda x, y: 3.28 * ground(x, y))
    output = str(tmp_path / "mosaic.tif")
    with pytest.raises(ImageError, match="differ by 4[0-9][0-9] m .* no vertical datum explains .*: check the unit"):
        run_stage("mosaic", {"dsms": [good, scaled], "output": output}, told())
    assert not os.path.exists(output)


@pytest.mark.parametrize(("up", "warned"), ((4.0, False), (48.0, True)))
def test_large_offsets_are_named(tmp_path, told, up, warned):
    good = write(tmp_path / "good.tif", (0, 0), 100)
    high = write(tmp_path / "high.tif", (50, 0), 100, lambda x, y: ground(x, y) + up)
    said = told()
    run_stage("mosaic", {"dsms": [good, high], "output": str(tmp_path / "mosaic.tif")}, said)
    named = [text for text in said.warnings if "DSMs are moved by more than 10 m" in text]
    assert bool(named) == warned and (not warned or "good.tif' (+24.0 m)" in named[0])


@pytest.mark.parametrize(
    ("stated", "up", "expected"),
    (
        (("0.5", "0.5"), 4.0, "3.7"),
        (("0.5", "0.5"), 3.4, None),
        (("2.0", "0.5"), 7.2, "6.9"),
        (("2.0", "0.5"), 6.6, None),
        (("0.5", None), 8.0, None),
        (("0.5", "nan"), 8.0, None),
        (("0.5", "-3"), 8.0, None),
        (("0.5", "much"), 8.0, None),
    ),
)
def test_what_stated_uncertainties_do_not_explain_is_named(tmp_path, told, stated, up, expected):
    paths = [
        write(
            tmp_path / f"{name}.tif",
            (start, 0),
            100,
            lambda x, y, by=by: ground(x, y) + by,
            tags={TAG: ELLIPSOID, **({} if deviation is None else {DEVIATION_TAG: deviation})},
        )
        for name, start, by, deviation in zip("ab", (0, 50), (0.0, up), stated)
    ]
    said, report = told(), tmp_path / "r.html"
    run_stage("mosaic", {"dsms": paths, "output": str(tmp_path / "m.tif"), "report": str(report)}, said)
    named = [text for text in said.warnings if "differ by more than their stated uncertainties explain" in text]
    assert bool(named) == (expected is not None)
    if expected:
        assert f"b.tif' by {up:.1f} m (expected: at most {expected} m)" in named[0]
        assert "Good." not in report.read_text(encoding="utf-8").split("<h2")[0]


def test_what_is_known_worse_is_moved_more(tmp_path, told):
    """Both were moved by half of the difference, however well one of them is known."""
    good, poor = (
        write(
            tmp_path / f"{name}.tif",
            (start, 0),
            100,
            lambda x, y, by=by: ground(x, y) + by,
            tags={TAG: ELLIPSOID, DEVIATION_TAG: deviation},
        )
        for name, start, by, deviation in (("good", 0, 0.0, "0.2"), ("poor", 50, 5.0, "2.0"))
    )
    said = told()
    result = run_stage("mosaic", {"dsms": [good, poor], "output": str(tmp_path / "m.tif")}, said)
    added = [each.added for each in result.offsets]
    assert added == pytest.approx([5.0 / 101, -500.0 / 101], abs=0.01)
    assert not said.warnings and any("each weighted by its stated uncertainty" in text for text in said.notes)


def town(x, y):
    """Flat ground with houses of any size and height, nowhere the same."""
    rng, heights = np.random.default_rng(5), np.full(np.shape(x), 120.0)
    for u, v, wide, deep, high in zip(*rng.uniform((0, 0, 8, 8, 4), (500, 500, 25, 25, 15), (300, 5)).T):
        heights[(abs(x - WEST - u) < wide / 2) & (abs(NORTH - y - v) < deep / 2)] += high
    return heights


@pytest.mark.parametrize(
    ("surface", "east", "beside"),
    ((town, 20.0, 20.0), (town, 3.0, 3.0), (town, 0.4, None), (lambda x, y: 0.02 * (x - WEST), 20.0, None)),
    ids=("20 m", "3 m", "0.4 m", "a plane"),
)
@pytest.mark.long
def test_dsms_that_lie_beside_each_other_are_named(tmp_path, told, surface, east, beside):
    """Heights of a flat town differ little where they are not of the same place: no offset shows it, nor a spread."""
    paths = [
        write(
            tmp_path / "a.tif",
            (0, 0),
            400,
            lambda x, y: surface(x, y) + 0.1 * np.random.default_rng(1).normal(size=x.shape),
        ),
        write(tmp_path / "b.tif", (100, 0), 400, lambda x, y: surface(x - east, y) + 0.3),
    ]
    said, report = told(), tmp_path / "r.html"
    run_stage("mosaic", {"dsms": paths, "output": str(tmp_path / "m.tif"), "report": str(report)}, said)
    named = [text for text in said.warnings if "DSMs are displaced horizontally" in text]
    assert bool(named) == (beside is not None)
    if beside is not None:
        (by,) = re.findall(r"b\.tif' by ([\d.]+) m; a mosaic only moves heights, so register them", named[0])
        assert abs(float(by) - beside) < 0.3 and "Good." not in report.read_text(encoding="utf-8").split("<h2")[0]
