"""Whether surfaces that are used together lie at one place, and how much of the ground they share."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Callable, List, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Window
from ..contracts.errors import EmptyResultError, ImageError
from ..contracts.findings import Finding, as_percent
from ..evaluation.coregistration import Patch, align
from ..evaluation.grids import Grid, cell_metres
from ..imagery.heights import read_heights, stated_deviation
from ..imagery.raster import opened
from .parameters import GATE, GateParameters

ROWS = 512
"""Rows of a raster that are read, where shares are counted."""


def displaced_by(
    patches: Sequence[Patch],
    cell: Tuple[float, float],
    check: Callable[[], None] = lambda: None,
    parameters: GateParameters = GATE,
) -> float:
    """How far beside its place a surface fits to another one better, m; 0 where it fits as well as anywhere, or the
    relief does not say. ``patches`` are those of :func:`~repm_qgis.evaluation.coregistration.align`."""
    with suppress(EmptyResultError):
        found = align("3d", patches, cell, check)
        by = float(np.hypot(found.dx, found.dy))
        # By whole cells: what lies between them is smoother, and noise would fit better there.
        whole = replace(found, dx=round(found.dx / cell[0]) * cell[0], dy=round(found.dy / cell[1]) * cell[1])
        if by > max(parameters.most_displaced_m, parameters.most_displaced_cells * max(map(abs, cell))):
            before, after = (
                np.concatenate([(surface - other)[np.isfinite(surface - other)] for surface, other in pairs])
                for pairs in (patches, [(whole.applied(surface, cell), other) for surface, other in patches])
            )
            # Over level ground only walls tell: what is far off counts, but no more than so much.
            misfits = [np.minimum(np.abs(d - np.median(d)), parameters.near_m).mean() for d in (before, after)]
            if misfits[1] < parameters.displaced_gain * misfits[0]:
                return by
    return 0.0


def known_m2(path: str) -> float:
    """The ground on which a DSM has heights, m2, by evenly spaced rows. Raises ImageError."""
    with opened(path) as dataset:
        columns, rows = dataset.RasterXSize, dataset.RasterYSize
        chosen = np.unique(np.linspace(0, rows - 1, min(rows, ROWS)).astype(int))
        known = sum(int(np.isfinite(read_heights(dataset, Window(0, int(row), columns, 1))).sum()) for row in chosen)
        width, height = cell_metres(Grid.of(dataset))
    return float(known * rows / len(chosen) * abs(width * height))


def partial_finding(share: float, paths: Sequence[str], parameters: GateParameters = GATE) -> List[Finding]:
    """The finding of dates that share too little of the ground: only this share of what the largest DSM covers has
    heights in all of these."""
    if share >= parameters.least_shared:
        return []
    names = ", ".join(f"'{path}'" for path in paths)
    text = f"Only {as_percent(share)} of the ground that the largest DSM covers has heights in {names}"
    return [Finding("dates-partial", f"{text}: nothing is known of the rest. Cut the DSMs to one area, if it matters.")]


def uncertain_findings(path: str, parameters: GateParameters = GATE) -> List[Finding]:
    """Whether a reference is a DSM that states an uncertain height of its own, as ours do without a reference."""
    deviation = None
    with suppress(ImageError), opened(path) as dataset:  # else a table or a cloud
        deviation = stated_deviation(dataset)
    if deviation is None or deviation <= parameters.most_uncertain_m:
        return []
    text = f"'{path}' is a DSM whose own height is uncertain (standard deviation {deviation:.1f} m)"
    return [Finding("reference-uncertain", f"{text}: the scene then lies as this DSM does, not better.")]
