"""One height for each cell, in whole runs: what is chosen, what it says of itself, and what is counted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Window
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.fusion.layout import DsmLayout
from repm_qgis.imagery.confidence import Provenance
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE
from tests.engine.rasters import bands


@pytest.fixture
def fused(urban_run, tmp_path, told):
    """A function that fuses the town's height maps: the DSM, the confidence, the facts and the log."""

    def made(name, parameters=ENGINE, scene=None, **options):
        files = {"output": str(tmp_path / f"{name}.tif"), "confidence": str(tmp_path / f"{name}_confidence.tif")}
        log = told()
        scene = scene or urban_run.result.scene
        facts = run_stage("dsmfuse", {"scene": scene, "resolution": 0.5, **files, **options}, log, parameters)
        return bands(files["output"])[0][0], bands(files["confidence"])[0], facts, log

    return made


def corner(path):
    """East and north of a raster's first corner, m."""
    dataset = gdal.Open(path)
    place = dataset.GetGeoTransform()
    return place[0], place[3]


@pytest.mark.long
def test_heights_are_chosen_and_each_says_where_it_comes_from(fused, as_they_are, urban, tmp_path):
    plain, before, without, _ = fused("plain", as_they_are)
    dsm, after, facts, _ = fused("chosen")
    changed = np.abs(dsm - plain) > 0
    assert 0.005 < changed.mean() < 0.3
    scores = [score_files(str(tmp_path / f"{name}.tif"), urban.truth, "cells").metrics for name in ("plain", "chosen")]
    assert scores[1].mae < scores[0].mae and scores[1].rmse < scores[0].rmse
    source = after[3]
    # No height keeps the facts of one that was thrown away.
    unmatched = np.isfinite(source) & (source != Provenance.MATCHED)
    assert (source == Provenance.NEIGHBOURS).sum() > 100 and np.isnan(after[:3, unmatched]).all()
    far = changed & (np.abs(dsm - plain) > 2.0) & (source == Provenance.MATCHED)
    assert not np.array_equal(after[2, far], before[2, far]) and (after[4, unmatched] >= 0.7).all()
    counts = {name: int((source == code).sum()) for name, code in (("matched", Provenance.MATCHED),)}
    assert facts.matched == counts["matched"] < without.matched
    assert facts.background == unmatched.sum() and facts.valid == np.isfinite(dsm).sum()


@pytest.mark.long
def test_without_filling_only_matched_heights_are_left(fused):
    dsm, confidence, facts, _ = fused("none", fill="none")
    assert set(np.unique(confidence[3][np.isfinite(confidence[3])])) == {Provenance.MATCHED}
    np.testing.assert_array_equal(np.isnan(confidence[3]), np.isnan(dsm))
    assert facts.background == 0 and facts.matched == np.isfinite(dsm).sum()


@pytest.mark.parametrize(("kind", "cell"), (("urban", 0.5), ("mountains", 1.0)))
@pytest.mark.slow
def test_heights_do_not_depend_on_the_blocks(request, tmp_path, told, kind, cell):
    """Three sizes of blocks, in which tiles are gridded and heights are chosen, and the same bytes."""
    scene = request.getfixturevalue(f"{kind}_run").result.scene
    found = []
    for number, (side, part) in enumerate(((1024, 512), (300, 200), (160, 333))):
        parameters = replace(ENGINE, fusion=replace(ENGINE.fusion, hole_block_cells=side, block_cells=part))
        path = str(tmp_path / f"{number}.tif")
        run_stage("dsmfuse", {"scene": scene, "resolution": cell, "output": path}, told(), parameters)
        found.append(bands(path)[0][0])
    assert np.isfinite(found[0]).mean() > 0.5
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


@pytest.mark.parametrize("kind", ("urban", "mountains"))
@pytest.mark.slow
def test_heights_do_not_depend_on_what_lies_far_away(request, tmp_path, told, monkeypatch, kind):
    """The same height maps, of which three EXTENTs are fused: farther than 50 m from their borders, the same bytes."""
    scene, laid_out = request.getfixturevalue(f"{kind}_run").result.scene, DsmLayout.of
    found = {}
    for cut in (0, 40, 74):  # cells of 0.5 m

        def part(*arguments, cut=cut):
            layout = laid_out(*arguments)
            inner = Window(cut, cut, layout.grid.size[0] - 2 * cut, layout.grid.size[1] - 2 * cut)
            windows = [window.common(inner).within(inner) for window in layout.windows]
            return replace(layout, grid=layout.grid.part(inner), windows=tuple(windows))

        monkeypatch.setattr(DsmLayout, "of", part)
        path = str(tmp_path / f"{cut}.tif")
        run_stage("dsmfuse", {"scene": scene, "resolution": 0.5, "output": path}, told())
        found[cut] = (bands(path)[0][0], *corner(path))
    whole, west, north = found[0]
    for cut in (40, 74):
        small, inner_west, inner_north = found[cut]
        row, column = round((north - inner_north) / 0.5), round((inner_west - west) / 0.5)
        same = whole[row : row + small.shape[0], column : column + small.shape[1]]
        far = np.s_[100:-100, 100:-100]
        assert small[far].size > 10_000 and np.isfinite(small[far]).mean() > 0.9
        np.testing.assert_array_equal(small[far], same[far])
        assert not np.array_equal(small, same)  # what lies beyond the border has a part in what lies beside it


@pytest.mark.long
def test_without_its_images_a_scene_is_fused_and_that_is_said(fused, urban_run, tmp_path):
    scene = Scene.load(urban_run.result.scene)
    views = tuple(replace(view, image=str(tmp_path / f"gone_{view.name}.tif")) for view in scene.views)
    moved = replace(scene, views=views).save(str(Path(urban_run.result.scene).with_name("moved.json")))
    dsm, _, _, log = fused("moved", scene=moved)
    assert np.isfinite(dsm).mean() > 0.5
    assert any(f"{len(views)} images of the scene cannot be found" in line for line in log.notes)
