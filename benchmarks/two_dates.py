"""A simulated town at two dates: 20 of its buildings are added, removed or raised by 3 m between them.

The images of each date are simulated with their own sun, directions of view, noise and pointing errors, and all DSMs
are made of images by the whole pipeline.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Sequence, Tuple

import numpy as np
from numpy.typing import ArrayLike
from osgeo import ogr

from benchmarks.runner import is_quick, pipeline
from benchmarks.scenes import CACHE, made_once, simulation
from repm_qgis.contracts.arrays import FloatImage, IntArray, Mask
from repm_qgis.files.vector import write_layer
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.gcps import common_square
from repm_qgis.simulation.parameters import SIMULATION
from repm_qgis.simulation.scene import (
    SceneSpec,
    fit_view_rpcs,
    make_views,
    pointing_errors,
    surface_bounds,
    write_image,
    write_truth,
)
from repm_qgis.simulation.sensor import PLEIADES, Look
from repm_qgis.simulation.surface import Area, Ground, Sun
from repm_qgis.simulation.town import Town

KINDS = ("added",) * 7 + ("removed",) * 7 + ("raised",) * 6
RAISED_M = 3.0
_AREA_M2 = (60.0, 600.0)  # of buildings that change
_APART_M = 8.0  # from one to the next
_BARE_M = 1.0  # of what a building may stand on
_EDGE = 0.18  # of the ground's side that changes stay away from: all views of both dates see the rest
_BEFORE = (Look(12.0, 0.5, 1.0), Look(-4.0, 0.5, 2.0), Look(-13.0, 0.5, -1.0), Look(5.0, 0.5, -2.0))
_AFTER = (Look(11.0, 0.5, -4.0), Look(1.0, 0.5, -3.0), Look(-12.0, 0.5, -5.0))
_SUNS = (Sun(152.0, 48.0), Sun(165.0, 33.0))
DSMS: Dict[str, Tuple[int, Tuple[int, ...]]] = {
    "before": (0, (1, 2, 3)),
    "after": (1, (1, 2, 3)),
    "same_1": (0, (1, 2)),
    "same_2": (0, (3, 4)),
}
"""Each DSM: of which date, and of which of its images."""
_QUICK = {"before": (0, (1, 3)), "after": (1, (1, 3))}


@dataclass(frozen=True)
class Built:
    """A building: where its nodes lie in the ground's grid, and whether it stands on the ground, not on a roof."""

    area: Area
    inside: Mask
    grounded: bool


class RecordedTown(Town):
    """A town that remembers its buildings."""

    def __init__(self, ground: Ground, base: float, seed: int) -> None:
        self.built: List[Built] = []
        self.owner: IntArray = np.full(ground.height.shape, -1, np.int64)
        super().__init__(ground, base, seed, Silent())

    def _put(self, area: Area, inside: Mask, height: ArrayLike, tone: ArrayLike) -> None:
        below = (self._ground.height[area] - self._terrain[area])[inside]
        grounded = bool(np.quantile(below, 0.9) < _BARE_M)
        super()._put(area, inside, height, tone)
        self.owner[area][inside] = len(self.built)
        self.built.append(Built(area, inside, grounded))

    def chosen(self, seed: int) -> List[Built]:
        """Buildings that stand alone enough, in a random order that the seed gives, one for each of ``KINDS``."""
        cell, shape = self._ground.cell, self.owner.shape
        margin = [int(_EDGE * n) for n in shape]
        found: List[Built] = []
        taken = np.zeros(shape, bool)
        reach = int(_APART_M / cell)
        for index in np.random.default_rng([seed, 9]).permutation(len(self.built)):
            each = self.built[index]
            rows, columns = each.area
            whole = (self.owner[each.area] == index)[each.inside].mean() > 0.98  # nothing else was put upon it
            m2 = each.inside.sum() * cell**2
            far = rows.start > margin[0] and columns.start > margin[1]
            far &= rows.stop < shape[0] - margin[0] and columns.stop < shape[1] - margin[1]
            around = slice(rows.start - reach, rows.stop + reach), slice(columns.start - reach, columns.stop + reach)
            if each.grounded and whole and far and _AREA_M2[0] <= m2 <= _AREA_M2[1] and not taken[around].any():
                taken[each.area] |= each.inside
                found.append(each)
            if len(found) == len(KINDS):
                return found
        return found

    def without(self, buildings: Sequence[Built]) -> None:
        """Clear these lots: a yard is there instead."""
        ground = self._ground
        yard = 0.105 + 0.02 * self._broad + 0.016 * self._fine
        for each in buildings:
            for layer, values in ((ground.height, self._terrain), (ground.albedo, yard)):
                layer[each.area] = np.where(each.inside, values[each.area], layer[each.area])


@dataclass(frozen=True)
class Change:
    """A building that changed: what became of it, its outline as WKT, its area (m2) and volume (m3)."""

    kind: str
    outline: str
    area: float
    volume: float


@dataclass(frozen=True)
class Dates:
    """Paths of what was made: DSMs and confidences by the names of ``DSMS``, true surfaces, and the true changes."""

    folder: Path

    def dsm(self, name: str) -> str:
        return str(self.folder / name / "dsm.tif")

    def confidence(self, name: str) -> str:
        return str(self.folder / name / "confidence.tif")

    def truth(self, date: int) -> str:
        return str(self.folder / f"truth_{date}.tif")

    @property
    def changes(self) -> List[Change]:
        return [Change(**each) for each in json.loads((self.folder / "changes.json").read_text(encoding="utf-8"))]


def spec_of(size: int, seed: int, date: int) -> SceneSpec:
    sensor = replace(PLEIADES, looks=(_BEFORE, _AFTER)[date])
    heading = (191.0, 187.0)[date]
    return replace(SceneSpec.default("urban", size, seed), sensor=sensor, sun=_SUNS[date], heading_deg=heading)


def dates(size: int, seed: int) -> Dates:
    """The town with its DSMs, in the cache under its seed and size."""
    folder = images = images_of(size, seed)
    for name, (date, numbers) in (_QUICK if is_quick() else DSMS).items():
        made_once(folder / name, lambda: _reconstruct(images, folder / name, date, numbers))  # noqa: B023 - runs now
    return Dates(folder)


def images_of(size: int, seed: int) -> Path:
    """The folder of the town's images, in the cache."""
    size = 400 if is_quick() else size
    folder = CACHE / f"dates_{seed}_{size}"
    return made_once(folder, lambda: _simulate(folder, size, seed))


def _reconstruct(images: Path, folder: Path, date: int, numbers: Sequence[int]) -> None:
    names = [str(images / f"date_{date}_{number}.tif") for number in numbers]
    pipeline(names, folder, confidence=f"{folder}/confidence.tif", resolution=0.5, ortho=f"{folder}/ortho.tif")


def _simulate(folder: Path, size: int, seed: int) -> None:
    views = [make_views(spec_of(size, seed, date)) for date in (0, 1)]
    bounds = [surface_bounds(spec_of(size, seed, date), views[date]) for date in (0, 1)]
    both = type(bounds[0])(
        *(min(a, b) for a, b in zip(*(each[:2] for each in bounds))),
        *(max(a, b) for a, b in zip(*(each[2:] for each in bounds))),
    )
    spec = spec_of(size, seed, 0)
    heights: List[FloatImage] = []
    for date in (0, 1):
        ground = Ground.empty(both, spec.cell_m / spec.surface_step)
        town = RecordedTown(ground, spec.base_m, seed)
        town.build()
        chosen = town.chosen(seed)
        gone, raised = ("added", "removed")[date], date == 1
        town.without([each for each, kind in zip(chosen, KINDS) if kind == gone])
        for each, kind in zip(chosen, KINDS):
            if raised and kind == "raised":
                ground.height[each.area] += np.where(each.inside, np.float32(RAISED_M), np.float32(0))
        heights.append(ground.height.copy())
        surface = ground.finish(spec.crs, _SUNS[date], SIMULATION.town.wall_m)
        fits = fit_view_rpcs(views[date], surface.height_range())
        biases = pointing_errors(len(fits), seed + 50 * date)
        for number, (view, fit, bias) in enumerate(zip(views[date], fits, biases), start=1):
            path = str(folder / f"date_{date}_{number}.tif")
            if is_quick() and number not in (1, 3):
                continue
            write_image(
                path,
                view,
                fit.rpc.shifted(-bias[0], -bias[1]),
                surface,
                seed + 31 * date + number,
                Silent(),
                simulation(),
            )
        square = common_square(surface, views[date], spec.surface_step, SIMULATION.control)
        write_truth(str(folder / f"truth_{date}.tif"), surface, square, spec.surface_step)
    _write_changes(folder, spec.crs, ground, chosen, heights)


def _write_changes(
    folder: Path, crs: str, ground: Ground, chosen: Sequence[Built], heights: Sequence[FloatImage]
) -> None:
    found = []
    for each, kind in zip(chosen, KINDS):
        difference = np.where(each.inside, (heights[1] - heights[0])[each.area], 0.0)
        outline = _outline(each, ground)
        m2 = float(each.inside.sum() * ground.cell**2)
        volume = float(difference.sum(dtype=float) * ground.cell**2)
        found.append(Change(kind, outline, m2, volume))
    (folder / "changes.json").write_text(json.dumps([vars(each) for each in found]), encoding="utf-8")
    fields = {"kind": str, "area": float, "volume": float}
    features = [(ogr.CreateGeometryFromWkt(each.outline), [each.kind, each.area, each.volume]) for each in found]
    write_layer(str(folder / "changes.gpkg"), crs, ogr.wkbPolygon, fields, features)


def _outline(each: Built, ground: Ground) -> str:
    """The convex outline of a building's nodes as WKT: they are turned rectangles."""
    rows, columns = np.nonzero(each.inside)
    x = ground.west + (columns + each.area[1].start) * ground.cell
    y = ground.north - (rows + each.area[0].start) * ground.cell
    points = ogr.Geometry(ogr.wkbMultiPoint)
    for place in zip(x, y):
        point = ogr.Geometry(ogr.wkbPoint)
        point.AddPoint_2D(*map(float, place))
        points.AddGeometry(point)
    return str(points.ConvexHull().ExportToWkt())
