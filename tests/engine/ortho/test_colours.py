"""Colours: balanced, without seams where views differ, sharpened their mean kept, true to the place."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from benchmarks.colour_scene import RATIO, WEIGHTS
from repm_qgis.contracts.errors import ImageError, OptionError, OverlapError, RpcMissingError
from repm_qgis.ortho.colour_balance import balanced
from repm_qgis.ortho.colour_sources import multispectral_beside
from repm_qgis.ortho.pansharpening import Multispectral, brovey, fitted
from repm_qgis.ortho.view_choice import chosen_views, feathered_colours
from repm_qgis.scene import Scene, load_views
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE


def fused(town, folder, told, parameters=ENGINE, **options):
    """Results of the fusion in colour, and what it said."""
    said = told()
    options = {
        "scene": town["scene"],
        "output": str(folder / "dsm.tif"),
        "ortho": str(folder / "ortho.tif"),
        "resolution": 0.5,
        "xs": town["xs"],
        **options,
    }
    return run_stage("dsmfuse", options, said, parameters), said


@pytest.fixture(scope="module")
def sharp(town, tmp_path_factory, told):
    folder = tmp_path_factory.mktemp("sharp")
    more = {"cloud": str(folder / "c.laz"), "ept": str(folder / "ept"), "mesh": str(folder / "m.ply")}
    return fused(town, folder, told, colour="all", **more)


def pixels(path):
    return gdal.Open(path).ReadAsArray()


# --- balance ---


def test_gains_and_offsets_are_found_again():
    """Three dates of one town, of which each sees a part; a tenth of the places has changed."""
    rng = np.random.default_rng(1)
    ground = rng.gamma(3.0, 40.0, (5000, 1)).astype(np.float32)
    gains, offsets = np.array([1.0, 1.3, 0.8]), np.array([0.0, -20.0, 15.0])
    seen = ground * gains + offsets + rng.normal(0, 3, (5000, 3))
    seen = np.where(rng.random(seen.shape) < 0.1, rng.permutation(seen), seen)
    seen[:2000, 0], seen[3500:, 2] = np.nan, np.nan
    found_gains, found_offsets = balanced(seen[..., None].astype(np.float32))
    alike = seen * found_gains[:, 0] + found_offsets[:, 0]
    assert found_gains.mean() == pytest.approx(1.0, abs=1e-3)
    for first, second in ((0, 1), (1, 2), (0, 2)):
        both = np.isfinite(alike[:, first] + alike[:, second])
        quantiles = (np.quantile(alike[both, view], (0.1, 0.5, 0.9)) for view in (first, second))
        np.testing.assert_allclose(*quantiles, atol=3.0)
    np.testing.assert_allclose(found_gains[:, 0] * gains / (found_gains[0, 0] * gains[0]), 1.0, atol=0.04)


def test_views_without_a_common_place_stay_as_they_are():
    samples = np.full((100, 2, 1), np.nan, np.float32)
    samples[:50, 0], samples[50:, 1] = 10.0, 90.0
    gains, offsets = balanced(samples)
    np.testing.assert_allclose(gains, 1.0)
    np.testing.assert_allclose(offsets, 0.0, atol=1e-9)


# --- choice of views ---


def test_the_most_vertical_view_is_taken_but_for_its_cars_and_for_what_it_does_not_see():
    rng = np.random.default_rng(2)
    ground = rng.normal(100, 10, (60, 80)).astype(np.float32)
    colours = np.stack([ground + rng.normal(0, 1, ground.shape) for _ in range(4)])[:, None].astype(np.float32)
    colours[0, 0, 20:28, 30:38] = 180.0  # a lorry
    colours[0, 0, 40:, :20] = np.nan  # behind a house
    colours[:, 0, :3, :3] = np.nan  # what nobody sees
    labels = chosen_views(colours, (0.05, 0.2, 0.3, 0.4), (10.0,))
    assert (labels[:3, :3] == -1).all()
    assert (labels[22:26, 32:36] > 0).all() and (labels[42:, :18] > 0).all()
    assert (labels[5:15, 45:] == 0).mean() > 0.95
    result = feathered_colours(colours, labels, (10.0,))[0]
    assert np.isnan(result[:3, :3]).all() and np.isfinite(result[5:]).all()
    assert np.abs(result - ground)[20:28, 30:38].max() < 12.0


def test_a_seam_runs_where_the_views_agree():
    """Two views, each blind on one side; between them they agree along one column only."""
    ground = np.tile(np.linspace(0, 10, 40, dtype=np.float32), (30, 1))
    colours = np.stack([ground, ground + 20])[:, None]
    colours[1, 0, :, 25] = ground[:, 25]
    colours[1, 0, :, 26] = ground[:, 26]
    colours[0, 0, :, 34:], colours[1, 0, :, :6] = np.nan, np.nan
    labels = chosen_views(colours, (0.1, 0.1), (10.0,))
    seams = np.argmax(labels == 1, axis=1)
    assert set(np.unique(labels)) == {0, 1}
    assert np.isin(seams, (25, 26)).all()


# --- pansharpening ---


def test_brovey_is_that_of_gdal(tmp_path):
    rng = np.random.default_rng(3)
    bands = rng.uniform(200, 900, (3, 16, 16)).astype(np.float32)
    pan = rng.uniform(200, 900, (16, 16)).astype(np.float32)
    weights = (0.5, 0.3, 0.2)
    paths = [str(tmp_path / name) for name in ("pan.tif", "xs.tif")]
    for path, planes in zip(paths, (pan[None], bands)):
        dataset = gdal.GetDriverByName("GTiff").Create(path, 16, 16, len(planes), gdal.GDT_Float32)
        dataset.SetGeoTransform((0, 1, 0, 0, 0, -1))
        dataset.WriteArray(planes if len(planes) > 1 else planes[0])
        dataset = None
    sources = [gdal.Open(path) for path in paths]
    xml = "<VRTDataset subClass='VRTPansharpenedDataset'><PansharpeningOptions><AlgorithmOptions><Weights>"
    xml += f"{','.join(map(str, weights))}</Weights></AlgorithmOptions>"
    xml += "".join(f"<SpectralBand dstBand='{band}'/>" for band in (1, 2, 3)) + "</PansharpeningOptions></VRTDataset>"
    made = gdal.CreatePansharpenedVRT(
        xml, sources[0].GetRasterBand(1), [sources[1].GetRasterBand(b) for b in (1, 2, 3)]
    )
    np.testing.assert_allclose(brovey(bands, pan, weights), made.ReadAsArray(), rtol=1e-5)


@pytest.mark.slow
def test_weights_and_shift_are_measured(town):
    views = Scene.load(town["scene"]).views
    image = load_views((town["xs"][0],))[0]
    own = np.random.default_rng([8, 9]).uniform(-0.35, 0.35, (3, 2))[0]
    found = fitted(Multispectral(views[0], image, (1, 2, 3, 4)), 190.0)
    np.testing.assert_allclose(found.weights, list(WEIGHTS.values()), atol=0.05)
    np.testing.assert_allclose(found.shift, -own, atol=0.15)
    assert found.correlation > 0.9
    ground = views[0].localise(np.array([[200.0, 200.0]]), 190.0)
    assert np.abs(found.project(ground)[0] - 200.0 / RATIO).max() < 1.5


@pytest.mark.long
@pytest.mark.parametrize("moved", (0, 5, 12))
def test_an_xs_that_lies_beside_its_place_is_named(town, tmp_path, told, moved):
    """XS moved by 12 px gave colours of other places, under "Good."."""
    beside = []
    for path in town["xs"]:
        beside.append(str(tmp_path / Path(path).name))
        dataset = gdal.GetDriverByName("GTiff").CreateCopy(beside[-1], gdal.Open(path))
        dataset.WriteArray(np.roll(dataset.ReadAsArray(), moved, axis=-1))
        dataset = None  # noqa: F841
    _, said = fused({**town, "xs": beside}, tmp_path, told, colour="all")
    named = {each.id for each in said.warnings} & {"xs-misplaced", "xs-unlike"}
    assert bool(named) == (moved > 3)


# --- the orthophoto ---


@pytest.mark.long
def test_pansharpening_keeps_the_mean_and_finds_the_true_colours(town, sharp, tmp_path, told):
    result, said = sharp
    plain, _ = fused(town, tmp_path, told, colour="all", pansharpen=False)
    fine, coarse = (pixels(each.ortho).astype(float) for each in (result, plain))
    both = (fine.min(axis=0) > 0) & (coarse.min(axis=0) > 0)
    ratio = fine[:, both].mean(axis=1) / coarse[:, both].mean(axis=1)
    assert np.abs(ratio - 1).max() < 0.02
    truth = gdal.Warp("", town["truth"], format="MEM", outputBounds=bounds(result.ortho), xRes=0.5, yRes=0.5)
    known = truth.ReadAsArray()
    errors = [float(np.median(np.abs(each - known)[:, both])) for each in (fine, coarse)]
    assert errors[0] < 0.75 * errors[1]
    assert any("near infrared from band 4" in text for text in said.notes)


@pytest.mark.parametrize("fill", (0, 65535))
@pytest.mark.long
def test_margins_that_nothing_marks_are_no_colours(town, sharp, tmp_path, told, fill):
    """A third of the multispectral image of one view is a margin; the others show that ground, and by the truth of the
    scene its colours are there. It was white, or black."""
    xs = []
    for number, path in enumerate(town["xs"]):
        copy = str(tmp_path / Path(path).name)
        gdal.GetDriverByName("GTiff").CreateCopy(copy, gdal.Open(path), options=["COPY_SRC_OVERVIEWS=NO"])
        if number == 1:
            dataset = gdal.Open(copy, gdal.GA_Update)
            values = dataset.ReadAsArray()
            values[:, :, : values.shape[2] // 3] = fill
            dataset.WriteArray(values)
            dataset = None
        xs.append(copy)
    result, said = fused(town, tmp_path, told, xs=xs, colour="all")
    truth = gdal.Warp("", town["truth"], format="MEM", outputBounds=bounds(result.ortho), xRes=0.5, yRes=0.5)
    known, off = truth.ReadAsArray(), []
    for path in (result.ortho, sharp[0].ortho):
        colours = pixels(path).astype(float)
        seen = (colours.min(axis=0) > 0) & (known.min(axis=0) > 0)
        off.append(np.abs(colours - known)[:, seen].max(axis=0) / np.median(known))
    assert np.median(off[0]) < 1.2 * np.median(off[1]) and (off[0] > 1.5).mean() < (off[1] > 1.5).mean() + 0.01
    assert any("% of the pixels of" in text and "left out" in text for text in said.notes)


def bounds(path):
    dataset = gdal.Open(path)
    x, cell, _, y, _, down = dataset.GetGeoTransform()
    return (x, y + dataset.RasterYSize * down, x + dataset.RasterXSize * cell, y)


@pytest.mark.long
def test_sixteen_bits_stay_and_bands_say_what_they_are(sharp):
    dataset, dsm = gdal.Open(sharp[0].ortho), gdal.Open(sharp[0].output)
    assert dataset.GetGeoTransform() == dsm.GetGeoTransform() and dataset.RasterXSize == dsm.RasterXSize
    bands = [dataset.GetRasterBand(band) for band in (1, 2, 3, 4)]
    assert [band.GetDescription() for band in bands] == list(WEIGHTS)
    assert {band.DataType for band in bands} == {gdal.GDT_UInt16} and {band.GetNoDataValue() for band in bands} == {0.0}
    colours = [gdal.GCI_RedBand, gdal.GCI_GreenBand, gdal.GCI_BlueBand]
    assert [band.GetColorInterpretation() for band in bands[:3]] == colours
    values = dataset.ReadAsArray()
    nothing = (values == 0).any(axis=0)
    assert (nothing == (values == 0).all(axis=0)).all()
    assert nothing[dsm.ReadAsArray() == -9999].all()
    style = Path(sharp[0].ortho).with_suffix(".qml").read_text()
    assert 'type="multibandcolor" redBand="1"' in style and "@" not in style


@pytest.mark.slow
def test_the_number_of_workers_and_who_else_runs_change_no_byte(town, sharp, tmp_path, told):
    """In blocks so small that there are many, and the same blocks by one worker and by three."""
    small = replace(ENGINE, ortho=replace(ENGINE.ortho, block_cells=150))
    found = []
    for workers in (1, 3):
        folder = tmp_path / str(workers)
        folder.mkdir()
        found.append(Path(fused(town, folder, told, small, workers=workers, colour="all")[0].ortho).read_bytes())
    assert found[0] == found[1]
    blocks, whole = pixels(str(tmp_path / "3" / "ortho.tif")).astype(int), pixels(sharp[0].ortho).astype(int)
    assert ((blocks == 0) == (whole == 0)).mean() > 0.999
    assert (np.abs(blocks - whole).max(axis=0) <= 2).mean() > 0.95  # seams need not be the same


@pytest.mark.long
def test_what_a_tower_hides_is_nodata_or_from_another_view(town, sharp, tmp_path):
    """With one view alone, the cells behind roofs are empty; others fill most of them."""
    from repm_qgis.contracts.arrays import Window
    from repm_qgis.fusion.finished import FinishedSurface
    from repm_qgis.geometry.vertical import HeightDatum
    from repm_qgis.ortho.seen_surface import SeenSurface

    scene = Scene.load(town["scene"])
    dsm = FinishedSurface.of(sharp[0].output, scene.crs, HeightDatum.of(""))
    whole = Window(0, 0, *dsm.grid.size)
    part = Window(dsm.grid.size[0] // 3, dsm.grid.size[1] // 3, 60, 60)
    view, surface = scene.views[0], SeenSurface.of(dsm, scene.views, ENGINE.ortho)
    seen = surface.seen(view, whole, dsm.heights(whole))
    inner = surface.seen(view, part, dsm.heights(part))
    rows, columns = part.inside(whole)
    assert (seen[rows, columns] == inner).mean() > 0.99  # what lies outside the window hides cells, too
    hidden = np.isfinite(dsm.heights(whole)) & ~seen
    assert hidden.mean() > 0.005
    assert (pixels(sharp[0].ortho)[0][hidden] > 0).mean() > 0.5


@pytest.mark.long
def test_clouds_and_meshes_have_the_colours(sharp):
    import laspy

    result, _ = sharp
    cloud = laspy.read(result.cloud)
    assert cloud.header.point_format.id == 7
    x, cell, _, y, _, down = gdal.Open(result.ortho).GetGeoTransform()
    column, row = ((cloud.x - x) // cell).astype(int), ((cloud.y - y) // down).astype(int)
    values = pixels(result.ortho)[0][row, column].astype(float)
    shown = values > 0
    low, high = np.percentile(values[shown], (10, 90))
    middle = shown & (values > low) & (values < high)
    assert np.corrcoef(values[middle], np.asarray(cloud.red)[middle])[0, 1] > 0.999
    schema = {each["name"]: each for each in json.loads((Path(result.ept) / "ept.json").read_text())["schema"]}
    assert schema["Red"]["size"] == 2 and schema["Red"]["maximum"] == float(np.max(cloud.red))
    assert schema["Blue"]["count"] == len(cloud.x)
    assert '<renderer type="rgb"' in (Path(result.ept) / "ept.qml").read_text()
    header, _, rest = Path(result.mesh).read_bytes().partition(b"end_header\n")
    vertices = int(header.split(b"element vertex ")[1].split()[0])
    assert b"property uchar red\nproperty uchar green\nproperty uchar blue\n" in header
    record = np.frombuffer(rest, [("place", "<f8", 3), ("colour", "u1", 3)], vertices)
    column, row = ((record["place"][:, i] - start) // step for i, start, step in ((0, x, cell), (1, y, down)))
    values = pixels(result.ortho)[0][row.astype(int), column.astype(int)].astype(float)
    middle = (values > low) & (values < high)
    assert np.corrcoef(values[middle], record["colour"][middle, 0])[0, 1] > 0.999


@pytest.mark.long
def test_greys_are_what_they_were(town, tmp_path, told):
    """Without XS, images of one band give one band of brightness, and clouds without colours."""
    import laspy

    result, said = fused(town, tmp_path, told, xs=[], cloud=str(tmp_path / "c.laz"))
    dataset = gdal.Open(result.ortho)
    assert dataset.RasterCount == 1 and dataset.GetRasterBand(1).DataType == gdal.GDT_Float32
    assert laspy.read(result.cloud).header.point_format.id == 6
    assert not any("Colours" in text for text in said.notes)


# --- what does not fit ---


@pytest.mark.long
def test_xs_are_paired_in_any_order(town, sharp, tmp_path, told):
    result, _ = fused(town, tmp_path, told, xs=town["xs"][::-1], colour="all")
    assert Path(result.ortho).read_bytes() == Path(sharp[0].ortho).read_bytes()


@pytest.mark.long
def test_views_without_xs_have_no_part_in_the_colours(town, tmp_path, told):
    _, said = fused(town, tmp_path, told, xs=town["xs"][:2])
    assert any("No colours from img_03" in text for text in said.notes)


@pytest.mark.long
def test_xs_that_do_not_fit_are_refused_in_a_sentence(town, tmp_path, told, write_image, synthetic_rpc):
    rpc = load_views((town["xs"][0],))[0].rpc
    colour = np.full((3, 105, 105), 500, np.uint16)
    cases = [
        (write_image(tmp_path / "one.tif", colour[0], rpc), ImageError, "one.tif' has one band only"),
        (write_image(tmp_path / "bare.tif", colour), RpcMissingError, "bare.tif"),
        (write_image(tmp_path / "far.tif", colour, synthetic_rpc(lon=40.0)), OverlapError, "far.tif' does not overlap"),
    ]
    for path, error, text in cases:
        with pytest.raises(error, match=text):
            fused(town, tmp_path, told, xs=[path])
    with pytest.raises(OptionError, match="two images of one acquisition with 'img_01'"):
        again = tmp_path / "again.tif"
        again.write_bytes(Path(town["xs"][0]).read_bytes())
        fused(town, tmp_path, told, xs=[town["xs"][0], str(again)])
    with pytest.raises(OptionError, match="COLOUR is 'greys': it must be auto or all where there are XS"):
        fused(town, tmp_path, told, colour="greys")


@pytest.mark.long
def test_an_xs_of_another_acquisition_is_refused(town, tmp_path, told, urban):
    """A view from another direction over the same place."""
    scene = Scene.load(town["scene"])
    alone = replace(scene, views=scene.views[1:], tiles=(), pairs=(), pointing=None, tie_points="")
    from repm_qgis.contracts.options import DsmFuseOptions
    from repm_qgis.ortho.colour_sources import colour_plan

    options = DsmFuseOptions(scene="s", output="o", xs=(town["xs"][0],))
    with pytest.raises(OptionError, match="must be of the same acquisition .* looks 1[0-9].. degrees"):
        colour_plan(alone, options, told(), ENGINE.ortho.sharpening)


@pytest.mark.long
def test_an_xs_that_lies_beside_its_image_is_used_and_not_overwritten(town, tmp_path, told):
    scene = Scene.load(town["scene"])
    beside = Path(scene.views[0].image).with_name("img_01_XS.tif")
    beside.write_bytes(Path(town["xs"][0]).read_bytes())
    try:
        with pytest.raises(OptionError, match="ORTHO is '.*img_01_XS.tif': it is also an image that is read"):
            fused(town, tmp_path, told, xs=[], ortho=str(beside))
        assert beside.read_bytes() == Path(town["xs"][0]).read_bytes()
        result, said = fused(town, tmp_path, told, xs=[])
    finally:
        beside.unlink()
    assert gdal.Open(result.ortho).RasterCount == 3
    assert any("Colours of 'img_01' from" in text for text in said.notes)


@pytest.mark.parametrize(
    ("pan", "xs"),
    [
        ("IMG_PHR1A_P_001/IMG_PHR1A_P_201_SEN_1-001_R1C1.TIF", "IMG_PHR1A_MS_002/IMG_PHR1A_MS_201_SEN_1-002_R1C1.TIF"),
        ("x_P001_PAN/12JUL14-P1BS-01_P001.NTF", "x_P001_MUL/12JUL14-M1BS-01_P001.NTF"),
        ("town.tif", "town_XS.tif"),
        ("town_PAN.tif", "town_MS.tif"),
    ],
)
def test_xs_are_found_under_their_vendors_names(tmp_path, pan, xs):
    for name in (pan, xs):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert multispectral_beside(str(tmp_path / pan)) == str(tmp_path / xs)
    (tmp_path / xs).unlink()
    assert multispectral_beside(str(tmp_path / pan)) == ""
