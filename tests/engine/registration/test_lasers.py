"""HDF5 files of ICESat-2 and GEDI: which heights are taken, by which support, and files that are none or lie."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import Cancelled, ImageError, MissingPackageError, OverlapError
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.registration import lasers
from repm_qgis.registration.lasers import read_lasers

UTM = "EPSG:32631"
BOUNDS = Bounds(500_000.0, 4_000_000.0, 502_000.0, 4_002_000.0)
FILL = 3.4028235e38
KINDS = {"float64": gdal.GDT_Float64, "float32": gdal.GDT_Float32, "int16": gdal.GDT_Int16, "uint8": gdal.GDT_Byte}


def write_hdf5(path, arrays):
    """An HDF5 file (as netCDF-4) with arrays by their names in groups."""
    dataset = gdal.GetDriverByName("netCDF").CreateMultiDimensional(str(path))
    groups = {"": dataset.GetRootGroup()}
    for full, values in arrays.items():
        *parents, name = full.split("/")
        key = ""
        for parent in parents:
            inner = f"{key}/{parent}"
            groups[inner] = groups.get(inner) or groups[key].CreateGroup(parent)
            key = inner
        axes = [groups[key].CreateDimension(f"{name}_{i}", "", "", n) for i, n in enumerate(values.shape)]
        array = groups[key].CreateMDArray(name, axes, gdal.ExtendedDataType.Create(KINDS[values.dtype.name]))
        assert array.Write(values.tobytes()) == gdal.CE_None
    return str(path)


@pytest.fixture(params=("GDAL", "h5py"))
def reader(request, monkeypatch):
    """Both ways to read; GDAL without its drivers leaves h5py."""
    if request.param == "h5py":
        try:
            pytest.importorskip("h5py", reason="the package h5py is not installed: it is read where GDAL has no HDF5")
        except ValueError as error:  # h5py is for a GDAL without HDF5, and then there is one such library
            pytest.skip(f"GDAL has loaded its hdf5.dll, and a process has one library of a name: {error}")
        monkeypatch.setattr(lasers, "_DRIVERS", ())


def places(count=400, inside=True):
    """Longitudes, latitudes of places along a track through the scene, and UTM of them."""
    along = np.linspace(-3000, 5000, count) if not inside else np.linspace(50, 1950, count)
    xy = np.column_stack([500_500 + 0.1 * along, 4_000_000 + along])
    return (*geodetic_from_projected(UTM, xy).T, xy)


def photons(confidence):
    lon, lat, xy = places()
    beam = {"lon_ph": lon, "lat_ph": lat, "h_ph": np.arange(400, dtype=np.float32), "signal_conf_ph": confidence}
    return {f"gt2r/heights/{name}": values for name, values in beam.items()}, xy


def test_photons_are_discs_with_confidence(tmp_path, reader):
    confidence = np.full((400, 5), 4, dtype=np.int16)
    confidence[:, 1:3] = confidence[:, 4] = 4  # of ocean, sea ice and water: they do not count
    confidence[:100, [0, 3]] = [2, -1]
    confidence[100:200, [0, 3]] = [-1, 3]  # land ice alone
    confidence[200:220, [0, 3]] = 255  # GDAL before 3.7 reads -1 so
    arrays, xy = photons(confidence)
    found = read_lasers(write_hdf5(tmp_path / "ATL03.h5", arrays), UTM, BOUNDS)
    taken = np.r_[100:200, 220:400]
    assert found.height.tolist() == taken.tolist() and found.disc and found.width_m == (12.0, 12.0)
    np.testing.assert_allclose(found.xy, xy[taken], atol=1e-3)
    assert found.datum.code == "" and found.slopes is None


def test_segments_within_the_scene_of_all_beams(tmp_path, reader):
    lon, lat, xy = places(800, inside=False)
    height = np.arange(800, dtype=np.float32)
    height[400] = FILL
    bad = np.zeros(800, dtype=np.int16)
    bad[405] = 1
    beam = {"longitude": lon, "latitude": lat, "h_li": height, "atl06_quality_summary": bad}
    arrays = {f"{name}/land_ice_segments/{key}": each for name in ("gt1l", "gt3r") for key, each in beam.items()}
    arrays["gt2l/land_ice_segments/longitude"] = lon  # a beam without heights
    arrays["orbit_info/h_li"] = height
    found = read_lasers(write_hdf5(tmp_path / "ATL06.h5", arrays), UTM, BOUNDS)
    inside = ((xy >= BOUNDS[:2]) & (xy <= BOUNDS[2:])).all(axis=1)
    assert inside[[400, 405]].all() and 150 < inside.sum() < 250
    inside[[400, 405]] = False
    assert found.height.tolist() == np.nonzero(inside)[0].tolist() * 2
    assert found.width_m == (12.0, 40.0) and not found.disc


def test_parts_of_land_segments_before_whole_ones(tmp_path, reader):
    lon, lat, xy = places()
    whole = {"longitude": lon, "latitude": lat, "terrain/h_te_best_fit": np.arange(400, dtype=np.float32)}
    arrays = {f"gt1r/land_segments/{name}": each for name, each in whole.items()}
    found = read_lasers(write_hdf5(tmp_path / "old.h5", arrays), UTM, BOUNDS)
    assert found.width_m == (12.0, 100.0) and len(found.height) == 400
    part = {name + "_20m": np.tile(each[:, None], 5).astype(np.float64) for name, each in whole.items()}
    part["terrain/h_te_best_fit_20m"][:, 1] = FILL
    arrays.update({f"gt1r/land_segments/{name}": each for name, each in part.items()})
    found = read_lasers(write_hdf5(tmp_path / "new.h5", arrays), UTM, BOUNDS)
    assert found.width_m == (12.0, 20.0) and found.height.tolist() == np.repeat(np.arange(400), 4).tolist()


def test_footprints_of_good_quality(tmp_path, reader):
    lon, lat, _ = places()
    good, degraded = np.arange(400) % 2, (np.arange(400) % 3 == 0) * 30
    beam = {
        "lon_lowestmode": np.where(lon < 0, lon + 360, lon),
        "lat_lowestmode": lat,
        "elev_lowestmode": np.arange(400, dtype=np.float32),
        "quality_flag": good.astype(np.uint8),
        "degrade_flag": degraded.astype(np.uint8),
    }
    path = write_hdf5(tmp_path / "GEDI02_A.h5", {f"BEAM0101/{name}": each for name, each in beam.items()})
    found = read_lasers(path, UTM, BOUNDS)
    assert found.height.tolist() == np.nonzero((good == 1) & (degraded == 0))[0].tolist()
    assert found.disc and found.width_m == (25.0, 25.0)


def test_long_beams_are_read_in_parts_and_may_be_stopped(tmp_path, monkeypatch, reader):
    arrays, _ = photons(np.full((400, 5), 4, dtype=np.int16))
    path = write_hdf5(tmp_path / "ATL03.h5", arrays)
    whole = read_lasers(path, UTM, BOUNDS)
    monkeypatch.setattr(lasers, "_ROWS", 130)
    checks = []
    assert (read_lasers(path, UTM, BOUNDS, lambda: checks.append(1)).height == whole.height).all() and len(checks) == 4

    def stop():
        raise Cancelled

    with pytest.raises(Cancelled):
        read_lasers(path, UTM, BOUNDS, stop)


@pytest.mark.parametrize("change", ("lat_ph", "signal_conf_ph", "claim"))
def test_groups_that_contradict_themselves(tmp_path, monkeypatch, reader, change):
    arrays, _ = photons(np.full((400, 5), 4, dtype=np.int16))
    if change == "claim":
        monkeypatch.setattr(lasers, "_MOST_ROWS", 399)
    else:
        arrays[f"gt2r/heights/{change}"] = arrays[f"gt2r/heights/{change}"][:-1]
    path = write_hdf5(tmp_path / "ATL03.h5", arrays)
    with pytest.raises(ImageError, match="has a damaged group 'gt2r': get the file again") as caught:
        read_lasers(path, UTM, BOUNDS)
    assert path in str(caught.value)


def test_what_is_no_laser_is_a_sentence(tmp_path, reader):
    path = write_hdf5(tmp_path / "other.h5", {"gt1l/something": np.arange(3.0)})
    with pytest.raises(ImageError, match="is neither ATL03, ATL06 or ATL08 of ICESat-2, nor L2A of GEDI: give one"):
        read_lasers(path, UTM, BOUNDS)
    arrays, _ = photons(np.full((400, 5), 4, dtype=np.int16))
    path = write_hdf5(tmp_path / "far.h5", arrays)
    with pytest.raises(OverlapError, match="has no heights over the scene: choose one that has"):
        read_lasers(path, UTM, Bounds(600_000.0, 4_000_000.0, 602_000.0, 4_002_000.0))
    with open(path, "r+b") as stream:
        stream.truncate(3000)
    with pytest.raises(ImageError, match=r"Cannot read the HDF5 file .*far\.h5.*: get it again"):
        read_lasers(path, UTM, BOUNDS)
    with pytest.raises(ImageError, match="Cannot read the HDF5 file"):
        read_lasers(str(tmp_path / "missing.h5"), UTM, BOUNDS)


def test_without_a_reader_the_remedy_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(lasers, "_DRIVERS", ())
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingPackageError, match=r"give its heights as a CSV file \(SlideRule and EarthExplorer"):
        read_lasers(write_hdf5(tmp_path / "a.h5", {"gt1l/a": np.arange(3.0)}), UTM, BOUNDS)


@pytest.mark.parametrize("reason", (KeyError("bad symbol table"), OSError("truncated"), RuntimeError("no filter")))
def test_what_h5py_cannot_open_in_a_file_is_a_sentence(reason):
    def get(name):
        raise reason

    h5py = SimpleNamespace(File=lambda path, mode: SimpleNamespace(get=get))
    with pytest.raises(ImageError, match=r"Cannot read the HDF5 file 'x\.h5'.*: get it again"):
        lasers._H5pyStore("x.h5", h5py).shape("gt1l/heights/h_ph")


class Damaged:
    """An HDF5 file that opens, and whose parts cannot be read."""

    def __init__(self, reason):
        self._reason = reason

    def __iter__(self):
        raise self._reason

    def __getitem__(self, name):
        raise self._reason


@pytest.mark.parametrize("reason", (OSError("truncated"), RuntimeError("no filter")))
def test_names_that_h5py_cannot_list_are_a_sentence(reason):
    h5py = SimpleNamespace(File=lambda path, mode: Damaged(reason))
    with pytest.raises(ImageError, match=r"Cannot read the HDF5 file 'x\.h5'.*: get it again"):
        lasers._H5pyStore("x.h5", h5py).groups()


@pytest.mark.parametrize("reason", (OSError("a"), RuntimeError("b"), ValueError("c"), TypeError("d"), KeyError("e")))
def test_values_that_h5py_cannot_read_are_a_sentence(reason):
    h5py = SimpleNamespace(File=lambda path, mode: Damaged(reason))
    with pytest.raises(ImageError, match=r"Cannot read the HDF5 file 'x\.h5'.*: get it again"):
        lasers._H5pyStore("x.h5", h5py).read("gt1l/heights/h_ph", 0, 10)
