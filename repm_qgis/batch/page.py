"""The HTML page about many scenes: what became of each, with links to the scenes' own reports."""

from __future__ import annotations

import os
from pathlib import Path
from typing import List, Optional, Sequence
from urllib.parse import quote

from ..contracts.errors import ImageError
from ..contracts.results import SceneOutcome
from ..reports import pictures as drawings
from ..reports.report import Link, Report, fixed
from ..runtime.progress import counted

_PICTURE_PX = 220
_MOST_PICTURES = 60
_MOST_ROWS = 1000
VERDICTS = {"good": "Good.", "look": "Look at it", "doubt": "Doubtful", "failed": "Failed"}
"""The verdicts of scenes, in words."""


def batch_page(
    scenes: Sequence[SceneOutcome], path: str, files: Sequence[tuple[str, Optional[str]]], pictures: bool = True
) -> Report:
    """The page of all scenes, to be written to ``path``, from where its links lead; ``files`` are products of all."""
    made = [scene for scene in scenes if scene.dsm]
    page = Report("DSMs of many scenes", f"{counted(len(scenes), 'scene')}, {counted(len(made), 'DSM')}")
    page.verdict(f"All {counted(len(scenes), 'scene')} have a DSM, and each of their reports says that it is good.")
    page.section("Scenes").table(
        "scene | verdict | cells with a height, % | LE90, median, m | deviation of the absolute height, m | pairs | "
        "images | taken | computed in, s | complete before | report",
        [_row(scene, path) for scene in scenes],
        "LE90: nine of ten heights are off by less, apart from the error that all share, whose standard deviation is "
        "that of the absolute height. Scenes that were complete before were not computed again.",
        most=_MOST_ROWS,
    )
    failed = [[scene.scene, scene.error] for scene in scenes if scene.error]
    if failed:
        again = "Correct these, and run again with the same workspace: what is complete is not computed again."
        page.section("Scenes without a DSM").table("scene | reason", failed, again, most=_MOST_ROWS)
    found = [[scene.scene, text] for scene in scenes for text in scene.findings]
    if found:
        page.section("What to look at").table(
            "scene | finding", found, "From the scenes' own reports.", most=_MOST_ROWS
        )
    _pictures(page, made if pictures else [])
    page.section("Files").facts([(title, file) for title, file in files if file])
    return page


def _row(scene: SceneOutcome, page: str) -> List[object]:
    figures = [scene.valid_percent, scene.le90_m, scene.height_deviation_m]
    shown = [
        fixed(value, decimals=decimals)[0] if value is not None else None for value, decimals in zip(figures, (1, 2, 2))
    ]
    known = (
        [scene.pairs, scene.images, ", ".join(scene.taken) or None] if scene.dsm else [None, scene.images or None, None]
    )
    link = Link("report", _address(scene.report, page)) if scene.report else None
    return [scene.scene, VERDICTS[scene.verdict], *shown, *known, f"{scene.seconds:.1f}", scene.reused, link]


def _address(file: str, page: str) -> str:
    """Where a link of a page leads to a file: from the page's folder on, so that both can be moved together."""
    try:
        return quote(os.path.relpath(file, os.path.dirname(os.path.abspath(page))).replace(os.sep, "/"))
    except ValueError:  # on another drive
        return Path(os.path.abspath(file)).as_uri()


def _pictures(page: Report, scenes: Sequence[SceneOutcome]) -> None:
    drawn = []
    for scene in scenes[:_MOST_PICTURES]:
        try:
            heights, cell = drawings.preview(str(scene.dsm), _PICTURE_PX)
        except ImageError:  # somebody has just removed it
            continue
        drawn.append((drawings.png_bytes(drawings.shaded_relief(heights, cell)), scene.scene))
    if drawn:
        more = f" The first {len(drawn)} of {len(scenes)}." if len(scenes) > len(drawn) else ""
        page.section("Pictures").gallery(drawn, f"The DSMs, shaded from the north-west, north up.{more}")
