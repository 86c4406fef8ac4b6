"""The gate: what is used together fits together, is refused, or takes the "Good." from the verdict."""

from __future__ import annotations

import shutil
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import ImageError, OptionError
from repm_qgis.gate.companions import confidence_findings, picture_findings, terrain_findings
from repm_qgis.gate.content import copies
from repm_qgis.gate.places import uncertain_findings
from repm_qgis.gate.times import order_findings, require_possible, time_findings
from repm_qgis.imagery import raster
from repm_qgis.imagery.heights import stray_numbers
from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.stages import run_stage

SIDE, CELL, WEST, NORTH = 240, 0.5, 500000.0, 4000000.0


def written(path, values, west=WEST, north=NORTH, cell=CELL, crs="EPSG:32631", metadata=None):
    values = np.asarray(values, np.float32)
    return raster.write(str(path), [values], (west, cell, 0, north, 0, -cell), crs, metadata=metadata or {}, unit="m")


def surface(seed=0, houses=True):
    """Gentle ground with some houses, m, and noise of 0.05 m."""
    y, x = np.mgrid[:SIDE, :SIDE] * CELL
    heights = 100.0 + 0.02 * x + np.sin(y / 20.0) + np.random.default_rng(seed).normal(0, 0.05, (SIDE, SIDE))
    if houses:
        for row in range(20, SIDE - 40, 60):
            heights[row : row + 24, 30:60] += 8.0
    return heights


@pytest.fixture
def dsm(tmp_path):
    return written(tmp_path / "dsm.tif", surface())


def ids(findings):
    return [finding.id for finding in findings]


def test_a_confidence_of_its_own_dsm_is_no_news(dsm, tmp_path):
    errors = np.full((SIDE, SIDE), 0.1)
    assert confidence_findings(dsm, written(tmp_path / "c.tif", errors), "CONFIDENCE") == []
    holes = surface()
    holes[50:90, 50:90] = errors[50:90, 50:90] = np.nan
    with_holes = written(tmp_path / "holes.tif", holes), written(tmp_path / "ch.tif", errors)
    assert confidence_findings(*with_holes, "CONFIDENCE") == []


def varied(of, seed=3):
    """Expected errors as a sound raster has them: up to twice, and more at edges."""
    return of * np.random.default_rng(seed).uniform(0.5, 2.0, (SIDE, SIDE))


@pytest.mark.parametrize(("median", "said"), ((10.0, "10"), (90.0, "90")), ids=("centimetres", "90 m"))
def test_expected_errors_of_another_unit_are_named(dsm, tmp_path, median, said):
    for errors in (np.full((SIDE, SIDE), median), varied(median)):
        (finding,) = confidence_findings(dsm, written(tmp_path / "c.tif", errors), "CONFIDENCE")
        assert finding.id == "errors-unlikely" and finding.level == "doubt"
    assert confidence_findings(dsm, written(tmp_path / "sound.tif", varied(0.1)), "CONFIDENCE") == []


@pytest.mark.long
def test_errors_of_other_units_are_named_whoever_reads_them(dsm, tmp_path):
    second = written(tmp_path / "b.tif", surface(1), metadata={"REPM_DAYS": "2024-05-01"})
    third = written(tmp_path / "c.tif", surface(2), west=WEST + 60.0)
    wrong, sound = (written(tmp_path / f"e{of}.tif", varied(of)) for of in (10.0, 0.1))
    beside = written(tmp_path / "beside.tif", varied(0.1), west=WEST + 60.0)
    output = {"output": str(tmp_path / "o.tif")}
    jobs = {
        "change": {"before": dsm, "after": second, "before_confidence": "", "after_confidence": sound, **output},
        "series": {"dsms": [dsm, second, written(tmp_path / "d.tif", surface(4))], **output},
        "mosaic": {"dsms": [dsm, third], **output},
        "viewer": {"dsm": dsm, "viewer": str(tmp_path / "page.html")},
        "dtm": {"dsm": dsm, "largest": 20.0, **output},
    }
    options = {"change": "before_confidence", "series": "confidences", "mosaic": "confidences"}
    jobs["series"]["dates"] = ["2020-05-01", "2022-05-01", "2024-05-01"]
    for name, job in jobs.items():
        for errors, named in ((wrong, True), (sound, False)):
            given = {"series": [errors, sound, sound], "mosaic": [errors, beside]}.get(name, errors)
            run = Recorder(Silent())
            run_stage(name, {**job, options.get(name, "confidence"): given}, run)
            assert ("errors-unlikely" in ids(run.findings)) == named, name
    negative = written(tmp_path / "n.tif", -varied(0.1))
    for name in ("viewer", "change"):
        with pytest.raises(ImageError, match="100 % of the expected errors of .*n.tif' are 0 or less"):
            run_stage(name, {**jobs[name], options.get(name, "confidence"): negative}, Silent())


def test_heights_without_an_expected_error_are_named_with_their_share(dsm, tmp_path):
    gap = np.full((SIDE, SIDE), 0.1)
    gap[50:90, 50:90] = np.nan
    (finding,) = confidence_findings(dsm, written(tmp_path / "gap.tif", gap), "CONFIDENCE")
    assert finding.id == "error-unknown" and finding.startswith(f"{100 * 1600 / SIDE**2:.1f} % of the heights of")
    whole = np.full((SIDE, SIDE), 0.1)
    moved = written(tmp_path / "moved.tif", whole, west=WEST + 50.0)
    (share,) = confidence_findings(dsm, moved, "CONFIDENCE")  # 100 of 240 columns
    assert share.startswith("41.7 % of the heights")
    cropped = written(tmp_path / "cropped.tif", whole[60:, :])
    assert "25.0 % of the heights" in confidence_findings(dsm, cropped, "CONFIDENCE")[0]
    holes = surface()
    holes[:, 100:] = np.nan
    (strange,) = confidence_findings(written(tmp_path / "h.tif", holes), written(tmp_path / "w.tif", whole), "C")
    assert strange.id == "confidence-of-other" and strange.level == "doubt"


@pytest.mark.parametrize(
    "place", ({"west": WEST + 0.2}, {"cell": 1.0}, {"crs": "EPSG:32632"}), ids=["between cells", "cells", "crs"]
)
def test_a_confidence_on_other_cells_is_refused(dsm, tmp_path, place):
    other = written(tmp_path / "other.tif", np.full((SIDE, SIDE), 0.1), **place)
    with pytest.raises(ImageError, match=r"other.tif.*does not have the cells of the DSM.*leave MY_OPTION empty"):
        confidence_findings(dsm, other, "MY_OPTION")


def test_a_terrain_that_does_not_belong_to_the_dsm_is_named(dsm, tmp_path):
    ground = surface(1, houses=False)
    assert terrain_findings(dsm, written(tmp_path / "good.tif", ground)) == []
    (low,) = terrain_findings(dsm, written(tmp_path / "low.tif", ground - 46.7))
    assert (low.id, low.level) == ("terrain-off", "doubt") and "lies 46.7 m below the ground" in low
    (high,) = terrain_findings(dsm, written(tmp_path / "high.tif", ground + 30.0))
    assert "m above the ground" in high
    (half,) = terrain_findings(dsm, written(tmp_path / "half.tif", ground[:, : SIDE // 2]))
    assert half.id == "terrain-partial" and "covers 50." in half


@pytest.mark.parametrize("off", (2.0, 2.8, -2.0, -2.8))
@pytest.mark.parametrize("tilted", (False, True))
def test_a_terrain_that_lies_two_or_three_metres_off_is_named(dsm, tmp_path, off, tilted):
    """The check began at 3 m, and houses are searched from 2.5 m on."""
    ground = surface(1, houses=False)
    ramp = np.linspace(-1.0, 1.0, SIDE)[:, None] if tilted else 1.0
    (found,) = terrain_findings(dsm, written(tmp_path / "off.tif", ground - off * ramp))
    assert (found.id, found.level) == ("terrain-off", "doubt")
    says = f"lies {'up to ' if tilted else ''}{abs(off):.1f} m {'below' if off > 0 else 'above'} the ground"
    assert tilted or says in found
    assert terrain_findings(dsm, written(tmp_path / "near.tif", ground - off / 4 * ramp)) == []


@pytest.mark.parametrize(
    "changed",
    (
        lambda heights: np.full(heights.shape, np.median(heights)),
        lambda heights: np.flipud(heights),
        lambda heights: np.fliplr(heights),
        lambda heights: 2 * heights - np.median(heights),
        lambda heights: np.roll(heights, (70, 50), (0, 1)),
    ),
    ids=("constant", "upside down", "mirrored", "doubled", "elsewhere"),
)
@pytest.mark.parametrize("relief", (1.5, 4.0))
def test_a_terrain_of_another_relief_is_named(tmp_path, changed, relief):
    """Houses on hills, above terrains of the right height: buildings had six times their area, under "Good."."""
    y, x = np.mgrid[:SIDE, :SIDE] * CELL
    hills = relief * (np.sin(x / 17.0 + 1.0) * np.cos(y / 23.0) + 0.4 * np.sin(x / 7.0 - y / 9.0))
    houses = surface() - surface(houses=False)
    dsm = written(tmp_path / "dsm.tif", 100.0 + hills + houses + 0.05 * np.random.default_rng(1).normal(size=x.shape))
    assert terrain_findings(dsm, written(tmp_path / "own.tif", 100.0 + hills)) == []
    found = terrain_findings(dsm, written(tmp_path / "other.tif", 100.0 + changed(hills)))
    assert found and {(each.id, each.level) for each in found} <= {
        ("terrain-relief", "doubt"),
        ("terrain-off", "doubt"),
    }


def test_a_constant_terrain_is_right_where_the_ground_is_level(tmp_path):
    houses = surface() - surface(houses=False) + np.random.default_rng(1).normal(0, 0.3, (SIDE, SIDE))
    level = written(tmp_path / "level.tif", np.full((SIDE, SIDE), 20.0))
    assert terrain_findings(written(tmp_path / "dsm.tif", 20 + houses), level) == []


def test_ground_between_crowns_tells_where_the_terrain_is(tmp_path):
    """Trees on four fifths of the ground, and a hall wider than the opening, are no ground."""
    heights, bare = surface(houses=False), surface(1, houses=False)
    crowns = np.random.default_rng(3).random((SIDE // 8, SIDE // 8)) < 0.8
    heights += np.kron(crowns, np.ones((8, 8))) * np.random.default_rng(4).uniform(4, 14, (SIDE, SIDE))
    heights[40:180, 60:200] = bare[40:180, 60:200] + 9.0
    path = written(tmp_path / "forest.tif", heights)
    assert terrain_findings(path, written(tmp_path / "bare.tif", bare)) == []
    assert ids(terrain_findings(path, written(tmp_path / "low.tif", bare - 4.0))) == ["terrain-off"]


def test_buildings_above_a_terrain_of_another_datum_are_not_good(dsm, tmp_path, told):
    """The ground was a building, under "Good."."""
    said = told()
    low = written(tmp_path / "low.tif", surface(1, houses=False) - 46.7)
    page = tmp_path / "r.html"
    options = {"dsm": dsm, "dtm": low, "output": str(tmp_path / "b.gpkg"), "report": str(page)}
    run_stage("buildings", options, said)
    assert "terrain-off" in ids(said.warnings)
    top = page.read_text(encoding="utf-8").split("<h2")[0]
    assert "Do not use it before you have looked at:" in top and "46.7 m below" in top


def test_a_picture_that_covers_a_part_is_named():
    assert picture_findings("dsm.tif", "ortho.tif", 0.995, [np.arange(9.0)]) == []
    (finding,) = picture_findings("dsm.tif", "ortho.tif", 0.5, [np.arange(9.0)])
    assert finding == "The picture 'ortho.tif' shows 50.0 % of the heights of 'dsm.tif': the rest has no colours."


def test_a_copy_is_known_under_another_name_format_and_compression(dsm, tmp_path):
    shutil.copy(dsm, tmp_path / "copy.tif")
    gdal.Translate(str(tmp_path / "c.img"), dsm, format="HFA")
    other = written(tmp_path / "other.tif", surface(1))
    paths = [dsm, other, str(tmp_path / "copy.tif"), str(tmp_path / "c.img")]
    assert copies(paths) == [(paths[2], dsm), (paths[3], dsm)]
    changed = surface()
    changed[3, 3] += 0.002
    assert copies([dsm, written(tmp_path / "changed.tif", changed)]) == [] or changed[3, 3] == surface()[3, 3]


def test_algorithms_refuse_copies(dsm, tmp_path, told):
    copy, other = str(tmp_path / "copy.tif"), written(tmp_path / "other.tif", surface(1))
    shutil.copy(dsm, copy)
    jobs = {
        "change": {"before": dsm, "after": copy, "output": str(tmp_path / "o.tif")},
        "series": {
            "dsms": [dsm, other, copy],
            "dates": ["2020-01-01", "2021-01-01", "2022-01-01"],
            "output": str(tmp_path / "o.tif"),
        },
        "mosaic": {"dsms": [dsm, copy], "output": str(tmp_path / "o.tif")},
        "comparedsm": {"dsm": dsm, "reference": copy, "error": str(tmp_path / "o.tif")},
    }
    for stage, options in jobs.items():
        with pytest.raises(OptionError, match=r"must not have the same heights as '.*tif'"):
            run_stage(stage, options, told())
        assert not (tmp_path / "o.tif").exists(), stage


def test_times_that_cannot_be_are_refused():
    for year in (18, 1956, 2320):
        with pytest.raises(OptionError, match=rf"{year:04d}-05-01.*between 1957 and today"):
            require_possible(datetime(year, 5, 1, tzinfo=timezone.utc), "DATES", "x")
    require_possible(datetime.now(timezone.utc) - timedelta(days=1), "DATES", "x")


def test_what_files_say_about_their_time_is_compared_with_what_the_user_says(tmp_path):
    early = written(tmp_path / "a.tif", surface(), metadata={"REPM_DAYS": "2019-05-01"})
    late = written(tmp_path / "b.tif", surface(1), metadata={"REPM_DAYS": "2021-05-01"})
    silent = written(tmp_path / "c.tif", surface(2))
    said = {early: datetime(2019, 5, 1, tzinfo=timezone.utc), silent: datetime(2020, 1, 1, tzinfo=timezone.utc)}
    assert time_findings(said) == []
    (finding,) = time_findings({early: datetime(2021, 5, 1, tzinfo=timezone.utc)})
    assert finding.level == "doubt" and "DATES says 2021-05-01" in finding and "the file 2019-05-01" in finding
    assert order_findings(early, late) == order_findings(late, silent) == []
    (reversed_,) = order_findings(late, early)
    assert reversed_.id == "dates-reversed" and "gains and losses are exchanged" in reversed_


@pytest.mark.long
def test_the_cases_that_were_read_wrongly(shared_data, tmp_path, told):
    """Small inputs of ../shared/data/cases, on which 1a5763d7 said "Good."."""
    cases = shared_data / "cases"
    if not cases.is_dir():
        pytest.skip(f"{cases} is absent")
    page = tmp_path / "r.html"

    def top():
        return page.read_text(encoding="utf-8").split("<h2")[0]

    gap, made = cases / "confidence_gap", {"output": str(tmp_path / "o.tif"), "report": str(page)}
    dates = {"before": str(gap / "a.tif"), "after": str(gap / "b2.tif")}
    errors = {"before_confidence": str(gap / "cf.tif"), "after_confidence": str(gap / "cfu.tif")}
    run_stage("change", {**dates, **errors, **made}, told())
    assert "% of the heights of" in top() and "Look at:" in top()
    mercator = cases / "web_mercator"
    found = run_stage("change", {"before": str(mercator / "wa.tif"), "after": str(mercator / "wb.tif"), **made}, told())
    assert (found.gained_m3, found.lost_m3) == pytest.approx((3600, 900), rel=0.03)
    datum = cases / "dtm_other_datum"
    options = {"dsm": str(datum / "fd.tif"), "dtm": str(datum / "fdtm_off.tif"), "output": str(tmp_path / "b.gpkg")}
    run_stage("buildings", {**options, "report": str(page)}, told())
    assert "46.7 m below the ground" in top()


def test_a_void_that_could_be_a_height_is_named_and_a_single_tower_is_not(tmp_path):
    sparse = np.full((SIDE, SIDE), np.nan)
    sparse[::17, ::17] = surface()[::17, ::17]
    sparse[0, 0] += 140.0
    holes = surface()
    holes[:40, :40] = 0.0
    roof = surface()
    roof[:40, :40] = np.floor(surface().max()) + 72.3012
    for values, share in ((surface(), 0.0), (sparse, 0.0), (holes, 1600 / SIDE**2), (roof, 0.0)):
        with raster.opened(written(tmp_path / "x.tif", values)) as dataset:
            assert stray_numbers(dataset).constant == pytest.approx(share)


def test_a_reference_that_states_an_uncertain_height_is_named(tmp_path):
    """As a DSM of a scene that was not registered does: its heights are no truth."""
    path = str(tmp_path / "dsm.tif")
    written(path, surface())
    for stated, named in ((None, False), ("0.31", False), ("36.962", True), ("nonsense", False)):
        with raster.quiet():
            source = gdal.Open(path, gdal.GA_Update)
            source.SetMetadataItem("REPM_HEIGHT_DEVIATION", stated)
            source = None  # noqa: F841 - closes it
        assert bool(uncertain_findings(path)) == named, stated
    assert not uncertain_findings(__file__)
