"""A surface over many dates (``repm:series``): simulated ones whose trends, dates and volumes are known."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from typing import Dict, List, Sequence

import numpy as np
import pyproj

from benchmarks.runner import alone, few, is_quick, say, stage, there
from benchmarks.tables import Section, table
from repm_qgis.contracts.stages import SERIES
from repm_qgis.imagery import raster
from repm_qgis.numerics.robust import nmad

_WKT = pyproj.CRS.from_epsg(32632).to_wkt()
_RADIUS, _STEP_M = 45.0, 3.0
_BEFORE_STEP = 0.5  # of the dates


@dataclass(frozen=True)
class Case:
    """A dome whose top rises by ``rate`` m a year, and a pit that is dug halfway; ``sigma`` are the errors of the dates
    in m, over and over; ``wrong`` is the number of a date that lies 5 m too high in the half with most of the
    dome, -1 for none; ``holes`` the share of cells that each date lacks."""

    name: str
    dates: int
    rate: float = 1.0
    sigma: Sequence[float] = (0.2,)
    wrong: int = -1
    holes: float = 0.0
    side: int = 400

    @property
    def years(self) -> np.ndarray:
        return np.arange(self.dates) + 0.3 * np.sin(np.arange(self.dates))


CASES = (
    Case("3 dates", 3),
    Case("6 dates", 6),
    Case("6 dates, errors of 0.1 to 0.4 m", 6, sigma=(0.1, 0.4, 0.2)),
    Case("6 dates, half of the fourth 5 m wrong", 6, wrong=3),
    Case("6 dates, 20 % of each missing", 6, holes=0.2),
    Case("12 dates", 12, sigma=(0.2, 0.3)),
)
LARGE = tuple(Case(f"6 dates, {side**2 / 1e6:g} Mcells", 6, side=side) for side in (1000, 3000, 5000))


def _dome(side: int) -> np.ndarray:
    y, x = np.mgrid[:side, :side] + 0.5
    return np.maximum(0.0, 1 - ((x - 0.6 * side) ** 2 + (y - 0.35 * side) ** 2) / (_RADIUS * side / 240) ** 2)


def _pit(side: int) -> np.ndarray:
    inside = np.zeros((side, side), bool)
    inside[int(0.6 * side) : int(0.8 * side), int(0.15 * side) : int(0.35 * side)] = True
    return inside


def _heights(case: Case, date: int) -> np.ndarray:
    y, x = np.mgrid[: case.side, : case.side] + 0.5
    heights = 100 + 4 * np.sin(x / 42) * np.cos(y / 34) + 2 * np.sin(x / 14 + y / 18)
    heights += case.rate * (case.years[date] - case.years[0]) * _dome(case.side)
    if date >= case.dates * _BEFORE_STEP:
        heights[_pit(case.side)] -= _STEP_M
    return heights


def written(case: Case, folder: str) -> Dict[str, object]:
    """Write a case's DSMs; gives the options of a run that follows them."""
    rng, paths = np.random.default_rng(case.dates), []
    for date in range(case.dates):
        fine = rng.normal(0, 1, (case.side, case.side))
        for axis in (0, 1):
            fine = fine + np.roll(fine, 1, axis) + np.roll(fine, -1, axis)  # neighbours share errors, as in matching
        heights = _heights(case, date) + case.sigma[date % len(case.sigma)] * fine / fine.std()
        if date == case.wrong:
            heights[:, case.side // 2 :] += 5.0
        if case.holes:
            heights[rng.uniform(size=heights.shape) < case.holes] = np.nan
        place = (500000.0, 1.0, 0.0, 5000000.0, 0.0, -1.0)
        paths.append(raster.write(f"{folder}/{date}.tif", [heights.astype(np.float32)], place, _WKT))
    start = np.datetime64("2010-01-01T00:00:00")
    seconds = np.round(case.years * 365.25 * 86400).astype("timedelta64[s]")
    names = {name: f"{folder}/{name}.tif" for name in ("output", "trend", "changed")}
    days = [f"{moment}Z" for moment in start + seconds]
    return {"dsms": paths, "dates": days, "table": f"{folder}/table.csv", **names}


def follow(options: Dict[str, object]) -> None:
    """A run of the stage with these options."""
    stage(SERIES, **options)


def _bands(path: str) -> List[np.ndarray]:
    with raster.opened(path) as dataset:
        return [raster.read(dataset, None, band) for band in range(1, dataset.RasterCount + 1)]


def scored(case: Case) -> List[object]:
    """A case's row."""
    with tempfile.TemporaryDirectory() as folder:
        options = written(case, folder)
        result = stage(SERIES, **options)
        trend, changed, stack = (_bands(there(path)) for path in (result.trend, result.changed, result.output))
    dome, pit = _dome(case.side), _pit(case.side)
    inside = (dome > 0.05) & np.isfinite(trend[0])
    away = (trend[0] - case.rate * dome)[inside]
    squares = np.polyfit(case.years, np.nan_to_num(np.stack(stack)[:, inside]), 1)[0] if not case.holes else [np.nan]
    share = (np.abs(away) <= trend[1][inside]).mean()
    covered = float("nan")
    if len(trend) > 3:
        low, high = (band[inside] for band in trend[3:])
        known = np.isfinite(low)
        true = case.rate * dome[inside]
        covered = ((low <= true) & (high >= true))[known].mean()
    first = int(np.ceil(case.dates * _BEFORE_STEP)) + 1
    still = (dome == 0) & ~_grown(pit)
    right = (np.nan_to_num(changed[0])[pit] == first).mean(), (np.nan_to_num(changed[0])[still] > 0).mean()
    row = [case.name, nmad(away, 0.0), nmad(squares - case.rate * dome[inside], 0.0), 100 * share, 100 * covered]
    say(row)
    sigma = np.array([case.sigma[date % len(case.sigma)] for date in range(case.dates)])
    worst = 100 * np.max(np.abs(np.array(result.errors_m) / sigma - 1))
    return [*row, 100 * right[0], 100 * right[1], worst]


def _grown(cells: np.ndarray) -> np.ndarray:
    grown = cells.copy()
    for axis in (0, 1):
        for by in (-2, -1, 1, 2):
            grown |= np.roll(grown, by, axis)
    return grown


def accuracy() -> List[str]:
    rows = [scored(case) for case in few(CASES)]
    return [
        "A dome that grows by 1 m a year and a pit of 3 m, on 400 x 400 cells of 1 m, with errors of 0.2 m where "
        "nothing else is said, which neighbours share. Trends are those on the dome. Two of three errors should be "
        "within the standard error, and 95 % of the true trends in the interval.",
        table(
            "series | trend, NMAD m/a | least squares, NMAD m/a | within the standard error % | in the interval % | "
            "right date of the pit % | date where nothing changed % | error of a date, worst %",
            rows,
        ),
    ]


def cost() -> List[str]:
    rows = []
    for case in [replace(LARGE[0], name="6 dates, 0.09 Mcells", side=300)] if is_quick() else LARGE:
        with tempfile.TemporaryDirectory() as folder:
            found = alone(follow, written(case, folder))
        rows.append([case.name, found.cpu_s, found.mib])
        say(rows[-1])
    return ["One process, without confidences and areas.", table("series | CPU s | peak MiB", rows)]


_COMMAND = "make bench-series"
SECTIONS = [
    Section("series", "A surface over many dates", _COMMAND, {"accuracy": accuracy}),
    Section("series_cost", "What a surface over many dates costs", _COMMAND, {"cost": cost}),
]
