"""Options that make no sense for these images are refused before any work: dialogs use the same checks as the engine.

Reads RPCs and scene files, nothing else: it takes milliseconds for each image.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Optional

from ..batch.scenes import scenes_of
from ..contracts.errors import OptionError
from ..contracts.file_kinds import is_catalogue
from ..contracts.options import (
    BatchOptions,
    CheckGcpsOptions,
    DsmFuseOptions,
    ExportRpcOptions,
    Options,
    PipelineOptions,
    ReconstructOptions,
    RegisterOptions,
    SampleDataOptions,
)
from ..geometry.vertical import HeightDatum, named_datum
from ..imagery.deliveries import with_images
from ..planning.overlap import views_of
from ..runtime.memory import free_mib
from ..runtime.progress import Silent
from ..scene import GroundSeen, ground_of
from .parameters import ENGINE, EngineParameters, TileParameters

_OF_A_SCENE = DsmFuseOptions, ReconstructOptions, RegisterOptions, CheckGcpsOptions, ExportRpcOptions
_SAMPLE_BYTES = {"urban": 450.0, "mountains": 180.0}  # memory for each px of a sample image; measured at 1000 px


def require_sensible(options: Options, parameters: EngineParameters = ENGINE) -> None:
    """Raise OptionError for cells that are absurd for the images, MissingPackageError for a geoid without its grid, and
    InputTableError for a table of scenes that has what no scene can have.

    Whatever reading images and RPCs raises is raised, too.
    """
    if isinstance(options, SampleDataOptions):
        _require_memory(options)
    if isinstance(options, BatchOptions) and not is_catalogue(options.table or ""):  # whose images would be opened
        scenes_of(options)
    seen = _ground_shown(options, parameters.tiles)
    if seen is None:
        return
    for part in options.parts():
        if isinstance(part, DsmFuseOptions):
            require_cell(part.resolution, seen.side_m, seen.gsd_m, parameters.tiles)
            cell = cell_of(part.resolution, seen.gsd_m, parameters.tiles)
            require_ortho_cell(part.ortho_resolution, cell, seen.gsd_m, parameters.tiles)
            most = _two_digits(parameters.fusion.outliers.most_cells * cell)
            if part.outlier_radius and part.outlier_radius > most:
                reason = f"must be at most {most:g} m, {parameters.fusion.outliers.most_cells:g} cells of the DSM"
                wide = f"{reason}: neighbours farther away are no evidence, and counting them takes hours"
                raise OptionError("OUTLIER_RADIUS", part.outlier_radius, wide)
            HeightDatum.of(part.vertical_datum).require(seen.lon, seen.lat)
        if isinstance(part, (ReconstructOptions, CheckGcpsOptions, ExportRpcOptions)) and part.gcps:
            HeightDatum.of(part.gcp_datum, "GCP_DATUM").require(seen.lon, seen.lat, "GCP_DATUM")
        if isinstance(part, RegisterOptions):
            stated = named_datum(part.reference_datum, "REFERENCE_DATUM")
            if stated is not None:
                stated.require(seen.lon, seen.lat, "REFERENCE_DATUM")


def _require_memory(options: SampleDataOptions) -> None:
    """Raise OptionError for sample images whose surface does not fit into the free memory."""
    free, each = free_mib(), _SAMPLE_BYTES[options.kind] / 2**20
    if free is not None and each * options.size**2 > free:
        most = max(128, 100 * int(math.sqrt(free / each) / 100))
        takes = f"takes about {each * options.size**2 / 1024:.1f} GiB of memory, and {free / 1024:.1f} GiB are free"
        raise OptionError("SIZE", options.size, f"{takes}: choose at most {most} px")


def _ground_shown(options: Options, parameters: TileParameters) -> Optional[GroundSeen]:
    """The ground that the images show; None where a stage has no images, or a scene that the stage itself will
    refuse."""
    if isinstance(options, PipelineOptions):
        options = replace(options, fit=with_images(options.fit, Silent()))  # which refuses one image
        return GroundSeen.of(views_of(options.fit, parameters.least_overlap_px))
    if isinstance(options, _OF_A_SCENE) and options.scene:
        return ground_of(options.scene)
    return None


def require_cell(cell_m: float, side_m: float, gsd_m: float, parameters: TileParameters) -> None:
    """Raise OptionError for cells of a DSM (m, 0: automatic) that are far finer than the images, or coarser than what
    they show, which is ``side_m`` wide at most."""
    if not cell_m:
        return
    finest = _two_digits(parameters.finest_cell_gsd * gsd_m)
    if cell_m < finest:
        raise OptionError(
            "RESOLUTION",
            cell_m,
            f"must be at least {finest:g} m, a quarter of the images' ground sampling distance of {gsd_m:.2g} m: "
            "finer cells add no detail, and take hours; 0 chooses a suitable size",
        )
    if cell_m * parameters.least_cells > side_m:
        coarsest = _two_digits(side_m / parameters.least_cells)
        most = f"must be at most {coarsest:g} m: the ground is {side_m:.0f} m wide at most"
        raise OptionError("RESOLUTION", cell_m, f"{most}, and a DSM needs {parameters.least_cells} cells a side")


def cell_of(resolution: float, gsd_m: float, parameters: TileParameters) -> float:
    """The side of a DSM's cells, m: as asked for, or else of two significant digits, 1.0 m and not 1.0122 m."""
    return resolution or float(f"{parameters.cell_gsd * gsd_m:.2g}")


def require_ortho_cell(ortho_m: float, cell_m: float, gsd_m: float, parameters: TileParameters) -> None:
    """Raise OptionError for cells of an orthophoto (m, 0: automatic) that are far finer than the images, or coarser
    than the cells of its DSM, which are ``cell_m`` wide."""
    if not ortho_m:
        return
    finest = min(_two_digits(parameters.finest_cell_gsd * gsd_m), cell_m)
    if ortho_m < finest:
        raise OptionError(
            "ORTHO_RESOLUTION",
            ortho_m,
            f"must be at least {finest:g} m, a quarter of the images' ground sampling distance of {gsd_m:.2g} m: finer "
            "cells add no detail; 0 takes the images' own",
        )
    if ortho_m > cell_m * (1 + 1e-9):
        raise OptionError(
            "ORTHO_RESOLUTION",
            ortho_m,
            f"must be at most {cell_m:g} m, the DSM's resolution: reduce the finished orthophoto instead "
            "(gdal_translate -r average)",
        )


def _two_digits(value: float) -> float:
    """Rounded down to two significant digits, so that the value which a message proposes is accepted."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / step + 1e-9) * step:.2g}")
