"""How long the pipeline takes, and how much memory: estimated before its work begins, from what was measured.

docs/benchmarks.md has the runs that the constants were fitted to: two to three images of 1 to 100 million pixels.
"""

from __future__ import annotations

from typing import NamedTuple, Sequence

from ..contracts.records import ViewPair
from ..runtime.memory import planned_mib
from ..runtime.parallel import cores
from ..runtime.progress import counted
from ..scene import Scene
from ..stereo.parameters import STEREO
from .disk_space import seen_px

_START_S = 2.0  # of a core, whatever the images
_PIXEL_S = 3.2e-6  # of a core, for each pixel of ground that a pair sees
_OWN_SURFACE = 1.33  # where the terrain model refines on a surface that has to be found first
_EIGHT_DIRECTIONS = 1.3  # of semi-global matching instead of three
_SHARED = 0.87  # of what so many workers could do, as they wait for each other
_ENGINE_MIB = 160.0  # the engine itself, beside its workers


class RunEstimate(NamedTuple):
    """Seconds of one core, seconds by the clock with so many workers, and the memory of all of them, MiB."""

    core_s: float
    wall_s: float
    mib: float
    workers: int

    def sentence(self) -> str:
        """What the log says of a run that begins."""
        time, size = duration(self.wall_s), f"{self.mib / 1024:.1f} GiB"
        workers = counted(self.workers, "worker")
        return f"This run will take about {time} with {workers} and {size} of memory. A continued run takes less."

    def outlook(self) -> str:
        """What a page says of a run that may come."""
        time, size = duration(self.wall_s), f"{self.mib / 1024:.1f} GiB"
        workers = counted(self.workers, "worker")
        return f"A DSM of all this ground will take about {time} with {workers} and {size} of memory."


def estimate_run(
    scene: Scene, pairs: Sequence[ViewPair], own_surface: bool = False, workers: int = 0, paths: int = 3
) -> RunEstimate:
    """The time and memory of the pipeline for a scene with tiles whose pairs are matched on the CPU, from images to the
    DSM.

    ``own_surface`` is the terrain model without a DEM; ``workers`` 0 means one a core; ``paths`` are
    the directions of semi-global matching. Point clouds and meshes come on
    top. The estimate is right within a factor of 2 on a machine as those of the benchmarks that does nothing else.
    """
    tile_px = max(max(x1 - x0, y1 - y0) for x0, y0, x1, y1 in (tile.bounds for tile in scene.tiles)) / scene.gsd_m
    slope = max(pair.base_to_height for pair in pairs)
    disparities = slope * (scene.altitudes[1] - scene.altitudes[0]) / scene.gsd_m
    seen = seen_px(scene, pairs) * (_OWN_SURFACE if own_surface else 1.0)
    return estimate(seen, tile_px, len(scene.tiles) * len(pairs), workers, disparities, paths)


def estimate(
    pixels: float, tile_px: float, tasks: int, workers: int = 0, disparities: float = 0.0, paths: int = 3
) -> RunEstimate:
    """The same for so many pixels of ground that pairs see, all pairs together, in so many tasks of a tile's side."""
    count = max(1, min(workers or cores(), tasks))
    work = _PIXEL_S * pixels * (_EIGHT_DIRECTIONS if paths == 8 else 1.0)
    wall = _START_S + work / (count * (_SHARED if count > 1 else 1.0))
    mib = _ENGINE_MIB + count * planned_mib(tile_px + 2 * STEREO.tile_margin_px, disparities, paths)
    return RunEstimate(_START_S + work, wall, mib, count)


def duration(seconds: float) -> str:
    """A time in words, no more exact than the estimate."""
    if seconds < 90:
        return f"{max(5, 5 * round(seconds / 5))} s"
    return f"{seconds / 60:.0f} minutes" if seconds < 5400 else f"{seconds / 3600:.1f} hours"
