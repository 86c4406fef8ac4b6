"""Scenes in which tie points are hard to find: water, clouds, equal roofs, other suns and seasons."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal
from scipy import ndimage

from benchmarks import hard_scenes
from benchmarks.pointing_case import Case, case_of, fitted, known_pointings, pointed, write_image
from benchmarks.runner import few
from benchmarks.scenes import CACHE, made_once, quick_size
from benchmarks.tables import table
from repm_qgis.contracts.errors import RepmError
from repm_qgis.simulation.scene import SceneSpec, make_views, surface_bounds
from repm_qgis.simulation.surface import SimulatedSurface, Sun

Made = Tuple[Case, List[str]]


def cloud_texture(shape: Tuple[int, ...], seed: int) -> np.ndarray:
    """Bright fractal texture, 0..1."""
    rng = np.random.default_rng(seed)
    total = np.zeros(shape)
    for octave in range(2, 8):
        nodes = 2**octave + 1
        rough = rng.normal(size=(nodes, nodes)) / 1.8**octave
        total += ndimage.zoom(rough, (shape[0] / nodes, shape[1] / nodes), order=1)[: shape[0], : shape[1]]
    return (total - total.min()) / np.ptp(total)


def changed(case: Case, name: str, change: Callable[[int, np.ndarray], np.ndarray]) -> Made:
    """The case's images with other pixels: ``change`` is given a view's number and its pixels."""
    folder = CACHE / f"{name}_{case.size}"
    folder.mkdir(parents=True, exist_ok=True)
    images = []
    for number, (view, path) in enumerate(zip(case.true, case.images)):
        source = gdal.Open(path)
        pixels = change(number, source.ReadAsArray())
        images.append(write_image(folder / f"{view.name}.tif", pixels, source.GetMetadata("RPC")))
    return case, images


def flooded(name: str, share: float) -> Made:
    """The town under water (one intensity, noise) but for a disc of land, a share of the area, on one place."""
    case = case_of("town")
    rng = np.random.default_rng(8)
    ground = case.ground(1, 12)
    radius = float(np.sqrt(share * case.size**2 / np.pi))

    def change(number: int, pixels: np.ndarray) -> np.ndarray:
        place = case.true[number].project(ground)[0]
        rows, cols = np.indices(pixels.shape)
        water = np.hypot(cols - place[0], rows - place[1]) > radius
        level = np.clip(np.rint(180 + rng.normal(0, 4, pixels.shape)), 1, 4095).astype(np.uint16)
        return np.where(water, level, pixels)

    return changed(case, name, change)


def clouded(name: str, halves: Sequence[Optional[str]]) -> Made:
    """The town's images with clouds of their own over one half each."""
    case = case_of("town")

    def change(number: int, pixels: np.ndarray) -> np.ndarray:
        top = float(np.percentile(pixels, 99.5))
        texture = cloud_texture(pixels.shape, 20 + number)
        cover = np.rint(top * (1.0 + 0.8 * texture)).clip(1, 4095).astype(np.uint16)
        rows, cols = np.indices(pixels.shape)
        none = np.zeros(pixels.shape, bool)
        under = {"left": cols < case.size / 2, "top": rows < case.size / 2, None: none}[halves[number]]
        return np.where(under, cover, pixels)

    return changed(case, name, change)


def rendered(name: str, surfaces: Callable[[SceneSpec], Sequence[SimulatedSurface]]) -> Made:
    """A scene of which each view may see another surface."""
    spec = SceneSpec.default("urban", quick_size(800), 5)
    folder = CACHE / f"{name}_{spec.size}"

    def make() -> None:
        hard_scenes.write_scene(folder, spec, surfaces(spec), lambda path, pixels: write_image(path, pixels, {}))

    pointings = known_pointings("shift", spec.size)
    case = Case((spec, made_once(folder, make)), pointings, CACHE / f"{folder.name}_shift")
    return case, case.images


def estates(garden: float, spec: SceneSpec) -> List[SimulatedSurface]:
    bounds = surface_bounds(spec, make_views(spec))
    return [hard_scenes.estate(bounds, spec, (18.0, 24.0), -11.0, 0.3, garden)] * 3


def days(suns: Sequence[Optional[Sun]], spec: SceneSpec) -> List[SimulatedSurface]:
    """The town under other suns; None is the usual one."""
    return [hard_scenes.town_under(spec, sun or spec.sun) for sun in suns]


def seasons(spec: SceneSpec) -> List[SimulatedSurface]:
    plain = hard_scenes.town_under(spec, spec.sun)
    return [plain, hard_scenes.another_season(plain, 1), hard_scenes.another_season(plain, 2)]


MORNING, AFTERNOON = hard_scenes.MORNING, hard_scenes.AFTERNOON
KINDS: Sequence[Tuple[str, Callable[[], Made]]] = (
    ("water but for 2 %", partial(flooded, "water_2", 0.02)),
    ("water but for 0.2 %", partial(flooded, "water_02", 0.002)),
    ("one image half under cloud", partial(clouded, "cloud_1", ("left", None, None))),
    ("every image half under its own clouds", partial(clouded, "cloud_3", ("left", "left", "left"))),
    ("clouds over different halves", partial(clouded, "cloud_2", ("left", "top", None))),
    ("equal roofs on a grid, gardens", partial(rendered, "estate_gardens", partial(estates, 0.016))),
    ("equal roofs on a grid, plain ground", partial(rendered, "estate_plain", partial(estates, 0.004))),
    ("one image in the morning", partial(rendered, "morning", partial(days, (None, MORNING, None)))),
    ("morning, noon, afternoon", partial(rendered, "day", partial(days, (MORNING, None, AFTERNOON)))),
    ("three seasons", partial(rendered, "seasons", seasons)),
)


def poor_scenes() -> List[str]:
    rows = []
    for label, make in few(KINDS):
        case, images = make()
        try:
            found = pointed(fitted(images, Path(images[0]).parent / "w"))
            left = case.observable_px(found.adjusted.pointing)
            cells = (found.figures.after_px, f"{np.median(left):.3f} / {left.max():.3f}", found.adjusted.reason)
            rows.append([label, len(found.tracks), *cells])
        except RepmError as error:
            rows.append([label, 0, "", "stopped", str(error)])
    return [
        "**4. Poor scenes**: the town of point 2 (shifts of up to 15 px), most of it hidden; an estate of equal "
        "houses every 18 x 24 m (36 x 48 px, within the search), on gardens of the town's texture or on nearly "
        "plain ground; the town with the sun at 105, 152 and 245 degrees of azimuth and 28, 48 and 32 degrees "
        "high, with the shadows that belong to it; the town with fields of 45 m of another intensity, half of "
        "them with inverted contrast, in the second and third image. What is left that could be observed, px "
        "(median / largest); or the sentence that it stops with.",
        table("scene | ties | median residual, px | left, px | why this model, or why it stopped", rows),
    ]
