"""A class raster of another place is named or refused, and one at its place is not."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.errors import OverlapError
from repm_qgis.imagery.raster import write
from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.stages import run_stage

CRS = "EPSG:32633"
SIZE = 300  # cells of 1 m


def town():
    """Heights of a town on a slope, and classes: 2 ground, 6 buildings, wider than the heights by 100 cells."""
    rng = np.random.default_rng(7)
    wide = SIZE + 200
    classes = np.full((wide, wide), 2.0)
    heights = 300 + 0.08 * np.indices((wide, wide))[1]
    for row in range(20, wide - 40, 45):
        for column in range(20, wide - 40, 45):
            row_, column_ = row + rng.integers(-8, 8), column + rng.integers(-8, 8)
            depth, width = rng.integers(10, 22, 2)
            place = slice(row_, row_ + depth), slice(column_, column_ + width)
            classes[place], heights[place] = 6.0, heights[place] + rng.uniform(4, 12)
    return heights[100:-100, 100:-100], classes


def found(tmp_path, classes, east=0.0, cell=1.0):
    heights, _ = town()
    noise = np.random.default_rng(1).normal(0, 0.2, heights.shape)
    place = (5e5, 1, 0, 5e6, 0, -1)
    paths = [
        write(str(tmp_path / f"{name}.tif"), [values.astype(np.float32)], place, CRS)
        for name, values in (("dsm", heights + noise), ("reference", heights))
    ]
    margin = 0.5 * (classes.shape[0] * cell - SIZE)
    corner = (5e5 - margin + east, cell, 0, 5e6 + margin, 0, -cell)
    named = write(str(tmp_path / "classes.tif"), [classes.astype(np.float32)], corner, CRS)
    run = Recorder(Silent())
    run_stage("comparedsm", {"dsm": paths[0], "reference": paths[1], "classes": named}, run)
    return run.findings


def test_classes_at_their_place_are_good(tmp_path):
    assert not found(tmp_path, town()[1])


def test_classes_that_say_nothing_of_heights_are_good(tmp_path):
    assert not found(tmp_path, np.indices((500, 500))[0] // 60 % 5)


def test_classes_with_larger_cells_are_good(tmp_path):
    assert not found(tmp_path, town()[1][2::5, 2::5], cell=5.0)


def test_classes_without_data_between_are_good(tmp_path):
    classes = town()[1]
    assert not found(tmp_path, np.where(classes == 6, classes, np.nan))


@pytest.mark.parametrize(("east", "cell", "mask"), ((20, 1, False), (-20, 1, True), (20, 5, False)))
def test_classes_beside_their_place_are_named(tmp_path, east, cell, mask):
    classes = town()[1][cell // 2 :: cell, cell // 2 :: cell]
    classes = np.where(classes == 6, classes, np.nan) if mask else classes
    (finding,) = found(tmp_path, classes, east=east, cell=cell)
    assert finding.id == "classes-displaced" and finding.level == "doubt"
    assert float(finding.split(" better ")[1].split(" m ")[0]) == pytest.approx(20.0, abs=cell)


def test_classes_of_a_part_are_named(tmp_path):
    (finding,) = found(tmp_path, town()[1][100:195, 100:195])
    assert finding.id == "classes-partial" and "10.0 %" in finding


def test_classes_of_another_place_are_refused(tmp_path):
    with pytest.raises(OverlapError, match="classes.tif' has no class at any height of .*reference.tif': choose"):
        found(tmp_path, town()[1], east=900.0)


@pytest.mark.parametrize(
    "other",
    (lambda of: of[::-1], lambda of: of[::-1, ::-1], lambda of: np.roll(of, (250, 130), (0, 1))),
    ids=("upside down", "turned", "another town"),
)
@pytest.mark.parametrize("mask", (False, True))
def test_classes_that_explain_nothing_are_named(tmp_path, other, mask):
    classes = other(town()[1])
    (finding,) = found(tmp_path, np.where(classes == 6, classes, np.nan) if mask else classes)
    assert finding.id == "classes-other" and "not flipped" in finding


def test_classes_without_any_value_are_refused(tmp_path):
    with pytest.raises(OverlapError, match="has no class at any height"):
        found(tmp_path, np.full((500, 500), np.nan))


@pytest.mark.parametrize("width", (60, 90, 150))
def test_districts_of_any_size_are_good(tmp_path, width):
    rows, columns = np.indices((500, 500)) // width
    assert not found(tmp_path, rows % 3 * 3 + columns % 3)
