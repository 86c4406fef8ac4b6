"""Whether a scene has walls: the choice between surfaces (``choice.py``) would flatten relief where there are none.
This is decided once, from the scene's height maps, so that all parts of a scene are treated alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..contracts.arrays import Window
from ..contracts.records import HeightMapRecord
from ..imagery.raster import opened, read
from ..matching.detail import tail
from ..matching.parameters import MATCHING, SubpixelParameters
from ..runtime.spare_cores import spread
from ..scene import Scene
from .outliers import remove_isolated_points
from .parameters import FUSION, IsolatedPointParameters, WallParameters


def has_walls(
    scene: Scene,
    parameters: WallParameters = FUSION.walls,
    subpixel: SubpixelParameters = MATCHING.subpixel,
    isolated: IsolatedPointParameters = FUSION.isolated,
    near_m: float = FUSION.choice.near_m,
) -> bool:
    """Whether the details of a scene's height maps have the long tail that walls give them.

    Where a pixel is wider than ``near_m``, the neighbourhood in which a height is chosen, it has no neighbour there;
    and at 2 m a px a mountain's ridges have tails of 6 to 12, nearly those of towns.
    """
    if scene.gsd_m > near_m:
        return False
    records = [record for tile in scene.tiles for record in tile.heights]
    asked = records[:: max(1, -(-len(records) // parameters.maps))]
    alike = replace(isolated, neighbours=parameters.neighbours)
    tails = spread(lambda record: _tail(record, parameters.window_px, subpixel, alike), asked)
    return bool(tails) and float(np.median(tails)) >= parameters.least_tail


def _tail(
    record: HeightMapRecord, side: int, parameters: SubpixelParameters, isolated: IsolatedPointParameters
) -> float:
    with opened(record.file) as dataset:
        width, height = min(side, dataset.RasterXSize), min(side, dataset.RasterYSize)
        middle = Window((dataset.RasterXSize - width) // 2, (dataset.RasterYSize - height) // 2, width, height)
        values, filled = read(dataset, middle, 1), read(dataset, middle, 3) > 0
    matched = np.where(filled, np.nan, values / record.metres_per_px)
    # In px of disparity; gross errors have long tails, too.
    return tail(remove_isolated_points(matched, 1.0, isolated).astype(np.float32), parameters)
