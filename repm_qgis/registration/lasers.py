"""Heights that lasers in space have measured: ICESat-2's ATL03, ATL06 and ATL08, and GEDI's L2A, as HDF5 files.

All of them are above the WGS 84 ellipsoid (ICESat-2: ITRF2014). GDAL's multidimensional API reads them, or else the
package h5py.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import datetime, timedelta
from types import ModuleType
from typing import Any, Callable, Dict, List, Optional, Protocol, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from ..contracts.arrays import Bounds, FloatArray, Mask
from ..contracts.errors import ImageError, MissingPackageError
from ..files.untrusted import refusal_of
from ..geometry.vertical import ELLIPSOID, HeightDatum
from ..imagery.raster import quiet
from .found import FoundHeights, FoundPoints, Within
from .parameters import REGISTRATION, RegistrationParameters
from .photons import dense

_DRIVERS = ("HDF5", "netCDF")
_GROUP = re.compile(r"gt[123][lr]|BEAM\d{4}")
_HIGHEST_M = 12_000.0  # of any height on the Earth: fills are larger
_LATEST_S = 4e9  # a century after the epoch
_ROWS = 1 << 20  # that are read at once
_EPOCH = datetime(2018, 1, 1)  # of delta_time, of ICESat-2 (ATLAS SDP) and GEDI
_ITRF = "WGS 84 ellipsoid (ITRF2014)"
_GROUND = "heights of the ground below vegetation, where there is one"
_MOST_ROWS = 1_000_000_000  # of a beam; a file of a few kB can claim any number


def flags(parameters: RegistrationParameters = REGISTRATION) -> Dict[str, Tuple[float, float]]:
    """The values that fields of quality have where a height can be used: the least and the greatest.

    GEDI: quality_flag 1 and degrade_flag 0 (L2A user guide); ATL06: the summary 0 (Smith et al. 2019); photons: the
    confidence of land or land ice. Wherever GDAL reads -1 as 255 (before 3.7), that is no confidence either.
    """
    confident = (float(parameters.least_confidence), 4.0)
    good = dict.fromkeys(("quality_flag", "l2_quality_flag"), (1.0, 1.0))
    return {
        **good,
        **dict.fromkeys(("degrade_flag", "atl06_quality_summary"), (0.0, 0.0)),
        **dict.fromkeys(("signal_conf_ph", "atl03_cnf"), confident),
    }


@dataclass(frozen=True)
class Laser:
    """A product of a laser: its support, and where its HDF5 files have places, heights, quality and time in each beam.

    ``frame`` is the datum of its heights, ``criterion`` says which of them are good.
    """

    name: str
    width_m: Tuple[float, float]
    disc: bool
    lon: str
    lat: str
    height: str
    quality: Tuple[str, ...] = ()
    time: str = ""
    frame: str = "WGS 84 ellipsoid"
    criterion: str = ""


def lasers(parameters: RegistrationParameters = REGISTRATION) -> Tuple[Laser, ...]:
    """All that are known; where a file has the fields of two, the first is taken."""
    p = parameters
    ice, land = "land_ice_segments/", "land_segments/"
    photons, footprint = (p.atl03_disc_m, p.atl03_disc_m), (p.gedi_disc_m, p.gedi_disc_m)
    height, part = land + "terrain/h_te_best_fit", "_20m"
    return (
        Laser(
            "ATL03",
            photons,
            True,
            "heights/lon_ph",
            "heights/lat_ph",
            "heights/h_ph",
            ("heights/signal_conf_ph",),
            "heights/delta_time",
            _ITRF,
            "photons of medium and high confidence, and those of low confidence where photons are dense",
        ),
        Laser(
            "ATL06",
            p.atl06_m,
            False,
            ice + "longitude",
            ice + "latitude",
            ice + "h_li",
            (ice + "atl06_quality_summary",),
            ice + "delta_time",
            _ITRF,
            "segments with atl06_quality_summary 0",
        ),
        Laser(
            "ATL08 (20 m)",
            p.atl08_part_m,
            False,
            land + "longitude" + part,
            land + "latitude" + part,
            height + part,
            (),
            land + "delta_time",
            _ITRF,
            _GROUND,
        ),
        Laser(
            "ATL08",
            p.atl08_m,
            False,
            land + "longitude",
            land + "latitude",
            height,
            (),
            land + "delta_time",
            _ITRF,
            _GROUND,
        ),
        Laser(
            "GEDI L2A",
            footprint,
            True,
            "lon_lowestmode",
            "lat_lowestmode",
            "elev_lowestmode",
            ("quality_flag", "degrade_flag"),
            "delta_time",
            criterion="footprints with quality_flag 1 and degrade_flag 0",
        ),
    )


def read_lasers(path: str, crs: str, bounds: Bounds, check: Callable[[], None] = lambda: None) -> FoundHeights:
    """The good heights of a file within bounds of the scene's projected CRS; ``check`` may raise to stop.

    Raises ImageError for a file that cannot be read or is of no known product, MissingPackageError where nothing here
    reads HDF5, OverlapError where it has no heights within the bounds.
    """
    wrong = refusal_of(path)
    if wrong:
        raise ImageError(f"'{path}' {wrong}")
    store = _opened(path)
    beams = [name for name in store.groups() if _GROUP.fullmatch(name)]
    known = [(laser, [beam for beam in beams if store.shape(f"{beam}/{laser.height}")]) for laser in lasers()]
    laser, having = next((each for each in known if each[1]), (None, []))
    if laser is None:
        raise ImageError(
            f"'{path}' is neither ATL03, ATL06 or ATL08 of ICESat-2, nor L2A of GEDI: give one of these, or its "
            "heights as a CSV file or a raster."
        )
    points = FoundPoints(path, Within(pyproj.CRS("EPSG:4326"), crs, bounds))
    seen = _Counts()
    for beam in having:
        _add_beam(points, store, f"{beam}/", laser=laser, path=path, seen=seen, check=check)
    return points.found(laser.width_m, laser.disc, HeightDatum("", ELLIPSOID), about=seen.sentence(laser))


@dataclass
class _Counts:
    """What was read around the scene: how many heights there are, how many were taken, and when they were measured (s
    since the epoch)."""

    there: int = 0
    taken: int = 0
    begin: float = math.inf
    end: float = -math.inf

    def sentence(self, laser: Laser) -> str:
        """For the report: the product, its epoch and datum, and which of its heights count."""
        when = ""
        if self.begin <= self.end:
            days = [(_EPOCH + timedelta(seconds=each)).date().isoformat() for each in (self.begin, self.end)]
            when = f", measured {' to '.join(dict.fromkeys(days))}"
        count = f"{self.taken} of {self.there} around the scene"
        return f"{laser.name}{when}, heights above the {laser.frame}; used are {laser.criterion}: {count}."


def _add_beam(
    points: FoundPoints, store: _Store, beam: str, *, laser: Laser, path: str, seen: _Counts, check: Callable[[], None]
) -> None:
    shape = store.shape(beam + laser.height)
    places = [store.shape(beam + name) for name in (laser.lon, laser.lat)]
    qualities = [name for name in laser.quality if store.shape(beam + name)]
    lengths = {each[0] for each in map(store.shape, (beam + name for name in qualities)) if each}
    if shape is None or places != [shape, shape] or len(shape) > 2 or lengths - {shape[0]} or shape[0] > _MOST_ROWS:
        raise ImageError(f"'{path}' has a damaged group '{beam[:-1]}': get the file again.")
    for begin in range(0, shape[0], _ROWS):
        check()
        count = min(_ROWS, shape[0] - begin)
        lat = store.read(beam + laser.lat, begin, count)
        lon = store.read(beam + laser.lon, begin, count)
        near = points.within.near(lon, lat)
        if not near.any():
            continue
        height = store.read(beam + laser.height, begin, count)
        near &= np.abs(height) < _HIGHEST_M
        seen.there += int(np.count_nonzero(near))
        for name in qualities:
            values = store.read(beam + name, begin, count)
            if values.ndim == 2:
                near &= _of_surfaces(lon, lat, height, values, near)
            else:
                good = _good(name.rpartition("/")[2], values)
                near &= good.reshape(good.shape + (1,) * (near.ndim - 1))
        seen.taken += int(np.count_nonzero(near))
        if laser.time and store.shape(beam + laser.time) == (shape[0],) and near.any():
            times = store.read(beam + laser.time, begin, count)[near.reshape(len(near), -1).any(axis=1)]
            known = times[(times > 0) & (times < _LATEST_S)]
            if known.size:
                seen.begin, seen.end = min(seen.begin, float(known.min())), max(seen.end, float(known.max()))
        points.add(lon[near], lat[near], height[near])


def _of_surfaces(lon: FloatArray, lat: FloatArray, height: FloatArray, values: FloatArray, near: Mask) -> Mask:
    """(N,) which photons come back from a surface, by their (N, 5) confidences; they are looked at where they are
    ``near``."""
    least, most = flags()["signal_conf_ph"]
    low = float(REGISTRATION.low_confidence)
    confidence = np.where(values <= most, values, -1.0)[:, [0, 3]].max(axis=1)  # land and land ice, of five surfaces
    good: Mask = confidence >= least
    looked = near & (confidence >= 0)
    if (looked & (confidence == low)).any():
        among = np.zeros(len(near), dtype=bool)
        among[looked] = dense(lon[looked], lat[looked], height[looked], confidence[looked] < low)
        good |= among & (confidence == low)
    return good


def _good(name: str, values: FloatArray) -> Mask:
    """(N,) whether values of a field of quality are those of a good height."""
    low, high = flags()[name]
    return np.asarray((values >= low) & (values <= high))


# Files ------------------------------------------------------------------------------------------------------------


def _opened(path: str) -> _Store:
    """The file, by GDAL or by h5py; raises ImageError or MissingPackageError."""
    drivers = [name for name in _DRIVERS if gdal.GetDriverByName(name) is not None]
    drivers = [name for name in drivers if gdal.GetDriverByName(name).GetMetadataItem(gdal.DCAP_MULTIDIM_RASTER)]
    if drivers:
        return _GdalStore(path, drivers)
    try:
        import h5py
    except ImportError:
        raise MissingPackageError(
            f"'{path}' is HDF5, which the GDAL of this QGIS cannot read: give its heights as a CSV file (SlideRule and "
            "EarthExplorer make such), or install the package 'h5py'."
        ) from None
    return _H5pyStore(path, h5py)


def _unreadable(path: str, reason: object) -> ImageError:
    return ImageError(f"Cannot read the HDF5 file '{path}' ({str(reason)[:300]}): get it again.")


class _Store(Protocol):
    """Arrays of an HDF5 file."""

    def groups(self) -> List[str]: ...

    def shape(self, name: str) -> Optional[Tuple[int, ...]]: ...

    def read(self, name: str, begin: int, count: int) -> FloatArray: ...


class _GdalStore:
    """Arrays of an HDF5 file by GDAL's multidimensional API."""

    def __init__(self, path: str, drivers: Sequence[str]) -> None:
        self._path = path
        self._dataset = self._tried(
            lambda: gdal.OpenEx(path, gdal.OF_MULTIDIM_RASTER | gdal.OF_READONLY, allowed_drivers=list(drivers))
        )
        if self._dataset is None:
            raise _unreadable(path, gdal.GetLastErrorMsg())
        self._root = self._tried(self._dataset.GetRootGroup)

    def groups(self) -> List[str]:
        """The names of the groups at the top."""
        return list(self._tried(self._root.GetGroupNames) or ())

    def shape(self, name: str) -> Optional[Tuple[int, ...]]:
        """How many values an array has along each of its axes; None where it is not there or empty."""
        array = self._array(name)
        found = tuple(int(axis.GetSize()) for axis in array.GetDimensions()) if array is not None else ()
        return found if found and min(found) > 0 else None

    def read(self, name: str, begin: int, count: int) -> FloatArray:
        """Some of an array along its first axis."""
        array = self._array(name)
        shape = (count, *(int(axis.GetSize()) for axis in array.GetDimensions()[1:]))
        start = [begin] + [0] * (len(shape) - 1)
        double = gdal.ExtendedDataType.Create(gdal.GDT_Float64)
        held = self._tried(lambda: array.Read(array_start_idx=start, count=list(shape), buffer_datatype=double))
        if held is None:
            raise _unreadable(self._path, gdal.GetLastErrorMsg())
        return np.frombuffer(held, dtype=np.float64).reshape(shape)

    def _array(self, name: str) -> Any:
        return self._tried(lambda: self._sought(name))

    def _sought(self, name: str) -> Any:
        group, parts = self._root, name.split("/")
        for part in parts[:-1]:
            group = group.OpenGroup(part) if part in (group.GetGroupNames() or ()) else None
            if group is None:
                return None
        return group.OpenMDArray(parts[-1]) if parts[-1] in (group.GetMDArrayNames() or ()) else None

    def _tried(self, work: Callable[[], object]) -> Any:
        with quiet():
            try:
                return work()
            except RuntimeError as error:
                raise _unreadable(self._path, error) from error


class _H5pyStore:
    """The same by the package h5py."""

    def __init__(self, path: str, h5py: ModuleType) -> None:
        self._path, self._h5py = path, h5py
        try:
            self._file = h5py.File(path, "r")
        except OSError as error:
            raise _unreadable(path, error) from error

    def groups(self) -> List[str]:
        try:
            return list(self._file)
        except (OSError, RuntimeError) as error:
            raise _unreadable(self._path, error) from error

    def shape(self, name: str) -> Optional[Tuple[int, ...]]:
        try:
            array = self._file.get(name)
        except (OSError, RuntimeError, KeyError) as error:
            raise _unreadable(self._path, error) from error
        found = array.shape if isinstance(array, self._h5py.Dataset) else ()
        return found if found and min(found) > 0 else None

    def read(self, name: str, begin: int, count: int) -> FloatArray:
        try:
            return np.asarray(self._file[name][begin : begin + count], dtype=np.float64)
        except (OSError, RuntimeError, ValueError, TypeError, KeyError) as error:
            raise _unreadable(self._path, error) from error
