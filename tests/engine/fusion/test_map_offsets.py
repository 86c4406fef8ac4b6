"""Height maps of different pairs are moved onto each other; what they have in common stays."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.fusion.map_offsets import Differences, Lattice, Parts, solve_parallax, with_agreeing_maps
from repm_qgis.fusion.parameters import FUSION
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.matching.backends import height_source
from repm_qgis.scene import Scene
from repm_qgis.stereo.height_maps import write_height_map

BOUNDS = Bounds(1000.0, 5000.0, 1300.0, 5200.0)
LATTICE = Lattice.over(BOUNDS, 60.0, 16)
KEYS = [("sgm", "a", "b"), ("sgm", "a", "c"), ("sgm", "b", "c")]
METRES = [0.6, 0.5, 2.4]


def _places():
    x, y = np.meshgrid(np.arange(1010.0, 1300.0, 20.0), np.arange(5010.0, 5200.0, 20.0))
    return x.ravel(), y.ravel()


def _differences(errors, noise=0.0, chosen=((1, 0), (2, 0), (2, 1))):
    """Medians of maps with errors (px, functions of x and y) that are known."""
    (x, y), numbers = _places(), np.random.default_rng(3)
    for i, j in chosen:
        metres = METRES[i], METRES[j]
        median = metres[0] * errors[i](x, y) - metres[1] * errors[j](x, y)
        median += noise * np.hypot(*metres) * numbers.normal(size=len(x))
        yield Differences(KEYS[i], KEYS[j], metres, x, y, median, np.full(len(x), 1500.0))


def _left(found, errors):
    """Differences of two maps that the solution leaves, px, for each two maps."""
    x, y = _places()
    weights = LATTICE.weights(x, y)
    wrong = [m * (e(x, y) - weights @ found[key]) for m, e, key in zip(METRES, errors, KEYS)]
    return [(wrong[i] - wrong[j]) / np.hypot(METRES[i], METRES[j]) for i, j in ((1, 0), (2, 0), (2, 1))]


def test_constant_and_smooth_errors_are_found():
    errors = [
        lambda x, y: 0.1 + 0.0 * x,
        lambda x, y: -0.05 + 0.0005 * (x - 1150.0),
        lambda x, y: 0.08 * np.sin((y - 5000.0) / 60.0),
    ]
    found = solve_parallax(list(_differences(errors, 0.02)), LATTICE)
    assert max(np.abs(part).max() for part in _left(found, errors)) < 0.03
    before = [(METRES[i] * errors[i](*_places()) - METRES[j] * errors[j](*_places())) for i, j in ((1, 0), (2, 0))]
    assert max(np.abs(part).max() for part in before) > 0.1


def test_what_all_maps_have_in_common_stays():
    """One height for all: nobody can see it. The best geometry has most weight in what stays."""
    errors = [lambda x, y, m=m: 0.3 / m + 0.0 * x for m in METRES]
    found = solve_parallax(list(_differences(errors)), LATTICE)
    assert max(np.abs(each).max() for each in found.values()) < 1e-6
    errors = [lambda x, y: 0.0 * x, lambda x, y: 0.0 * x, lambda x, y: 0.1 + 0.0 * x]
    found = solve_parallax(list(_differences(errors)), LATTICE)
    moved = [float((m * found[key]).mean()) for m, key in zip(METRES, KEYS)]
    assert moved[2] > 0.2 and max(map(abs, moved[:2])) < 0.04


def test_a_part_that_contradicts_all_others_has_little_weight():
    errors = [lambda x, y: 0.0 * x] * 3
    differences = list(_differences(errors, 0.01))
    differences[0].median[40] += 0.4
    found = solve_parallax(differences, LATTICE)
    assert max(np.abs(part).max() for part in _left(found, errors)) < 0.05


def test_maps_without_common_ground_stay_where_they_are():
    errors = [lambda x, y: 0.1 + 0.0 * x] * 3
    found = solve_parallax(list(_differences(errors, chosen=((1, 0),))), LATTICE)
    assert sorted(found) == KEYS[:2]
    empty = [each._replace(x=each.x[:0], y=each.y[:0], median=each.median[:0]) for each in _differences(errors)]
    assert solve_parallax(empty, LATTICE) == {} and solve_parallax([], LATTICE) == {}


def test_the_lattice_is_bilinear_and_bounded():
    weights = LATTICE.weights(*_places())
    assert weights.shape == (len(_places()[0]), LATTICE.shape[0] * LATTICE.shape[1])
    assert np.asarray(weights.sum(axis=1)).ravel() == pytest.approx(1.0)
    x = np.tile(np.linspace(BOUNDS.xmin, BOUNDS.xmax, LATTICE.shape[1]), LATTICE.shape[0])
    y = np.repeat(np.linspace(BOUNDS.ymax, BOUNDS.ymin, LATTICE.shape[0]), LATTICE.shape[1])
    assert weights @ (3.0 * x - y) == pytest.approx(3.0 * _places()[0] - _places()[1])
    assert Lattice.over(BOUNDS, 1.0, 16).shape == (17, 17) and Lattice.over(BOUNDS, 1e6, 16).shape == (2, 2)


def test_medians_are_of_one_surface():
    """Roofs that one map alone has, and holes, say nothing about the ground's difference."""
    numbers = np.random.default_rng(5)
    difference = 0.2 + 0.1 * numbers.normal(size=(90, 70))
    difference[:, :20] += 9.0
    difference[60:, 40:] = np.nan
    parts = Parts(CellGrid(1000.0, 5000.0, 1.0, difference.shape), 40)
    x, y, median, cells = parts.medians(difference, 1.0, FUSION.offsets)
    assert median == pytest.approx(0.2, abs=0.02)
    assert dict(zip(zip(x, y), cells)) == {
        (1020.0, 4980.0): 800,
        (1060.0, 4980.0): 1200,
        (1020.0, 4940.0): 800,
        (1060.0, 4940.0): 600,
        (1020.0, 4910.0): 200,
    }
    assert not len(parts.medians(difference + 50.0, 1.0, FUSION.offsets)[0])


def _moved(scene, folder, pair, metres):
    """The scene with all height maps of a pair so many metres higher than they were matched."""

    def changed(record):
        if record.pair != pair:
            return replace(record, offsets=())
        dataset = gdal.Open(record.file)
        height, score, filled = (dataset.GetRasterBand(band).ReadAsArray() for band in (1, 2, 3))
        return write_height_map(
            os.path.join(folder, f"{record.tile}.tif"), "key", record, height + metres, score, filled > 0
        )

    return scene.with_tiles(lambda tile: replace(tile, heights=tuple(map(changed, tile.heights))))


def test_a_pair_that_is_too_high_is_brought_down(urban_run, tmp_path, told):
    scene, said = Scene.load(urban_run.result.scene), told()
    pair = scene.tiles[0].heights[0].pair
    metres = 0.5 * scene.tiles[0].heights[0].metres_per_px
    found = [
        {record.file: np.array(record.offsets) for tile in each.tiles for record in tile.heights}
        for each in (
            with_agreeing_maps(each, 1, 0, said) for each in (scene, _moved(scene, str(tmp_path), pair, metres))
        )
    ]
    assert "The height maps have been moved by up to" in said.notes[-1]
    there = {
        str(tmp_path / f"{tile.id}.tif"): record.file
        for tile in scene.tiles
        for record in tile.heights
        if record.pair == pair
    }
    moved = {there.get(file, file): rows for file, rows in found[1].items()}
    change = {file: float((rows - found[0][file]).mean()) for file, rows in moved.items()}
    down = [value for file, value in change.items() if file in there.values()]
    up = [value for file, value in change.items() if file not in there.values()]
    assert min(np.ptp(down), np.ptp(up)) < 0.1 * metres
    assert min(up) - max(down) == pytest.approx(metres, rel=0.1)


def test_offsets_move_points_along_their_lines_of_sight(urban_run):
    scene = Scene.load(urban_run.result.scene)
    tile = scene.tiles[0]
    record = replace(tile.heights[0], offsets=((1.0, 2.0, 3.0), (3.0, 4.0, 5.0)))
    plain, moved = (
        height_source(scene, tile.bounds, each, scene.crs).read() for each in (replace(record, offsets=()), record)
    )
    up = moved.height - plain.height
    rows, columns = up.shape
    wanted = 1.0 + 2.0 * np.arange(columns) / (columns - 1) + 2.0 * np.arange(rows)[:, None] / (rows - 1)
    known = np.isfinite(up)
    assert known.mean() > 0.3 and up[known] == pytest.approx(wanted[known], abs=1e-6)
    along = np.stack([(moved.x - plain.x)[known], (moved.y - plain.y)[known]]) / up[known]
    assert along == pytest.approx(np.tile(np.array(plain.ray)[:, None], along.shape[1]), abs=2e-3)


def test_records_refuse_offsets_that_are_no_lattice(urban_run):
    record = Scene.load(urban_run.result.scene).tiles[0].heights[0]
    for offsets in ([[1.0, 2.0]], [[1.0], [2.0]], [[1.0, 2.0], [3.0]], [[1.0, 2.0], [3.0, "4"]]):
        with pytest.raises(ValueError, match="offsets"):
            record.from_mapping({**record.to_mapping(), "offsets": offsets})


def test_of_many_maps_each_is_compared_with_those_of_the_best_geometry(urban_run, told):
    """With one such map, its offset and that of each other still agree with what all comparisons give."""
    scene = Scene.load(urban_run.result.scene)
    few = replace(FUSION, offsets=replace(FUSION.offsets, compared=1))
    found = [with_agreeing_maps(scene, 1, 0, told(), fusion) for fusion in (FUSION, few)]
    for whole, part in zip(*(each.tiles for each in found)):
        for one, other in zip(whole.heights, part.heights):
            assert other.offsets != () and np.array(other.offsets) == pytest.approx(np.array(one.offsets), abs=0.05)
    assert found[0].tiles != found[1].tiles
