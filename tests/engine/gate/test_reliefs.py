"""Dates and DSMs that do not show one ground are named after any alignment, and what does is "Good."."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.errors import EmptyResultError, ImageError
from repm_qgis.gate.companions import terrain_findings
from repm_qgis.imagery.raster import write
from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.stages import run_stage

SIDE = 240  # cells of 1 m
ROWS, COLUMNS = np.indices((SIDE, SIDE)).astype(float)
EAST = COLUMNS / SIDE - 0.5


def town(seed=7, hills=1.0, base=2.0):
    """Heights of a town at the sea: gentle ground, and houses at random places."""
    rng = np.random.default_rng(seed)
    ground = base + hills * (np.sin(COLUMNS / (20 + seed)) * np.cos(ROWS / 25) + 0.3 * np.sin(ROWS / 13 + seed))
    for _ in range(60):
        row, column = rng.integers(0, SIDE - 20, 2)
        depth, width = rng.integers(8, 18, 2)
        ground[row : row + depth, column : column + width] += rng.uniform(3, 9)
    return ground


def compared(folder, stage, heights, align="none", reference=None, **more):
    """The findings of a stage for heights against the town, in a series as the second of four dates."""
    rng, paths = np.random.default_rng(1), []
    first = town() if reference is None else reference
    surfaces = [first, heights, first, first] if stage == "series" else [first, heights]
    for number, surface in enumerate(surfaces):
        noisy = (surface + rng.normal(0, 0.1, surface.shape)).astype(np.float32)
        path = str(folder / f"{number}.tif")
        paths.append(write(path, [noisy], (5e5, 1, 0, 5e6, 0, -1), "EPSG:32633"))
    output, run = {"output": str(folder / "out.tif")}, Recorder(Silent())
    named = {
        "comparedsm": {"reference": paths[0], "dsm": paths[1]},
        "change": {"before": paths[0], "after": paths[1], **output},
        "series": {"dsms": paths, "dates": ["2018-05-01", "2020-05-01", "2022-05-01", "2024-05-01"], **output},
    }[stage]
    run_stage(stage, {**named, "align": align, **more}, run)
    return run.findings


STAGES = ("comparedsm", "change", pytest.param("series", marks=pytest.mark.long))
WRONG = {
    "feet": lambda of: of / 0.3048,
    "another town": lambda of: town(11),
    "mirrored": lambda of: of[:, ::-1],
    "upside down": lambda of: 2 * np.median(of) - of,
}


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("align", ("vertical", "3d"))
@pytest.mark.parametrize("wrong", WRONG)
def test_a_date_of_another_relief_is_named_after_the_alignment(stage, align, wrong, tmp_path):
    try:
        found = compared(tmp_path, stage, WRONG[wrong](town()), align)
    except EmptyResultError as refused:
        assert "too little relief for a 3-D alignment" in str(refused)
        return
    assert any(each.id == "relief-other" and each.level == "doubt" for each in found)


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("align", ("none", "vertical", "3d"))
@pytest.mark.parametrize("hills", (0.0, 1.0, 20.0))
def test_one_ground_is_good(stage, align, hills, tmp_path):
    """Of flat ground only the houses tell."""
    ground = town(hills=hills)
    assert not compared(tmp_path, stage, ground + (0.0 if align == "none" else 1.0), align, reference=ground)


@pytest.mark.parametrize("stage", STAGES)
def test_noise_alone_is_no_other_relief(stage, tmp_path):
    level = np.full((SIDE, SIDE), 2.0)
    assert not compared(tmp_path, stage, level + np.random.default_rng(2).normal(0, 0.8, level.shape), reference=level)


@pytest.mark.parametrize(("by", "hills"), ((1.5, 0.0), (3.0, 1.0), (5.0, 20.0)))
@pytest.mark.parametrize("stage", STAGES)
def test_a_tilt_is_named_as_what_it_is(stage, by, hills, tmp_path):
    ground = town(hills=hills)
    found, *more = compared(tmp_path, stage, ground + by * EAST, "vertical", reference=ground)
    assert found.id == "tilted" and float(found.split(" by ")[1].split(" m ")[0]) == pytest.approx(by, abs=0.15)
    assert {each.id for each in more} <= {"level-high"}  # of the tilt, too


@pytest.mark.parametrize("align", ("vertical", "3d"))
def test_a_date_of_which_most_is_raised_is_named(align, tmp_path):
    raised = town() + 4.0 * (np.abs(EAST) < 0.3)
    assert "changed-much" in {each.id for each in compared(tmp_path, "series", raised, align)}


@pytest.mark.parametrize("align", ("none", "vertical"))
def test_a_date_that_is_far_off_is_not_to_be_aligned(align, tmp_path):
    said = [each for each in compared(tmp_path, "series", town() + 477.0, align) if each.id.startswith("date")]
    assert said and not any("ALIGN" in each for each in said) and all("unit" in each for each in said)


@pytest.mark.parametrize("by", (50.0, -50.0))
@pytest.mark.parametrize("hills", (0.0, 20.0))
def test_a_burst_in_one_piece_is_named(by, hills, tmp_path):
    ground = town(hills=hills)
    burst = ground + by * ((ROWS < 34) & (COLUMNS > 200))
    (found,) = compared(tmp_path, "comparedsm", burst, reference=ground)
    assert found.id == "piece-off" and "2.3 % of the heights, in one piece" in found and f"{by:+.1f} m" in found


def test_houses_that_were_built_between_are_no_burst(tmp_path):
    built = town() + 20.0 * ((ROWS % 60 < 12) & (COLUMNS % 60 < 12))  # 4 % of the ground
    assert not compared(tmp_path, "comparedsm", built)


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("align", ("none", "vertical", "3d"))
def test_heights_in_centimetres_are_refused_as_what_they_are(stage, align, tmp_path):
    ground = town(base=300.0)
    with pytest.raises(ImageError, match="1.tif' can be a height in metres .*: state the unit of its band, such as cm"):
        compared(tmp_path, stage, 100 * ground, align, reference=ground)


@pytest.mark.parametrize("stage", ("change", "series"))
@pytest.mark.parametrize("bare", ("first", "second"))
def test_bare_earth_as_a_date_is_named(stage, bare, tmp_path):
    """The terrain below the town: its houses would be what was built or taken away."""
    ground = 2.0 + np.sin(COLUMNS / 27) * np.cos(ROWS / 25)
    made = {"heights": ground} if bare == "second" else {"heights": town(), "reference": ground}
    found = compared(tmp_path, stage, **made)
    assert any(each.id == "overlap-bare" and each.level == "doubt" for each in found)


def test_a_new_hall_and_a_heap_are_no_bare_earth(tmp_path):
    ground = 2.0 + np.sin(COLUMNS / 27) * np.cos(ROWS / 25)
    built = ground.copy()
    built[40:60, 40:60] += 8.0
    built[140:160, 40:60] += 5.0
    assert not compared(tmp_path, "change", built, reference=ground)


@pytest.mark.parametrize("noise", (0.0, 0.1))
@pytest.mark.parametrize("below", (0.0, 3.0, 5.0, 10.0))
def test_a_terrain_a_constant_below_its_dsm_is_named(below, noise, tmp_path):
    """Also where the DSM has no noise, as those that are made of formulas."""
    ground = 2.0 + np.sin(COLUMNS / 27) * np.cos(ROWS / 25) + 0.3 * np.sin(ROWS / 13 + 7)
    surface = town() + np.random.default_rng(1).normal(0, noise, (SIDE, SIDE))
    paths = [
        write(str(tmp_path / f"{name}.tif"), [each.astype(np.float32)], (5e5, 1, 0, 5e6, 0, -1), "EPSG:32633")
        for name, each in (("dsm", surface), ("dtm", ground - below))
    ]
    assert [each.id for each in terrain_findings(*paths)] == (["terrain-off"] if below else [])


def scattered(share, by):
    return town() + by * (np.random.default_rng(5).random((SIDE, SIDE)) < share)


@pytest.mark.parametrize(
    ("heights", "align", "named"),
    (
        (lambda: scattered(0.4, 3.0), "none", "heights-stepped"),
        (lambda: town() + 3.0 * (ROWS < 96), "vertical", "heights-stepped"),
        (lambda: scattered(0.02, 50.0), "3d", "heights-stray"),
        (lambda: town() - 30.0, "3d", "moved-far"),
    ),
)
def test_what_no_nmad_shows_is_named_by_a_comparison(heights, align, named, tmp_path):
    assert [each.id for each in compared(tmp_path, "comparedsm", heights(), align)] == [named]


def test_crowns_and_errors_of_matching_are_no_step(tmp_path):
    rng = np.random.default_rng(6)
    errors = rng.normal(0, 0.5, (SIDE, SIDE)) + (rng.random((SIDE, SIDE)) < 0.3) * rng.exponential(4, (SIDE, SIDE))
    assert not compared(tmp_path, "comparedsm", town() + errors)
