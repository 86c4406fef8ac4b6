"""Write the corrected RPCs of a scene's images in the forms that GDAL, QGIS, OTB, CARS, S2P and ASP read."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Dict, List

import numpy as np

from .. import __version__
from ..contracts.errors import InputTableError, OptionError, RpcInvalidError
from ..contracts.findings import Finding
from ..contracts.options import ExportRpcOptions
from ..contracts.results import ExportRpcResult
from ..evaluation.gcp_accuracy import GcpAccuracy, measure_images, shifted
from ..geometry.frames import EnuFrame
from ..imagery.raster import opened
from ..imagery.vrt import image_vrt_text
from ..names import scene_title
from ..pointing.control_places import require_places
from ..pointing.ground_control import read_gcps
from ..reports.rpc_page import ExportedRpc, control_sentence, rpc_page, within_px
from ..reports.verdict import of_control, of_rpcs
from ..rpc.correction import corrected, of_projected
from ..rpc.writers import rpb_text, rpc_tags, rpc_txt
from ..runtime.progress import Progress, Recorder, counted, warn_all
from ..runtime.workspace import require_no_strangers, whole_folder, write_text
from ..scene import Scene, View

_LIST = "rpcs.json"


def run(options: ExportRpcOptions, progress: Progress) -> ExportRpcResult:
    """Export the RPCs; gives the folder, the VRTs as ``images``, and the largest distance from the pointed model, px.

    Raises SceneError, ImageError, RpcInvalidError, WorkspaceError; InputTableError and OptionError for control points.
    """
    scene = Scene.load(options.scene)
    scene.require_images()
    _require_place(Path(options.rpc_folder))
    control = _control(scene, options) if options.gcps else None
    if control is not None:
        scene = replace(scene, views=tuple(shifted(scene.views, control.shifts)))
    exported = [_exported(scene, view) for view in scene.views]
    run = Recorder(progress)
    findings = [*control.warnings, *of_control(control, [view.name for view in scene.views])] if control else []
    warn_all(run, [*findings, *of_rpcs({each.view.name: each.corrected for each in exported})])
    with whole_folder(options.rpc_folder) as folder:
        for index, each in enumerate(exported):
            progress.check_cancelled()
            progress.step(index / len(exported), each.view.name)
            _write(each, folder, options.rpc_folder)
        document = {"format": "repm-rpcs", "engine": __version__, "images": [_record(each) for each in exported]}
        write_text(str(folder / _LIST), json.dumps(document, indent=1, allow_nan=False))
    if options.report:
        rpc_page(exported, options.scene, control).of(scene_title(scene, options.scene)).write(options.report, run)
    worst = max(each.corrected.max_px for each in exported)
    images = tuple(str(Path(options.rpc_folder) / each.files[0]) for each in exported)
    off = f"at most {within_px(exported):.4f} px from the pointed model"
    if control is not None:
        for name in control.shifts:
            progress.info(control_sentence(control, name))
    progress.info(f"{counted(len(images), 'image')}: RPCs in '{options.rpc_folder}', {off}.")
    progress.step(1.0, "RPCs exported")
    return ExportRpcResult(rpc_folder=options.rpc_folder, report=options.report, images=images, max_error=worst)


def _control(scene: Scene, options: ExportRpcOptions) -> GcpAccuracy:
    """The control points in the images of a scene without pointing, and the shift that they give to each image."""
    path = options.gcps or ""
    if any(np.abs(view.pointing - np.eye(2, 3)).max() > 0 or view.jitter is not None for view in scene.views):
        reason = "must be empty for a scene that has a pointing: give the points to 'Reconstruct heights'"
        raise OptionError("GCPS", path, reason)
    elsewhere: List[Finding] = []
    found = GcpAccuracy(read_gcps(path, scene.views, options.gcp_datum, elsewhere.append), warnings=elsewhere)
    require_places(found.gcps, scene.views, path)
    measure_images(found, scene.views)
    if not found.shifts:
        remedy = "fill the fields view, col and row of points with the role control"
        raise InputTableError(f"No control point of '{path}' was measured in an image: {remedy}.")
    return found


def _exported(scene: Scene, view: View) -> ExportedRpc:
    try:
        if view.plane is None:
            waves = None if view.jitter is None else view.jitter.added
            made = corrected(view.rpc, view.pointing, view.size, scene.altitudes, waves)
        else:
            made = of_projected(view.localise, view.rpc, view.size, scene.altitudes)
    except RpcInvalidError as error:
        raise RpcInvalidError(
            f"The RPC of '{view.image}' cannot be exported: {error} Make the scene again with the image's own RPC."
        ) from error
    middle, height = np.array([(view.width - 1) / 2, (view.height - 1) / 2]), sum(scene.altitudes) / 2
    before, after = view.model.localise(middle, height), view.localise(middle, height)
    moved = np.full(2, np.nan)
    if np.isfinite(before).all() and np.isfinite(after).all():
        moved = EnuFrame(*map(float, before)).from_geodetic(after)[:2]
    shift = view.pointing @ np.append(middle, 1.0) - middle
    return ExportedRpc(view, made, shift, moved)


def _write(exported: ExportedRpc, folder: Path, place: str) -> None:
    """One image's three files into a folder that will have the path ``place``."""
    view, rpc = exported.view, exported.corrected.rpc
    metadata = {"RPC": rpc_tags(rpc)}
    if view.acquired:
        # As GDAL's readers of vendors' files write it.
        metadata["IMAGERY"] = {"ACQUISITIONDATETIME": view.acquired.replace("T", " ").rstrip("Z")}
    with opened(view.image) as image:
        # From the folder beside the final one, where it is written, other files have the same relative names.
        vrt = image_vrt_text(image, view.image, place, metadata)
    for name, text in zip(exported.files, (vrt, rpb_text(rpc), rpc_txt(rpc))):
        write_text(str(folder / name), text)


def _record(exported: ExportedRpc) -> Dict[str, object]:
    made = exported.corrected
    return {
        "view": exported.view.name,
        "original": exported.view.image,
        "files": list(exported.files),
        "method": made.method,
        "max_px": made.max_px,
        "rms_px": made.rms_px,
        "shift_px": exported.shift_px.tolist(),
        "moved_m": exported.moved_m.tolist() if np.isfinite(exported.moved_m).all() else None,
    }


def _require_place(folder: Path) -> None:
    """Raise WorkspaceError where replacing the folder would delete anything but an earlier export."""
    known = {_LIST, *(name + end for name in _listed(folder / _LIST) for end in ("", ".aux.xml", ".ovr"))}
    require_no_strangers(folder, known.__contains__, "does not belong to an export of RPCs", option="RPC_FOLDER")


def _listed(path: Path) -> List[str]:
    """The files that an earlier export wrote, as its list says; empty where there is none that can be read."""
    try:
        with open(path, encoding="utf-8") as stream:
            document = json.load(stream)
        return [str(name) for image in document["images"] for name in image["files"]]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []
