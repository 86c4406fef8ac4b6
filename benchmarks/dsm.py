"""DSMs of truth scenes and real images through qgis_process, ours and, where they are on PATH, S2P's and CARS's.

'make bench'. Simulated scenes are made once and kept in the folder that REPM_BENCH_CACHE names (default: repm_bench
in the temporary folder); real images lie in the folder that REPM_SHARED_DATA names, and are left out without it.
"""

from __future__ import annotations

import os
import sys
import tempfile
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Callable, List, Optional, Sequence

from osgeo import gdal

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.runner import PEERS, SHARED, Failed, peer, repm, say, scores  # noqa: E402
from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.simulation.scene import SceneSpec, make_scene  # noqa: E402
from repm_qgis.simulation.sensor import ZY3  # noqa: E402

CACHE = Path(os.environ.get("REPM_BENCH_CACHE", Path(tempfile.gettempdir()) / "repm_bench"))
COLUMNS = ("valid", "RMSE", "ME", "MAE", "NMAD", "C1", "C2.5", "C5")


@dataclass(frozen=True)
class Scene:
    """Images with the surface that they are measured against; ``make`` simulates them where they are not there."""

    name: str
    images: Sequence[str]
    reference: str
    resolution: float
    align: bool
    make: Optional[Callable[[], None]] = None

    def there(self) -> bool:
        return all(os.path.exists(path) for path in (*self.images, self.reference))


def simulated(name: str, spec: SceneSpec, resolution: float) -> Scene:
    """A truth scene in the cache."""
    folder = CACHE / name

    def make() -> None:
        if not (folder / "done").exists():
            say(f"simulating {name} ...")
            make_scene(spec, str(folder), Silent())
            (folder / "done").write_text("")

    return Scene(
        name,
        [str(folder / f"img_{i:02d}.tif") for i in range(1, len(spec.sensor.looks) + 1)],
        str(folder / "truth.tif"),
        resolution,
        True,
        make,
    )


def zy3(size: int, relief_m: float) -> SceneSpec:
    """A three-line-array tri-stereo at 2.1 to 2.5 m over mountains."""
    return SceneSpec(
        "mountains", size, 11, ZY3, cell_m=5.0, surface_step=2, base_m=300.0, relief_m=relief_m, lon=6.65, lat=44.38
    )


def all_scenes() -> List[Scene]:
    def real(name: str, count: int, reference: str, align: bool) -> Scene:
        return Scene(
            name,
            [str(SHARED / name / f"img_{i:02d}.tif") for i in range(1, count + 1)],
            str(SHARED / name / reference),
            0.5,
            align,
        )

    return [
        real("truth_urban", 2, "truth.tif", True),
        real("pleiades_pair", 2, "s2p_dsm.tif", False),
        real("pleiades_triplet", 3, "s2p_dsm.tif", False),
        simulated("town_800", SceneSpec.default("urban", 800, 1), 0.5),
        simulated("mountains_1200", SceneSpec.default("mountains", 1200, 7), 1.0),
        simulated("zy3_1600", zy3(1600, 1000.0), 5.0),
    ]


def row(scene: Scene, program: str, images: Sequence[str], label: str) -> List[Any]:
    """A program's scores and cost on some of a scene's images, or why there are none."""
    say(f"{scene.name}: {label} ...")
    with tempfile.TemporaryDirectory() as work:
        try:
            if program == "ours":
                dsm, cost, _ = repm(images, scene.resolution, Path(work))
            else:
                dsm, cost = peer(program, images, scene.resolution, Path(work))
            found = scores(dsm, scene.reference, scene.align)
        except Failed as error:
            return [scene.name, label, str(error), *[""] * (len(COLUMNS) + 2)]
    return [
        scene.name,
        label,
        *(round(found[name], 3) for name in COLUMNS),
        round(cost.cpu_s, 1),
        round(cost.wall_s, 1),
        round(cost.peak_gib, 2),
    ]


def rows(scene: Scene) -> List[List[Any]]:
    """All programs on all views, and ours on each pair of a tri-stereo truth scene."""
    if scene.make is not None:
        scene.make()
    if not scene.there():
        return [
            [scene.name, "", f"not measured: '{Path(scene.reference).parent}' is absent", *[""] * (len(COLUMNS) + 2)]
        ]
    made = [row(scene, "ours", scene.images, f"ours, {len(scene.images)} views")]
    if len(scene.images) > 2 and scene.make is not None:
        for pair in combinations(range(len(scene.images)), 2):
            made.append(
                row(
                    scene,
                    "ours",
                    [scene.images[i] for i in pair],
                    "ours, views " + " and ".join(str(i + 1) for i in pair),
                )
            )
    return made + [row(scene, name, scene.images, name) for name in PEERS]


def main() -> int:
    gdal.UseExceptions()
    chosen = sys.argv[1:]
    found = [line for scene in all_scenes() if not chosen or scene.name in chosen for line in rows(scene)]
    text = table(
        [
            "scene",
            "program",
            "valid %",
            *(f"{name} m" for name in COLUMNS[1:5]),
            *(f"{name} %" for name in COLUMNS[5:]),
            "CPU s",
            "wall s",
            "peak GiB",
        ],
        found,
    )
    if chosen:
        print(text)
        return 0
    publish(
        "dsm",
        "DSMs, ours and others",
        "make bench",
        [
            "Whole commands with default options, the start of QGIS included, on "
            f"{len(os.sched_getaffinity(0))} cores that others used too (wall times are upper bounds); memory is the "
            "resident memory of the whole process tree. Simulated scenes and truth_urban are compared with the true ground "
            "after the best whole-cell shift and the median height difference are taken out (relative pointing leaves "
            "them); the Pleiades images with S2P's DSM as it is, which is no truth. valid and C1, C2.5, C5 are percent of "
            "all cells of the reference; ME is the median of absolute errors.",
            text,
        ],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
