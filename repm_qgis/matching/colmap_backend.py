"""Backend ``colmap``: all views of a tile matched together by COLMAP's patch match on CUDA."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Dict, List, Optional, Sequence, Tuple

from ..colmap.runner import PatchMatchOptions, Runner, run_patch_match
from ..colmap.tile_matching import GpuTask, match_tiles, tile_height_source
from ..contracts.arrays import Bounds
from ..contracts.errors import OptionError
from ..contracts.options import ReconstructOptions
from ..contracts.records import HeightMapRecord, ViewPair
from ..imagery.parameters import SAMPLING
from ..runtime.environment import Gpu, cuda, cuda_usable, gpus
from ..runtime.progress import Progress
from ..runtime.workspace import fingerprint
from ..scene import Scene, Tile
from ..stereo.height_maps import HeightSource
from ..stereo.wave_change import WaveGeometry
from .backends import MatchingJob, MatchingResult
from .parameters import MatchingParameters


@dataclass(frozen=True)
class ColmapBackend:
    """COLMAP as a backend (:class:`repm_qgis.matching.backends.Backend`).

    ``run`` runs COLMAP in the workspace of a tile, ``devices`` finds the GPUs.
    """

    run: Runner = run_patch_match
    devices: Callable[[], Sequence[Gpu]] = gpus
    name: str = "colmap"
    pair_matcher: None = None

    def usable(self) -> bool:
        return cuda_usable()

    def remedy(self) -> str:
        missing = cuda()["remedy"]
        return f"needs CUDA, and {missing}" if missing else ""

    def settings(self, options: ReconstructOptions) -> List[object]:
        return [options.geometric, options.colmap_fusion, options.window_radius]

    def share_left(self, job: MatchingJob) -> float:
        return 1.0  # what is there says itself whether it is of this job

    def match(self, job: MatchingJob, progress: Progress) -> MatchingResult:
        """Match all tiles, one worker for each GPU.

        Raises OptionError where images of very different ground sampling distances are to be matched with each other.
        """
        _require_alike(job.scene, job.pairs)
        chosen, scene = job.options, job.scene.lean()
        options = PatchMatchOptions(chosen.geometric, chosen.window_radius, chosen.gpu_memory, chosen.colmap_fusion)
        tasks = []
        for tile in job.tiles:
            sources = _partners(tile, job.pairs)
            if sources:
                stretches = {name: job.stretches[name] for name in sorted(sources)}
                task = GpuTask(
                    scene=scene,
                    tile=tile.id,
                    bounds=tile.bounds,
                    altitudes=tile.altitudes,
                    sources=sources,
                    stretches=stretches,
                    options=options,
                    folder=job.folder,
                    key=fingerprint(job.key, tile.id, sources),
                    parameters=job.parameters.colmap,
                    stereo=job.parameters.stereo,
                )
                tasks.append(task)
        records, failed = match_tiles(tasks, self.devices(), self.run, progress)
        return MatchingResult(records, failed)

    def height_source(
        self, scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str, parameters: MatchingParameters
    ) -> HeightSource:
        return tile_height_source(scene, bounds, record, crs, parameters.colmap, parameters.stereo)

    def wave_geometry(
        self, scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str, parameters: MatchingParameters
    ) -> Optional[WaveGeometry]:
        return None  # each map is of several views at once


BACKEND = ColmapBackend()


def _require_alike(scene: Scene, pairs: Sequence[ViewPair]) -> None:
    """COLMAP gets each image with its own pixels: the windows that it compares would show ground of another size."""
    for pair in pairs:
        fine, coarse = sorted(scene.view(name).gsd_m for name in pair.names)
        if coarse > SAMPLING.alike * fine:
            reason = (
                f"compares images pixel by pixel, but those of {pair.first} and {pair.second} are of {fine:.2f} m and "
                f"{coarse:.2f} m: choose sgm, which matches each pair at the pixels of its coarser image"
            )
            raise OptionError("BACKEND", BACKEND.name, reason)


def _partners(tile: Tile, pairs: Sequence[ViewPair]) -> Dict[str, Tuple[str, ...]]:
    """For each view of a tile, the views it is matched with: both directions of every pair that the tile has."""
    found: Dict[str, List[str]] = {}
    for pair in pairs:
        if pair.first in tile.views and pair.second in tile.views:
            found.setdefault(pair.first, []).append(pair.second)
            found.setdefault(pair.second, []).append(pair.first)
    return {name: tuple(others) for name, others in found.items()}
