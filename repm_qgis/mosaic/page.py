"""The HTML page of a mosaic."""

from __future__ import annotations

import os
from typing import Dict, List, Optional, Sequence

import numpy as np

from ..contracts.options import MosaicOptions
from ..reports import charts, pictures, verdict
from ..reports.report import Report, fixed
from ..runtime.progress import counted
from .inputs import Layout
from .offsets import Offsets, Overlap

_PICTURE_PX = 1000
_MOST_KEYS = 24  # of DSMs in the key
_MOST_MOVES = 8


def mosaic_page(
    options: MosaicOptions,
    layout: Layout,
    overlaps: Sequence[Overlap],
    *,
    offsets: Offsets,
    left: Sequence[verdict.Difference],
    cells: Dict[int, int],
    seam: Optional[float],
) -> Report:
    """The page of a mosaic; ``left`` are the differences after the offsets, ``cells`` counts those of each DSM by its
    number, ``seam`` is the median step, m."""
    page = Report("Mosaic of DSMs", f"{options.output}, of {counted(len(layout.dsms), 'DSM')}")
    spread = float(np.sqrt(np.mean([each.median**2 for each in left])))
    good = f"After the offsets, the median differences of the DSMs are {spread:.3f} m (root mean square)."
    page.verdict(good)
    _surface(page, options, layout, cells, seam)
    _dsms(page, layout, overlaps, offsets, cells)
    _overlaps(page, layout, overlaps, offsets)
    if options.sources:
        _sources(page, options.sources, len(layout.dsms))
    return page


def left_differences(overlaps: Sequence[Overlap], offsets: Offsets) -> List[verdict.Difference]:
    """What is left of the differences of DSMs after their offsets."""
    return [
        verdict.Difference(each.first + 1, each.second + 1, each.after(offsets.added), each.nmad, each.other_relief)
        for each in overlaps
    ]


def _surface(
    page: Report, options: MosaicOptions, layout: Layout, cells: Dict[int, int], seam: Optional[float]
) -> None:
    values, cell = pictures.preview(options.output, _PICTURE_PX)
    relief = pictures.png_bytes(pictures.shaded_relief(values, cell))
    page.png(relief, "The mosaic, shaded from the north-west, north up. White: no DSM has a height there.")
    above = f"m above the {layout.datum.name}" if layout.datum else "m"
    page.svg(charts.colour_bar(pictures.RAMPS["elevation"], *pictures.percentile_range(values), above))
    columns, rows = layout.grid.size
    known = sum(cells.values())
    page.facts(
        [
            ("Cells", f"{columns} x {rows} of {layout.grid.cell:g} m"),
            ("Cells with a height", f"{known} ({100.0 * known / (columns * rows):.1f} %)"),
            ("Difference of two DSMs along the seams, median", "–" if seam is None else f"{seam:.3f} m"),
        ]
    )


def _dsms(
    page: Report,
    layout: Layout,
    overlaps: Sequence[Overlap],
    offsets: Offsets,
    cells: Dict[int, int],
) -> None:
    group_of = {number: place for place, group in enumerate(offsets.groups, start=1) for number in group}
    known, rows = max(sum(cells.values()), 1), []
    for number, dsm in enumerate(layout.dsms):
        count = sum(number in (overlap.first, overlap.second) for overlap in overlaps)
        added = fixed(float(offsets.added[number]), sign="+") + fixed(float(offsets.deviation[number]))
        share = f"{100.0 * cells.get(number, 0) / known:.1f}"
        rows.append([number + 1, dsm.name, *added, dsm.fixed, count, group_of[number], share])
    page.section("DSMs").facts([("Moved in height", move) for move in _moves(layout, offsets)]).table(
        "number | DSM or scene | added, m | standard deviation, m | fixed | overlaps | group | cells from it, %",
        rows,
        "Offsets are solved together by least squares over all overlaps. DSMs of different groups do not "
        "overlap, so their heights are not compared. A group without a fixed DSM keeps its mean height.",
    )


def _moves(layout: Layout, offsets: Offsets) -> List[str]:
    """Which DSMs were moved and by how much, the farthest first."""
    moved = [number for number, dsm in enumerate(layout.dsms) if not dsm.fixed and abs(offsets.added[number]) >= 0.005]
    moved.sort(key=lambda number: -abs(float(offsets.added[number])))
    named = [f"'{os.path.basename(layout.dsms[i].name)}' by {offsets.added[i]:+.2f} m" for i in moved[:_MOST_MOVES]]
    more = [f"{len(moved) - _MOST_MOVES} more below"] if len(moved) > _MOST_MOVES else []
    return [*named, *more] or ["none"]


def _overlaps(page: Report, layout: Layout, overlaps: Sequence[Overlap], offsets: Offsets) -> None:
    rows: List[List[object]] = []
    for overlap in sorted(overlaps, key=lambda each: -abs(each.after(offsets.added))):
        medians = fixed(overlap.median, overlap.after(offsets.added), sign="+")
        numbers = [overlap.first + 1, overlap.second + 1]
        beside = ["–"] if overlap.displaced is None else fixed(float(np.hypot(*overlap.displaced)))
        rows.append([*numbers, overlap.cells, *medians, *fixed(overlap.nmad), *beside])
    page.section("Overlaps").table(
        "first | second | cells, about | median before, m | median after, m | NMAD, m | horizontal shift, m",
        rows,
        "Heights of the first DSM minus those of the second, before and after the offsets are added, worst first. The "
        "NMAD is the spread of the differences about their median; an offset does not change it. Horizontal shift: "
        "how far the second lies beside the first, found from the relief (–: too little relief). It is not corrected.",
    )
    for name, values in (
        ("before", [overlap.median for overlap in overlaps]),
        ("after", [overlap.after(offsets.added) for overlap in overlaps]),
    ):
        page.facts([(f"Median differences {name}, root mean square", f"{np.sqrt(np.mean(np.square(values))):.3f} m")])


def _sources(page: Report, path: str, count: int) -> None:
    values, _ = pictures.preview(path, _PICTURE_PX, nearest=True)
    numbers, some = range(1, count + 1), pictures.CLASSES
    colours = {number: some[(number - 1) % len(some)] for number in numbers}
    page.section("Sources").png(
        pictures.png_bytes(pictures.categories(values, colours)),
        "The number of the DSM that each height comes from, north up, as in the list of DSMs.",
    )
    page.svg(charts.legend([(colours[number], str(number)) for number in numbers][:_MOST_KEYS]))
