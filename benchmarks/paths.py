#!/usr/bin/env python3
"""Whole runs from a path that is hard for Windows, with 1, 2 and 4 workers: ``benchmarks/paths.py``.

The path has umlauts, Japanese letters, spaces and ``&``, and all files in it have more than 260 characters. Prints a
table: whether the DSM's heights and its file are the same with every number of workers, and the NMAD to S2P's DSM.
With ``--keep FOLDER`` the DSMs are left there, and with ``--beside FOLDER`` they are compared with those that another
machine left. scripts/windows-trial runs it with Windows' Python:

    .venv/bin/python benchmarks/paths.py --keep FOLDER/linux
    scripts/windows-trial FOLDER --python benchmarks/paths.py --beside Z:/win/linux
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Tuple

from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path[:] = [str(ROOT), *(path for path in sys.path if path != str(ROOT / "benchmarks"))]

from benchmarks.scenes import SHARED, real  # noqa: E402
from benchmarks.scoring import difference, heights_of, nmad, scores  # noqa: E402
from repm_qgis.contracts.results import SampleDataResult  # noqa: E402

NAME, LONG = "Höhen & Straßen, 東京", 260
_EXTENDED = "\\\\?\\"  # Windows takes more than 260 characters only after these


@dataclass(frozen=True)
class Case:
    """One set of images, and how it is run."""

    name: str
    images: List[str]
    workers: Tuple[int, ...]
    options: Dict[str, object]
    reference: str = ""


def deep(folder: Path) -> str:
    """A folder below ``folder`` whose path alone is longer than 260 characters."""
    path = str(folder)
    while len(path) <= LONG:
        path = os.path.join(path, NAME)
    os.makedirs(plain(path))
    return path


def plain(path: str) -> str:
    """The path as Python's own calls take it on every system, however long it is."""
    return _EXTENDED + os.path.abspath(path) if os.name == "nt" else path


def engine(stage: str, job: Dict[str, object]) -> Dict[str, Any]:
    """The result of a stage, run as the plugin runs it."""
    done = subprocess.run(
        [sys.executable, "-m", "repm_qgis", stage, "-"],
        input=json.dumps(job).encode(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=ROOT,
        check=False,
    )
    last = json.loads((done.stdout.splitlines() or [b"{}"])[-1])
    if last.get("type") != "result":
        raise SystemExit(f"paths: {stage} failed: {last.get('text') or done.stderr.decode('utf-8', 'replace')}")
    return last["result"]


def taken(sources: List[str], place: str) -> List[str]:
    """Images, with what lies beside them under the same name, in another folder."""
    os.makedirs(plain(place))
    for source in map(Path, sources):
        for path in source.parent.glob(f"{source.stem}*"):
            shutil.copyfile(path, plain(os.path.join(place, path.name)))
    return [os.path.join(place, Path(source).name) for source in sources]


def cases(place: str) -> Iterator[Case]:
    for name, workers in (("pleiades_pair", (1, 2, 4)), ("pleiades_triplet", (2,))):
        for scene in real(name):
            images = taken(list(scene.images), os.path.join(place, name))
            yield Case(name, images, workers, {"resolution": scene.resolution}, scene.reference)
    made = engine("sampledata", {"folder": os.path.join(place, "demo"), "size": 400})
    images = list(SampleDataResult.from_mapping(made).images)
    yield Case("demo", images, (1, 2, 4), {"tile_size": 256})


def dsms(case: Case, place: str) -> Iterator[bytes]:
    """The file of the DSM with each number of workers, all made in one folder: its name is a part of their bytes."""
    made = os.path.join(place, "results")
    output = os.path.join(made, "dsm.tif")
    for workers in case.workers:
        os.makedirs(plain(made))
        job = {"images": case.images, "workspace": os.path.join(made, "w"), "output": output, "workers": workers}
        engine("pipeline", {**job, **case.options})
        yield Path(plain(output)).read_bytes()
        shutil.rmtree(plain(made))


def heights(file: bytes) -> str:
    """A hash of the grid and the heights of a DSM."""
    gdal.FileFromMemBuffer("/vsimem/dsm.tif", file)
    try:
        dataset = gdal.Open("/vsimem/dsm.tif")
        return hashlib.sha256(heights_of(dataset).tobytes() + repr(dataset.GetGeoTransform()).encode()).hexdigest()
    finally:
        gdal.Unlink("/vsimem/dsm.tif")


def row(case: Case, place: str, keep: Path, beside: Optional[Path]) -> str:
    files = list(dsms(case, place))
    kept = keep / f"{case.name}.tif"
    kept.write_bytes(files[0])
    several = len(files) > 1
    of_heights, of_files = (len(set(values)) == 1 for values in (map(heights, files), files))
    same = "the same to the last bit" if of_heights else "different"
    cells = [
        case.name,
        ", ".join(map(str, case.workers)),
        same if several else "",
        ("the same bytes" if of_files else "different") if several else "",
        f"{scores(str(kept), case.reference, align=False).nmad:.3f} m" if case.reference else "",
        f"{nmad(difference(str(kept), str(beside / kept.name))):.3f} m" if beside else "",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> int:
    gdal.UseExceptions()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, help="leave the DSMs in this folder")
    parser.add_argument("--beside", type=Path, help="compare with the DSMs in this folder")
    options = parser.parse_args()
    if not SHARED.is_dir():
        sys.stdout.write(f"The real images are absent ({SHARED}): the demo alone is run.\n")
    with tempfile.TemporaryDirectory(prefix="repm-paths-") as folder:
        place = deep(Path(folder))
        keep = options.keep or Path(folder)
        keep.mkdir(parents=True, exist_ok=True)
        sys.stdout.write(f"The folder's path has {len(place)} characters.\n\n")
        sys.stdout.write("| images | workers | heights | file | NMAD to S2P's DSM | NMAD to the other machine's |\n")
        sys.stdout.write("|---|---|---|---|---|---|\n")
        for case in cases(place):
            sys.stdout.write(row(case, place, keep, options.beside) + "\n")
            sys.stdout.flush()
        shutil.rmtree(plain(os.path.join(folder, NAME)), ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
