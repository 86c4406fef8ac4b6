"""What analysts make from a DSM: bare earth, changes, colour, 3-D. Each part is a module ``answers_PART``."""

from __future__ import annotations

from typing import Callable, Dict, List

from benchmarks import answers_change, answers_colour, answers_dtm, answers_solids, answers_viewer
from benchmarks.tables import Section

PARTS: Dict[str, Callable[[], List[str]]] = {
    "change": answers_change.change,
    "colour": answers_colour.colours,
    "dtm": answers_dtm.terrain,
    "heights": answers_dtm.heights,
    "solids": answers_solids.solids,
    "viewer": answers_viewer.pages,
}

SECTIONS = [Section("answers", "From the surface to answers", "make bench-answers", PARTS)]
