"""Blocks of small frames with an RPC each, and pairs of two sensors."""

from __future__ import annotations

import resource
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.pointing_case import fitted
from benchmarks.runner import alone, few, is_quick, pipeline
from benchmarks.scenes import CACHE, made_once, simulation
from benchmarks.scoring import scores, shares
from benchmarks.simulated.frames import Exposure, exposed, frames_of, make_frames
from benchmarks.tables import Section, table
from repm_qgis.planning.pair_selection import choose_pairs
from repm_qgis.pointing.pointing import point_views
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.parameters import SIMULATION
from repm_qgis.simulation.scene import SceneSpec
from repm_qgis.simulation.sensor import PLEIADES, Look, PushbroomView

_PASSES = (Look(20.0, 0.8), Look(0.0, 0.8, 2.0), Look(-20.0, 0.8))
_SIDES = (("ahead", 10.0), ("behind", -10.0))


def _block_spec() -> SceneSpec:
    return replace(SceneSpec.default("mountains", 1300, 5), cell_m=0.8, surface_step=1, relief_m=250.0)


def _frames() -> List[Exposure]:
    return frames_of(_PASSES, (1300, 600), (1, 2) if is_quick() else (2, 7))


def _block_folder() -> Path:
    folder = CACHE / f"frames_{len(_frames())}"
    # One ray a pixel: a quarter of the time, and enough for tie points.
    quick = replace(SIMULATION, render=replace(SIMULATION.render, oversample=1))

    def make() -> None:
        make_frames(_block_spec(), _frames(), str(folder), Silent(), quick)

    return made_once(folder, make)


def adjusted(images: Sequence[str], workspace: str) -> Dict[str, object]:
    """The cameras, pairs, ties and pointing of a block, in this process; and the CPU seconds until the cameras are
    fitted."""
    shutil.rmtree(workspace, ignore_errors=True)
    scene = fitted(images, Path(workspace))
    used = resource.getrusage(resource.RUSAGE_SELF)
    pairs = choose_pairs(scene)
    stretches = {view.name: view.stretch() for view in scene.views}
    found = point_views(scene, pairs, stretches, model="auto", gcps=(), progress=Silent(), workers=1)
    figures = found.figures
    return {
        "fit_s": used.ru_utime + used.ru_stime,
        "pairs": len(pairs),
        "ties": figures.count,
        "before_px": figures.before_px,
        "after_px": figures.after_px,
        "model": figures.model,
        "pointing": {view.name: view.pointing.tolist() for view in found.views},
    }


def _left_px(images: Sequence[str], pointing: Mapping[str, ArrayLike], true: Sequence[PushbroomView]) -> float:
    """What the corrections leave of the frames' errors, px (RMS), apart from a move of the whole block."""
    from repm_qgis.scene import load_views

    spec = _block_spec()
    height, off, moves = sum(spec.height_bounds) / 2, [], []
    for view, real in zip(load_views(tuple(images)), true):
        view = view.with_pointing(np.array(pointing[view.name]))
        pixels = np.stack(np.meshgrid(*(np.linspace(50, side - 50, 5) for side in view.size)), axis=-1).reshape(-1, 2)
        ground = real.localise(pixels, height)
        off.append((view.project(ground) - pixels).mean(axis=0))
        middle = ground[len(ground) // 2]
        steps = [view.project(middle + step) - view.project(middle) for step in np.diag([1e-5, 1e-5, 1.0])]
        moves.append(np.array(steps).T)
    residual, design = np.concatenate(off), np.concatenate(moves)
    rest = residual - design @ np.linalg.lstsq(design, residual, rcond=None)[0]
    return float(np.sqrt(np.mean(rest**2)))


def block() -> List[str]:
    folder = _block_folder()
    images = sorted(map(str, folder.glob("pass_*.tif")))
    run = alone(adjusted, images, str(folder / "w"))
    found, true = run.result, exposed(_block_spec(), _frames())
    raw = {Path(path).stem: np.eye(2, 3) for path in images}
    left = [_left_px(images, pointing, true) for pointing in (raw, found["pointing"])]
    row = [len(images), found["pairs"], found["ties"], f"{found['before_px']:.2f} / {found['after_px']:.3f}"]
    row += [f"{left[0]:.2f} / {left[1]:.3f}", f"{found['fit_s']:.0f}", f"{run.cpu_s:.0f}", f"{run.mib:.0f}"]
    return [
        f"**Block**: {len(images)} simulated frames of 1300 x 600 px of 0.8 m, as SkySat's, in three passes (20 "
        "degrees ahead, nadir, 20 degrees behind) over mountains of 250 m of relief; neighbours share 15 and 25 %, and "
        "each RPC has a pointing error of its own. 'Left' is the error of the pointing that no move of the whole block "
        "explains. CPU seconds of one process: until all cameras are fitted, and until the block is adjusted. The bar "
        "is 60 s. Before (revision fdec819) the adjustment ended with numpy's error 'Singular matrix'.",
        table(
            "frames | pairs | tie points | residual before / after, px | left before / after, px | cameras, CPU s | "
            "all, CPU s | MiB",
            [row],
        ),
    ]


def _mixed_images() -> Path:
    fine = 0.5
    side = 400 if is_quick() else 1000
    spec = SceneSpec.default("urban", int(side / fine), 5)
    exposures = [
        Exposure(
            f"{name}_{where}", replace(PLEIADES, name=name), Look(pitch, gsd, 1.0), (round(side / gsd),) * 2, flight=k
        )
        for k, (name, gsd) in enumerate((("fine", fine), ("coarse", 1.5)))
        for where, pitch in _SIDES
    ]
    folder = CACHE / f"mixed_{side}"
    return made_once(folder, lambda: make_frames(spec, exposures, str(folder), Silent(), simulation()))


def mixed() -> List[str]:
    folder, rows = _mixed_images(), []
    for label, names in few(
        (
            ("both coarse", ("coarse_ahead", "coarse_behind")),
            ("fine and coarse", ("fine_ahead", "coarse_behind")),
            ("coarse and fine", ("coarse_ahead", "fine_behind")),
        )
    ):
        work = folder / "w" / names[0] / names[1]
        work.mkdir(parents=True, exist_ok=True)
        made = pipeline([str(folder / f"{name}.tif") for name in names], work, workers=1)
        found = scores(made.output, str(folder / "truth.tif"), True)
        rows.append([label, found.rmse, found.nmad, found.medae, *(f"{share:.1f}" for share in shares(found))])
    return [
        "**Two sensors**: a simulated town seen by images of 0.5 m and of 1.5 m, 10 degrees ahead and behind; DSMs of "
        "two images each, in the cells that are chosen for them (3 m), against the true surface of 0.5 m.",
        table("pair | RMSE, m | NMAD, m | MEDAE, m | within 1 m, % | 2.5 m | 5 m", rows),
    ]


SECTIONS = (Section("frames", "Small frames and mixed sensors", "make bench-frames", {"block": block, "mixed": mixed}),)
