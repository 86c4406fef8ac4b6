"""The point cloud of a DSM: where it is written, and its points."""

from __future__ import annotations

from contextlib import ExitStack
from typing import List, Optional, Sequence

import numpy as np

from ..fusion.layout import DsmLayout
from ..fusion.tile_fusion import StoredTile
from ..las import is_cloud
from ..options import DsmFuseOptions
from .painting import opened_paint
from .point_cloud import created_cloud


def clouds_of(options: DsmFuseOptions, folder: str) -> List[str]:
    """Where clouds are written; an EPT is made from the last one, which is temporary where the user keeps no LAZ."""
    wanted = [options.cloud] if options.cloud else []
    return wanted + ([f"{folder}/cloud.laz"] if options.ept and not any(map(is_cloud, wanted)) else [])


def write_cloud(
    path: str, layout: DsmLayout, stored: Sequence[StoredTile], ortho: Optional[str] = None, normals: bool = False
) -> int:
    """Write the points of the fused tiles, with the colours of the orthophoto ``ortho`` if there is one, and with
    ``normals`` where the tiles have them; gives their number. Raises WorkspaceError where the file cannot be written.
    """
    origin, heights = (layout.grid.west, layout.grid.north, 0.0), layout.datum.name
    with ExitStack() as stack:
        paint = stack.enter_context(opened_paint(ortho)) if ortho else None
        cloud = stack.enter_context(created_cloud(path, layout.file_crs, origin, paint is not None, normals, heights))
        for tile in stored:
            points = tile.points()
            if points is not None and len(points):
                x, y, z, score = points[:, :4].T
                below = layout.datum.undulation(layout.crs, np.column_stack([x, y]))
                colours = paint.points(x, y) if paint else None
                cloud.write(x, y, z - below, score, colours, points[:, 4:] if normals else None)
        return cloud.count
