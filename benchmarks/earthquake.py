"""Two dates for real: Kahramanmaras some years before and two months after the earthquakes of February 2023.

There is no truth. What changed was read from the four images by eye, with the result in sight, and stands below as
places: that shows what is invented, and what was seen to be missed, and is no independent count. Where the images are
absent, the simulated town of two_dates.py stands for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np
from osgeo import gdal, ogr

from benchmarks import two_dates
from benchmarks.runner import is_quick, pipeline, say, stage
from benchmarks.scenes import CACHE, SHARED, made_once
from benchmarks.tables import Section, table
from repm_qgis.contracts.results import ChangeResult
from repm_qgis.contracts.stages import CHANGE, DSMFUSE, REGISTER
from repm_qgis.imagery.raster import opened
from repm_qgis.numerics.robust import nmad

_IMAGES = SHARED / "pleiades_two_dates"
_CRS = "EPSG:32637"
_MIDDLE = (315280, 4161640, 315530, 4161890)  # the part of a quick run
_NEAR_M = 3.0  # of a place: outlines of roofs are off by as much

# By eye, east and north in EPSG:32637.
_GONE = (
    *((315398, 4161775), (315178, 4161794), (315353, 4161700), (315521, 4161686), (315175, 4161642)),
    *((315510, 4161587), (315644, 4161848), (315458, 4161956), (315378, 4161942)),
    *((315446, 4161783), (315266, 4162011)),  # new buildings stand on a part of these lots
)
_TREES = ((315656, 4161713), (315566, 4161719), (315193, 4161755), (315229, 4161743), (315357, 4161739))
_BUILT = (
    *((315306, 4161794), (315624, 4161577), (315395, 4161598), (315345, 4161610), (315285, 4162012)),
    *((315175, 4161885), (315421, 4161599), (315476, 4161769), (315193, 4161869), (315370, 4161603)),
    *((315496, 4161976), (315658, 4161608), (315196, 4161629), (315209, 4161895), (315657, 4161894)),
    *((315163, 4161586), (315406, 4161633), (315414, 4161962), (315392, 4162033), (315518, 4162028)),
    *((315220, 4161562), (315315, 4161994), (315424, 4161629), (315424, 4161933), (315635, 4161606)),
)


Kinds = Sequence[Tuple[str, Sequence[Tuple[int, int]], int]]


@dataclass(frozen=True)
class Town:
    """A town: its name in tables, the images of both dates, options of the pipeline, and its changes: of each kind the
    name, places, and whether heights rise (1) or fall (-1)."""

    name: str
    before: Sequence[Path]
    after: Sequence[Path]
    options: Mapping[str, object]
    changes: Kinds


def town() -> Town:
    """The real one where its images are there; else a simulated one."""
    if _IMAGES.exists():
        before, after = ([_IMAGES / f"{date}_event_img{number}.tif" for number in (1, 2)] for date in ("pre", "post"))
        kinds: Kinds = (
            ("buildings that are gone", _GONE, -1),
            ("rows of trees that are gone", _TREES, -1),
            ("new or higher buildings", _BUILT, 1),
        )
        area = {"extent": _MIDDLE, "extent_crs": _CRS} if is_quick() else {}
        return Town("earthquake", before, after, {"crs": _CRS, **area}, kinds)
    folder = two_dates.images_of(900, 3)
    before, after = ([folder / f"date_{date}_{number}.tif" for number in (1, 3)] for date in (0, 1))
    places: Dict[int, List[Tuple[int, int]]] = {-1: [], 1: []}
    for change in two_dates.Dates(folder).changes:
        middle = ogr.CreateGeometryFromWkt(change.outline).Centroid()
        places[-1 if change.kind == "removed" else 1].append((round(middle.GetX()), round(middle.GetY())))
    kinds = ("buildings that are gone", places[-1], -1), ("new or higher buildings", places[1], 1)
    return Town("simulated", before, after, {}, kinds)


@dataclass(frozen=True)
class Dates:
    """Folders of what was made: ``before``, ``after`` with its pointing registered to it, and the change."""

    before: Path
    after: Path
    change: Path


def dates(place: Optional[Town] = None) -> Dates:
    """All of it in the cache; of the town where none is given."""
    place = place or town()
    size = "_quick" * is_quick()
    folders = Dates(*(CACHE / f"{place.name}_{name}{size}" for name in ("before", "after", "change")))
    made_once(folders.before, lambda: _dsm(place.before, place.options, folders.before))
    made_once(folders.after, lambda: _registered(place, folders))
    made_once(folders.change, lambda: _change(folders, folders.change, "none"))
    return folders


def _dsm(images: Sequence[Path], options: Mapping[str, object], folder: Path) -> object:
    made = {"confidence": f"{folder}/confidence.tif", "ortho": f"{folder}/ortho.tif"}
    return pipeline(list(map(str, images)), folder, resolution=0.5, **options, **made)


def _registered(place: Town, folders: Dates) -> None:
    folder = folders.after
    _dsm(place.after, place.options, folder)
    scene = f"{folder}/w/registered.json"
    stage(REGISTER, scene=f"{folder}/w/reconstructed.json", reference=[f"{folders.before}/dsm.tif"], output_scene=scene)
    made = {name: f"{folder}/registered_{name}.tif" for name in ("confidence", "ortho")}
    stage(DSMFUSE, scene=scene, output=f"{folder}/registered_dsm.tif", resolution=0.5, **made)


def _change(folders: Dates, folder: Path, method: str, after: str = "registered_") -> ChangeResult:
    given = {
        "before": f"{folders.before}/dsm.tif",
        "after": f"{folders.after}/{after}dsm.tif",
        "before_confidence": f"{folders.before}/confidence.tif",
        "after_confidence": f"{folders.after}/{after}confidence.tif",
    }
    made = {name: f"{folder}/{name}_{method}.tif" for name in ("output", "significant")}
    return stage(CHANGE, align=method, volumes=f"{folder}/volumes_{method}.gpkg", **given, **made)


# Where the dates lie on each other --------------------------------------------------------------------------------


def _on_grid_of(path: str, other: str) -> np.ndarray:
    """A raster on another one's cells, which lie whole cells away; NaN where it has nothing."""
    place = gdal.Open(other)
    west, cell, _, north = place.GetGeoTransform()[:4]
    bounds = (west, north - cell * place.RasterYSize, west + cell * place.RasterXSize, north)
    warped = gdal.Warp("", path, format="MEM", outputBounds=bounds, xRes=cell, yRes=cell, dstNodata=np.nan)
    return np.asarray(warped.ReadAsArray(), np.float32)


def _fine(image: np.ndarray) -> np.ndarray:
    """What is finer than two metres."""
    known = np.where(np.isfinite(image), image, np.nanmean(image)).astype(np.float32)
    return known - cv2.GaussianBlur(known, (0, 0), 4)


def _shift_of_orthophotos(folders: Dates, after: str) -> Tuple[float, float, float, int]:
    """East and north (m) that lay the later orthophoto on the earlier one, the error of a mean, and how many windows.

    Windows of 16 m on open ground: what their correlation says owes nothing to heights of roofs and walls.
    """
    first = f"{folders.before}/ortho.tif"
    images = [_on_grid_of(path, first) for path in (first, f"{folders.after}/{after}ortho.tif")]
    heights = [_on_grid_of(path, first) for path in (f"{folders.before}/dsm.tif", f"{folders.after}/{after}dsm.tif")]
    side, reach, found = 32, 6, []
    usual = float(np.nanmedian(heights[1] - heights[0]))
    for top in range(reach, images[0].shape[0] - side - reach, 10):
        for left in range(reach, images[0].shape[1] - side - reach, 10):
            own = np.s_[top : top + side, left : left + side]
            flat = all(np.ptp(surface[own]) < 6 for surface in heights)  # False where one has no height
            if not flat or abs(float(np.median(heights[1][own] - heights[0][own])) - usual) > 0.8:
                continue
            wide = np.s_[top - reach : top + side + reach, left - reach : left + side + reach]
            if np.isnan(images[1][wide]).mean() > 0.1:
                continue
            score = cv2.matchTemplate(_fine(images[1][wide]), _fine(images[0][own]), cv2.TM_CCOEFF_NORMED)
            row, col = np.unravel_index(int(score.argmax()), score.shape)
            if score.max() > 0.35 and 0 < row < 2 * reach and 0 < col < 2 * reach:
                best = score[row - 1 : row + 2, col - 1 : col + 2]
                found.append((col - reach + _peak(best[1]), row - reach + _peak(best[:, 1])))
    moved = 0.5 * np.array(found)
    east, down = np.median(moved, axis=0)
    error = 1.25 * max(nmad(moved[:, 0]), nmad(moved[:, 1])) / len(found) ** 0.5
    return -float(east), float(down), error, len(found)


def _peak(three: np.ndarray) -> float:
    """Where the parabola through three scores has its peak, from the middle one."""
    return float(0.5 * (three[0] - three[2]) / (three[0] - 2 * three[1] + three[2]))


def _position(folders: Dates) -> List[str]:
    work = folders.change
    free = _change(folders, work, "3d", "")
    again = _change(folders, work, "3d")
    rows = []
    for name, after, result in (("as it was matched", "", free), ("registered", "registered_", again)):
        east, north, error, count = _shift_of_orthophotos(folders, after)
        shown = f"{east:+.2f}, {north:+.2f} ({error:.2f}; {count} windows)"
        rows.append([name, shown, ", ".join(f"{axis:+.2f}" for axis in (result.dx, result.dy, result.dz))])
    return [
        "How far the later date must be moved to lie on the earlier one, m: what the orthophotos of both dates say on "
        "open ground (east, north; its standard deviation), and what `repm:change` finds with ALIGN=3d (east, north, "
        "up), which looks at differences of heights alone.",
        table("later date | orthophotos | ALIGN=3d", rows),
    ]


# What changed -----------------------------------------------------------------------------------------------------


def _polygons(path: str) -> List[Tuple[ogr.Geometry, float, float, float]]:
    """Shape, area (m2), volume (m3, negative for losses) and its standard deviation."""
    source = ogr.Open(path)
    names = ("area_m2", "volume_m3", "deviation_m3")
    return [(each.GetGeometryRef().Clone(), *(each.GetField(name) for name in names)) for each in source.GetLayer(0)]


def _changes(folders: Dates, kinds: Kinds) -> List[str]:
    found, rows = _polygons(f"{folders.change}/volumes_none.gpkg"), []
    left = set(range(len(found)))
    for name, places, sign in kinds:
        own, seen = set(), 0
        for place in places:
            point = ogr.Geometry(ogr.wkbPoint)
            point.AddPoint_2D(*map(float, place))
            near = {index for index, each in enumerate(found) if each[0].Distance(point) < _NEAR_M}
            here = {index for index in near if found[index][2] * sign > 0}
            own |= here
            seen += bool(here)
        left -= own
        rows.append([name, f"{seen} of {len(places)}", *_sums([found[i] for i in own])])
    rows.append(["not told by eye", f"{len(left)} polygons", *_sums([found[i] for i in left])])
    return [
        "What `repm:change` finds (MIN_AREA=50, registered, ALIGN=none), beside what the four images show to the eye, "
        "which was read with the result in sight. The two buildings that are missed made room for new ones, whose "
        "shadow lies on the rest of their place.",
        table("change | found | area, m2 | volume, m3 | its standard deviation, m3", rows),
    ]


def _sums(polygons: Sequence[Tuple[ogr.Geometry, float, float, float]]) -> List[str]:
    area, volume = (sum(each[index] for each in polygons) for index in (1, 2))
    return [f"{area:.0f}", f"{volume:.0f}", f"{sum(each[3] ** 2 for each in polygons) ** 0.5:.0f}"]


def earthquake() -> List[str]:
    place = town()
    say(f"{place.name}: DSMs of both dates")
    folders = dates(place)
    rows = []
    for name, path in (("before", f"{folders.before}/dsm.tif"), ("after", f"{folders.after}/registered_dsm.tif")):
        heights = _on_grid_of(path, f"{folders.before}/dsm.tif")
        with opened(path.replace("dsm.tif", "confidence.tif")) as dataset:
            source = dataset.GetRasterBand(4).ReadAsArray()
        rows.append(
            [f"{place.name}, {name}", 100 * float(np.isfinite(heights).mean()), 100 * float((source == 0).mean())]
        )
    absent = f"pleiades_two_dates is absent from '{SHARED}': all figures here are of a simulated town."
    return [
        *([absent] if place.name == "simulated" else []),
        "Kahramanmaras, two Pleiades pairs of 1000 px (B/H 0.31 and 0.28, cells of 0.5 m; images: CNES, Licence "
        "Ouverte 2.0). There is no truth. The earlier images are some years older than the earthquakes, so new "
        "buildings are among the changes, and a cleared ruin looks like any demolition.",
        table("DSM | with a height, % of the rectangle | matched, %", rows),
        *_position(folders),
        *_changes(folders, place.changes),
    ]


SECTIONS = [Section("earthquake", "Two dates of a town, for real", "make bench-earthquake", {"earthquake": earthquake})]
