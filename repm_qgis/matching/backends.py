"""The registry of matching backends, and the interface that all of them have.

A backend turns the tiles of a scene into height maps. Two kinds are in use: a matcher of rectified pairs, which
:class:`repm_qgis.matching.pair_backend.PairBackend` runs over all tiles and pairs (``sgm``), and one that matches all
views of a tile together (``colmap``). A third kind, a cost volume, is a pair matcher whose function aggregates the
volume, selects the disparities, and calls the same steps as ``sgm`` after that. A new backend is a module with an
object ``BACKEND``, a line in ``_MODULES`` here, and its name in ``options.BACKENDS``; ``_PREFERRED`` has it once its
DSMs are at least as good. This module imports nothing that QGIS may lack, so that the dialogs can call it.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Dict, List, Mapping, NamedTuple, Optional, Protocol, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Bounds
from ..contracts.errors import DeviceError
from ..contracts.findings import Finding
from ..contracts.options import ReconstructOptions
from ..contracts.records import HeightMapRecord, ViewPair
from ..geometry.ground_shifts import shift_in
from ..imagery.enhancement import Stretch
from ..runtime.progress import Part, Progress
from ..scene import Scene, Tile
from ..stereo.height_maps import HeightSource
from ..stereo.wave_change import WaveChange, WaveGeometry
from .parameters import MATCHING, MatchingParameters

if TYPE_CHECKING:
    from .disparity_map import PairMatcher

_AUTO = "auto"
_MODULES = {"colmap": "repm_qgis.matching.colmap_backend", "sgm": "repm_qgis.matching.sgm"}
"""Where each backend's object ``BACKEND`` is."""
_PREFERRED = ("sgm",)
"""Those that ``auto`` chooses from, the best one first: it takes the first usable one, and the next where that fails.

A backend is here once docs/benchmarks.md shows that its DSMs are as good. COLMAP's on an H100 are not, and take longer.
"""
NEED_A_DEVICE = frozenset({"colmap"})
"""The backends that may be unable to run: only these must be asked for a remedy."""


@dataclass(frozen=True)
class MatchingJob:
    """The tiles to match; ``key`` is the fingerprint of the inputs of all height maps, ``folder`` takes these."""

    scene: Scene
    tiles: Tuple[Tile, ...]
    pairs: Tuple[ViewPair, ...]
    stretches: Mapping[str, Stretch]
    options: ReconstructOptions
    key: str
    folder: str
    parameters: MatchingParameters = MATCHING


class MatchingResult(NamedTuple):
    """Records of height maps (None for a pair without common ground in a tile), and why tiles failed, by their id."""

    records: List[Optional[HeightMapRecord]]
    failed: Dict[str, DeviceError]


class Backend(Protocol):
    """What every backend has."""

    @property
    def name(self) -> str:
        """The backend's name in options and in records of height maps."""

    @property
    def pair_matcher(self) -> Optional[PairMatcher]:
        """The backend's matcher of rectified pairs, if it has one."""

    def usable(self) -> bool:
        """Whether the backend can run on this machine: a quick answer for ``auto``."""

    def remedy(self) -> str:
        """What the backend needs, and what to do to make it run, after its name; "" where it can run."""

    def settings(self, options: ReconstructOptions) -> List[object]:
        """The user's choices that change this backend's height maps: they are part of the fingerprint."""

    def match(self, job: MatchingJob, progress: Progress) -> MatchingResult:
        """Match all tiles of a job."""

    def share_left(self, job: MatchingJob) -> float:
        """The share of the job, 0..1, that no earlier run has left in its folder."""

    def height_source(
        self, scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str, parameters: MatchingParameters
    ) -> HeightSource:
        """A height map of the tile with these bounds, to be placed on the ground in any projected ``crs``.

        The geometry is made again from the scene: it is exact, and nothing stored can contradict it. Raises SceneError
        where the height map is of another scene; reading from it raises SceneError too, where the file is missing or
        damaged.
        """

    def wave_geometry(
        self, scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str, parameters: MatchingParameters
    ) -> Optional[WaveGeometry]:
        """How waves of the attitude act on a height map; None where the backend's maps are not of pairs."""


def backend_of(name: str) -> Backend:
    """The backend of this name; its module is imported now."""
    found: Backend = importlib.import_module(_MODULES[name]).BACKEND
    return found


def remedy(name: str) -> str:
    """What to do to make the backend of an option run, after the backend's name; "" where it can run."""
    return "" if name == _AUTO else backend_of(name).remedy()


def resolve(name: str) -> List[Backend]:
    """The backends that an option means on this machine: the first one matches, the next ones what it fails on.

    Raises DeviceError where a backend is asked for by name and cannot run.
    """
    require(name)
    if name != _AUTO:
        return [backend_of(name)]
    return [backend for backend in map(backend_of, _PREFERRED) if backend.usable()]


def require(name: str) -> None:
    """Raise DeviceError where a backend is asked for by name and cannot run."""
    missing = remedy(name)
    if missing:
        raise DeviceError(f"BACKEND {name} {missing}; or choose auto.")


def pair_matcher(backend: Backend) -> PairMatcher:
    """The backend's matcher of pairs; where it has none, that of the first backend which has one."""
    candidates = (backend, *map(backend_of, _MODULES))
    return next(found for found in (candidate.pair_matcher for candidate in candidates) if found is not None)


def matched_pairs(pairs: Sequence[ViewPair], backend: Backend) -> Sequence[ViewPair]:
    """The pairs that have a height map each; one where a backend matches all views of a tile together."""
    return pairs if backend.pair_matcher is not None else pairs[:1]


def match_scene(job: MatchingJob, backends: Sequence[Backend], progress: Progress) -> List[Optional[HeightMapRecord]]:
    """Records of all tiles' height maps; tiles on which a backend fails are matched by the next one.

    A warning names each tile that fails. Raises DeviceError where no tile has height maps for that reason.
    """
    records: List[Optional[HeightMapRecord]] = []
    begin = 0.0
    for number, backend in enumerate(backends, start=1):
        last = number == len(backends)
        end = 1.0 if last else 0.9 + 0.1 * begin
        found = backend.match(job, Part(progress, begin, end))
        records += found.records
        outcome = "has no heights" if last else f"was matched by {backends[number].name} instead"
        for tile, error in found.failed.items():
            progress.warn(Finding("tile-unmatched", f"Tile {tile} {outcome}: {error}"))
        if last and found.failed and not records:
            raise next(iter(found.failed.values()))
        begin, job = end, replace(job, tiles=tuple(tile for tile in job.tiles if tile.id in found.failed))
    return records


def height_source(
    scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str, parameters: MatchingParameters = MATCHING
) -> HeightSource:
    """A height map by the backend that made it, see :meth:`Backend.height_source`; of a scene that was registered since
    it was matched, where that has moved it."""
    backend, matched = backend_of(record.backend), record.ground or bounds
    source = backend.height_source(scene.as_matched, matched, record, crs, parameters)
    if record.offsets:
        source = replace(source, offsets=np.array(record.offsets))
    if scene.waves_changed:
        geometry = backend.wave_geometry(scene.as_matched, matched, record, crs, parameters)
        if geometry is not None:
            now, before = (
                (seen.view(record.pair[0]).jitter, seen.view(record.pair[1]).jitter)
                for seen in (scene, scene.as_matched)
            )
            source = replace(source, waves=WaveChange(geometry, now, before))
    if scene.registration is None:
        return source
    middle = 0.5 * (bounds[0] + bounds[2]), 0.5 * (bounds[1] + bounds[3])
    return replace(source, shift=shift_in(scene.registration.shift, scene.crs, crs, middle))


def wave_geometry(
    scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str, parameters: MatchingParameters = MATCHING
) -> Optional[WaveGeometry]:
    """How waves act on a height map of a tile with these bounds, see :meth:`Backend.wave_geometry`."""
    matched = record.ground or bounds
    return backend_of(record.backend).wave_geometry(scene.as_matched, matched, record, crs, parameters)
