"""Rasters whose voids no nodata value declares: they are read without these, and the log says so."""

from __future__ import annotations

from ..contracts.errors import ImageError, RepmError
from ..contracts.file_kinds import is_catalogue, is_cloud
from ..contracts.findings import Finding, as_percent
from ..contracts.options import Options
from ..imagery.heights import HIGHEST_M, LOWEST_M, stray_numbers
from ..imagery.raster import opened
from ..runtime.progress import Progress

_HEIGHTS = ("dem", "dsm", "dsms", "reference", "before", "after", "others", "dtm")
"""The options that name rasters of heights, beside files of other kinds."""


def name_voids(options: Options, progress: Progress) -> None:
    """Name rasters with numbers that are no heights, and their share: a warning where they cannot be heights, a note
    where they are the usual marks. Raises ImageError where none of them can be a height, as in centimetres."""
    paths = dict.fromkeys(path for name, path in options.read_paths() if name in _HEIGHTS)
    for path in (each for each in paths if not (is_cloud(each) or is_catalogue(each))):
        try:
            with opened(path) as dataset:
                stray = stray_numbers(dataset)
        except RepmError:  # a table, or what the stage itself reports
            continue
        if stray.impossible and not stray.possible:
            raise ImageError(
                f"No number of '{path}' can be a height in metres ({LOWEST_M:g} to {HIGHEST_M:g}): state the unit "
                "of its band, such as cm, or convert its heights."
            )
        if stray.constant:
            progress.warn(
                Finding(
                    "void-likely",
                    f"{as_percent(stray.constant)} of the cells of '{path}' have exactly {stray.constant_m:g} m, far "
                    "from all others: declare that number as its nodata value (gdal_edit -a_nodata), if it is none.",
                    "doubt",
                )
            )
        if stray.impossible:
            progress.warn(
                Finding(
                    "heights-impossible",
                    f"{as_percent(stray.impossible)} of the cells of '{path}' have numbers that cannot be heights "
                    f"(below {LOWEST_M:g} or above {HIGHEST_M:g} m), and no nodata value declares them: they are "
                    "left out.",
                )
            )
        elif stray.marked:
            progress.info(
                f"{as_percent(stray.marked)} of the cells of '{path}' are -9999 or a like number, which no nodata "
                "value declares: they are left out."
            )
