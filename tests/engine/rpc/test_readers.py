"""Finding RPCs in what vendors deliver, and saying no to what is none."""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import RpcError, RpcInvalidError, RpcMissingError
from repm_qgis.imagery.raster import opened
from repm_qgis.rpc import readers
from repm_qgis.rpc.formats import rpc_from_texts
from repm_qgis.rpc.readers import files_in_folder, read_rpc_file, rpc_of
from repm_qgis.rpc.writers import rpc_tags
from tests.engine.rpc.writers import key_value


def read(path):
    with opened(str(path)) as dataset:
        return rpc_of(dataset, str(path))


def close(a, b):
    """Whether two RPCs are the same to the digits that text formats keep."""
    for name in (each.name for each in fields(a) if each.compare):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-9, atol=1e-12)


def rpc_txt(rpc):
    """The _RPC.TXT of IKONOS and many after it, with units."""
    units = {"LINE": "pixels", "SAMP": "pixels", "LAT": "degrees", "LONG": "degrees", "HEIGHT": "meters"}
    tags = rpc_tags(rpc)
    lines = [f"{k}_{e}: {float(tags[f'{k}_{e}']):+.12f} {u}" for e in ("OFF", "SCALE") for k, u in units.items()]
    for name in ("LINE_NUM", "LINE_DEN", "SAMP_NUM", "SAMP_DEN"):
        lines += [f"{name}_COEFF_{i}: {float(v):+.15E}" for i, v in enumerate(tags[f"{name}_COEFF"].split(), start=1)]
    return "\n".join(lines) + "\n"


def rpb(rpc):
    """DigitalGlobe's .RPB."""
    tags = rpc_tags(rpc)
    text = 'satId = "WV01";\nbandId = "P";\nSpecId = "RPC00B";\n'
    text += "BEGIN_GROUP = IMAGE\n\terrBias = 1.0;\n\terrRand = 0.5;\n"
    for ours, theirs in (("LINE", "line"), ("SAMP", "samp"), ("LAT", "lat"), ("LONG", "long"), ("HEIGHT", "height")):
        text += f"\t{theirs}Offset = {float(tags[f'{ours}_OFF']):.12f};\n"
        text += f"\t{theirs}Scale = {float(tags[f'{ours}_SCALE']):.12f};\n"
    for ours, theirs in (
        ("LINE_NUM", "lineNum"),
        ("LINE_DEN", "lineDen"),
        ("SAMP_NUM", "sampNum"),
        ("SAMP_DEN", "sampDen"),
    ):
        values = ",\n".join(f"\t\t\t{float(v):+.15E}" for v in tags[f"{ours}_COEFF"].split())
        text += f"\t{theirs}Coef = (\n{values});\n"
    return text + "END_GROUP = IMAGE\nEND;\n"


def dimap(rpc, height_off=None, head=""):
    """Airbus's RPC_*.XML: pixels count from 1, and the direct model's polynomials come first."""
    tags = rpc_tags(rpc)
    body = "".join(
        f"<{name}_COEFF_{i}>{value}</{name}_COEFF_{i}>\n"
        for name in ("SAMP_NUM", "SAMP_DEN", "LINE_NUM", "LINE_DEN")
        for i, value in enumerate(tags[f"{name}_COEFF"].split(), start=1)
    )
    direct = "".join(
        f"<{name}_COEFF_{i}>{0.5 + i}</{name}_COEFF_{i}>\n"
        for name in ("SAMP_NUM", "SAMP_DEN", "LINE_NUM", "LINE_DEN")
        for i in range(1, 21)
    )
    numbers = {
        f"{k}_{e}": tags[f"{k}_{e}"] for k in ("LONG", "LAT", "HEIGHT", "SAMP", "LINE") for e in ("SCALE", "OFF")
    }
    numbers["SAMP_OFF"] = repr(float(numbers["SAMP_OFF"]) + 1)
    numbers["LINE_OFF"] = repr(float(numbers["LINE_OFF"]) + 1)
    if height_off is not None:
        numbers["HEIGHT_OFF"] = height_off
    validity = "".join(f"<{name}>{value}</{name}>\n" for name, value in numbers.items())
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n{head}<Dimap_Document><Rational_Function_Model><Global_RFM>'
        f"<Direct_Model>{direct}</Direct_Model><Inverse_Model>{body}</Inverse_Model><RFM_Validity>"
        f"<Direct_Model_Validity_Domain><FIRST_ROW>1</FIRST_ROW></Direct_Model_Validity_Domain>{validity}"
        "</RFM_Validity></Global_RFM></Rational_Function_Model></Dimap_Document>"
    )


def test_geotiff_tags(tmp_path, write_image, synthetic_rpc):
    rpc = synthetic_rpc()
    close(read(write_image(tmp_path / "a.tif", rpc=rpc)), rpc)


@pytest.mark.parametrize("name, text", (("a_RPC.TXT", rpc_txt), ("a_rpc.txt", rpc_txt), ("a.RPB", rpb)))
def test_sidecars_of_gdal(tmp_path, write_image, synthetic_rpc, name, text):
    rpc = synthetic_rpc()
    image = write_image(tmp_path / "a.tif")
    (tmp_path / name).write_text(text(rpc))
    close(read(image), rpc)


@pytest.mark.parametrize(
    "image, xml",
    (
        ("IMG_PHR1A_P_2012_SEN_9_R1C1.TIF", "RPC_PHR1A_P_2012_SEN_9.XML"),
        ("img_phr1a_p_2012_r1c1.tif", "RPC_phr1a_p_2012.xml"),
        ("scene.tif", "scene_RPC.XML"),
        ("scene.tif", "scene.xml"),
        ("scene.tif", "RPC_scene.XML"),
    ),
)
def test_airbus_xml_beside_the_image(tmp_path, write_image, synthetic_rpc, image, xml):
    rpc = synthetic_rpc()
    write_image(tmp_path / image)
    (tmp_path / xml).write_text(dimap(rpc))
    close(read(tmp_path / image), rpc)


def test_another_images_xml_is_not_taken(tmp_path, write_image, synthetic_rpc):
    image = write_image(tmp_path / "IMG_PHR1A_1_R1C1.TIF")
    (tmp_path / "RPC_PHR1A_2.XML").write_text(dimap(synthetic_rpc()))
    with pytest.raises(RpcMissingError):
        read(image)


def test_real_sidecars(shared_data, tmp_path, write_image):
    """Every vendor's file gives a model that can go from its image to the ground and back."""
    other = shared_data / "rpc" / "other"
    for number, (source, target) in enumerate(
        (
            ("20191015_073816_ssc1d3_0011_basic_l1a_panchromatic_dn_RPC.TXT", "a_RPC.TXT"),
            ("rpc_IKONOS.txt", "a_rpc.txt"),
            ("rpc_PLANET_L1A.txt", "a_RPC.TXT"),
            ("rpc_PLANET_L1B.txt", "a_RPC.TXT"),
            ("rpc_SPOT6.xml", "RPC_a.XML"),
            ("rpc_WV2.xml", "a.XML"),
            ("RPC_PHR1B_P_201709281038045_SEN_PRG_FC_178608-001.XML", "RPC_a.XML"),
        )
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        image = write_image(folder / "a.tif")
        shutil.copy(other / source, folder / target)
        rpc = read(image)
        unit = np.random.default_rng(3).uniform(-0.9, 0.9, (50, 2))
        pixels = unit * [rpc.col_scale, rpc.row_scale] + [rpc.col_off, rpc.row_off]
        ground = rpc.localise(pixels, rpc.height_off)
        assert np.abs(ground[:, 0] - rpc.lon_off).max() <= 1.2 * abs(rpc.lon_scale), source
        assert np.abs(ground[:, 1] - rpc.lat_off).max() <= 1.2 * abs(rpc.lat_scale), source
        assert np.abs(rpc.project(ground) - pixels).max() < 1e-6, source


def test_pleiades_xml_and_ossim_geom_are_the_same_model(shared_data):
    """OSSIM's file of the same scene, written by other software that counts from 0 too."""
    other = shared_data / "rpc" / "other"
    rpc = read_rpc_file(str(other / "RPC_PHR1B_P_201709281038045_SEN_PRG_FC_178608-001.XML"))
    geom = dict(
        line.split(":", 1)
        for line in (other / "PHR1B_P_201709281038045_SEN_PRG_FC_178608-001.geom").read_text().splitlines()
        if ":" in line
    )
    assert (rpc.row_off, rpc.col_off) == (float(geom["line_off"]), float(geom["samp_off"]))
    assert rpc.lat_off == pytest.approx(float(geom["lat_off"]), abs=1e-9)
    for i in range(20):
        assert rpc.row_num[i] == pytest.approx(float(geom[f"line_num_coeff_{i:02d}"]), rel=1e-9)
        assert rpc.col_den[i] == pytest.approx(float(geom[f"samp_den_coeff_{i:02d}"]), rel=1e-9)


@pytest.mark.parametrize("head", ("<!DOCTYPE a>", '<!DOCTYPE a [<!ENTITY b "c">]>'))
def test_doctype_and_entities_are_refused(tmp_path, write_image, synthetic_rpc, head):
    image = write_image(tmp_path / "a.tif")
    (tmp_path / "RPC_a.XML").write_text(dimap(synthetic_rpc(), head=head))
    with pytest.raises(RpcInvalidError, match="declares a DOCTYPE or entities"):
        read(image)


def test_xml_of_another_kind_is_passed_over(tmp_path, write_image):
    image = write_image(tmp_path / "a.tif")
    for text in ("<PAMDataset></PAMDataset>", "no xml at all", "", "<a><b></a>"):
        (tmp_path / "a.xml").write_text(text)
        with pytest.raises(RpcInvalidError):
            read_rpc_file(str(tmp_path / "a.xml"))
        with pytest.raises(RpcMissingError):
            read(image)


def test_missing_rpc_lists_the_places(tmp_path, write_image):
    image = write_image(tmp_path / "scene.tif")
    (tmp_path / "scene.xml").write_text("<a/>")
    with pytest.raises(RpcMissingError) as caught:
        read(image)
    text = str(caught.value)
    for words in (
        image,
        "GTiff metadata",
        ".RPB",
        "_RPC.TXT",
        "scene.xml",
        "Put the vendor's RPC file into the image's folder",
    ):
        assert words in text


def test_projected_product_has_its_own_sentence(tmp_path, write_image):
    image = write_image(tmp_path / "ortho.tif", crs="EPSG:32631")
    with pytest.raises(RpcMissingError) as caught:
        read(image)
    assert "already projected to a map" in str(caught.value)
    assert "order the Basic, Sensor or Primary" in str(caught.value)
    assert "Looked in" not in str(caught.value)


@pytest.mark.parametrize(
    "key, value, words",
    (
        ("LINE_SCALE", "0", "row scale is 0.0"),
        ("LAT_OFF", "nan", "lat offset is nan"),
        ("HEIGHT_SCALE", "0.0 meters", "height scale is 0.0"),
        ("LONG_OFF", "east", "LONG_OFF is 'east', which is not a number"),
        ("SAMP_DEN_COEFF", " ".join(["0"] * 20), "col_den has only zero coefficients"),
        ("SAMP_NUM_COEFF", " ".join(["1"] * 19), "col_num has 19 coefficients"),
        ("LINE_NUM_COEFF", " ".join(["1"] * 19 + ["nan"]), "row_num has a coefficient that is not a finite number"),
    ),
)
def test_wrong_numbers_name_the_file_and_the_value(tmp_path, write_image, synthetic_rpc, key, value, words):
    image = write_image(tmp_path / "a.tif", rpc=synthetic_rpc(), tags={key: value})
    tags = {**rpc_tags(synthetic_rpc()), key: value}
    with pytest.raises(RpcInvalidError) as caught:
        rpc_from_texts(tags)
    assert words in str(caught.value)
    if value == "east":
        return  # the GeoTIFF tag holds numbers only
    with pytest.raises((RpcInvalidError, RpcMissingError)) as caught:
        read(image)
    assert image in str(caught.value)


@pytest.mark.parametrize(("key", "name"), (("LINE_SCALE", "row"), ("SAMP_SCALE", "column")))
def test_a_wrong_sign_does_not_mirror_the_image(tmp_path, write_image, synthetic_rpc, key, name):
    image = write_image(tmp_path / "a.tif", rpc=synthetic_rpc(), tags={key: "-5000"})
    with pytest.raises(RpcInvalidError, match=f"its {name} scale is -5000: it must be above zero"):
        read(image)


@pytest.mark.parametrize("key", ("LINE_OFF", "SAMP_NUM_COEFF", "HEIGHT_SCALE"))
@pytest.mark.parametrize("change", ("drop", "empty"))
def test_missing_members_are_named(synthetic_rpc, key, change):
    tags = rpc_tags(synthetic_rpc())
    if change == "drop":
        del tags[key]
    else:
        tags[key] = " "
    with pytest.raises(RpcInvalidError):
        rpc_from_texts(tags)


def test_an_xml_with_nan_or_nothing_for_a_number(tmp_path, write_image, synthetic_rpc):
    image = write_image(tmp_path / "a.tif")
    for value in ("NaN", "", "tall"):
        (tmp_path / "RPC_a.XML").write_text(dimap(synthetic_rpc(), height_off=value))
        with pytest.raises(RpcInvalidError) as caught:
            read(image)
        assert "a.tif" in str(caught.value) and "Get the file again" in str(caught.value)


@pytest.mark.parametrize("tile", ("R1C2", "R2C1", "R3C3"))
def test_a_further_tile_of_a_cut_product_does_not_get_the_whole_images_rpc(tmp_path, write_image, synthetic_rpc, tile):
    """Airbus cuts large products into R1C1, R1C2...: only the first tile's pixels are the RPC's pixels."""
    image = write_image(tmp_path / f"IMG_PHR1A_P_2012_{tile}.TIF")
    (tmp_path / "RPC_PHR1A_P_2012.XML").write_text(dimap(synthetic_rpc()))
    with pytest.raises((RpcMissingError, RpcInvalidError)):
        read(image)


def differing(rpc, terms):
    """The RPC with columns that are off by so many px for each unit of some of RPC00B's terms (1 L, 2 P, 3 H, 10 PLH).

    Its denominators are 1, so that the differences are these to the digit.
    """
    flat = (1.0,) + (0.0,) * 19
    base = type(rpc)(**{**vars(rpc), "col_den": flat, "row_den": flat})
    moved = tuple(value + terms.get(i, 0.0) / rpc.col_scale for i, value in enumerate(base.col_num))
    return base, type(rpc)(**{**vars(base), "col_num": moved})


@pytest.mark.parametrize(
    "terms, most",
    (
        ({1: 1.0}, 0.6),  # linear in one direction: half a unit and the shear of rows and columns
        ({1: -1.0}, 0.6),
        ({2: 1.0}, 0.6),
        ({3: 1.0}, 0.5),
        ({10: 1.0}, 0.15),  # only the corners in all three directions differ
        ({2: 1.0, 3: 1.0}, 1.1),  # where height and row grow together, they cancel
        ({2: 1.0, 3: -1.0}, 1.1),
    ),
)
def test_two_files_may_differ_by_half_a_pixel_in_the_middle_half_of_the_model(synthetic_rpc, terms, most):
    """Differences are measured up to half of the normalisers in each direction, corners included."""
    for factor, agree in ((0.4 / most, True), (0.7 / most, False)):
        rpc, other = differing(synthetic_rpc(), {term: factor * value for term, value in terms.items()})
        if agree:
            readers._require_agreement("a", rpc, "b", other)
        else:
            with pytest.raises(RpcInvalidError, match="a and b differ by"):
                readers._require_agreement("a", rpc, "b", other)


@pytest.mark.parametrize("moved", ((100, 0), (0, 30), (0, 1)))
def test_a_crop_that_begins_at_a_border_is_one(tmp_path, write_image, synthetic_rpc, moved):
    rpc = synthetic_rpc()
    image = write_image(tmp_path / "a.tif", rpc=rpc.shifted(*moved))
    (tmp_path / "a_RPC.TXT").write_text(key_value(rpc))
    close(read(image), rpc.shifted(*moved))


@pytest.mark.parametrize("moved", ((-100, 0), (0, -30), (100.4, 0), (0.2, 40)))
def test_what_is_no_shift_by_whole_pixels_to_the_right_and_down_is_another_model(
    tmp_path, write_image, synthetic_rpc, moved
):
    rpc = synthetic_rpc()
    image = write_image(tmp_path / "a.tif", rpc=rpc.shifted(*moved))
    (tmp_path / "a_RPC.TXT").write_text(key_value(rpc))
    with pytest.raises(RpcInvalidError, match="differ by"):
        read(image)


@pytest.mark.parametrize(
    "transform, moved, step",
    (
        ((200.0, 1.0, 0.0, 100.0, 0.0, 1.0), (200.0, 100.0), (1.0, 1.0)),
        ((200.0, 1.0, 0.0, -100.0, 0.0, -1.0), (200.0, 100.0), (1.0, 1.0)),
        ((0.0, 1.0, 0.0, 100.0, 0.0, 1.0), (0.0, 100.0), (1.0, 1.0)),
        ((200.0, 2.0, 0.0, 100.0, 0.0, 2.0), (200.0, 100.0), (2.0, 2.0)),
        ((200.0, 2.0, 0.0, -100.0, 0.0, -2.0), (200.0, 100.0), (2.0, 2.0)),
        ((200.0, 1.0, 0.0, 100.0, 0.0, 0.5), (200.0, 100.0), (1.0, 0.5)),
        ((1.44, 4.5e-6, 0.0, 43.6, 0.0, -4.5e-6), (0.0, 0.0), (1.0, 1.0)),  # degrees of a world file,
        ((-0.5, 1.0, 0.0, 100.0, 0.0, 1.0), (0.0, 0.0), (1.0, 1.0)),  # or outside
        ((200.0, 1.0, 0.0, -0.5, 0.0, 1.0), (0.0, 0.0), (1.0, 1.0)),
        ((900.0, 1.0, 0.0, 100.0, 0.0, 1.0), (0.0, 0.0), (1.0, 1.0)),
    ),
)
def test_which_geotransforms_count_pixels(tmp_path, write_image, synthetic_rpc, transform, moved, step):
    """A pixel of steps of 2 is the mean of 2 x 2: its centre is that of their common corner."""
    rpc = synthetic_rpc(col_off=449.0, col_scale=450.0, row_off=349.0, row_scale=350.0)
    found = read(placed(write_image(tmp_path / "a.tif"), transform, rpc))
    whole = np.array([[230.5, 140.5], [300.0, 200.0]])
    ground = rpc.localise(whole, 500.0)
    wanted = (whole - moved - (np.array(step) - 1) / 2) / step
    assert np.abs(found.project(ground) - wanted).max() < 1e-6


def placed(image, transform, rpc):
    """An image that gets a geotransform, and an RPC file beside it."""
    dataset = gdal.Open(image, gdal.GA_Update)
    dataset.SetGeoTransform(transform)
    dataset = None  # noqa: F841
    Path(image).with_name("a_RPC.TXT").write_text(key_value(rpc))
    return image


@pytest.mark.parametrize("origin", ((0.0, 0.0), (60.0, 100.0)))
@pytest.mark.parametrize("step", (2.0, 0.5))
def test_an_rpc_that_was_made_for_the_crop_already_is_not_changed_twice(
    tmp_path, write_image, synthetic_rpc, origin, step
):
    """The image of 80 x 100 px is all of what the RPC describes from the origin on, at another step."""
    size = np.array(origin) + step * np.array([80, 100])
    whole = synthetic_rpc(
        col_off=(size[0] - 1) / 2, col_scale=(size[0] - 1) / 2, row_off=(size[1] - 1) / 2, row_scale=(size[1] - 1) / 2
    )
    transform = (origin[0], step, 0.0, origin[1], 0.0, step)
    scaled = whole.shifted(*origin).resampled(step, step)
    for number, rpc in enumerate((whole, whole.shifted(*origin), scaled)):
        folder = tmp_path / str(number)
        folder.mkdir()
        close(read(placed(write_image(folder / "a.tif"), transform, rpc)), scaled)


def test_a_window_that_the_rpc_cannot_have_is_refused(tmp_path, write_image, synthetic_rpc):
    rpc = synthetic_rpc(col_off=149.0, col_scale=150.0, row_off=149.0, row_scale=150.0)
    for transform, words in (
        ((200.0, 2.0, 0.0, 100.0, 0.0, 2.0), "puts its end at column 360, row 300 of an image .* for 300 x 300 px"),
        ((100.0, 1.0, 0.1, 100.0, 0.0, 1.0), "along rotated axes"),
        ((100.0, 1.0, 0.0, 100.0, 0.1, 1.0), "along rotated axes"),
    ):
        with pytest.raises(RpcInvalidError, match=words):
            read(placed(write_image(tmp_path / "a.tif"), transform, rpc))


def test_pixel_coordinates_without_a_crs_are_no_map(tmp_path, write_image):
    image = write_image(tmp_path / "a.tif")
    dataset = gdal.Open(image, gdal.GA_Update)
    dataset.SetGeoTransform((200.0, 1.0, 0.0, 100.0, 0.0, 1.0))
    dataset = None  # noqa: F841
    with pytest.raises(RpcMissingError, match="No RPC found"):
        read(image)


def test_folders_and_files_that_cannot_be_read_have_nothing(tmp_path, monkeypatch):
    (tmp_path / "A.XML").write_text("x")
    both = ["A.XML"] if (tmp_path / "a.xml").exists() else ["A.XML", "a.xml"]  # on Windows and macOS they are one file
    (tmp_path / "a.xml").write_text("x")
    (tmp_path / "folder.xml").mkdir()
    assert files_in_folder(tmp_path / "a.tif") == {"a.xml": both}
    assert files_in_folder(tmp_path / "nowhere" / "a.tif") == {}
    assert not readers._is_image(str(tmp_path / "a.xml"))

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(readers, "open", refuse, raising=False)
    assert not readers._is_image(str(tmp_path / "a.xml"))


def test_a_damaged_sidecar_is_the_same_sentence_where_gdal_raises_exceptions(write_image, tmp_path):
    path = write_image(tmp_path / "a.tif")
    (tmp_path / "a_RPC.TXT").write_text("LINE_OFF: 1\n")
    said = []
    before = gdal.GetUseExceptions()
    for choose in (gdal.UseExceptions, gdal.DontUseExceptions):
        choose()
        try:
            with opened(str(path)) as dataset:
                rpc_of(dataset, str(path))
        except RpcError as error:
            said.append(str(error))
    (gdal.UseExceptions if before else gdal.DontUseExceptions)()
    assert len(said) == 2 and said[0] == said[1] and "a_RPC.TXT" in said[0]
