"""Ortho-ready images: the exact model, and what is recognised as one, by the product's files or by its own numbers."""

from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.checks import Misfit
from repm_qgis.contracts.errors import RpcInvalidError
from repm_qgis.geometry.frames import projected_from_geodetic
from repm_qgis.geometry.map_plane import MapPlane
from repm_qgis.imagery.ortho_ready import OrthoReady
from repm_qgis.rpc.fit import fit_rpc
from repm_qgis.rpc.writers import rpb_text, rpc_tags
from repm_qgis.scene import View, load_view

HEIGHT = 240.0
TRANSFORM = (375000.0, 0.5, 0.0, 4829500.0, 0.0, -0.5)


@pytest.fixture
def map_image(tmp_path, write_image):
    """map_image(rpc, name, transform, crs): a GeoTIFF on a map with the RPC in a vendor's file beside it."""

    def make(rpc, name="image", transform=TRANSFORM, crs="EPSG:32631"):
        path = write_image(tmp_path / f"{name}.tif", np.arange(200 * 160, dtype=np.uint16).reshape(160, 200))
        dataset = gdal.Open(path, gdal.GA_Update)
        dataset.SetGeoTransform(transform)
        dataset.SetProjection(crs)
        dataset = None  # noqa: F841
        (tmp_path / f"{name}.RPB").write_text(rpb_text(rpc))
        return path

    return make


@pytest.fixture
def model(synthetic_rpc):
    return OrthoReady(synthetic_rpc(), MapPlane("EPSG:32631", TRANSFORM, HEIGHT, "test"))


def test_a_pixel_is_its_place_on_the_map_and_sees_along_the_rpcs_line(model):
    pixels = np.random.default_rng(1).uniform(0, 20_000, (400, 2))
    heights = np.random.default_rng(2).uniform(100, 900, 400)
    ground = model.localise(pixels, heights)
    assert np.abs(model.project(ground) - pixels).max() < 1e-6
    # GDAL's geotransform is that of the first pixel's corner, not of its middle.
    corner = projected_from_geodetic("EPSG:32631", model.plane.ground(np.array([-0.5, -0.5])))
    assert corner == pytest.approx([TRANSFORM[0], TRANSFORM[3]], abs=1e-6)
    on_plane = model.localise(pixels, HEIGHT)
    assert np.abs(model.plane.pixels(on_plane) - pixels).max() < 1e-6, "at the plane's height it is the map itself"
    assert np.abs(model.rpc.project(ground) - model.rpc.project(on_plane)).max() < 1e-6, "one line of sight"
    moved = np.abs((ground - on_plane)[:, :2]).max(axis=1) * 111_320
    assert moved.max() > 10, "which leans, or this test would show nothing"


def test_the_jacobian_of_one_place_serves_points_that_start_near_their_answer(synthetic_rpc, points_of):
    rpc = synthetic_rpc()
    ground = points_of(rpc, 3000)
    pixels = rpc.project(ground)
    near = ground[:, :2] + np.random.default_rng(3).normal(0, 2e-5, (3000, 2))  # 2 m
    found = rpc.localise(pixels, ground[:, 2], near=near)
    assert np.abs(found - rpc.localise(pixels, ground[:, 2])).max() < 1e-12
    assert np.isnan(rpc.localise(np.array([[np.nan, 1.0]]), 100.0, near=np.array([[1.4, 43.6]]))[0, 0])


def test_nothing_is_known_of_nothing(model):
    assert np.isnan(model.project(np.array([[np.nan, 43.6, 100.0]]))).all()
    assert np.isnan(model.localise(np.array([[np.nan, 1.0], [5.0, 5.0]]), 300.0)[0, :2]).all()


SAID = {
    "image.IMD": ('imageDescriptor = "ORStandard2A";\n\tterrainHAE = 240.00;\n', "'image.IMD'"),
    "image.XML": (
        "<isd><IMD><IMAGE><IMAGEDESCRIPTOR>ORStandard2A</IMAGEDESCRIPTOR></IMAGE><MAP_PROJECTED_PRODUCT>"
        "<TERRAINHAE>2.400e+02</TERRAINHAE><DEMCORRECTION>Base Elevation</DEMCORRECTION></MAP_PROJECTED_PRODUCT>"
        "</IMD></isd>",
        "'image.XML'",
    ),
    "DIM_image.XML": (
        "<Dimap_Document><Metadata_Identification><METADATA_PROFILE>PHR_PROJECTED</METADATA_PROFILE>"
        "</Metadata_Identification><Dataset_Content><Bounding_Polygon><Vertex><H>240</H></Vertex><Vertex><H>240</H>"
        "</Vertex></Bounding_Polygon></Dataset_Content></Dimap_Document>",
        "'DIM_image.XML'",
    ),
}


@pytest.mark.parametrize("name", SAID)
def test_the_vendors_files_say_the_height(tmp_path, map_image, synthetic_rpc, name):
    text, source = SAID[name]
    path = map_image(synthetic_rpc())
    (tmp_path / name).write_text(text)
    plane = load_view(path, height=77.0).plane
    assert (plane.height, plane.source) == (HEIGHT, source)
    assert plane.geotransform == TRANSFORM


def test_a_level_without_a_height_takes_the_option_and_else_the_rpcs_middle(tmp_path, map_image, synthetic_rpc):
    path = map_image(synthetic_rpc())
    (tmp_path / "image.XML").write_text("<ProductMetaData><ProductLevel>LEVEL2A</ProductLevel></ProductMetaData>")
    given, assumed = load_view(path, height=77.0).plane, load_view(path).plane
    assert (given.height, given.source) == (77.0, "ORTHO_READY_HEIGHT")
    assert (assumed.height, assumed.source) == (500.0, "")


def test_without_any_metadata_a_map_whose_rpc_sees_other_pixels_is_one(map_image, synthetic_rpc):
    assert load_view(map_image(synthetic_rpc())).plane is not None
    rough = (375000.0, 0.49, -0.1, 4829500.0, -0.1, -0.49)
    assert load_view(map_image(synthetic_rpc(), "rough", rough)).plane is None, "a sensor's image, roughly placed"
    assert load_view(map_image(synthetic_rpc(), "rough", rough), height=240.0).plane is not None


def test_an_rpc_of_the_projected_pixels_is_the_whole_model(map_image, model):
    own = fit_rpc(model.localise, (200, 160), (100.0, 900.0))
    assert own.max_px < 0.01
    view = load_view(map_image(own.rpc), height=77.0)
    assert view.plane is None and view.model == view.rpc
    corrected = load_view(map_image(own.rpc.shifted(-12.0, 7.0), "corrected"))
    assert corrected.plane is None, "corrected by somebody: its numbers count, not the map's"


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("DIM_image.XML", "<D><PROCESSING_LEVEL>ORTHO</PROCESSING_LEVEL></D>", "ORTHO in 'DIM_image.XML'"),
        ("image.IMD", 'imageDescriptor = "OrthoRectified3";\n', "OrthoRectified3 in 'image.IMD'"),
        ("image.IMD", 'imageDescriptor = "ORStandard2A";\nDEMCorrection = "Fine DEM";\n', "Fine DEM in 'image.IMD'"),
        ("image.XML", "<P><ProductLevel>LEVEL4</ProductLevel></P>", "LEVEL4 in 'image.XML'"),
    ],
)
def test_an_orthoimage_is_refused_with_the_reason(tmp_path, map_image, synthetic_rpc, name, text, word):
    path = map_image(synthetic_rpc())
    (tmp_path / name).write_text(text)
    with pytest.raises(RpcInvalidError) as caught:
        load_view(path, height=240.0)
    assert word in str(caught.value) and "lines of sight are lost" in str(caught.value)
    assert "order the Basic, Sensor or Primary level" in str(caught.value)


def test_heights_that_differ_are_no_plane(tmp_path, map_image, synthetic_rpc):
    path = map_image(synthetic_rpc())
    text = "<D><P>PHR_PROJECTED</P><Bounding_Polygon><H>240</H><H>300</H></Bounding_Polygon></D>"
    (tmp_path / "DIM_image.XML").write_text(text)
    assert load_view(path).plane.source == ""


def test_a_view_keeps_its_plane_in_the_scene(map_image, synthetic_rpc):
    view = load_view(map_image(synthetic_rpc()), height=HEIGHT)
    again = View.from_mapping(view.to_mapping())
    assert again.plane == view.plane and again.model == view.model
    turned = view.with_pointing(np.array([[1.0, 1e-5, 3.0], [0.0, 1.0, -2.0]]))
    pixels = np.array([[10.0, 20.0], [150.0, 90.0]])
    assert np.abs(turned.project(turned.localise(pixels, 300.0)) - pixels).max() < 1e-6
    assert np.abs(turned.project(view.localise(pixels, 300.0)) - pixels - [3.0, -2.0]).max() < 0.01


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"crs": "nonsense"}, "coordinate reference system"),
        ({"geotransform": [0, 1, 1, 0, 1, 1]}, "without an inverse"),
        ({"geotransform": [0, 1, 1]}, "6 entries"),
        ({"height": 1e6}, "between"),
    ],
)
def test_a_damaged_plane_is_refused(model, changed, word):
    with pytest.raises(Misfit, match=word):
        MapPlane.from_mapping({**model.plane.to_mapping(), **changed})


def test_images_of_one_rpc_on_different_parts_of_a_map_are_different(map_image, synthetic_rpc):
    one, other = (replace(load_view(map_image(synthetic_rpc(), n)), name=n) for n in ("a", "b"))
    assert one.model == other.model
    assert replace(other, plane=replace(other.plane, height=9.0)).model != one.model


def test_the_tags_of_the_image_itself_serve_too(tmp_path, map_image, synthetic_rpc):
    path = map_image(synthetic_rpc())
    (tmp_path / "image.RPB").unlink()
    dataset = gdal.Open(path, gdal.GA_Update)
    dataset.SetMetadata(rpc_tags(synthetic_rpc()), "RPC")
    dataset = None  # noqa: F841
    assert load_view(path, height=HEIGHT).plane.height == HEIGHT
