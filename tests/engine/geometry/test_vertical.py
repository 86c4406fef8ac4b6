"""What heights refer to, against PROJ's own answers."""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys

import numpy as np
import pyproj
import pytest
from pyproj.crs.crs import CompoundCRS
from pyproj.transformer import TransformerGroup

from repm_qgis.contracts.errors import MissingPackageError, OptionError
from repm_qgis.geometry import vertical
from repm_qgis.geometry.frames import vertical_part
from repm_qgis.geometry.vertical import HeightDatum, _bounds, metres_per_unit, stated_datum

ROOT = pathlib.Path(__file__).resolve().parents[3]
UTM = "EPSG:32631"
PLACES = np.array([[[500000.0, 4800000.0], [540000.0, 4810000.0]], [[500000.0, 4850000.0], [512345.6, 4799999.9]]])


def installed(code):
    return bool(TransformerGroup("EPSG:4979", f"EPSG:4326+{code}", always_xy=True, allow_ballpark=False).transformers)


@pytest.mark.parametrize("text", ("", None, "ellipsoid", "Ellipsoidal", " "))
def test_the_ellipsoid_takes_nothing_off(text):
    datum = HeightDatum.of(text)
    assert datum.name == "WGS 84 ellipsoid" and not datum.undulation(UTM, PLACES).any()
    assert pyproj.CRS(datum.file_crs(UTM)) == pyproj.CRS(UTM)


def test_egm96_is_projs_undulation():
    if not installed(5773):
        pytest.skip("PROJ's EGM96 grid is not installed")
    datum = HeightDatum.of("egm96")
    lon, lat = pyproj.Transformer.from_crs(UTM, 4326, always_xy=True).transform(PLACES[..., 0], PLACES[..., 1])
    expected = -pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4326+5773", always_xy=True).transform(
        lon, lat, np.zeros(lon.shape)
    )[2]
    found = datum.undulation(UTM, PLACES)
    assert found.shape == (2, 2) and np.abs(found - expected).max() < 1e-6 and 45 < found.min() < 55
    crs = pyproj.CRS(datum.file_crs(UTM))
    assert crs.is_compound and vertical_part(crs) == "EGM96 height"
    assert HeightDatum.of("EPSG:5773") == HeightDatum.of("EGM96") == HeightDatum.of("EPSG:4326+5773")


def test_a_grid_that_is_not_there_is_named():
    if installed(3855):
        pytest.skip("PROJ's EGM2008 grid is installed here")
    datum = HeightDatum.of("EGM2008")
    with pytest.raises(
        MissingPackageError, match=r"EGM2008 height.*us_nga_egm08_25\.tif.*not installed: .* put .*, or set VERTICAL"
    ):
        datum.undulation(UTM, PLACES)
    with pytest.raises(MissingPackageError, match="us_nga_egm08_25"):
        datum.require(3.0, 43.0)


WITH_THE_GRID = """
import os, shutil, sys
import numpy as np
from osgeo import gdal, osr
from repm_qgis.contracts.errors import MissingPackageError
from repm_qgis.geometry.vertical import HeightDatum

datum, place = HeightDatum.of("EGM2008"), np.array([[500000.0, 4800000.0]])
try:
    datum.require(3.0, 43.0)
    sys.exit("installed")
except MissingPackageError as error:
    text = str(error)
url, folder = text.split("put ")[1].split(" into the folder ")
folder = folder.split("'")[1]
assert folder.startswith(os.environ["XDG_DATA_HOME"]) and url.startswith("https://cdn.proj.org/"), text
os.makedirs(folder, exist_ok=True)
path = os.path.join(folder, url.rsplit("/", 1)[1])
grid = gdal.GetDriverByName("GTiff").Create(path, 37, 19, 1, gdal.GDT_Float32)
world = osr.SpatialReference()
world.ImportFromEPSG(4326)
grid.SetProjection(world.ExportToWkt())
grid.SetGeoTransform((-185.0, 10.0, 0.0, 95.0, 0.0, -10.0))
grid.SetMetadataItem("TYPE", "VERTICAL_OFFSET_GEOGRAPHIC_TO_VERTICAL")
grid.SetMetadataItem("AREA_OR_POINT", "Point")
band = grid.GetRasterBand(1)
band.SetDescription("geoid_undulation")
band.SetUnitType("metre")
band.WriteArray(np.full((19, 37), 12.5, np.float32))
band = grid = None
datum.require(3.0, 43.0)
print(datum.undulation("EPSG:32631", place))
"""


def test_the_remedy_holds_and_needs_no_restart(tmp_path):
    """The file that the message names, in the folder that it names: found by the same process, at the next question."""
    environment = {
        **os.environ,
        "XDG_DATA_HOME": str(tmp_path),
        "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
        "PROJ_NETWORK": "OFF",
    }
    if os.name == "nt":  # where PROJ asks the system for the folder
        environment["PROJ_USER_WRITABLE_DIRECTORY"] = str(tmp_path / "proj")
    done = subprocess.run([sys.executable, "-c", WITH_THE_GRID], env=environment, capture_output=True, text=True)
    if done.stderr.strip() == "installed":
        pytest.skip("PROJ's EGM2008 grid is installed here")
    assert done.returncode == 0 and done.stdout.strip() == "[12.5]", done.stderr


@pytest.mark.parametrize("text", ("geoid", "EPSG:4326", "EPSG:99999999"))
def test_what_is_no_vertical_crs(text):
    with pytest.raises(OptionError, match=f"VERTICAL_DATUM is '{text}'.*EGM96, EGM2008"):
        HeightDatum.of(text)


def test_a_vertical_crs_without_a_code_keeps_its_definition():
    crs = pyproj.CRS("EPSG:5773").to_wkt().replace("EGM96 height", "our heights").replace(',ID["EPSG",5773]', "")
    datum = HeightDatum.of(crs)
    assert datum.name == "our heights" and pyproj.CRS(datum.code).is_vertical
    assert HeightDatum.of("EPSG:5773").code == "EPSG:5773"
    assert pyproj.CRS(datum.file_crs(UTM)).sub_crs_list[0] == pyproj.CRS(UTM)


def test_bounds_are_whole_degrees_around_all_points():
    assert _bounds(np.array([[[5.2, -3.7], [6.9, 44.0]], [[7.0, 1.0], [-0.5, 2.0]]])) == (-1, -4, 8, 45)
    assert _bounds(np.array([[3.0, 43.0]])) == (3, 43, 4, 44)


def test_a_datum_in_feet_takes_metres_off(monkeypatch):
    """PROJ answers in the datum's own unit."""

    class InFeet:
        def transform(self, lon, lat, height):
            return lon, lat, (height + 30.0) / 0.3048

    monkeypatch.setattr(vertical, "_best_operation", lambda *_: InFeet())
    datum = HeightDatum.of("EPSG:8228")  # NAVD88 height (ft)
    np.testing.assert_allclose(datum.undulation("EPSG:32618", PLACES), -30.0)
    with pytest.raises(MissingPackageError, match="does not cover the area: choose another VERTICAL_DATUM"):
        monkeypatch.setattr(InFeet, "transform", lambda self, lon, lat, height: (lon, lat, height + np.inf))
        datum.undulation("EPSG:32618", PLACES)


@pytest.mark.parametrize(
    "crs, tag, code, unit",
    (
        (UTM, "", None, None),
        (UTM, "WGS 84 ellipsoid", "", None),
        (UTM, "EGM96 height", "EPSG:5773", None),
        (UTM, "above the sea", None, None),
        ("EPSG:4979", "EGM96 height", "", 1.0),
        ("EPSG:4326+3855", "WGS 84 ellipsoid", "EPSG:3855", 1.0),
        ("EPSG:2260+6360", "", "EPSG:6360", 1200 / 3937),
        (None, "EGM2008 height", "EPSG:3855", None),
    ),
)
def test_what_a_file_says(crs, tag, code, unit):
    system = crs and pyproj.CRS(crs)
    found = stated_datum(system, tag)
    assert (found and found.code) == code
    assert system is None or metres_per_unit(system) == (unit and pytest.approx(unit, rel=1e-9))


def test_a_vertical_part_that_is_the_ellipsoid():
    """As writers of LAS name it, which PROJ knows no operation for."""
    part = pyproj.CRS("EPSG:5773").to_wkt().replace("EGM96 height", "WGS 84 Ellipsoid").replace(',ID["EPSG",5773]', "")
    assert stated_datum(CompoundCRS("points", [UTM, part])).code == ""
