"""Apply edits to a DSM: what an analyst removed, filled, flattened or drew is applied in the order of the records.

The original stays as it is, and the edited DSM is made of it and the records alone: an edit is undone by deleting or
disabling its record. The product's metadata hold the records and what identifies the original.
"""

from __future__ import annotations

import json
import os
from contextlib import ExitStack
from dataclasses import replace
from typing import Dict, List, Optional, Tuple

import numpy as np

from ..contracts.checks import as_text
from ..contracts.documents import Keywords
from ..contracts.findings import Finding, as_percent
from ..contracts.options import EditDsmOptions
from ..contracts.products import product
from ..contracts.results import EditDsmResult
from ..editing.apply import Surface
from ..editing.edits import Edits, read_edits
from ..editing.parameters import EDITING, EditingParameters
from ..editing.session import ORIGIN
from ..editing.shapes import height_findings, shapes_of
from ..evaluation.grids import Grid
from ..geometry.cell_grid import overlapping_blocks
from ..geometry.vertical import DEVIATION_TAG
from ..imagery import raster
from ..imagery.confidence import CONFIDENCE_BANDS, SOURCE_BAND, ConfidenceBands, confidence_bands
from ..imagery.heights import read_heights
from ..planning.disk_space import editing_needs, require_space
from ..reports.styles import write_style
from ..runtime.progress import Part, Progress, counted, warn_all
from ..runtime.workspace import fingerprint
from ..terrain.inputs import surface_of

_COPIED = 0.4  # of the progress


def run(options: EditDsmOptions, progress: Progress, parameters: EditingParameters = EDITING) -> EditDsmResult:
    """Copy the DSM, apply the edits that are enabled, and write the result.

    Raises ImageError for a DSM or a confidence raster that cannot be used, InputTableError for an invalid record,
    EmptyResultError for an edit that finds no heights to use, and WorkspaceError.
    """
    surface = surface_of(options.dsm, options.confidence)
    warn_all(progress, surface.findings)
    grid = Grid(options.dsm, surface.size, surface.transform, surface.crs)
    edits = read_edits(options.edits)
    shapes = shapes_of(edits, grid, surface.cell)
    warn_all(progress, height_findings(options.dsm, edits, grid, shapes, parameters))
    named = _confidence(options)
    if not shapes:
        text = f"No edit of '{options.edits}' is enabled, so the DSM stays as it is: set the field 'enabled' to 1."
        progress.warn(Finding("edits-none", text))
    cells = surface.size[0] * surface.size[1]
    require_space("the edited surface", editing_needs(options, cells, len(named[1]) if named else 0), progress)
    tags = {**_kept(options.dsm), **surface.tags, **_origin(options.dsm, edits)}
    counts: List[int] = []
    with ExitStack() as stack:
        frame = raster.RasterFrame(surface.size[::-1], np.float32, 1, surface.transform, surface.crs)
        facts: Keywords = {"metadata": tags, "cog": True, "compress": False}
        name = f"height above the {surface.datum.name} (m)" if surface.datum else "height (m)"
        heights = stack.enter_context(raster.created(options.output, frame, descriptions=(name,), unit="m", **facts))
        confidence: Optional[Tuple[raster.RasterWriter, int, ConfidenceBands]] = None
        if named and options.edited_confidence:
            meaning, names = named
            facts["overviews"] = "NEAREST"
            several = replace(frame, bands=len(names))
            made = raster.created(options.edited_confidence, several, descriptions=names, **facts)
            confidence = stack.enter_context(made), len(names), meaning
        _copy(options, heights, confidence, Part(progress, 0.0, _COPIED), parameters)
        records: Dict[str, str] = {}
        edited = Surface(grid, heights, confidence, progress, parameters)
        for number, (edit, shape) in enumerate(shapes):
            progress.step(_COPIED + (0.9 - _COPIED) * number / len(shapes), f"edit {number + 1} of {len(shapes)}")
            applied = edited.apply(edit, shape)
            counts.append(applied.cells)
            if not applied.cells:
                text = f"Edit {edit.number} covers no cell of the DSM: it changes nothing."
                progress.warn(Finding("edit-outside", text))
            if edit.operation != "fill" and applied.cells > parameters.most_edited * cells:
                text = f"Edit {edit.number} replaces or removes {as_percent(applied.cells / cells)} of the DSM's cells"
                progress.warn(Finding("edit-large", f"{text}: check its polygon.", "doubt"))
            found = {**edit.record(), "cells": applied.cells}
            if applied.level is not None:
                found["level"] = applied.level
                progress.info(f"Edit {edit.number}: the water is at {applied.level:.2f} m.")
            records[f"EDIT_{number + 1}"] = json.dumps(found, sort_keys=True)
        for writer in [heights, *([confidence[0]] if confidence else [])]:
            writer.set_metadata({**tags, **records})
        progress.step(0.9, "writing the edited DSM")
    for name in ("output", "edited_confidence"):
        if getattr(options, name):
            write_style(product("editdsm", name).style, getattr(options, name))
    progress.info(f"{counted(len(counts), 'edit')} applied to {counted(sum(counts), 'cell')}.")
    progress.step(1.0, "Edited")
    return EditDsmResult(
        output=options.output,
        edited_confidence=options.edited_confidence,
        edits=len(counts),
        edited_cells=sum(counts),
        vertical_datum=surface.datum.name if surface.datum else None,
    )


def _kept(dsm: str) -> Dict[str, str]:
    """The DSM's metadata about its scene, days and datum."""
    with raster.opened(dsm) as dataset:
        tags = {as_text(name): as_text(value) for name, value in (dataset.GetMetadata() or {}).items()}
    return {name: value for name, value in tags.items() if name.startswith("REPM_") or name == DEVIATION_TAG}


def _origin(dsm: str, edits: Edits) -> Dict[str, str]:
    """What identifies the original and the records, wherever their files lie."""
    applied = [edit.record() for edit in edits.edits if edit.enabled]
    return {
        ORIGIN: os.path.basename(dsm),
        "EDITED_FROM_CONTENT": raster.content_of(dsm),
        "EDITS": str(len(applied)),
        "EDITS_CRS": edits.crs,
        "EDITS_FINGERPRINT": fingerprint(applied, edits.crs),
    }


def _confidence(options: EditDsmOptions) -> Optional[Tuple[ConfidenceBands, Tuple[str, ...]]]:
    """The meaning and the names of the bands of the confidence raster; None where it is not to be written."""
    if not options.confidence or not options.edited_confidence:
        return None
    with raster.opened(options.confidence) as dataset:
        meaning = confidence_bands(dataset, "CONFIDENCE")
        bands = range(1, dataset.RasterCount + 1)
        names = [str(dataset.GetRasterBand(band).GetDescription()) for band in bands]
    if meaning.source:
        names[meaning.source - 1] = CONFIDENCE_BANDS[SOURCE_BAND - 1]
    return meaning, tuple(names)


def _copy(
    options: EditDsmOptions,
    heights: raster.RasterWriter,
    confidence: Optional[Tuple[raster.RasterWriter, int, ConfidenceBands]],
    progress: Progress,
    parameters: EditingParameters,
) -> None:
    """Copy the DSM and its confidence as they are, in blocks."""
    with ExitStack() as stack:
        source = stack.enter_context(raster.opened(options.dsm))
        stated = stack.enter_context(raster.opened(str(options.confidence))) if confidence else None
        size = source.RasterXSize, source.RasterYSize
        blocks = [own for own, _ in overlapping_blocks(size, parameters.block_cells)]
        for number, own in enumerate(blocks):
            progress.check_cancelled()
            progress.step(number / len(blocks), "copying the DSM")
            heights.write(read_heights(source, own), own.col, own.row)
            if confidence and stated is not None:
                for band in range(1, confidence[1] + 1):
                    confidence[0].write(raster.read(stated, own, band), own.col, own.row, band)
            if own.col + own.width == size[0]:
                for writer in [heights, *([confidence[0]] if confidence else [])]:
                    writer.flush()  # so that GDAL's cache does not grow
