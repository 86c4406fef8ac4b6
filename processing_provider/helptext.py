"""Help pages in the little Markdown we write them in, as the HTML that QGIS's dialogs show.

QGIS's panel for help colours <p>, <b> and <h2> with fixed dark greys, which cannot be read in a dark theme: other
elements take the theme's colour. QGIS puts all of it into one <p>, which has to end first.
"""

from __future__ import annotations

import html
import os
import re

from qgis.PyQt.QtCore import QUrl

_WIDTH_PX = 230  # of the panel as QGIS first opens it


def inline(text: str) -> str:
    """Bold, italic, code and links of one paragraph."""
    codes = re.findall(r"`([^`]+)`", text)
    text = html.escape(re.sub(r"`[^`]+`", "\1", text), quote=False)  # code may have any sign, and be in bold or links
    text = re.sub(r"\*\*(.+?)\*\*(?!\*)", r"<strong>\1</strong>", text)
    text = re.sub(r"\*([^*]+)\*", r"<i>\1</i>", text)
    text = re.sub(r"\[([^\]]+)\]\(([^)\s]+)\)", r'<a href="\2">\1</a>', text)
    return re.sub("\1", lambda _: f"<code>{html.escape(codes.pop(0), quote=False)}</code>", text)


def _picture(block: str, folder: str) -> str:
    """A picture alone in its paragraph, as wide as the narrow panel; "" for other blocks, or where the file is gone."""
    found = re.fullmatch(r"!\[([^\]]*)\]\(([^)\s]+)\)", block)
    if found is None:
        return ""
    path = os.path.realpath(os.path.join(folder, found[2]))
    if not os.path.exists(path):
        return ""
    address = html.escape(QUrl.fromLocalFile(path).toString())
    return (
        f'<div style="margin-bottom: 8px"><img src="{address}" width="{_WIDTH_PX}" alt="{html.escape(found[1])}"></div>'
    )


def _block(block: str) -> str:
    if block.startswith("#"):
        return f"<h3>{inline(block.lstrip('#').strip())}</h3>"
    if block.startswith("- "):
        items = re.split(r"\n- ", block[2:])
        return "<ul>" + "".join(f"<li>{inline(' '.join(item.split()))}</li>" for item in items) + "</ul>"
    return f'<div style="margin-bottom: 8px">{inline(" ".join(block.split()))}</div>'


def to_html(markdown: str, folder: str = "") -> str:
    """Headings, paragraphs, "- " lists, bold, italic, code, links and pictures; anything else stays as text.

    ``folder`` is the document's, from which its pictures are found.
    """
    # A heading needs no empty line after it.
    text = re.sub(r"(?m)^(#+ .*)$", r"\n\1\n", markdown.replace("\r\n", "\n"))
    blocks = (block.strip() for block in re.split(r"\n\s*\n", text))
    return "</p>" + "".join(_picture(block, folder) or _block(block) for block in blocks if block)
