"""Never silently wrong: trials with known truth over the algorithms after the DSM, over registration, and twins of runs
of the pipeline. Each ends right, refused, named by a warning, or silently wrong."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Tuple

import numpy as np

from benchmarks import twin_scenes, twin_trials
from benchmarks.runner import Failed, is_quick, say
from benchmarks.tables import Section, table
from benchmarks.twin_trials import Draw, Heard, Trial
from benchmarks.twin_world import World
from repm_qgis.contracts.errors import RepmError

_SEED = 20261127
_EACH, _QUICK = 210, 4
TRIALS: Dict[str, Callable[[Draw], Trial]] = {
    **twin_trials.TRIALS,
    "register": twin_scenes.register,
    "pipeline": twin_scenes.images,
}
_OF_ALL = {"register": 210, "pipeline": 60}  # the others _EACH
_BAD = ("silently wrong", "crashed", "false alarm")
OUTCOMES = ("right", "refused", "named", *_BAD)


def outcome(trial: Trial) -> Tuple[str, str]:
    """How a trial ended, one of :data:`OUTCOMES`, with the sentence that says why."""
    heard = Heard()
    try:
        wrong = trial.run(heard)
    except RepmError as error:
        return ("false alarm" if trial.sound else "refused"), f"{type(error).__name__}: {error}"
    except Exception as error:  # a crash is what is looked for
        return "crashed", f"{type(error).__name__}: {error}"
    if heard.findings:
        named = "; ".join(map(str, heard.findings))
        return ("false alarm" if trial.sound else "named"), f"{named}. {wrong}"
    return ("silently wrong" if wrong else "right"), wrong


def tried(name: str, count: int, shared: Path, seed: int = _SEED) -> Iterator[Tuple[Trial, str, str]]:
    """So many trials of one algorithm, each with its outcome and the sentence about it; ``shared`` is a folder for the
    scene that trials of scenes use."""
    for number in range(count):
        own = [seed, sorted(TRIALS).index(name), number]
        rng = np.random.default_rng(own)
        with tempfile.TemporaryDirectory() as folder:
            trial = TRIALS[name](Draw(World.drawn(int(rng.integers(1 << 30))), Path(folder), rng, shared))
            kind, why = outcome(trial)
        if kind in _BAD:
            say(f"{name} {number}: {trial.what}: {kind}: {why[:300]}")
        yield trial, kind, why


def trials() -> List[str]:
    """All algorithms. Raises Failed where a result is silently wrong, where one crashes, or at a false alarm."""
    rows: List[List[object]] = []
    faults: Dict[Tuple[str, str], int] = Counter()
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as shared:
        for name in TRIALS:
            counts: Dict[str, int] = Counter()
            for trial, kind, _ in tried(name, _QUICK if is_quick() else _OF_ALL.get(name, _EACH), Path(shared)):
                counts[kind] += 1
                counts["sound"] += trial.sound
                faults[trial.what.replace("terrain: ", ""), kind] += 1
            ended = [counts[kind] for kind in OUTCOMES]
            rows.append([f"`repm:{name}`", sum(ended), counts["sound"], *ended])
    total = [sum(int(str(row[index])) for row in rows) for index in range(1, len(rows[0]))]
    rows.append(["all", *total])
    say(f"{total[0]} trials in {time.monotonic() - start:.0f} s")
    bad = sum(count for (_, kind), count in faults.items() if kind in _BAD)
    if bad:
        raise Failed(f"{bad} of {total[0]} trials ended silently wrong, with a crash or with a false alarm")
    kinds = sorted({what for what, _ in faults})
    return [
        "Surfaces that are known by formula, at random places in Europe: hills, houses, heaps and pits, and a "
        "simulated scene. CRS, cells, datum, unit, holes and type of numbers are drawn; some trials are sound, the "
        f"others have one fault. Seed {_SEED}.",
        table(["algorithm", "trials", "sound", *OUTCOMES], rows),
        "By fault:",
        table(["fault", *OUTCOMES], [[what, *(faults[what, kind] for kind in OUTCOMES)] for what in kinds]),
    ]


SECTIONS = [Section("twins", "Never silently wrong", "make bench-twins", {"trials": trials})]
