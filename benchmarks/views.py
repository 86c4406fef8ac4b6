"""What a third view is worth (``make bench-views``): three views against each of their pairs, on simulated scenes.

Default options. Each DSM is laid on the true surface by a shift in three dimensions first, as pointing without ground
control leaves one.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, List, Tuple

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.imagery.raster import opened, read  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.scene import Scene  # noqa: E402
from repm_qgis.simulation.scene import SceneSpec, make_scene  # noqa: E402
from repm_qgis.simulation.sensor import PLEIADES, ZY3  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402

SCENES: Dict[str, SceneSpec] = {
    "town, 800 px of 0.5 m": SceneSpec.default("urban", 800, 1),
    "town, 1000 px of 0.5 m": SceneSpec.default("urban", 1000, 7),
    "town, 700 px of 0.8 m": dataclasses.replace(
        SceneSpec.default("urban", 700, 5), sensor=PLEIADES.at_gsd(0.8), cell_m=0.8
    ),
    "mountains, 800 px of 1 m": SceneSpec.default("mountains", 800, 3),
    "mountains, 1000 px of 1 m": SceneSpec.default("mountains", 1000, 9),
    "ZY-3, 1000 px of 2.5 m": SceneSpec(
        "mountains", 1000, 11, ZY3, cell_m=2.5, surface_step=1, base_m=300.0, relief_m=700.0, lon=6.65, lat=44.38
    ),
}


def scored(scene_path: str, pairs: List[Tuple[str, ...]], truth: str, folder: str) -> Dict[str, Any]:
    """Fuse some pairs' height maps of a scene, and compare."""
    scene = Scene.load(scene_path)
    scene = scene.with_tiles(lambda tile: replace(tile, heights=tuple(r for r in tile.heights if r.pair in pairs)))
    path = scene.save(f"{folder}/chosen.json")
    run_stage("dsmfuse", {"scene": path, "output": f"{folder}/dsm.tif"}, Silent())
    error = f"{folder}/error.tif"
    found = run_stage(
        "comparedsm", {"dsm": f"{folder}/dsm.tif", "reference": truth, "align": "3d", "error": error}, Silent()
    )
    with opened(error) as dataset:
        return {**found, "errors": read(dataset)}


def where_both(whole: np.ndarray, part: np.ndarray) -> float:
    """RMSE of one DSM's errors on the cells that another has, too."""
    errors = whole[np.isfinite(whole) & np.isfinite(part)].astype(np.float64)
    return float(np.sqrt((errors**2).mean()))


def rows_of(name: str, spec: SceneSpec, folder: str) -> List[List[Any]]:
    """A scene's rows: each pair, then all views."""
    made = make_scene(spec, folder, Silent())
    run = run_stage(
        "pipeline", {"images": made["images"], "workspace": f"{folder}/w", "output": f"{folder}/dsm.tif"}, Silent()
    )
    pairs = sorted({record.pair for tile in Scene.load(run["scene"]).tiles for record in tile.heights})
    rows = []
    whole = scored(run["scene"], pairs, made["truth"], folder + "/w")
    for label, chosen in [*((" and ".join(pair), [pair]) for pair in pairs), ("**all three**", pairs)]:
        found = scored(run["scene"], chosen, made["truth"], folder + "/w") if len(chosen) == 1 else whole
        share = found["completeness_by_threshold"]
        rows.append(
            [
                name,
                label,
                found["valid"],
                found["nmad"],
                found["mae"],
                found["rmse"],
                where_both(whole["errors"], found["errors"]),
                share["1"],
                share["2.5"],
            ]
        )
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    rows: List[List[Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, spec) in enumerate(SCENES.items()):
            rows += rows_of(name, spec, f"{folder}/{number}")
    publish(
        "views",
        "What a third view is worth",
        "make bench-views",
        [
            "Default options, all with the pointing of the three views, after the best shift in three dimensions. Bar: "
            "three views are better than the best pair in C1 and RMSE, on every scene.",
            table(
                ["scene", "views", "valid %", "NMAD m", "MAE m", "RMSE m", "all three there, RMSE m", "C1 %", "C2.5 %"],
                rows,
            ),
        ],
    )


if __name__ == "__main__":
    main()
