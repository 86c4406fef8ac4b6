"""What each step between gridding and the DSM gives, on real and simulated scenes of all kinds.

A scene is reconstructed once for each draw of the pointing (``chance`` of towns.py) and then fused many times: with
all steps, without one of them, and with one alone. Further parts compare DSMs of real three-line images with lidar,
also those of earlier revisions' engines, and DSMs of several images with those of their pairs.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Callable, Dict, FrozenSet, List, Mapping, Sequence, Tuple

import numpy as np

from benchmarks import towns
from benchmarks.runner import ROOT, earlier, few, pipeline, say, stage
from benchmarks.scenes import SHARED, Scene, absent, default, not_measured, real, simulated, whu_tlc, zy3_fine
from benchmarks.tables import Details, Section, table
from benchmarks.views import where_both
from repm_qgis.contracts.stages import DSMFUSE
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene as SceneFile
from repm_qgis.stages.parameters import ENGINE, EngineParameters

DRAWS = 2  # of the pointing, for each scene; 8 at most
BEFORE = ("d774150", "913e92d")  # earlier revisions, for the part `whu`


# The steps ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Step:
    """A step, and what switches it off: numbers of the groups of ENGINE.fusion. Where it is alone, the steps
    ``together`` with it are on as well, because it does nothing without them."""

    numbers: Mapping[str, Mapping[str, float]]
    together: Tuple[str, ...] = ()


_CHOICE, _CHOSEN_BY = "choice as a whole", ("neighbours", "appearance", "ground in shadows")
STEPS: Dict[str, Step] = {
    "neighbours": Step({"choice": {"smoothness": 0.0}}, (_CHOICE,)),
    "appearance": Step({"choice": {"appearance": 0.0}}, (_CHOICE,)),
    "ground in shadows": Step({"shaded": {"least_elevation_deg": 90.0}}, (_CHOICE,)),  # no sun is high enough
    "doubt": Step({"evidence": {"doubtful": 1.0}}),
    _CHOICE: Step({"walls": {"least_tail": 1e9}}, _CHOSEN_BY),
}
_ALL, _NONE = "all steps", "none of them"


def variants() -> Dict[str, FrozenSet[str]]:
    """What is compared, and the steps that are off there."""
    every, some = frozenset(STEPS), few(list(STEPS))
    found: Dict[str, FrozenSet[str]] = {_ALL: frozenset()}
    found.update({f"without {name}": frozenset([name]) for name in some})
    found.update({f"{name} alone": every - {name, *STEPS[name].together} for name in some})
    return {**found, _NONE: every}


def without(steps: FrozenSet[str]) -> EngineParameters:
    """The engine's parameters with some steps off."""
    fusion = ENGINE.fusion
    for name in steps:
        for group, numbers in STEPS[name].numbers.items():
            fusion = replace(fusion, **{group: replace(getattr(fusion, group), **numbers)})
    return replace(ENGINE, fusion=fusion)


# The scenes ---------------------------------------------------------------------------------------------------------


def west() -> Dict[str, List[str]]:
    """Sets of images of the real town, by the images' numbers; none where they are absent."""
    if not towns._FOLDER.exists():
        return {}
    names = towns._names()
    counts = {str(count): names[:count] for count in (2, 6, 19)}
    chosen = ("006 007", "009 010", "003 022", "005 006 007", "013 014 015")
    more = ("013 014 015 016 018 019", "005 007 009 012 014 020")
    return {**counts, "3, January": list(towns._JANUARY), **{numbers: numbers.split() for numbers in (*chosen, *more)}}


def _west(label: str, names: Sequence[str]) -> Scene:
    return Scene(f"jax_068, {label}", towns.images_of(names), towns._LIDAR.heights, 0.5, True)


def _district(label: str) -> Scene:
    folder = towns._simulated_scene("all effects", 12, {})
    images = [str(folder / f"img_{number + 1:02d}.tif") for number in towns._SIMULATED_SETS[label]]
    return Scene(f"district, {label}", images, str(folder / "truth.tif"), 0.5, True)


def _itself(scene: Scene) -> Scene:
    return scene


def cases() -> List[Tuple[str, Callable[[], Scene]]]:
    """All scenes by their kind; simulated ones are made when they are called for."""
    found: List[Tuple[str, Callable[[], Scene]]] = [("real town", partial(_west, *part)) for part in west().items()]
    found += [("simulated towns", lambda: default("urban", 800, 4))]
    found += [("simulated towns", partial(_district, label)) for label in ("2", "3, January", "6")]
    found += [("mountains", lambda: default("mountains", 400, 7, 1.0))]
    found += [("mountains", lambda: default("mountains", 800, 3, 1.0))]
    found += [("mountains", lambda: simulated("zy3_fine", zy3_fine(1000), 2.5))]
    found += [("Pléiades", partial(_itself, scene)) for scene in real("pleiades_pair", "pleiades_triplet")]
    return found + [("WHU-TLC", partial(_itself, scene)) for scene in whu_tlc()]


def _missing() -> List[str]:
    folders = [name for name in ("jax_068", "whu_tlc") if not (SHARED / name).exists()]
    sentences = [f"Not measured, absent from '{SHARED}': {', '.join(folders)}."] if folders else []
    return [*sentences, *absent("pleiades_pair", "pleiades_triplet")]


def _drawn(contrast: float) -> EngineParameters:
    """The engine with keypoints of another contrast, and so with a pointing that is a little different."""
    keypoints = replace(ENGINE.pointing.ties.keypoints, contrast=contrast)
    ties = replace(ENGINE.pointing.ties, keypoints=keypoints)
    return replace(ENGINE, pointing=replace(ENGINE.pointing, ties=ties))


# Each step ----------------------------------------------------------------------------------------------------------


def _fused(scene: Scene, made: str, off: FrozenSet[str], folder: str) -> List[float]:
    """C1 (%), MAE and RMSE (m) of a reconstructed scene's DSM without some steps, and the CPU seconds of fusing."""
    start = time.process_time()
    own = {"scene": made, "output": f"{folder}/dsm.tif", "resolution": scene.resolution, "workers": 1}
    dsm = stage(DSMFUSE, Silent(), without(off), **own).output
    cost = time.process_time() - start
    m = score_files(dsm, scene.reference, "3d").metrics
    return [dict(m.completeness)[1.0], m.mae, m.rmse, cost]


def _measured(scene: Scene) -> np.ndarray:
    """(draws, variants, 4) the figures of :func:`_fused`."""
    found = []
    for contrast in few(towns._CONTRASTS[:DRAWS]):
        say(f"{scene.name}, contrast {contrast} ...")
        with tempfile.TemporaryDirectory() as folder:
            made = pipeline(scene.images, folder, Silent(), _drawn(contrast), resolution=scene.resolution).scene
            found.append([_fused(scene, made, off, folder) for off in variants().values()])
    return np.array(found)


def _spread(values: np.ndarray) -> str:
    return f"{values.mean():.4g} ± {values.std():.2g}"


def steps() -> List[str]:
    rows: List[List[object]] = []
    differences: Dict[str, List[np.ndarray]] = {}
    for kind, make in few(cases()):
        scene = make()
        figures = _measured(scene)
        differences.setdefault(kind, []).append((figures - figures[:, :1]).mean(axis=0))
        for number, name in enumerate(variants()):
            of_draws = figures[:, number].T
            rows.append([scene.name, name, *map(_spread, of_draws[:3]), float(of_draws[3].mean())])
    means = {kind: np.mean(parts, axis=0) for kind, parts in differences.items()}
    short = [
        [name, *(f"{value:+.2f}" for mean in means.values() for value in mean[number, [0, 2]])]
        for number, name in enumerate(variants())
    ]
    heads = ["steps", *(f"{kind}, {figure}" for kind in means for figure in ("C1, points", "RMSE, m"))]
    return [
        f"What changes with each step between gridding and the DSM, against *{_ALL}*, in the mean over the scenes of a "
        "kind and over the draws of the pointing: without the step, and with the step alone. *Neighbours*, "
        "*appearance* and *ground in shadows* are parts of the *choice*, and do nothing without it; alone, it has all "
        "three. *Doubt*: less evidence beside steps and holes. All DSMs are aligned in 3-D. The reference of Pléiades "
        "is S2P's DSM, which is no truth.",
        table(heads, short),
        Details(
            f"Each scene, mean ± standard deviation over {len(few(towns._CONTRASTS[:DRAWS]))} draws of the pointing. "
            "*jax_068*: the first images by date, or those of these numbers, against lidar in cells of 0.5 m."
        ),
        Details(table("scene | steps | C1, % | MAE, m | RMSE, m | fusion, CPU s", rows)),
        *_missing(),
    ]


# Three-line images --------------------------------------------------------------------------------------------------


def _compared(scene: Scene, tree: Path) -> List[float]:
    with tempfile.TemporaryDirectory() as folder:
        dsm, cost = towns._made(scene.images, folder, tree, resolution=scene.resolution)
        m = score_files(dsm, scene.reference, "3d").metrics
        share = dict(m.completeness)
        return [m.mae, m.rmse, share[2.5], share[5.0], m.valid, cost]


def whu() -> List[str]:
    scenes = few(whu_tlc())
    if not scenes:
        return [not_measured("whu_tlc")]
    rows: List[List[object]] = []
    with tempfile.TemporaryDirectory() as place:
        trees = [("now", ROOT)]
        for revision in few(BEFORE):
            folder = Path(place, revision)
            folder.mkdir()
            tree = earlier(revision, folder)
            trees += [(revision, tree)] if tree else []
        for engine, tree in trees:
            say(f"whu_tlc, {engine} ...")
            figures = [_compared(scene, tree) for scene in scenes]
            rows += [[scene.name, engine, *found] for scene, found in zip(scenes, figures)]
            rows.append(["**mean**", engine, *map(float, np.mean(figures, axis=0))])
    rows.sort(key=lambda row: row[0] == "**mean**")
    return [
        "Real three-line images (ZY-3, 2.1 to 2.5 m, 8 bit, three views of each block) against a DSM of lidar and "
        "photogrammetry, in cells of 5 m, default settings, aligned in 3-D. C2.5 and C5: shares of all cells of the "
        "reference within 2.5 and 5 m. Published for all 46 sets of the test (MAE, RMSE in m, C2.5, C5 in %): the "
        "paper's REPM 1.67, 3.15, 75.8, 97.3; S2P 1.69, 8.71, 66.7, 94.7.",
        table("block | engine | MAE, m | RMSE, m | C2.5, % | C5, % | valid, % | CPU s", rows),
    ]


# More images --------------------------------------------------------------------------------------------------------


def _error(made: SceneFile, pairs: Sequence[Tuple[str, str]], scene: Scene, folder: str) -> np.ndarray:
    """The errors (m) of the DSM of some pairs of a reconstructed scene."""
    part = made.with_tiles(lambda tile: replace(tile, heights=tuple(r for r in tile.heights if r.pair in pairs)))
    path = part.save(f"{folder}/chosen.json")
    dsm = stage(DSMFUSE, scene=path, output=f"{folder}/part.tif", resolution=scene.resolution).output
    return score_files(dsm, scene.reference, "3d").error


def _both(whole: np.ndarray, part: np.ndarray) -> List[float]:
    """C1 (%) and RMSE (m) of one DSM, then of another one, in the cells that both have."""
    found = []
    for own, other in ((whole, part), (part, whole)):
        within = np.abs(own[np.isfinite(own) & np.isfinite(other)]) < 1.0
        found += [100.0 * float(within.mean()), where_both(own, other)]
    return found


def more() -> List[str]:
    sets = few(sorted((part for part in west().items() if len(part[1]) > 2), key=lambda part: len(part[1])))
    if not sets:
        return [not_measured("jax_068")]
    short, rows = [], []
    for label, names in sets:
        say(f"more, {label} ...")
        scene = _west(label, names)
        with tempfile.TemporaryDirectory() as folder:
            made = SceneFile.load(pipeline(scene.images, folder, resolution=scene.resolution).scene)
            pairs = sorted({record.pair for tile in made.tiles for record in tile.heights})
            whole = _error(made, pairs, scene, folder)
            pairs = few(pairs)
            found = [_both(whole, _error(made, [pair], scene, folder)) for pair in pairs]
        gains = np.array([[c1 - own_c1, own_rmse - rmse] for c1, rmse, own_c1, own_rmse in found])
        counts = [f"{int((column > 0).sum())} of {len(pairs)}" for column in gains.T]
        worst = [float(column.min()) for column in gains.T]
        short.append([label, counts[0], f"{worst[0]:+.2f}", counts[1], f"{worst[1]:+.3f}"])
        rows += [[label, _numbers(pair), *figures] for pair, figures in zip(pairs, found)]
    return [
        "What more images give, on the real town: the DSM of a set against that of each of its matched pairs alone, "
        "with the pointing of all, in the cells that both have. *Better*: pairs than which the set is better; *least "
        "gain*: against the best pair, in points of C1 and in m of RMSE. A negative one is a loss.",
        table("images | better in C1 | least gain | better in RMSE | least gain", short),
        Details("Each set and each of its pairs, in the cells that both have."),
        Details(table("images | pair | C1, % | RMSE, m | of the pair: C1, % | RMSE, m", rows)),
    ]


def _numbers(pair: Tuple[str, str]) -> str:
    """The images' numbers, of names such as JAX_068_009_RGB."""
    return " and ".join(name.split("_")[2] for name in pair)


SECTIONS = [
    Section(
        "ablation",
        "What each step of the fusion gives",
        "make bench-ablation",
        {"steps": steps, "whu": whu, "more": more},
    )
]
