#!/usr/bin/env python3
"""Write the tables of results in docs/algorithms from the stages' results ('make tables'): ``result_tables.py``.

Each page has a place for its own, between two comments; a page without one keeps none, as of a stage without figures.
"""

from __future__ import annotations

import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from repm_qgis.contracts.stages import STAGES  # noqa: E402

PAGES = ROOT / "docs" / "algorithms"
BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"


def table(stage: str) -> str:
    """The fields of a stage's result that are no products' paths: outputs of the algorithm in capitals."""
    meanings = STAGES[stage].result.meanings()
    rows = [f"| {name.upper() if each.label else f'`{name}`'} | {each.text} |" for name, each in meanings.items()]
    return "\n".join([BEGIN, "| figure (small letters: not in QGIS) | meaning |", "|---|---|", *rows, END])


def page(stage: str, text: str) -> str:
    """The page of a stage with its table; raises ValueError where it has no place for one."""
    if BEGIN not in text:
        raise ValueError(f"docs/algorithms/{stage}.md has no place for results: write '{BEGIN}' and '{END}' into it")
    return re.sub(f"{BEGIN}.*?{END}", lambda _: table(stage), text, flags=re.DOTALL)


def main() -> int:
    for stage in STAGES:
        path = PAGES / f"{stage}.md"
        path.write_text(page(stage, path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
