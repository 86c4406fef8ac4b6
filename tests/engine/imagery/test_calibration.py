"""What the digital numbers of bands mean, by the vendors' documents; green and near infrared are compared."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.imagery.calibration import SUN, calibration

BANDS = {"green": 2, "near infrared": 4}
DIMAP = """<?xml version="1.0"?><Dimap_Document><Radiometric_Data><Radiometric_Calibration><Instrument_Calibration>
<Band_Measurement_List>{measured}</Band_Measurement_List></Instrument_Calibration></Radiometric_Calibration>
</Radiometric_Data></Dimap_Document>"""
RADIANCE = "<Band_Radiance><BAND_ID>{0}</BAND_ID><GAIN>{1}</GAIN><BIAS>{2}</BIAS></Band_Radiance>"
LIGHT = "<Band_Solar_Irradiance><BAND_ID>{0}</BAND_ID><VALUE>{1}</VALUE></Band_Solar_Irradiance>"
MAXAR = "BEGIN_GROUP = BAND_{0}\n\tabsCalFactor = {1};\n\teffectiveBandwidth = {2};\nEND_GROUP = BAND_{0}\n"


@pytest.fixture
def image(tmp_path):
    path = tmp_path / "IMG_P1_MS.tif"
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), 4, 4, 4, gdal.GDT_UInt16)
    dataset = None  # noqa: F841
    return path


def ratio(path):
    """What equal digital numbers mean: the near infrared's reflectance over the green's; None without a calibration."""
    found = calibration(gdal.Open(str(path)), str(path), BANDS)
    if found is None:
        return None
    green, infrared = np.full(2, 100.0) * found.gains + found.offsets
    return float(infrared / green)


def test_nothing_says_what_numbers_mean(image):
    assert ratio(image) is None


def test_airbus_gains_biases_and_irradiances(image):
    measured = "".join(
        [RADIANCE.format(band, gain, bias) for band, gain, bias in (("B0", 9, 0), ("B1", 10, 1.0), ("B3", 16, 0.5))]
        + [LIGHT.format(band, value) for band, value in (("B1", 1830), ("B3", 1060))]
    )
    image.with_name("DIM_P1_MS.XML").write_text(DIMAP.format(measured=measured), encoding="utf-8")
    assert ratio(image) == pytest.approx((100 / 16 + 0.5) / 1060 / ((100 / 10 + 1.0) / 1830), rel=1e-5)


def test_maxars_factors(image):
    text = MAXAR.format("G", 0.0093, 0.0618) + MAXAR.format("N", 0.0122, 0.0989)
    image.with_suffix(".IMD").write_text(text, encoding="ascii")
    expected = 0.0122 / 0.0989 / SUN["near infrared"] / (0.0093 / 0.0618 / SUN["green"])
    assert ratio(image) == pytest.approx(expected, rel=1e-5)


def test_a_files_own_scale_and_offset(image):
    dataset = gdal.Open(str(image), gdal.GA_Update)
    for number, scale, offset in ((2, 0.0001, -0.001), (4, 0.0002, 0.0)):
        dataset.GetRasterBand(number).SetScale(scale)
        dataset.GetRasterBand(number).SetOffset(offset)
    dataset = None
    assert ratio(image) == pytest.approx(0.02 / 0.009, rel=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        MAXAR.format("G", 0.0093, 0.0618),
        MAXAR.format("G", "x", 0.06) + MAXAR.format("N", 0.01, 0.09),
        MAXAR.format("G", 0, 0.06) + MAXAR.format("N", 0.01, 0.09),
        "BEGIN_GROUP = BAND_G\n",
    ],
    ids=["one band", "no number", "zero", "cut"],
)
def test_documents_that_do_not_say_it_say_nothing(text, image):
    image.with_suffix(".IMD").write_text(text, encoding="ascii")
    assert ratio(image) is None
