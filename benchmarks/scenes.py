"""The scenes that benchmarks share: simulated once and kept in a folder, or real images beside the project.

REPM_BENCH_CACHE names the folder of simulated scenes (default: repm_bench in the temporary folder), REPM_SHARED_DATA
that of real images (default: ../shared/data beside the checkout). Parts that need absent data say so.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence

from osgeo import gdal

from benchmarks.runner import ROOT, is_quick, say, there
from benchmarks.scoring import bounds_of
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.parameters import SIMULATION, SimulationParameters
from repm_qgis.simulation.scene import SceneSpec, make_scene
from repm_qgis.simulation.sensor import ZY3

SHARED = Path(os.environ.get("REPM_SHARED_DATA", ROOT.parent / "shared" / "data"))
CACHE = Path(os.environ.get("REPM_BENCH_CACHE", Path(tempfile.gettempdir()) / "repm_bench"))
_QUICK_PX = {"PLEIADES": 400, "NEO": 700, "ZY3": 900}  # less has too few tie points


@dataclass(frozen=True)
class Scene:
    """Images, and the surface that their DSM is compared with."""

    name: str
    images: Sequence[str]
    reference: str
    resolution: float
    align: bool  # compare after the best whole-cell shift, which pointing without ground control leaves
    spec: Optional[SceneSpec] = None  # of a simulated scene

    @property
    def made(self) -> SceneSpec:
        """What it was simulated from; raises Failed where it is real."""
        return there(self.spec, f"the simulation of {self.name}")

    @property
    def folder(self) -> Path:
        return Path(self.reference).parent


def made_once(folder: Path, make: Callable[[], object]) -> Path:
    """A folder that ``make`` fills unless an earlier run has filled it."""
    if not (folder / "done").exists():
        say(f"making {folder.name} ...")
        folder.mkdir(parents=True, exist_ok=True)
        make()
        (folder / "done").write_text("")
    return folder


def quick_size(px: int, sensor: str = "PLEIADES") -> int:
    return min(px, _QUICK_PX[sensor]) if is_quick() else px


def simulation() -> SimulationParameters:
    """Those of the engine; quick images have one ray for each pixel, which takes half of the time."""
    one_ray = replace(SIMULATION, render=replace(SIMULATION.render, oversample=1))
    return one_ray if is_quick() else SIMULATION


def simulated(name: str, spec: SceneSpec, resolution: float = 0.5) -> Scene:
    """A truth scene, in the cache under a name and its size."""
    spec = replace(spec, size=quick_size(spec.size, spec.sensor.name))
    folder = CACHE / f"{name}_{spec.size}{'_quick' * is_quick()}"
    made_once(folder, lambda: make_scene(spec, str(folder), Silent(), simulation()))
    images = [str(folder / f"img_{i:02d}.tif") for i in range(1, len(spec.sensor.looks) + 1)]
    return Scene(folder.name, images, str(folder / "truth.tif"), resolution, True, spec)


def default(kind: str, size: int, seed: int, resolution: float = 0.5) -> Scene:
    """A town or mountains with the simulation's defaults."""
    return simulated(f"{kind}_{seed}", SceneSpec.default(kind, size, seed), resolution)


def zy3(size: int, relief_m: float) -> SceneSpec:
    """A tri-stereo of a three-line camera at 2.1 to 2.5 m over mountains."""
    return SceneSpec("mountains", size, 11, ZY3, 5.0, 2, base_m=300.0, relief_m=relief_m, lon=6.65, lat=44.38)


def zy3_fine(size: int) -> SceneSpec:
    """The same with a true surface in cells of 2.5 m."""
    return replace(zy3(size, 700.0), cell_m=2.5, surface_step=1)


_REAL = {
    "truth_urban": (2, "truth.tif", True),
    "pleiades_pair": (2, "s2p_dsm.tif", False),
    "pleiades_triplet": (3, "s2p_dsm.tif", False),
}


def real(*names: str) -> List[Scene]:
    """The real scenes of these names (all without names) that are there; S2P's DSM is a reference, but no truth."""
    found = []
    for name in names or _REAL:
        count, reference, align = _REAL[name]
        images = [str(SHARED / name / f"img_{i:02d}.tif") for i in range(1, count + 1)]
        if all(os.path.exists(path) for path in (*map(Path, images), SHARED / name / reference)):
            found.append(Scene(name, images, str(SHARED / name / reference), 0.5, align))
    return found


def real_or_town(*names: str) -> List[Scene]:
    """The real scenes of these names that are there; where none is, a simulated town that says so in its name."""
    town = default("urban", 800, 1) if not real(*names) else None
    return [replace(town, name="simulated town (real images are absent)")] if town else real(*names)


def whu_tlc() -> List[Scene]:
    """The real three-line images of WHU-TLC's four neighbouring blocks that are there, with their DSMs of lidar."""
    folder, found = SHARED / "whu_tlc", []
    for block in ("0066", "0067", "0072", "0073"):
        images = [str(folder / f"block{block}_view{number}.tif") for number in range(3)]
        reference = str(folder / f"truth_{block}.tif")
        if all(os.path.exists(path) for path in (*images, reference)):
            found.append(Scene(f"whu_tlc {block}", images, reference, 5.0, True))
    return found


def middle_of(reference: str) -> Dict[str, object]:
    """Options of the pipeline: the middle quarter of a raster's area."""
    dataset = gdal.Open(reference)
    west, south, east, north = bounds_of(dataset)
    x, y = (east - west) / 4, (north - south) / 4
    return {"extent": [west + x, south + y, east - x, north - y], "extent_crs": dataset.GetProjection()}


def not_measured(name: str) -> str:
    """The sentence that stands for a part whose folder of data is not there."""
    return f"{name} was not measured: absent from '{SHARED}'."


def absent(*names: str) -> List[str]:
    """A sentence about real scenes that are not there."""
    missing = [name for name in names or _REAL if not real(name)]
    return [f"Not measured, absent from '{SHARED}': {', '.join(missing)}."] if missing else []
