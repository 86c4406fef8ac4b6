"""COLMAP's adjustment of principal points: the same shifts as against the RPCs, and the same DSM."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import EmptyResultError, MissingPackageError, OptionError
from repm_qgis.contracts.options import ReconstructOptions
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.pointing.adjustment import adjust
from repm_qgis.pointing.colmap_adjustment import adjust_colmap
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.ties.tracks import Track
from tests.engine.versions import needs_pycolmap_4

pytest.importorskip("pycolmap")


def true_tracks(truth, count=240, noise=0.05, outliers=0.0):
    """Points of the true surface where the true sensors see them; every other one in two views only."""
    numbers = np.random.default_rng(4)
    rows, cols = (numbers.integers(10, n - 10, count) for n in truth.surface.shape)
    x, cell, _, y, _, _ = truth.transform
    lon_lat = geodetic_from_projected(truth.crs, np.column_stack([x + (cols + 0.5) * cell, y - (rows + 0.5) * cell]))
    tracks = []
    for number, point in enumerate(np.column_stack([lon_lat, truth.surface[rows, cols]])):
        pixels = {view.name: view.rpc.project(point) + numbers.normal(0, noise, 2) for view in truth.true_views}
        if number % 2:
            pixels.pop(truth.views[number // 2 % 3].name)
        if numbers.uniform() < outliers:
            name = sorted(pixels)[number % len(pixels)]
            pixels[name] = pixels[name] + numbers.uniform(-30, 30, 2)
        tracks.append(Track(pixels))
    return tracks


@pytest.fixture(scope="module", params=("urban", "mountains"))
def fitted(request, tmp_path_factory, told):
    truth = request.getfixturevalue(request.param)
    made = run_stage("epmfit", {"images": truth.images, "workspace": str(tmp_path_factory.mktemp("colmap"))}, told())
    return truth, Scene.load(made.scene)


@needs_pycolmap_4
@pytest.mark.parametrize("outliers", (0.0, 0.2))
@pytest.mark.long
def test_the_shifts_are_those_against_the_rpcs(fitted, told, outliers):
    truth, scene = fitted
    tracks = true_tracks(truth, outliers=outliers)
    ours, theirs = adjust(truth.views, tracks, 500.0), adjust_colmap(scene, tracks, told())
    assert max(np.abs(shift).max() for shift in ours.shifts.values()) > 0.2
    for name, shift in ours.shifts.items():
        np.testing.assert_allclose(theirs.shifts[name], shift, atol=0.02)
    assert np.median(theirs.residual_px) < 0.06 and np.median(theirs.before_px) > 0.2
    assert "COLMAP" in theirs.reason and theirs.model == "shift"


@needs_pycolmap_4
def test_no_view_is_the_truth(fitted, told):
    truth, scene = fitted
    found = adjust_colmap(scene, true_tracks(truth), told())
    assert np.abs(sum(found.shifts.values())).max() < 0.03
    for pointing in found.pointing.values():
        np.testing.assert_array_equal(pointing[:, :2], np.eye(2))


@needs_pycolmap_4
def test_errors_of_many_pixels_are_found_in_several_patches(fitted, told):
    """Tiles of a quarter of the scene: four patches and more, whose shifts are joined."""
    truth, scene = fitted
    errors = {view.name: np.array(error) for view, error in zip(scene.views, ((15, -9), (-12, 14), (3, -12)))}
    tracks = [
        Track({name: pixel + errors[name] for name, pixel in track.pixels.items()}) for track in true_tracks(truth)
    ]
    whole = scene.tiles[0].bounds
    small = (whole[0], whole[1], (whole[0] + whole[2]) / 2, (whole[1] + whole[3]) / 2)
    tiled = Scene(**{**vars(scene), "tiles": [scene.tiles[0].__class__(**{**vars(scene.tiles[0]), "bounds": small})]})
    ours, theirs = adjust(truth.views, tracks, 500.0), adjust_colmap(tiled, tracks, told())
    assert int(theirs.reason.split(" in ")[1].split()[0]) >= 4
    for name, shift in ours.shifts.items():
        np.testing.assert_allclose(theirs.shifts[name], shift, atol=0.03)


@needs_pycolmap_4
def test_the_present_pointing_does_not_matter(fitted, told):
    truth, scene = fitted
    tracks = true_tracks(truth, 60)
    moved = Scene(
        **{**vars(scene), "views": [view.with_pointing(np.array([[1, 0, 7.0], [0, 1, -5.0]])) for view in scene.views]}
    )
    plain, after = (adjust_colmap(s, tracks, told()).shifts for s in (scene, moved))
    for name in plain:
        np.testing.assert_array_equal(plain[name], after[name])


@needs_pycolmap_4
def test_too_few_ties(fitted, told):
    truth, scene = fitted
    with pytest.raises(EmptyResultError, match="ADJUSTMENT rpc"):
        adjust_colmap(scene, true_tracks(truth, 5), told())


def test_without_pycolmap_the_error_says_what_to_do(fitted, told, monkeypatch):
    truth, scene = fitted
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(MissingPackageError, match="choose rpc"):
        adjust_colmap(scene, true_tracks(truth, 20), told())


def test_what_it_cannot_do_is_said_before_the_work():
    for more, word in (
        ({"pointing": "affine"}, "principal points only"),
        ({"gcps": "g.csv"}, "must be rpc"),
        ({"adjustment": "ceres"}, "rpc, colmap"),
    ):
        with pytest.raises(OptionError, match=word):
            ReconstructOptions(**{"scene": "s", "output_scene": "o", "adjustment": "colmap", **more})


@needs_pycolmap_4
@pytest.mark.slow
def test_both_routes_make_the_same_dsm(urban, tmp_path, told):
    made = run_stage("epmfit", {"images": urban.images, "workspace": str(tmp_path)}, told())
    heights = []
    for route in ("rpc", "colmap"):
        out = run_stage(
            "reconstruct",
            {
                "scene": made.scene,
                "output_scene": str(tmp_path / route / "r.json"),
                "pointing": "shift",
                "adjustment": route,
            },
            told(),
        )
        dsm = run_stage(
            "dsmfuse",
            {"scene": out.output_scene, "output": str(tmp_path / f"{route}.tif"), "resolution": 0.5},
            told(),
        ).output
        box = urban.bounds
        warped = (
            gdal.Warp("", dsm, format="MEM", outputBounds=box, xRes=0.5, yRes=0.5, resampleAlg="near", dstNodata=-9999)
            .ReadAsArray()
            .astype(np.float64)
        )
        heights.append(np.where(warped < -9000, np.nan, warped))
    apart = heights[0] - heights[1]
    assert np.isfinite(apart).mean() > 0.7
    # Both see the same ties; shifts differ by thousandths of a px. Bar: 0.05 m.
    assert abs(np.nanmedian(apart)) < 0.02 and np.nanmedian(np.abs(apart)) < 0.05
