"""Put many DSMs together to one, without steps between them."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from .. import __version__
from ..arrays import IntArray
from ..disk_space import mosaic_needs, require_space
from ..errors import EmptyResultError, OverlapError
from ..evaluation.styles import write_style
from ..geometry.vertical import TAG
from ..imagery.raster import RasterWriter, created
from ..memory import workers_within
from ..mosaic.blocks import (
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
from ..mosaic.inputs import Layout, layout_of
from ..mosaic.offsets import Offsets, Overlap, solve_offsets
from ..mosaic.page import mosaic_page
from ..mosaic.parameters import MosaicParameters
from ..options import MosaicOptions
from ..parallel import kept_workers, run_tasks
from ..products import paths_of
from ..progress import Part, Progress, Recorder, counted
from ..workspace import temporary_folder
from .parameters import ENGINE, EngineParameters

SOURCE_BANDS = (
    "number of the DSM that the height is from, in the order given, from 1",
    "DSMs that have a height",
    "standard deviation between them (m)",
)


def run(options: MosaicOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> Dict[str, Any]:
    """Solve the offsets, make the mosaic block by block, and write it; gives the offsets and the products' paths.

    Raises ImageError for a DSM that cannot be used, OverlapError where none overlaps another, EmptyResultError where
    none has a height, WorkspaceError, OutOfMemoryError and ClusterError.
    """
    start, progress = time.monotonic(), Recorder(progress)
    layout = layout_of(options, progress)
    (rows, columns), cell = layout.grid.shape, layout.grid.cell
    datum = f"heights above the {layout.datum.name}" if layout.datum else "a vertical datum that is unknown"
    progress.info(f"Mosaic of {len(layout.dsms)} DSMs: {columns} x {rows} cells of {cell:g} m, {datum}.")
    require_space("the mosaic", mosaic_needs(options, rows * columns), progress)
    with kept_workers(), temporary_folder(options.output) as folder:
        overlaps = _overlaps(options, layout, parameters.mosaic, Part(progress, 0.0, 0.2))
        fixed = {os.path.realpath(path) for path in options.fixed}
        numbers = [number for number, dsm in enumerate(layout.dsms) if os.path.realpath(dsm.path) in fixed]
        offsets = solve_offsets(len(layout.dsms), overlaps, numbers, parameters.mosaic.offsets)
        _log(layout, overlaps, offsets, numbers, progress)
        parts = _sources(options, layout, overlaps, offsets, folder, parameters.mosaic, Part(progress, 0.2, 0.3))
        blocks = _blocks(options, layout, parts, folder, parameters.mosaic, Part(progress, 0.3, 0.9))
        cells = {n: sum(block.cells.get(n, 0) for block in blocks) for n in range(len(layout.dsms))}
        valid = sum(cells.values())
        if not valid:
            raise EmptyResultError(f"None of the {rows * columns} cells of the mosaic has a height: check the DSMs.")
        progress.step(0.9, "Writing the mosaic")
        _write(options, layout, blocks, progress)
    for product, path in paths_of("mosaic", options):
        if product.style:
            write_style(product.style, path)
    seam = _median(np.sum([block.steps for block in blocks], axis=0))
    if seam is not None:
        progress.info(f"Along the seams, two DSMs are {seam:.3f} m apart (median) before heights are feathered.")
    if options.report:
        page = mosaic_page(options, layout, overlaps, offsets, cells, seam, progress.warnings)
        page.write(options.report)
    progress.step(1.0, "Mosaic made")
    return {
        "output": options.output,
        "sources": options.sources,
        "report": options.report,
        "offsets": [
            {"dsm": dsm.path, "added": float(added), "deviation": float(deviation)}
            for dsm, added, deviation in zip(layout.dsms, offsets.added, offsets.deviation)
        ],
        "groups": len(offsets.groups),
        "overlaps": len(overlaps),
        "seam": seam,
        "valid_percent": 100.0 * valid / (rows * columns),
        "vertical_datum": layout.datum.name if layout.datum else None,
        "seconds": round(time.monotonic() - start, 3),
    }


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
        write_interior, tasks, options.workers, progress, lambda task: f"borders of {os.path.basename(task.dsm.path)}"
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
    each, side = max(block_mib(task) for task in tasks), max(task.own.width for task in tasks)
    workers = workers_within(options.workers, each, options.memory, side, progress)
    return run_tasks(make_block, tasks, workers, progress, lambda task: "making the mosaic")


def _write(options: MosaicOptions, layout: Layout, blocks: Sequence[Block], progress: Progress) -> None:
    """Write the products from the blocks, which go one after the other."""
    facts: Dict[str, object] = {"REPM_ENGINE": __version__, "REPM_MOSAIC": len(layout.dsms)}
    if layout.datum:
        facts[TAG] = layout.datum.name
    names = {f"DSM_{number}": dsm.path for number, dsm in enumerate(layout.dsms, start=1)}
    height = f"height above the {layout.datum.name} (m)" if layout.datum else "height (m)"
    shape, place = layout.grid.shape, layout.grid.geotransform
    with ExitStack() as stack:

        def raster(path: str, bands: Tuple[str, ...], crs: str, tags: Dict[str, object], **more: Any) -> RasterWriter:
            frame = shape, np.dtype(np.float32), len(bands), place, crs
            return stack.enter_context(created(path, *frame, descriptions=bands, metadata=tags, cog=True, **more))

        output = raster(options.output, (height,), layout.file_crs, facts, unit="m")
        sources = None
        if options.sources:
            sources = raster(options.sources, SOURCE_BANDS, layout.crs, {**facts, **names}, overviews="NEAREST")
        for index, block in enumerate(blocks):
            progress.check_cancelled()
            progress.step(0.9 + 0.08 * index / len(blocks))
            if block.path is None:
                continue
            with np.load(block.path, allow_pickle=False) as made:
                output.write(made["height"], block.own.col, block.own.row)
                if sources is not None:
                    known = made["source"] >= 0
                    for band, values in enumerate((made["source"] + 1, made["count"], made["spread"]), start=1):
                        stated = np.where(known, values, np.nan).astype(np.float32)
                        sources.write(stated, block.own.col, block.own.row, band)
            os.unlink(block.path)
            if block.own.col + block.own.width == layout.grid.size[0]:
                for writer in filter(None, (output, sources)):
                    writer.flush()  # so that GDAL's cache does not grow


def _median(steps: IntArray) -> Optional[float]:
    """The median of a histogram of steps, m; None where there is no seam."""
    total = np.cumsum(steps)
    if not total[-1]:
        return None
    return float((np.searchsorted(total, total[-1] / 2.0) + 0.5) * STEP_M)


def _log(
    layout: Layout, overlaps: Sequence[Overlap], offsets: Offsets, fixed: Sequence[int], progress: Progress
) -> None:
    """What was solved, a line for each DSM, and what the user has to know of it."""
    for number, dsm in enumerate(layout.dsms):
        count = counted(sum(number in (each.first, each.second) for each in overlaps), "overlap")
        added, deviation = offsets.added[number], offsets.deviation[number]
        solved = f"{added:+.3f} m are added (standard deviation {deviation:.3f} m)"
        progress.info(f"'{dsm.path}': {'its heights are fixed' if number in fixed else solved}, {count}.")
    before, after = (
        np.sqrt(np.mean(np.square(values)))
        for values in ([each.median for each in overlaps], [each.after(offsets.added) for each in overlaps])
    )
    found = f"{counted(len(overlaps), 'overlap')}: median differences of {before:.3f} m (root mean square)"
    progress.info(f"{found} before and {after:.3f} m after the offsets.")
    if not any(offsets.anchored):
        progress.info("No DSM is named as FIXED: the mean of all offsets is zero.")
    if len(offsets.groups) > 1:
        names = [", ".join(os.path.basename(layout.dsms[i].path) for i in group) for group in offsets.groups]
        text = f"The DSMs are {len(names)} groups that do not overlap each other ({'; '.join(names)})"
        progress.warn(f"{text}: each is solved for itself, and heights of two groups may differ by an offset.")
