"""3-D Tiles of surfaces and of clouds of 1 to 100 million cells or points: time, memory, and what is written."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Dict, List

import numpy as np
import pyproj

from benchmarks.runner import alone, few, say, stage
from benchmarks.tables import Section, table
from repm_qgis.contracts.stages import TILES3D
from repm_qgis.imagery.raster import RasterFrame, created
from repm_qgis.solids.point_cloud import created_cloud

SIDES = (1000, 2000, 5000, 10000)
_CELL_M, _STRIP = 0.5, 500
_EPSG, _WEST, _NORTH = "EPSG:32631", 500_000.0, 4_800_000.0
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
    crs = pyproj.CRS(_EPSG).to_wkt()
    frame = RasterFrame((side, side), np.float32, 1, (_WEST, _CELL_M, 0.0, _NORTH, 0.0, -_CELL_M), crs)
    with created(path, frame, descriptions=["height"], unit="m") as raster:
        for row in range(0, side, _STRIP):
            raster.write(_heights(row, min(_STRIP, side - row), side), 0, row)
    return path


def _tiled(folder: str, dsm: str) -> None:
    stage(TILES3D, dsm=dsm, tiles3d=f"{folder}/tiles")


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


def _points(folder: str, side: int) -> str:
    """A cloud with a point in each cell of the surface, anywhere in it, in colour."""
    path, numbers = f"{folder}/cloud.laz", np.random.default_rng(side)
    with created_cloud(path, _EPSG, (_WEST, _NORTH, 0.0), coloured=True) as cloud:
        for first in range(0, side, _STRIP):
            heights = _heights(first, min(_STRIP, side - first), side)
            row, column = (part.ravel() for part in np.indices(heights.shape))
            x, y = (place + numbers.uniform(0, 1, place.shape) for place in (column, first + row))
            colours = np.column_stack([np.abs(np.sin(x / 90)), np.abs(np.sin(y / 70)), np.full(x.shape, 0.5)]) * 65535
            score = numbers.uniform(0, 1, x.shape)
            cloud.write(_WEST + x * _CELL_M, _NORTH - y * _CELL_M, heights.ravel(), score, colours.astype(np.uint16))
    return path


def _shares(folder: Path) -> List[float]:
    """The millions of points that a viewer has when it has loaded the tiles of each depth, from the root on."""
    many: Dict[int, int] = {}
    for path in (folder / "tiles").iterdir():
        data = path.read_bytes()
        document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
        depth = int(path.name.split("_")[0])
        many[depth] = many.get(depth, 0) + document["accessors"][0]["count"]
    return [sum(many[depth] for depth in many if depth <= deepest) / 1e6 for deepest in sorted(many)]


def clouds() -> List[str]:
    rows, levels = [], ""
    for side in few(SIDES):
        with tempfile.TemporaryDirectory() as folder:
            cloud = alone(_points, folder, side).result
            found, tiles, million = alone(_tiled, folder, cloud), Path(folder, "tiles"), side**2 / 1e6
            sizes = {path: path.stat().st_size for path in tiles.rglob("*") if path.is_file()}
            whole, index = sum(sizes.values()) / 1e6, sizes[tiles / "tileset.json"] / 1e6
            read = Path(cloud).stat().st_size / 1e6
            rows.append([million, found.cpu_s, found.cpu_s / million, found.mib, _listed(tiles), read, whole, index])
            levels = ", ".join(f"{share:.3g}" for share in _shares(tiles))
        say(rows[-1])
    heads = (
        "million points | CPU s | CPU s a million | peak MiB | tiles | MB of the LAZ | MB on the disk | of it the list"
    )
    return [
        "The same town as points in colour, one anywhere in each cell, from a LAZ file. All files that a tileset names "
        "are there.",
        table(f"{heads}, MB", rows),
        f"Million points down to each level of the last one, from the coarsest tile on: {levels}.",
    ]


_COMMAND = "make bench-tiles"
SECTIONS = [
    Section("tiles", "3-D Tiles", _COMMAND, {"cost": cost}),
    Section("cloud_tiles", "3-D Tiles of point clouds", _COMMAND, {"clouds": clouds}),
]
