"""DSMs that are compared or put together, with their confidence rasters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Window
from ..contracts.file_kinds import is_cloud
from ..contracts.findings import Finding, as_percent
from ..evaluation.coregistration import Patch
from .companions import confidence_findings
from .content import require_distinct_content
from .open_ground import open_ground, opened_surface
from .parameters import GATE, GateParameters


@dataclass(frozen=True)
class Entry:
    """A DSM and its confidence raster ("" for none), with the options that name them."""

    option: str
    path: str
    confidence: str = ""
    confidence_option: str = ""


def entries_of(dsms: Sequence[str], confidences: Sequence[str]) -> List[Entry]:
    """The DSMs of DSMS with the rasters of CONFIDENCES in that order, which may be none at all."""
    return [Entry("DSMS", path, own, "CONFIDENCES") for path, own in zip(dsms, confidences or [""] * len(dsms))]


def surface_findings(entries: Sequence[Entry], why: str) -> List[Finding]:
    """What is to be known of DSMs that are used together: copies are refused, or ``why`` ("it would count as a date
    of its own"), and confidence rasters must be theirs.

    Raises OptionError for a copy, ImageError for a raster that cannot be used.
    """
    named: dict[str, List[str]] = {}
    for entry in entries:
        if not is_cloud(entry.path):
            named.setdefault(entry.option, []).append(entry.path)
    require_distinct_content(named, why)
    with_errors = [each for each in entries if each.confidence]
    return [
        finding
        for each in with_errors
        for finding in confidence_findings(each.path, each.confidence, each.confidence_option)
    ]


def overlap_findings(
    patches: Sequence[Patch],
    windows: Sequence[Window],
    cell: Tuple[float, float],
    names: Tuple[str, str],
    whole: Tuple[float, float] = (0.0, 0.0),
    parameters: GateParameters = GATE,
) -> List[Finding]:
    """Whether two DSMs are tilted against each other, or one of them lacks what stands on the ground in the other.

    ``patches`` are (rows, columns) heights of both in windows of their overlap, m, with cells of these metres;
    ``whole`` is how far the larger one reaches along rows and columns, m.
    """
    found = []
    differences = [first - second for first, second in patches]
    every = replace(parameters, open_near_m=np.inf, open_gradient=np.inf)  # no ground, but all that is alike
    plane = open_ground([first for first, _ in patches], differences, windows, cell, every)
    tilt = 0.0 if plane.offsets is None else float(np.ptp(np.percentile(plane.offsets, (2.0, 98.0))))
    least = max(parameters.sure_tilt_m, parameters.sure_tilt_nmads * plane.left)
    beyond = max(tilt, float(np.abs(plane.slope) @ whole) if tilt > least else 0.0)  # less may be errors
    if beyond > max(parameters.most_tilt_m, parameters.most_tilt_cells * max(cell)):
        text = (
            f"{names[1]} is tilted against {names[0]}, by {tilt:.1f} m over their overlap and by "
            f"{beyond:.1f} m over all of it: register both (repm:register), or leave one out."
        )
        found.append(Finding("overlap-tilted", text, "doubt"))
    return found + bare_findings(patches, cell, names, parameters)


def bare_findings(
    patches: Sequence[Patch], cell: Tuple[float, float], names: Tuple[str, str], parameters: GateParameters = GATE
) -> List[Finding]:
    """Whether one of two DSMs lacks what stands on the ground in the other; arguments as for
    :func:`overlap_findings`."""
    from scipy import ndimage  # QGIS's own process may lack it

    found: List[Finding] = []
    narrow, raised, factor = replace(parameters, open_width_m=parameters.object_width_m), [], 1
    for patch in patches:
        (own, own_low, factor), (other, other_low, _) = (opened_surface(heights, cell, narrow) for heights in patch)
        both = np.isfinite(own) & np.isfinite(other)
        raised.append(
            [np.where(both, high - low, np.float32(np.nan)) for high, low in ((own, own_low), (other, other_low))]
        )
    cells = sum(int(np.isfinite(own).sum()) for own, _ in raised)
    least = max(parameters.object_m2 / abs(cell[0] * cell[1]) / factor**2, parameters.object_share * cells)
    for here, there, name, bare in ((0, 1, *names), (1, 0, *names[::-1])):
        with np.errstate(invalid="ignore"):
            stands = [patch[here] > parameters.object_m for patch in raised]
            gone = [each & (patch[there] < patch[here] / 2) for each, patch in zip(stands, raised)]
        stand = sum(int(each.sum()) for each in stands)
        share = sum(int(each.sum()) for each in gone) / max(stand, 1)
        objects = sum(ndimage.label(each)[1] for each in gone)
        if stand >= least and share > parameters.most_gone and objects >= parameters.least_objects:
            text = (
                f"{as_percent(share)} of what stands more than {parameters.object_m:g} m high in {name} is missing in "
                f"{bare}, which may be a terrain: give DSMs only."
            )
            found.append(Finding("overlap-bare", text, "doubt"))
    return found
