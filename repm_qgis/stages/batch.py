"""The DSMs of many scenes: the pipeline for each of them, one after the other; what is complete is not made again."""

from __future__ import annotations

import os
import time
import traceback
from dataclasses import replace
from typing import List, Optional, Sequence

import numpy as np
from osgeo import ogr

from ..batch.layer import write_footprints
from ..batch.page import batch_page
from ..batch.records import KeptMosaic, KeptScene, files_in, scene_key
from ..batch.scenes import SceneOfMany, folder_of, scenes_of
from ..contracts.documents import JsonObject
from ..contracts.errors import Cancelled, ClusterError, EmptyResultError, RepmError
from ..contracts.findings import Finding, by_severity, verdict_of
from ..contracts.formats import extension_of
from ..contracts.options import BatchOptions
from ..contracts.products import SO_FAR, product, stem_of
from ..contracts.records import FusionFacts
from ..contracts.results import BatchResult, PipelineResult, SceneOutcome
from ..contracts.stages import MOSAIC, PIPELINE
from ..geometry.footprints import footprint, geometry_of, reprojected
from ..imagery.confidence import CONFIDENCE_BANDS
from ..imagery.deliveries import delivered
from ..imagery.heights import stated_deviation
from ..imagery.raster import opened
from ..names import folder_name
from ..reports import verdict
from ..reports.pictures import preview
from ..runtime.imports import import_failure, is_import_failure
from ..runtime.progress import Part, Progress, Recorder, Silent, counted, listed, warn_all
from ..runtime.workspace import ensure_folder, file_identity, fingerprint, remove_temporary, with_copy
from ..scene import Scene, load_view
from . import run_stage

_LAST = 0.92  # of the progress, where a mosaic follows
_SAMPLE_PX = 1000  # of a confidence raster, along the longer side
_LE90_BAND = next(band for band, name in enumerate(CONFIDENCE_BANDS, start=1) if name.startswith("LE90"))
_DSM, _REPORT, _RECORD = "dsm.tif", "report.html", "batch.json"
_LEAST_SHARE = 20  # of the time between two layers of what has ended so far, to the time that one takes
_LON_LAT = "EPSG:4326"


def run(options: BatchOptions, progress: Progress) -> BatchResult:
    """Make what is not complete of each scene, then the layer, the page and the mosaic of all.

    A scene that fails does not stop the others. Raises EmptyResultError where all fail, what
    :func:`~repm_qgis.batch.scenes.scenes_of` raises, WorkspaceError, ClusterError and Cancelled; what is complete by
    then stays, for the next run, with a layer and a page of it (:class:`_SoFar`).
    """
    start, run = time.monotonic(), Recorder(progress)
    scenes = scenes_of(options)
    folder = str(ensure_folder(options.workspace))
    run.info(f"{counted(len(scenes), 'scene')}: {listed([scene.name for scene in scenes])}.")
    share, kept, so_far = (_LAST if options.mosaic else 0.98) / len(scenes), [], _SoFar(folder, scenes)
    for number, scene in enumerate(scenes):
        title = f"Scene {number + 1} of {len(scenes)}, {scene.name}"
        kept.append(_one(scene, options, Part(run, number * share, (number + 1) * share, title)))
        so_far.write(kept)
    outcomes = [each.outcome for each in kept]
    warn_all(run, _findings(outcomes))
    first = next((each for each in outcomes if each.error), None)
    if first is not None and all(each.error for each in outcomes):
        raise EmptyResultError(
            f"None of {counted(len(scenes), 'scene')} has a DSM; the first, '{first.scene}': {first.error}"
        )
    mosaic = _mosaic(options, outcomes, Part(run, len(scenes) * share, 0.98, "Mosaic")) if options.mosaic else None
    layers = with_copy(os.path.join(folder, "scenes.gpkg"), options.output)
    for path in layers:
        write_footprints(kept, path)
    pages = with_copy(os.path.join(folder, "scenes.html"), options.report)
    for path in pages:
        files = [
            ("Footprints of the scenes", layers[-1]),
            ("Mosaic of the DSMs", mosaic),
            ("Workspace of all scenes", folder),
        ]
        batch_page(outcomes, path, files).of(folder_name(folder)).write(path, run)
    so_far.remove()
    progress.step(1.0, "done")
    return BatchResult(
        workspace=options.workspace,
        output=layers[-1],
        report=pages[-1],
        mosaic=mosaic,
        scenes=tuple(outcomes),
        dsms=tuple(each.dsm for each in outcomes if each.dsm),
        n_scenes=len(outcomes),
        n_failed=sum(bool(each.error) for each in outcomes),
        n_reused=sum(each.reused for each in outcomes),
        seconds=round(time.monotonic() - start, 3),
    )


class _SoFar:
    """The layer and the page of the scenes that have ended, beside those of the last run that came to its end. They are
    there before a cancel: after one no file takes its name any more."""

    def __init__(self, folder: str, scenes: Sequence[SceneOfMany]) -> None:
        self._folder, self._scenes = folder, scenes
        self._last, self._took = 0.0, 0.0  # seconds

    def _path(self, extension: str) -> str:
        return os.path.join(self._folder, f"{SO_FAR}.{extension}")

    def write(self, kept: Sequence[KeptScene]) -> None:
        """Write both where a scene was made, and others follow; in no more than a twentieth of the time."""
        start, rest = time.monotonic(), [scene.name for scene in self._scenes[len(kept) :]]
        if not rest or kept[-1].outcome.reused or start - self._last < _LEAST_SHARE * self._took:
            return
        text = (
            f"This run has not come to its end: {len(kept)} of {len(self._scenes)} scenes are here, and not yet "
            f"{listed(rest)}. If it was cancelled or has failed, run again with the same workspace: what is complete "
            "is not computed again."
        )
        said = Recorder(Silent())
        said.warn(Finding("run-unfinished", text, "doubt"))
        write_footprints(kept, self._path("gpkg"))
        outcomes, page = [each.outcome for each in kept], self._path("html")
        files = [("Footprints of the scenes", self._path("gpkg")), ("Workspace of all scenes", self._folder)]
        batch_page(outcomes, page, files, pictures=False).of(folder_name(self._folder)).write(page, said)
        self._last = time.monotonic()
        self._took = self._last - start

    def remove(self) -> None:
        for extension in ("gpkg", "qml", "html"):
            remove_temporary(self._path(extension))


class _Quiet(Part):
    """The progress of one scene: what its run warns of is a line of the log here, and a finding of its own report."""

    def warn(self, finding: Finding) -> None:
        self.info(f"{self._name}: {finding}")


def _one(scene: SceneOfMany, options: BatchOptions, progress: Part) -> KeptScene:
    """One scene: as an earlier run has completed it, made now, or with the sentence of its failure."""
    start = time.monotonic()
    job: JsonObject = {}
    try:
        progress.check_cancelled()
        if scene.error is not None:
            raise scene.error
        folder = folder_of(options.workspace, scene.name)
        job = _job(scene, options, folder)
        key, record = scene_key(job), os.path.join(folder, _RECORD)
        before = KeptScene.read(record, key)
        if before is not None:
            progress.step(1.0, "is complete")
            progress.info(f"'{scene.name}' is complete, with the same images and options: it is not made again.")
            return before.again(str(job["output"]), os.path.join(folder, _REPORT))
        made = _made(scene.name, job, folder, progress, start)
        named = [_DSM, _REPORT, *(os.path.basename(str(job[name])) for name in options.products)]
        kept = replace(made, fingerprint=key, files=files_in(folder, named))
        kept.write(record)
        return kept
    except (Cancelled, ClusterError):  # which all that follow would meet as well
        raise
    except Exception as error:
        progress.check_cancelled()  # native code that was interrupted has exceptions of its own
        sentence = _sentence(error, progress)
        progress.info(f"'{scene.name}' has no DSM: {sentence}")
        return _failed(scene, job, sentence, time.monotonic() - start)


def _job(scene: SceneOfMany, options: BatchOptions, folder: str) -> JsonObject:
    """The pipeline's options for a scene, with all places in its folder."""
    places = {"workspace": folder, "output": os.path.join(folder, _DSM)}
    for name in options.products:
        each = product("dsmfuse", name)
        places[name] = os.path.join(folder, f"{stem_of('dsmfuse', each)}{extension_of(each)}")
    return {**scene.job(options.common), **places}


def _made(name: str, job: JsonObject, folder: str, progress: Part, start: float) -> KeptScene:
    record = Recorder(_Quiet(progress, 0.0, 1.0, f"'{name}'"))
    result = run_stage(PIPELINE, job, record)
    scene = Scene.load(result.scene)
    facts = FusionFacts.from_mapping(result.to_mapping())
    found = by_severity([*verdict.of_run(scene, facts), *verdict.of_history(scene), *record.findings])
    outcome = SceneOutcome(
        scene=name,
        verdict=verdict_of(found),
        error="",
        findings=tuple(map(str, found)),
        reused=False,
        seconds=round(time.monotonic() - start, 3),
        dsm=result.output,
        report=os.path.join(folder, _REPORT),
        images=len(scene.views),
        pairs=len({each.pair for tile in scene.tiles for each in tile.heights}),
        taken=tuple(scene.days()),
        valid_percent=result.valid_percent,
        resolution=result.resolution,
        vertical_datum=result.vertical_datum,
        le90_m=_le90(result),
        height_deviation_m=_deviation(result.output),
    )
    progress.info(
        f"'{name}': {result.valid_percent:.1f} % of the cells have a height, {counted(len(found), 'finding')}."
    )
    area = ogr.CreateGeometryFromWkt(scene.area)
    return KeptScene("", {}, outcome, reprojected(area, scene.crs, _LON_LAT).ExportToWkt())


def _le90(result: PipelineResult) -> Optional[float]:
    """The median LE90 of a DSM's heights, m; None without a confidence raster."""
    if not result.confidence:
        return None
    values = preview(result.confidence, _SAMPLE_PX, _LE90_BAND, nearest=True)[0]
    known = values[np.isfinite(values)]
    return round(float(np.median(known)), 3) if known.size else None


def _deviation(dsm: str) -> Optional[float]:
    with opened(dsm) as dataset:
        return stated_deviation(dataset)


def _sentence(error: Exception, progress: Progress) -> str:
    """What a failure means for the user; of one that nobody expected the log has the details."""
    if isinstance(error, RepmError):
        return str(error)
    if is_import_failure(error):
        return str(import_failure(error))
    progress.info("".join(traceback.format_exception(type(error), error, error.__traceback__)))
    return f"This is a bug ({type(error).__name__}: {' '.join(str(error).split())[:200]}): report it with the log."


def _failed(scene: SceneOfMany, job: JsonObject, sentence: str, seconds: float) -> KeptScene:
    """A scene without a DSM, with the outline of the images that can be read."""
    shape, count = None, 0
    try:
        images = delivered([str(path) for path in job.get("images", ())])
        for path, rpc in zip(images.images, images.rpcs):
            view = load_view(path, rpc, whole=False)
            outline = geometry_of(footprint(view.localise, view.size, view.rpc.height_off))
            shape, count = (outline if shape is None else shape.Union(outline)), count + 1
    except (RepmError, ValueError, RuntimeError):  # which is why it failed
        pass
    outcome = SceneOutcome(
        scene=scene.name,
        verdict="failed",
        error=sentence,
        findings=(),
        reused=False,
        seconds=round(seconds, 3),
        dsm=None,
        report=None,
        images=count,
        pairs=0,
        taken=(),
        valid_percent=None,
        resolution=None,
        vertical_datum=None,
        le90_m=None,
        height_deviation_m=None,
    )
    return KeptScene("", {}, outcome, shape.ExportToWkt() if shape is not None and shape.GetArea() > 0 else "")


def _findings(outcomes: Sequence[SceneOutcome]) -> List[Finding]:
    """What the reader of all must know: scenes without a DSM, and those whose reports are not good."""
    kinds = (
        ("failed", "doubt", "Scenes without a DSM"),
        ("doubt", "doubt", "Scenes that contradict what is known"),
        ("look", "look", "Scenes to look at"),
    )
    found = []
    for kind, level, words in kinds:
        named = [each.scene for each in outcomes if each.verdict == kind]
        if named:
            text = f"{words}: {len(named)} of {len(outcomes)} ({listed(named)}); the report's tables say why."
            found.append(Finding(f"scenes-{kind}", text, "doubt" if level == "doubt" else "look"))
    return found


def _mosaic(options: BatchOptions, outcomes: Sequence[SceneOutcome], progress: Part) -> Optional[str]:
    """Make one DSM of all, unless it is complete; gives its path, None where there is none to make."""
    made = [each for each in outcomes if each.dsm]
    dsms = [str(each.dsm) for each in made]
    if len(dsms) < 2:
        progress.warn(Finding("mosaic-missing", "There is no mosaic, as only one scene has a DSM."))
        return None
    path = str(options.mosaic)
    confidences = [os.path.join(os.path.dirname(dsm), "confidence.tif") for dsm in dsms]
    if "confidence" not in options.products:
        confidences = []
    key = fingerprint("batch-mosaic", dsms, *map(file_identity, [*dsms, *confidences]))
    record = f"{os.path.splitext(path)[0]}_batch.json"
    before = KeptMosaic.read(record, key)
    if before is not None:
        progress.info("The mosaic is complete, of the same DSMs: it is not made again.")
        warn_all(progress, before.findings)
        return path
    machine = {name: options.common[name] for name in BatchOptions.MACHINE if name in options.common}
    said = Recorder(Part(progress, 0.0, 1.0))
    try:
        run_stage(MOSAIC, {"output": path, "dsms": dsms, "confidences": confidences, **machine}, said)
    except (Cancelled, ClusterError):
        raise
    except RepmError as error:
        progress.warn(Finding("mosaic-missing", f"There is no mosaic: {error}"))
        return None
    name = os.path.basename(path)
    KeptMosaic(key, files_in(os.path.dirname(path), [name]), tuple(said.findings)).write(record)
    return path
