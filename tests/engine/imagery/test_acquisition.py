"""When images were taken: every place where it may stand, and nonsense in each of them."""

from __future__ import annotations

from datetime import datetime, timezone

import pytest
from osgeo import gdal

from repm_qgis.imagery.acquisition import acquired, duration_text, moment, time_of_name, time_sidecars
from repm_qgis.imagery.raster import opened

DIM = """<?xml version="1.0"?><Dimap_Document><Dataset_Sources><Source_Identification><Strip_Source>
<IMAGING_DATE>2013-04-17</IMAGING_DATE><IMAGING_TIME>10:37:19.8Z</IMAGING_TIME></Strip_Source></Source_Identification>
</Dataset_Sources></Dimap_Document>"""
NEO = """<Dimap_Document><Geometric_Data><Refined_Model><Time><Time_Range><START>2021-08-21T11:02:37.912Z</START>
<END>2021-08-21T11:02:39.1Z</END></Time_Range></Time></Refined_Model></Geometric_Data></Dimap_Document>"""
IMD = """version = "R";
generationTime = 2015-10-01T12:01:14.000000Z;
BEGIN_GROUP = IMAGE_1
\tfirstLineTime = 2015-09-30T10:56:56.973685Z;
\tTLCTime = 2015-09-30T10:56:57.204388Z;
END_GROUP = IMAGE_1
END;
"""


def of(path, **items):
    """What is found for an image of this name; ``items`` are metadata by domain."""
    dataset = gdal.GetDriverByName("MEM").Create("", 4, 4, 1)
    for domain, values in items.items():
        for key, value in values.items():
            dataset.SetMetadataItem(key, value, "" if domain == "plain" else domain)
    return acquired(dataset, str(path))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2013-04-17T10:37:19.8Z", (2013, 4, 17, 10, 37, 19, 800000)),
        ("2013-04-17 10:37:19", (2013, 4, 17, 10, 37, 19)),
        ("2013-04-17T10:37Z", (2013, 4, 17, 10, 37, 0)),
        ("2013-04-17T12:37:19+02:00", (2013, 4, 17, 10, 37, 19)),
        ("2003-10-17T23:30:30-0700", (2003, 10, 18, 6, 30, 30)),
        ("201202250024153", (2012, 2, 25, 0, 24, 15, 300000)),
        ("20150930105657", (2015, 9, 30, 10, 56, 57)),
        ("30105657ZSEP15", (2015, 9, 30, 10, 56, 57)),
        ("30105657ZSEP99", (1999, 9, 30, 10, 56, 57)),
        ("2015-09-30T10:56:56.973685123Z", (2015, 9, 30, 10, 56, 56, 973685)),
    ],
)
def test_times_of_all_spellings(text, expected):
    assert moment(text) == datetime(*expected, tzinfo=timezone.utc)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "unknown",
        "2013-02-30T10:00:00Z",
        "2013-04-17T25:00:00Z",
        "20130417",
        "--------------",
        "1066-10-14T10:00:00Z",
        "2013-04-17T10:37:19Z" * 9,
        "\u0662\u0660\u0661\u0663-04-17T10:37:19Z",
        "00000000000000",
        "30105657ZXYZ15",
        "9999-12-31T23:59:59-23:59",
        "0001-01-01T00:00:00+23:59",
    ],
)
def test_nonsense_is_unknown(text):
    assert moment(text) is None


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("PHR1B_P_201709281038045_SEN_PRG_FC_178608-001", "2017-09-28T10:38:04.500"),
        ("IMG_PHR1A_P_201304171037198_SEN_616226101-001_R1C1", "2013-04-17T10:37:19.800"),
        ("img_spot7_pms_201605071041566_sen", "2016-05-07T10:41:56.600"),
        ("IMG_PNEO4_202108211102379_PAN_SEN", "2021-08-21T11:02:37.900"),
        ("14AUG06082955-P1BS-059339054010_01_P001", "2014-08-06T08:29:55.000"),
        ("18DEC15WV031200015DEC18140510-P1BS-500515572020_01_P001", "2015-12-18T14:05:10.000"),
        ("20191015_073816_ssc1d3_0011_basic_l1a_panchromatic_dn", "2019-10-15T07:38:16.000"),
        ("20170831_172754_101c_1B_AnalyticMS", "2017-08-31T17:27:54.000"),
        ("BSG_20200101T101010Z_x", "2020-01-01T10:10:10.000"),
        # Local times, dates alone, times that are not there, and numbers that are no times.
        ("ZY3_01a_hsnbavp_001129_20120803_105403_0008_SASMAC", None),
        ("GF7_DLC_E118.9_N36.7_20200410_L1A0000012345", None),
        ("PHR1B_P_201799281038045_SEN", None),
        ("img_01", None),
        ("crop_20200101T101010", None),
        ("12345678901234567", None),
    ],
)
def test_names_of_products(name, expected):
    found = of(f"/nowhere/{name}.tif")
    assert found == (f"{expected}Z" if expected else "")
    assert bool(moment(time_of_name(f"{name}.tif"))) == bool(expected)


def test_files_of_the_product_come_first(tmp_path):
    image = tmp_path / "IMG_PHR1A_P_201304171037198_SEN_616226101-001_R1C2.TIF"
    assert of(image) == "2013-04-17T10:37:19.800Z" and time_sidecars(str(image)) == []
    dim = tmp_path / "DIM_PHR1A_P_201304171037198_SEN_616226101-001.XML"
    dim.write_text(DIM.replace("2013-04-17", "2014-05-18"))
    assert time_sidecars(str(image)) == [str(dim)]
    assert of(image, IMAGERY={"ACQUISITIONDATETIME": "2001-01-01 10:00:00"}) == "2014-05-18T10:37:19.800Z"
    dim.write_text(DIM.replace("IMAGING_DATE", "SOMETHING"))
    assert of(image, IMAGERY={"ACQUISITIONDATETIME": "2001-01-01 10:00:00"}) == "2001-01-01T10:00:00.000Z"


@pytest.mark.parametrize(
    ("image", "file", "text", "expected"),
    [
        ("IMG_01_PNEO4_P_R1C1.tif", "DIM_01_PNEO4.XML", NEO, "2021-08-21T11:02:37.912Z"),
        ("a.tif", "A.imd", IMD, "2015-09-30T10:56:56.973Z"),
        ("a.tif", "a.IMD", IMD.replace("firstLineTime", "x"), "2015-09-30T10:56:57.204Z"),
        (
            "a.ntf",
            "a.XML",
            "<isd><IMD><IMAGE><TLCTIME>2015-09-30T10:56:57Z</TLCTIME></IMAGE></IMD></isd>",
            "2015-09-30T10:56:57.000Z",
        ),
        (
            "a.tif",
            "a.geom",
            "support_data.production_date:  2018-07-19T07:06:22.673\n"
            "support_data.image_date:  2017-09-28T10:38:04.5Z\n",
            "2017-09-28T10:38:04.500Z",
        ),
    ],
)
def test_files_of_other_makers(tmp_path, image, file, text, expected):
    (tmp_path / file).write_text(text)
    assert of(tmp_path / image) == expected


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\0\1\2",
        b"<a>",
        b"<" * 1000,
        b"\xff\xfe\xff",
        b"firstLineTime = ;",
        b"firstLineTime = 2015-99-99T99:99:99Z;",
        b'<!DOCTYPE a [<!ENTITY b "2015-09-30T10:56:57Z">]><a><START>&b;</START></a>',
        b"<a>" + b"<b>" * 100 + b"<START>2015-09-30T10:56:57Z</START>" + b"</b>" * 100 + b"</a>",
        b"<a><START><c/>2015-09-30T10:56:57Z</START></a>",
    ],
    ids=lambda content: repr(content[:16]),
)
def test_broken_files_tell_nothing(tmp_path, content):
    for name in ("a.IMD", "a.XML", "a.geom", "DIM_a.XML"):
        (tmp_path / name).write_bytes(content)
    assert of(tmp_path / "a.tif") == ""


def test_nitf_headers():
    assert of("a.ntf", plain={"NITF_IDATIM": "20150930105657"}) == "2015-09-30T10:56:57.000Z"
    assert of("a.ntf", plain={"NITF_IDATIM": "--------------"}) == ""
    stdidc = {"NITF_STDIDC_ACQUISITION_DATE": "20150930105656", "NITF_IDATIM": "20160930105657"}
    assert of("a.ntf", plain=stdidc) == "2015-09-30T10:56:56.000Z"
    # What GDAL writes into every NITF that it makes.
    assert of("a.ntf", plain={"NITF_IDATIM": "20021216151629"}) == ""


def test_the_time_of_the_file_is_not_that_of_the_image():
    assert of("a.tif", plain={"TIFFTAG_DATETIME": "2015:09:30 10:56:57"}) == ""


def test_real_files(shared_data, tmp_path, write_image):
    other = shared_data / "rpc" / "other"
    with opened(str(other / "wv3_20.NTF")) as dataset:  # written by GDAL
        assert acquired(dataset, str(other / "wv3_20.NTF")) == ""
    (tmp_path / "a.XML").write_bytes((other / "rpc_WV2.xml").read_bytes())
    path = write_image(tmp_path / "a.tif")
    with opened(path) as dataset:
        assert acquired(dataset, path) == "2015-09-30T10:56:56.973Z"
    names = sorted(path.name.partition("__")[2] for path in (shared_data / "rpc" / "pleiades").glob("*.XML"))
    assert len(names) > 30 and all(moment(time_of_name(name)).year in (2011, 2012, 2013) for name in names)


@pytest.mark.parametrize(
    ("days", "text"),
    [
        (None, "unknown"),
        (0.0, "0 s"),
        (21 / 86400, "21 s"),
        (300 / 86400, "5 min"),
        (0.25, "6 h"),
        (1.0, "24 h"),
        (2.0, "2 days"),
        (184.4, "184 days"),
    ],
)
def test_spans_as_people_say_them(days, text):
    assert duration_text(days) == text


@pytest.mark.parametrize(
    ("domain", "items", "found"),
    [
        ("plain", {"IMAGING_DATE": "2013-06-29T06:37:14Z"}, "2013-06-29T06:37:14.000Z"),
        ("plain", {"TIFFTAG_IMAGING_DATE": "2013-06-29 06:37:14"}, "2013-06-29T06:37:14.000Z"),
        ("plain", {"IMAGING_DATE": "2013-06-29", "IMAGING_TIME": "06:37:14.4Z"}, "2013-06-29T06:37:14.400Z"),
        ("IMAGERY", {"acquisition_date": "2013-06-29", "acquisition_time": "06:37:14"}, "2013-06-29T06:37:14.000Z"),
        ("plain", {"ACQUIRED": "2013-06-29T08:37:14+02:00"}, "2013-06-29T06:37:14.000Z"),
        ("plain", {"IMAGING_DATE": "2013-06-29"}, ""),  # no time of day: the sun would be wrong
        ("plain", {"TIFFTAG_DATETIME": "2013:06:29 06:37:14"}, ""),
    ],
)
def test_tags_of_the_image(domain, items, found):
    assert of("a.tif", **{domain: items}) == found


def test_what_is_better_comes_before_tags_of_the_image(tmp_path):
    tags = {"IMAGING_DATE": "2001-01-01T00:00:00Z"}
    assert of("PHR1A_201106151037450.tif", plain=tags).startswith("2011-06-15")
    (tmp_path / "a.IMD").write_text(IMD)
    assert of(tmp_path / "a.tif", plain=tags).startswith("2015-09-30")
