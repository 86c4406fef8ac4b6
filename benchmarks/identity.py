#!/usr/bin/env python3
"""Whether a change left every result as it was, to the byte (``make identity BASE=revision``).

Runs the same jobs with this checkout and with another revision of it, and compares what they make: the values,
grid, CRS and metadata of every raster, the points of clouds, the vertices of meshes, the attributes of layers, and
the figures and pictures of the reports. Times, paths and fingerprints (which hold times of change) are left out.

    benchmarks/identity.py REVISION            both sides, then the comparison; exit code 1 where something differs
    benchmarks/identity.py --digest FILE       this checkout's side alone, into a JSON file
    benchmarks/identity.py --against FILE      this checkout against such a file
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

import numpy as np
from osgeo import gdal, ogr

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("REPM_SHARED_DATA", ROOT.parent / "shared" / "data"))
PRODUCTS = {
    "output": "dsm.tif",
    "confidence": "confidence.tif",
    "ortho": "ortho.tif",
    "cloud": "cloud.laz",
    "ept": "ept",
    "mesh": "mesh.ply",
    "view_heights": "pairs",
    "report": "report.html",
    "tiles": "tiles.gpkg",
    "tie_points": "ties.gpkg",
}
PASSING = {"REPM_SCENE", "REPM_FINGERPRINT", "REPM_RECORD"}  # metadata with times of change and paths in it
Digest = Dict[str, str]


def cases(folder: Path) -> Iterator[Tuple[str, List[Tuple[str, Dict[str, object]]]]]:
    """Each case's name, and its stages with their options."""
    town, hills = str(folder / "town"), str(folder / "hills")
    yield (
        "samples",
        [
            ("sampledata", {"folder": town, "size": 800}),
            ("sampledata", {"folder": hills, "kind": "mountains", "size": 500, "seed": 3}),
        ],
    )
    of = {name: sorted(str(p) for p in Path(name).glob("*.tif") if "truth" not in p.name) for name in (town, hills)}

    def pipeline(name: str, images: List[str], **options: object) -> Tuple[str, Dict[str, object]]:
        made = {option: str(folder / name / file) for option, file in PRODUCTS.items()}
        return "pipeline", {"images": images, "workspace": str(folder / name / "w"), **made, **options}

    truth = next(iter(sorted(str(p) for p in Path(town).glob("*truth*.tif"))), "")
    yield (
        "demo",
        [
            pipeline("demo", of[town]),
            (
                "comparedsm",
                {
                    "dsm": str(folder / "demo" / "dsm.tif"),
                    "reference": truth,
                    "align": "3d",
                    "error": str(folder / "demo" / "error.tif"),
                    "report": str(folder / "demo" / "accuracy.html"),
                },
            ),
        ],
    )
    yield "terrain", [pipeline("terrain", of[town], model="terrain", fill="all", method="median", resolution=0.7)]
    gcps = sorted(str(p) for p in Path(hills).glob("*.csv"))
    yield (
        "hills",
        [
            pipeline("hills_run", of[hills], gcps=gcps[0] if gcps else None, vertical_datum="EGM96", tile_size=300),
            (
                "errormap",
                {
                    "scene": str(folder / "hills_run" / "w" / "refined.json"),
                    "output": str(folder / "hills_run" / "errormap.tif"),
                },
            ),
            (
                "checkgcps",
                {
                    "gcps": gcps[0] if gcps else "",
                    "output": str(folder / "hills_run" / "gcps.gpkg"),
                    "scene": str(folder / "hills_run" / "w" / "reconstructed.json"),
                    "report": str(folder / "hills_run" / "gcps.html"),
                },
            ),
            (
                "exportcameras",
                {
                    "scene": str(folder / "hills_run" / "w" / "refined.json"),
                    "folder": str(folder / "hills_run" / "cameras"),
                },
            ),
        ],
    )
    yield "colmap adjustment", [pipeline("principal", of[hills], adjustment="colmap", model="homography")]
    for name, resolution in (("truth_urban", 0.0), ("pleiades_pair", 0.5), ("pleiades_triplet", 0.5)):
        images = sorted(str(p) for p in (SHARED / name).glob("*.tif") if p.name.startswith("im"))
        if images:
            yield name, [pipeline(name, images, resolution=resolution)]
        else:
            sys.stderr.write(f"identity: {name} is left out, there are no images in {SHARED / name}\n")


def digest(tree: Path) -> Digest:
    """What the engine of a checkout makes of all cases."""
    found: Digest = {}
    with tempfile.TemporaryDirectory() as work:
        for name, stages in _later(cases, Path(work)):
            before = {path for path in Path(work).rglob("*") if path.is_file()}
            for stage, options in stages:
                result = _run(tree, stage, options, Path(work))
                figures = json.dumps(_figures(result, work), sort_keys=True)
                found[f"{name}: result of {stage}"] = _hash(figures.encode())
            for path in sorted(set(p for p in Path(work).rglob("*") if p.is_file()) - before):
                content = _content(path, work)
                if content is not None:
                    found[f"{name}: {path.relative_to(work)}"] = _hash(content)
            sys.stderr.write(f"identity: {name} done, {len(found)} results\n")
    return found


def _later(make: Any, folder: Path) -> Iterator[Tuple[str, List[Tuple[str, Dict[str, object]]]]]:
    """The cases one by one; those after the first are named once the samples are there."""
    for index in range(sum(1 for _ in make(folder))):
        yield list(make(folder))[index]


def _run(tree: Path, stage: str, options: Dict[str, object], work: Path) -> Dict[str, object]:
    job = work / "job.json"
    job.write_text(json.dumps(options))
    done = subprocess.run(
        [sys.executable, "-m", "repm_qgis", stage, str(job)],
        cwd=tree,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        check=False,
    )
    job.unlink()
    last = json.loads(done.stdout.splitlines()[-1])
    if last["type"] != "result":
        raise SystemExit(f"identity: {stage} failed in {tree}: {last.get('text')}")
    return last["result"]


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _figures(value: object, work: str) -> Any:
    """A result without times and paths."""
    if isinstance(value, dict):
        return {name: _figures(part, work) for name, part in value.items() if name not in ("seconds", "worker_s")}
    if isinstance(value, (list, tuple)):
        return [_figures(part, work) for part in value]
    return value.replace(work, "") if isinstance(value, str) else value


def _content(path: Path, work: str) -> Any:
    """The bytes of a product that must not change; None for what is no product."""
    kind = path.suffix.lower()
    if kind in (".tif", ".tiff"):
        return _raster(path)
    if kind in (".laz", ".las"):
        import laspy

        cloud = laspy.read(path)
        return cloud.points.array.tobytes() + repr((list(cloud.header.scales), list(cloud.header.offsets))).encode()
    if kind in (".ply", ".npy", ".png", ".csv", ".txt", ".qml", ".bin"):
        return path.read_bytes().replace(work.encode(), b"")
    if kind == ".gpkg":
        return _layer(path)
    if kind == ".html":
        return _report(path, work)
    return None


def _raster(path: Path) -> bytes:
    dataset = gdal.Open(str(path))
    kept = {key: value for key, value in dataset.GetMetadata().items() if key not in PASSING}
    parts = [repr((dataset.GetGeoTransform(), dataset.GetProjection(), sorted(kept.items()))).encode()]
    for number in range(1, dataset.RasterCount + 1):
        band = dataset.GetRasterBand(number)
        parts.append(repr((band.GetNoDataValue(), band.GetDescription(), band.GetUnitType())).encode())
        # Not a number has many bit patterns; one stands for all.
        values = band.ReadAsArray()
        parts.append(
            np.where(np.isnan(values), np.nan, values).tobytes() if values.dtype.kind == "f" else values.tobytes()
        )
    return b"".join(parts)


def _layer(path: Path) -> bytes:
    dataset = ogr.Open(str(path))
    rows = []
    for number in range(dataset.GetLayerCount()):
        layer = dataset.GetLayer(number)
        for feature in layer:
            values = [feature.GetField(i) for i in range(feature.GetFieldCount())]
            rows.append((feature.GetGeometryRef().ExportToWkt(), values))
    return repr(rows).encode()


def _report(path: Path, work: str) -> bytes:
    """Numbers of tables and charts, and pictures; words may be put better, and times and paths differ."""
    text = path.read_text(encoding="utf-8").replace(work, "")
    text = text.replace("&#39;", "&#x27;").replace("&#34;", "&quot;")  # jinja2's and html's spelling of one character
    text = re.sub(r"<(style|footer|nav|head|pre)\b.*?</\1>", "", text, flags=re.S)
    text = re.sub(r"<tr><td>DSM of each pair alone</td>.*?</tr>", "", text, flags=re.S)  # a row that once was missing
    text = re.split(r"<h2[^>]*>What was done", text)[0]
    pictures = re.findall(r'src="data:[^"]*"', text)
    cells = [re.sub("<[^>]*>", "", cell) for cell in re.findall(r"<td[^>]*>.*?</td>", text, flags=re.S)]
    numbers = [re.findall(r"-?\d+\.?\d*", cell) for cell in cells if "/" not in cell]
    charts = [re.findall(r"-?\d+\.?\d*", chart) for chart in re.findall(r"<svg.*?</svg>", text, flags=re.S)]
    return json.dumps([pictures, numbers, charts]).encode()


def compare(now: Digest, before: Digest) -> int:
    """Print what differs; gives the exit code."""
    names = sorted({*now, *before})
    different = [name for name in names if now.get(name) != before.get(name)]
    for name in different:
        state = "is new" if name not in before else "is missing" if name not in now else "differs"
        sys.stdout.write(f"{name} {state}\n")
    sys.stdout.write(f"{len(names) - len(different)} of {len(names)} results are identical\n")
    return int(bool(different))


def of_revision(revision: str) -> Digest:
    """The digest of another revision of this repository, checked out beside the temporary files."""
    with tempfile.TemporaryDirectory() as place:
        tree = Path(place) / "tree"
        subprocess.run(
            ["git", "-C", str(ROOT), "worktree", "add", "--detach", "--quiet", str(tree), revision], check=True
        )
        try:
            return digest(tree)
        finally:
            subprocess.run(["git", "-C", str(ROOT), "worktree", "remove", "--force", str(tree)], check=True)


def main() -> int:
    gdal.UseExceptions()
    ogr.UseExceptions()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("revision", nargs="?", default="HEAD")
    parser.add_argument("--digest", help="write this checkout's digest into a file")
    parser.add_argument("--against", help="compare with a digest's file instead of a revision")
    options = parser.parse_args()
    mine = digest(ROOT)
    if options.digest:
        Path(options.digest).write_text(json.dumps(mine, indent=1))
        return 0
    if options.against:
        return compare(mine, json.loads(Path(options.against).read_text()))
    return compare(mine, of_revision(options.revision))


if __name__ == "__main__":
    sys.exit(main())
