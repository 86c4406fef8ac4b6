"""Which bands are red, green and blue: by the file, else by the satellite's known order, else nothing."""

from __future__ import annotations

import pytest
from osgeo import gdal

from repm_qgis.imagery.bands import band_name, intensity_bands, natural_bands, water_bands


def image(bands, meanings=(), names=()):
    dataset = gdal.GetDriverByName("MEM").Create("", 8, 8, bands, gdal.GDT_UInt16)
    for band, meaning in enumerate(meanings, start=1):
        dataset.GetRasterBand(band).SetColorInterpretation(meaning)
    for band, name in enumerate(names, start=1):
        dataset.GetRasterBand(band).SetDescription(name)
    return dataset


def test_the_file_says_which_bands_are_which():
    red, green, blue, grey = gdal.GCI_RedBand, gdal.GCI_GreenBand, gdal.GCI_BlueBand, gdal.GCI_GrayIndex
    assert natural_bands(image(4, (blue, green, red, grey)), "Pleiades 1A") == (3, 2, 1)
    assert natural_bands(image(3, names=("Blue band", "GREEN", "red (630 nm)"))) == (3, 2, 1)


def test_bands_that_are_only_called_after_a_colour_do_not_count():
    names = ("coastal blue", "blue", "green", "yellow", "red", "red edge", "near infrared")
    assert natural_bands(image(7, names=names)) == (5, 3, 2)
    assert natural_bands(image(2, names=("red edge", "green"))) is None


@pytest.mark.parametrize(
    ("sensor", "bands", "expected"),
    [
        ("Pleiades 1B", 4, (1, 2, 3)),
        ("SPOT 7", 4, (1, 2, 3)),
        ("WorldView-2", 4, (3, 2, 1)),
        ("WorldView-3", 8, (5, 3, 2)),
        ("WorldView-1", 8, None),
        ("", 4, None),
        ("GeoEye-1", 1, None),
    ],
)
def test_vendors_have_their_orders(sensor, bands, expected):
    grey = [gdal.GCI_GrayIndex] + [gdal.GCI_Undefined] * (bands - 1)
    assert natural_bands(image(bands, grey), sensor) == expected


def test_alpha_shows_nothing():
    dataset = image(2, (gdal.GCI_GrayIndex, gdal.GCI_AlphaBand))
    assert intensity_bands(dataset) == [1]
    assert band_name(dataset, 2) == "band 2"


@pytest.mark.parametrize(
    ("names", "sensor", "expected"),
    [
        (("red", "green", "blue", "near infrared"), "", (2, 4)),
        (("B0 blue", "green", "red", "NIR"), "", (2, 4)),
        (("coastal", "blue", "green", "yellow", "red", "red edge", "nir-1", "nir-2"), "", (3, 7)),
        ((), "Pleiades 1A", (2, 4)),
        ((), "WorldView-2", (2, 4)),
        ((), "", None),
        (("red", "green", "blue", "thermal"), "", None),
        (("green", "NIR", "near infrared", "red"), "", None),
    ],
)
def test_green_and_near_infrared(names, sensor, expected):
    """Of two bands that are called near infrared, nothing says which is meant."""
    assert water_bands(image(max(len(names), 4), names=names), sensor) == expected
