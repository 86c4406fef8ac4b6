"""Markdown tables, and the sections of docs/benchmarks.md that they are written into."""

from __future__ import annotations

import platform
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, Iterable, List, Sequence, Union

DOCS = Path(__file__).resolve().parents[1] / "docs"


class Details(str):
    """A paragraph or a table that is too long for docs/benchmarks.md: it goes to docs/benchmarks/SECTION.md."""


@dataclass(frozen=True)
class Section:
    """A section of a page: the name of its markers, its title, the command that writes it, its parts, and the page.

    A part is a function that measures something and returns paragraphs and tables. It can be run alone, by its name.
    """

    name: str
    title: str
    command: str
    parts: Dict[str, Callable[[], List[str]]]
    page: str = "benchmarks.md"


def table(headers: Union[str, Sequence[str]], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; ``headers`` may be one string with bars between them. Floats have four significant digits."""
    names = [name.strip() for name in headers.split("|")] if isinstance(headers, str) else headers
    lines = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    lines += ["| " + " | ".join(_cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _revision() -> str:
    """The revision that is measured, in words that follow a comma; "" where this is no clone."""
    found = subprocess.run(["git", "-C", str(DOCS), "rev-parse", "--short", "HEAD"], capture_output=True, check=False)
    return f", revision {found.stdout.decode().strip()}" if found.returncode == 0 else ""


def publish(section: Section, texts: Sequence[str], docs: Path = DOCS) -> None:
    """Write a section's texts into the pages, in the place of what the last run wrote there."""
    made = f"`{section.command}`, Python {platform.python_version()} on {platform.machine()}{_revision()}."
    short = [text for text in texts if not isinstance(text, Details)]
    details = [text for text in texts if isinstance(text, Details)]
    if details:
        file = f"benchmarks/{section.name}.md"
        short.append(f"More tables: [{file}]({file}).")
        (docs / file).parent.mkdir(exist_ok=True)
        back = f"Short tables and other subjects: [benchmarks](../benchmarks.md). {made}"
        (docs / file).write_text("\n\n".join([f"# {section.title}", back, *details]) + "\n", encoding="utf-8")
    begin, end = f"<!-- {section.name}: begin -->", f"<!-- {section.name}: end -->"
    block = begin + "\n" + "\n\n".join([f"## {section.title}", made, *short]) + "\n" + end
    path = docs / section.page
    page = path.read_text(encoding="utf-8") if path.exists() else "# Benchmarks\n"
    if begin in page:
        page = re.sub(re.escape(begin) + ".*?" + re.escape(end), lambda _: block, page, flags=re.DOTALL)
    else:
        page = page.rstrip() + "\n\n" + block + "\n"
    path.write_text(page, encoding="utf-8")
