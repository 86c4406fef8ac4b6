"""Programs that make a DSM of images: ours through QGIS, and others that may be on PATH."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any, Callable, Dict, Sequence, Tuple

from benchmarks.runner import CORES, ROOT, Cost, Failed, measured

QGIS = str(ROOT / "scripts" / "qgis-headless")


def repm(images: Sequence[str], resolution: float, folder: Path, **options: object) -> Tuple[str, Cost, Dict[str, Any]]:
    """Ours through ``scripts/qgis-headless``: the DSM, the cost, and the algorithm's other results."""
    folder.mkdir(parents=True, exist_ok=True)
    dsm = folder / "dsm.tif"
    values = {"RESOLUTION": resolution, "OUTPUT": dsm, "WORKSPACE": folder / "w", **options}
    words = [f"IMAGES={image}" for image in images] + [f"{name}={value}" for name, value in values.items()]
    text, cost = measured([QGIS, "--json", "run", "repm:pipeline", "--", *words])
    return str(dsm), cost, json.loads(text)["results"]


def peer(name: str, images: Sequence[str], resolution: float, folder: Path) -> Tuple[str, Cost]:
    """Another program's DSM of the same images; raises Failed where it is not on PATH or does not make one."""
    if shutil.which(name) is None:
        raise Failed("not on PATH")
    config, products = PEERS[name](images, resolution, folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "config.json"
    path.write_text(json.dumps(config))
    _, cost = measured([name, str(path)], str(folder))
    found = next((folder / product for product in products if (folder / product).exists()), None)
    if found is None:
        raise Failed(f"left no {products[0]}")
    return str(found), cost


Configured = Tuple[Dict[str, object], Sequence[str]]


def _s2p(images: Sequence[str], resolution: float, folder: Path) -> Configured:
    config = {
        "out_dir": str(folder / "out"),
        "images": [{"img": image} for image in images],
        "full_img": True,
        "dsm_resolution": resolution,
        "max_processes": CORES,
    }
    return config, ("out/dsm.tif",)


def _cars(images: Sequence[str], resolution: float, folder: Path) -> Configured:
    sensors = {
        f"view{i}": {"image": image, "geomodel": {"path": image, "model_type": "RPC"}} for i, image in enumerate(images)
    }
    names = list(sensors)
    config = {
        "input": {"sensors": sensors, "pairing": [[names[0], other] for other in names[1:]]},
        "output": {"directory": str(folder / "out"), "resolution": resolution},
    }
    return config, ("out/dsm/dsm.tif", "out/dsm.tif")


PEERS: Dict[str, Callable[[Sequence[str], float, Path], Configured]] = {"s2p": _s2p, "cars": _cars}
"""The configuration file that each program reads, and where it leaves its DSM."""
