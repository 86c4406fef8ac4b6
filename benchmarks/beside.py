"""One part of ours and open3d's on the same data, each in a process of its own: what they find, and what they cost."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Callable, Dict, List, Optional

import numpy as np

from benchmarks.answers_solids import has_library, library
from benchmarks.runner import alone

Beside = List[object]
ABSENT = "absent"  # in the place of what open3d finds, where there is no open3d
HEADERS = "part | data | figure | ours | open3d | CPU s: ours | open3d | MiB: ours | open3d"


@dataclass(frozen=True)
class Both:
    """What ours found, as it was read, and the arrays that open3d found, None where it is absent; CPU seconds of the
    work and MiB of the process, ours first."""

    ours: Any
    theirs: Optional[Dict[str, np.ndarray]]
    cpu_s: List[float]
    mib: List[float]

    def row(self, part: str, data: str, figure: str, ours: object, theirs: object) -> Beside:
        """A row of the table; the cost stands in the first row of a part alone."""
        cpu_s, mib = [f"{value:.1f}" for value in self.cpu_s], list(map(round, self.mib))
        missing = [ABSENT] if self.theirs is None else []
        cost = [*cpu_s, *missing, *mib, *missing] if data else [""] * 4
        return [part, data, figure, ours, theirs, *cost]


def timed(module: str, name: str, folder: str) -> float:
    """Call a function with a folder; the CPU seconds that it takes, without those of the interpreter's start."""
    function = getattr(import_module(module), name)
    start = time.process_time()
    function(folder)
    return time.process_time() - start


def compared_with(
    part: str,
    data: Dict[str, Any],
    own: Callable[[str], None],
    prepare: Callable[[str], None] = lambda folder: None,
    read: Callable[[str], Any] = lambda folder: dict(np.load(f"{folder}/own.npz")),
) -> Both:
    """Give ``data`` to ``own`` and to the part of solids_libraries.py. ``own`` takes a folder with data.npz and what
    ``prepare`` puts there, and ``read`` reads what it wrote. Raises Failed."""
    with tempfile.TemporaryDirectory() as folder:
        np.savez(f"{folder}/data.npz", **data)
        prepare(folder)
        ours = alone(timed, own.__module__, own.__name__, folder)
        found = read(folder)
        if not has_library():
            return Both(found, None, [ours.result], [ours.mib])
        cost = library(part, f"{folder}/data.npz", f"{folder}/open3d.npz")
        theirs = dict(np.load(f"{folder}/open3d.npz"))
    return Both(found, theirs, [ours.result, cost["cpu_s"]], [ours.mib, cost["mib"]])
