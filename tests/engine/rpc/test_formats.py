"""RPC files of every vendor, told apart by what they hold; crops and tiles; and what is refused."""

from __future__ import annotations

import os
import shutil
from dataclasses import fields

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import OptionError, RpcInvalidError, RpcMissingError
from repm_qgis.contracts.options import EpmFitOptions, PipelineOptions
from repm_qgis.imagery.raster import opened
from repm_qgis.rpc import Rpc
from repm_qgis.rpc.formats import _signed_areas, checked
from repm_qgis.rpc.readers import read_rpc_file, rpc_of, rpc_sidecars
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.scene import load_views
from repm_qgis.stages.epmfit import _key
from tests.engine.rpc import writers
from tests.engine.rpc.writers import WRITERS, dimap_v2, dimap_v3, geom, key_value, rpb, rpcm_json, whu_tlc

MODEL = [each.name for each in fields(Rpc) if each.compare]


def read(path, rpc_file=None):
    with opened(str(path)) as dataset:
        return rpc_of(dataset, str(path), rpc_file)


def written(folder, text, name="file.dat"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(path)


def refused(folder, text):
    with pytest.raises(RpcInvalidError) as caught:
        read_rpc_file(written(folder, text))
    assert "'file.dat'" in str(caught.value)
    return str(caught.value)


def same(a, b):
    """Equal to the fifteen digits that GDAL's metadata keep."""
    return all(np.allclose(getattr(a, name), getattr(b, name), rtol=1e-13, atol=1e-12) for name in MODEL)


def gdal_pixels(dataset, points):
    """GDAL's RPC transformer; it counts from the first pixel's corner."""
    transformer = gdal.Transformer(dataset, None, ["METHOD=RPC"])
    found, good = transformer.TransformPoints(1, points.tolist())
    assert all(good)
    return np.array(found)[:, :2] - 0.5


# --- every format ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", WRITERS)
def test_every_format_gives_back_what_was_written(tmp_path, synthetic_rpc, kind):
    rpc = synthetic_rpc()
    for name in ("file.dat", "x.XML", "x_RPC.TXT", "x.json"):  # the name says nothing
        assert read_rpc_file(written(tmp_path, WRITERS[kind](rpc), name)) == rpc


@pytest.mark.parametrize("kind", WRITERS)
def test_windows_line_ends_marks_and_wide_characters(tmp_path, synthetic_rpc, kind):
    rpc = synthetic_rpc()
    text = WRITERS[kind](rpc)
    windows = text.replace("\n", "\r\n")
    for data in (windows.encode(), windows.encode("utf-8-sig"), windows.encode("utf-16"), text.rstrip().encode()):
        assert read_rpc_file(written(tmp_path, data)) == rpc


def test_variants_of_key_value_texts(tmp_path, synthetic_rpc):
    rpc = synthetic_rpc()
    text = key_value(rpc)
    for variant in (
        key_value(rpc, width=2),
        text.replace(": ", " = "),
        text.replace(": ", ":\t"),
        text.replace("LONG_", "LON_"),
        text.replace("e-05", "D-05"),
        "# 5 \u00b0\n" + text,
        together(rpc),
        text + "RFM_CORRECTION_PARAMETERS\n" + "".join(f"a{i}: 0.0\n" for i in range(6)),
    ):
        assert read_rpc_file(written(tmp_path, variant.encode("latin-1"))) == rpc


def together(rpc):
    """Each polynomial in one line, as GDAL's metadata has it."""
    head = "".join(line + "\n" for line in key_value(rpc).splitlines() if "COEFF" not in line)
    names = {"LINE_NUM": rpc.row_num, "LINE_DEN": rpc.row_den, "SAMP_NUM": rpc.col_num, "SAMP_DEN": rpc.col_den}
    return head + "".join(f"{name}_COEFF: {' '.join(map(repr, values))}\n" for name, values in names.items())


def test_much_side_by_side_is_not_deep(tmp_path, synthetic_rpc):
    rpc = synthetic_rpc()
    wide = dimap_v2(rpc).replace("<Global_RFM>", "<Global_RFM>" + "<a/>" * 100 + "<b></b>" * 100)
    assert read_rpc_file(written(tmp_path, wide)) == rpc
    wide = rpcm_json(rpc).replace("{", '{"x": [' + ", ".join(["[{}]"] * 50) + "], ", 1)
    assert read_rpc_file(written(tmp_path, wide)) == rpc


@pytest.mark.parametrize("mirrored", (1, -1))
def test_areas_of_cells_are_those_of_their_corners(mirrored):
    """Parallelograms at the upper left corner of each cell, against the cross product; a mirrored one is negative."""
    grid = np.random.default_rng(1).normal(0, 0.2, (3, 3, 2)) + np.stack(np.meshgrid(range(3), range(3)), axis=-1)
    grid[..., 0] *= mirrored
    ground = np.concatenate([grid.reshape(9, 2), np.full((9, 1), 500.0)], axis=1)
    expected = []
    for i in range(2):
        for j in range(2):
            (ax, ay), (bx, by) = grid[i, j + 1] - grid[i, j], grid[i + 1, j] - grid[i, j]
            expected.append(ax * by - ay * bx)
    np.testing.assert_allclose(_signed_areas(ground), expected)
    assert (np.sign(expected) == mirrored).all()


def test_a_model_is_checked_around_its_own_centre(synthetic_rpc):
    """An RPC of a crop far from the first pixel is none of those that fit nowhere."""
    far = synthetic_rpc().shifted(-2e6, 3e6)
    assert checked(far) == far


def test_image_tags_are_read_from_any_name(tmp_path, synthetic_rpc, write_image):
    image = write_image(tmp_path / "a.tif", rpc=synthetic_rpc())
    os.rename(image, tmp_path / "file.dat")
    assert same(read_rpc_file(str(tmp_path / "file.dat")), synthetic_rpc())


@pytest.mark.parametrize(
    "kind, change, accuracy",
    (
        ("RPB", ("", ""), np.hypot(1.09, 0.24)),
        ("RPB", ("1.09", "-1"), None),
        ("RPB", ("1.09", "much"), None),
        ("RPB", ("errRand =  0.24", "errRand =  0"), 1.09),
        ("Maxar XML", ("", ""), 26.68),
        ("IKONOS", ("LINE_OFF", "ERR_BIAS: 0003.31 meters\nERR_RAND: 0000.50 meters\nLINE_OFF"), np.hypot(3.31, 0.5)),
        ("IKONOS", ("LINE_OFF", "ERR_BIAS: 1e9\nLINE_OFF"), None),
        ("DIMAP v2", ("", ""), None),  # its ERR_BIAS_ROW is that of the RPC's fit
    ),
)
def test_the_vendors_figure_for_its_errors(tmp_path, synthetic_rpc, kind, change, accuracy):
    found = read_rpc_file(written(tmp_path, WRITERS[kind](synthetic_rpc()).replace(*change, 1)))
    assert found.accuracy_m == (None if accuracy is None else pytest.approx(accuracy))
    assert found == synthetic_rpc() and found.shifted(3, 4).accuracy_m == found.accuracy_m


def test_the_vendors_figure_in_an_images_tags(tmp_path, synthetic_rpc, write_image):
    tags = {"ERR_BIAS": "3.0", "ERR_RAND": "4.0"}
    assert read(write_image(tmp_path / "a.tif", rpc=synthetic_rpc(), tags=tags)).accuracy_m == 5.0
    assert read(write_image(tmp_path / "b.tif", rpc=synthetic_rpc())).accuracy_m is None


def test_dimap_origin(tmp_path, synthetic_rpc):
    """v2 counts pixels from 1, v3 from 0; v3's validity domain starts at -3 here, which changes nothing."""
    rpc = synthetic_rpc()
    as_v2 = dimap_v3(rpc).replace("GroundtoImage_Values", "Inverse_Model").replace("PNEO_SENSOR", "PHR_SENSOR")
    assert read_rpc_file(written(tmp_path, dimap_v3(rpc))) == rpc
    assert read_rpc_file(written(tmp_path, as_v2)) == rpc.shifted(1, 1)
    # CARS's advice for Pleiades Neo was to rename the elements: the profile still says what it is.
    renamed = as_v2.replace("PHR_SENSOR", "PNEO_SENSOR").replace("ImagetoGround_Values", "Direct_Model")
    assert read_rpc_file(written(tmp_path, renamed)) == rpc


# --- real files -----------------------------------------------------------------------------------------------------


def test_all_real_files_read_and_go_to_the_ground_and_back(shared_data):
    files = [path for path in sorted((shared_data / "rpc").rglob("*")) if path.is_file()]
    assert len(files) >= 47
    for path in files:
        rpc = read_rpc_file(str(path))
        unit = np.random.default_rng(3).uniform(-0.9, 0.9, (20, 2))
        pixels = unit * [rpc.col_scale, rpc.row_scale] + [rpc.col_off, rpc.row_off]
        ground = rpc.localise(pixels, rpc.height_off)
        assert np.abs(rpc.project(ground) - pixels).max() < 1e-6, path.name


@pytest.mark.parametrize(
    "source, image, sidecar",
    (
        ("other/rpc_IKONOS.txt", "a.tif", "a_rpc.txt"),
        ("other/rpc_PLANET_L1A.txt", "a.tif", "a_RPC.TXT"),
        ("other/rpc_PLANET_L1B.txt", "a.tif", "a_RPC.TXT"),
        ("other/20191015_073816_ssc1d3_0011_basic_l1a_panchromatic_dn_RPC.TXT", "a.tif", "a_RPC.TXT"),
        ("other/rpc_SPOT6.xml", "IMG_a_R1C1.TIF", "RPC_a.XML"),
        ("other/rpc_WV2.xml", "a.tif", "a.XML"),
        ("other/RPC_PHR1B_P_201709281038045_SEN_PRG_FC_178608-001.XML", "IMG_a_R1C1.TIF", "RPC_a.XML"),
        ("pleiades/ossoue__RPC_PHR1A_P_201309231104351_SEN_756965101-002.XML", "IMG_a_R1C1.TIF", "RPC_a.XML"),
        ("other/wv3_20.NTF", "", ""),
        ("other/wv3_30.NTF", "", ""),
    ),
)
def test_projection_agrees_with_gdals(shared_data, tmp_path, write_image, points_of, source, image, sidecar):
    path = shared_data / "rpc" / source
    rpc = read_rpc_file(str(path))
    points = points_of(rpc, 300) if "ssc1d3" not in source else _seen(rpc)
    if sidecar:
        (tmp_path / sidecar).write_bytes(path.read_bytes())
        path = write_image(tmp_path / image)
        assert read(path) == rpc
    dataset = gdal.Open(str(path))
    assert dataset.GetMetadata("RPC")
    assert np.abs(gdal_pixels(dataset, points) - rpc.project(points)).max() < 1e-6


def _seen(rpc):
    """Ground points that the image sees: SkySat's normalisers reach far beyond."""
    unit = np.random.default_rng(5).uniform(-1, 1, (300, 3))
    pixels = unit[:, :2] * [rpc.col_scale, rpc.row_scale] + [rpc.col_off, rpc.row_off]
    return rpc.localise(pixels, rpc.height_off + 200 * unit[:, 2])


def test_geom_of_the_same_scene_is_the_same_model(shared_data, points_of):
    """Written by OSSIM from the same product: fifteen digits are kept, and pixels count from 0."""
    other = shared_data / "rpc" / "other"
    xml = read_rpc_file(str(other / "RPC_PHR1B_P_201709281038045_SEN_PRG_FC_178608-001.XML"))
    ours = read_rpc_file(str(other / "PHR1B_P_201709281038045_SEN_PRG_FC_178608-001.geom"))
    points = points_of(xml, 500)
    assert np.abs(xml.project(points) - ours.project(points)).max() < 1e-6


def test_every_writer_agrees_with_gdals_transformer(tmp_path, synthetic_rpc, points_of, write_image):
    rpc = synthetic_rpc()
    points = points_of(rpc)
    dataset = gdal.Open(write_image(tmp_path / "a.tif", rpc=rpc))
    expected = gdal_pixels(dataset, points)
    for name, write in WRITERS.items():
        got = read_rpc_file(written(tmp_path, write(rpc))).project(points)
        assert np.abs(got - expected).max() < 1e-6, name


# --- what is refused ------------------------------------------------------------------------------------------------


def test_what_is_no_rpc_file_lists_the_formats(tmp_path):
    for text in ("", "hello", "<a/>", "{}", "[1, 2]", "<Dimap_Document/>", "LINE_OFF: 5\n"):
        message = refused(tmp_path, text)
        for words in ("tried", "DIMAP", "Maxar XML", "RPB", "OSSIM geom", "KEY: value", "JSON", "GeoTIFF"):
            assert words in message
    assert "it is not a text" in refused(tmp_path, b"LINE_NUM_COEFF_1: 5\0")
    assert "it is marked as UTF-16" in refused(tmp_path, b"\xff\xfe\x00\xd8\x00")


def test_two_formats_in_one_file_are_ambiguous(tmp_path, synthetic_rpc):
    message = refused(tmp_path, rpb(synthetic_rpc()) + key_value(synthetic_rpc()))
    assert "it fits several formats: RPB or KEY: value" in message


def test_no_file_and_no_regular_file(tmp_path):
    with pytest.raises(RpcMissingError, match="There is no RPC file"):
        read_rpc_file(str(tmp_path / "nothing.txt"))
    with pytest.raises(RpcMissingError, match="There is no RPC file"):
        read_rpc_file(str(tmp_path))
    if os.name == "nt":  # which has no pipes with names in folders
        return
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RpcMissingError, match="There is no RPC file"):
        read_rpc_file(str(tmp_path / "pipe"))


@pytest.mark.parametrize(
    "kind, old, new, words",
    (
        ("IKONOS", "LINE_OFF: ", "LINE_OFFSET: ", "its LINE_OFF is missing"),
        ("IKONOS", "SAMP_DEN_COEFF_20: ", "SAMP_DEN_COEFF_21: ", "its SAMP_DEN_COEFF_20 is missing"),
        ("IKONOS", "500.0 meters", "500.0 feet", "its HEIGHT_OFF is '500.0 feet': it must be in meters"),
        ("IKONOS", "1.44 degrees", "1.44 radians", "it must be in degrees"),
        ("IKONOS", "500.0 meters", "500,0 meters", "its HEIGHT_OFF is '500,0', which is not a number"),
        ("IKONOS", "500.0 meters", "1e400 meters", "the RPC's height offset is inf"),
        ("IKONOS", "500.0 meters", "500.0 400.0 meters", "which is not a number"),
        ("IKONOS", "LAT_OFF: 43.6", "LAT_OFF: 143.6", "that is not on the Earth"),
        ("IKONOS", "LINE_SCALE", "LINE_OFF", "its LINE_OFF is given twice"),
        ("IKONOS", "LINE_NUM_COEFF_1: ", "LINE_NUM_COEFF: ", "both together and number by number"),
        ("WHU-TLC", "LONG_DEN_COEFF_20: ", "X: ", "its LONG_DEN_COEFF_20 is missing"),
        ("WHU-TLC", "LAT_NUM_COEFF_3: ", "LAT_NUM_COEFF_3: x", "its LAT_NUM_COEFF is 'x"),
        ("RPB", "lineOffset", "lineOfset", "its LINE_OFF is missing"),
        ("RPB", "END_GROUP", "END_GRUOP", "its group IMAGE is not complete"),
        ("RPB", "lineNumCoef = (", "lineNumCoef = ", "is not in brackets"),
        ("RPB", "sampNumCoef = (", "sampNumCoef = (1.0,", "col_num has 21 coefficients"),
        ("RPB", "sampNumCoef = (", "sampNumCoef = (1.0", "not a list of numbers with commas"),
        ("DIMAP v2", "<Inverse_Model>", "<Inverse_Models>", "it is not complete XML"),
        ("DIMAP v2", "Inverse_Model>", "Invers_Model>", "0 elements Inverse_Model or GroundtoImage_Values"),
        ("DIMAP v2", "</Global_RFM>", "</Global_RFM><Global_RFM></Global_RFM>", "2 elements Global_RFM"),
        ("DIMAP v2", "<LINE_OFF>", "<LINE_OFF>7</LINE_OFF><LINE_OFF>", "its LINE_OFF is given twice"),
        ("DIMAP v2", "<Dimap_Document", "<!DOCTYPE a><Dimap_Document", "declares a DOCTYPE or entities"),
        (
            "DIMAP v3",
            "<Dimap_Document",
            '<!DOCTYPE a [<!ENTITY b "c">]><Dimap_Document',
            "declares a DOCTYPE or entities",
        ),
        (
            "DIMAP v3",
            "<HEIGHT_OFF>",
            "<HEIGHT_OFF>&#xD800;",
            "its HEIGHT_OFF is '?#xD800;500.0', which is not a number",
        ),
        ("DIMAP v3", "<HEIGHT_OFF>", "<HEIGHT_OFF><a/>", "its HEIGHT_OFF is '', which is not a number"),
        ("Maxar XML", "LINENUMCOEF>", "LINENUMCOEFF>", "row_num has 0 coefficients"),
        ("Maxar XML", "LINEOFFSET>", "LINEOFFSETS>", "0 elements LINEOFFSET"),
        ("Maxar XML", "</RPB>", "</RPB><RPB/>", "2 elements RPB"),
        ("OSSIM B", "parameter:  0", "parameter:  0.3", "adjusted models are not supported"),
        ("OSSIM B", "format:  B", "format:  C", "its polynomial_format is 'C'"),
        ("OSSIM B", "line_den_coeff_19", "line_den_coeff_20", "its LINE_DEN_COEFF_19 is missing"),
        ("JSON rpcm", '"row_scale"', '"row_off"', "its row_scale is missing"),
        ("JSON rpcm", '"row_scale"', '"row_offset"', "its row_offset is given twice"),
        ("JSON rpcm", '"row_offset": 18999.5', '"row_offset": true', "its row_offset is True, which is not a number"),
        ("JSON rpcm", '"row_offset": 18999.5', '"row_offset": NaN', "the RPC's row offset is nan"),
        ("JSON rpcm", '"col_num": [', '"col_num": [1.0,', "its col_num is not a list of 20 numbers"),
        ("JSON rpcm", '"rpc": {', '"rpc": [{', "it is not complete JSON"),
        ("JSON rpcm", '"width": 800', '"width": ' + "[" * 17, "nest deeper than 16"),
        ("JSON GDAL", '"LINE_OFF"', '"LINE_OF"', "its LINE_OFF is missing"),
    ),
)
def test_broken_files_name_what_is_broken(tmp_path, synthetic_rpc, kind, old, new, words):
    text = WRITERS[kind](synthetic_rpc())
    assert old in text
    assert words in refused(tmp_path, text.replace(old, new))


def test_numbers_that_are_no_sensor_model(tmp_path, synthetic_rpc):
    """Each number passes, but no pixel is found on the ground: a swapped or scrambled polynomial."""
    rpc = synthetic_rpc()
    flat = (1.0,) + (0.0,) * 19
    for changes in (
        {"row_num": rpc.col_num},
        {"col_num": flat},
        {"row_den": (0.0, 1.0) + (0.0,) * 18},
        {"row_num": (5.0,) + rpc.row_num[1:]},
        # x - 2.5 x^3 turns back at 0.37, before the pixels at 0.5 of the scale
        {"col_num": tuple({1: 1.0, 11: -2.5}.get(i, 0.0) for i in range(20)), "col_den": flat},
    ):
        broken = type(rpc)(**{**vars(rpc), **changes})
        assert "its numbers are not a sensor model" in refused(tmp_path, key_value(broken))


def test_corrections_in_the_image_are_refused(tmp_path, synthetic_rpc):
    text = key_value(synthetic_rpc()) + "RFM_CORRECTION_PARAMETERS\n"
    assert "RFM_CORRECTION_PARAMETERS" in refused(tmp_path, text + "".join(f"a{i}: {i * 0.1}\n" for i in range(6)))
    assert "RFM_CORRECTION_PARAMETERS" in refused(tmp_path, text)
    assert "RFM_CORRECTION_PARAMETERS" in refused(tmp_path, text + "".join(f"a{i}: 0.0\n" for i in range(5)))


def test_sizes_are_bounded(tmp_path, synthetic_rpc):
    text = key_value(synthetic_rpc())
    assert "larger than 8 MiB" in refused(tmp_path, text + " " * (8 << 20))
    assert "larger than 1 MiB" in refused(tmp_path, text + "X: 1\n" * 300_000)
    assert "no RPC file has more than 20000" in refused(tmp_path, text + "\n" * 30_000)
    assert "a line of more than 4096" in refused(tmp_path, text + "X" * 5000)
    xml = dimap_v2(synthetic_rpc())
    assert "nest deeper than 64" in refused(tmp_path, xml.replace("<Global_RFM>", "<a>" * 70 + "<Global_RFM>"))
    assert "more than 100000 elements" in refused(tmp_path, xml + "<a/>" * 100_001)


# --- which file, and which pixels -----------------------------------------------------------------------------------


@pytest.fixture
def product(tmp_path, synthetic_rpc, write_image):
    """A whole image of 900 x 700 px with RPC tags, whose RPC's domain starts at its first pixel."""
    rpc = synthetic_rpc(col_off=449.5, col_scale=450.0, row_off=349.5, row_scale=350.0)
    return write_image(tmp_path / "full.tif", pixels=np.zeros((700, 900), np.uint8), rpc=rpc), rpc


@pytest.mark.parametrize(
    "name, text",
    (
        ("a.RPB", rpb),
        ("a_RPC.TXT", key_value),
        ("A_rpc.txt", key_value),
        ("a.rpc", whu_tlc),
        ("a.geom", geom),
        ("a.json", rpcm_json),
        ("a.XML", writers.maxar_xml),
        ("RPC_a.XML", dimap_v3),
        ("a_rpc.xml", dimap_v2),
    ),
)
def test_files_named_after_the_image_are_found(tmp_path, write_image, synthetic_rpc, name, text):
    image = write_image(tmp_path / "a.tif")
    sidecar = written(tmp_path, text(synthetic_rpc()), name)
    written(tmp_path, text(synthetic_rpc(lon=9.0)), "other_" + name)
    assert rpc_sidecars(image) == [sidecar]
    assert read(image) == synthetic_rpc()


def test_a_gdal_crop_is_moved_once(tmp_path, product):
    """gdal_translate moves the tags; the vendor's file copied beside the crop is passed over."""
    full, rpc = product
    crop = str(tmp_path / "crop.tif")
    gdal.Translate(crop, full, srcWin=[200, 100, 300, 250])
    assert same(read(crop), rpc.shifted(200, 100))
    for name, text in (("crop.RPB", rpb), ("RPC_crop.XML", dimap_v2), ("crop_RPC.TXT", key_value)):
        written(tmp_path, text(rpc), name)
        assert same(read(crop), rpc.shifted(200, 100)), name


@pytest.mark.parametrize("down", (1, -1))
def test_a_crop_in_pixel_coordinates_moves_the_file_beside_it(tmp_path, write_image, product, down):
    rpc = product[1]
    image = write_image(tmp_path / "crop.tif")
    dataset = gdal.Open(image, gdal.GA_Update)
    dataset.SetGeoTransform((200.0, 1.0, 0.0, 100.0 * down, 0.0, float(down)))
    dataset = None  # noqa: F841
    sidecar = written(tmp_path, key_value(rpc), "crop_RPC.TXT")
    expected = rpc.shifted(200, 100)
    assert read(image) == expected
    elsewhere = written(tmp_path, geom(rpc), "elsewhere.geom")
    os.remove(sidecar)
    assert read(image, elsewhere) == expected
    # A file that was moved with the crop already is not moved again.
    assert read(image, written(tmp_path, key_value(expected), "moved.txt")) == expected


def test_tags_of_a_crop_in_pixel_coordinates_are_not_moved_again(tmp_path, product):
    full, rpc = product
    dataset = gdal.Open(full, gdal.GA_Update)
    dataset.SetGeoTransform((0.0, 1.0, 0.0, 0.0, 0.0, -1.0))
    dataset = None  # noqa: F841
    crop = str(tmp_path / "crop.tif")
    gdal.Translate(crop, full, srcWin=[200, 100, 300, 250])
    with opened(crop) as cropped:
        assert cropped.GetGeoTransform() == (200.0, 1.0, 0.0, -100.0, 0.0, -1.0)
    assert same(read(crop), rpc.shifted(200, 100))
    assert same(read(crop, crop), rpc.shifted(200, 100))
    written(tmp_path, key_value(rpc), "crop_RPC.TXT")
    assert same(read(crop), rpc.shifted(200, 100))


def test_map_coordinates_without_a_crs_are_no_pixel_coordinates(tmp_path, write_image, product):
    rpc = product[1]
    image = write_image(tmp_path / "a.tif")
    dataset = gdal.Open(image, gdal.GA_Update)
    dataset.SetGeoTransform((500000.0, 1.0, 0.0, 4800000.0, 0.0, -1.0))
    dataset = None  # noqa: F841
    assert read(image, written(tmp_path, key_value(rpc))) == rpc


def test_two_files_that_differ_are_ambiguous_until_one_is_named(tmp_path, write_image, synthetic_rpc):
    rpc = synthetic_rpc()
    image = write_image(tmp_path / "a.tif", rpc=rpc)
    refined = written(tmp_path, key_value(rpc.shifted(1.7, -2.3)), "a_RPC.TXT")
    with pytest.raises(RpcInvalidError) as caught:
        read(image)
    for words in (image, "'a_RPC.TXT' and the image's own tags differ by 2.3 px", "name the right one in RPCS"):
        assert words in str(caught.value)
    assert read(image, refined) == rpc.shifted(1.7, -2.3)
    assert same(read(image, image), rpc)
    os.remove(refined)
    written(tmp_path, key_value(rpc), "a_RPC.TXT")
    written(tmp_path, rpb(rpc.shifted(0, 4)), "a.RPB")
    with pytest.raises(RpcInvalidError, match="'a.RPB' and 'a_RPC.TXT' differ by 4 px"):
        read(image)
    written(tmp_path, rpb(rpc.shifted(0.01, 0)), "a.RPB")  # rounded otherwise: the same model
    assert read(image) == rpc.shifted(0.01, 0)


DIM = (
    "<Dimap_Document><Raster_Data><Raster_Dimensions><Tile_Set><NTILES>4</NTILES><Regular_Tiling>"
    '<NTILES_SIZE nrows="2048" ncols="4096"/><NTILES_COUNT ntiles_R="2" ntiles_C="2"/>'
    "<OVERLAP_ROW>{0}</OVERLAP_ROW><OVERLAP_COL>0</OVERLAP_COL></Regular_Tiling></Tile_Set></Raster_Dimensions>"
    "</Raster_Data></Dimap_Document>"
)


@pytest.mark.parametrize("tile, origin", (("R1C1", (0, 0)), ("R1C2", (4096, 0)), ("R3C2", (4096, 4096))))
def test_a_tile_of_an_airbus_product_is_moved_to_its_place(tmp_path, write_image, synthetic_rpc, tile, origin):
    rpc = synthetic_rpc()
    for product, dim, text in (("PHR1A_SEN_9", "PHR1A_SEN_9", dimap_v2), ("PNEO4_F_1_P", "PNEO4_F_1", dimap_v3)):
        image = write_image(tmp_path / f"IMG_{product}_{tile}.TIF")
        written(tmp_path, text(rpc), f"RPC_{product}.XML")
        written(tmp_path, DIM.format(0), f"DIM_{dim}.XML")
        assert read(image) == rpc.shifted(*origin)
        assert read(image, str(tmp_path / f"RPC_{product}.XML")) == rpc.shifted(*origin)


def test_a_tile_whose_place_is_unknown_is_refused(tmp_path, write_image, synthetic_rpc):
    image = write_image(tmp_path / "IMG_PHR1A_SEN_9_R2C1.TIF")
    written(tmp_path, dimap_v2(synthetic_rpc()), "RPC_PHR1A_SEN_9.XML")
    with pytest.raises(RpcInvalidError, match="tile R2C1 of its product and 'DIM_PHR1A_SEN_9.XML'"):
        read(image)
    written(tmp_path, DIM.format(16), "DIM_PHR1A_SEN_9.XML")
    with pytest.raises(RpcInvalidError, match="the tiles of 'DIM_PHR1A_SEN_9.XML' overlap"):
        read(image)


def test_a_damaged_file_beside_the_image_is_not_passed_over(tmp_path, write_image, synthetic_rpc):
    image = write_image(tmp_path / "a.tif")
    written(tmp_path, key_value(synthetic_rpc())[:3000], "a_RPC.TXT")
    with pytest.raises(RpcInvalidError) as caught:
        read(image)
    assert image in str(caught.value) and "'a_RPC.TXT' cannot be used" in str(caught.value)


# --- RPCS -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def pair(tmp_path, write_image, synthetic_rpc):
    rpc = synthetic_rpc(col_off=49.5, col_scale=50.0, row_off=49.5, row_scale=50.0, lat_scale=0.0002, lon_scale=0.0003)
    images = tuple(write_image(tmp_path / f"{name}.tif", np.zeros((100, 100), np.uint8)) for name in "ab")
    return images, rpc


def test_views_take_the_files_in_the_images_order(tmp_path, pair):
    images, rpc = pair
    second = written(tmp_path, rpcm_json(rpc.shifted(2, 3)), "second.json")
    written(tmp_path, rpb(rpc), "a.RPB")
    views = load_views(images, ("", second))
    assert [view.rpc for view in views] == [rpc, rpc.shifted(2, 3)]
    with pytest.raises(RpcMissingError) as caught:
        load_views(images)
    assert "b.tif" in str(caught.value) and "name it in RPCS" in str(caught.value)
    with pytest.raises(RpcMissingError, match="There is no RPC file"):
        load_views(images, ("", "nowhere.txt"))
    with pytest.raises(RpcInvalidError) as caught:
        load_views(images, (images[1], second))
    assert "a.tif" in str(caught.value) and "'b.tif' is not an RPC file of a known format" in str(caught.value)


@pytest.mark.parametrize(
    "rpcs, words",
    (
        (("a.rpb",), "one for each of IMAGES"),
        ("a.rpb", "must be a list"),
        ((1, 2), "must be a list"),
        (("a",) * 3, "must be empty, or name 2 files"),
    ),
)
def test_options_check_the_files(rpcs, words):
    for make in (
        lambda: EpmFitOptions(images=("a.tif", "b.tif"), workspace="ws", rpcs=rpcs),
        lambda: PipelineOptions.from_json(
            {"images": ["a.tif", "b.tif"], "workspace": "ws", "output": "dsm.tif", "rpcs": rpcs}
        ),
    ):
        with pytest.raises(OptionError, match=words) as caught:
            make()
        assert caught.value.name == "RPCS"


def test_options_carry_the_files_on():
    options = PipelineOptions.from_json(
        {"images": ["a.tif", "b.tif"], "workspace": "ws", "output": "dsm.tif", "rpcs": ["", "b.rpc"]}
    )
    assert options.fit.rpcs == ("", "b.rpc")


def test_a_changed_rpc_file_makes_a_new_key(tmp_path, pair):
    """Cameras are fitted anew when an RPC file changes, named in RPCS or found beside the image."""
    images, rpc = pair
    named = written(tmp_path, key_value(rpc), "named.txt")
    options = EpmFitOptions(images=images, workspace=str(tmp_path), rpcs=(named, ""))
    keys = [_key(options), _key(options), _key(EpmFitOptions(images=images, workspace=str(tmp_path)))]
    written(tmp_path, rpb(rpc), "b.RPB")
    keys.append(_key(options))
    shutil.copy(written(tmp_path, key_value(rpc.shifted(1, 0)), "x.txt"), named)
    keys.append(_key(options))
    assert keys[0] == keys[1] and len(set(keys)) == 4


def test_tags_written_by_our_simulation_are_gdals(tmp_path, write_image, synthetic_rpc):
    image = write_image(tmp_path / "a.tif", rpc=synthetic_rpc())
    with opened(image) as dataset:
        assert float(dataset.GetMetadata("RPC")["LINE_OFF"]) == float(rpc_tags(synthetic_rpc())["LINE_OFF"])


def test_an_rpb_without_semicolons_is_read_as_gdal_reads_it(tmp_path, synthetic_rpc):
    rpc = synthetic_rpc()
    text = rpb(rpc)
    for plain in (text.replace(";", ""), text.replace(";", "").replace(");", "\n\t)"), text.replace(");", "\n\t);")):
        assert same(read_rpc_file(written(tmp_path, plain)), rpc)
    assert "its LINE_OFF is" in refused(tmp_path, text.replace("lineOffset = ", "lineOffset = 1 2 ").replace(";", ""))
    for name in ("LINE_OFF", "SAMP_SCALE"):
        assert name in str(rpc_tags(rpc))


@pytest.mark.parametrize("number", (1, 2))
def test_the_shared_rpb_without_semicolons(shared_data, number):
    rpc = read_rpc_file(str(shared_data / "cases" / "rpb_plain" / f"img{number}.rpb"))
    tags = gdal.Open(str(shared_data / "pleiades_triplet" / f"img_0{number}.tif")).GetMetadata("RPC")
    assert rpc.lat_off == pytest.approx(float(tags["LAT_OFF"])) and len(rpc.row_num) == 20
