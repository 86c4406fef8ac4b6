"""The page: facts, heights and draped rasters as text inside it, with the script that draws them.

Heights are whole numbers of 16 bit, each stored as its difference from the one to the left, low bytes before high
bytes, deflated; values of other rasters have 8 bit. Both are read again by ``resources/viewer/contents.js``.
"""

from __future__ import annotations

import base64
import math
import os
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional

import numpy as np
from osgeo import gdal

from .. import __version__
from ..contracts.arrays import ByteImage, FloatImage
from ..contracts.checks import as_text
from ..contracts.errors import EmptyResultError
from ..contracts.options import ViewerOptions
from ..contracts.products import STYLES
from ..evaluation.grids import Grid, metres_per_unit
from ..gate.companions import draped_findings, error_findings
from ..geometry.frames import flat_crs, vertical_part
from ..geometry.vertical import TAG
from ..imagery import raster
from ..names import surface_title
from ..reports.pictures import RAMPS, jpeg_bytes, percentile_range
from ..reports.styles import value_range
from ..reports.templates import RESOURCES, Drawing, page
from ..runtime.progress import Progress, warn_all
from ..runtime.translation import reader
from ..runtime.workspace import write_text
from .parameters import VIEWER, ViewerParameters
from .script import joined
from .surface import page_grid, read_draped, read_on, without_holes

_COLOURS = (gdal.GCI_RedBand, gdal.GCI_GreenBand, gdal.GCI_BlueBand)
_MOST_LEVELS = 65_534.0  # of a height
_VALUES = 254.0  # of a draped raster; 0 is none


@dataclass(frozen=True)
class ViewerFacts:
    """A written page: its ``cells`` (columns, rows), how many times larger than the DSM's they are, and its bytes."""

    cells: tuple[int, int]
    factor: float
    size: int


def write_viewer(
    options: ViewerOptions, progress: Progress, parameters: ViewerParameters = VIEWER, name: str = ""
) -> ViewerFacts:
    """Write the page of a DSM, whole or not at all; ``name`` is the subject of the page, "" for the name in its file.

    Raises ImageError for a raster that cannot be read, EmptyResultError for a DSM without heights, OverlapError for
    a raster of another place, MissingPackageError without jinja2, WorkspaceError where the page cannot be written.
    """
    with raster.opened(options.dsm) as dataset:
        whole = Grid.of(dataset)
        cells = page_grid(whole, options.cells, parameters)
        heights = read_on(dataset, cells, 1, progress.check_cancelled, parameters)
        tag = as_text(dataset.GetMetadataItem(TAG) or "")
    if not np.isfinite(heights).any():
        raise EmptyResultError(f"The DSM '{options.dsm}' has no heights: there is nothing to show in a page.")
    layers = [_elevation(heights)]
    for kind, path in (
        ("ortho", options.ortho),
        ("confidence", options.confidence),
        ("dsm_error", options.difference),
    ):
        if path:
            with raster.opened(path) as dataset:
                layers.append(_draped(kind, dataset, cells, heights, progress, parameters))
    factor = whole.size[0] / cells.size[0]
    facts = {
        "size": list(cells.size),
        "layers": layers,
        **_place(cells, tag),
        **_packed(heights, parameters),
    }
    progress.check_cancelled()
    text = page(
        "viewer.html",
        language=reader().language,
        title=name or surface_title(options.dsm) or Path(options.dsm).stem,
        version=__version__,
        facts=facts,
        script=Drawing(joined(RESOURCES / "viewer" / "page.js")),
        whole=list(whole.size),
        means=factor > 1 + 1e-9 or cells.size != whole.size,
        cell=_rounded(cells.transform[1]),
        whole_cell=_rounded(math.hypot(whole.transform[1], whole.transform[4])),
    )
    write_text(str(options.viewer), text)
    return ViewerFacts(cells.size, factor, os.path.getsize(str(options.viewer)))


def _place(cells: Grid, tag: Optional[str]) -> Dict[str, object]:
    """Where the cells lie: their corner and size in units of the CRS, their size in metres, and the heights' datum."""
    x, step_x, _, y, _, step_y = cells.transform
    metres = metres_per_unit(cells)
    crs = cells.crs if cells.wkt else None
    name, datum = "", tag or ""
    if crs is not None:
        flat = flat_crs(crs)
        authority = flat.to_authority()
        name = f"{flat.name} ({':'.join(authority)})" if authority else flat.name
        datum = tag or vertical_part(crs) or ""
    return {
        "corner": [x, y],
        "step": [step_x, step_y],
        "cell_m": [abs(step_x) * metres[0], abs(step_y) * metres[1]],
        "decimals": int(np.clip(1 - math.floor(math.log10(abs(step_x)) + 1e-6), 0, 8)),
        "crs": name,
        "datum": datum,
    }


def _packed(heights: FloatImage, parameters: ViewerParameters) -> Dict[str, object]:
    """Heights in 16 bit, and which cells have one."""
    good = np.isfinite(heights)
    low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
    quantum = max(parameters.quantum_m, (high - low) / _MOST_LEVELS)
    levels = np.rint((without_holes(heights) - np.float32(low)) / np.float32(quantum))
    packed = {"heights": _deflated(_differences(np.clip(levels, 0, 65535).astype(np.uint16)), parameters)}
    packed["mask"] = "" if good.all() else _deflated(np.packbits(good).tobytes(), parameters)
    return {"low": low, "quantum": quantum, **packed}


def _differences(levels: "np.ndarray[Any, np.dtype[np.uint16]]") -> bytes:
    """Each level minus the one to its left (of the first column, the one above), low bytes first, then high bytes."""
    found = levels.copy()
    found[:, 1:] -= levels[:, :-1]
    found[1:, 0] -= levels[:-1, 0]
    return (found & 0xFF).astype(np.uint8).tobytes() + (found >> 8).astype(np.uint8).tobytes()


def _deflated(data: bytes, parameters: ViewerParameters) -> str:
    return base64.b64encode(zlib.compress(data, parameters.level)).decode("ascii")


def _elevation(heights: FloatImage) -> Dict[str, object]:
    low, high = percentile_range(heights)
    return {"kind": "dsm", "ramp": list(RAMPS["elevation"]), "low": low, "high": high}


def _draped(
    kind: str,
    dataset: gdal.Dataset,
    cells: Grid,
    heights: FloatImage,
    progress: Progress,
    parameters: ViewerParameters,
) -> Dict[str, object]:
    """A raster as the page shows it over its heights: a picture, or values with their colours."""

    def values_of(band: int) -> FloatImage:
        return read_draped(dataset, cells, band, progress.check_cancelled, parameters)

    if kind == "ortho":
        byte = dataset.GetRasterBand(1).DataType == gdal.GDT_Byte
        bands = [values_of(band) for band in _bands(dataset)]
        warn_all(progress, draped_findings(cells.path, dataset.GetDescription(), heights, bands, kind))
        picture = np.stack([_grey(values, byte) for values in bands], axis=-1)
        data = base64.b64encode(jpeg_bytes(picture, parameters.jpeg_quality)).decode("ascii")
        return {"kind": kind, "picture": data}
    style = next(style for style in STYLES if style.kind == kind)
    band = style.band if style.band <= dataset.RasterCount else 1
    if kind == "confidence":
        with raster.opened(cells.path) as dsm:
            warn_all(progress, error_findings(dsm, dataset, band, "CONFIDENCE"))
    values = values_of(band)
    warn_all(progress, draped_findings(cells.path, dataset.GetDescription(), heights, [values], kind))
    low, high = value_range(kind, values)
    known = np.isfinite(values)
    scaled = np.clip((np.where(known, values, low) - low) / (high - low), 0.0, 1.0)
    stored = np.where(known, 1 + np.rint(_VALUES * scaled), 0).astype(np.uint8)
    packed = _deflated(stored.tobytes(), parameters)
    return {"kind": kind, "ramp": list(RAMPS[style.ramp]), "low": low, "high": high, "values": packed}


def _bands(dataset: gdal.Dataset) -> List[int]:
    """Red, green and blue of a colour image, the first three where it has as many and does not say, else the first."""
    meanings = [dataset.GetRasterBand(band).GetColorInterpretation() for band in range(1, dataset.RasterCount + 1)]
    if all(colour in meanings for colour in _COLOURS):
        return [meanings.index(colour) + 1 for colour in _COLOURS]
    alpha = gdal.GCI_AlphaBand in meanings
    return [1, 2, 3] if dataset.RasterCount - alpha >= 3 else [1]


def _grey(values: FloatImage, byte: bool) -> ByteImage:
    """A band in 8 bit: as it is, or stretched; cells without a value are black."""
    low, high = (0.0, 255.0) if byte else percentile_range(values)
    scaled = np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0, 1)
    grey: ByteImage = np.rint(255 * scaled).astype(np.uint8)
    return grey


def _rounded(length: float) -> str:
    return f"{length:.4g}"
