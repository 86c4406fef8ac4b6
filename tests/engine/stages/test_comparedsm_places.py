"""A comparison with what is not the same surface, or not at its place, is not "Good."."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from repm_qgis.imagery.raster import write
from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.stages import run_stage

CRS = "EPSG:32633"


def hills(shape=(240, 240)):
    rows, columns = np.indices(shape).astype(float)
    surface = 20 * np.sin(columns / 31) * np.cos(rows / 23) + 8 * np.sin((rows + 2 * columns) / 11) + 0.05 * columns
    surface[60:100, 80:140] += 15
    return (300 + surface).astype(np.float32)


def ids_of(tmp_path, heights, align, east=0.0, reference=None):
    """The findings' ids of a comparison of heights with the hills."""
    paths = []
    for name, values, x in (
        ("dsm", heights, 5e5 + east),
        ("reference", hills() if reference is None else reference, 5e5),
    ):
        paths.append(write(str(tmp_path / f"{name}.tif"), [values.astype(np.float32)], (x, 1, 0, 5e6, 0, -1), CRS))
    run = Recorder(Silent())
    run_stage("comparedsm", {"dsm": paths[0], "reference": paths[1], "align": align}, run)
    return {finding.id for finding in run.findings}


@pytest.fixture
def noise():
    return np.random.default_rng(5).normal(0, 0.3, hills().shape)


@pytest.mark.parametrize("align", ("none", "vertical", "3d"))
def test_a_sound_dsm_is_good(tmp_path, noise, align):
    assert ids_of(tmp_path, hills() + noise, align) == set()


@pytest.mark.parametrize(
    "wrong",
    (
        lambda of: 2 * np.median(of) - of,
        lambda of: of[::-1, ::-1],
        lambda of: np.full_like(of, 300) + np.random.default_rng(1).normal(0, 0.01, of.shape),
        lambda of: of / 0.3048,
    ),
    ids=("negated", "turned", "constant", "feet"),
)
def test_another_relief_is_named(tmp_path, noise, wrong):
    assert "relief-other" in ids_of(tmp_path, wrong(hills() + noise), "vertical")


@pytest.mark.long
def test_points_that_a_tilt_leads_astray_are_named(tmp_path, noise):
    """Planes of points that are tilted against those of the reference fit better farther on."""
    rows, columns = np.indices(hills().shape).astype(float)
    town = 300 + 3 * np.sin(columns / 40) * np.cos(rows / 30)
    down, right = np.mgrid[-7:7, -8:8]
    for number, (top, left) in enumerate(product(range(10, 220, 30), repeat=2)):
        town[top : top + 14, left : left + 16] += 7 + 0.4 * (right, -right, down, -down)[number % 4]
    assert "icp-apart" not in ids_of(tmp_path, town + noise, "icp", reference=town)
    found = ids_of(tmp_path, town + noise + 4 * columns / 240, "icp", reference=town)
    assert "icp-apart" in found


@pytest.mark.parametrize("align", ("none", "vertical"))
def test_a_dsm_beside_its_place_is_named(tmp_path, noise, align):
    assert ids_of(tmp_path, hills() + noise, align, east=5.0) == {"place-off"}
    assert ids_of(tmp_path, hills() + noise, "3d", east=5.0) == set()


def test_a_few_cells_say_nothing(tmp_path, noise):
    few = np.full(hills().shape, np.nan)
    few[100:105, 100:110] = (hills() + noise)[100:105, 100:110]
    assert "compared-cells" in ids_of(tmp_path, hills() + noise, "none", reference=few)


def test_a_move_of_more_than_a_geoid_is_named(tmp_path, noise):
    assert "moved-far" in ids_of(tmp_path, hills() + noise + 236, "vertical")


@pytest.mark.parametrize(
    ("wrong", "named"),
    (
        (lambda of: of, False),
        (lambda of: of + 4, False),
        (lambda of: 2 * np.median(of) - of, True),
        (lambda of: of[:, ::-1], True),
        (lambda of: np.median(of) + 1.25 * (of - np.median(of)), True),
    ),
    ids=("sound", "raised", "negated", "mirrored", "scaled"),
)
def test_a_dsm_of_a_mosaic_has_the_relief_of_the_others(tmp_path, noise, wrong, named):
    """Medians of differences are 0 after the offsets, whatever the DSMs show."""
    dsms = [
        write(str(tmp_path / f"{name}.tif"), [values.astype(np.float32)], (5e5, 1, 0, 5e6, 0, -1), CRS)
        for name, values in (("one", hills()), ("two", wrong(hills() + noise)))
    ]
    run = Recorder(Silent())
    run_stage("mosaic", {"dsms": dsms, "output": str(tmp_path / "mosaic.tif")}, run)
    assert ("overlap-relief" in {finding.id for finding in run.findings}) == named


@pytest.mark.parametrize(("wrong", "named"), ((False, False), (True, True)), ids=("sound", "other"))
def test_gentle_ground_of_another_place_is_named_in_a_mosaic(tmp_path, noise, wrong, named):
    """Hills of 2 m differ by less than DSMs of coarse cells do."""
    rows, columns = np.indices(hills().shape).astype(float)
    one = 300 + 2 * np.sin(columns / 31) * np.cos(rows / 23) + 0.01 * columns
    other = 300 + 2 * np.cos(columns / 19) * np.sin(rows / 29) - 0.01 * columns if wrong else one
    dsms = [
        write(str(tmp_path / f"{name}.tif"), [heights.astype(np.float32)], (5e5, 1, 0, 5e6, 0, -1), CRS)
        for name, heights in (("one", one), ("two", other + noise))
    ]
    run = Recorder(Silent())
    run_stage("mosaic", {"dsms": dsms, "output": str(tmp_path / "mosaic.tif")}, run)
    assert ("overlap-relief" in {finding.id for finding in run.findings}) == named
