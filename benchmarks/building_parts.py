"""What each part of the search for buildings gives: the search without it, on a simulated town and a real one.

A difference is beyond chance where it is more than twice its standard error, by a jackknife over parts of the scene
(Efron 1982): neighbouring cells share their errors.
"""

from __future__ import annotations

import math
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any, Callable, List, Mapping, Optional, Sequence, Tuple
from unittest import mock

import numpy as np
from osgeo import gdal
from scipy import ndimage

from benchmarks import buildings
from benchmarks.answers_dtm import _ours
from benchmarks.buildings import Case, Made, areas, found_in, roofs
from benchmarks.runner import few, is_quick, say
from benchmarks.scenes import SHARED
from benchmarks.tables import Section, table
from repm_qgis.buildings import building, footprints, partition, regularisation, solids
from repm_qgis.buildings import roofs as planes
from repm_qgis.buildings.parameters import BuildingParameters
from repm_qgis.imagery.raster import opened
from repm_qgis.stages.parameters import ENGINE

_PARTS = 6  # of a scene, down and across
_MARGIN_M = 10.0  # of a half of a scene, beside which the other half's buildings stand
_MOST_M = 3.0  # of a height's error: what is farther off stands on something else
_PLAIN = ENGINE.buildings


@dataclass(frozen=True)
class Way:
    """The search with other numbers, or with other functions in the place of some: (module, name) and what is there."""

    name: str
    numbers: BuildingParameters = _PLAIN
    functions: Mapping[Tuple[Any, str], Callable[..., Any]] = field(default_factory=dict)


def _with(group: str, **numbers: float) -> BuildingParameters:
    return replace(_PLAIN, **{group: replace(getattr(_PLAIN, group), **numbers)})


def _inner_heights(patch: Any, _: Any, known: np.ndarray) -> np.ndarray:
    return np.asarray(patch.roof.height[known].astype(np.float64))


def _high(above: np.ndarray, least_m: float, _: int) -> np.ndarray:
    return np.where(np.isfinite(above), above, -np.inf) > least_m


WAYS = (
    Way("as it is"),
    Way("planes within the expected error are kept", functions={(building, "_expected"): lambda *_: math.nan}),
    Way("feet of walls are not taken off", functions={(footprints, "_above_half"): _high}),
    Way("no test for planes", _with("footprints", planar_m=1e3)),
    Way("grown back by one cell, not five", _with("footprints", rim_m=0.1)),
    Way("tails stay", functions={(footprints, "without_tails"): lambda cells, _: cells}),
    Way("not divided by walls", _with("segments", least_m2=math.inf)),
    Way("lower parts do not reach below higher ones", _with("segments", below_m=0.1)),
    Way("outlines are simplified borders", functions={(regularisation, "_walls"): lambda *_: None}),
    Way("walls not turned to the main direction", _with("outlines", turned_deg=0.0)),
    Way("near parallel walls stay two", _with("outlines", offset_m=0.01, offset_cells=0.01)),
    Way("walls count as roof", _with("heights", inner_m=0.0)),
    Way("lower ends of slopes are not added", functions={(building, "_roof_heights"): _inner_heights}),
    Way("cells' own slopes are not asked", _with("roofs", turned_deg=89.0)),
    Way("planes of one surface are not joined", functions={(planes, "_joined"): lambda c, p, n, t: (p, n)}),
    Way("no walls between planes", _with("roofs", step_m=math.inf)),
    Way("no lines where planes cross", functions={(partition, "_crossing"): lambda *_: None}),
    Way("borders where planes cross are not divided", functions={(solids, "_without_crossings"): lambda p, *_: p}),
    Way("planes that explain a little are kept", _with("roofs", better=1e9, better_m=-1e9)),
    Way("LoD 1 alone", _with("roofs", better=0.0)),
)


@dataclass(frozen=True)
class _Cells:
    """(rows, columns): which cells are buildings in truth and found, and the errors of the heights found there, m."""

    true: np.ndarray
    found: np.ndarray
    errors: np.ndarray


def _cells(case: Case, made: Made) -> _Cells:
    true, found = (case.numbers > 0) & case.judged, (made.numbers > 0) & case.judged
    inner = ndimage.binary_erosion((case.numbers > 0) & (made.numbers > 0), iterations=buildings._INNER_CELLS)
    return _Cells(true, found, np.where(inner & case.judged, made.roofs - case.surface, np.nan))


def _sums(cells: _Cells, common: np.ndarray) -> np.ndarray:
    """(parts, 5) of each part of a scene: cells of either, of both, errors up to a limit, and how many these are."""
    size = np.minimum(np.abs(cells.errors), _MOST_M)
    each = [cells.true | cells.found, cells.true & cells.found, np.where(common, size, 0.0), common]
    parts = [
        [part for rows in np.array_split(one, _PARTS) for part in np.array_split(rows, _PARTS, axis=1)] for one in each
    ]
    return np.array([[float(part.sum()) for part in one] for one in parts]).T


def _figures(sums: np.ndarray) -> np.ndarray:
    """Quality of the areas, %, and the mean error of the heights, m."""
    either, both, error, count = sums.sum(axis=0)
    return np.array([100 * both / max(either, 1), error / max(count, 1)])


def differences(plain: _Cells, other: _Cells) -> List[Tuple[float, float]]:
    """What the other way changes in both figures, and the standard errors of that."""
    common = np.isfinite(plain.errors) & np.isfinite(other.errors)
    sums = [_sums(each, common) for each in (plain, other)]
    changed = _figures(sums[1]) - _figures(sums[0])
    used = np.flatnonzero(sums[0][:, 0] + sums[1][:, 0] > 0)
    less = [_figures(np.delete(sums[1], k, axis=0)) - _figures(np.delete(sums[0], k, axis=0)) for k in used]
    errors = np.sqrt((len(used) - 1) / len(used) * ((less - np.mean(less, axis=0)) ** 2).sum(axis=0))
    return list(zip(changed, errors))


def _shown(change: float, error: float, decimals: int) -> str:
    text = f"{change:+.{decimals}f} ± {error:.{decimals}f}"
    return f"**{text}**" if abs(change) > 2 * error else text


def _corners(made: Made) -> float:
    return float(np.mean([each["corners"] for each in made.fields.values()])) if made.fields else math.nan


def _north(case: Case, folder: str) -> Case:
    """The northern half of a case's DSM, and what of the truth lies in it."""
    files = []
    for name, path in (("dsm", case.dsm), ("confidence", case.confidence)):
        with opened(path) as dataset:
            columns, rows = dataset.RasterXSize, dataset.RasterYSize // 2
            gdal.Translate(f"{folder}/{name}.tif", dataset, srcWin=[0, 0, columns, rows])
            south = dataset.GetGeoTransform()[3] + rows * dataset.GetGeoTransform()[5]
        files.append(f"{folder}/{name}.tif")
    with opened(case.reference) as dataset:
        place = dataset.GetGeoTransform()
    y = place[3] + (np.arange(len(case.judged)) + 0.5) * place[5]
    inside = case.judged & (y > south + _MARGIN_M)[:, None]
    return replace(case, name=f"{case.name}, northern half", dsm=files[0], confidence=files[1], judged=inside)


def _run(case: Case, way: Way, dtm: str) -> Made:
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        for (module, name), function in way.functions.items():
            stack.enter_context(mock.patch.object(module, name, function))
        return found_in(case, folder, replace(ENGINE, buildings=way.numbers), dtm=dtm)


def _rows(case: Case) -> List[List[object]]:
    """The rows of a town: the figures as it is, and then what changes."""
    rows: List[List[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        dtm, _ = _ours(case, folder)
        plain: Optional[_Cells] = None
        for way in few(WAYS):
            made = _run(case, way, dtm)
            cells = _cells(case, made)
            if plain is None:
                plain = cells
                quality, error = _figures(_sums(cells, np.isfinite(cells.errors)))
                first = [f"{quality:.2f}", f"{error:.3f}"]
            else:
                first = [_shown(*each, decimals) for each, decimals in zip(differences(plain, cells), (2, 3))]
            errors, _ = roofs(case, made)
            spread = [float(np.percentile(np.abs(errors), share)) for share in (68, 90)]
            lod2 = sum(fields["lod"] == 2 for fields in made.fields.values())
            counts = [len(made.fields), lod2, f"{_corners(made):.1f}"]
            rows.append([case.name, way.name, *first, areas(case, made)[5], *spread, *counts])
            say(rows[-1])
    return rows


def _table(rows: Sequence[Sequence[object]]) -> List[str]:
    return [
        "**Without each part** of the search, with the terrain given. The first row has the quality of the areas, %, "
        "and the mean error of the heights of roofs (LoD 2 where there is one; what is off by more than "
        f"{_MOST_M:g} m counts as {_MOST_M:g} m), the others what changes and its standard error; bold: more than two "
        "of these.",
        table(
            "DSM | way | area: quality % | heights: mean error m | objects: quality % | roofs: 68 % m | 90 % m | "
            "buildings | with LoD 2 | corners of an outline",
            rows,
        ),
    ]


def real() -> List[str]:
    """All ways on the real town, where it is."""
    if not (SHARED / "jax_068").exists():
        return [f"Not measured, absent from '{SHARED}': jax_068."]
    return _table(_rows(buildings._real(buildings._VIEWS)))


def simulated() -> List[str]:
    """All ways on half of the simulated town, which takes as long as the whole real one."""
    with tempfile.TemporaryDirectory() as folder:
        return _table(_rows(_north(buildings._simulated(400 if is_quick() else 1000), folder)))


_COMMAND = "make bench-building_parts"
SECTIONS = [
    Section("building_parts", "Parts of the search for buildings: a real town", _COMMAND, {"real": real}),
    Section("building_parts_simulated", "The same on a simulated town", _COMMAND, {"simulated": simulated}),
]
