"""Images with black frames that no nodata value marks: the cameras' stage leaves them out, and all stages after it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import ImageError
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage


@pytest.fixture
def framed(mountains, tmp_path):
    """The mountains' images with black upper parts and a stripe, which their files do not mark."""
    paths = []
    for image in mountains.images:
        path = str(tmp_path / Path(image).name)
        source = gdal.Open(image)
        dataset = gdal.GetDriverByName("GTiff").CreateCopy(path, source)
        dataset.SetMetadata(source.GetMetadata("RPC"), "RPC")
        values = dataset.GetRasterBand(1).ReadAsArray()
        values[:60] = 0
        values[200:230] = 0
        dataset.GetRasterBand(1).WriteArray(values)
        source = dataset = None
        paths.append(path)
    return paths


def fit(images, folder, said):
    return Scene.load(run_stage("epmfit", {"images": images, "workspace": str(folder)}, said).scene)


@pytest.mark.long
def test_black_frames_are_masked_and_change_nothing_else(mountains, framed, tmp_path, told):
    said = told()
    scene, plain = fit(framed, tmp_path / "ws", said), fit(mountains.images, tmp_path / "plain", told())
    assert all(Path(view.mask).exists() for view in scene.views) and not any(view.mask for view in plain.views)
    assert sum("are black margins that no nodata value marks" in text for text in said.notes) == 3
    assert np.abs(np.subtract(scene.altitudes, plain.altitudes)).max() < 60.0
    again = told()
    fit(framed, tmp_path / "ws", again)
    assert any(text.startswith("Reused the cameras") for text in again.notes)
    Path(scene.views[0].mask).unlink()
    assert Path(fit(framed, tmp_path / "ws", told()).views[0].mask).exists()


SIDE, CORNER = 40_000, (39_300, 39_500)


def linear(tags):
    """RPC tags for a raster a hundred times as large, without higher terms: far from the image they make nonsense."""
    for axis in ("LINE", "SAMP"):
        above, below = (np.array(tags[f"{axis}_{part}_COEFF"].split(), float) for part in ("NUM", "DEN"))
        terms = np.append(above[0], (above - above[0] * below)[1:4]) * (0.01, 1, 1, 0.01)  # of 1, lon, lat and height
        tags[f"{axis}_NUM_COEFF"] = " ".join(map(repr, [*terms.tolist(), *[0.0] * 16]))
        tags[f"{axis}_DEN_COEFF"] = " ".join(["1"] + ["0"] * 19)
    for axis in ("LINE", "SAMP", "LAT", "LONG"):
        tags[f"{axis}_SCALE"] = str(100 * float(tags[f"{axis}_SCALE"]))
    return tags


@pytest.fixture(scope="module")
def in_corner(mountains, tmp_path_factory):
    """Makes two of the mountains' images in the corner of rasters of so many pixels a side, which hold nothing else."""

    def make(side, corner):
        folder = tmp_path_factory.mktemp("corner")
        paths = [str(folder / Path(image).name) for image in mountains.images[:2]]
        for path, image in zip(paths, mountains.images):
            source = gdal.Open(image)
            tags = linear(source.GetMetadata("RPC"))
            for name, offset in zip(("SAMP_OFF", "LINE_OFF"), corner):
                tags[name] = str(float(tags[name]) + offset)
            options = ["TILED=YES", "SPARSE_OK=TRUE"]
            dataset = gdal.GetDriverByName("GTiff").Create(path, side, side, 1, gdal.GDT_UInt16, options)
            dataset.GetRasterBand(1).WriteArray(source.ReadAsArray(), *corner)
            dataset.SetMetadata(tags, "RPC")
            source = dataset = None
            assert Path(path).stat().st_size < 3 << 20
        return paths

    return make


@pytest.fixture(scope="module")
def sparse(in_corner):
    return in_corner(SIDE, CORNER)


@pytest.fixture(scope="module")
def within(mountains):
    """EXTENT: the inner part of the mountains, as options."""
    xmin, ymin, xmax, ymax = mountains.bounds
    across, up = 0.3 * (xmax - xmin), 0.3 * (ymax - ymin)
    return {"extent": [xmin + across, ymin + up, xmax - across, ymax - up], "extent_crs": mountains.crs}


@pytest.mark.slow
def test_of_a_huge_raster_only_the_extent_counts(in_corner, sparse, within, tmp_path, told):
    made = {}
    for name, images in (("sparse", sparse), ("plain", in_corner(400, (0, 0)))):
        options = {"images": images, "workspace": str(tmp_path / name), "output": str(tmp_path / f"{name}.tif")}
        made[name] = run_stage("pipeline", {**options, **within, "resolution": 1.0, "workers": 1}, told())
    scenes = {name: Scene.load(result.scene) for name, result in made.items()}
    for view, plain in zip(scenes["sparse"].views, scenes["plain"].views):
        assert np.abs(np.subtract(view.part, (*np.add(plain.part[:2], CORNER), *plain.part[2:]))).max() <= 3
        stretch, expected = view.stretch(), plain.stretch()
        assert abs(stretch.low - expected.low) < 3 and abs(stretch.high - expected.high) < 5
        assert all(tile.views[view.name].window.common(view.part) for tile in scenes["sparse"].tiles)
    heights = [gdal.Open(made[name].output).ReadAsArray() for name in ("sparse", "plain")]
    assert heights[0].shape == heights[1].shape
    both = (heights[0] != -9999) & (heights[1] != -9999)
    assert both.mean() > 0.95 * (heights[1] != -9999).mean()
    assert np.median(np.abs(heights[0] - heights[1])[both]) < 0.1


def test_without_an_extent_what_holds_almost_nothing_is_refused(sparse, tmp_path, told):
    with pytest.raises(
        ImageError, match=r"holds 0.\d* % of them, .* crop it to what it holds, or give an EXTENT there"
    ):
        fit(sparse, tmp_path / "ws", told())


def test_an_extent_that_images_show_wholly_changes_nothing(mountains, tmp_path, told):
    back = pyproj.Transformer.from_crs(mountains.crs, "EPSG:4326", always_xy=True)
    xmin, ymin, xmax, ymax = back.transform_bounds(*mountains.bounds)
    options = {"images": mountains.images, "extent": [xmin - 0.1, ymin - 0.1, xmax + 0.1, ymax + 0.1]}
    made = run_stage("epmfit", {**options, "workspace": str(tmp_path), "extent_crs": "EPSG:4326"}, told())
    assert [view.part for view in Scene.load(made.scene).views] == [None] * 3


@pytest.mark.long
@pytest.mark.parametrize("fill", (65535, -9999, -3.4e38))
def test_tie_points_are_found_beside_margins_of_any_value(urban, tmp_path, told, fill):
    """65535 would be bright ground, and pixels that are read reduced would have a part of -9999 or -3.4e38 in them."""
    counts = []
    for name in ("plain", "filled"):
        images = []
        for image in urban.images[:2]:
            images.append(str(tmp_path / f"{name}_{Path(image).name}"))
            source = gdal.Open(image)
            values = source.GetRasterBand(1).ReadAsArray().astype(np.float32)
            rows, columns = np.indices(values.shape)
            if name == "filled":
                values[(columns < 0.2 * (len(values) - rows)) | (rows < 30)] = fill
            kind = gdal.GDT_UInt16 if fill > 0 else gdal.GDT_Float32
            dataset = gdal.GetDriverByName("GTiff").Create(images[-1], *values.shape[::-1], 1, kind)
            dataset.SetMetadata(source.GetMetadata("RPC"), "RPC")
            dataset.GetRasterBand(1).WriteArray(values)
            source = dataset = None
        said = told()
        scene = fit(images, tmp_path / name, said)
        options = {"scene": str(scene.path), "output_scene": str(tmp_path / name / "r.json"), "quality": "fast"}
        counts.append(run_stage("reconstruct", {**options, "workers": 1}, told()).n_tie_points)
    assert all(view.mask for view in scene.views)
    assert sum(f"of the value {fill:g}" in text or "black margins" in text for text in said.notes) == 2
    assert counts[1] > 0.6 * counts[0]
