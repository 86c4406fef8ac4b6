"""Show a DSM in 3-D in a page for the browser, with rasters draped over it."""

from __future__ import annotations

from ..contracts.options import ViewerOptions
from ..contracts.results import ViewerResult
from ..runtime.parallel import run_whole
from ..runtime.progress import Progress
from ..viewer.page import write_viewer


def run(options: ViewerOptions, progress: Progress) -> ViewerResult:
    """Write the page; gives its path, and how many columns and rows of cells it has.

    Raises ImageError, EmptyResultError, OverlapError, MissingPackageError, WorkspaceError.
    """
    result: ViewerResult = run_whole(written, options, progress, "making the page")
    progress.step(1.0, "page written")
    return result


def written(options: ViewerOptions, progress: Progress, name: str = "") -> ViewerResult:
    """The page, with its size in the log; reports no progress."""
    facts = write_viewer(options, progress, name=name)
    columns, rows = facts.cells
    progress.info(f"Page of {columns} x {rows} cells, {facts.size / 1e6:.1f} MB.")
    if facts.factor > 1:
        progress.info(
            f"Each of its heights is a mean over {facts.factor:.3g} cells of the DSM along each side: a page has at "
            f"most {options.cells} cells (CELLS of repm:viewer)."
        )
    return ViewerResult(viewer=options.viewer, columns=columns, rows=rows)
