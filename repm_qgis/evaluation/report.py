"""One HTML page that holds everything it shows: it opens offline, prints, and asks no server for anything.

>>> page = Report("DSM compared", "dsm.tif against truth.tif")
>>> page.section("Accuracy").table(["metric", "value"], [["RMSE", "0.42 m"]]).write("report.html")

All text is escaped here; the only raw mark-up taken is SVG made by :mod:`repm_qgis.evaluation.charts`.
"""

from __future__ import annotations

import base64
import datetime
import html
import math
import numbers
import os
import re
from typing import Any, Iterable, List, Mapping, Optional, Sequence, Tuple, Union

from ..workspace import write_text

Pairs = Union[Mapping[str, Any], Iterable[Tuple[str, Any]]]

_NUMBER = re.compile(r"^[<>≤≥~±+\-−]?\s*\d[\d\s,.]*(e[+-]?\d+)?\s*(%|°|[a-zA-Zµ²³/]{1,5})?$", re.IGNORECASE)
_LONG = 40
_UNSAFE_SVG = re.compile(r"<\s*(script|foreignobject|iframe|image|use)\b|\bon\w+\s*=|href\s*=", re.IGNORECASE)

# Every rule has a plain value before a variable where an old engine (QtWebKit, QTextBrowser) may not know variables.
_CSS = """
:root{color-scheme:light dark;--ink:#1d2733;--soft:#5b6876;--line:#d9dfe5;--page:#fff;--panel:#f5f7f9;--accent:#1f6f9f;
--warn:#8a5a00;--warnbg:#fff6e0;--warnline:#e0a100}
@media (prefers-color-scheme:dark){:root{--ink:#e3e8ed;--soft:#9aa7b4;--line:#37424d;--page:#161b20;--panel:#1f262d;
--accent:#69b4e0;--warn:#ffd479;--warnbg:#33290f;--warnline:#b98a1a}}
*{box-sizing:border-box}
body{margin:0;font:15px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans","DejaVu Sans",sans-serif;
color:#1d2733;color:var(--ink);background:#fff;background:var(--page)}
main{max-width:64rem;margin:0 auto;padding:2.2rem 1.4rem 3rem}
h1{font-size:1.9rem;line-height:1.2;margin:0 0 .2rem;letter-spacing:-.01em}
.subtitle{color:#5b6876;color:var(--soft);margin:0 0 1.4rem;overflow-wrap:anywhere}
h2{font-size:1.2rem;margin:2.2rem 0 .7rem;padding-bottom:.3rem;border-bottom:1px solid #d9dfe5;
border-bottom-color:var(--line)}
nav{margin:0 0 1.2rem;font-size:.9rem}nav a{margin-right:1.1rem;white-space:nowrap}
a{color:#1f6f9f;color:var(--accent);text-decoration:none}a:hover{text-decoration:underline}
p{max-width:46rem;margin:.5rem 0;overflow-wrap:anywhere}
table.facts{margin:.6rem 0}table.facts th,table.facts td{border:0;padding:.12rem 1.4rem .12rem 0}
table.facts th{font-weight:400;white-space:nowrap;color:#5b6876;color:var(--soft)}
table.facts td,td.w{overflow-wrap:anywhere}
.scroll{overflow-x:auto;margin:.8rem 0}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;min-width:50%}
p.caption{color:#5b6876;color:var(--soft);font-size:.87rem;margin-top:-.35rem}
th,td{padding:.32rem .8rem;text-align:left;border-bottom:1px solid #d9dfe5;border-bottom-color:var(--line);
vertical-align:top}
thead th{font-weight:600;border-bottom-width:2px;white-space:nowrap}
.n{text-align:right;white-space:nowrap}
figure{margin:1rem 0 1.4rem;max-width:100%;overflow-x:auto}
figure img,figure svg{max-width:100%;height:auto;display:block}
figcaption{color:#5b6876;color:var(--soft);font-size:.87rem;margin-top:.45rem;max-width:46rem}
.warning{background:#fff6e0;background:var(--warnbg);color:#8a5a00;color:var(--warn);padding:.6rem .9rem;
border-left:4px solid #e0a100;border-left-color:var(--warnline);border-radius:3px;margin:.7rem 0;max-width:52rem}
pre{background:#f5f7f9;background:var(--panel);border:1px solid #d9dfe5;border-color:var(--line);border-radius:4px;
padding:.7rem .9rem;overflow-x:auto;font:13px/1.5 ui-monospace,"DejaVu Sans Mono",Consolas,monospace;
white-space:pre-wrap;overflow-wrap:anywhere;-webkit-user-select:all;user-select:all}
footer{margin-top:2.6rem;color:#5b6876;color:var(--soft);font-size:.82rem}
@media print{:root{--ink:#000;--soft:#444;--line:#bbb;--page:#fff;--panel:#f5f5f5;--warn:#000;--warnbg:#fff}
main{max-width:none;padding:0}nav{display:none}h2{break-after:avoid}figure,tr,.warning{break-inside:avoid}
.scroll,figure{overflow:visible}}
"""


def number(value: Any) -> str:
    """Write a value for a reader: floats with as many decimals as their size needs, None and NaN as a dash.

    >>> number(0.0123456), number(3.14159), number(12345.678), number(None)
    ('0.01235', '3.142', '12345.7', '–')
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or isinstance(value, (str, numbers.Integral)):
        return "–" if value is None else str(value)
    try:
        real = float(value)
    except (TypeError, ValueError):
        return str(value)
    if math.isnan(real):
        return "–"
    if real == 0 or math.isinf(real):
        return f"{real:g}".lstrip("-") if real == 0 else str(real)
    if abs(real) >= 1000:
        return f"{real:.1f}"
    return f"{real:.4g}" if abs(real) >= 1e-4 else f"{real:.2e}"


def _is_number(value: Any) -> bool:
    if isinstance(value, str):
        return bool(_NUMBER.match(value.strip()))
    return value is None or (hasattr(value, "__float__") and not isinstance(value, bool))


class Report:
    """A page that is written from top to bottom; all methods but :meth:`html` and :meth:`write` give the page back."""

    def __init__(self, title: str, subtitle: str = "") -> None:
        self._title, self._subtitle = str(title), str(subtitle)
        self._parts: List[str] = []
        self._sections: List[str] = []

    def section(self, title: str) -> Report:
        """Start a section; from three sections on the page opens with links to them."""
        self._sections.append(str(title))
        self._parts.append(f'<h2 id="s{len(self._sections)}">{html.escape(str(title))}</h2>')
        return self

    def paragraph(self, text: str) -> Report:
        self._parts.append(f"<p>{html.escape(str(text))}</p>")
        return self

    def facts(self, pairs: Pairs) -> Report:
        """Names and their values, one a line, from a mapping or a list of pairs."""
        items = pairs.items() if isinstance(pairs, Mapping) else pairs
        rows = "".join(
            f"<tr><th>{html.escape(str(name))}</th><td>{html.escape(number(value))}</td></tr>" for name, value in items
        )
        self._parts.append(f'<table class="facts"><tbody>{rows}</tbody></table>')
        return self

    def table(self, headers: Sequence[str], rows: Iterable[Sequence[Any]], caption: str = "") -> Report:
        """A table; columns that hold only numbers (or number-like text such as ``"0.4 m"``) are right aligned.

        Raises ValueError where a row has another length than ``headers``.
        """
        body = [list(row) for row in rows]
        for row in body:
            if len(row) != len(headers):
                raise ValueError(f"A table row has {len(row)} cells under {len(headers)} headers: {row!r}.")
        numeric = [
            bool(body) and all(_is_number(row[i]) or row[i] in ("–", "") for row in body) for i in range(len(headers))
        ]
        # Only long cells, paths above all, may break anywhere: names and numbers stay whole.
        long = [any(len(str(row[i])) > _LONG for row in body) for i in range(len(headers))]
        mark = [' class="n"' if flag else ' class="w"' if wide else "" for flag, wide in zip(numeric, long)]
        head = "".join(f"<th{m}>{html.escape(str(text))}</th>" for m, text in zip(mark, headers))
        lines = "".join(
            "<tr>" + "".join(f"<td{m}>{html.escape(number(cell))}</td>" for m, cell in zip(mark, row)) + "</tr>"
            for row in body
        )
        # Beside the table, not in it: a caption is as wide as its table, and a wide one would be cut where it scrolls.
        title = f'<p class="caption">{html.escape(caption)}</p>' if caption else ""
        self._parts.append(
            f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table></div>{title}'
        )
        return self

    def warning(self, text: str, remedy: str = "") -> Report:
        """Something the reader should know; ``remedy`` says what to do about it."""
        say = html.escape(str(text)) + (f" <strong>What to do:</strong> {html.escape(remedy)}" if remedy else "")
        self._parts.append(f'<div class="warning" role="note">{say}</div>')
        return self

    def png(self, data: bytes, caption: str = "", width: Optional[int] = None) -> Report:
        """A PNG, carried inside the page; ``width`` in CSS pixels, None = its own.

        Raises ValueError where ``data`` is not a PNG.
        """
        if not bytes(data[:8]) == b"\x89PNG\r\n\x1a\n":
            raise ValueError("The picture's bytes are not a PNG.")
        size = f' width="{int(width)}"' if width else ""
        source = base64.b64encode(data).decode("ascii")
        self._figure(
            f'<img src="data:image/png;base64,{source}" alt="{html.escape(caption, quote=True)}"{size}>', caption
        )
        return self

    def svg(self, svg_text: str, caption: str = "") -> Report:
        """A drawing of :mod:`~repm_qgis.evaluation.charts`.

        Raises ValueError where it is not an ``<svg>`` element, or holds scripts or references.
        """
        text = svg_text.strip()
        if not (text.startswith("<svg") and text.endswith("</svg>")) or _UNSAFE_SVG.search(text):
            raise ValueError("The drawing is not a plain <svg> element without scripts and references.")
        self._figure(text, caption)
        return self

    def command(self, text: str) -> Report:
        """Text to copy, such as a command line; one click selects all of it."""
        self._parts.append(f"<pre>{html.escape(str(text))}</pre>")
        return self

    def html(self) -> str:
        """The whole page."""
        nav = " ".join(f'<a href="#s{i}">{html.escape(name)}</a>' for i, name in enumerate(self._sections, 1))
        nav = f"<nav>{nav}</nav>" if len(self._sections) >= 3 else ""
        subtitle = f'<p class="subtitle">{html.escape(self._subtitle)}</p>' if self._subtitle else ""
        made = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z").strip()
        return (
            '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{html.escape(self._title)}</title><style>{_CSS}</style></head><body><main>"
            f"<h1>{html.escape(self._title)}</h1>{subtitle}{nav}\n"
            + "\n".join(self._parts)
            + f"\n<footer>REPM · {html.escape(made)}</footer></main></body></html>\n"
        )

    def write(self, path: Union[str, os.PathLike]) -> None:
        """Write the page, whole or not at all. Raises WorkspaceError where the file cannot be written."""
        write_text(os.fspath(path), self.html())

    def _figure(self, inner: str, caption: str) -> None:
        legend = f"<figcaption>{html.escape(caption)}</figcaption>" if caption else ""
        self._parts.append(f"<figure>{inner}{legend}</figure>")
