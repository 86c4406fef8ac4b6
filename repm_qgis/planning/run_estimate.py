"""How long the pipeline takes, and how much memory: estimated before its work begins, from what was measured, and
corrected by what it does.

docs/benchmarks.md has the runs that the constants were fitted to: two to three images of 1 to 100 million pixels.
"""

from __future__ import annotations

import time
from typing import List, NamedTuple, Sequence, Tuple

from ..contracts.records import ViewPair
from ..runtime.memory import planned_mib
from ..runtime.parallel import cores
from ..runtime.progress import Part, Progress, counted
from ..scene import Scene
from ..stereo.parameters import STEREO
from .disk_space import seen_px

_START_S = 0.2  # of a core, whatever the images
_VIEW_S = 0.25  # of a core, for the cameras of an image
_TIES_S = 1.1  # of a core, for the tie points of a pair
_MATCHED_PIXEL_S, _FUSED_PIXEL_S = 2.0e-6, 1.1e-6  # of a core, for each pixel of ground that a pair sees
_OWN_SURFACE = 1.33  # where the terrain model refines on a surface that has to be found first
_EIGHT_DIRECTIONS = 1.55  # of semi-global matching instead of three
_SHARED = 0.87  # of what so many workers could do, as they wait for each other
_ENGINE_MIB = 160.0  # the engine itself, beside its workers


class RunEstimate(NamedTuple):
    """Seconds by the clock of a run's stages with so many workers, and the memory of all of them, MiB."""

    cameras_s: float
    ties_s: float
    matching_s: float
    fusion_s: float
    mib: float
    workers: int

    @property
    def wall_s(self) -> float:
        return self.cameras_s + self.rest_s

    @property
    def rest_s(self) -> float:
        """What follows when the cameras are there."""
        return self.ties_s + self.matching_s + self.fusion_s

    @property
    def core_s(self) -> float:
        """Seconds of one core."""
        return self.cameras_s + self.rest_s * _speed(self.workers)

    def sentence(self) -> str:
        """What the log says of a run that begins."""
        return f"This run will take about {self._needs()} of memory."

    def outlook(self) -> str:
        """What a page says of a run that may come."""
        return f"A DSM of all this ground will take about {self._needs()} of memory."

    def _needs(self) -> str:
        return f"{duration(self.wall_s)} with {counted(self.workers, 'worker')} and {self.mib / 1024:.1f} GiB"


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
    tied, tasks = sum(pair.tied for pair in pairs), len(scene.tiles) * len(pairs)
    return estimate(
        seen, tile_px, tasks, workers, views=len(scene.views), tied=tied, disparities=disparities, paths=paths
    )


def estimate(
    pixels: float,
    tile_px: float,
    tasks: int,
    workers: int = 0,
    *,
    views: int,
    tied: int,
    disparities: float = 0.0,
    paths: int = 3,
) -> RunEstimate:
    """The same for so many pixels of ground that pairs see, all pairs together, in so many tasks of a tile's side."""
    count = max(1, min(workers or cores(), tasks))
    speed = _speed(count)
    return RunEstimate(
        cameras_s=_START_S + _VIEW_S * views,
        ties_s=_TIES_S * tied / speed,
        matching_s=_MATCHED_PIXEL_S * pixels * (_EIGHT_DIRECTIONS if paths == 8 else 1.0) / speed,
        fusion_s=_FUSED_PIXEL_S * pixels / speed,
        mib=_ENGINE_MIB + count * planned_mib(tile_px + 2 * STEREO.tile_margin_px, disparities, paths),
        workers=count,
    )


def _speed(workers: int) -> float:
    """How many times faster than one they are."""
    return workers * (_SHARED if workers > 1 else 1.0)


class TimeLeft(Part):
    """The progress of a run whose rest was estimated: from then on its texts say how long it takes.

    The time that the work has taken so far corrects the estimate, which counts as much as a twentieth of the rest does.
    """

    _TRUST = 0.05
    _LEAST_S = 10.0  # nobody waits for less

    def __init__(self, whole: Progress) -> None:
        super().__init__(whole, 0.0, 1.0)
        self._fraction, self._since, self._trust = 0.0, 0.0, 0.0
        self._parts: List[Tuple[float, float, float]] = []

    def expect(self, seconds: float) -> None:
        """The rest is expected to take so many seconds, evenly over its fractions."""
        self._since, self._trust = time.monotonic(), self._TRUST * seconds
        self._parts = [(self._fraction, 1.0, seconds)]

    def slow_down(self, factor: float, end: float = 1.0) -> None:
        changed = []
        for low, high, seconds in self._parts:
            ends = sorted({low, high, *(each for each in (self._fraction, end) if low < each < high)})
            for a, b in zip(ends, ends[1:]):
                slow = factor if self._fraction <= a and b <= end else 1.0
                changed.append((a, b, slow * seconds * (b - a) / (high - low)))
        self._parts = changed

    def seconds_left(self) -> float:
        """0 before anything is expected."""
        done = [min(max((self._fraction - low) / (high - low), 0.0), 1.0) for low, high, _ in self._parts]
        whole, past = sum(part[2] for part in self._parts), sum(d * part[2] for d, part in zip(done, self._parts))
        if not whole:
            return 0.0
        return (whole - past) * (time.monotonic() - self._since + self._trust) / (past + self._trust)

    def step(self, fraction: float, text: str = "") -> None:
        self._fraction = max(self._fraction, fraction)
        left = self.seconds_left()
        super().step(fraction, f"{text}, about {duration(left)} left" if text and left >= self._LEAST_S else text)


def duration(seconds: float) -> str:
    """A time in words, no more exact than the estimate."""
    if seconds < 90:
        return f"{max(5, 5 * round(seconds / 5))} s"
    if seconds < 5400:
        return f"{round(seconds / 30) / 2:g} minutes" if seconds < 600 else f"{seconds / 60:.0f} minutes"
    return f"{seconds / 3600:.1f} hours"
