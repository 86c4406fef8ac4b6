"""3-D Tiles of surfaces of 1 to 100 million cells: time, memory, and what is written."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Dict, List

import numpy as np
import pyproj

from benchmarks.runner import alone, few, say, stage
from benchmarks.tables import Section, table
from repm_qgis.imagery.raster import RasterFrame, created

SIDES = (1000, 2000, 5000, 10000)
_CELL_M, _STRIP = 0.5, 500
_BLOCK_M, _HOUSE_M = 24.0, 16.0  # houses stand in a grid of blocks, each with a flat roof of its own height


def _heights(first: int, rows: int, columns: int) -> np.ndarray:
    """(rows, columns) heights of a town on hills, which are the same wherever a strip of rows begins."""
    y, x = np.mgrid[first : first + rows, 0:columns] * _CELL_M
    ground = (
        40 * np.sin(x / 310) * np.cos(y / 270) + 6 * np.sin(x / 37 + 1) * np.sin(y / 41) + 0.3 * np.sin(x * y / 900)
    )
    column, row = np.floor(x / _BLOCK_M), np.floor(y / _BLOCK_M)
    inside = (x % _BLOCK_M < _HOUSE_M) & (y % _BLOCK_M < _HOUSE_M)
    storeys = 1 + np.floor(7 * np.abs(np.sin(12.9898 * column + 78.233 * row)))
    return np.where(inside, 60 + 3 * storeys + 0.1 * ground, ground).astype(np.float32)


def _surface(folder: str, side: int) -> str:
    path = f"{folder}/dsm.tif"
    crs = pyproj.CRS("EPSG:32631").to_wkt()
    frame = RasterFrame((side, side), np.float32, 1, (500_000.0, _CELL_M, 0.0, 4_800_000.0, 0.0, -_CELL_M), crs)
    with created(path, frame, descriptions=["height"], unit="m") as raster:
        for row in range(0, side, _STRIP):
            raster.write(_heights(row, min(_STRIP, side - row), side), 0, row)
    return path


def _tiled(folder: str, dsm: str) -> Dict[str, object]:
    return stage("tiles3d", dsm=dsm, tiles3d=f"{folder}/tiles")


def _listed(folder: Path) -> int:
    """How many of the files that the tileset names are there; raises where one is absent."""
    nodes, found = [json.loads((folder / "tileset.json").read_text(encoding="utf-8"))["root"]], 0
    while nodes:
        node = nodes.pop()
        nodes += node.get("children", ())
        if "content" in node:
            found += (folder / node["content"]["uri"]).stat().st_size > 0
    return found


def cost() -> List[str]:
    rows = []
    for side in few(SIDES):
        with tempfile.TemporaryDirectory() as folder:
            found, tiles, million = alone(_tiled, folder, _surface(folder, side)), Path(folder, "tiles"), side**2 / 1e6
            sizes = {path: path.stat().st_size for path in tiles.rglob("*") if path.is_file()}
            whole, index = sum(sizes.values()) / 1e6, sizes[tiles / "tileset.json"] / 1e6
            rows.append([million, found.cpu_s, found.cpu_s / million, found.mib, _listed(tiles), whole, index])
        say(rows[-1])
    return [
        "A town on hills in cells of 0.5 m, without an orthophoto, in one process. All files that a tileset names are "
        "there.",
        table("million cells | CPU s | CPU s a million | peak MiB | tiles | MB on the disk | of it the list, MB", rows),
    ]


SECTIONS = [Section("tiles", "3-D Tiles", "make bench-tiles", {"cost": cost})]
