"""The point cloud of a finished DSM: the points of the scene's height maps that lie on it, and the files they make.

Each tile of the scene has the points of its own height maps in its own cells, found side by side and kept in a file a
tile; the clouds that are asked for are written from these.
"""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Iterator, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Bounds, FloatArray, Window
from ..contracts.file_kinds import is_cloud
from ..contracts.options import DsmFuseOptions
from ..contracts.records import HeightMapRecord
from ..fusion.finished import FinishedSurface
from ..fusion.layout import DsmLayout, own_cells
from ..fusion.parameters import FUSION, IsolatedPointParameters
from ..matching.backends import height_source
from ..matching.parameters import MATCHING, MatchingParameters
from ..runtime.memory import gathering_mib, tile_work, workers_within
from ..runtime.parallel import run_tasks
from ..runtime.progress import Progress
from ..runtime.workspace import ensure_folder, writing
from ..scene import Scene
from .cloud_points import cloud_points
from .painting import opened_paint
from .parameters import SOLIDS, CloudParameters, PaintingParameters
from .point_cloud import created_cloud


def clouds_of(options: DsmFuseOptions, folder: str) -> List[str]:
    """Where clouds are written; an EPT is made from the last one, which is temporary where the user keeps no LAZ."""
    wanted = [options.cloud] if options.cloud else []
    return wanted + ([f"{folder}/cloud.laz"] if options.ept and not any(map(is_cloud, wanted)) else [])


@dataclass(frozen=True)
class TilePoints:
    """The points of a tile, in a file that has one array for each of its height maps: (N, 4) x, y, height (m above the
    ellipsoid), score, and with normals (N, 7) these east, north and up."""

    path: str
    maps: int

    def __iter__(self) -> Iterator[FloatArray]:
        with open(self.path, "rb") as stream:
            for _ in range(self.maps):
                yield np.load(stream, allow_pickle=False)


@dataclass(frozen=True)
class CloudTask:
    """All a worker needs to gather the points of one tile: the ``scene`` without its tiles, the tile's ``bounds`` and
    height maps, the finished DSM and the tile's ``window`` of it, and the file for the points."""

    scene: Scene
    bounds: Bounds
    records: Tuple[HeightMapRecord, ...]
    dsm: FinishedSurface
    window: Window
    path: str
    normals: bool = False
    parameters: CloudParameters = SOLIDS.cloud
    isolated: IsolatedPointParameters = FUSION.isolated
    matching: MatchingParameters = MATCHING


def gathered_points(
    scene: Scene,
    dsm: FinishedSurface,
    layout: DsmLayout,
    *,
    options: DsmFuseOptions,
    folder: str,
    progress: Progress,
    parameters: CloudParameters = SOLIDS.cloud,
    isolated: IsolatedPointParameters = FUSION.isolated,
    matching: MatchingParameters = MATCHING,
) -> List[TilePoints]:
    """The points of all height maps of a scene that lie on its finished DSM or on its walls, each of them once, in
    files in ``folder``; ``layout`` has the window of each tile. Normals are there where the options' cloud has them.

    Raises SceneError where a height map is missing or damaged, WorkspaceError where a file cannot be written.
    """
    ensure_folder(folder)
    normals = bool(options.cloud and options.cloud_normals)
    tasks = [
        CloudTask(
            scene.lean(),
            tile.bounds,
            tile.heights,
            dsm,
            dsm.grid.window(layout.grid.part(window).bounds),
            f"{folder}/points_{number}.npy",
            normals,
            parameters,
            isolated,
            matching,
        )
        for number, (tile, window) in enumerate(zip(scene.tiles, layout.windows))
    ]
    takes = [
        gathering_mib([record.pixels for record in task.records], task.window.width * task.window.height)
        for task in tasks
    ]
    xmin, ymin, xmax, ymax = tasks[takes.index(max(takes))].bounds
    side = math.ceil(max(xmax - xmin, ymax - ymin) / scene.gsd_m)
    workers = workers_within(options.workers, tile_work(side, max(takes)), options.memory, progress)
    return run_tasks(gather, tasks, workers, progress, lambda task: f"points of {task.records[0].tile}")


def gather(task: CloudTask) -> TilePoints:
    """Write the points of one tile into its file, map by map."""
    grid, inner = task.dsm.grid, task.window
    wide = inner.grown(task.parameters.wall_cells, grid.size)
    records = task.records if inner.width and inner.height else ()
    part = grid.part(wide)
    here = np.zeros(part.shape, dtype=bool)
    own = own_cells(grid.part(inner), task.dsm.layout.crs, task.bounds, task.scene.crs)
    here[inner.inside(wide)] = True if own is None else own
    surface = task.dsm.heights(wide) if records else np.empty(part.shape)
    with writing(task.path), open(task.path, "wb") as stream:
        for record in records:
            heights = height_source(task.scene, task.bounds, record, task.dsm.layout.crs, task.matching).read()
            points = cloud_points(
                heights,
                record.metres_per_px,
                part,
                surface=surface,
                own=here,
                with_normals=task.normals,
                parameters=task.parameters,
                isolated=task.isolated,
            )
            np.save(stream, points)
    return TilePoints(task.path, len(records))


def write_cloud(
    path: str,
    layout: DsmLayout,
    tiles: Sequence[TilePoints],
    ortho: Optional[str] = None,
    normals: bool = False,
    parameters: PaintingParameters = SOLIDS.painting,
) -> int:
    """Write the gathered points, with the colours of the orthophoto ``ortho`` if there is one, and with ``normals``
    where they have them; gives their number. Raises WorkspaceError where the file cannot be written.
    """
    origin, heights = (layout.grid.west, layout.grid.north, 0.0), layout.datum.name
    with ExitStack() as stack:
        paint = stack.enter_context(opened_paint(ortho, parameters)) if ortho else None
        cloud = stack.enter_context(created_cloud(path, layout.file_crs, origin, paint is not None, normals, heights))
        for points in (each for tile in tiles for each in tile):
            if len(points):
                x, y, z, score = points[:, :4].T
                below = layout.datum.undulation(layout.crs, np.column_stack([x, y]))
                colours = paint.points(x, y) if paint else None
                cloud.write(x, y, z - below, score, colours, points[:, 4:] if normals else None)
        return cloud.count
