"""Markdown tables, and the pages of docs/benchmarks/ that they are written to; docs/benchmarks.md is kept by hand."""

from __future__ import annotations

import platform
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, Iterable, List, Sequence, Union

DOCS = Path(__file__).resolve().parents[1] / "docs"


Details = str  # a paragraph or a table of many lines; it is written like any other


@dataclass(frozen=True)
class Section:
    """One subject: its name, its title, the command that writes it, its parts, and the page that it is written into.

    A part is a function that measures something and returns paragraphs and tables. It can be run alone, by its name.
    Without a page the section has its own, docs/benchmarks/NAME.md; in one that is named, it stands between markers.
    """

    name: str
    title: str
    command: str
    parts: Dict[str, Callable[[], List[str]]]
    page: str = ""


def table(headers: Union[str, Sequence[str]], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; ``headers`` may be one string with bars between them. Floats have four significant digits."""
    names = [name.strip() for name in headers.split("|")] if isinstance(headers, str) else headers
    lines = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    lines += ["| " + " | ".join(_cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _revision() -> str:
    """The revision that is measured and its day, in words that follow a comma; "" where this is no clone."""
    words = ["git", "-C", str(DOCS), "log", "-1", "--format=%h (%ad)", "--date=short"]
    found = subprocess.run(words, capture_output=True, check=False)
    return f", revision {found.stdout.decode().strip()}" if found.returncode == 0 else ""


def publish(section: Section, texts: Sequence[str], docs: Path = DOCS) -> None:
    """Write a section's texts: the whole of its own page, or in the place of what the last run wrote into another."""
    made = f"`{section.command}`, Python {platform.python_version()} on {platform.machine()}{_revision()}."
    if not section.page:
        path = docs / "benchmarks" / f"{section.name}.md"
        path.parent.mkdir(exist_ok=True)
        made = f"The headline figures of all subjects: [benchmarks](../benchmarks.md). {made}"
        path.write_text("\n\n".join([f"# {section.title}", made, *texts]) + "\n", encoding="utf-8")
        return
    begin, end = f"<!-- {section.name}: begin -->", f"<!-- {section.name}: end -->"
    block = begin + "\n" + "\n\n".join([f"## {section.title}", made, *texts]) + "\n" + end
    path = docs / section.page
    page = path.read_text(encoding="utf-8")
    if begin in page:
        page = re.sub(re.escape(begin) + ".*?" + re.escape(end), lambda _: block, page, flags=re.DOTALL)
    else:
        page = page.rstrip() + "\n\n" + block + "\n"
    path.write_text(page, encoding="utf-8")
