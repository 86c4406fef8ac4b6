"""The whole way on simulated scenes, against their true surface; and the same result by every other way."""

from __future__ import annotations

import json
import os
from pathlib import Path

import laspy
import numpy as np
import pytest
from osgeo import gdal, ogr

from repm_qgis.contracts.errors import OptionError
from repm_qgis.contracts.options import PipelineOptions
from repm_qgis.geometry.frames import projected_from_geodetic
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from tests.engine.rasters import bands


def compared(path, truth, told):
    return run_stage("comparedsm", {"dsm": path, "reference": truth, "align": "3d"}, told())


@pytest.mark.parametrize(
    "kind, nmad, within_1, within_5, valid",
    (
        # Measured: urban 0.36 m, 82.9 %, 93.5 %, 99.4 %; mountains (1 m px) 0.56 m, 91.0 %, 100.0 %, 100.0 %.
        ("urban", 0.42, 80.0, 91.0, 97.0),
        ("mountains", 0.65, 89.0, 99.0, 99.0),
    ),
)
def test_accuracy_against_the_true_surface(request, told, capsys, kind, nmad, within_1, within_5, valid):
    run = request.getfixturevalue(f"{kind}_run")
    found = compared(run.result.output, run.scene.truth, told)
    share = found.completeness_by_threshold
    with capsys.disabled():
        print(
            f"\n{kind}: NMAD {found.nmad:.3f} m, within 1 m {share['1']:.1f} %, 5 m {share['5']:.1f} %, valid "
            f"{found.valid:.2f} %, moved by {found.dx:.2f}, {found.dy:.2f}, {found.dz:.2f} m"
        )
    assert found.nmad < nmad and share["1"] > within_1 and share["5"] > within_5 and found.valid > valid
    # What alignment took out is the pointing error that all views share: a few px.
    assert np.hypot(found.dx, found.dy) < 4 and abs(found.dz) < 8


def test_tiles_do_not_show(urban, urban_run, mountains_run, told):
    """Along the borders of the four tiles heights are as good as anywhere."""
    (height,), transform = bands(urban_run.result.output)
    scene = Scene.load(urban_run.result.scene)
    assert len(scene.tiles) >= 4
    found = compared(urban_run.result.output, urban.truth, told)
    west, cell, _, north, _, _ = transform
    truth_west, truth_cell, _, truth_north, _, _ = urban.transform
    rows, cols = np.indices(height.shape)
    x = west + (cols + 0.5) * cell + found.dx
    y = north - (rows + 0.5) * cell + found.dy
    tc, tr = ((x - truth_west) / truth_cell).astype(int), ((truth_north - y) / truth_cell).astype(int)
    inside = (tc >= 0) & (tr >= 0) & (tc < urban.surface.shape[1]) & (tr < urban.surface.shape[0])
    error = np.where(
        inside, height + found.dz - urban.surface[np.where(inside, tr, 0), np.where(inside, tc, 0)], np.nan
    )
    near = np.zeros(height.shape, bool)
    for tile in scene.tiles:
        for edge in (tile.bounds[0], tile.bounds[2]):
            near |= np.abs(x - found.dx - edge) < 2.5
        for edge in (tile.bounds[1], tile.bounds[3]):
            near |= np.abs(y - found.dy - edge) < 2.5
    near &= inside
    assert near.sum() > 500
    good = [(np.abs(error[part]) < 1).mean() for part in (near, inside & ~near)]
    assert good[0] > good[1] - 0.1
    assert np.isfinite(error[near]).mean() > np.isfinite(error[inside & ~near]).mean() - 0.05
    # Nor is there a step: neighbouring cells differ across a border as they do 5 to 15 m beside it.
    for axis, ends, place in ((1, (0, 2), x - found.dx), (0, (1, 3), y - found.dy)):
        steps = np.abs(np.diff(height, axis=axis))
        middle = (place[:, 1:] + place[:, :-1]) / 2 if axis else (place[1:] + place[:-1]) / 2
        across, beside = np.zeros(steps.shape, bool), np.zeros(steps.shape, bool)
        shared = set.intersection(*({tile.bounds[end] for tile in scene.tiles} for end in ends))
        for edge in shared:
            across |= np.abs(middle - edge) < 0.75 * cell
            beside |= (np.abs(middle - edge) > 5) & (np.abs(middle - edge) < 15)
        assert shared and np.nanmedian(steps[across]) < 1.2 * np.nanmedian(steps[beside]), (axis, shared)


def test_products_lie_on_each_other(urban_run):
    result = urban_run.result
    (height,), transform = bands(result.output)
    (count, spread, score, filled, error, le90), other = bands(result.confidence)
    (ortho,), third = bands(result.ortho)
    assert transform == other == third and height.shape == count.shape == ortho.shape
    known = np.isfinite(height)
    counted = np.isfinite(count)
    assert not (counted & ~known).any() and set(np.unique(count[counted])) <= {1.0, 2.0, 3.0}
    # What no map has matched is filled, and marked so.
    assert (filled[known & ~counted] > 0).all() and counted[known].mean() > 0.8
    assert np.isfinite(spread[known & (count > 1)]).all() and np.isnan(spread[count == 1]).all()
    assert np.nanmin(score) >= 0 and np.nanmax(score) <= 1
    assert (error[known] > 0.05).all() and np.isnan(error[~known]).all()
    assert (le90[known] > error[known]).all() and np.isnan(le90[~known]).all()
    assert np.isfinite(ortho[known]).mean() > 0.95 and np.isnan(ortho[~known]).all()
    assert result.valid == known.sum()
    assert not [name for name in os.listdir(os.path.dirname(result.output)) if ".part" in name]


def test_the_dsm_says_what_it_is(urban_run, urban):
    dataset = gdal.Open(urban_run.result.output)
    assert dataset.GetSpatialRef().GetAuthorityCode(None) == urban.crs.split(":")[1]
    assert "ellipsoid" in dataset.GetRasterBand(1).GetDescription() and dataset.GetRasterBand(1).GetUnitType() == "m"
    assert "ellipsoid" in dataset.GetMetadataItem("VERTICAL_DATUM") and dataset.GetMetadataItem("REPM_ENGINE")
    assert dataset.GetGeoTransform()[0] % 0.5 == 0 and dataset.GetGeoTransform()[1] == 0.5
    stated = Scene.load(urban_run.result.scene).pointing.height_uncertainty_m / 2
    assert stated > 1 and float(dataset.GetMetadataItem("REPM_HEIGHT_DEVIATION")) == pytest.approx(stated, abs=1e-3)
    dataset = None


def test_the_cloud_lies_on_the_dsm(urban_run):
    (height,), (west, cell, _, north, _, _) = bands(urban_run.result.output)
    with laspy.open(urban_run.result.cloud) as reader:
        points = reader.read()
    assert len(points.x) == urban_run.result.points > 50000
    cols = np.floor((np.asarray(points.x) - west) / cell).astype(int)
    rows = np.floor((north - np.asarray(points.y)) / cell).astype(int)
    inside = (cols >= 0) & (rows >= 0) & (cols < height.shape[1]) & (rows < height.shape[0])
    assert inside.mean() > 0.99
    difference = np.asarray(points.z)[inside] - height[rows[inside], cols[inside]]
    assert np.isfinite(difference).mean() > 0.99
    assert abs(np.nanmedian(difference)) < 0.1 and np.nanpercentile(np.abs(difference), 99) < 5


def test_the_ept_has_the_clouds_points_and_the_mesh_the_dsms_heights(urban_run):
    def points(paths):
        rows = np.vstack([np.column_stack([part.x, part.y, part.z]) for part in map(laspy.read, paths)])
        return rows[np.lexsort(rows.T)]

    folder = Path(urban_run.result.ept)
    ours, theirs = points(sorted(folder.glob("ept-data/*.laz"))), points([urban_run.result.cloud])
    assert ours.shape == theirs.shape and np.abs(ours - theirs).max() < 1e-6
    assert json.loads((folder / "ept.json").read_text())["points"] == urban_run.result.points
    assert (folder / "ept.qml").exists() and Path(urban_run.result.mesh).with_suffix(".qml").exists()

    (height,), (west, cell, _, north, _, _) = bands(urban_run.result.output)
    rows, cols = np.nonzero(np.isfinite(height))
    head, body = Path(urban_run.result.mesh).read_bytes().split(b"end_header\n", 1)
    assert b"element vertex %d\n" % len(rows) in head
    np.testing.assert_array_equal(
        np.frombuffer(body, "<f8", 3 * len(rows)).reshape(-1, 3),
        np.column_stack([west + (cols + 0.5) * cell, north - (rows + 0.5) * cell, height[rows, cols]]),
    )


@pytest.mark.long
def test_an_ept_comes_without_a_cloud_too(urban_run, tmp_path, told):
    said = told()
    fused = run_stage(
        "dsmfuse",
        {
            "scene": urban_run.result.scene,
            "output": str(tmp_path / "dsm.tif"),
            "resolution": 1.0,
            "ept": str(tmp_path / "ept"),
            "mesh": str(tmp_path / "m.ply"),
            "mesh_vertices": 2000,
            "vertical_datum": "",
            "workers": 1,
        },
        said,
    )
    assert fused.cloud is None and fused.ept == str(tmp_path / "ept")
    assert json.loads((tmp_path / "ept" / "ept.json").read_text())["points"] == fused.points > 10000
    assert any("cells (MESH_VERTICES)" in note for note in said.notes)
    assert not list(tmp_path.rglob("*.laz.*")) and not list(urban_run.workspace.glob(".fusion*"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dsm.qml", "dsm.tif", "ept", "m.ply", "m.qml"]


@pytest.mark.slow
@pytest.mark.long
def test_a_cloud_as_ply_with_normals_comes_with_an_ept(urban_run, tmp_path, told):
    files = {"output": str(tmp_path / "d.tif"), "cloud": str(tmp_path / "c.ply"), "ept": str(tmp_path / "e")}
    wanted = {"scene": urban_run.result.scene, "resolution": 0.5, "cloud_normals": True, "workers": 1, **files}
    fused = run_stage("dsmfuse", wanted, told())
    assert Path(fused.output).read_bytes() == Path(urban_run.result.output).read_bytes()
    assert json.loads((tmp_path / "e" / "ept.json").read_text())["points"] == fused.points
    head, body = (tmp_path / "c.ply").read_bytes().split(b"end_header\n", 1)
    assert b"element vertex %d\n" % fused.points in head
    names = ["nx", "ny", "nz", "score"]
    points = np.frombuffer(body, [("xyz", "<f8", 3), *((name, "<f4") for name in names)])
    las = laspy.read(urban_run.result.cloud)
    assert np.abs(points["xyz"] - las.xyz).max() < 0.00051 and (points["score"] > 0).mean() > 0.99
    assert np.allclose(points["nx"] ** 2 + points["ny"] ** 2 + points["nz"] ** 2, 1, atol=1e-5)
    assert np.median(points["nz"]) > 0.95 and 0.002 < (points["nz"] == 0).mean() < 0.2  # level ground, and walls
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.ply", "d.qml", "d.tif", "e"]


def test_the_orthophoto_shows_the_true_brightness_where_it_lies(urban_run, urban):
    """Each cell's brightness is that of the nearest pixel of one of the views that see it there."""
    (height,), (west, cell, _, north, _, _) = bands(urban_run.result.output)
    (ortho,), _ = bands(urban_run.result.ortho)
    scene = Scene.load(urban_run.result.scene)
    rows, cols = np.nonzero(np.isfinite(ortho))
    pick = np.random.default_rng(0).permutation(len(rows))[:3000]
    rows, cols = rows[pick], cols[pick]
    from repm_qgis.geometry.frames import geodetic_from_projected

    lon_lat = geodetic_from_projected(
        urban.crs, np.column_stack([west + (cols + 0.5) * cell, north - (rows + 0.5) * cell])
    )
    ground = np.column_stack([lon_lat, height[rows, cols]])
    best = np.full(len(rows), np.inf)
    for view in scene.views:
        dataset = gdal.Open(view.image)
        image = dataset.ReadAsArray().astype(float)
        dataset = None
        pixel = view.project(ground)
        c, r = np.rint(pixel).astype(int).T
        inside = (c >= 1) & (r >= 1) & (c < 399) & (r < 399)
        around = np.stack(
            [image[np.clip(r + dr, 0, 399), np.clip(c + dc, 0, 399)] for dr in (-1, 0, 1) for dc in (-1, 0, 1)]
        )
        value = ortho[rows, cols]
        off = np.maximum(np.maximum(around.min(axis=0) - value, value - around.max(axis=0)), 0)
        best = np.minimum(best, np.where(inside, off, np.inf))
    assert (best < 1.0).mean() > 0.97


def test_layers_and_numbers(urban_run):
    result = urban_run.result
    source = ogr.Open(result.tie_points)
    assert source.GetLayer(0).GetFeatureCount() == result.n_tie_points > 100
    heights = [feature["height"] for feature in source.GetLayer(0)]
    residuals = [feature["residual"] for feature in source.GetLayer(0)]
    source = None
    low, high = urban_run.scene.height_range
    assert low - 8 < np.percentile(heights, 1) and np.percentile(heights, 99) < high + 8
    assert np.median(residuals) < 0.25
    source = ogr.Open(result.tiles)
    layer = source.GetLayer(0)
    assert layer.GetFeatureCount() >= 4
    assert max(feature["worst_max"] for feature in layer) == pytest.approx(result.max_error, rel=1e-6)
    layer = source = None
    assert result.rmse <= result.max_error < 5
    assert os.path.getsize(result.report) > 2000 and set(result.seconds) == {
        "epmfit",
        "refine",
        "reconstruct",
        "dsmfuse",
    }
    assert json.dumps(result.to_mapping(), allow_nan=False)


def test_progress_rises_to_the_end_and_names_what_it_does(urban_run):
    fractions = urban_run.said.fractions
    assert fractions == sorted(fractions) and fractions[-1] == 1.0 and len(fractions) > 12
    assert urban_run.said.checks > 10


def test_ties_are_where_the_true_surface_is(mountains_run):
    """Heights of tie points against the true DSM, but for the shift that all views share."""
    scene = mountains_run.scene
    source = ogr.Open(mountains_run.result.tie_points)
    ties = np.array([[f.geometry().GetX(), f.geometry().GetY(), f["height"]] for f in source.GetLayer(0)])
    source = None
    x, cell, _, y, _, _ = scene.transform
    cols, rows = ((ties[:, 0] - x) / cell).astype(int), ((y - ties[:, 1]) / cell).astype(int)
    inside = (cols > 0) & (rows > 0) & (cols < scene.surface.shape[1]) & (rows < scene.surface.shape[0])
    error = ties[inside, 2] - scene.surface[rows[inside], cols[inside]]
    assert inside.sum() > 100 and 1.4826 * np.median(np.abs(error - np.median(error))) < 1.7


@pytest.mark.slow
def test_stages_one_by_one_give_the_same_dsm(urban, urban_run, tmp_path, told):
    fitted = run_stage("epmfit", {"images": urban.images, "workspace": str(tmp_path), "tile_size": 256}, told())
    refined = run_stage(
        "refine",
        {"scene": fitted.scene, "output_scene": str(tmp_path / "refined.json"), "write_images": False},
        told(),
    )
    done = run_stage(
        "reconstruct",
        {"scene": refined.output_scene, "output_scene": str(tmp_path / "done.json"), "workers": 1},
        told(),
    )
    fused = run_stage(
        "dsmfuse",
        {"scene": done.output_scene, "output": str(tmp_path / "dsm.tif"), "resolution": 0.5, "workers": 1},
        told(),
    )
    ours, theirs = bands(fused.output), bands(urban_run.result.output)
    assert ours[1] == theirs[1]
    np.testing.assert_array_equal(ours[0], theirs[0])


@pytest.mark.long
@pytest.mark.parametrize("workers", (2, 4))
def test_more_workers_give_the_same_dsm(urban, urban_run, tmp_path, told, workers):
    result = run_stage(
        "pipeline",
        {
            **urban_run.options,
            "workspace": str(tmp_path / "ws"),
            "workers": workers,
            **{
                name: str(tmp_path / f"{name}{end}")
                for name, end in (
                    ("output", ".tif"),
                    ("confidence", ".tif"),
                    ("ortho", "_o.tif"),
                    ("cloud", ".laz"),
                    ("ept", ""),
                    ("mesh", ".ply"),
                )
            },
        },
        told(),
    )
    for name in ("output", "confidence", "ortho"):
        ours, theirs = bands(getattr(result, name)), bands(getattr(urban_run.result, name))
        assert ours[1] == theirs[1]
        np.testing.assert_array_equal(ours[0], theirs[0])
    a, b = (laspy.read(r.cloud) for r in (result, urban_run.result))
    np.testing.assert_array_equal(a.xyz, b.xyz)
    assert Path(result.mesh).read_bytes() == Path(urban_run.result.mesh).read_bytes()
    for path in Path(urban_run.result.ept).rglob("*.*"):
        assert path.read_bytes() == (Path(result.ept) / path.relative_to(urban_run.result.ept)).read_bytes()


def test_an_extent_cuts_the_dsm(urban, tmp_path, told):
    x0, y0, x1, y1 = urban.bounds
    extent = [np.floor(x0 + 40), np.floor(y0 + 40), np.floor(x0 + 100), np.floor(y0 + 90)]
    result = run_stage(
        "pipeline",
        {
            "images": urban.images[:2],
            "workspace": str(tmp_path / "ws"),
            "workers": 1,
            "output": str(tmp_path / "dsm.tif"),
            "resolution": 0.5,
            "extent": extent,
            "extent_crs": urban.crs,
        },
        told(),
    )
    (height,), (west, cell, _, north, _, _) = bands(result.output)
    assert west >= extent[0] - 1 and north <= extent[3] + 1
    assert west + height.shape[1] * cell <= extent[2] + 1 and north - height.shape[0] * cell >= extent[1] - 1
    found = compared(result.output, urban.truth, told)
    assert found.nmad < 1.0


@pytest.mark.parametrize("crs", ("EPSG:32630", "EPSG:2154"))
@pytest.mark.long
def test_another_crs_has_no_seams_and_the_same_heights(urban, urban_run, tmp_path, told, crs):
    """Tiles are turned in another CRS, and their boxes overlap: no cell may be lost to a neighbour's empty corner."""
    fused = run_stage(
        "dsmfuse",
        {
            "scene": urban_run.result.scene,
            "output": str(tmp_path / "dsm.tif"),
            "crs": crs,
            "resolution": 0.5,
            "workers": 1,
        },
        told(),
    )
    (height,), (west, cell, _, north, _, _) = bands(fused.output)
    (own,), (own_west, _, _, own_north, _, _) = bands(urban_run.result.output)
    from repm_qgis.geometry.frames import geodetic_from_projected

    rows, cols = np.indices(own.shape)
    xy = np.stack([own_west + (cols + 0.5) * cell, own_north - (rows + 0.5) * cell], axis=-1)
    x, y = np.moveaxis(projected_from_geodetic(crs, geodetic_from_projected(urban.crs, xy)), -1, 0)
    c, r = np.floor((x - west) / cell).astype(int), np.floor((north - y) / cell).astype(int)
    inside = (c >= 0) & (r >= 0) & (c < height.shape[1]) & (r < height.shape[0])
    other = np.where(inside, height[np.where(inside, r, 0), np.where(inside, c, 0)], np.nan)
    known = np.isfinite(own)
    lost = known & ~np.isfinite(other)
    assert lost.sum() / known.sum() < 0.03
    # Where cells of the own CRS are surely inside (all neighbours known), hardly one may be missing.
    core = known.copy()
    for axis in (0, 1):
        for step in (-2, -1, 1, 2):
            core &= np.roll(known, step, axis)
    assert (lost & core).sum() / core.sum() < 0.005
    assert np.nanmedian(np.abs(other - own)) < 0.15
    # Cells within a millimetre of a border belong to both tiles.
    assert fused.valid == pytest.approx(np.isfinite(height).sum(), abs=20)


@pytest.mark.slow
def test_heights_above_a_geoid_differ_by_projs_undulation_at_every_cell(urban_run, tmp_path, told):
    import pyproj
    from pyproj.transformer import TransformerGroup

    if not TransformerGroup("EPSG:4979", "EPSG:4326+5773", always_xy=True, allow_ballpark=False).transformers:
        pytest.skip("PROJ's EGM96 grid is not installed")
    scene, said = Scene.load(urban_run.result.scene), told()
    fused = run_stage(
        "dsmfuse",
        {
            "scene": urban_run.result.scene,
            "output": str(tmp_path / "dsm.tif"),
            "resolution": 0.5,
            "cloud": str(tmp_path / "c.laz"),
            "vertical_datum": "EGM96",
        },
        said,
    )
    (ellipsoidal,), transform = bands(urban_run.result.output)
    (geoid,), same = bands(str(tmp_path / "dsm.tif"))
    assert same == transform and np.array_equal(np.isnan(ellipsoidal), np.isnan(geoid))
    rows, cols = np.indices(geoid.shape)
    x, y = transform[0] + (cols + 0.5) * transform[1], transform[3] + (rows + 0.5) * transform[5]
    lon, lat = pyproj.Transformer.from_crs(scene.crs, 4326, always_xy=True).transform(x, y)
    undulation = -pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4326+5773", always_xy=True).transform(
        lon, lat, np.zeros(lon.shape)
    )[2]
    known = np.isfinite(geoid)
    assert np.abs(ellipsoidal - geoid - undulation)[known].max() < 0.01 and np.abs(undulation).min() > 1
    # Said in the file's CRS, the log and the result; and the cloud lies on the same surface.
    dataset = gdal.Open(str(tmp_path / "dsm.tif"))
    crs = pyproj.CRS.from_wkt(dataset.GetSpatialRef().ExportToWkt(["FORMAT=WKT2_2018"]))
    assert crs.sub_crs_list[1].name == "EGM96 height" and dataset.GetMetadataItem("VERTICAL_DATUM") == "EGM96 height"
    dataset = None
    assert any("EGM96 height" in note for note in said.notes) and fused.vertical_datum == "EGM96 height"
    old, new = laspy.read(urban_run.result.cloud), laspy.read(str(tmp_path / "c.laz"))
    assert len(old) == len(new)
    assert np.abs(old.z - new.z - undulation[known].mean()).max() < 0.02
    assert "EGM96" in new.header.parse_crs().to_wkt()


def test_a_missing_geoid_stops_the_run_before_the_work(urban, tmp_path, told):
    from pyproj.transformer import TransformerGroup

    from repm_qgis.contracts.errors import MissingPackageError

    if TransformerGroup("EPSG:4979", "EPSG:4326+3855", always_xy=True, allow_ballpark=False).transformers:
        pytest.skip("PROJ's EGM2008 grid is installed here")
    said = told()
    with pytest.raises(MissingPackageError, match="us_nga_egm08_25"):
        run_stage(
            "pipeline",
            {
                "images": urban.images,
                "workspace": str(tmp_path / "ws"),
                "vertical_datum": "EGM2008",
                "output": str(tmp_path / "dsm.tif"),
            },
            said,
        )
    assert not said.fractions and not (tmp_path / "dsm.tif").exists()  # before the first step


@pytest.mark.parametrize(
    "wrong, words",
    (
        ({"adjustment": "colmap", "pointing": "affine"}, "POINTING is 'affine': it must be auto or shift"),
        ({"adjustment": "colmap", "pointing": "jitter"}, "POINTING is 'jitter': it must be auto or shift"),
        ({"adjustment": "colmap", "gcps": "points.csv"}, "ADJUSTMENT is 'colmap': it must be rpc where there are GCPS"),
        ({"adjustment": "ceres"}, "ADJUSTMENT is 'ceres'"),
        ({"pointing": "bent"}, "POINTING is 'bent'"),
    ),
)
def test_adjustments_that_cannot_be_fail_at_once(wrong, words):
    files = {"images": ["a.tif", "b.tif"], "workspace": "w", "output": "dsm.tif"}
    with pytest.raises(OptionError) as caught:
        PipelineOptions.from_json({**files, **wrong})
    text = str(caught.value)
    assert words in text and text.endswith(".") and "\n" not in text
    made = PipelineOptions.from_json({**files, "adjustment": "colmap", "pointing": "shift"})
    assert made.reconstruct.adjustment == "colmap" and made.reconstruct.gcps is None


def test_the_pipeline_hands_the_adjustment_on(urban, told, tmp_path, monkeypatch):
    from repm_qgis.stages import pipeline

    class Enough(Exception):
        pass

    def stopped(options, progress, parameters):
        raise Enough(options.adjustment, options.pointing)

    monkeypatch.setattr(pipeline.reconstruct, "run", stopped)
    with pytest.raises(Enough) as caught:
        run_stage(
            "pipeline",
            {
                "images": list(urban.images),
                "workspace": str(tmp_path / "w"),
                "pointing": "shift",
                "output": str(tmp_path / "dsm.tif"),
                "adjustment": "colmap",
            },
            told(),
        )
    assert caught.value.args == ("colmap", "shift")


@pytest.mark.slow
def test_holes_are_filled_on_the_scenes_dem_and_said(urban, tmp_path, pipeline):
    """FILL=all with a DEM: no hole is left inside, the fourth band tells them, and they lie on the DEM's surface."""
    dem = str(tmp_path / "dem.tif")
    gdal.Warp(dem, urban.truth, xRes=20, yRes=20, resampleAlg="average")
    run = pipeline(urban, tmp_path, images=urban.images[:2], dem=dem, fill="all", resolution=0.5, workers=1)
    (height,), transform = bands(run.result.output)
    source = bands(run.result.confidence)[0][3]
    on_dem = source == 3
    assert on_dem.sum() > 50 and run.result.interpolated == np.isin(source, (2, 3)).sum()
    assert np.isfinite(height[on_dem]).all() and np.isnan(source[np.isnan(height)]).all()
    west, cell, _, north, _, _ = transform
    rows, columns = height.shape
    coarse = gdal.Warp(
        "",
        dem,
        format="MEM",
        outputBounds=(west, north - rows * cell, west + columns * cell, north),
        width=columns,
        height=rows,
        resampleAlg="bilinear",
    ).ReadAsArray()
    covered = on_dem & (coarse > -9000)
    assert covered.sum() > 50 and np.median(np.abs(height - coarse)[covered]) < 6  # a DEM of 20 m cells has no walls
