"""Where the images really look: what the adjustment recovers, on truth scenes and real images."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence, Set, Tuple

import numpy as np

from benchmarks.control_bound import DRAWS, controlled
from benchmarks.pointing_case import case_of, fitted, pointed, truth_scene
from benchmarks.poor_scenes import poor_scenes
from benchmarks.runner import CORES, alone, few, is_quick, pipeline, stage, there
from benchmarks.scenes import SHARED, absent, middle_of, real, simulated, zy3
from benchmarks.scoring import difference, nmad
from benchmarks.tables import Details, Section, table
from repm_qgis.contracts.stages import DSMFUSE, EPMFIT, RECONSTRUCT
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.geometry.footprints import bounds_of, footprint, seen_twice
from repm_qgis.geometry.frames import EnuFrame, projected_from_geodetic, utm_crs
from repm_qgis.imagery.acquisition import duration_text, moment, time_of_name
from repm_qgis.planning.pair_selection import choose_pairs, pair_cost
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.pointing.adjustment import adjust
from repm_qgis.pointing.colmap_adjustment import adjust_colmap
from repm_qgis.rpc.readers import read_rpc_file
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene as SceneFile
from repm_qgis.scene import Tile, View
from repm_qgis.stereo.pairing import convergence
from repm_qgis.ties.tracks import Track


def truth_urban() -> List[str]:
    """Two views under real RPCs, the second wrong by (1.7, -2.3) px."""
    rows = []
    for scene in real("truth_urban"):
        for label, options in (("without", {}), ("with gcps.csv", {"gcps": str(scene.folder / "gcps.csv")})):
            with tempfile.TemporaryDirectory() as folder:
                area = middle_of(scene.reference) if is_quick() else {}
                made = pipeline(scene.images, folder, resolution=scene.resolution, **area, **options)
                found = score_files(made.output, scene.reference).metrics
                facts = there(SceneFile.load(made.scene).pointing)
            pair, uncertain = facts.pairs[0], facts.height_uncertainty_m
            rejected = f"{len(facts.rejected_gcps)} of {len(facts.gcps)} points rejected"
            height = rejected if uncertain is None else f"{uncertain:.1f} m"
            parallax = (pair.count, abs(pair.before_px), pair.after_px)
            up = [each.up_m for each in facts.gcps if not each.rejected]
            noise = f"{np.std(up, ddof=1) / len(up) ** 0.5:.2f}" if up else ""
            rows.append([label, *parallax, found.bias, noise, found.nmad, height])
    headers = (
        "GCPs | ties | vertical parallax before, px | after (median of absolute), px | bias of the DSM, m | "
        "one sigma that the points' noise leaves in it, m | NMAD, m | reported of the absolute height"
    )
    return [
        "**1. truth_urban**: two views, real Pleiades RPCs, the second wrong by (1.7, -2.3) px; GCPs with 0.3 px "
        "of noise. Bars: vertical parallax below 0.1 px; bias with GCPs below 0.15 m without any alignment; without "
        "GCPs the report says how uncertain the absolute height is. The sigma is that of the mean of the points' own "
        "height errors: a bias of its size is the points' draw, not the adjustment's.",
        table(headers, rows),
        *absent("truth_urban"),
    ]


def with_outliers(tracks: Sequence[Track], share: float, seed: int) -> List[Track]:
    """Tie points of which a share is wrong by up to 30 px in one view."""
    rng = np.random.default_rng(seed)
    result = []
    for track in tracks:
        pixels = dict(track.pixels)
        if rng.uniform() < share:
            name = sorted(pixels)[rng.integers(len(pixels))]
            pixels[name] = pixels[name] + rng.uniform(-30, 30, 2)
        result.append(Track(pixels))
    return result


def known_errors() -> List[str]:
    """Truth scenes with known pointing errors."""
    found_rows, control_rows = [], []
    for label in few(("town", "hills")):
        for kind, bar in few((("shift", 0.05), ("affine", 0.1))):
            case = case_of(label, kind)
            scene = case.scene()
            found = pointed(scene)
            altitude = sum(scene.altitudes) / 2
            dirty = adjust(case.views(), with_outliers(found.tracks, 0.2, 3), altitude, "auto")
            observable = [case.observable_px(a.pointing) for a in (found.adjusted, dirty)]
            cells = (f"{np.median(o):.3f} / {o.max():.3f}" for o in observable)
            found_rows.append([label, kind, len(found.tracks), found.adjusted.model, *cells, bar])
            control_rows.append([label, kind, *controlled(case, found, altitude, kind), bar])
    size = truth_scene("town").made.size
    control = (
        "scene | errors | absolute, exact GCPs | absolute, GCPs of 0.3 px | RMS of the draws | bound | right model | "
        "named as wrong (draws) | bar"
    )
    return [
        f"**2. Known errors**: simulated tri-stereo, {size} px, RPCs shifted by up to 15 px; *affine*: with drift "
        "of up to 3 px across the image besides. Observable: what no move of the ground points takes up, RMS over "
        "the views, at 600 points of the surface (median / largest), px.",
        table("scene | errors | ties | model chosen | observable | with 20 % gross outliers | bar", found_rows),
        "With 12 control points, of which G01 and G02 are wrong by 4 to 12 px in each direction. Absolute: the "
        "error of the view that is worst at each of 600 points of the surface (median / largest), px; the bar is "
        f"for exact points. RMS: over points and views, of {DRAWS} draws of points with 0.3 px of noise; beside it "
        "the Cramer-Rao bound: what ten good points of that noise and the ties allow an unbiased adjustment that "
        "knows which two are wrong, and how noisy all are.",
        table(control, control_rows),
    ]


def _of_pair(pair: Set[str], tile: Tile) -> Tile:
    return replace(tile, heights=tuple(record for record in tile.heights if set(record.pair) == pair))


def pairwise_dsms(images: Sequence[str], folder: str, area: Mapping[str, object]) -> Dict[Tuple[str, str], str]:
    """One DSM for each pair of views, all from one adjustment."""
    made = stage(EPMFIT, images=list(images), workspace=folder, **area)
    scene = SceneFile.load(stage(RECONSTRUCT, scene=made.scene, output_scene=f"{folder}/all.json").output_scene)
    result = {}
    for pair in combinations([view.name for view in scene.views], 2):
        alone = scene.with_tiles(partial(_of_pair, set(pair)))
        name = f"{folder}/{'_'.join(pair)}"
        result[pair] = stage(DSMFUSE, scene=alone.save(f"{name}.json"), output=f"{name}.tif", resolution=0.5).output
    return result


def worst_corner(error: np.ndarray) -> float:
    """The largest median of the four corners, each a quarter of the sides, m."""
    height, width = (n // 4 for n in error.shape)
    corners = [error[r, c] for r in np.s_[:height, -height:] for c in np.s_[:width, -width:]]
    return max((abs(float(np.nanmedian(part))) for part in corners if np.isfinite(part).any()), default=0.0)


def triplet() -> List[str]:
    """The pairwise DSMs of three real images agree."""
    rows = []
    for scene in real("pleiades_triplet"):
        with tempfile.TemporaryDirectory() as folder:
            made = pairwise_dsms(scene.images, folder, middle_of(scene.reference) if is_quick() else {})
            for (one, first), (two, second) in combinations(made.items(), 2):
                error = difference(first, second)
                cells = (float(np.nanmedian(error)), worst_corner(error), nmad(error))
                rows.append([" and ".join(one), " and ".join(two), *cells])
    return [
        "**3. pleiades_triplet**: the DSMs of the three pairs against each other after adjustment, 0.5 m cells, no "
        "alignment. Bar: median within 0.3 m (S2P's raw pairs differ by 4.8 m; CARS leaves up to 2.4 m in "
        "corners).",
        table("DSM of | less DSM of | median, m | worst corner's median, m | NMAD, m", rows),
        *absent("pleiades_triplet"),
    ]


# Cost -------------------------------------------------------------------------------------------------------------


def timed_pointing(path: str) -> Tuple[int, float, float, float]:
    """Ties and adjustment of a scene: how many ties, what they leave, px, and seconds by the clock and of the CPU."""
    scene = replace(SceneFile.load(path), refinement="polynomial")
    start, before = time.perf_counter(), os.times()
    figures = pointed(scene).figures
    wall, after = time.perf_counter() - start, os.times()
    return figures.count, figures.after_px, wall, sum(after[:4]) - sum(before[:4])


def cost(images: Sequence[str]) -> List[object]:
    """The same in a process of its own, and MiB of itself and its workers."""
    with tempfile.TemporaryDirectory() as folder:
        used = alone(timed_pointing, str(fitted(images, Path(folder) / "w").path))
    workers = CORES if used.child_mib > 100 else 0
    return [*used.result, f"{used.mib + workers * used.child_mib:.0f}"]


def costs() -> List[str]:
    scenes = [] if is_quick() else real("pleiades_triplet")
    rows = [[scene.name, *cost(scene.images), "6 s, 1024 MiB"] for scene in scenes]
    big = simulated("zy3_800m", zy3(5120, 800.0), 5.0)
    side = big.made.size
    rows.append([f"3 x {side} x {side} (ZY-3 simulated)", *cost(big.images), "30 s, 1024 MiB"])
    return [
        f"**5. Cost** of ties and adjustment, on {CORES} cores that others used too (load "
        f"{os.getloadavg()[0]:.1f}); memory of the process plus, where there are worker processes, of as many "
        "of the largest.",
        table("scene | ties | median residual, px | wall, s | CPU, s | memory, MiB | bar", rows),
    ]


# The two adjustments, and the choice of pairs ------------------------------------------------------------------------


def two_routes() -> List[str]:
    """The adjustment against the RPCs, and COLMAP's of principal points: figures of both, and their DSMs."""
    rows = []
    for label in few(("town", "hills")):
        case = case_of(label)
        scene = case.scene()
        found = pointed(scene, model="shift")
        start = time.process_time()
        other = adjust_colmap(scene, found.tracks, Silent())
        colmap_s = time.process_time() - start
        start = time.process_time()
        adjust(case.views(), found.tracks, sum(scene.altitudes) / 2, "shift")
        rpc_s = time.process_time() - start
        apart = max(float(np.abs(other.shifts[n] - found.adjusted.shifts[n]).max()) for n in other.shifts)
        with tempfile.TemporaryDirectory() as folder:
            error = difference(
                route_dsm(case.images, f"{folder}/rpc", "rpc"), route_dsm(case.images, f"{folder}/colmap", "colmap")
            )
        left = (f"{case.observable_px(a.pointing).max():.3f}" for a in (found.adjusted, other))
        medians = (float(np.nanmedian(error)), float(np.nanmedian(np.abs(error))))
        rows.append([label, *left, apart, *medians, rpc_s, colmap_s])
    headers = (
        "scene | left where observable, RPC route, px | COLMAP route, px | largest difference of shifts, px | "
        "DSM difference, median, m | median of absolute, m | RPC route, CPU s | COLMAP route, CPU s"
    )
    return [
        Details(
            "**Both routes**: against the original RPCs (the default), and the paper's: COLMAP's bundle adjustment of "
            "principal points only. Bar: their DSMs differ by less than 0.05 m (median)."
        ),
        Details(table(headers, rows)),
    ]


def route_dsm(images: Sequence[str], folder: str, route: str) -> str:
    scene = stage(EPMFIT, images=list(images), workspace=folder).scene
    options = {"pointing": "shift", "adjustment": route}
    scene = stage(RECONSTRUCT, scene=scene, output_scene=f"{folder}/r.json", **options).output_scene
    return stage(DSMFUSE, scene=scene, output=f"{folder}/dsm.tif", resolution=0.5).output


def scene_of_rpcs(files: Sequence[Path]) -> SceneFile:
    """A scene of full images that are not there: RPCs, times from the files' names, one tile over what all overlap."""
    views = []
    for path in files:
        rpc = read_rpc_file(str(path))
        taken = moment(time_of_name(path.name.partition("__")[2] or path.name))
        size = round(2 * rpc.col_off), round(2 * rpc.row_off)
        views.append(View(path.stem[-8:], "", 1, *size, rpc, 0.7, acquired=taken.isoformat() if taken else ""))
    lon, lat = (float(np.median([getattr(view.rpc, name) for view in views])) for name in ("lon_off", "lat_off"))
    crs, middle = utm_crs(lon, lat), float(np.median([view.rpc.height_off for view in views]))
    area = seen_twice([[projected_from_geodetic(crs, footprint(v.localise, v.size, middle)) for v in views]])
    seen: Dict[str, Any] = {view.name: None for view in views}  # no camera is asked for
    tile = Tile("r000c000", bounds_of(area), (middle - 50, middle + 50), seen)
    return SceneFile(tuple(views), EnuFrame(lon, lat), crs, area.ExportToWkt(), tile.altitudes, (tile,))


def pair_selection() -> List[str]:
    """Which of the 136 pairs of 17 views are matched."""
    folder = SHARED / "rpc" / "pleiades"
    files = sorted(folder.glob("melbourne__*.XML"))
    if not files:
        return [Details(f"Pair selection: not measured, '{folder}' is absent.")]
    scene = scene_of_rpcs(files[:6] if is_quick() else files)
    start = time.process_time()
    pairs = choose_pairs(scene)
    seconds = time.process_time() - start
    lon, lat, height = scene.frame.lon, scene.frame.lat, sum(scene.altitudes) / 2
    every = [convergence(a, b, lon, lat, height) for a, b in combinations(scene.views, 2)]
    good, angles = PLANNING.pairs, [angle for angle, _ in every]
    narrow, wide = (sum(ratio < good.narrow for _, ratio in every), sum(ratio > good.wide for _, ratio in every))
    slanting = max(ratio for angle, ratio in every if angle < 8)
    count = [sum(view.name in (pair.first, pair.second) for pair in pairs) for view in scene.views]
    rows = [
        [
            *(pair.first, pair.second, pair.angle_deg, pair.base_to_height, 100.0 * pair.share),
            *(duration_text(pair.days), pair.sun_deg, pair_cost(pair)),
        ]
        for pair in pairs
    ]
    headers = (
        "first | second | convergence, degrees | B/H | of the area, % | taken apart | between the suns, degrees | score"
    )
    return [
        Details(
            f"**6. Pair selection**: the RPCs of {len(files)} full Pleiades scenes of Melbourne, one pass (times from "
            f"the files' names). Of {len(every)} pairs ({min(angles):.1f} to {max(angles):.1f} degrees; {narrow} too "
            f"narrow, {wide} too wide) {len(pairs)} are matched, {min(count)} to {max(count)} a view, in {seconds:.2f} "
            "CPU s. Score: what is against a pair ([method](../method.md#pairs)). Oblique looks less than 8 degrees "
            f"apart have B/H up to {slanting:.2f}: hence the score by the angle."
        ),
        Details(table(headers, rows)),
    ]


PARTS = {
    "urban": truth_urban,
    "known": known_errors,
    "triplet": triplet,
    "poor": poor_scenes,
    "cost": costs,
    "routes": two_routes,
    "pairs": pair_selection,
}
SECTIONS = [Section("pointing", "Where the images really look", "make bench-pointing", PARTS)]
