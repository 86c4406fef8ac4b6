"""What a run over many scenes keeps of each part of its work that is complete: what it was made from, its files, and
its figures. The next run takes it where all of that is unchanged.

A record may have come from anybody: it is bounded in size and checked as a scene is, and it names files by their names
in its own folder only.
"""

from __future__ import annotations

import dataclasses
import json
import os
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence, Tuple, Type, TypeVar

from ..contracts.checks import Misfit
from ..contracts.documents import JsonMapping
from ..contracts.findings import Finding
from ..contracts.options import BatchOptions, Options, PipelineOptions
from ..contracts.record import Record
from ..contracts.results import SceneOutcome
from ..geometry.footprints import bounds_of_wkt
from ..imagery.acquisition import time_sidecars
from ..imagery.deliveries import delivered
from ..imagery.raster import raster_identity
from ..ortho.colour_sources import multispectral_beside
from ..rpc.readers import rpc_sidecars
from ..runtime.workspace import file_identity, fingerprint, write_text

_MOST_BYTES = 4 << 20
_CHAIN = ("scene", "output_scene")  # by which the pipeline chains its stages
_NOT_COMPARED = {"images", *_CHAIN, *BatchOptions.PLACES, *BatchOptions.MACHINE}
K = TypeVar("K", bound="Kept")


@dataclass(frozen=True)
class Kept(Record):
    """Something that is complete: the ``fingerprint`` of what it was made from, and the size and the time of each of
    its ``files`` (-1: a folder), by its name in the record's folder."""

    fingerprint: str
    files: Dict[str, Tuple[int, int]]

    @classmethod
    def read(cls: Type[K], path: str, key: str) -> Optional[K]:
        """The record in a file, if what it was made from is unchanged, and its files are; else None."""
        found = None
        with suppress(OSError, ValueError, RecursionError, Misfit):
            if os.path.isfile(path) and os.path.getsize(path) <= _MOST_BYTES:
                with open(path, encoding="utf-8") as stream:
                    found = cls.from_mapping(json.load(stream))
        folder = os.path.dirname(path)
        if found is None or found.fingerprint != key or not found.files:
            return None
        here = all(name == os.path.basename(name) for name in found.files)
        return found if here and found.files == files_in(folder, list(found.files)) else None

    def write(self, path: str) -> None:
        """Raises WorkspaceError."""
        write_text(path, json.dumps(self.to_mapping(), indent=1, sort_keys=True, allow_nan=False) + "\n")


@dataclass(frozen=True)
class KeptScene(Kept):
    """A complete scene: what became of it, and its ``area`` as WKT in longitude and latitude, "" where it has none."""

    outcome: SceneOutcome
    area: str

    def contradiction(self) -> str:
        return "has an area that is none" if self.area and bounds_of_wkt(self.area) is None else ""

    def again(self, dsm: str, report: str) -> "KeptScene":
        """The same in a later run, with its files where they are now."""
        return replace(self, outcome=replace(self.outcome, reused=True, dsm=dsm, report=report))


@dataclass(frozen=True)
class KeptMosaic(Kept):
    """A complete mosaic, and what its run found."""

    findings: Tuple[Finding, ...]


def files_in(folder: str, names: Sequence[str]) -> Dict[str, Tuple[int, int]]:
    """The size and the time of modification of files in a folder; those that are not there are missing."""
    found: Dict[str, Tuple[int, int]] = {}
    for name in names:
        with suppress(OSError):
            path = os.path.join(folder, name)
            status = os.stat(path)
            found[name] = (-1, -1) if os.path.isdir(path) else (status.st_size, status.st_mtime_ns)
    return found


def scene_key(job: JsonMapping) -> str:
    """The fingerprint of a scene's inputs and options; what computes, where it writes and which defaults are given are
    no part of it.

    Raises OptionError for a bad option, ImageError where its images cannot be found.
    """
    options = PipelineOptions.from_json(job)
    images = delivered(options.fit.images)
    wanted = [
        [type(part).__name__, each.name, getattr(part, each.name)]
        for part in options.parts()
        for each in dataclasses.fields(part)
        if each.name not in _NOT_COMPARED and not isinstance(getattr(part, each.name), Options)
    ]
    products = sorted(name for name in BatchOptions.PLACES if job.get(name))
    beside = [multispectral_beside(image) for image in images.images]
    files = _identities([*images.images, *images.xs, *beside], options)
    return fingerprint("batch", wanted, images.images, products, *files)


def _identities(images: Sequence[str], options: PipelineOptions) -> List[object]:
    """Those of all files that a scene reads: images with what belongs to them, and whatever its options name."""
    found: List[object] = []
    for image in filter(None, images):
        sidecars = [*rpc_sidecars(image), *time_sidecars(image)]
        found += [raster_identity(image), *map(file_identity, dict.fromkeys(sidecars))]
    named = [path for name, path in options.read_paths() if name not in ("images", *_CHAIN)]
    found += [file_identity(path.split("|")[0]) for path in dict.fromkeys(named)]
    return found
