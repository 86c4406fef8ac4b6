"""Write a DSM as 3-D Tiles for viewers on the globe."""

from __future__ import annotations

import os

from ..contracts.documents import JsonObject
from ..contracts.options import Tiles3dOptions
from ..runtime.parallel import run_whole
from ..runtime.progress import Progress, counted
from ..solids.tiles3d import write_tiles3d


def run(options: Tiles3dOptions, progress: Progress) -> JsonObject:
    """Write the tileset; gives its folder, and how many tiles, vertices and triangles it has.

    Raises ImageError, EmptyResultError, MissingPackageError, WorkspaceError.
    """
    result: JsonObject = run_whole(_written, options, progress, "writing 3-D Tiles")
    progress.step(1.0, "tileset written")
    return result


def _written(options: Tiles3dOptions, progress: Progress) -> JsonObject:
    made = write_tiles3d(options.dsm, options.tiles3d, options.ortho, progress=progress)
    tiles = counted(made.tiles, "tile")
    progress.info(
        f"3-D Tiles: {tiles} with {made.vertices} vertices and {made.triangles} triangles; the coarsest is "
        f"{made.error_m:.2f} m (RMS) from the DSM."
    )
    counts = {"tiles": made.tiles, "vertices": made.vertices, "triangles": made.triangles}
    return {"tiles3d": options.tiles3d, "tileset": os.path.join(options.tiles3d, "tileset.json"), **counts}
