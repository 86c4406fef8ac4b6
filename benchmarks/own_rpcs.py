"""Whether each image has its own RPC: what sound scenes show, and the same scenes with the RPCs of two images
exchanged."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Iterator, List, Optional, Sequence, Tuple
from unittest import mock

from osgeo import gdal

from benchmarks import towns
from benchmarks.runner import few, say, there
from benchmarks.scenes import absent, default, real, simulated, whu_tlc, zy3
from benchmarks.tables import Section, table
from repm_qgis.contracts.errors import RepmError
from repm_qgis.contracts.records import PointingFigures
from repm_qgis.contracts.stages import PIPELINE
from repm_qgis.planning.height_uncertainty import height_uncertainty
from repm_qgis.pointing import pointing
from repm_qgis.pointing.exchanged import Exchange, exchanges, require_own_rpcs
from repm_qgis.pointing.parameters import POINTING
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import View
from repm_qgis.stages import run_stage
from repm_qgis.ties.tracks import Track


class _Heard(Exception):
    """The pointing is known, and nothing more is wanted."""


def sound_scenes() -> Iterator[Tuple[str, Sequence[str]]]:
    for scene in real("pleiades_pair", "pleiades_triplet"):
        yield scene.name, scene.images
    if towns._FOLDER.exists():
        names = towns._names()
        for chosen in (names[:2], names[:3], ["006", "007"], ["009", "010"]):
            yield "jax_068 " + " ".join(name[-3:] for name in chosen), towns.images_of(chosen)
    for scene in whu_tlc():
        yield scene.name, scene.images
    for kind, seeds in (("urban", (4, 5, 6, 7, 8)), ("mountains", (3, 5, 6, 7))):
        for seed in seeds:
            yield f"simulated {kind}, seed {seed}", default(kind, 800, seed).images[:2]
    first, middle, last = _three_lines()
    yield "simulated ZY-3", (first, middle, last)
    yield "simulated ZY-3, forward and backward", (first, last, middle)


def _three_lines() -> Sequence[str]:
    """Images of a simulated ZY-3, whose forward and backward cameras look at the ground in mirrored angles."""
    return simulated("zy3_2048", zy3(2048, 1500.0), 5.0).images


def _exchanged(images: Sequence[str], folder: str) -> List[str]:
    """The images, the first two with each other's RPC."""
    made = []
    for image, other in zip(images, [images[1], images[0], *images[2:]]):
        path = str(Path(folder, f"{Path(image).stem}.vrt"))
        copy = gdal.GetDriverByName("VRT").CreateCopy(path, gdal.Open(image))
        copy.SetMetadata(gdal.Open(other).GetMetadata("RPC"), "RPC")
        copy = None
        made.append(path)
    return made


@dataclass
class _Told:
    """What the pointing of images finds: what each exchange would change, the views with their pointing and its figures
    where there is one, and else why it is refused."""

    pairs: List[Exchange] = field(default_factory=list)
    views: Sequence[View] = ()
    figures: Optional[PointingFigures] = None
    refused: str = ""


def _told(images: Sequence[str]) -> _Told:
    found = _Told()

    def every_pair(views: Sequence[View], tracks: Sequence[Track], altitude: float, *given: Any, **named: Any) -> None:
        found.pairs = list(exchanges(views, tracks, altitude))
        require_own_rpcs(views, tracks, altitude, *given, **named)

    def heard(views: Sequence[View], figures: PointingFigures, *rest: object) -> None:
        found.views, found.figures = views, figures
        raise _Heard

    with (
        tempfile.TemporaryDirectory() as place,
        mock.patch.multiple(pointing, require_own_rpcs=every_pair, _log=heard),
        suppress(_Heard),
    ):
        options = {"images": list(images), "workspace": f"{place}/w", "output": f"{place}/dsm.tif", "workers": 1}
        try:
            run_stage(PIPELINE, options, Silent())
        except RepmError as error:
            found.refused = str(error)
    return found


def _row(name: str, images: Sequence[str]) -> List[object]:
    sound = _told(images)
    figures = there(sound.figures, f"the pointing of {name} ({sound.refused})")
    with tempfile.TemporaryDirectory() as folder:
        crossed = _told(_exchanged(images, folder))
    worst = max((each.evidence for each in sound.pairs), default=float("nan"))
    known = height_uncertainty(sound.views, figures)
    best = max(crossed.pairs, key=lambda each: each.evidence, default=None)
    outcome = "refused" if crossed.refused else "accepted"
    limit = POINTING.exchange.least_evidence
    if outcome == "accepted" and best is not None and best.evidence >= -limit:
        outcome = "warned" if best.evidence > limit else "the log says that nothing tells"
    return [
        name,
        "; ".join(f"{each.own_px:.2f} / {each.exchanged_px:.2f}" for each in sound.pairs),
        f"{worst:+.0f}",
        max(figures.trends_px.values()),
        known.disagreement,
        "none" if best is None else f"{best.own_px:.2f} / {best.exchanged_px:.2f}",
        "none" if best is None else f"{best.evidence:+.0f}",
        outcome,
    ]


def own_rpcs() -> List[str]:
    rows = []
    for name, images in few(sound_scenes()):
        say(f"{name} ...")
        rows.append(_row(name, images))
    heads = (
        "scene",
        "sound: own / exchanged, px",
        "most evidence",
        "trend, px",
        "disagreement",
        "exchanged RPCs: own / exchanged, px",
        "evidence",
        "outcome",
    )
    return [
        "Median residuals of the tie points of each pair with shifts alone, with the RPCs as they are and exchanged "
        "(where a pair leaves a doubt, those of all ties of its two images); "
        "the evidence that they are exchanged (a difference of information criteria: a warning from 10, a refusal from "
        "30 where the ties then fit to 0.15 px); the largest change of a correction over an image (a warning from 1 "
        "px); the RPCs' disagreement in what vendors promise (a warning from 3). Then the same with the RPCs of the "
        "first two images exchanged: *refused* also where the ties found nothing in common.",
        table(heads, rows),
        *absent("pleiades_pair", "pleiades_triplet"),
    ]


SECTIONS = [Section("own_rpcs", "Whether each image has its own RPC", "make bench-own_rpcs", {"own_rpcs": own_rpcs})]
