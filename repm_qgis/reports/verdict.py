"""Whether a result can be used as it is: each figure compared with the bound beyond which somebody should look at it.

The bounds are :class:`~repm_qgis.evaluation.parameters.VerdictParameters`. A finding is a sentence with the figure and
the bound; no finding is a good result.
"""

from __future__ import annotations

import math
import os
from typing import List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, Mask
from ..contracts.findings import Finding, as_percent, distinct
from ..contracts.records import FusionFacts, OtherRelief, PairFigures, RegistrationFigures
from ..evaluation.gcp_accuracy import GcpAccuracy
from ..evaluation.metrics import HeightMetrics
from ..evaluation.parameters import GCPS
from ..numerics.robust import nmad
from ..registration.solve import half_spread
from ..rpc.correction import DELIVERED, JITTERED, CorrectedRpc
from ..runtime.progress import counted, listed
from ..scene import Scene
from .parameters import VERDICT, VerdictParameters

_MOST_PAIRS = 5  # that are named
_FEW_MEASURED = 0.5  # of a roof
_OPEN_OUTLINE = 0.1  # of an outline at gaps, from which on a building may go on in them
_OPEN_BUILDINGS = 0.25  # of the area of all: DSMs of two images have 0.10 to 0.20, gaps beside walls
_MANY_OBJECTS_PERCENT = 80.0


def of_run(scene: Scene, facts: Optional[FusionFacts] = None, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of a reconstructed scene and, where there is one, of its DSM."""
    found = of_surface(facts, bounds) if facts is not None else []
    ties = scene.pointing
    if ties is not None and ties.after_px > bounds.most_residual_px:
        found.append(
            Finding(
                "tie-residual",
                f"The median residual of the tie points is {ties.after_px:.2f} px (usual: at most "
                f"{bounds.most_residual_px:g} px): see 'Tie points'.",
            )
        )
    found += _parallaxes(ties.pairs if ties is not None else (), bounds)
    if ties is not None and ties.rejected_gcps:
        found.append(
            Finding(
                "gcps-contradict",
                f"Control points contradict the others ({', '.join(ties.rejected_gcps)}): see 'Absolute position'.",
            )
        )
    found += _cameras(scene, bounds)
    if scene.registration is not None:
        found += of_registration(scene.registration, bounds)
    return found


def of_surface(facts: FusionFacts, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of a fused surface."""
    found = []
    if facts.valid_percent < bounds.least_covered_percent:
        found.append(
            Finding(
                "coverage-low",
                f"Only {facts.valid_percent:.0f} % of the ground that two images see has a height (usual: at least "
                f"{bounds.least_covered_percent:g} %): look at the confidence, and at 'Height maps'.",
            )
        )
    if facts.dem_offset is not None and facts.dem_offset.unexpected:
        found.append(Finding("dem-apart", facts.dem_offset.sentence(), "doubt"))
    return found


def of_history(scene: Scene) -> List[Finding]:
    """What the stages of a scene have found, each sentence once."""
    return distinct(finding for entry in scene.history for finding in entry.warnings)


def _parallaxes(pairs: Sequence[PairFigures], bounds: VerdictParameters) -> List[Finding]:
    """The pairs that keep the most vertical parallax, and how many more there are: a block of frames has very many."""
    worst = sorted((pair for pair in pairs if pair.after_px > bounds.most_parallax_px), key=lambda pair: -pair.after_px)
    found = [
        Finding(
            "vertical-parallax",
            f"{pair.pair[0]} and {pair.pair[1]} keep a vertical parallax of {pair.after_px:.2f} px (usual: at most "
            f"{bounds.most_parallax_px:g} px): see 'Tie points'.",
        )
        for pair in worst[:_MOST_PAIRS]
    ]
    more = len(worst) - _MOST_PAIRS
    if more > 0:
        found.append(
            Finding("vertical-parallax-more", f"The same holds for {counted(more, 'more pair')}: see 'Tie points'.")
        )
    return found


def of_refinement(scene: Scene, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of a refined scene's cameras."""
    return _cameras(scene, bounds)


def of_fit(scene: Scene, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of cameras that are fitted, and whose images are not refined yet."""
    found, worst = [], fitted_error_px(scene)
    if worst > bounds.most_equivalent_px:
        found.append(
            Finding(
                "equivalent-error",
                f"The cameras of a tile differ from the RPC by {worst:.2f} px (RMSE; matching needs at most "
                f"{bounds.most_equivalent_px:g} px): refine the images, or choose a smaller TILE_SIZE.",
            )
        )
    return found


def _cameras(scene: Scene, bounds: VerdictParameters) -> List[Finding]:
    worst = largest_error_px(scene)
    if worst is None or worst <= bounds.most_equivalent_px:
        return []
    return [
        Finding(
            "equivalent-error",
            f"The cameras of a tile differ from the RPC by {worst:.2f} px (RMSE; usual: at most "
            f"{bounds.most_equivalent_px:g} px): see 'Equivalent error'.",
        )
    ]


def fitted_error_px(scene: Scene) -> float:
    """The largest RMSE of a view's camera in a tile before refinement, px."""
    return max(view.error.rmse for tile in scene.tiles for view in tile.views.values())


def largest_error_px(scene: Scene) -> Optional[float]:
    """The largest RMSE of a view's camera in a tile after refinement, px; None before."""
    errors = [view.refined.error.rmse for tile in scene.tiles for view in tile.views.values() if view.refined]
    return max(errors, default=None)


def of_error_map(rmse: float, refined: bool, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of one view's equivalent error at an altitude, px."""
    if rmse <= bounds.most_equivalent_px:
        return []
    most = bounds.most_equivalent_px
    if refined:
        return [
            Finding(
                "equivalent-error",
                f"The refined cameras of this view differ from the RPC by {rmse:.2f} px (RMSE; matching needs at "
                f"most {most:g} px): choose a smaller TILE_SIZE, or another MODEL.",
            )
        ]
    return [
        Finding(
            "equivalent-error",
            f"The cameras of this view differ from the RPC by {rmse:.2f} px (RMSE; matching needs at most {most:g} "
            "px): refine the images.",
        )
    ]


def of_points(found: GcpAccuracy, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of a check against ground control points."""
    said = _few_points(int(found.rows().sum()), bounds)
    column = next((name for name in ("scene", "compensated") if name in found.residuals), "")
    if column:
        middle = _median_residual_px(found, column)
        if middle > GCPS.wrong_px:
            said.append(
                Finding(
                    "point-residual",
                    f"The median residual of the points in the images is {middle:.2f} px (usual: at most "
                    f"{GCPS.wrong_px:g} px): see 'In the images', and give the points to 'Reconstruct heights' as "
                    "GCPS.",
                )
            )
    up = found.errors["dsm"][found.rows(), 2] if "dsm" in found.errors else np.empty(0)
    known = np.isfinite(up)
    if known.sum() >= bounds.least_points:
        said += _spread_of_points(found, up, known, bounds)
    up = up[known]
    if up.size and abs(np.median(up)) > max(bounds.most_bias_nmads * nmad(up), bounds.most_bias_m):
        said.append(
            Finding(
                "heights-off",
                f"The DSM's heights differ from the points' by {np.median(up):+.2f} m as a whole, which is much more "
                "than their spread: check GCP_DATUM, the DSM's vertical datum and its absolute position.",
            )
        )
    return said


def _few_points(count: int, bounds: VerdictParameters) -> List[Finding]:
    if count >= bounds.least_points:
        return []
    text = f"Points that can be used: {count} (with fewer than {bounds.least_points}, a wrong one is not found)."
    return [Finding("points-few", text)]


def _median_residual_px(found: GcpAccuracy, column: str) -> float:
    """Of the points that count, over all images, px; 0 without any."""
    usable = [each for each, yes in zip(found.residuals[column], found.rows()) if yes]
    size = [float(np.hypot(*pixel)) for residual in usable for pixel in residual.values()]
    return float(np.median(size)) if size else 0.0


def of_control(found: GcpAccuracy, views: Sequence[str], bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of RPCs that were shifted by control points: images with few, and points that no shift explains."""
    counts = {
        name: sum(name in gcp.pixels for gcp, yes in zip(found.gcps, found.rows("control")) if yes) for name in views
    }
    said = _few_points(min(filter(None, counts.values()), default=0), bounds)
    bare = [name for name, count in counts.items() if not count]
    if bare:
        text = f"No control point was measured in {listed(bare)}: the RPC stays as delivered there."
        said.append(Finding("rpc-without-control", text))
    middle = _median_residual_px(found, "compensated")
    if middle > GCPS.wrong_px:
        text = (
            f"The median residual of the points after the shift is {middle:.2f} px (usual: at most {GCPS.wrong_px:g} "
            "px): check their places, heights and pixels with 'Check ground control points'."
        )
        said.append(Finding("point-residual", text))
    return said


def _spread_of_points(found: GcpAccuracy, up: FloatArray, known: Mask, bounds: VerdictParameters) -> List[Finding]:
    """Whether the heights of points say something of the DSM, whose errors at those that count are (N,) m."""
    if found.dsm_heights is not None:
        own = found.dsm_heights[found.rows()][known]
        left, relief = half_spread(up[known]), max(half_spread(own), half_spread(own - up[known]))
        if left > max(bounds.most_points_left_m, found.cell_m, bounds.most_points_unexplained * relief):
            text = (
                f"The heights of the points do not vary with the DSM's: both spread by {relief:.1f} m at most, and "
                f"their differences by {left:.1f} m. Check that both show the same place, and their units."
            )
            return [Finding("points-relief", text, "doubt")]
    away, most = np.abs(up - np.median(up[known])), max(bounds.most_points_m, found.cell_m)
    rms = float(np.sqrt(np.mean(away[known] ** 2)))
    if rms <= most:
        return []
    worst = [gcp.id for gcp, yes in zip(found.gcps, found.rows()) if yes][int(np.nanargmax(away))]
    text = (
        f"The errors of the DSM's heights at the points spread by {rms:.1f} m (RMS about their median; usual: at most "
        f"{most:.3g} m), most at {worst} ({np.nanmax(away):.1f} m): check the places of the points, and that they lie "
        "on open ground."
    )
    return [Finding("points-spread", text, "doubt")]


class Difference(NamedTuple):
    """Two DSMs of a mosaic by their numbers: the median and the NMAD of their differences after the offsets, m."""

    first: int
    second: int
    median: float
    nmad: float
    other_relief: Optional[OtherRelief] = None


def of_mosaic(differences: Sequence[Difference], bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of a mosaic, from all overlaps of its DSMs."""
    said = []
    wide = [
        each for each in differences if abs(each.median) > max(bounds.most_bias_nmads * each.nmad, bounds.most_bias_m)
    ]
    if wide:
        worst = max(wide, key=lambda each: abs(each.median))
        said.append(
            Finding(
                "overlaps-differ",
                f"Overlaps whose DSMs still differ after the offsets: {len(wide)} of {len(differences)}, at most "
                f"{abs(worst.median):.2f} m (DSMs {worst.first} and {worst.second}): see 'Overlaps', and check the "
                "vertical datums.",
            )
        )
    apart = [each for each in differences if each.nmad > bounds.most_spread_m]
    if apart:
        worst = max(apart, key=lambda each: each.nmad)
        said.append(
            Finding(
                "overlaps-other-surface",
                f"Overlaps whose DSMs do not show the same surface: {len(apart)} of {len(differences)}; those of "
                f"DSMs {worst.first} and {worst.second} differ by {worst.nmad:.1f} m (NMAD; usual: at most "
                f"{bounds.most_spread_m:g} m): check their places and units.",
                "doubt",
            )
        )
    for each in differences:
        if each.other_relief is not None:
            text = each.other_relief.sentence(f"DSM {each.first}")
            said.append(Finding("overlap-relief", f"Of DSM {each.second}: {text}", "doubt"))
    return said


def of_comparison(metrics: HeightMetrics, cell_m: float = 0.0, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of a comparison with a reference; ``cell_m`` is the side of the larger cells of both, m."""
    found = []
    most_spread = max(bounds.most_spread_m, bounds.most_spread_cells * cell_m)
    if metrics.nmad > most_spread:
        found.append(
            Finding(
                "other-surface",
                f"The heights spread by {metrics.nmad:.1f} m about the reference's (NMAD; usual: at most "
                f"{most_spread:g} m), so the two do not show the same surface: check the unit and scale of both, "
                "and their CRS and place.",
                "doubt",
            )
        )
    if metrics.valid < bounds.least_compared_percent:
        found.append(
            Finding(
                "compared-few",
                f"The DSM covers only {metrics.valid:.1f} % of the reference's cells, and the completeness counts "
                "all of them: cut the reference to the DSM's area if the DSM was not meant to cover the rest.",
            )
        )
    if abs(metrics.bias) > max(bounds.most_bias_nmads * metrics.nmad, bounds.most_bias_m):
        found.append(
            Finding(
                "heights-off",
                f"The heights differ by {metrics.bias:+.2f} m as a whole, which is much more than their spread: "
                "check the vertical datums and the absolute pointing, or set ALIGN to vertical or 3d.",
            )
        )
    return found


def of_change(
    changed_share: float, shift: Tuple[float, float, float], level_m: float, bounds: VerdictParameters = VERDICT
) -> List[Finding]:
    """The findings of the change between two dates: the changed share of what was compared, the shift (east, north, up)
    that was removed and the median level of detection, m."""
    found = [*of_shift(shift, bounds), *of_changed(changed_share, bounds)]
    if level_m > bounds.most_level_m:
        found.append(
            Finding(
                "level-high",
                f"Only changes of more than {level_m:.1f} m can be distinguished from errors (usual: at most "
                f"{bounds.most_level_m:g} m): see 'Stable ground'.",
            )
        )
    return found


def of_offset(offset_m: float, nmad_m: float, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The finding of the second of two dates that lies so much higher as a whole, where nothing removes it: the
    differences then spread by this NMAD."""
    if abs(offset_m) <= max(bounds.most_bias_nmads * nmad_m, bounds.most_bias_m):
        return []
    text = (
        f"AFTER lies {offset_m:+.2f} m from BEFORE as a whole, and the level of detection counts this as an error: set "
        "ALIGN to vertical or 3d, which removes it, if it is no change of the ground."
    )
    return [Finding("dates-apart", text)]


def of_unsure(areas: Sequence[float], least_m: float) -> List[Finding]:
    """The finding of parts with these areas (m2) that differ by more than the level of detection, and are no change, as
    no expected errors are known and they differ by less than ``least_m`` on level ground."""
    if not areas:
        return []
    text = (
        f"{sum(areas):.0f} m2 in {counted(len(areas), 'part')} differ by more than the level of detection and are not "
        f"counted: without expected errors, only what differs by {least_m:.1f} m or more is. Give BEFORE_CONFIDENCE "
        "and AFTER_CONFIDENCE, or look at the difference there."
    )
    return [Finding("changes-unsure", text)]


def of_shift(shift: Tuple[float, float, float], bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of the shift (m east, north, up) between two dates that an alignment removed."""
    found, (dx, dy, dz) = [], shift
    if math.hypot(dx, dy) > bounds.most_offset_m:
        found.append(
            Finding(
                "dates-displaced",
                f"The DSMs lie {math.hypot(dx, dy):.1f} m beside each other, which the alignment removed: check the "
                "CRS and the place of both.",
            )
        )
    if abs(dz) > bounds.most_offset_m:
        found.append(
            Finding(
                "dates-apart",
                f"The DSMs differ by {dz:+.1f} m as a whole, which the alignment removed: check that both have the "
                "same vertical datum and unit.",
            )
        )
    return found


def of_changed(share: float, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The finding of the share of the ground that changed between dates."""
    if share <= bounds.most_changed_share:
        return []
    text = (
        f"{100 * share:.0f} % of the ground changed (usual: at most {100 * bounds.most_changed_share:.0f} %): the "
        "alignment assumes that most of the ground is stable, so align both DSMs before, and set ALIGN to none."
    )
    return [Finding("changed-much", text)]


def of_buildings(
    areas: Sequence[float], measured: Sequence[float], gaps: Sequence[float], min_height: float, min_area: float
) -> List[Finding]:
    """The findings of buildings with these areas (m2), of whose roofs these shares were measured, not filled in, and
    of whose outlines these end at ``gaps``; the lowest height (m) and the smallest area (m2) that were looked for."""
    if not areas:
        return [
            Finding(
                "no-buildings",
                f"No building of at least {min_height:g} m and {min_area:g} m2 was found: the layer is empty. Choose "
                "a smaller MIN_HEIGHT or MIN_AREA, or check that DTM is the terrain below this DSM.",
            )
        ]
    found = []
    unsure = sum(share < _FEW_MEASURED for share in measured)
    if unsure:
        text = f"Less than half of the roof was measured for {unsure} of the buildings: look at these first."
        found.append(Finding("roofs-unsure", text))
    cut = [area for area, share in zip(areas, gaps) if share > _OPEN_OUTLINE]
    if sum(cut) > _OPEN_BUILDINGS * sum(areas):
        text = (
            f"{len(cut)} of the buildings ({as_percent(sum(cut) / sum(areas))} of their area) end where the DSM has "
            "no heights, and may be larger than stated: fill these gaps (repm:editdsm), or use a DSM of more images."
        )
        found.append(Finding("outlines-open", text, "doubt"))
    return found


def of_terrain(objects_percent: float) -> List[Finding]:
    """The findings of a terrain, by the share of the DSM's heights that belong to objects."""
    text = "Most of the heights belong to objects: choose a smaller LARGEST or a larger SLOPE where hills are gone."
    return [Finding("objects-many", text)] if objects_percent > _MANY_OBJECTS_PERCENT else []


def of_registration(figures: RegistrationFigures, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of a registration to references."""
    found = []
    relief = any(each.other_relief is not None for each in figures.references)  # that is the cause then
    if len(figures.determined) < 2 and not relief:
        unsure = min((each.unsure_m for each in figures.references if each.unsure_m is not None), default=None)
        which = f" but along {_azimuth(figures.determined[0])}" if figures.determined else ""
        stays = "there, the scene stays where the vendors' RPCs put it"
        if unsure is not None and unsure[0] <= figures.promised_m[0]:
            text = (
                f"The heights determine the horizontal position{which} with a standard deviation of {unsure[0]:.2f} m "
                f"(needed: {unsure[1]:.2f} m): {stays}. Choose a finer reference, or one of more ground."
            )
            found.append(Finding("position-unsure", text))
        else:
            text = f"The relief does not determine the horizontal position{which}: {stays}."
            found.append(Finding("relief-level", f"{text} Flat ground only determines the height: see 'Registration'."))
    for words, size, promise in figures.unexpected():
        found.append(
            Finding(
                "shift-unexpected",
                f"The shift of {size:.1f} m {words} is more than expected (nine of ten scenes need at most "
                f"{promise:.1f} m): see 'Registration'.",
            )
        )
    for each in figures.references:
        share = each.used / max(each.seen, 1)
        if share < bounds.least_used_share:
            found.append(
                Finding(
                    "reference-unlike",
                    f"Only {100 * share:.0f} % of the heights of '{os.path.basename(each.file)}' agree with the "
                    f"surface (usual: at least {100 * bounds.least_used_share:.0f} %): see 'Registration'.",
                    "doubt",
                )
            )
        if each.other_relief is not None:
            sentence = each.other_relief.sentence(os.path.basename(each.file))
            found.append(Finding("relief-other", sentence, "doubt"))
    return found


def of_rpcs(exported: Mapping[str, CorrectedRpc], bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """The findings of exported RPCs, by the views' names."""
    if all(each.method == DELIVERED for each in exported.values()):
        return [
            Finding(
                "rpcs-as-delivered",
                "The scene has no pointing correction, so these are the RPCs as delivered: give control points as "
                "GCPS, or export the scene that 'Reconstruct heights' writes.",
            )
        ]
    shaken = {name: each for name, each in exported.items() if each.method == JITTERED}
    return [
        Finding(
            "rpc-without-jitter",
            f"An RPC cannot hold the jitter of {name}: the exported one differs from the pointed model by up to "
            f"{each.max_px:.2f} px, {each.rms_px:.2f} px in the mean. Products of software that uses it contain "
            "these waves; this scene's own products do not.",
        )
        for name, each in shaken.items()
        if each.max_px > bounds.most_rpc_px
    ] + [
        Finding(
            "rpc-approximate",
            f"The exported RPC of {name} differs from the pointed model by up to {each.max_px:.3f} px (usual: at "
            f"most {bounds.most_rpc_px:g} px), as the correction is too large for the form of an RPC: check the tie "
            "points, or set POINTING to shift.",
        )
        for name, each in exported.items()
        if each.max_px > bounds.most_rpc_px and name not in shaken
    ]


def _azimuth(direction: Tuple[float, float]) -> str:
    """A horizontal direction in degrees from north, 0 to 180: it has no sign."""
    return f"{math.degrees(math.atan2(direction[0], direction[1])) % 180.0:.0f} degrees from north"
