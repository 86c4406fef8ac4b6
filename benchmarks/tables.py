"""Markdown tables, printed and kept in docs/benchmarks.md between markers of their own."""

from __future__ import annotations

import platform
import re
from pathlib import Path
from typing import Any, Iterable, List, Sequence

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"


def table(headers: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A Markdown table; floats with four significant digits."""
    lines = ["| " + " | ".join(headers) + " |", "|" + "---|" * len(headers)]
    lines += ["| " + " | ".join(_cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def publish(name: str, title: str, command: str, parts: List[str]) -> None:
    """Print a benchmark's text and put it into the page, in the place of what the last run put there."""
    text = "\n\n".join(
        [f"## {title}", f"`{command}`, Python {platform.python_version()} on {platform.machine()}.", *parts]
    )
    print(text)
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    page = PAGE.read_text(encoding="utf-8") if PAGE.exists() else "# Benchmarks\n"
    block = f"{begin}\n{text}\n{end}"
    if begin in page:
        page = re.sub(re.escape(begin) + ".*?" + re.escape(end), lambda _: block, page, flags=re.DOTALL)
    else:
        page = page.rstrip() + "\n\n" + block + "\n"
    PAGE.write_text(page, encoding="utf-8")
