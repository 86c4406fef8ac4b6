"""The cloud's points against a known surface with its walls: simulated towns, seen steeply and from the sides."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Dict, List, Tuple

import laspy
import numpy as np
from scipy.spatial import cKDTree

from benchmarks import answers_dtm
from benchmarks.runner import few, is_quick, say, stage, there
from benchmarks.scenes import Scene, simulated
from benchmarks.tables import table
from repm_qgis.contracts.stages import DSMFUSE
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.imagery.raster import opened
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.parameters import SIMULATION
from repm_qgis.simulation.scene import SceneSpec, make_views, surface_bounds
from repm_qgis.simulation.sensor import PLEIADES, Look
from repm_qgis.simulation.surface import Ground, interpolate
from repm_qgis.simulation.town import Town
from repm_qgis.stages.parameters import ENGINE, EngineParameters

_STEP_M = 0.125  # between samples of walls, up and along
_TALL_M, _END_M = 3.0, 1.0  # walls that count, and what is left out at their ends, where roof and ground are as near
_FAR_M = 6.0  # beyond which no wall is looked for
_SIDES = (Look(27.0, 0.5, 8.0), Look(17.0, 0.5, 8.0), Look(-14.0, 0.5, -16.0), Look(-24.0, 0.5, -16.0))
_WALL_M = SIMULATION.town.wall_m


def half_m() -> float:
    """Half the side of the square in the middle of a scene in which points are compared."""
    return 40.0 if is_quick() else 150.0


class _Truth:
    """The true surface about a place: its nodes, and points on the walls between them, with each wall's two ends."""

    def __init__(self, spec: SceneSpec, middle: Tuple[float, float]) -> None:
        self._nodes = nodes = Ground.empty(surface_bounds(spec, make_views(spec)), spec.cell_m / spec.surface_step)
        Town(nodes, spec.base_m, spec.seed, Silent(), SIMULATION.town).build()
        self._middle = middle
        reach = half_m() + 2 * _FAR_M
        col, row = (int((middle[0] - nodes.west) / nodes.cell), int((nodes.north - middle[1]) / nodes.cell))
        half = int(reach / nodes.cell)
        first = np.array([row - half, col - half])
        height = nodes.height[first[0] : row + half, first[1] : col + half].astype(np.float64)
        self.walls = np.concatenate([self._sampled(height, first, axis) for axis in (0, 1)])
        self._tree = cKDTree(self.walls[:, :3])

    def _sampled(self, height: np.ndarray, first: np.ndarray, axis: int) -> np.ndarray:
        """(N, 5) x, y, height, lower and upper end of the walls between nodes that are neighbours along an axis."""
        nodes = self._nodes
        a, b = (height[:-1], height[1:]) if axis == 0 else (height[:, :-1], height[:, 1:])
        places = np.argwhere(np.abs(a - b) > _WALL_M)
        low, high = (f(a, b)[tuple(places.T)] for f in (np.minimum, np.maximum))
        count = np.ceil((high - low) / _STEP_M).astype(int) + 1
        each = np.repeat(np.arange(len(count)), count)
        share = (np.arange(len(each)) - np.repeat(np.cumsum(count) - count, count)) / (count - 1)[each]
        z = low[each] + (high - low)[each] * share
        parts = []
        for along in (-0.25, 0.25):
            shift = (0.5, along) if axis == 0 else (along, 0.5)
            row, column = ((places[:, k] + first[k])[each] + shift[k] for k in (0, 1))
            x, y = nodes.west + column * nodes.cell, nodes.north - row * nodes.cell
            parts.append(np.column_stack([x, y, z, low[each], high[each]]))
        return np.concatenate(parts)

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Which points are compared."""
        return np.all(np.abs(points[:, :2] - self._middle) < half_m(), axis=1)

    def samples(self, half_m: float, count: int) -> Dict[str, np.ndarray]:
        """So many places (N, 3) on tall walls, and on the surface between them, in a square about the middle."""
        numbers, nodes = np.random.default_rng(0), self._nodes
        tall = (np.abs(self.walls[:, :2] - self._middle) < half_m).all(axis=1)
        tall &= self.walls[:, 4] - self.walls[:, 3] > _TALL_M
        x, y = (numbers.uniform(-half_m, half_m, (count, 2)) + self._middle).T
        z = interpolate(nodes.height, (x - nodes.west) / nodes.cell, (nodes.north - y) / nodes.cell, _WALL_M)
        return {"walls": numbers.choice(self.walls[tall, :3], count), "tops": np.column_stack([x, y, z])}

    def score(self, points: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N,) distance from the surface over or below each point, from the nearest wall, and whether it is a
        facade's: nearer to a tall wall than to the surface, and not at the wall's ends."""
        nodes, (x, y, z) = self._nodes, points[:, :3].T
        column, row = (x - nodes.west) / nodes.cell, (nodes.north - y) / nodes.cell
        up = np.abs(z - interpolate(nodes.height, column, row, _WALL_M))
        away, which = self._tree.query(points[:, :3], distance_upper_bound=_FAR_M)
        low, high = self.walls[np.minimum(which, len(self.walls) - 1), 3:].T
        facade = (away < up) & (z > low + _END_M) & (z < high - _END_M) & (high - low > _TALL_M)
        return up, away, facade


@dataclass(frozen=True)
class Town3d:
    """A simulated town's reconstruction, what is to be added to its points to lie on the truth, and the truth."""

    name: str
    scene: str
    shift: np.ndarray
    truth: _Truth


def _made(name: str, scene: Scene) -> Town3d:
    folder = answers_dtm._dsm(scene.name, scene.images, 0.5)
    found = score_files(str(folder / "dsm.tif"), scene.reference, "3d").alignment
    with opened(scene.reference) as dataset:
        west, cell, _, north, _, _ = dataset.GetGeoTransform()
        middle = west + cell * dataset.RasterXSize / 2, north - cell * dataset.RasterYSize / 2
    shift = np.array([found.dx, found.dy, found.dz])
    return Town3d(name, str(folder / "w" / "reconstructed.json"), shift, _Truth(scene.made, middle))


def towns() -> List[Callable[[], Town3d]]:
    """The towns, which are made when they are called for; a quick run has that of other parts alone."""
    steep = SceneSpec.default("urban", 1600, 4)
    sides = replace(steep, size=1000, sensor=replace(PLEIADES, looks=_SIDES))
    names = "town, 4 views of 16 to 29 degrees, two from each side", "town, 3 views of 0 and 12 degrees"
    made = [
        lambda: _made(names[0], simulated("urban_sides_4", sides)),
        lambda: _made(names[1], simulated("urban_4", steep)),
    ]
    return made[1:] if is_quick() else made


def fused(town: Town3d, folder: str, parameters: EngineParameters = ENGINE, **more: object) -> Tuple[str, str]:
    """The DSM and the cloud of a town's scene, with ``more`` options."""
    made = {"output": f"{folder}/dsm.tif", "cloud": f"{folder}/cloud.laz", **more}
    result = stage(DSMFUSE, Silent(), parameters, scene=town.scene, resolution=0.5, colour="greys", **made)
    return result.output, there(result.cloud)


def compared(town: Town3d, cloud: str) -> np.ndarray:
    """(N, 3) points of a cloud, as they lie on the truth."""
    points = laspy.read(cloud).xyz + town.shift
    return points[town.truth.inside(points)]


def _figures(town: Town3d, points: np.ndarray) -> List[object]:
    up, away, facade = town.truth.score(points)
    distance = away[facade]
    nearest = np.minimum(up, away)
    wall = [int(facade.sum()), int((distance < 1).sum()), *np.percentile(distance, (50, 90))]
    return [len(points), *wall, 100.0 * float((nearest > 1).mean()), 100.0 * float((nearest > 2).mean())]


def walls() -> List[str]:
    """What the rule for points on walls keeps, and what it costs."""
    cloud = ENGINE.solids.cloud
    rules = {
        "on the DSM alone": replace(cloud, wall_cells=0),
        "and on walls, of one cell around": replace(cloud, wall_cells=1),
        "**and on walls, of two cells around**": cloud,
        "the same without a margin": replace(cloud, wall_px=0.0),
        "the same with a margin of 1 px": replace(cloud, wall_px=1.0),
    }
    rows: List[List[object]] = []
    same = True
    for number, make in enumerate(few(towns())):
        town = make()
        first = b""
        for name, rule in few(list(rules.items())[: 3 if number else None]):
            say(f"walls: {town.name}, {name}")
            changed = replace(ENGINE, solids=replace(ENGINE.solids, cloud=rule))
            with tempfile.TemporaryDirectory() as folder:
                dsm, points = fused(town, folder, changed)
                heights = Path(dsm).read_bytes()
                first = first or heights
                same = same and heights == first
                rows.append([town.name, name, *_figures(town, compared(town, points))])
    headers = (
        "scene | what is kept | points | of facades | of these within 1 m of a wall | median distance from the "
        "wall, m | 90 % | all points farther than 1 m from the surface, % | farther than 2 m, %"
    )
    unchanged = "The DSMs are the same, byte for byte." if same else "The DSMs differ."
    return [
        f"**Walls in the cloud.** Simulated towns, the square of {2 * half_m():g} m in their middle. The truth has "
        f"vertical walls between its nodes, of trees too. A point belongs to a facade where a wall of {_TALL_M:g} m or "
        f"more is nearer than the surface over or below the point, but for {_END_M:g} m at the wall's ends. "
        + unchanged,
        table(headers, rows),
    ]


_KINDS: Dict[str, Tuple[str, float]] = {
    "none": ("none", 0.0),
    "statistical, 20 neighbours, 3 deviations": ("statistical", 3.0),
    "statistical, 20 neighbours, 2 deviations": ("statistical", 2.0),
    "statistical, 20 neighbours, 1 deviation": ("statistical", 1.0),
    "radius of 1 m, 4 neighbours": ("radius", 4.0),
    "radius of 1 m, 8 neighbours": ("radius", 8.0),
    "radius of 1 m, 12 neighbours": ("radius", 12.0),
}


def _without_outliers(points: np.ndarray, kind: str, number: float) -> np.ndarray:
    """Which points Rusu's filters keep: by the mean distance of 20 neighbours, or by their number within a metre."""
    tree = cKDTree(points)
    if kind == "statistical":
        away = tree.query(points, 21)[0][:, 1:].mean(axis=1)
        return away <= away.mean() + number * away.std()
    if kind == "radius":
        return tree.query_ball_point(points, 1.0, return_length=True) > number
    return np.ones(len(points), dtype=bool)


def outliers() -> List[str]:
    """What removing outliers of the cloud would gain and cost."""
    rows: List[List[object]] = []
    for make in few(towns()):
        town = make()
        with tempfile.TemporaryDirectory() as folder:
            points = compared(town, fused(town, folder)[1])[:: 10 if is_quick() else 1]
        up, away, facade = town.truth.score(points)
        wrong = np.minimum(up, away) > 1
        for name, (kind, number) in _KINDS.items():
            say(f"outliers: {town.name}, {name}")
            kept = _without_outliers(points, kind, number)
            lost = [100.0 * float((~kept)[part].mean()) for part in (wrong, ~wrong, facade & ~wrong)]
            rows.append([town.name, name, 100.0 * float(wrong[kept].mean()), *lost])
    headers = (
        "scene | filter (Rusu 2008) | points farther than 1 m from the surface, % | of these removed, % | of the "
        "others removed, % | of those on facades removed, %"
    )
    return ["**Outliers of the cloud**, on the same squares; none of these filters is built in.", table(headers, rows)]
