"""Buildings (``repm:buildings``) against the lidar of a real town and a simulated town whose houses are known."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import ogr
from scipy import ndimage

from benchmarks.answers_dtm import _lidar, _on_truth, _town
from benchmarks.answers_solids import has_library, library
from benchmarks.runner import ROOT, few, is_quick, say
from benchmarks.scenes import SHARED, default
from benchmarks.tables import Section, table
from repm_qgis.contracts.stages import BUILDINGS
from repm_qgis.evaluation.coregistration import Alignment
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.imagery.cell_polygons import burned
from repm_qgis.imagery.raster import opened, read
from repm_qgis.numerics.robust import nmad
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.scene import make_views, surface_bounds
from repm_qgis.simulation.surface import Ground
from repm_qgis.simulation.town import Town
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE

_LEAST_M2 = 50.0  # of a building that is counted: smaller ones are sheds, and parts of roofs
_FOUND = 0.5  # of an object's area that the other side covers
_VIEWS = 6
_INNER_CELLS = 2  # of the truth's cells inside a roof, within which its height is compared
_KINDS = ("flat", "gable")
_CJVAL = ROOT / "dist" / "cityjson" / "tool" / "bin"


@dataclass(frozen=True)
class Case:
    """A DSM with its confidence, and on the cells of ``reference`` the true surface, the number of each building (0:
    none), and which cells are judged. ``kinds``: of the roof of each number, where it is known."""

    name: str
    dsm: str
    confidence: str
    reference: str
    surface: np.ndarray
    numbers: np.ndarray
    judged: np.ndarray
    kinds: Optional[Dict[int, str]] = None


class _Recorded(Town):
    """A town that remembers which nodes each house stands on, and its kind of roof."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.numbers = np.zeros(self._ground.height.shape, np.int32)
        self.kinds: Dict[int, str] = {}
        self._kind = ""

    def _flat(self, *given: Any, **named: Any) -> None:
        self._kind = "flat"
        super()._flat(*given, **named)

    def _gabled(self, *given: Any) -> None:
        self._kind = "gable"
        super()._gabled(*given)

    def _put(self, area: Any, inside: np.ndarray, height: Any, tone: Any) -> None:
        super()._put(area, inside, height, tone)
        part = self.numbers[area]
        if not (part[inside] > 0).all():  # a skylight stands on a roof that is there
            number = len(self.kinds) + 1
            self.kinds[number] = self._kind
            self.numbers[area] = np.where(inside, number, part)


def _simulated(size: int) -> Case:
    made, scene = _town(size), default("urban", size, 4)
    spec = scene.made
    nodes = Ground.empty(surface_bounds(spec, make_views(spec)), spec.cell_m / spec.surface_step)
    town = _Recorded(nodes, spec.base_m, spec.seed, Silent())
    town.build()
    with opened(scene.reference) as dataset:
        surface, (west, cell, _, north, _, _) = read(dataset), dataset.GetGeoTransform()
    col, row = (round(d / nodes.cell) for d in (west + cell / 2 - nodes.west, nodes.north - north + cell / 2))
    step = spec.surface_step
    rows, columns = surface.shape
    numbers = town.numbers[row : row + step * rows : step, col : col + step * columns : step]
    name = "town, 3 views of 0.5 m"
    return Case(name, made.dsm, made.confidence, made.reference, surface, numbers, np.isfinite(surface), town.kinds)


def _real(count: int) -> Case:
    made = _lidar(count)
    with opened(str(SHARED / "jax_068" / "classes_west.tif")) as dataset:
        kind = read(dataset)
    numbers, _ = ndimage.label(kind == 6)
    judged = np.isin(kind, (2, 5, 6, 9, 17)) & np.isfinite(made.ground)
    return Case(made.name, made.dsm, made.confidence, made.reference, made.ground, numbers, judged)


def _cases() -> List[Case]:
    found = [_simulated(400 if is_quick() else 1000)]
    return found + ([_real(_VIEWS)] if (SHARED / "jax_068").exists() and not is_quick() else [])


@dataclass(frozen=True)
class Made:
    """What the stage found, on the truth's cells: the number of each building, and the heights of its solids by LoD, m,
    in the truth's frame, and those of the DSM; the buildings' fields by their numbers."""

    numbers: np.ndarray
    blocks: np.ndarray
    roofs: np.ndarray
    surface: np.ndarray
    fields: Dict[int, Dict[str, Any]]
    seconds: float


def found_in(case: Case, folder: str, parameters: Any = ENGINE, **options: object) -> Made:
    """Run the stage on a case's DSM."""
    start = time.monotonic()
    named = {"output": f"{folder}/b.gpkg", "cityjson": f"{folder}/b.city.json"}
    run_stage(BUILDINGS, {"dsm": case.dsm, "confidence": case.confidence, **named, **options}, Silent(), parameters)
    spent = time.monotonic() - start
    move = score_files(case.dsm, case.reference, "3d").alignment
    with opened(case.reference) as dataset:
        x, dx, _, y, _, dy = dataset.GetGeoTransform()
    place = (x - move.dx, dx, 0.0, y - move.dy, 0.0, dy)
    fields, shapes = _layer(named["output"])
    shape = case.surface.shape
    numbers = np.nan_to_num(burned(shapes, [each["id"] for each in fields], shape, place)).astype(np.int64)
    city = json.loads(Path(named["cityjson"]).read_text(encoding="utf-8"))
    blocks, roofs = (_roof_heights(city, lods, shape, place, move) for lods in (("1.2",), ("2.2", "1.2")))
    surface = _on_truth(case.dsm, case, move)
    return Made(numbers, blocks, roofs, surface, {each["id"]: each for each in fields}, spent)


def _layer(path: str) -> Tuple[List[Dict[str, Any]], List[ogr.Geometry]]:
    source = ogr.Open(path)
    fields, shapes = [], []
    for feature in source.GetLayer(0):
        shape = feature.GetGeometryRef().Clone()
        corners = sum(shape.GetGeometryRef(number).GetPointCount() - 1 for number in range(shape.GetGeometryCount()))
        fields.append({**feature.items(), "corners": corners})
        shapes.append(shape)
    return fields, shapes


def _roof_heights(
    city: Dict[str, Any], lods: Sequence[str], shape: Tuple[int, ...], place: Sequence[float], move: Alignment
) -> np.ndarray:
    """The heights of the roofs as the CityJSON file has them, m, on cells: read from its faces alone."""
    scale, start = (np.array(city["transform"][name]) for name in ("scale", "translate"))
    corners = np.array(city["vertices"]) * scale + start
    heights = np.full(shape, np.nan)
    for each in city["CityObjects"].values():
        by_lod = {solid["lod"]: solid for solid in each["geometry"]}
        solid = next(by_lod[lod] for lod in lods if lod in by_lod)
        kinds = [surface["type"] for surface in solid["semantics"]["surfaces"]]
        for face, kind in zip(solid["boundaries"][0], solid["semantics"]["values"][0]):
            if kinds[kind] != "RoofSurface":
                continue
            ring = corners[face[0]]
            centre = ring.mean(axis=0)
            east, north = np.linalg.lstsq(ring[:, :2] - centre[:2], ring[:, 2] - centre[2], rcond=1e-9)[0]
            cut, near, x, y = _around(ring, shape, place)
            here = np.isfinite(burned([_polygon([corners[part] for part in face])], [1.0], x.shape, near))
            level = centre[2] + east * (x - centre[0]) + north * (y - centre[1]) + move.dz
            heights[cut] = np.where(here, level, heights[cut])
    return heights


def _around(
    ring: np.ndarray, shape: Tuple[int, ...], place: Sequence[float]
) -> Tuple[Tuple[slice, slice], Tuple[float, ...], np.ndarray, np.ndarray]:
    """The cells around a ring: their slices, geotransform, and x and y."""
    ends = [np.sort((ring[:, axis] - place[3 * axis]) / place[5 * axis or 1])[[0, -1]] for axis in (0, 1)]
    (left, right), (top, bottom) = (
        (min(max(int(low) - 1, 0), size - 1), min(max(int(high) + 2, 1), size))
        for (low, high), size in zip(ends, shape[::-1])
    )
    near = (place[0] + left * place[1], place[1], 0.0, place[3] + top * place[5], 0.0, place[5])
    rows, columns = np.indices((max(bottom - top, 1), max(right - left, 1)))
    x, y = near[0] + (columns + 0.5) * near[1], near[3] + (rows + 0.5) * near[5]
    return (slice(top, top + len(rows)), slice(left, left + columns.shape[1])), near, x, y


def _polygon(rings: Sequence[np.ndarray]) -> ogr.Geometry:
    made = ogr.Geometry(ogr.wkbPolygon)
    for ring in rings:
        line = ogr.Geometry(ogr.wkbLinearRing)
        for x, y, _ in [*ring, ring[0]]:
            line.AddPoint_2D(float(x), float(y))
        made.AddGeometry(line)
    return made


def _quality(complete: float, correct: float) -> float:
    """Rutzinger et al. 2009: true positives over all that either side has."""
    return complete * correct / (complete + correct - complete * correct) if complete + correct else 0.0


def areas(case: Case, made: Made) -> List[object]:
    """Completeness, correctness and quality of areas, then of objects of at least 50 m2, %."""
    true, found = (case.numbers > 0) & case.judged, (made.numbers > 0) & case.judged
    complete, correct = (true & found).sum() / max(true.sum(), 1), (true & found).sum() / max(found.sum(), 1)
    cell = _cell_m2(case)
    objects = [
        _share(case.numbers * case.judged, found, cell),
        _share(made.numbers * case.judged, true, cell),
    ]
    shares = [complete, correct, _quality(complete, correct), *objects, _quality(*objects)]
    return [f"{100 * share:.1f}" for share in shares]


def _cell_m2(case: Case) -> float:
    with opened(case.reference) as dataset:
        place = dataset.GetGeoTransform()
    return abs(place[1] * place[5])


def _share(numbers: np.ndarray, covered: np.ndarray, cell_m2: float) -> float:
    """How many objects of at least 50 m2 are covered by half or more."""
    sizes = np.bincount(numbers.ravel())
    common = np.bincount(numbers[covered], minlength=len(sizes))
    large = np.flatnonzero(sizes * cell_m2 >= _LEAST_M2)
    large = large[large > 0]
    return float((common[large] >= _FOUND * sizes[large]).mean()) if large.size else 0.0


def roofs(case: Case, made: Made) -> Tuple[np.ndarray, np.ndarray]:
    """For each building of at least 50 m2 of which half is true: its median's error, m, and that error over the stated
    one."""
    inner = ndimage.binary_erosion(case.numbers > 0, iterations=_INNER_CELLS) & case.judged
    cell, errors, shares = _cell_m2(case), [], []
    for number, fields in made.fields.items():
        here = made.numbers == number
        judged = here & case.judged
        if judged.sum() * cell < _LEAST_M2 or (case.numbers[judged] > 0).mean() < _FOUND:
            continue
        roof = ndimage.binary_erosion(here, iterations=_INNER_CELLS) & inner
        if roof.sum() < 20:
            continue
        errors.append(float(np.median(made.blocks[roof]) - np.median(case.surface[roof])))
        shares.append(abs(errors[-1]) / fields["error_m"])
    return np.array(errors), np.array(shares)


def _spread(errors: np.ndarray) -> List[object]:
    size = np.abs(errors)
    return [float(np.median(errors)), nmad(errors), *(float(np.percentile(size, share)) for share in (68, 90))]


def _validity(name: str, path: str) -> List[object]:
    """What programs of others find in a CityJSON file: the validator of its schemas, and open3d in its solids."""
    program = shutil.which("cjval") or shutil.which("cjval", path=str(_CJVAL))
    said = "not tried: run 'make cityjson-tools'"
    if program:
        done = subprocess.run([program, path, "--report"], capture_output=True, encoding="utf-8", check=True)
        report = json.loads(done.stdout)
        warned = ", with warnings" if report["has_warnings"] else ", no warnings"
        said = ("valid" if report["valid"] else "not valid") + warned
    if not has_library():
        return [name, said, "not tried: REPM_SOLIDS_PYTHON names no Python", "", "", ""]
    found = library("shells", path)
    counts = [found[part] for part in ("solids", "closed", "oriented", "apart")]
    return [name, said, *counts]


def measured() -> List[str]:
    area_rows, roof_rows, cell_rows, kind_rows, valid_rows = [], [], [], [], []
    for case in few(_cases()):
        with tempfile.TemporaryDirectory() as folder:
            made = found_in(case, folder)
            valid_rows.append(_validity(case.name, f"{folder}/b.city.json"))
        area_rows.append([case.name, len(made.fields), *areas(case, made), f"{made.seconds:.0f}"])
        errors, shares = roofs(case, made)
        within = [f"{100 * float((shares < limit).mean()):.0f}" for limit in (1.0, 1.645)]
        roof_rows.append([case.name, len(errors), *_spread(errors), *within])
        inner = ndimage.binary_erosion((case.numbers > 0) & (made.numbers > 0), iterations=_INNER_CELLS) & case.judged
        roofed = np.isin(made.numbers, [number for number, fields in made.fields.items() if fields["lod"] == 2])
        for name, cells in (("all", inner), ("those with LoD 2", inner & roofed)):
            given = ("the DSM's own cells", made.surface)
            for lod, heights in (given, ("1", made.blocks), ("2 where there is one", made.roofs)):
                away = (heights - case.surface)[cells]
                cell_rows.append([case.name, name, lod, *_spread(away[np.isfinite(away)])])
        kind_rows += _kinds(case, made)
        say(area_rows[-1])
        say(roof_rows[-1])
    return [
        "**Buildings** by default settings, from DSMs with cells of 0.5 m of the default pipeline; the truth is the "
        "simulated town's own houses, and the class 6 of the lidar of `jax_068`, unclassified cells left out. Outlines "
        "and heights are moved by the shift in 3-D that lays the DSM onto the truth. An object of at least "
        f"{_LEAST_M2:g} m2 counts as found where the other side covers {100 * _FOUND:g} % of it; completeness, "
        "correctness and quality as Rutzinger et al. (2009) define them.",
        table(
            "DSM | buildings | area: complete % | correct % | quality % | objects: complete % | correct % | quality % "
            "| s",
            area_rows,
        ),
        "**Height of each roof**: the median of the roof minus the truth's, of buildings of at least "
        f"{_LEAST_M2:g} m2; *within* are shares of roofs whose error is within the stated one, or 1.645 times that: 68 "
        "and 90 % are right.",
        table(
            "DSM | roofs | median m | NMAD m | 68 % m | 90 % m | within the error % | within 1.645 errors %", roof_rows
        ),
        "**Heights of roofs cell by cell**, as the faces in the CityJSON file have them, a metre and more inside.",
        table("DSM | buildings | LoD | median m | NMAD m | 68 % m | 90 % m", cell_rows),
        "**Kinds of roofs** of the simulated town, by the houses that the most of each building stands on.",
        table("true roof | buildings | flat | gable | other kinds | with LoD 2", kind_rows),
        "**The CityJSON files** in programs of others: CityJSON's validator of schemas (cjval), and of the solids, "
        "divided into triangles, how many open3d finds closed, turned one way all over, and not cutting themselves.",
        table("DSM | cjval | solids | closed | oriented | do not cut themselves", valid_rows),
    ]


def _kinds(case: Case, made: Made) -> List[List[object]]:
    if case.kinds is None:
        return []
    counts = {kind: [0, 0, 0, 0, 0] for kind in _KINDS}
    cell = _cell_m2(case)
    for number, fields in made.fields.items():
        here = made.numbers == number
        below = np.bincount(case.numbers[here]) if here.any() else np.zeros(1)
        if here.sum() * cell < _LEAST_M2 or below.argmax() == 0:
            continue
        row = counts[case.kinds[int(below.argmax())]]
        row[0] += 1
        row[1 + (_KINDS.index(fields["roof"]) if fields["roof"] in _KINDS else 2)] += 1
        row[4] += fields["lod"] == 2
    return [[kind, *row] for kind, row in counts.items()]


SECTIONS = [Section("buildings", "Buildings", "make bench-buildings", {"measured": measured})]
