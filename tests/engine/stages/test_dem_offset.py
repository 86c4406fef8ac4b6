"""A DEM that is given is compared with the DSM: the offset is said, and warned of where it is not to be expected."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.records import DemOffset, FusionFacts
from repm_qgis.contracts.results import FusedSurface
from repm_qgis.imagery.raster import write
from repm_qgis.registration.dem_offset import stated_height_deviation
from repm_qgis.reports import verdict
from repm_qgis.reports.stage_reports import pipeline_report
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from tests.engine.pages import plain


def dem_of(truth, folder, up, cells=10, cut=slice(None)):
    """The true surface in coarse cells, so much higher than it is, as a DEM; gives its path."""
    rows, columns = (count // cells * cells for count in truth.surface.shape)
    blocks = truth.surface[:rows, :columns].reshape(rows // cells, cells, columns // cells, cells)
    heights = np.nanmean(blocks, axis=(1, 3)).astype(np.float32)[cut] + np.float32(up)
    x, cell, _, y, _, _ = truth.transform
    wkt = gdal.Open(truth.truth).GetProjection()
    return write(str(Path(folder) / "dem.tif"), [heights], (x, cells * cell, 0, y, 0, -cells * cell), wkt)


def fused(run, folder, dem, said, uncertain=6.0, **options):
    """The run's height maps fused in a scene that has a DEM, and whose height is uncertain by so many metres."""
    scene = Scene.load(run.result.scene)
    pointing = replace(scene.pointing, height_uncertainty_m=uncertain)
    path = replace(scene, dem=dem, pointing=pointing).save(str(Path(run.result.scene).with_name("with_dem.json")))
    made = run_stage("dsmfuse", {"scene": path, "output": str(folder / "dsm.tif"), **options}, said)
    return Scene.load(path), made


def true_offset(truth, dsm):
    """How far the DSM lies above the true surface, m."""
    return run_stage("comparedsm", {"dsm": dsm, "reference": truth.truth}, told_nothing())["bias"]


def told_nothing():
    from repm_qgis.runtime.progress import Silent

    return Silent()


@pytest.mark.parametrize(("up", "fill"), ((0.0, "occlusions"), (-55.0, "all")))
@pytest.mark.slow
def test_the_offset_is_that_of_the_truth(urban, urban_run, tmp_path, told, up, fill):
    """Whatever is filled in on the DEM itself counts nothing."""
    said, dem = told(), dem_of(urban, tmp_path, up)
    scene, made = fused(urban_run, tmp_path, dem, said, fill=fill, resolution=1.0)
    found = FusionFacts.from_mapping(made.to_mapping()).dem_offset
    assert found.file == dem and found.up_m == pytest.approx(true_offset(urban, urban_run.result.output) - up, abs=0.4)
    assert 0.0 < found.deviation_m < 0.5
    # Two deviations of 6.0 / 2 m and of the DEM's own 2.4 m.
    assert found.most_m == pytest.approx(2 * np.hypot(3.0, 2.4), rel=0.02)
    text = f"The DSM lies {abs(found.up_m):.1f} m {'above' if found.up_m > 0 else 'below'} the DEM '{dem}'"
    if not up:
        assert not found.unexpected and any(text in note for note in said.notes) and said.warnings == []
        return
    (warned,) = [warning for warning in said.warnings if "DEM" in warning]
    assert text in warned and f"at most {found.most_m:.1f} m are to be expected" in warned and "above" in text
    facts = FusionFacts.from_mapping(made.to_mapping())
    assert any(text in finding for finding in verdict.of_run(scene, facts))
    page = plain(pipeline_report(scene, replace(urban_run.result, **made.fields_of(FusedSurface)), None).html())
    assert page.count(f"The DSM lies {found.up_m:.1f} m above the DEM") == 1 and "Nothing here measures" not in page


@pytest.mark.long
def test_what_is_stated_decides_what_is_to_be_expected(urban_run, urban, tmp_path, told):
    scene, made = fused(urban_run, tmp_path, dem_of(urban, tmp_path, -20.0), told(), 90.0)
    assert not FusionFacts.from_mapping(made.to_mapping()).dem_offset.unexpected
    assert stated_height_deviation(scene) == 45.0
    controlled = replace(scene.pointing, height_uncertainty_m=None, control_information=np.diag([1.0, 1.0, 16.0]))
    assert stated_height_deviation(replace(scene, pointing=controlled)) == pytest.approx(0.25)
    assert stated_height_deviation(replace(scene, pointing=None)) is None
    assert not DemOffset("dem.tif", 500.0, 0.1).unexpected


@pytest.mark.long
def test_a_dem_that_cannot_be_compared_stops_nothing(urban_run, urban, tmp_path, told):
    """Too few of its cells, and none at all."""
    few = dem_of(urban, tmp_path, 0.0, 10, (slice(0, 5), slice(0, 5)))
    for dem in (few, str(tmp_path / "gone.tif")):
        said = told()
        made = fused(urban_run, tmp_path, dem, said)[1]
        assert made.dem_offset is None and made.valid > 0 and said.warnings == []
        assert any(f"was not compared with the DEM '{dem}'" in note for note in said.notes)


def test_without_a_dem_there_is_no_offset(urban_run):
    assert urban_run.result.dem_offset is None
