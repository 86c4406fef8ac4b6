"""Rasters whose voids no nodata value declares: they are read without these, and the log says so."""

from __future__ import annotations

from ..contracts.errors import RepmError
from ..contracts.file_kinds import is_catalogue, is_cloud
from ..contracts.findings import Finding
from ..contracts.options import Options
from ..imagery.heights import HIGHEST_M, LOWEST_M, stray_shares
from ..imagery.raster import opened
from ..runtime.progress import Progress

_HEIGHTS = ("dem", "dsm", "dsms", "reference", "before", "after", "others", "dtm")
"""The options that name rasters of heights, beside files of other kinds."""


def name_voids(options: Options, progress: Progress) -> None:
    """Name rasters with numbers that are no heights, and their share: a warning where they cannot be heights, a note
    where they are the usual marks."""
    paths = dict.fromkeys(path for name, path in options.read_paths() if name in _HEIGHTS)
    for path in (each for each in paths if not (is_cloud(each) or is_catalogue(each))):
        try:
            with opened(path) as dataset:
                impossible, marked = stray_shares(dataset)
        except RepmError:  # a table, or what the stage itself reports
            continue
        if impossible:
            progress.warn(
                Finding(
                    "heights-impossible",
                    f"{_percent(impossible)} of the cells of '{path}' have numbers that cannot be heights (below "
                    f"{LOWEST_M:g} or above {HIGHEST_M:g} m), and no nodata value declares them: they are left out.",
                )
            )
        elif marked:
            progress.info(
                f"{_percent(marked)} of the cells of '{path}' are -9999 or a like number, which no nodata value "
                "declares: they are left out."
            )


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"
