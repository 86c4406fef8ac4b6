"""The terrain below a simulated town on hills, from files to files."""

from __future__ import annotations

import os
import re
from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.errors import Cancelled, EmptyResultError, ImageError, OptionError
from repm_qgis.geometry.vertical import ELLIPSOID, TAG
from repm_qgis.imagery import raster
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE
from tests.engine.pages import plain

UTM31 = "EPSG:32631"
CELL = 0.5
SHAPE = (420, 500)


def hills(steep):
    rows, columns = np.indices(SHAPE) * CELL
    return 200 + steep / 2 / np.pi * 120 * (np.sin(rows / 120 * 2 * np.pi) + np.cos(columns / 120 * 2 * np.pi))


def town(ground):
    """Houses of 12 x 15 m and 6 m, a hall of 50 x 40 m and 9 m, and where they stand."""
    objects = np.zeros(SHAPE)
    for row in range(20, SHAPE[0] - 40, 70):
        for col in range(20, 300, 70):
            objects[row : row + 24, col : col + 30] = 6.0
    objects[150:250, 340:420] = 9.0
    return ground + objects, objects > 0


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    rng = np.random.default_rng(5)
    ground = hills(0.1)
    surface, objects = town(ground)
    surface = surface + rng.normal(0, 0.1, SHAPE)
    surface[60:64, 100:104] -= 30.0  # a wrong match far below the ground
    surface[:, -40:] = np.nan  # outside the DSM
    surface[300:330, 60:90] = np.nan  # a void
    return ground, surface.astype(np.float32), objects


def write(path, bands, crs=UTM31, cell=CELL, **facts):
    place = (500000.0, cell, 0.0, 4800000.0, 0.0, -cell)
    facts = {"metadata": {TAG: ELLIPSOID}, "unit": "m", **facts}
    return raster.write(str(path), [np.asarray(band, np.float32) for band in bands], place, crs, **facts)


def read(path, band=1):
    with raster.opened(str(path)) as dataset:
        return raster.read(dataset, band=band)


def made(folder, parameters=ENGINE, progress=Silent(), **options):
    names = {name: str(folder / f"{name}.tif") for name in ("output", "heights", "mask")}
    return run_stage("dtm", {**names, "report": str(folder / "report.html"), **options}, progress, parameters)


def test_the_ground_the_heights_and_the_mask(scene, tmp_path):
    ground, surface, objects = scene
    result = made(tmp_path, dsm=write(tmp_path / "dsm.tif", [surface]))
    terrain, above, mask = (read(tmp_path / f"{name}.tif") for name in ("output", "heights", "mask"))
    open_ground = ~objects & np.isfinite(surface) & (surface > ground - 5)
    error = terrain - ground
    assert np.sqrt(np.mean(error[open_ground] ** 2)) < 0.15
    assert np.sqrt(np.mean(error[objects] ** 2)) < 1.0  # below the hall, on a hill, nothing is known
    assert (mask[objects] == 1).mean() > 0.98 and (mask[open_ground] == 1).mean() < 0.02
    house = objects & (np.arange(SHAPE[1]) < 300)
    assert np.median(above[house]) == pytest.approx(6.0, abs=0.2)
    assert np.isnan(terrain[:, -40:]).all()  # outside the DSM there is no terrain,
    assert np.sqrt(np.mean(error[300:330, 60:90] ** 2)) < 1.0  # within a void there is
    assert np.isnan(above[300:330, 60:90]).all()
    with raster.opened(str(tmp_path / "mask.tif")) as dataset:
        assert dataset.ReadAsArray()[310, 70] == 255
    assert np.isfinite(terrain[60:64, 100:104]).all() and abs(error[60:64, 100:104]).max() < 0.5
    assert result.objects_percent == pytest.approx(100 * objects[np.isfinite(surface)].mean(), abs=2)
    with raster.opened(str(tmp_path / "output.tif")) as dataset:
        assert dataset.GetMetadataItem(TAG) == ELLIPSOID and result.vertical_datum == ELLIPSOID
    assert all((tmp_path / f"{name}.qml").exists() for name in ("output", "heights", "mask"))
    assert not [name for name in os.listdir(tmp_path) if ".part" in name]


def test_voids_that_are_to_stay(scene, tmp_path):
    made(tmp_path, dsm=write(tmp_path / "dsm.tif", [scene[1]]), voids="none")
    assert (np.isnan(read(tmp_path / "output.tif")) == np.isnan(scene[1])).all()


@pytest.mark.slow
def test_neither_workers_nor_blocks_change_a_byte(scene, tmp_path):
    dsm = write(tmp_path / "dsm.tif", [scene[1]])
    found = []
    for number, (block, workers) in enumerate(((2048, 1), (64, 1), (128, 2))):
        folder = tmp_path / str(number)
        folder.mkdir()
        parameters = replace(ENGINE, terrain=replace(ENGINE.terrain, block_cells=block))
        made(folder, parameters, dsm=dsm, largest=60, workers=workers)
        found.append([(folder / f"{name}.tif").read_bytes() for name in ("output", "heights", "mask")])
    assert found[0] == found[1] == found[2]


def test_steep_hills_keep_their_tops(tmp_path):
    """Without houses the terrain is the DSM, up to the steepest ground that is said."""
    ground = hills(0.55)
    made(tmp_path, dsm=write(tmp_path / "dsm.tif", [ground]), slope=60)
    error = read(tmp_path / "output.tif") - ground
    assert np.sqrt(np.mean(error**2)) < 0.1 and (read(tmp_path / "mask.tif") == 1).mean() < 0.001


def ramp():
    """A slope of 100 % with three houses."""
    rows, columns = np.indices(SHAPE) * CELL
    surface = 200 + columns + 0 * rows
    for row, col in ((60, 60), (200, 240), (300, 380)):
        surface[row : row + 24, col : col + 30] = surface[row + 12, col + 15] + 8.0
    return surface


def benches():
    """Two sides of a quarry: benches of 15 m with walls of 12 m, which no SLOPE is a wall to."""
    _, columns = np.indices(SHAPE) * CELL
    inside = 100 - np.abs(columns - 125)
    return 300 - 12 * np.floor(np.maximum(inside, 0) / 15)


@pytest.mark.parametrize("surface", (ramp, benches))
def test_ground_that_is_steeper_than_slope_is_named(tmp_path, told, surface):
    """The ramp ended 184 m too low under a good verdict."""
    said = told()
    made(tmp_path, progress=said, dsm=write(tmp_path / "dsm.tif", [surface()]))
    (finding,) = (each for each in said.warnings if each.id == "terrain-cut")
    assert "steeper than SLOPE (40 %)" in finding and "a smaller LARGEST" in finding
    page = plain((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "lie on ground steeper than SLOPE (40 %)" in page and "Good." not in page
    if surface is ramp:
        better = float(re.search(r"Choose SLOPE=(\d+) ", finding)[1])
        again = told()
        made(tmp_path, progress=again, dsm=str(tmp_path / "dsm.tif"), slope=better)
        assert not again.warnings and abs(read(tmp_path / "heights.tif")).max() < 20


def test_no_house_is_steep_ground(scene, tmp_path, told):
    """Nor a hill that is as steep as SLOPE allows, whatever the cells' size."""
    dense = np.tile(np.array([[0, 12], [5, 0]]).repeat(24, 0).repeat(24, 1), (9, 11))[: SHAPE[0], : SHAPE[1]]
    for name, surface, cell in (
        ("town", scene[1], CELL),
        ("dense", hills(0.1) + dense, CELL),
        ("hills", hills(0.35), 5.0),
    ):
        said = told()
        made(tmp_path, progress=said, dsm=write(tmp_path / f"{name}.tif", [surface], cell=cell))
        assert not said.warnings, name


def test_a_hill_goes_on_below_a_house(tmp_path):
    """On a top and in a hollow the ground curves below the house as it does beside it."""
    ground = hills(0.35)
    surface, places = ground.copy(), {"top": (60, 240), "hollow": (180, 120)}
    for row, col in places.values():
        surface[row - 20 : row + 20, col - 20 : col + 20] = ground[row, col] + 8.0
    made(tmp_path, dsm=write(tmp_path / "dsm.tif", [surface]))
    error = read(tmp_path / "output.tif") - ground
    for row, col in places.values():
        assert abs(error[row - 20 : row + 20, col - 20 : col + 20].mean()) < 0.7  # 0.9 and more of a flat film


def test_a_slope_goes_on_below_a_house_at_the_border(tmp_path):
    rows, columns = np.indices(SHAPE) * CELL
    ground = 200 + 0.2 * rows - 0.1 * columns
    surface = ground.copy()
    for house in ((slice(0, 30), slice(200, 240)), (slice(200, 240), slice(-30, None))):
        surface[house] += 8.0
    made(tmp_path, dsm=write(tmp_path / "dsm.tif", [surface]))
    assert abs(read(tmp_path / "output.tif") - ground).max() < 0.3


@pytest.mark.long
def test_heights_that_were_interpolated_and_wide_errors_say_little(scene, tmp_path):
    """A mound of interpolated heights, and one of uncertain ones, are passed over."""
    rows, columns = np.indices(SHAPE)
    ground = 200 + 0.02 * rows - 0.01 * columns
    mounds = [0.45 * np.exp(-((rows - 200) ** 2 + (columns - col) ** 2) / 30.0**2) for col in (150, 350)]
    error, source = np.full(SHAPE, 0.2), np.zeros(SHAPE)
    source[mounds[0] > 0.05] = 2
    error[mounds[1] > 0.05] = 3.0
    bands = ["height maps that agree", "spread between them (m)", "mean matching score"]
    bands += ["source: 0 matched, 1 background of an occlusion, 2 interpolated, 3 interpolated on the DEM, ..."]
    bands += ["expected error (m): two of three errors are smaller"]
    confidence = write(tmp_path / "c.tif", [*[np.ones(SHAPE)] * 3, source, error], descriptions=bands)
    dsm = write(tmp_path / "dsm.tif", [ground + sum(mounds)])
    made(tmp_path, dsm=dsm, confidence=confidence)
    weighted = (read(tmp_path / "output.tif") - ground)[200, [150, 350]]
    made(tmp_path, dsm=dsm)
    plain = (read(tmp_path / "output.tif") - ground)[200, [150, 350]]
    assert (plain > 0.4).all() and abs(weighted[0]) < 0.1 and weighted[1] < 0.25


def test_what_cannot_be_used_is_shortage_as_error(scene, tmp_path):
    dsm = write(tmp_path / "dsm.tif", [scene[1]])
    degrees = write(tmp_path / "degrees.tif", [scene[1]], crs="EPSG:4326", cell=1e-5)
    other = write(tmp_path / "other.tif", [scene[1][:100]])
    empty = write(tmp_path / "empty.tif", [np.full(SHAPE, np.nan)])
    for error, text, options in (
        (ImageError, "does not exist", {"dsm": str(tmp_path / "none.tif")}),
        (ImageError, "reproject it first, such as to EPSG:32", {"dsm": degrees}),
        (ImageError, "does not have the cells of the DSM", {"dsm": dsm, "confidence": other}),
        (EmptyResultError, "with a smaller LARGEST", {"dsm": empty}),
        (OptionError, "or SCENE, and not both", {"dsm": dsm, "scene": "s.json"}),
        (OptionError, "or SCENE, and not both", {}),
        (OptionError, "must be empty where SCENE is given", {"scene": "s.json", "confidence": other}),
    ):
        with pytest.raises(error, match=text):
            made(tmp_path, **options)
    assert not (tmp_path / "output.tif").exists()


def test_a_run_that_is_cancelled_leaves_nothing(scene, tmp_path):
    class Impatient(Silent):
        def step(self, fraction, text=""):
            if fraction > 0.7:
                raise Cancelled

    dsm = write(tmp_path / "dsm.tif", [scene[1]])
    with pytest.raises(Cancelled):
        made(tmp_path, progress=Impatient(), dsm=dsm, largest=40, workers=1)
    assert sorted(os.listdir(tmp_path)) == ["dsm.tif"]
