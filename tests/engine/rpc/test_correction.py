"""Corrected RPCs against the pointed model, by GDAL's transformer, and every written form read back."""

from __future__ import annotations

import os
import re
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import RpcInvalidError
from repm_qgis.imagery.vrt import image_vrt_text
from repm_qgis.rpc.correction import DELIVERED, EXACT, FITTED, JITTERED, SHIFTED, corrected
from repm_qgis.rpc.readers import read_rpc_file, rpc_of
from repm_qgis.rpc.writers import rpb_text, rpc_tags, rpc_txt

SHIFT = np.array([[1.0, 0.0, 17.25], [0.0, 1.0, -20.0]])
AFFINE = SHIFT + 1e-4 * np.array([[0.7, -1.0, 0.0], [1.0, 0.6, 0.0]])
SITES = (
    "calanques giza lenclio melbourne new_york ossoue port_au_prince toulouse ubaye other/RPC_PHR1B other/PHR1B "
    "other/rpc_IKONOS other/rpc_WV2 other/rpc_SPOT6 other/rpc_PLANET_L1A other/rpc_PLANET_L1B other/20191015 "
    "other/wv3_20 other/wv3_30"
).split()


def seen(rpc, size, count=400, seed=5):
    """Random ground points (N, 3) over an image and the RPC's heights."""
    chance = np.random.default_rng(seed)
    pixels = chance.uniform(-0.5, np.array(size) - 0.5, (count, 2))
    return rpc.localise(pixels, chance.uniform(*rpc.height_range, count))


def pointed(rpc, pointing, ground):
    return rpc.project(ground) @ pointing[:, :2].T + pointing[:, 2]


def distance(rpc, other, pointing, ground):
    return np.linalg.norm(other.project(ground) - pointed(rpc, pointing, ground), axis=1).max()


def by_gdal(path, ground):
    """(N, 2) pixels in our convention, by the RPC that GDAL finds for a file."""
    dataset = gdal.Open(str(path))
    transformer = gdal.Transformer(dataset, None, ["METHOD=RPC"])
    found, done = transformer.TransformPoints(1, ground.tolist())
    assert all(done)
    return np.array(found)[:, :2] - 0.5


def files_of(site, shared_data):
    folder, _, stem = site.rpartition("/")
    found = sorted((shared_data / "rpc" / (folder or "pleiades")).glob(f"{stem}*"))
    assert found, f"no RPC of {site} in the shared data"
    return found


def test_the_sites_are_all_that_there_are(shared_data):
    there = {path for path in (shared_data / "rpc").rglob("*") if path.is_file()}
    assert {path for site in SITES for path in files_of(site, shared_data)} == there and len(there) == 47


@pytest.mark.parametrize("pointing", [SHIFT, AFFINE], ids=["shift", "affine"])
@pytest.mark.parametrize("site", SITES)
@pytest.mark.long
def test_gdal_sees_the_pointed_model_in_every_form(site, pointing, shared_data, tmp_path, write_image):
    for number, path in enumerate(files_of(site, shared_data)):
        rpc = read_rpc_file(str(path))
        crop = path.suffix == ".NTF"
        size = (500, 500) if crop else (round(2 * rpc.col_scale), round(2 * rpc.row_scale))
        made = corrected(rpc, pointing, size, rpc.height_range)
        assert made.method == (SHIFTED if pointing is SHIFT else EXACT if "IKONOS" in path.name else FITTED)
        folder = tmp_path / str(number)
        for form in ("vrt", "rpb", "txt"):
            (folder / form).mkdir(parents=True)
            image = write_image(folder / form / "scene.tif")
        (folder / "rpb" / "scene.RPB").write_text(rpb_text(made.rpc))
        (folder / "txt" / "scene_RPC.TXT").write_text(rpc_txt(made.rpc))
        vrt = image_vrt_text(gdal.Open(image), image, str(folder / "vrt"), {"RPC": rpc_tags(made.rpc)})
        (folder / "vrt" / "scene.vrt").write_text(vrt)
        ground = seen(rpc, size)
        wanted = pointed(rpc, pointing, ground)
        for name in ("vrt/scene.vrt", "rpb/scene.tif", "txt/scene.tif"):
            error = np.linalg.norm(by_gdal(folder / name, ground) - wanted, axis=1).max()
            assert error < 5e-4 and error < 1.5 * made.max_px + 1e-6, f"{path.name}, {name}: {error} px"
            dataset = gdal.Open(str(folder / name))
            assert distance(rpc, rpc_of(dataset, str(folder / name)), pointing, ground) < 5e-4
        for name in ("rpb/scene.RPB", "txt/scene_RPC.TXT"):
            assert read_rpc_file(str(folder / name)) == made.rpc  # all digits


def test_a_shift_is_in_the_offsets_alone(synthetic_rpc):
    rpc = synthetic_rpc()
    made = corrected(rpc, SHIFT, (41500, 38000), (0.0, 900.0))
    assert made.method == SHIFTED
    assert made.rpc == replace(rpc, col_off=rpc.col_off + 17.25, row_off=rpc.row_off - 20.0)
    assert made.max_px < 1e-9 and made.rms_px <= made.max_px
    untouched = corrected(rpc, np.eye(2, 3), (41500, 38000), (0.0, 900.0))
    assert (untouched.rpc, untouched.method, untouched.max_px) == (rpc, DELIVERED, 0.0)


def test_an_affine_map_is_exact_where_the_denominators_are_equal(synthetic_rpc):
    rpc = synthetic_rpc()
    rpc = replace(rpc, col_den=rpc.row_den)
    turned = np.array([[0.9, -0.3, 100.0], [0.3, 0.9, -50.0]])
    made = corrected(rpc, turned, (41500, 38000), (100.0, 900.0))
    assert made.method == EXACT and made.max_px < 1e-7
    assert distance(rpc, made.rpc, turned, seen(rpc, (41500, 38000))) < 1e-7


def test_what_it_says_of_its_errors_is_true_and_the_denominators_stay(synthetic_rpc):
    rpc = synthetic_rpc()
    size = (41500, 38000)
    for factor in (1, 10, 100):
        pointing = SHIFT + factor * (AFFINE - SHIFT)
        made = corrected(rpc, pointing, size, rpc.height_range)
        error = distance(rpc, made.rpc, pointing, seen(rpc, size, 4000))
        assert 0.3 * made.max_px < error < 1.5 * made.max_px and made.rms_px < made.max_px
        assert (made.rpc.row_den, made.rpc.col_den) == (rpc.row_den, rpc.col_den)
        assert made.method == FITTED and made.max_px < 2e-4 * factor


def test_an_rpc_holds_slow_waves_and_says_what_it_cannot(synthetic_rpc):
    rpc, size = synthetic_rpc(), (41500, 38000)

    def waves(period):
        def shaken(pixels):
            angle = 2 * np.pi * pixels[..., 1] / period
            return pixels + np.stack([0.8 * np.sin(angle), 0.5 * np.cos(angle)], axis=-1)

        return shaken

    slow, fast = (corrected(rpc, SHIFT, size, rpc.height_range, waves(period)) for period in (150000.0, 6000.0))
    assert slow.method == fast.method == JITTERED
    assert slow.rms_px < 0.1 and 0.4 < fast.rms_px < 0.7 and fast.max_px < 1.5  # they are 0.67 px
    ground = seen(rpc, size)
    for made, period in ((slow, 150000.0), (fast, 6000.0)):
        wanted = waves(period)(pointed(rpc, SHIFT, ground))
        assert np.linalg.norm(made.rpc.project(ground) - wanted, axis=1).max() < 1.3 * made.max_px


def test_a_crop_keeps_a_model_of_the_whole_product(shared_data):
    """Fitted to a crop alone, WorldView's RPC is 0.05 px off at the product's other end."""
    rpc = read_rpc_file(str(shared_data / "rpc" / "other" / "wv3_20.NTF"))
    made = corrected(rpc, AFFINE, (500, 500), rpc.height_range)
    assert made.max_px < 5e-4
    whole = (round(2 * rpc.col_scale), round(2 * rpc.row_scale))
    chance = np.random.default_rng(4)
    pixels = chance.uniform(0, whole, (2000, 2)) + [rpc.col_off - rpc.col_scale, rpc.row_off - rpc.row_scale]
    ground = rpc.localise(pixels, chance.uniform(*rpc.height_range, 2000))
    assert distance(rpc, made.rpc, AFFINE, ground) < 5e-3


def test_heights_of_the_scene_beyond_those_of_the_rpc_count(synthetic_rpc):
    rpc = synthetic_rpc()
    low = corrected(rpc, AFFINE, (41500, 38000), rpc.height_range)
    high = corrected(rpc, AFFINE, (41500, 38000), (100.0, 6000.0))
    pixels = np.random.default_rng(2).uniform(0, 38000, (500, 2))
    ground = rpc.localise(pixels, 5900.0)
    assert distance(rpc, high.rpc, AFFINE, ground) < 0.5 * distance(rpc, low.rpc, AFFINE, ground)


def test_a_model_that_does_not_see_its_image_is_refused(synthetic_rpc):
    with pytest.raises(RpcInvalidError, match="gives almost none of the image"):
        corrected(synthetic_rpc().shifted(5e7, 5e7), AFFINE, (500, 500), (100.0, 900.0))


def test_the_accuracy_is_kept_and_only_where_it_is_known(synthetic_rpc, tmp_path):
    for accuracy in (None, 3.25):
        rpc = synthetic_rpc(accuracy_m=accuracy)
        made = corrected(rpc, AFFINE, (41500, 38000), (100.0, 900.0)).rpc
        assert ("ERR_BIAS" in rpc_tags(made)) == (accuracy is not None)
        for name, text in (("a.RPB", rpb_text(made)), ("a_RPC.TXT", rpc_txt(made))):
            (tmp_path / name).write_text(text)
            assert read_rpc_file(str(tmp_path / name)).accuracy_m == accuracy
    assert "\terrBias = 3.25;\n\terrRand = 0.0;\n\tlineOffset = " in rpb_text(made)


def test_the_texts_have_the_members_in_the_order_of_gdals_own_writer(synthetic_rpc, tmp_path):
    rpc = synthetic_rpc(accuracy_m=1.0)
    memory = gdal.GetDriverByName("MEM").Create("", 4, 4, 1)
    memory.SetMetadata(rpc_tags(rpc), "RPC")
    path = str(tmp_path / "g.tif")
    gdal.GetDriverByName("GTiff").CreateCopy(path, memory, options=["RPB=YES", "RPCTXT=YES"])
    for name, text, member in (("g.RPB", rpb_text(rpc), r"(\w+) = "), ("g_RPC.TXT", rpc_txt(rpc), r"(\w+): ")):
        theirs = (tmp_path / name).read_text()
        assert re.findall(member, text) == re.findall(member, theirs)
    assert not os.path.exists(path + ".aux.xml")
