"""Bad input, the part on heights: RPCs that are wrong along the parallax, the stated uncertainty, cells that are too
fine. benchmarks/input.py runs the trials, and has the calibration as a part of its own."""

from __future__ import annotations

import os
import re
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, List, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from benchmarks.input_case import Ended, Job, Trial, off, pipeline, pixels_of, say_of, town, true_views, write_plain
from benchmarks.pointing_case import fitted, pointed, truth_scene
from benchmarks.runner import few, is_quick, say
from benchmarks.scenes import CACHE, SHARED, real
from benchmarks.tables import table
from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.contracts.records import PointingFigures
from repm_qgis.imagery.raster import opened, read, write
from repm_qgis.planning.height_uncertainty import height_uncertainty, usual_height_deviation
from repm_qgis.planning.pair_selection import choose_pairs
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.planning.promises import promise_of
from repm_qgis.pointing.adjustment import Adjustment, adjust
from repm_qgis.pointing.pointing import Pointing, ground_heights
from repm_qgis.pointing.vertical_parallax import tracks_of_pair
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.scene import Scene as SceneFile
from repm_qgis.scene import View, load_views
from repm_qgis.ties.tracks import Track

_DEM_CELLS = 20  # of the true surface in one of the DEM's
_STATED = "The absolute height is uncertain by"
_MOST_PX = 50.0  # the largest pointing error that is drawn
_SIZES_PX = (10, 20, 30, 40, 60, 100, 200)
_PLACES = 12  # drawn errors with which tie points are found anew


# --- trials ---------------------------------------------------------------------------------------------------------


def coarse_dem(truth: str, folder: Path) -> str:
    """The true surface in cells of 10 m, as the DEM of a user."""
    with opened(truth) as dataset:
        heights, place, wkt = read(dataset), list(dataset.GetGeoTransform()), dataset.GetProjection()
    rows, columns = (count // _DEM_CELLS for count in heights.shape)
    blocks = heights[: rows * _DEM_CELLS, : columns * _DEM_CELLS].reshape(rows, _DEM_CELLS, columns, _DEM_CELLS)
    place[1], place[5] = place[1] * _DEM_CELLS, place[5] * _DEM_CELLS
    return write(str(folder / "dem.tif"), [blocks.mean(axis=(1, 3))], place, pyproj.CRS(wkt).to_wkt())


def moved_rows(rows: float, dem: bool, folder: Path) -> List[Job]:
    """The town's first two images under true RPCs, the second's so many rows off, with file names of Pleiades 1A."""
    images = []
    for number, view in enumerate(true_views(2)):
        rpc = view.rpc.shifted(0.0, rows * number)
        images.append(write_plain(folder / f"PHR1A_{view.name}.tif", pixels_of(view.image), rpc))
    return [pipeline(folder, images, **({"dem": coarse_dem(town().reference, folder)} if dem else {}))]


def moved_real(rows: float, dem: bool, folder: Path) -> List[Job]:
    """The real Pleiades pair, the second RPC so many rows off; S2P's DSM is the user's DEM where one is wanted."""
    (scene,) = real("pleiades_pair")
    first, second = scene.images
    with opened(second) as dataset:
        pixels, tags, name = read(dataset), dataset.GetMetadata("RPC"), dataset.GetMetadata()
    tags = {**tags, "LINE_OFF": str(float(tags["LINE_OFF"]) + rows)}
    image = write_plain(folder / "img_02.tif", pixels.astype(np.uint16), tags=name)
    with_tags(image, tags)
    return [pipeline(folder, [first, image], **({"dem": scene.reference} if dem else {}))]


def with_tags(image: str, tags: Dict[str, str]) -> None:
    """Give an image RPC tags as they are."""
    dataset = gdal.Open(image, gdal.GA_Update)
    dataset.SetMetadata(tags, "RPC")
    dataset = None


def resolution(cell: float, folder: Path) -> List[Job]:
    return [pipeline(folder, town().images[:2], resolution=cell)]


def judged(truth: Callable[[], str], words: Sequence[str], ended: Ended) -> str:
    """How far off the DSM is in metres and in stated deviations, and what was said."""
    found, stated = off(ended, truth()), re.search(_STATED + r" ([\d.]+) m", " ".join(ended.said))
    wrong = re.search(r"([\d.]+) m wrong", found)
    if stated and wrong:
        found += f", {PLANNING.promises.le90 * float(wrong[1]) / float(stated[1]):.1f} stated standard deviations"
    return f"{found}; {say_of(ended, words)}"


def filled(ended: Ended) -> str:
    return f"exit 0: VALID_PERCENT {ended.result['valid_percent']:.1f}; {say_of(ended, ('finer than',))}"


def _town_truth() -> str:
    return town().reference


def _s2p() -> str:
    return str(real("pleiades_pair")[0].reference)


_ABOUT_DEM = (_STATED, "above the DEM", "below the DEM")
_ABOUT_RPC = (_STATED, "its RPCs were made for")
TRIALS: List[Trial] = [
    Trial(
        "3",
        "an RPC 30 rows off, a DEM given",
        partial(moved_rows, 30.0, True),
        partial(judged, _town_truth, _ABOUT_DEM),
    ),
    Trial("3", "true RPCs, a DEM given", partial(moved_rows, 0.0, True), partial(judged, _town_truth, _ABOUT_DEM)),
    *(
        Trial(
            "3",
            "the real Pleiades pair, an RPC 30 rows off, S2P's DSM given as DEM (and as the truth)",
            partial(moved_real, 30.0, True),
            partial(judged, _s2p, _ABOUT_DEM),
        )
        for _ in real("pleiades_pair")
    ),
    Trial("4", "RPCs that agree", partial(moved_rows, 0.0, False), partial(judged, _town_truth, _ABOUT_RPC)),
    Trial("4", "an RPC 60 rows off", partial(moved_rows, 60.0, False), partial(judged, _town_truth, _ABOUT_RPC)),
    *(
        Trial(
            "4",
            "the real Pleiades pair, an RPC 200 rows off (the truth is S2P's DSM)",
            partial(moved_real, 200.0, False),
            partial(judged, _s2p, _ABOUT_RPC),
        )
        for _ in real("pleiades_pair")
    ),
    *(
        Trial("6", f"RESOLUTION {cell:g} m, images of 0.5 m", partial(resolution, cell), filled)
        for cell in (0.5, 0.25, 0.13)
    ),
]


# --- sizes of an error along the parallax -----------------------------------------------------------------------------


def along_parallax() -> List[str]:
    """What is stated and said where one RPC of a pair is wrong along the parallax by known sizes, both ways."""
    cases = [("simulated town, as Pleiades 1A", true_views(2), "PHR1A_")]
    cases += [("real Pleiades pair", list(load_views(scene.images)), "") for scene in real("pleiades_pair")]
    jax = [str(SHARED / "jax_068" / f"JAX_068_00{number}_RGB.tif") for number in (2, 3)]
    cases += [("`jax_068`, WorldView-3", list(load_views(jax)), "") for _ in (1,) if all(map(os.path.exists, jax))]
    rows = []
    for name, views, prefix in few(cases):
        true, (low, high) = _pointed_as(views, prefix, 0.0), views[0].rpc.height_range
        for size in few(_SIZES_PX):
            say(f"{name}: {size} px ...")
            tried = [_along(views, prefix, sign * size, true) for sign in (1, -1)]
            rows.append([name, f"{low:.0f} to {high:.0f}", size, *map(" / ".join, zip(*tried))])
    headers = (
        "pair | heights of its RPCs, m | RPC wrong along the parallax by, px | heights wrong by, m | stated deviation "
        "without the RPCs' heights, m | wrong by so many of them | stated deviation now, m | wrong by so many | warned"
    )
    return [
        "**An RPC that is wrong along the parallax** makes wrong heights and leaves no other trace in a pair, unless "
        "the ground then lies outside the heights that its RPCs were made for. Each row has an error up and one down; "
        "heights are compared over the tie points. Stops: too few tie points.",
        table(headers, rows),
    ]


def _along(views: Sequence[View], prefix: str, size_px: float, true: Pointing) -> List[str]:
    """The cells of one error: how wrong the heights are; what is stated without and with the RPCs' heights, and how
    many of these they are wrong by; whether it is warned of."""
    try:
        found = _pointed_as(views, prefix, size_px)
    except EmptyResultError:
        return ["stops"] * 6
    new, old = ((each.tracks, each.adjusted) for each in (found, true))
    up = up_between(new, old, prefix + views[0].name)
    before = height_uncertainty(found.views, replace(found.figures, ground_m=None)).deviation_m
    now = height_uncertainty(found.views, found.figures)
    stated = before, abs(up) / before, now.deviation_m, abs(up) / now.deviation_m
    return [f"{up:+.0f}", *(f"{figure:.1f}" for figure in stated), "yes" if now.outside else "no"]


def _pointed_as(views: Sequence[View], prefix: str, size_px: float) -> Pointing:
    """The pointing of a pair whose second RPC is so many px off in the direction in which heights move its pixels.

    The images are written anew with names that begin with ``prefix``, which may name a satellite.
    """
    first, second = views
    middle = (np.array(first.size) - 1) / 2
    ends = [second.project(first.localise(middle, second.rpc.height_off + up)) for up in (0.0, 10.0)]
    shift = size_px * (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    with tempfile.TemporaryDirectory() as folder:
        images = []
        for view, rpc in ((first, first.rpc), (second, second.rpc.shifted(*map(float, shift)))):
            images.append(str(Path(folder) / f"{prefix}{Path(view.image).name}"))
            gdal.Translate(images[-1], view.image)
            with_tags(images[-1], rpc_tags(rpc))
        return pointed(fitted(images, Path(folder) / "w"), "shift")


# --- the calibration ------------------------------------------------------------------------------------------------


def figures_of(views: Sequence[View], tracks: Sequence[Track], adjusted: Adjustment, like: PointingFigures) -> Any:
    """A scene's figures with the shifts, the vertical parallax and the heights of another adjustment."""
    of = {view.name: view for view in views}
    pairs = [pair for pair in like.pairs if {*pair.pair} <= {*of}]
    parallax = (tracks_of_pair((of[p.pair[0]], of[p.pair[1]]), tracks, adjusted.ground)[1] for p in pairs)
    shifts = {name: (float(shift[0]), float(shift[1])) for name, shift in adjusted.shifts.items()}
    seen = tuple(replace(pair, before_px=float(np.median(found))) for pair, found in zip(pairs, parallax))
    return replace(like, shifts_px=shifts, pairs=seen, ground_m=ground_heights(adjusted))


def drawn(views: Sequence[View], scatter: bool, rng: np.random.Generator) -> Tuple[List[View], float]:
    """The views with RPCs that are wrong as is promised, and the largest error, px; with ``scatter`` some scenes are
    better than promised and others worse, as the formula has it."""
    freedom = PLANNING.promises.freedom
    factor = float(np.sqrt(freedom / rng.chisquare(freedom))) if scatter else 1.0
    wrong, most = [], 0.0
    for view in views:
        deviation = factor * promise_of(view).horizontal_m / PLANNING.promises.ce90 / view.gsd_m
        shift = rng.normal(0.0, deviation, 2)
        while np.hypot(*shift) > _MOST_PX:
            shift = rng.normal(0.0, deviation, 2)
        wrong.append(replace(view, rpc=view.rpc.shifted(*shift)))
        most = max(most, float(np.hypot(*shift)))
    return wrong, most


def calibration() -> List[str]:
    """The stated uncertainty of the absolute height against 100 simulated pointing errors."""
    scene = fitted(truth_scene("town").images, CACHE / "heights_w")
    known = pointed(scene, "shift")
    rows, again, rng = [], [], np.random.default_rng(5)
    draws, altitude = 10 if is_quick() else 100, sum(scene.altitudes) / 2
    for names in few((("img_01", "img_02"), ("img_01", "img_02", "img_03"))):
        views = [view for view in scene.views if view.name in names]
        tracks = [Track({n: track.pixels[n] for n in names if n in track.pixels}) for track in known.tracks]
        tracks = [track for track in tracks if len(track.pixels) > 1]
        true = adjust(views, tracks, altitude)
        pairs = choose_pairs(replace(scene, views=tuple(views)))
        for scatter in (False, True):
            say(f"{len(names)} images, {'scatter' if scatter else 'as promised'} ...")
            found = []
            for number in range(draws):
                wrong, most = drawn(views, scatter, rng)
                adjusted = adjust(wrong, tracks, altitude)
                up = float(np.median(adjusted.ground[:, 2] - true.ground[:, 2]))
                figures = figures_of(wrong, tracks, adjusted, known.figures)
                now = height_uncertainty(wrong, figures).deviation_m
                found.append((up, now, usual_height_deviation(pairs, figures, scene.gsd_m), most))
                if not scatter and number < _PLACES // 2 and len(names) == len(scene.views):
                    again.append(abs(up_with_new_ties(replace(scene, views=tuple(wrong)), known.tracks, true) - up))
            offset, now, before, most = np.array(found).T
            within = [f"{100 * np.mean(np.abs(offset) < k * each):.0f}" for each in (before, now) for k in (1, 2)]
            errors = "scatter" if scatter else "as promised"
            spread = f"{np.sqrt(np.mean(offset**2)):.1f}", f"{np.median(before):.1f}", f"{np.median(now):.1f}"
            rows.append([len(names), errors, draws, f"{np.median(most):.0f} / {most.max():.0f}", *spread, *within])
    headers = (
        "images | errors | draws | largest error of a draw, px (median / largest) | RMS of the height's error, m | "
        "stated deviation before, m (median) | now, m | within one before, % | within two | within one now, % | "
        "within two"
    )
    checked = (
        f" With tie points that are found anew under the wrong RPCs the height differs by {max(again):.2f} m at most "
        f"({len(again)} draws of three images)."
        if again
        else ""
    )
    return [
        "**The stated uncertainty of the absolute height**: the town, 800 px of 0.5 m, satellite unknown (CE90 20 m "
        "assumed). Each draw makes each RPC wrong by an error of its own, at most 50 px; the tie points of the true "
        "images are adjusted, and the height's error is the median over them. As promised: each error is normal with "
        "the deviation that is assumed. Scatter: the deviation differs from scene to scene, by the distribution that "
        f"the formula has.{checked} Bar: 68 % within one and 95 % within two stated deviations, or more.",
        table(headers, rows),
    ]


def up_with_new_ties(scene: SceneFile, tracks: Sequence[Track], true: Adjustment) -> float:
    """The error of the height where tie points are found anew: the median over ties of like places in the first
    image."""
    found = pointed(scene, "shift")
    return up_between((found.tracks, found.adjusted), (tracks, true), scene.views[0].name)


def up_between(
    found: Tuple[Sequence[Track], Adjustment], true: Tuple[Sequence[Track], Adjustment], first: str
) -> float:
    """By how much heights are too great: the median over ties of like places in the image ``first``."""
    new, old = (
        np.array([[*t.pixels[first], h] for t, h in zip(tracks, adjusted.ground[:, 2]) if first in t.pixels])
        for tracks, adjusted in (found, true)
    )
    away = np.hypot(*(new[:, None, :2] - old[None, :, :2]).transpose(2, 0, 1))
    nearest = away.argmin(axis=1)
    alike = away[np.arange(len(new)), nearest] < 0.5
    return float(np.median(new[alike, 2] - old[nearest[alike], 2]))
