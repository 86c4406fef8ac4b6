"""Twins of runs on a simulated scene: references of its true surface in many forms, and images in other orders,
directions, depths and cuts, whose DSMs must be the same."""

from __future__ import annotations

import csv
import shutil
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Dict, List, Sequence, Tuple

import laspy
import numpy as np
import pyproj
from osgeo import gdal

from benchmarks.runner import pipeline, stage
from benchmarks.twin_trials import Draw, Heard, Trial, off_by
from repm_qgis.contracts.results import RegisterResult
from repm_qgis.contracts.stages import REGISTER, SAMPLEDATA
from repm_qgis.runtime.progress import Silent

_SIZE = 400
_NONE = -9999.0
_FEET = 0.3048


@dataclass(frozen=True)
class Truth:
    """A simulated scene in a folder: its images, its true heights (rows, columns; NaN where there is none) with their
    geotransform and CRS, the scene with height maps, its DSM, and its registration to all true heights."""

    images: Tuple[str, ...]
    heights: np.ndarray
    transform: Tuple[float, ...]
    crs: str
    scene: str
    dsm: str
    base: RegisterResult


@lru_cache(maxsize=1)
def truth_in(folder: str) -> Truth:
    made = stage(SAMPLEDATA, folder=folder, kind="urban", size=_SIZE, seed=3)
    images = tuple(made.images[:2])
    run = pipeline(images, folder, Silent(), resolution=0.5, workers=1)
    dataset = gdal.Open(made.truth)
    heights = dataset.ReadAsArray().astype(np.float64)
    heights[heights == dataset.GetRasterBand(1).GetNoDataValue()] = np.nan
    system = dataset.GetSpatialRef()
    scene = f"{folder}/w/reconstructed.json"
    base = stage(
        REGISTER,
        scene=scene,
        output_scene=f"{folder}/base.json",
        reference=[made.truth],
        reference_datum="ellipsoid",
        workers=1,
    )
    transform, crs = tuple(dataset.GetGeoTransform()), f"EPSG:{system.GetAuthorityCode(None)}"
    return Truth(images, heights, transform, crs, scene, str(run.output), base)


# References ---------------------------------------------------------------------------------------------------------


def _write(path: str, heights: np.ndarray, transform: Sequence[float], crs: str, unit: str = "m") -> str:
    rows, columns = heights.shape
    made = gdal.GetDriverByName("GTiff").Create(path, columns, rows, 1, gdal.GDT_Float32)
    made.SetGeoTransform(list(transform))
    made.SetProjection(pyproj.CRS(crs).to_wkt())
    made.SetMetadataItem("VERTICAL_DATUM", "WGS 84 ellipsoid")
    band = made.GetRasterBand(1)
    band.SetNoDataValue(_NONE)
    band.SetUnitType(unit)
    band.WriteArray(np.where(np.isfinite(heights), heights, _NONE))
    made = band = None  # noqa: F841 - closes them
    return path


def _xyz(heights: np.ndarray, transform: Sequence[float]) -> np.ndarray:
    row, column = np.nonzero(np.isfinite(heights))
    west, wide, _, north, _, high = transform
    x, y = west + (column + 0.5) * wide, north + (row + 0.5) * high
    return np.column_stack([x, y, heights[row, column]])


def _las(path: str, xyz: np.ndarray, crs: str) -> str:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.add_crs(pyproj.CRS(crs))
    header.offsets, header.scales = np.floor(xyz.min(axis=0)), [0.001, 0.001, 0.001]
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = xyz.T
    cloud.return_number = np.ones(len(xyz), np.uint8)
    cloud.write(path)
    return path


_GAPPED = ("stripes", "checkers")
"""Of these a direction may be undetermined, which is named."""
FORMS = ("raster", "coarse raster", "stripes", "checkers", "lattice", "points", "cloud")
FAULTS = {
    "negated": lambda h: 2 * np.nanmedian(h) - h,
    "turned by 180 degrees": lambda h: h[::-1, ::-1],
    "random": lambda h: np.nanmedian(h) + np.random.default_rng(1).normal(0, np.nanstd(h), h.shape),
    "constant": lambda h: np.where(np.isfinite(h), np.nanmedian(h), np.nan),
    "of another place": lambda h: np.roll(h, (h.shape[0] // 3, h.shape[1] // 3), (0, 1)),
    "in feet that nothing states": lambda h: h / _FEET,
}


def register(draw: Draw) -> Trial:
    """A reference of the true surface in any form, moved by a known shift: the scene is moved by it."""
    rng = draw.rng
    form = FORMS[rng.integers(len(FORMS))]
    moved = rng.uniform((-2.5, -2.5, -4.0), (2.5, 2.5, 4.0))
    fault = ["", "", "", *FAULTS, "a copy and itself", "two that contradict each other"][rng.integers(11)]
    sigma = float(rng.uniform(0.02, 0.25))

    def run(heard: Heard) -> str:
        truth = truth_in(str(draw.shared))
        heights = truth.heights + moved[2] + sigma * rng.normal(size=truth.heights.shape)
        if fault in FAULTS:
            heights = np.where(np.isfinite(truth.heights), FAULTS[fault](heights), np.nan)
        west, wide, _, north, _, high = truth.transform
        place = (west + moved[0], wide, 0.0, north + moved[1], 0.0, high)
        references = [_reference(draw, form, heights, place, truth.crs)]
        if fault == "a copy and itself":
            suffix = Path(references[0]).suffix
            references.append(shutil.copy(references[0], draw.path(f"copy{suffix}")))
        if fault == "two that contradict each other":
            references.append(_write(draw.path("other.tif"), heights + 6.0, place, truth.crs))
        made = stage(
            REGISTER,
            heard,
            scene=truth.scene,
            output_scene=draw.path("out.json"),
            reference=references,
            reference_datum="ellipsoid",
            report=draw.path("r.html"),
            workers=1,
        )
        base = truth.base
        wrong = [
            off_by(got, was + add, 3.0 * float(np.hypot(deviation, own)) + 0.1, f"the shift {name}, m,")
            for name, got, was, add, deviation, own in (
                ("to the east", made.east, base.east, moved[0], made.east_deviation, base.east_deviation),
                ("to the north", made.north, base.north, moved[1], made.north_deviation, base.north_deviation),
                ("up", made.up, base.up, moved[2], made.up_deviation, base.up_deviation),
            )
        ]
        return next(filter(None, wrong), "")

    return Trial(f"reference {fault}" if fault else f"reference as {form}", not fault and form not in _GAPPED, run)


def _reference(draw: Draw, form: str, heights: np.ndarray, place: Sequence[float], crs: str) -> str:
    """A reference file of a form, of heights on the cells of a place."""
    rng, path = draw.rng, draw.path("reference.tif")
    row, column = np.indices(heights.shape)
    if form == "raster":
        return _write(path, heights, place, crs)
    if form == "coarse raster":
        rows, columns = (side // 4 * 4 for side in heights.shape)
        blocks = heights[:rows, :columns].reshape(rows // 4, 4, columns // 4, 4)
        return _write(path, blocks.mean(axis=(1, 3)), (place[0], 4 * place[1], 0, place[3], 0, 4 * place[5]), crs)
    if form in ("stripes", "checkers"):
        kept = column % 4 < 2 if form == "stripes" else (row // 2 + column // 2) % 2 == 0
        return _write(path, np.where(kept, heights, np.nan), place, crs)
    if form == "lattice":
        kept = (row % 4 == 0) & (column % 4 == 0)
        return _las(draw.path("reference.laz"), _xyz(np.where(kept, heights, np.nan), place), crs)
    xyz = _xyz(heights, place)
    if form == "cloud":
        count = int(rng.uniform(0.12, 2.0) * len(xyz) * abs(place[1] * place[5]))
        return _las(draw.path("reference.laz"), xyz[rng.choice(len(xyz), min(count, len(xyz)), replace=False)], crs)
    some = xyz[rng.choice(len(xyz), int(rng.uniform(300, 1500)), replace=False)]
    lon, lat = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(some[:, 0], some[:, 1])
    with open(draw.path("reference.csv"), "w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["longitude", "latitude", "height"])
        table.writerows([f"{a:.9f}", f"{b:.9f}", f"{h:.3f}"] for a, b, h in zip(lon, lat, some[:, 2]))
    return draw.path("reference.csv")


# Images -------------------------------------------------------------------------------------------------------------

_TURNS = {  # (columns, rows): sign of the new column and row, and whether they are exchanged
    "turned by 90 degrees": lambda pixels: np.rot90(pixels),
    "turned by 180 degrees": lambda pixels: np.rot90(pixels, 2),
    "mirrored": lambda pixels: pixels[:, ::-1],
}
TWINS = (
    "in reverse order",
    *_TURNS,
    "in 8 bit",
    "in floating point",
    "cut by 16 px",
    "with a frame of 0",
    "with a frame of 65535",
)


_POORER = ("in 8 bit", "with a frame of 0", "with a frame of 65535")
"""Less contrast, and ground that the RPC shows and the pixels do not: these may be named."""


def images(draw: Draw) -> Trial:
    """The same images in another form: the same DSM."""
    what = TWINS[draw.rng.integers(len(TWINS))]

    def run(heard: Heard) -> str:
        truth = truth_in(str(draw.shared))
        order = truth.images[::-1] if what == "in reverse order" else truth.images
        paths = [_twin(path, draw.path(f"{k}.tif"), what) for k, path in enumerate(order)]
        made = pipeline(paths, draw.folder, heard, resolution=0.5, workers=1)
        return _same_surface(truth.dsm, str(made.output), what)

    return Trial(f"images {what}", what not in _POORER, run)


def _same_surface(one: str, other: str, what: str) -> str:
    """What is wrong with a DSM beside that of its twin: a height as a whole, a spread, or missing cells."""
    first, second = gdal.Open(one), gdal.Open(other)
    values, places = [], []
    for dataset in (first, second):
        heights = dataset.GetRasterBand(1).ReadAsArray().astype(np.float64)
        heights[heights == dataset.GetRasterBand(1).GetNoDataValue()] = np.nan
        values.append(heights)
        west, _, _, north, _, _ = dataset.GetGeoTransform()
        places.append((round(west / 0.5), round(-north / 0.5)))
    col, row = (max(a, b) for a, b in zip(*places))
    parts = [heights[row - y :, col - x :] for heights, (x, y) in zip(values, places)]
    rows, columns = (min(part.shape[axis] for part in parts) for axis in (0, 1))
    ours, theirs = (part[:rows, :columns] for part in parts)
    both = np.isfinite(ours) & np.isfinite(theirs)
    away = (theirs - ours)[both]
    middle = float(np.median(away))
    least = 0.85 if "cut" in what else 0.97
    return next(
        filter(
            None,
            (
                off_by(middle, 0.0, 0.05, "the median difference of the twins, m,"),
                off_by(1.4826 * float(np.median(np.abs(away - middle))), 0.0, 0.25, "their NMAD, m,"),  # half a cell
                off_by(min(both.sum() / np.isfinite(ours).sum(), 1.0), 1.0, 1.0 - least, "the share of its cells"),
            ),
        ),
        "",
    )


def _twin(path: str, target: str, what: str) -> str:
    """An image in another form, with the RPC that belongs to it."""
    dataset = gdal.Open(path)
    pixels, rpc = dataset.ReadAsArray(), dataset.GetMetadata("RPC")
    rows, columns = pixels.shape
    if what in _TURNS:
        pixels, rpc = np.ascontiguousarray(_TURNS[what](pixels)), _turned(rpc, what, rows, columns)
    elif what == "in 8 bit":
        low, high = np.percentile(pixels, (0.1, 99.9))
        pixels = np.clip((pixels - low) / (high - low) * 254 + 1, 1, 255).astype(np.uint8)
    elif what == "in floating point":
        pixels = pixels.astype(np.float32) / 3.0
    elif what == "cut by 16 px":
        pixels = pixels[16:-16, 16:-16]
        rpc = {**rpc, "LINE_OFF": str(float(rpc["LINE_OFF"]) - 16), "SAMP_OFF": str(float(rpc["SAMP_OFF"]) - 16)}
    elif "frame" in what:
        pixels = np.pad(pixels, 40, constant_values=int(what.rsplit(" ", 1)[1]))
        rpc = {**rpc, "LINE_OFF": str(float(rpc["LINE_OFF"]) + 40), "SAMP_OFF": str(float(rpc["SAMP_OFF"]) + 40)}
    kinds = {"uint8": gdal.GDT_Byte, "uint16": gdal.GDT_UInt16, "float32": gdal.GDT_Float32}
    size = pixels.shape[1], pixels.shape[0]
    made = gdal.GetDriverByName("GTiff").Create(target, *size, 1, kinds[str(pixels.dtype)])
    made.SetMetadata(rpc, "RPC")
    made.GetRasterBand(1).WriteArray(pixels)
    made = None  # noqa: F841 - closes it
    return target


def _turned(rpc: Dict[str, str], what: str, rows: int, columns: int) -> Dict[str, str]:
    """The RPC of an image whose pixels were turned as numpy turns them."""

    def negated(axis: str, most: int) -> Dict[str, str]:
        numbers = [f"{-float(each):.15g}" for each in rpc[f"{axis}_NUM_COEFF"].split()]
        return {f"{axis}_OFF": str(most - float(rpc[f"{axis}_OFF"])), f"{axis}_NUM_COEFF": " ".join(numbers)}

    if what == "mirrored":
        return {**rpc, **negated("SAMP", columns - 1)}
    if what == "turned by 180 degrees":
        return {**rpc, **negated("SAMP", columns - 1), **negated("LINE", rows - 1)}
    # By 90 degrees, the new row is the last column minus the old one, and the new column is the old row.
    flipped = {**rpc, **negated("SAMP", columns - 1)}
    names: List[str] = ["OFF", "SCALE", "NUM_COEFF", "DEN_COEFF"]
    exchanged = {f"LINE_{name}": flipped[f"SAMP_{name}"] for name in names}
    return {**flipped, **exchanged, **{f"SAMP_{name}": rpc[f"LINE_{name}"] for name in names}}
