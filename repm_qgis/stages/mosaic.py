"""Put many DSMs together to one, without steps between them."""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from pathlib import Path
from typing import Dict, List, Optional, Sequence

import numpy as np
import pyproj

from ..contracts.arrays import IntArray
from ..contracts.checks import as_text
from ..contracts.documents import Keywords
from ..contracts.errors import EmptyResultError, ImageError, OverlapError
from ..contracts.findings import Finding
from ..contracts.options import DsmFuseOptions, MosaicOptions
from ..contracts.paths import real_path
from ..contracts.products import kept_folder
from ..contracts.results import DsmOffset, MosaicResult
from ..gate.surfaces import Entry, entries_of, surface_findings
from ..geometry.vertical import PLACED, PLACED_TAG
from ..imagery.raster import opened, raster_identity
from ..mosaic.blocks import (
    STEP_BINS,
    STEP_M,
    Block,
    InteriorTask,
    Source,
    block_mib,
    block_tasks,
    make_block,
    measure_pair,
    pair_tasks,
    write_interior,
)
from ..mosaic.inputs import Layout, Surface, layout_of, require_datum_of_scenes
from ..mosaic.offsets import Offsets, Overlap, solve_offsets
from ..mosaic.page import left_differences, mosaic_page
from ..mosaic.parameters import MosaicParameters, OffsetParameters
from ..mosaic.products import rasters_of, require_tiles_place, write_mosaic
from ..names import mosaic_name
from ..planning.disk_space import mosaic_needs, require_space
from ..reports import verdict
from ..runtime.memory import Work, workers_within
from ..runtime.parallel import kept_workers, run_tasks
from ..runtime.progress import Part, Progress, Recorder, Silent, counted, warn_all
from ..runtime.workspace import ensure_folder, file_identity, fingerprint
from . import dsmfuse
from .kept import drop_others, kept_until_done
from .parameters import ENGINE, EngineParameters

_FEW = 5  # pairs that a warning names
_FUSION_SHARE = 0.6  # of the progress, where all surfaces are scenes


def run(options: MosaicOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> MosaicResult:
    """Fuse the scenes, solve the offsets, make the mosaic block by block, and write it; gives the offsets and the
    products' paths.

    Finished parts of a stopped run are used as they are. Raises ImageError for a DSM that cannot be used, SceneError
    for such a scene, OverlapError where none overlaps another, EmptyResultError where none has a height,
    WorkspaceError, OutOfMemoryError and ClusterError.
    """
    for path in filter(None, (options.output, options.sources)):
        require_tiles_place(path)
    with kept_workers(), kept_until_done(Path(kept_folder(options.output)), "mosaic", progress) as kept:
        folder = kept / _key(options, parameters)
        drop_others(kept, folder)
        return _run(options, str(ensure_folder(str(folder))), progress, parameters)


def _run(options: MosaicOptions, folder: str, progress: Progress, parameters: EngineParameters) -> MosaicResult:
    start, progress = time.monotonic(), Recorder(progress)
    entries = entries_of(options.dsms, options.confidences)
    warn_all(progress, surface_findings(entries, "it would count twice"))
    count = len(options.dsms) + len(options.scenes)
    fused = _FUSION_SHARE * len(options.scenes) / count
    surfaces = _surfaces(options, entries, folder, Part(progress, 0.0, fused), parameters)
    whole, progress_of = progress, Part(progress, fused, 1.0)
    layout = layout_of(options, surfaces, progress)
    (rows, columns), cell = layout.grid.shape, layout.grid.cell
    datum = f"heights above the {layout.datum.name}" if layout.datum else "a vertical datum that is unknown"
    progress.info(f"Mosaic of {len(layout.dsms)} DSMs: {columns} x {rows} cells of {cell:g} m, {datum}.")
    require_space("the mosaic", mosaic_needs(options, rows * columns, folder), progress)
    overlaps = _overlaps(options, layout, parameters.mosaic, Part(progress_of, 0.0, 0.2))
    fixed = [number for number, dsm in enumerate(layout.dsms) if dsm.fixed]
    _require_like_heights(layout, overlaps, parameters.mosaic.offsets)
    stated = [dsm.deviation for dsm in layout.dsms]
    offsets = solve_offsets(len(layout.dsms), overlaps, fixed, parameters.mosaic.offsets, stated)
    _log(layout, overlaps, offsets, progress)
    _name_large(layout, offsets, parameters.mosaic.offsets, progress)
    _name_unexpected(layout, overlaps, parameters.mosaic.offsets, progress)
    _name_displaced(layout, overlaps, parameters.mosaic.offsets, progress)
    parts = _sources(options, layout, overlaps, offsets, folder, parameters.mosaic, Part(progress_of, 0.2, 0.3))
    blocks = _blocks(options, layout, parts, folder, parameters.mosaic, Part(progress_of, 0.3, 0.9))
    cells: Dict[int, int] = Counter()
    for block in blocks:
        cells.update(block.cells)
    valid = sum(cells.values())
    if not valid:
        raise EmptyResultError(f"No cell of the mosaic has a height (cells: {rows * columns}): check the DSMs.")
    rasters, writing = rasters_of(options, layout), Part(progress_of, 0.9, 0.98)
    write_mosaic(
        rasters,
        layout.grid,
        blocks,
        folder=folder,
        workers=options.workers,
        parameters=parameters.mosaic,
        progress=writing,
    )
    seam = _median(blocks)
    if seam is not None:
        progress.info(f"Along the seams, two DSMs differ by {seam:.3f} m (median) before their heights are blended.")
    left = left_differences(overlaps, offsets)
    warn_all(whole, [*verdict.of_mosaic(left), *(finding for each in overlaps for finding in each.findings)])
    if options.report:
        page = mosaic_page(options, layout, overlaps, offsets=offsets, left=left, cells=cells, seam=seam)
        page.of(mosaic_name(options.output, (*options.dsms, *options.scenes))).write(options.report, whole)
    progress.step(1.0, "Mosaic made")
    return MosaicResult(
        output=options.output,
        sources=options.sources,
        report=options.report,
        offsets=tuple(
            DsmOffset(dsm=dsm.name, added=float(added), deviation=float(deviation))
            for dsm, added, deviation in zip(layout.dsms, offsets.added, offsets.deviation)
        ),
        groups=len(offsets.groups),
        overlaps=len(overlaps),
        seam=seam,
        valid_percent=100.0 * valid / (rows * columns),
        vertical_datum=layout.datum.name if layout.datum else None,
        seconds=round(time.monotonic() - start, 3),
    )


def _key(options: MosaicOptions, parameters: EngineParameters) -> str:
    """The fingerprint of all that the mosaic's cells depend on."""
    rasters = [raster_identity(path) if path else [] for path in (*options.dsms, *options.confidences)]
    scenes = [file_identity(path) for path in options.scenes]
    chosen = options.resolution, options.crs, sorted(map(real_path, options.fixed))
    return fingerprint("mosaic", rasters, scenes, chosen, *parameters.in_fingerprint())


# The DSMs, and those of scenes ------------------------------------------------------------------------------------


def _surfaces(
    options: MosaicOptions, entries: Sequence[Entry], folder: str, progress: Progress, parameters: EngineParameters
) -> List[Surface]:
    """The DSMs in their order, and then the scenes, each of which is fused."""
    named = {real_path(path) for path in options.fixed}

    def fixed(path: str) -> str:
        return "named in FIXED" if real_path(path) in named else ""

    found = [Surface(each.path, each.path, each.confidence, fixed(each.path) or _stated(each.path)) for each in entries]
    placed = [_placed(path, progress) for path in options.scenes]  # scenes that cannot be fused are refused at once
    layout = layout_of(options, found, Silent()) if found and options.scenes else None
    for number, path in enumerate(options.scenes):
        if layout:
            require_datum_of_scenes(options, layout)
        low, high = number / len(options.scenes), (number + 1) / len(options.scenes)
        part = Part(progress, low, high, os.path.basename(os.path.dirname(os.path.abspath(path))))
        dsm, confidence = (f"{folder}/scene_{number}{kind}.tif" for kind in ("", "_confidence"))
        if os.path.exists(dsm) and os.path.exists(confidence):
            part.info(f"Reused the DSM of '{path}' that an earlier run had finished.")
        else:
            cells: Keywords = {"resolution": options.resolution, "crs": options.crs}
            if layout:
                cells = {"resolution": layout.grid.cell, "crs": options.crs or _crs_text(layout)}
            cells.update(workers=options.workers, memory=options.memory)
            part.info(f"Fusing the scene '{path}'.")
            dsmfuse.run(DsmFuseOptions(scene=path, output=dsm, confidence=confidence, **cells), part, parameters)
        why = fixed(path) or placed[number]
        found.append(Surface(path, dsm, confidence, why))
        layout = layout or layout_of(options, found, Silent())
    return found


def _placed(path: str, progress: Progress) -> str:
    """How a scene's absolute position was determined; raises SceneError for one that cannot be fused."""
    progress.check_cancelled()
    return dsmfuse.reconstructed(path).placed


def _stated(path: str) -> str:
    """How the absolute position of a DSM of this plugin was determined, as it states; "" for other files."""
    try:
        with opened(path) as dataset:
            tag = as_text(dataset.GetMetadataItem(PLACED_TAG) or "")
    except ImageError:  # reported where the layout is made
        return ""
    return tag if tag in PLACED else ""


def _crs_text(layout: Layout) -> str:
    """A layout's CRS as scenes name theirs."""
    crs = pyproj.CRS.from_wkt(layout.crs)
    authority = crs.to_authority()
    return ":".join(authority) if authority and pyproj.CRS.from_authority(*authority) == crs else layout.crs


# The mosaic -------------------------------------------------------------------------------------------------------


def _overlaps(
    options: MosaicOptions, layout: Layout, parameters: MosaicParameters, progress: Progress
) -> List[Overlap]:
    """The differences of all DSMs that overlap; raises OverlapError where none does."""
    tasks = pair_tasks(layout, parameters.offsets)
    measured = run_tasks(
        measure_pair,
        tasks,
        options.workers,
        progress,
        lambda task: f"comparing DSMs {task.numbers[0] + 1} and {task.numbers[1] + 1}",
    )
    found = [overlap for overlap in measured if overlap is not None]
    if not found:
        least = parameters.offsets.least_cells
        raise OverlapError(
            f"No two of the {len(layout.dsms)} DSMs have heights in {least} common cells: choose DSMs that overlap, or "
            "correct a wrongly assigned CRS."
        )
    return found


def _sources(
    options: MosaicOptions,
    layout: Layout,
    overlaps: Sequence[Overlap],
    offsets: Offsets,
    folder: str,
    parameters: MosaicParameters,
    progress: Progress,
) -> List[Source]:
    """The DSMs as blocks need them, with the maps of how far inside each a place lies."""
    tasks = [InteriorTask(dsm, f"{folder}/interior_{i}.tif", parameters) for i, dsm in enumerate(layout.dsms)]
    maps = run_tasks(
        write_interior, tasks, options.workers, progress, lambda task: f"borders of {os.path.basename(task.dsm.name)}"
    )
    found = []
    for number, (dsm, path) in enumerate(zip(layout.dsms, maps)):
        # Two DSMs of the same quality share the spread of their differences.
        spreads = [each.nmad / 2**0.5 for each in overlaps if number in (each.first, each.second)]
        error = float(np.median(spreads)) if spreads else parameters.seams.unknown_error_m
        found.append(Source(number, dsm, path, float(offsets.added[number]), error))
    return found


def _blocks(
    options: MosaicOptions,
    layout: Layout,
    parts: Sequence[Source],
    folder: str,
    parameters: MosaicParameters,
    progress: Progress,
) -> List[Block]:
    tasks = block_tasks(layout, parts, folder, parameters)
    largest = max(tasks, key=block_mib)
    over = f"a block of {largest.own.width} cells a side with {counted(len(largest.sources), 'DSM')}"
    work = Work(over, block_mib(largest), lambda _: "take fewer DSMs that overlap, or a larger RESOLUTION")
    workers = workers_within(options.workers, work, options.memory, progress)
    blocks = run_tasks(make_block, tasks, workers, progress, lambda task: "making the mosaic")
    reused = sum(block.reused for block in blocks)
    if reused:
        progress.info(f"Reused {reused} of {counted(len(blocks), 'block')} that an earlier run had finished.")
    return blocks


def _median(blocks: Sequence[Block]) -> Optional[float]:
    """The median of the steps along all seams, m; None where there is no seam."""
    steps: IntArray = np.zeros(STEP_BINS, np.int64)
    for block in blocks:
        steps[: len(block.steps)] += block.steps
    total = np.cumsum(steps)
    if not total[-1]:
        return None
    return float((np.searchsorted(total, total[-1] / 2.0) + 0.5) * STEP_M)


def _require_like_heights(layout: Layout, overlaps: Sequence[Overlap], parameters: OffsetParameters) -> None:
    """Raise ImageError where two DSMs differ by more than any vertical datum explains: one offset would move the good
    one as far as the wrong one."""
    worst = max(overlaps, key=lambda each: abs(each.median), default=None)
    if worst is not None and abs(worst.median) > parameters.apart_m:
        first, second = (layout.dsms[number].name for number in (worst.first, worst.second))
        raise ImageError(
            f"The heights of '{first}' and '{second}' differ by {abs(worst.median):.0f} m where both have some, which "
            f"no vertical datum explains (at most {parameters.apart_m:g} m): check the unit and scale of both, or "
            "leave one out."
        )


def _name_large(layout: Layout, offsets: Offsets, parameters: OffsetParameters, progress: Progress) -> None:
    """Warn of DSMs that are moved by more than usual."""
    moved = [
        f"'{dsm.name}' ({added:+.1f} m)"
        for dsm, added in zip(layout.dsms, offsets.added)
        if abs(added) > parameters.most_m
    ]
    if moved:
        progress.warn(
            Finding(
                "dsm-moved-far",
                f"DSMs are moved by more than {parameters.most_m:g} m: {', '.join(moved)}; check their vertical "
                "datums and units, and name those that are right in FIXED.",
            )
        )


def _name_unexpected(
    layout: Layout, overlaps: Sequence[Overlap], parameters: OffsetParameters, progress: Progress
) -> None:
    """Warn of DSMs that differ by more than the uncertainties of their absolute heights explain, which both state."""
    found = []
    for each in overlaps:
        first, second = layout.dsms[each.first], layout.dsms[each.second]
        if first.deviation is None or second.deviation is None:
            continue
        by, most = abs(each.median), math.hypot(first.deviation, second.deviation, parameters.other_m)
        if by > parameters.unexpected * most:
            most *= parameters.unexpected
            found.append((-by, f"'{first.name}' and '{second.name}' by {by:.1f} m (expected: at most {most:.1f} m)"))
    if found:
        names = ", ".join(text for _, text in sorted(found)[:_FEW])
        more = f", and {counted(len(found) - _FEW, 'pair')} more" if len(found) > _FEW else ""
        progress.warn(
            Finding(
                "dsms-contradict",
                f"Heights of DSMs differ by more than their stated uncertainties explain: {names}{more}; check the "
                "RPCs, ground control and vertical datums of both, and name those that are right in FIXED.",
            )
        )


def _name_displaced(
    layout: Layout, overlaps: Sequence[Overlap], parameters: OffsetParameters, progress: Progress
) -> None:
    """Warn of DSMs that are horizontally displaced from each other: an offset of their heights does not correct
    that."""
    most = max(parameters.most_displaced_m, parameters.most_displaced_cells * layout.grid.cell)
    displaced = sorted(
        (float(-np.hypot(*each.displaced)), layout.dsms[each.first].name, layout.dsms[each.second].name)
        for each in overlaps
        if each.displaced is not None and np.hypot(*each.displaced) > most
    )
    if displaced:
        names = ", ".join(f"'{first}' and '{second}' by {-by:.1f} m" for by, first, second in displaced[:_FEW])
        more = f", and {counted(len(displaced) - _FEW, 'pair')} more" if len(displaced) > _FEW else ""
        progress.warn(
            Finding(
                "dsms-displaced",
                f"DSMs are displaced horizontally: {names}{more}; a mosaic only moves heights, so register them "
                "(repm:register), or check their CRS.",
            )
        )


def _log(layout: Layout, overlaps: Sequence[Overlap], offsets: Offsets, progress: Progress) -> None:
    """Log the solution, a line for each DSM, with the notes that the user needs."""
    for number, dsm in enumerate(layout.dsms):
        count = counted(sum(number in (each.first, each.second) for each in overlaps), "overlap")
        added, deviation = offsets.added[number], offsets.deviation[number]
        solved = f"{added:+.3f} m are added (standard deviation {deviation:.3f} m)"
        stays = f"its heights are fixed ({dsm.fixed})"
        progress.info(f"'{dsm.name}': {stays if dsm.fixed else solved}, {count}.")
    before, after = (
        np.sqrt(np.mean(np.square(values)))
        for values in ([each.median for each in overlaps], [each.after(offsets.added) for each in overlaps])
    )
    found = f"{counted(len(overlaps), 'overlap')}: median differences of {before:.3f} m (root mean square)"
    progress.info(f"{found} before and {after:.3f} m after the offsets.")
    if not any(offsets.anchored):
        weighted = all(dsm.deviation is not None for dsm in layout.dsms)
        how = ", each weighted by its stated uncertainty" if weighted else ""
        progress.info(f"No DSM is fixed (FIXED is empty), so the mean of all offsets is zero{how}.")
    if len(offsets.groups) > 1:
        names = [", ".join(os.path.basename(layout.dsms[i].name) for i in group) for group in offsets.groups]
        text = f"The DSMs form {len(names)} groups that do not overlap ({'; '.join(names)})"
        progress.warn(
            Finding(
                "dsms-in-groups",
                f"{text}: each group has its own solution, and heights of different groups may differ by an offset.",
            )
        )
