"""Whether two surfaces that were laid onto each other show one ground: its relief in the same scale, better here than
elsewhere, and without a tilt."""

from __future__ import annotations

from typing import Iterable, List, Tuple

import numpy as np

from ..contracts.arrays import FloatImage
from ..contracts.findings import Finding, as_percent
from ..contracts.records import OtherRelief
from ..evaluation.coregistration import block_means
from ..numerics.robust import nmad
from ..registration.parameters import REGISTRATION
from ..registration.solve import half_spread, mode, other_relief
from .open_ground import robust_plane
from .parameters import GATE, GateParameters
from .surfaces import bare_findings


def relief_findings(
    own: FloatImage,
    other: FloatImage,
    cell: Tuple[float, float],
    path: str,
    beside: float = 0.0,
    parameters: GateParameters = GATE,
) -> List[Finding]:
    """What contradicts that a surface's heights (rows, columns; m, NaN = none) are those of the other one at ``path``,
    on the same cells (m) and after the alignment; ``beside`` is how far beside its place it is known to lie, m."""
    both, side = np.isfinite(own) & np.isfinite(other), abs(cell[0])
    factor = max(1, round(parameters.open_cell_m / side))
    ours, theirs = (block_means(np.where(both, each, np.float32(np.nan)), factor) for each in (own, other))
    rows, columns = np.nonzero(np.isfinite(ours))
    if rows.size < parameters.open_cells:
        return []
    places = np.column_stack([columns / ours.shape[1] - 0.5, rows / ours.shape[0] - 0.5, np.ones(rows.size)])
    first, second = (each[rows, columns].astype(np.float64) for each in (ours, theirs))
    away = first - second
    tilt, *planes = (
        places @ robust_plane(places, each, float(np.median(each)), parameters) for each in (away, first, second)
    )
    found = other_relief(first - tilt, second, REGISTRATION)
    for image, plane in zip((ours, theirs), planes):
        image[rows, columns] -= plane
    one, two = ours[rows, columns], theirs[rows, columns]
    alike = float(np.corrcoef(one, two)[0, 1]) if min(one.std(), two.std()) > 0.0 else 0.0
    relief = OtherRelief(alike, float(one.std() / max(two.std(), parameters.open_least_m)))
    if found is None and (
        _is_scaled(relief) or (not beside and _fits_elsewhere(ours, theirs, side * factor, parameters))
    ):
        found = relief
    if found is not None:
        return [Finding("relief-other", found.sentence(path), "doubt")]
    by = float(np.ptp(tilt))
    if beside or by <= max(parameters.most_tilted_m, parameters.most_tilted_nmads * nmad(away - tilt)):
        return []
    text = f"The heights tilt against those of '{path}' by {by:.1f} m from one side of the ground to the other"
    return [Finding("tilted", f"{text}: register the DSM, or give the pointing control points.", "doubt")]


def date_findings(
    path: str, other: str, heights: Tuple[FloatImage, FloatImage], cell_m: float, beside: float
) -> List[Finding]:
    """What contradicts that the DSMs of two dates show one ground: ``heights`` of both (rows, columns) on the same
    cells of this side, m, after the alignment; ``beside``: the first one fits better so many metres beside its place.
    """
    found = of_dsm(path, relief_findings(heights[0], heights[1], (cell_m, cell_m), other, beside))
    if beside and not found:
        text = f"'{path}' fits to '{other}' better {beside:.1f} m beside its place"
        remedy = "check the CRS and the place of both, or set ALIGN to 3d"
        found.append(Finding("dates-displaced", f"{text}: {remedy}.", "doubt"))
    return found + bare_findings([heights], (cell_m, cell_m), (f"'{path}'", f"'{other}'"))


def of_dsm(path: str, findings: Iterable[Finding]) -> List[Finding]:
    """The same findings, which say of which of several DSMs they are."""
    return [Finding(each.id, f"Of the DSM '{path}': {each}", each.level) for each in findings]


def block_findings(
    own: FloatImage, reference: FloatImage, path: str, parameters: GateParameters = GATE
) -> List[Finding]:
    """Whether many heights (rows, columns; m) in one piece are far from a reference's: no NMAD shows a burst, nor what
    one of the two lacks."""
    from scipy import ndimage  # QGIS's own process may lack it

    away = own - reference
    known = away[np.isfinite(away)]
    most = max(parameters.least_burst_m, parameters.far_spreads * nmad(known))
    found = []
    for above in (1, -1):
        pieces = ndimage.label(above * (away - np.median(known)) > most)[0]
        sizes = np.bincount(pieces.ravel(), minlength=2)[1:]
        if sizes.max() > parameters.most_burst * known.size:
            by = float(np.median(away[pieces == sizes.argmax() + 1]))
            share = as_percent(sizes.max() / known.size)
            text = f"{share} of the heights, in one piece, lie {by:+.1f} m from those of '{path}'"
            found.append(Finding("piece-off", f"{text}: see 'Pictures'."))
    return found


def stray_findings(
    own: FloatImage, reference: FloatImage, path: str, parameters: GateParameters = GATE
) -> List[Finding]:
    """Whether heights (rows, columns; m) differ from a reference's by more than its whole relief, or many of them by
    one and the same step: no NMAD shows these, nor do errors of matching look so."""
    away = (own - reference)[np.isfinite(own) & np.isfinite(reference)].astype(np.float64)
    if away.size < parameters.open_cells:
        return []
    middle, spread = mode(away, 0.5), max(half_spread(away), parameters.open_least_m)
    most = float(np.nanmax(reference) - np.nanmin(reference)) + parameters.least_burst_m
    stray = float(np.mean(np.abs(away - middle) > most))
    if stray > parameters.most_stray:
        text = f"{as_percent(stray)} of the heights lie more than {most:.0f} m from those of '{path}'"
        remedy = "which span less than that: take the DSM's gross errors out (repm:editdsm)"
        return [Finding("heights-stray", f"{text}, {remedy}.", "doubt")]
    apart = away[np.abs(away - middle) > max(parameters.least_far_m, parameters.far_spreads * spread)]
    if apart.size > parameters.most_apart * away.size and half_spread(apart) < parameters.step_spreads * spread:
        share, step = as_percent(apart.size / away.size), mode(apart, 0.5) - middle
        text = f"{share} of the heights lie {step:+.1f} m from the others, against those of '{path}': see 'Pictures'."
        return [Finding("heights-stepped", text, "doubt")]
    return []


def far_share(own: FloatImage, other: FloatImage, parameters: GateParameters = GATE) -> float:
    """The share of the ground on which two surfaces (rows, columns; m) differ from their usual difference by more than
    errors explain."""
    away = (own - other)[np.isfinite(own) & np.isfinite(other)].astype(np.float64)
    if not away.size:
        return 0.0
    far = max(parameters.least_far_m, parameters.far_spreads * half_spread(away))
    return float(np.mean(np.abs(away - mode(away, 0.5)) > far))


def _is_scaled(relief: OtherRelief) -> bool:
    """Whether the slopes of both regressions, between which the scale is whatever the noise, say so; those of DSMs that
    lack houses of the other are 1 on one side."""
    alike, most = relief.correlation, REGISTRATION.most_scaled
    return alike >= REGISTRATION.least_alike and (relief.ratio * alike > most or relief.ratio / alike < 1.0 / most)


def _fits_elsewhere(own: FloatImage, other: FloatImage, side_m: float, parameters: GateParameters) -> bool:
    """Whether a surface fits to another one no better than to what that shows elsewhere: mirrored, turned, and moved by
    half of its extent. Both are without tilt, and have more relief than noise."""
    lag = max(1, round(parameters.noise_lag_m / side_m))
    bends = (np.diff(image[::lag, ::lag], 2) for image in (own, other))
    noise = max((nmad(each[np.isfinite(each)]) / np.sqrt(6.0) for each in bends), default=np.inf)
    half = tuple(size // 2 for size in other.shape)
    turned = other[::-1], other[:, ::-1], other[::-1, ::-1]
    moved = (np.roll(other, by, (0, 1)) for by in (half, (half[0], 0), (0, half[1])))
    usual = float(np.median([_misfit(own, each, parameters) for each in (*turned, *moved)]))
    least = min(_misfit(each, np.zeros_like(each), parameters) for each in (own, other))
    if (
        usual < max(parameters.least_relief_m, parameters.relief_noises * noise)
        or least < parameters.least_relief_m / 2
    ):
        return False
    return _misfit(own, other, parameters) > parameters.fits_elsewhere * usual


def _misfit(own: FloatImage, other: FloatImage, parameters: GateParameters) -> float:
    away = (own - other)[np.isfinite(own) & np.isfinite(other)]
    return float(np.minimum(np.abs(away - np.median(away)), parameters.near_m).mean()) if away.size else np.nan
