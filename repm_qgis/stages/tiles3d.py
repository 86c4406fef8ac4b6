"""Write a DSM or a point cloud as 3-D Tiles for viewers on the globe."""

from __future__ import annotations

import os
from typing import Optional

from ..contracts.file_kinds import is_cloud
from ..contracts.options import Tiles3dOptions
from ..contracts.results import Tiles3dResult
from ..runtime.parallel import run_whole
from ..runtime.progress import Progress, counted
from ..solids.cloud_tiles import write_cloud_tiles
from ..solids.tiles3d import write_tiles3d


def run(options: Tiles3dOptions, progress: Progress) -> Tiles3dResult:
    """Write the tileset; gives its folder, and how many tiles, and vertices and triangles or points, it has.

    Raises ImageError, EmptyResultError, MissingPackageError, WorkspaceError.
    """
    written = _written_points if is_cloud(options.dsm) else _written
    result: Tiles3dResult = run_whole(written, options, progress, "writing 3-D Tiles")
    progress.step(1.0, "tileset written")
    return result


def _written(options: Tiles3dOptions, progress: Progress) -> Tiles3dResult:
    made = write_tiles3d(options.dsm, options.tiles3d, options.ortho, progress=progress)
    tiles = counted(made.tiles, "tile")
    progress.info(
        f"3-D Tiles: {tiles} with {made.vertices} vertices and {made.triangles} triangles; the coarsest is "
        f"{made.error_m:.2f} m (RMS) from the DSM."
    )
    return _result(options, made.tiles, vertices=made.vertices, triangles=made.triangles)


def _written_points(options: Tiles3dOptions, progress: Progress) -> Tiles3dResult:
    made = write_cloud_tiles(options.dsm, options.tiles3d, progress=progress)
    progress.info(
        f"3-D Tiles: {counted(made.tiles, 'tile')} with {made.points} points; the coarsest has one for each "
        f"{made.spacing_m:.2f} m."
        if made.spacing_m
        else f"3-D Tiles: 1 tile with {made.points} points."
    )
    return _result(options, made.tiles, points=made.points)


def _result(
    options: Tiles3dOptions,
    tiles: int,
    vertices: Optional[int] = None,
    triangles: Optional[int] = None,
    points: Optional[int] = None,
) -> Tiles3dResult:
    return Tiles3dResult(
        tiles3d=options.tiles3d,
        tileset=os.path.join(options.tiles3d, "tileset.json"),
        tiles=tiles,
        vertices=vertices,
        triangles=triangles,
        points=points,
    )
