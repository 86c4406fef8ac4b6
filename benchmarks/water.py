"""Water: what share of simulated lakes and of a river is found, how high it is, and what dry ground is taken for it."""

from __future__ import annotations

from pathlib import Path
from typing import List, Tuple

import numpy as np
from osgeo import gdal

from benchmarks.runner import few, is_quick, pipeline, say
from benchmarks.scenes import CACHE, SHARED, made_once
from benchmarks.tables import Section, table
from benchmarks.water_and_clouds import DARK, LAND, WATER, make_pair
from repm_qgis.contracts.results import PipelineResult
from repm_qgis.contracts.stages import DSMFUSE
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage

_WET = (
    ("urban", 5, "lakes"),
    ("mountains", 6, "lakes"),
    ("mountains", 5, "river"),
    ("urban", 5, "lakes, XS"),
    ("mountains", 6, "lakes, XS"),
)
_SIZE = 700
_PATCHES = (("urban", 5, False), ("mountains", 6, False), ("mountains", 6, True))
_DRY = {
    "jax_068, three views": [f"jax_068/JAX_068_{number}_RGB.tif" for number in ("009", "011", "012")],
    "pleiades_pair": [f"pleiades_pair/img_0{number}.tif" for number in (1, 2)],
    "pleiades_triplet": [f"pleiades_triplet/img_0{number}.tif" for number in (1, 2, 3)],
    "pleiades_two_dates, before": [f"pleiades_two_dates/pre_event_img{number}.tif" for number in (1, 2)],
    "pleiades_two_dates, after": [f"pleiades_two_dates/post_event_img{number}.tif" for number in (1, 2)],
}


def _size() -> int:
    """px of a side."""
    return 620 if is_quick() else _SIZE


def _made(images: List[str], folder: Path) -> PipelineResult:
    return pipeline(images, folder, resolution=0.5, workers=1, water="flatten", water_mask=f"{folder}/water.tif")


def _on(path: Path, truth: gdal.Dataset, nodata: float) -> np.ndarray:
    """A raster on the cells of another one."""
    place, size = truth.GetGeoTransform(), (truth.RasterXSize, truth.RasterYSize)
    bounds = (place[0], place[3] + place[5] * size[1], place[0] + place[1] * size[0], place[3])
    options = {"outputBounds": bounds, "xRes": place[1], "yRes": place[1], "dstNodata": nodata}
    warped = gdal.Warp("", str(path), format="MEM", dstSRS=truth.GetProjection(), **options)
    return np.asarray(warped.ReadAsArray(), float)


def _wet(kind: str, seed: int, what: str) -> List[List[object]]:
    folder = CACHE / f"water_{kind}_{seed}_{what.replace(', ', '_')}_{_size()}"
    river, xs = what == "river", "XS" in what

    def simulate() -> None:
        made = make_pair(str(folder), kind, _size(), seed=seed, clouds=not river, river=river, xs=xs)
        np.save(folder / "classes.npy", made.classes)
        _made(made.images, folder)

    made_once(folder, simulate)
    truth = gdal.Open(str(folder / "truth.tif"))
    true = truth.ReadAsArray().astype(float)
    classes = np.load(folder / "classes.npy")[: true.shape[0], : true.shape[1]]
    water = _on(folder / "water.tif", truth, 255) == 1
    error = _on(folder / "dsm.tif", truth, np.nan) - true
    land = classes == LAND
    error -= float(np.nanmedian(error[land]))
    rows = []
    for name, number in WATER.items():
        own = classes == number
        if own.any():
            shown = _level(error[own & water])
            kind_of = "river, still" if river else f"lake, {name}"
            rows.append([f"{kind}, seed {seed}{', XS' * xs}", kind_of, 100 * float(water[own].mean()), shown, ""])
    rows[-1][-1] = f"{100 * float(water[land].mean()):.3f}"
    return rows


def _level(error: np.ndarray) -> str:
    """Quantiles of a level's errors, m; most cells of a body without a level have no height."""
    if not error.size:
        return "-"
    known = error[np.isfinite(error)]
    if known.size < error.size / 2:
        return "left open"
    return ", ".join(f"{value:+.2f}" for value in np.percentile(known, (5, 50, 95)))


def _dry() -> Tuple[List[List[object]], List[str]]:
    rows: List[List[object]] = []
    absent: List[str] = []
    for name, files in few(list(_DRY.items())):
        images = [str(SHARED / file) for file in files]
        if not all(Path(image).exists() for image in images):
            absent.append(name)
            continue
        folder = CACHE / f"water_{name.replace(', ', '_').replace(' ', '_')}"
        made_once(folder, lambda: _made(images, folder))  # noqa: B023 - runs now
        mask = gdal.Open(str(folder / "water.tif"))
        values = mask.ReadAsArray()
        rows.append([name, f"{(values == 0).sum() / 4e4:.1f}", f"{(values == 1).sum() / 4:.0f}"])
    return rows, absent


def water() -> List[str]:
    say("water: simulated lakes and a river")
    wet = [row for case in few(_WET) for row in _wet(*case)]
    dry, absent = _dry()
    return [
        f"Simulated pairs of {_size()} px with three or four lakes and two clouds, or with a river that falls by 8 m "
        "(`benchmarks/water_and_clouds.py`), with WATER=flatten. *Found*: the share of the true water. *Level*: found "
        "minus true, as 5, 50 and 95 % quantiles, after the median error of land is taken off; shores are half a metre "
        "and more above the water; it is left open where a cloud hides too much of the shore. *Land*: the share of "
        "land that is taken for water. *XS*: multispectral images of a quarter of the resolution lie beside the "
        "panchromatic ones. Without them, glint and murky water are bright, and are not looked for.",
        table("pair | water | found, % | level, m | land, %", wet),
        "Real images without water, in towns with tall shadows, fields and mountains:",
        table("images | heights, ha | taken for water, m2", dry),
        *([f"Not measured, absent from '{SHARED}': {', '.join(absent)}."] if absent else []),
    ]


def _patches(kind: str, seed: int, lakes: bool) -> List[List[object]]:
    """What share of dark patches, of lakes and of other land is taken for water, with XS and without."""
    name = f"dark_{kind}_{seed}{'_lakes' * lakes}_{_size()}"
    folder, made = CACHE / name, CACHE / f"{name}_water"

    def simulate() -> None:
        pair = make_pair(str(folder), kind, _size(), seed=seed, water=lakes, clouds=False, xs=True, dark=True)
        np.save(folder / "classes.npy", pair.classes)

    def measure() -> None:
        found = _made([str(folder / f"img_0{number}.tif") for number in (1, 2)], made)
        grey = {"colour": "greys", "output": f"{made}/grey.tif", "water_mask": f"{made}/grey_water.tif"}
        run_stage(DSMFUSE, {"scene": found.scene, "resolution": 0.5, "workers": 1, **grey}, Silent())

    made_once(folder, simulate)
    made_once(made, measure)
    truth = gdal.Open(str(folder / "truth.tif"))
    classes = np.load(folder / "classes.npy")[: truth.RasterYSize, : truth.RasterXSize]
    rows: List[List[object]] = []
    for given, file in (("XS", "water.tif"), ("no XS", "grey_water.tif")):
        water = _on(made / file, truth, 255) == 1
        of = {**DARK, "land": LAND, **(WATER if lakes else {})}
        shares = {each: 100 * float(water[classes == number].mean()) for each, number in of.items()}
        cells = [f"{shares[each]:.1f}" if each in shares else "" for each in (*DARK, *WATER)]
        rows.append([f"{kind}, seed {seed}{', lakes' * lakes}", given, *cells, f"{shares['land']:.3f}"])
    return rows


def dark() -> List[str]:
    say("water: dark patches of dry ground")
    rows = [row for case in few(_PATCHES) for row in _patches(*case)]
    return [
        f"Simulated pairs of {_size()} px, without clouds, with two dark patches of 0.4 ha that have no texture: shade "
        "on ground of one colour, and tarmac in the sun (`benchmarks/water_and_clouds.py`). Per cent of each that is "
        "taken for water.",
        table("pair | images | shade | tarmac | still water | ripples | glint | murky | other land", rows),
    ]


SECTIONS = [
    Section("water", "Lakes and rivers", "make bench-water", {"water": water}),
    Section("dark_ground", "Dark ground that looks like water", "make bench-water", {"dark": dark}),
]
