"""One HTML page that holds everything it shows: it opens offline, prints, and asks no server for anything.

>>> page = Report("DSM compared", "dsm.tif against truth.tif")
>>> page.section("Accuracy").table("metric | value", [["RMSE", "0.42 m"]]).write("report.html", run)

The templates lie in ``resources/templates``. They escape all text; only drawings of
:mod:`repm_qgis.reports.charts` are taken as they are.
"""

from __future__ import annotations

import base64
import datetime
import math
import numbers
import os
import re
import struct
from typing import Dict, Iterable, List, Sequence, Tuple, Union

from ..contracts.findings import Finding, by_severity, verdict_of
from ..runtime.progress import Recorder
from ..runtime.translation import labels, reader
from ..runtime.workspace import write_text
from .readable import readable
from .templates import Drawing, page

_NUMBER = re.compile(r"^[<>≤≥~±+\-−]?\s*\d[\d\s,.]*(e[+-]?\d+)?\s*(%|°|[a-zA-Zµ²³/]{1,5})?$", re.IGNORECASE)
_LONG = 40
_MOST_ROWS = 300
_SHOWN_PX = 800  # of a picture's longer side on the page, about, in whole pixels of the picture


class Link(str):
    """A table's cell that leads to another file, at an address from the page on."""

    href: str

    def __new__(cls, text: str, href: str) -> Link:
        link = super().__new__(cls, text)
        link.href = href
        return link


def number(value: object) -> str:
    """Write a value for a reader: floats with as many decimals as their size needs, None and NaN as a dash.

    >>> number(0.0123456), number(3.14159), number(12345.678), number(None)
    ('0.01235', '3.142', '12345.7', '–')
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if value is None or isinstance(value, numbers.Integral):
        return "–" if value is None else str(value)
    try:
        real = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return str(value)
    if math.isnan(real):
        return "–"
    if real == 0 or math.isinf(real):
        return f"{real:g}".lstrip("-") if real == 0 else str(real)
    if abs(real) >= 1000:
        return f"{real:.1f}"
    return f"{real:.4g}" if abs(real) >= 1e-4 else f"{real:.2e}"


def fixed(*values: float, decimals: int = 3, sign: str = "") -> List[str]:
    """Table cells with a fixed number of decimals, a dash for NaN; ``sign`` "+" writes the plus too."""
    return [f"{value:{sign}.{decimals}f}" if math.isfinite(value) else "–" for value in values]


class Report:
    """A page that is written from top to bottom; all methods but :meth:`html` and :meth:`write` return the page."""

    def __init__(self, title: str, subtitle: str = "") -> None:
        self._title, self._subtitle, self._of = title, subtitle, ""
        self._parts: List[Tuple[str, Dict[str, object]]] = []
        self._sections: List[str] = []

    def of(self, name: str) -> Report:
        """Add the page's subject to its title: a scene and its days."""
        self._of = name
        return self

    def section(self, title: str) -> Report:
        """Start a section; from three sections on the page opens with links to them."""
        self._sections.append(title)
        return self._add("section", title=title, number=len(self._sections))

    def paragraph(self, text: str) -> Report:
        return self._add("paragraph", text=text)

    def facts(self, pairs: Iterable[Tuple[str, object]]) -> Report:
        """Names and their values, one a line."""
        return self._add("facts", pairs=[(name, number(value)) for name, value in pairs])

    def table(
        self,
        headers: Union[str, Sequence[str]],
        rows: Iterable[Sequence[object]],
        caption: str = "",
        most: int = _MOST_ROWS,
        where: str = "",
    ) -> Report:
        """A table; columns that hold only numbers (or text such as ``"0.4 m"``) are right aligned.

        ``headers`` may be one text with " | " between the columns. Of more than ``most`` rows the others are left out,
        and the caption says so, and ``where`` they are. Raises ValueError where a row has another length than
        ``headers``.
        """
        titles, body = headers.split(" | ") if isinstance(headers, str) else list(headers), list(rows)
        for row in body:
            if len(row) != len(titles):
                raise ValueError(f"A table row has {len(row)} cells under {len(titles)} headers: {row!r}.")
        kinds = [_kind_of([row[i] for row in body]) for i in range(len(titles))]
        if len(body) > most:
            caption = f"{len(body) - most} more rows are left out here. {where} {caption}".strip()
        rows = [[number(cell) for cell in row] for row in body[:most]]
        return self._add("table", columns=list(zip(titles, kinds)), rows=rows, caption=caption)

    def verdict(self, good: str, findings: Sequence[Finding] = (), *, about: bool = False) -> Report:
        """Whether the result can be used as it is: what is ``good``, or else what is to be looked at, which are these
        ``findings`` and those of the run (:meth:`write`).

        ``about``: the sentence says what was found in the world, such as damage, which is never called good, and
        stands there beside findings too.
        """
        return self._add("verdict", good=good, findings=list(findings), about=about)

    def png(self, data: bytes, caption: str = "") -> Report:
        """A PNG, carried inside the page, and shown so many times larger that it can be read: a small surface has few
        pixels. Raises ValueError where ``data`` is not a PNG."""
        if data[:8] != b"\x89PNG\r\n\x1a\n":
            raise ValueError("The picture's bytes are not a PNG.")
        size = struct.unpack(">II", data[16:24])  # of the header, which is a PNG's first chunk
        width = size[0] * max(1, round(_SHOWN_PX / max(size)))
        return self._add("png", source=base64.b64encode(data).decode("ascii"), caption=caption, width=width)

    def gallery(self, drawn: Iterable[Tuple[bytes, str]], caption: str = "") -> Report:
        """Small PNGs side by side, each with its name below."""
        pictures = [(base64.b64encode(data).decode("ascii"), name) for data, name in drawn]
        return self._add("gallery", pictures=pictures, caption=caption)

    def svg(self, drawing: Drawing, caption: str = "") -> Report:
        """A drawing of :mod:`~repm_qgis.reports.charts`. Raises ValueError for text that was not escaped there."""
        if not isinstance(drawing, Drawing):
            raise ValueError("Only the drawings of repm_qgis.reports.charts can be shown.")
        return self._add("svg", drawing=drawing, caption=caption)

    def command(self, text: str) -> Report:
        """Text to copy, such as a command line; one click selects all of it."""
        return self._add("command", text=text)

    def html(self, run: Sequence[Finding] = ()) -> str:
        """The whole page, with what the run has found in its verdict, or at its top."""
        made = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z").strip()
        head = {"title": self._title, "of": self._of, "subtitle": self._subtitle, "sections": self._sections}
        head["language"] = reader().language
        parts = [(kind, _with(values, run) if kind == "verdict" else values) for kind, values in self._parts]
        if run and "verdict" not in dict(parts):
            parts.insert(0, ("verdict", _with({"good": "", "findings": [], "about": False}, run)))
        made_page = page("report.html", parts=parts, made=made, **head)
        return readable(made_page, reader().language, labels())

    def write(self, path: str | os.PathLike[str], run: Recorder) -> None:
        """Write the page, whole or not at all, with the findings of the run in its verdict.

        Raises WorkspaceError where the file cannot be written.
        """
        write_text(os.fspath(path), self.html(run.findings))

    def _add(self, kind: str, **values: object) -> Report:
        self._parts.append((kind, values))
        return self


def _with(verdict: Dict[str, object], run: Sequence[Finding]) -> Dict[str, object]:
    """A verdict with the findings of the run behind its own of the same severity."""
    own: Sequence[Finding] = verdict["findings"]  # type: ignore[assignment]  # of Report.verdict
    findings = by_severity([*own, *run])
    return {**verdict, "findings": findings, "level": verdict_of(findings)}


def _kind_of(cells: Sequence[object]) -> str:
    """The style of a column: "n" for numbers, "w" for long texts (paths above all), which may break anywhere."""
    if cells and all(_is_number(cell) or cell in ("–", "") for cell in cells):
        return "n"
    return "w" if any(len(str(cell)) > _LONG for cell in cells) else ""


def _is_number(value: object) -> bool:
    if isinstance(value, str):
        return bool(_NUMBER.match(value.strip()))
    return value is None or (hasattr(value, "__float__") and not isinstance(value, bool))
