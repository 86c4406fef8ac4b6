"""repm:series in QGIS: its layers arrive styled, and the temporal controller shows one date after the other."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal, osr
from qgis.core import QgsDateTimeRange, QgsPalettedRasterRenderer, QgsSingleBandPseudoColorRenderer
from qgis.PyQt.QtCore import QDateTime, Qt

DAYS = ("2019-05-01", "2020-06-10", "2021-05-20", "2023-05-02")


@pytest.fixture
def dsms(tmp_path):
    """Four dates of hills, with a pit that was dug before the third."""
    rng, (y, x) = np.random.default_rng(5), np.mgrid[:120, :120]
    paths = []
    for number, day in enumerate(DAYS):
        heights = 100 + 4 * np.sin(x / 21) * np.cos(y / 17) + rng.normal(0, 0.1, x.shape)
        if number >= 2:
            heights[40:80, 30:70] -= 3.0
        path = str(tmp_path / "pit" / f"dsm_{number}.tif")
        (tmp_path / "pit").mkdir(exist_ok=True)
        made = gdal.GetDriverByName("GTiff").Create(path, 120, 120, 1, gdal.GDT_Float32)
        made.SetGeoTransform((500000, 1, 0, 5000000, 0, -1))
        reference = osr.SpatialReference()
        reference.ImportFromEPSG(32631)
        made.SetSpatialRef(reference)
        made.SetMetadataItem("REPM_DAYS", day)
        made.GetRasterBand(1).WriteArray(heights)
        made = None
        paths.append(path)
    return paths


def moment(text):
    return QDateTime.fromString(f"{text}T12:00:00Z", Qt.DateFormat.ISODate)


def test_products_need_not_be_there(provider, context, dsms, tmp_path):
    """TABLE is a product here, and an input of the batch."""
    series = next(each for each in provider.algorithms() if each.name() == "series").create()
    given = {"DSMS": dsms, "OUTPUT": str(tmp_path / "o.tif"), "TABLE": str(tmp_path / "t.csv")}
    assert series.checkParameterValues(given, context) == (True, "")


@pytest.mark.long
def test_layers_arrive_styled_and_each_date_has_its_period(load, dsms, tmp_path):
    made = {name: tmp_path / f"{name}.tif" for name in ("OUTPUT", "TREND", "CHANGED")}
    folder = tmp_path / "dates"
    results, layers = load(
        "series", {"DSMS": dsms, "LAYERS": str(folder), "REPORT": ""}, {**made, "VOLUMES": tmp_path / "v.gpkg"}
    )
    assert results["N_DATES"] == 4 and results["FALLING_M2"] == pytest.approx(1600, rel=0.05)
    assert results["VOLUME_M3"] == pytest.approx(-4800, rel=0.02)
    trend = layers["TREND"].renderer()
    assert isinstance(trend, QgsSingleBandPseudoColorRenderer)
    assert trend.classificationMin() == -trend.classificationMax()
    assert "Standard error of the trend" in layers["TREND"].styleManager().styles()
    changed = layers["CHANGED"].renderer()
    assert isinstance(changed, QgsPalettedRasterRenderer) and [each.label for each in changed.classes()] == list(DAYS)
    assert layers["VOLUMES"].featureCount() == 1
    dated = {each.name()[-11:-1]: each for each in load.project.mapLayers().values() if ".vrt" in each.source()}
    assert set(dated) == set(DAYS) and dated[DAYS[0]].name() == "Heights pit, 2019-05-01 – 2023-05-02 (2019-05-01)"
    for shown in ("2020-06-10", "2021-05-19", "2021-05-20", "2023-06-01"):
        at = QgsDateTimeRange(moment(shown), moment(shown))
        visible = [day for day, each in dated.items() if each.temporalProperties().isVisibleInTemporalRange(at)]
        assert visible == [max(day for day in DAYS if day <= shown)]
    assert all(each.isValid() and each.temporalProperties().isActive() for each in dated.values())
    assert len({each.renderer().classificationMax() for each in dated.values()}) == 1  # the same colours
    (group,) = load.project.layerTreeRoot().children()
    shown = [(each.name().split(" pit")[0], each.itemVisibilityChecked()) for each in group.children()]
    assert shown[:3] == [("Volumes over time", True), ("Dates of change", False), ("Trend", True)]
    assert shown[3:] == [("Heights", False)] * 4 + [("Heights of all dates", False)]


@pytest.mark.long
def test_dates_are_given_as_a_list(load, dsms, tmp_path):
    text = "2001-01-01; 2003-01-01, 2002-01-01;2004-01-01"
    options = {"DSMS": dsms, "DATES": text, "LAYERS": "", "TREND": "", "CHANGED": "", "VOLUMES": "", "REPORT": ""}
    load("series", options, {"OUTPUT": tmp_path / "s.tif"})
    stack = gdal.Open(str(tmp_path / "s.tif"))
    names = [stack.GetRasterBand(band).GetDescription() for band in (1, 2, 3, 4)]
    assert names == ["2001-01-01", "2002-01-01", "2003-01-01", "2004-01-01"]
