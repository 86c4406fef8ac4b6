"""Which satellite took an image: real names and metadata of products, nonsense, and the table's rows."""

from __future__ import annotations

import pytest
from osgeo import gdal

from repm_qgis.imagery.acquisition import sensor_of
from repm_qgis.imagery.raster import opened
from repm_qgis.imagery.sensors import SENSORS, sensor_in, sensor_named


def of(path, **items):
    """The satellite of an image of this name; ``items`` are metadata by domain."""
    dataset = gdal.GetDriverByName("MEM").Create("", 4, 4, 1)
    for domain, values in items.items():
        for key, value in values.items():
            dataset.SetMetadataItem(key, value, "" if domain == "plain" else domain)
    return sensor_of(dataset, str(path))


def test_rows_have_a_source_for_every_figure_and_a_name_of_their_own():
    assert len({sensor.name for sensor in SENSORS}) == len(SENSORS) >= 25
    for sensor in SENSORS:
        assert sensor_in(sensor.name) == sensor.name and sensor_named(sensor.name) is sensor
        figures = [figure for figure in (sensor.ce90_m, sensor.le90_m) if figure is not None]
        assert bool(figures) == bool(sensor.source) and all(1.0 <= figure <= 200.0 for figure in figures)
    assert sensor_named("") is None


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("PHR1B_P_201709281038045_SEN_PRG_FC_178608-001", "Pleiades 1B"),
        ("IMG_PHR1A_P_201304171037198_SEN_616226101-001_R1C1", "Pleiades 1A"),
        ("img_spot7_pms_201605071041566_sen", "SPOT 7"),
        ("IMG_SPOT6_MS_201308032015087_SEN_1_R1C1", "SPOT 6"),
        ("IMG_PNEO4_202108211102379_PAN_SEN", "Pleiades Neo"),
        ("18DEC15WV031200015DEC18140510-P1BS-500515572020_01_P001", "WorldView-3"),
        ("WV01_20150101_102001003A", "WorldView-1"),
        ("QB02", "QuickBird"),
        ("GE01", "GeoEye-1"),
        ("20191015_073816_ssc1d3_0011_basic_l1a_panchromatic_dn", "SkySat"),
        ("20170831_172754_101c_1B_AnalyticMS", "PlanetScope"),
        ("ZY3_01a_hsnbavp_001129_20120803_105403_0008_SASMAC", "ZY-3"),
        ("ZY302_TMS_E118.9_N36.7_20170410_L1A0000012345", "ZY-3"),
        ("GF7_DLC_E118.9_N36.7_20200410_L1A0000012345", "GF-7"),
        ("GF701_001234_E113.0_N34.1_20200617_BWD_01_SC0_0006111_L1A", "GF-7"),
        ("SV1-01_20180325_L1B0000400555_1109180058110_01-PAN", "SuperView-1"),
        ("TRIPLESAT_1_PAN_L1_20160415", "TripleSat"),
        ("K3A_20170216121345_10567_09581167_L1R_P", "KOMPSAT-3A"),
        ("K3_20130216121345_10567_09581167_L1R_P", "KOMPSAT-3"),
        ("ALPSMN123452895", "ALOS PRISM"),
        ("CARTOSAT-1 PAN-F", "Cartosat-1"),
        # No satellites.
        ("img_01", ""),
        ("", ""),
        ("JAX_068_001_RGB", ""),
        ("aerial_HWV01", ""),
        ("SPOT 66", ""),
        ("ZY1E", ""),
        ("passc1d3_0011", ""),
        ("x" * 9000 + " WV03", ""),
    ],
)
def test_names_of_products(text, name):
    assert sensor_in(text) == name
    assert of(f"/nowhere/{text[:99]}.tif") == name


@pytest.mark.parametrize(
    ("image", "file", "text", "name"),
    [
        (
            "IMG_01_R1C1.tif",
            "DIM_01.XML",
            "<D><MISSION>PHR</MISSION><MISSION_INDEX>1A</MISSION_INDEX></D>",
            "Pleiades 1A",
        ),
        ("IMG_01_R1C1.tif", "DIM_01.XML", "<D><MISSION>SPOT</MISSION><MISSION_INDEX>5</MISSION_INDEX></D>", "SPOT 5"),
        ("a.tif", "A.imd", 'BEGIN_GROUP = IMAGE_1\n\tsatId = "WV02";\nEND_GROUP = IMAGE_1', "WorldView-2"),
        ("a.tif", "a.XML", "<isd><IMD><IMAGE><SATID>GE01</SATID></IMAGE></IMD></isd>", "GeoEye-1"),
        ("a.tif", "a.xml", "<ProductMetaData><SatelliteID>GF7</SatelliteID></ProductMetaData>", "GF-7"),
        ("a.tif", "a.geom", "sensor:  PHR 1B\nsize: 4", "Pleiades 1B"),
        ("a.tif", "a.IMD", "satId = ;", ""),
        ("a.tif", "a.XML", '<!DOCTYPE a [<!ENTITY b "WV02">]><a><SATID>&b;</SATID></a>', ""),
        ("a.tif", "a.XML", "<a><SATID>WV02", ""),
        ("a.tif", "a.XML", "<a><note>compared with WV02</note></a>", ""),
        ("a.tif", "a.IMD", "\0\1\2", ""),
    ],
)
def test_files_of_the_product(tmp_path, image, file, text, name):
    (tmp_path / file).write_text(text)
    assert of(tmp_path / image) == name
    if name:  # the product's file is believed before the image's own name
        (tmp_path / file).rename(
            tmp_path / file.replace("01", "PHR1B").replace("a.", "QB02_a.").replace("A.", "QB02_a.")
        )
        assert of(tmp_path / image.replace("01", "PHR1B").replace("a.", "QB02_a.")) == name


def test_metadata():
    assert of("a.tif", IMAGERY={"SATELLITEID": "PHR 1A"}) == "Pleiades 1A"
    assert (
        of("a.ntf", plain={"NITF_FTITLE": "05OCT14WV031100014OCT05160138-M1BS-500648062040_01_P001"}) == "WorldView-3"
    )
    assert of("a.tif", plain={"gml.root-instance": "<x id='DS_PHR1B_201306290637144_FR1_PX'/>"}) == "Pleiades 1B"
    assert of("a.tif", plain={"TIFFTAG_SOFTWARE": "for WV03"}) == ""
    assert of("a.tif", plain={"MISSION": "PHR", "MISSION_INDEX": "1B"}) == "Pleiades 1B"
    assert of("a.tif", plain={"MISSION": "PHR"}) == of("a.tif", plain={"MISSION_INDEX": "1B"}) == ""


def test_real_files(shared_data, tmp_path, write_image):
    other = shared_data / "rpc" / "other"
    (tmp_path / "a.XML").write_bytes((other / "rpc_WV2.xml").read_bytes())
    (tmp_path / "b.geom").write_bytes((other / "PHR1B_P_201709281038045_SEN_PRG_FC_178608-001.geom").read_bytes())
    places = {
        str(tmp_path / "a.tif"): "WorldView-2",
        str(tmp_path / "b.tif"): "Pleiades 1B",
        str(shared_data / "jax_068" / "JAX_068_001_RGB.tif"): "WorldView-3",
        str(shared_data / "pleiades_pair" / "img_01.tif"): "Pleiades 1B",
        str(shared_data / "pleiades_triplet" / "img_03.tif"): "Pleiades 1A",
        str(shared_data / "pleiades_two_dates" / "post_event_img2.tif"): "Pleiades 1B",
        str(shared_data / "pleiades_two_dates" / "pre_event_img1.tif"): "",
        str(shared_data / "truth_urban" / "img_01.tif"): "",
        str(other / "wv3_20.NTF"): "",
    }
    for name in ("a.tif", "b.tif"):
        write_image(tmp_path / name)
    for path, name in places.items():
        with opened(path) as dataset:
            assert sensor_of(dataset, path) == name, path
    names = sorted(path.name for path in (shared_data / "rpc" / "pleiades").glob("*.XML"))
    assert len(names) > 30 and {sensor_in(name) for name in names} == {"Pleiades 1A"}
