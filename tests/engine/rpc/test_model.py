"""The RPC model against GDAL's transformer, and against itself there and back."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import RpcInvalidError
from repm_qgis.rpc import Rpc
from repm_qgis.rpc.readers import read_rpc_file, rpc_of
from repm_qgis.rpc.writers import rpc_tags

CONVENTION = 0.5  # GDAL's pixel corners are whole numbers, our pixel centres are


def gdal_project(metadata, points):
    """(N, 2) column, row of GDAL's own transformer, in our convention."""
    dataset = gdal.GetDriverByName("MEM").Create("", 10, 10, 1)
    dataset.SetMetadata(metadata, "RPC")
    transformer = gdal.Transformer(dataset, None, ["METHOD=RPC"])
    found, good = transformer.TransformPoints(1, points.tolist())
    assert all(good)
    transformer = dataset = None
    return np.array(found)[:, :2] - CONVENTION


def gdal_metadata(text):
    """GDAL's RPC domain from a DIMAP XML, read with regular expressions: nothing of ours takes part."""
    inverse = text[text.index("<Inverse_Model>") : text.index("</Inverse_Model>")]
    inverse += text[text.index("<RFM_Validity>") :]
    value = dict(re.findall(r"<((?:SAMP|LINE|LAT|LONG|HEIGHT)_[A-Z]+(?:_COEFF_\d+)?)>\s*([^<\s]+)", inverse))
    metadata = {
        f"{k}_{e}": value[f"{k}_{e}"] for k in ("LAT", "LONG", "HEIGHT", "SAMP", "LINE") for e in ("OFF", "SCALE")
    }
    for name in ("SAMP", "LINE"):
        metadata[f"{name}_OFF"] = repr(float(value[f"{name}_OFF"]) - 1.0)
        for part in ("NUM", "DEN"):
            metadata[f"{name}_{part}_COEFF"] = " ".join(value[f"{name}_{part}_COEFF_{i}"] for i in range(1, 21))
    return metadata


def test_project_agrees_with_gdal(synthetic_rpc, points_of):
    rpc = synthetic_rpc()
    points = points_of(rpc)
    difference = rpc.project(points) - gdal_project(rpc_tags(rpc), points)
    assert np.abs(difference).max() < 1e-6


def test_project_agrees_with_gdal_on_all_pleiades_scenes(shared_data, points_of):
    files = sorted((shared_data / "rpc" / "pleiades").glob("*.XML"))
    assert len(files) > 20
    for path in files:
        rpc = read_rpc_file(str(path))
        points = points_of(rpc, 60)
        difference = rpc.project(points) - gdal_project(gdal_metadata(path.read_text()), points)
        assert np.abs(difference).max() < 1e-6, path.name


def test_project_agrees_with_gdal_on_images(shared_data, points_of):
    images = [
        *shared_data.glob("pleiades_*/img*.tif"),
        *shared_data.glob("truth_urban/img*.tif"),
        *shared_data.glob("rpc/other/*.NTF"),
    ]
    assert len(images) >= 9
    for path in images:
        dataset = gdal.Open(str(path))
        rpc, metadata = rpc_of(dataset, str(path)), dataset.GetMetadata("RPC")
        dataset = None
        points = points_of(rpc, 60)
        assert np.abs(rpc.project(points) - gdal_project(metadata, points)).max() < 1e-6, path.name


def test_localise_undoes_project(synthetic_rpc, points_of):
    rpc = synthetic_rpc()
    points = points_of(rpc, 20000)  # more than one chunk
    pixels = rpc.project(points)
    found = rpc.localise(pixels, points[:, 2])
    np.testing.assert_allclose(rpc.project(found), pixels, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found, points, rtol=0, atol=1e-11)


def test_localise_undoes_project_on_real_rpcs(shared_data, points_of):
    for path in sorted((shared_data / "rpc" / "pleiades").glob("*.XML")):
        rpc = read_rpc_file(str(path))
        pixels = rpc.project(points_of(rpc, 300))
        heights = np.linspace(*rpc.height_range, 300)
        found = rpc.localise(pixels, heights)
        assert np.abs(rpc.project(found) - pixels).max() < 1e-6, path.name
        assert (found[:, 2] == heights).all()


def test_nan_goes_through_alone(synthetic_rpc, points_of):
    rpc = synthetic_rpc()
    points = points_of(rpc, 5)
    pixels = rpc.project(points)
    for axis in range(3):
        broken = points.copy()
        broken[2, axis] = np.nan
        found = rpc.project(broken)
        assert np.isnan(found[2]).all()
        np.testing.assert_array_equal(np.delete(found, 2, 0), np.delete(pixels, 2, 0))
    broken = pixels.copy()
    broken[1, 0] = np.nan
    ground = rpc.localise(broken, 500.0)
    assert np.isnan(ground[1, :2]).all() and np.isfinite(np.delete(ground, 1, 0)).all()
    assert np.isnan(rpc.localise(pixels, np.array([500, np.nan, 500, 500, 500]))[1, :2]).all()


@pytest.mark.parametrize("count", (0, 1, 2, 3))
def test_shapes_are_kept(synthetic_rpc, points_of, count):
    """Two or three points look like coordinates to careless broadcasting."""
    rpc = synthetic_rpc()
    points = points_of(rpc, 3)[:count]
    pixels = rpc.project(points)
    assert pixels.shape == (count, 2)
    assert rpc.localise(pixels, 400.0).shape == (count, 3)
    for k in range(count):
        np.testing.assert_allclose(rpc.project(points[k]), pixels[k], rtol=0, atol=1e-9)
        np.testing.assert_allclose(rpc.localise(pixels, points[:, 2])[k], points[k], rtol=0, atol=1e-11)


def test_grids_of_points(synthetic_rpc, points_of):
    rpc = synthetic_rpc()
    points = points_of(rpc, 24).reshape(2, 3, 4, 3)
    pixels = rpc.project(points)
    assert pixels.shape == (2, 3, 4, 2)
    heights = np.array([100.0, 200.0, 300.0, 400.0])
    ground = rpc.localise(pixels, heights)
    assert ground.shape == (2, 3, 4, 3)
    assert (ground[..., 2] == heights).all()


def test_a_pixel_far_outside_has_no_ground_or_the_right_one(synthetic_rpc):
    rpc = synthetic_rpc()
    pixels = np.array([[1e7, 1e7], [-3e6, 2e6], [0.0, 0.0]])
    ground = rpc.localise(pixels, 500.0)
    answered = np.isfinite(ground).all(axis=1)
    assert answered[2]
    np.testing.assert_allclose(rpc.project(ground[answered]), pixels[answered], rtol=0, atol=1e-4)


def test_across_the_date_line(synthetic_rpc, points_of):
    here, there = synthetic_rpc(lon=10.0), synthetic_rpc(lon=179.97)
    points = points_of(here)
    moved = points + [169.97, 0, 0]
    moved[:, 0] = np.where(moved[:, 0] > 180, moved[:, 0] - 360, moved[:, 0])
    assert (moved[:, 0] < 0).any() and (moved[:, 0] > 0).any()
    np.testing.assert_allclose(there.project(moved), here.project(points), rtol=0, atol=1e-6)
    found = there.localise(there.project(moved), moved[:, 2])
    turn = (found[:, 0] - moved[:, 0] + 180) % 360 - 180
    assert np.abs(turn).max() < 1e-10


def test_a_crops_rpc(synthetic_rpc, points_of):
    rpc = synthetic_rpc()
    points = points_of(rpc)
    np.testing.assert_allclose(rpc.shifted(1200, 345).project(points), rpc.project(points) - [1200, 345], atol=1e-9)


def test_mapping_round_trip(synthetic_rpc):
    rpc = synthetic_rpc()
    assert Rpc.from_mapping(json.loads(json.dumps(rpc.to_mapping()))) == rpc
    assert rpc.height_range == (100.0, 900.0)


@pytest.mark.parametrize(
    "changes, words",
    (
        ({"row_off": float("nan")}, "row offset is nan"),
        ({"col_off": 1e12}, "col offset is 1000000000000"),
        ({"lat_scale": 0.0}, "lat scale is 0.0: it must be a finite number other than zero"),
        ({"height_scale": float("inf")}, "height scale is inf"),
        ({"row_num": (1.0,) * 19}, "row_num has 19 coefficients: it must have 20"),
        ({"col_den": (float("nan"),) + (0.0,) * 19}, "col_den has a coefficient that is not a finite number"),
        ({"col_den": (0.0,) * 20}, "col_den has only zero coefficients"),
        ({"lat_off": 91.0}, "latitude 91.0: that is not on the Earth"),
        ({"lon_off": 400.0}, "longitude 400.0"),
    ),
)
def test_impossible_numbers_each_have_their_sentence(synthetic_rpc, changes, words):
    with pytest.raises(RpcInvalidError) as caught:
        synthetic_rpc(**changes)
    assert words in str(caught.value)


def test_incomplete_records_are_refused(synthetic_rpc):
    record = synthetic_rpc().to_mapping()
    for broken in (
        {**record, "row_num": "x"},
        {k: v for k, v in record.items() if k != "lon_off"},
        {**record, "lat_off": None},
        {**record, "row_num": 5},
        {**record, "row_num": [None] * 20},
    ):
        with pytest.raises(RpcInvalidError):
            Rpc.from_mapping(broken)


@pytest.mark.parametrize(
    "changes",
    (
        {"lat_off": 90.0},
        {"lat_off": -90.0},
        {"lon_off": 360.0},
        {"lon_off": -360.0},
        {"row_off": -999999999.0},
        {"height_scale": -400.0},
        {"lat_scale": 2e-12},
        {"row_num": (1e30,) * 20},
    ),
)
def test_the_most_that_is_possible_is_accepted(synthetic_rpc, changes):
    (name, value) = next(iter(changes.items()))
    assert getattr(synthetic_rpc(**changes), name) == value


@pytest.mark.parametrize(
    "changes",
    (
        {"lat_off": 90.5},
        {"lat_off": -90.5},
        {"lon_off": 360.5},
        {"lon_off": -360.5},
        {"row_off": 1e9},
        {"col_off": -1e9},
        {"height_scale": 1e9},
        {"lat_scale": 1e-12},
        {"row_num": (2e30,) * 20},
        {"col_den": (1.0,) * 21},
    ),
)
def test_what_is_beyond_is_refused(synthetic_rpc, changes):
    with pytest.raises(RpcInvalidError):
        synthetic_rpc(**changes)


def test_heights_of_a_negative_scale_are_ordered(synthetic_rpc):
    assert synthetic_rpc(height_scale=-400.0).height_range == (100.0, 900.0)


@pytest.mark.parametrize("scale", (0.1, -0.1))
@pytest.mark.parametrize("side", (1.0, -1.0))
@pytest.mark.parametrize("axis", ("lon", "lat"))
def test_a_pixel_near_a_pole_of_the_model_is_found(synthetic_rpc, axis, side, scale):
    """x / (1 - 0.4 x) has the value 3 at 15 / 11, before its pole at 2.5; the first step of Newton's method goes to 3,
    beyond it. The other axis is linear."""
    term = {"lon": 1, "lat": 2}

    def linear(name):
        return tuple(float(i == term[name]) for i in range(20))

    one, other = ("lon", "lat") if axis == "lon" else ("lat", "lon")
    bent = tuple(1.0 if i == 0 else -0.4 * side if i == term[one] else 0.0 for i in range(20))
    flat = (1.0,) + (0.0,) * 19
    rpc = synthetic_rpc(
        lon_off=10.0, lat_off=45.0, lon_scale=scale, lat_scale=scale, col_off=0.0, row_off=0.0, col_scale=1000.0,
        row_scale=1000.0, col_num=linear(one), col_den=bent, row_num=linear(other), row_den=flat,
    )  # fmt: skip
    found = rpc.localise(np.array([[3000.0 * side, 100.0], [0.0, 0.0]]), 500.0)
    place = {one: 15 / 11 * side * scale, other: 0.1 * scale}
    np.testing.assert_allclose(found[0, :2] - [10.0, 45.0], [place["lon"], place["lat"]], atol=1e-9)
    np.testing.assert_allclose(found[1], [10.0, 45.0, 500.0], atol=1e-12)
