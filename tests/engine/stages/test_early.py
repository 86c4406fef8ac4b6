"""Requests that make no sense for the images are refused before any work, by the engine and so by the dialogs."""

from __future__ import annotations

import re
import time
from dataclasses import replace

import pytest

from repm_qgis.contracts.errors import MissingPackageError, OptionError
from repm_qgis.contracts.options import PipelineOptions, SampleDataOptions
from repm_qgis.scene import GroundSeen, Scene, ground_of
from repm_qgis.stages import run_stage
from repm_qgis.stages.early import require_cell, require_sensible
from repm_qgis.stages.parameters import ENGINE


@pytest.fixture
def job(urban, tmp_path):
    """A pipeline's options, which must not have begun: no scene is there."""

    def make(**options):
        names = {"workspace": str(tmp_path / "w"), "output": str(tmp_path / "dsm.tif")}
        return {"images": urban.images[:2], **names, **options}

    yield make
    assert not (tmp_path / "w" / "scene.json").exists()


@pytest.mark.parametrize(
    ("resolution", "words"),
    (
        (
            0.01,
            r"RESOLUTION is 0\.01: it must be at least 0\.1[0-9]* m, a quarter of the images' ground sampling distance",
        ),
        (500.0, r"RESOLUTION is 500\.0: it must be at most [0-9]+ m: the ground is [0-9]+ m wide at most"),
    ),
)
def test_cells_far_from_what_the_images_show(job, told, resolution, words):
    start = time.monotonic()
    with pytest.raises(OptionError, match=words):
        run_stage("pipeline", job(resolution=resolution), told())
    assert time.monotonic() - start < 2


@pytest.mark.parametrize("gsd", (0.31, 0.4987, 0.5, 1.0, 2.5, 10.0))
def test_what_the_message_proposes_is_accepted(gsd):
    for cell in (0.01, 900.0):
        with pytest.raises(OptionError) as caught:
            require_cell(cell, 400 * gsd if gsd < 2 else 1000.0, gsd, ENGINE.tiles)
        proposed = float(re.search(r"must be at (?:least|most) ([0-9.e+]+) m", str(caught.value))[1])
        require_cell(proposed, 400 * gsd if gsd < 2 else 1000.0, gsd, ENGINE.tiles)
        assert 0.2 * gsd < proposed < 500
    require_cell(0.0, 1.0, gsd, ENGINE.tiles)  # automatic


def test_an_area_that_is_too_small_for_the_cells_is_refused_before_matching(urban, told, tmp_path):
    x, y = (urban.bounds[0] + urban.bounds[2]) / 2, (urban.bounds[1] + urban.bounds[3]) / 2
    small = {"extent": (x - 20, y - 20, x + 20, y + 20), "extent_crs": urban.crs, "resolution": 15.0}
    given = {"images": urban.images[:2], "workspace": str(tmp_path / "w"), "output": str(tmp_path / "dsm.tif")}
    with pytest.raises(OptionError, match=r"RESOLUTION is 15\.0: it must be at most 1[01](\.[0-9])? m"):
        run_stage("pipeline", {**given, **small}, told())
    assert not (tmp_path / "w" / "reconstructed.json").exists()
    with pytest.raises(OptionError, match=r"EXTENT is .*: it shares only 4 m² with what two images see: draw at least"):
        run_stage("pipeline", {**given, **small, "extent": (x - 1, y - 1, x + 1, y + 1)}, told())


def test_the_fusion_refuses_the_same(urban_run, told, tmp_path):
    scene = urban_run.result.scene
    seen, views = ground_of(scene), Scene.load(scene).views
    assert seen == GroundSeen.of(views) and seen.gsd_m == min(view.gsd_m for view in views)
    for resolution, words in ((0.02, "must be at least"), (900.0, "must be at most")):
        with pytest.raises(OptionError, match=words):
            run_stage("dsmfuse", {"scene": scene, "output": str(tmp_path / "d.tif"), "resolution": resolution}, told())
    assert ground_of(str(tmp_path / "gone.json")) is None and not (tmp_path / "d.tif").exists()


@pytest.mark.parametrize("option", ("vertical_datum", "gcp_datum"))
def test_a_geoid_without_its_grid_is_said_before_the_fit(urban, job, told, option, monkeypatch):
    """As on Debian 12 with EGM2008; PROJ lacks the grid here in any case."""
    from repm_qgis.geometry import vertical

    missing = lambda *_: (type("Group", (), {"transformers": []}), ["Und.gz", "us_nga_egm08_25.tif"])  # noqa: E731
    monkeypatch.setattr(vertical, "vertical_operations", missing)
    vertical._best_operation.cache_clear()
    with pytest.raises(MissingPackageError) as caught:
        run_stage("pipeline", job(gcps=urban.made.gcps, **{option: "EGM2008"}), told())
    text = str(caught.value)
    for words in ("EGM2008 height", "put https://cdn.proj.org/us_nga_egm08_25.tif into the folder", option.upper()):
        assert words in text, text


def test_too_many_tiles(urban, job, told):
    few = replace(ENGINE, tiles=replace(ENGINE.tiles, most_tiles=1))
    with pytest.raises(
        OptionError, match=r"TILE_SIZE is 256: it makes 4 tiles of .*, and 1 are the most: choose \d+ px"
    ):
        run_stage("pipeline", job(tile_size=256), told(), few)


@pytest.mark.parametrize(("resolution", "most"), ((0.0, "(29|30) m"), (0.5, "15 m"), (2.0, "60 m")))
def test_a_radius_of_very_many_cells(job, told, resolution, most):
    """Three million passes over a tile, and counts that no longer fit into 16 bits."""
    with pytest.raises(OptionError, match=f"OUTLIER_RADIUS is 1000.0: it must be at most {most}, 30 cells of the DSM"):
        run_stage("pipeline", job(outlier_radius=1000.0, resolution=resolution), told())


@pytest.mark.parametrize("kind", ("urban", "mountains"))
def test_sample_images_that_do_not_fit_into_memory(told, tmp_path, monkeypatch, kind):
    """20,000 px of a town take 170 GiB: QGIS would be ended by the system."""
    monkeypatch.setattr("repm_qgis.stages.early.free_mib", lambda: 8192.0)
    with pytest.raises(
        OptionError, match=r"SIZE is 20000: it takes about \d+\.\d GiB of memory, and 8\.0 GiB are free"
    ) as caught:
        run_stage("sampledata", {"folder": str(tmp_path / "s"), "kind": kind, "size": 20000}, told())
    most = int(re.search(r"choose at most (\d+) px", str(caught.value))[1])
    require_sensible(SampleDataOptions(folder="s", kind=kind, size=most))
    assert 4000 < most < 7000 and not (tmp_path / "s").exists()


def test_it_takes_milliseconds(job):
    options = PipelineOptions.from_json(job(resolution=0.5))
    start = time.process_time()  # its own: other processes may have the processor for longer
    require_sensible(options)
    assert time.process_time() - start < 0.5


def test_a_crs_that_distorts_is_named_where_it_is_chosen(urban, told, tmp_path):
    said = told()
    options = {"images": urban.images, "workspace": str(tmp_path), "altitude_min": 150.0, "altitude_max": 260.0}
    made = run_stage("epmfit", {**options, "crs": "EPSG:3857"}, said)
    (finding,) = [each for each in said.warnings if each.id == "crs-distorts"]
    assert "EPSG:3857" in finding and urban.crs in finding  # and the UTM zone
    assert Scene.load(made.scene).history[0].warnings[0].id == "crs-distorts"
