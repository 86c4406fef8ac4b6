"""Changes between two dates: simulated ones that are known, and none between two DSMs of one date."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import List, Sequence, Tuple

import numpy as np
from osgeo import ogr

from benchmarks import towns
from benchmarks.runner import few, is_quick, pipeline, say, stage
from benchmarks.scenes import CACHE, SHARED, made_once, not_measured
from benchmarks.tables import Details, table
from benchmarks.two_dates import KINDS, Change, dates
from repm_qgis.contracts.results import ChangeResult
from repm_qgis.contracts.stages import CHANGE

_SIZE, _SEEDS = 900, (3, 5, 8)
_NEAR_M = 2.0  # a found outline may lie so far outside of the true one
_LEAST_SHARE = 0.2  # of a found outline that must lie there
_TOWN = SHARED / "jax_068"
QUICK_VIEWS = ("001", "002")
_VIEWS = {
    "autumn and winter, odd": "001 003 007 009 011",
    "autumn and winter, even": "002 004 005 006 010",
    "spring and summer": "015 016 018 019 020",
}


@dataclass(frozen=True)
class Polygon:
    """A polygon that was found."""

    shape: ogr.Geometry
    area: float
    volume: float
    deviation: float


def _size() -> int:
    """The side of a town's images, px."""
    return 400 if is_quick() else _SIZE


def _found(before: str, after: str, confidences: Sequence[str], folder: str) -> Tuple[List[Polygon], ChangeResult]:
    made = {"before": before, "after": after, "output": f"{folder}/d.tif", "volumes": f"{folder}/v.gpkg"}
    made.update(zip(("before_confidence", "after_confidence"), confidences))
    result = stage(CHANGE, **made)
    source = ogr.Open(made["volumes"])
    found = []
    for feature in source.GetLayer(0):
        values = [feature.GetField(name) for name in ("area_m2", "volume_m3", "deviation_m3")]
        found.append(Polygon(feature.GetGeometryRef().Clone(), *values))
    return found, result


@dataclass(frozen=True)
class Score:
    """Of one town: each true change with the polygons found for it, and the polygons of none."""

    truth: List[Change]
    matched: List[List[Polygon]]
    invented: List[Polygon]

    def ratios(self) -> List[float]:
        """Found over true volume of those that were found."""
        pairs = zip(self.truth, self.matched)
        return [sum(p.volume for p in own) / true.volume for true, own in pairs if own]

    def deviations(self) -> List[float]:
        """How many of its stated standard deviations each found volume is away."""
        result = []
        for true, own in zip(self.truth, self.matched):
            if own:
                stated = float(np.sqrt(sum(p.deviation**2 for p in own)))
                result.append(abs(sum(p.volume for p in own) - true.volume) / stated)
        return result


def _scored(found: Sequence[Polygon], truth: List[Change]) -> Score:
    around = [ogr.CreateGeometryFromWkt(true.outline).Buffer(_NEAR_M) for true in truth]
    matched: List[List[Polygon]] = [[] for _ in truth]
    invented = []
    for polygon in found:
        shares = [polygon.shape.Intersection(shape).GetArea() / polygon.shape.GetArea() for shape in around]
        best = int(np.argmax(shares))
        same = polygon.volume * truth[best].volume > 0
        if shares[best] >= _LEAST_SHARE and same:
            matched[best].append(polygon)
        else:
            invented.append(polygon)
    return Score(truth, matched, invented)


def _town(seed: int, stated: bool) -> Tuple[Score, List[Polygon]]:
    """The changes of a town, and what is found between two DSMs of its first date."""
    made = dates(_size(), seed)
    with tempfile.TemporaryDirectory() as folder:
        parts = []
        for names in few((("before", "after"), ("same_1", "same_2"))):
            confidences = [made.confidence(name) for name in names] if stated else []
            parts.append(_found(made.dsm(names[0]), made.dsm(names[1]), confidences, folder)[0])
    return _scored(parts[0], made.changes), [] if is_quick() else parts[1]


def _share(values: Sequence[float], most: float) -> float:
    return 100.0 * float(np.mean(np.array(values) <= most)) if values else float("nan")


def _row(name: str, scores: Sequence[Score], same: Sequence[Sequence[Polygon]]) -> List[object]:
    ratios = [ratio for score in scores for ratio in score.ratios()]
    away = [value for score in scores for value in score.deviations()]
    pairs = [(true.volume, own) for score in scores for true, own in zip(score.truth, score.matched) if own]
    volumes = sum(abs(sum(p.volume for p in own)) for _, own in pairs) / sum(abs(true) for true, _ in pairs)
    count = sum(len(score.truth) for score in scores)
    invented = [polygon for score in scores for polygon in score.invented]
    false = [polygon for each in same for polygon in each]
    return [
        name,
        f"{len(ratios)} of {count}",
        f"{len(invented)} ({sum(p.area for p in invented):.0f} m2)",
        f"{100 * (volumes - 1):+.1f}",
        100 * float(np.median(np.abs(np.array(ratios) - 1))),
        _share(list(np.abs(np.array(ratios) - 1)), 0.1),
        f"{_share(away, 1):.0f}, {_share(away, 2):.0f}",
        f"{len(false)} ({sum(p.area for p in false):.0f} m2)",
    ]


def _simulated() -> List[str]:
    rows, details = [], []
    for stated in few((True, False)):
        scores, same = [], []
        for seed in few(_SEEDS):
            say(f"change: town {seed}")
            score, none = _town(seed, stated)
            scores.append(score)
            same.append(none)
        rows.append(_row("with confidences" if stated else "without", scores, same))
        if stated:
            details = [
                [
                    seed,
                    true.kind,
                    true.area,
                    true.volume,
                    sum(p.volume for p in own) if own else "not found",
                    float(np.sqrt(sum(p.deviation**2 for p in own))) if own else "",
                ]
                for seed, score in zip(few(_SEEDS), scores)
                for true, own in zip(score.truth, score.matched)
            ]
    headers = (
        "DSMs | found | invented | all volumes, % | a volume, median % | within 10 %, % | within 1, 2 deviations, % | "
        "between two DSMs of one date"
    )
    return [
        f"Changes of simulated towns of {_size() * 0.5:.0f} m a side ({len(few(_SEEDS))} towns, 0.5 m, three views at "
        f"each date): {len(KINDS)} buildings of each are added, removed or raised by 3 m. The second date has another "
        "sun, other views, noise and pointing errors; both DSMs are made by the whole pipeline. *All volumes*: the sum "
        "of all volumes that were found against the true sum. *Within 1, 2 deviations*: the share of true volumes that "
        "lie within one and two stated standard deviations. *Between two DSMs of one date*: what is found between the "
        "DSMs of two disjoint pairs of views, where nothing changed.",
        table(headers, rows),
        Details("Each simulated change, with confidences."),
        Details(table("town | kind | area, m2 | true volume, m3 | found, m3 | standard deviation, m3", details)),
    ]


def _real() -> List[str]:
    if not _TOWN.exists():
        return [not_measured("jax_068")]
    folders = {}
    for name, numbers in _VIEWS.items():
        folders[name] = real_scene(numbers.split())
    first, *others = folders
    rows = []
    with tempfile.TemporaryDirectory() as place:
        for other in others:
            for stated in few((True, False)):
                before, after = (str(folders[name] / "dsm.tif") for name in (first, other))
                confidences = [str(folders[name] / "confidence.tif") for name in (first, other)] if stated else []
                found, result = _found(before, after, confidences, place)
                areas = sorted((p.area for p in found), reverse=True)
                moved = f"{result.dx:+.2f}, {result.dy:+.2f}, {result.dz:+.2f}"
                label = "with confidences" if stated else "without"
                rows.append([f"{first}; {other}", label, moved, result.level_m, len(found), sum(areas)])
    headers = "views of both DSMs | DSMs | moved by, m | level, m | changes | their area, m2"
    return [
        "Real DSMs of `jax_068` (WorldView-3, 8 bit, cells of 0.5 m) from disjoint sets of five views. "
        "The first two sets are of the same four months, so almost nothing changed but cars and leaves; the "
        "third is of half a year later.",
        table(headers, rows),
    ]


def real_scene(numbers: Sequence[str]) -> Path:
    """The folder of the real town's reconstruction and DSM from some of its views, in the cache."""
    images = [str(_TOWN / f"JAX_068_{number}_RGB.tif") for number in numbers]
    folder = CACHE / f"change_{'_'.join(numbers)}"
    options = {"confidence": f"{folder}/confidence.tif", "resolution": 0.5, **towns.quick_area()}
    return made_once(folder, lambda: pipeline(images, folder, **options))


def change() -> List[str]:
    return [*_simulated(), *([] if is_quick() else _real())]
