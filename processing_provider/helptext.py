"""Help pages in the little Markdown we write them in, as the HTML that QGIS's dialogs show.

QGIS's panel for help colours <p>, <b> and <h2> with fixed dark greys, which cannot be read in a dark theme: other
elements take the theme's colour. QGIS puts all of it into one <p>, which has to end first.
"""

from __future__ import annotations

import html
import re


def inline(text: str) -> str:
    """Bold, italic, code and links of one paragraph."""
    return "".join(
        f"<code>{html.escape(part, quote=False)}</code>" if index % 2 else _marked(part)
        for index, part in enumerate(re.split(r"`([^`]+)`", text))
    )


def _marked(text: str) -> str:
    text = html.escape(text, quote=False)
    text = re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", text)
    text = re.sub(r"\*([^*]+)\*", r"<i>\1</i>", text)
    return re.sub(r"\[([^\]]+)\]\(([^)\s]+)\)", r'<a href="\2">\1</a>', text)


def _block(block: str) -> str:
    if block.startswith("#"):
        return f"<h3>{inline(block.lstrip('#').strip())}</h3>"
    if block.startswith("- "):
        items = re.split(r"\n- ", block[2:])
        return "<ul>" + "".join(f"<li>{inline(' '.join(item.split()))}</li>" for item in items) + "</ul>"
    return f'<div style="margin-bottom: 8px">{inline(" ".join(block.split()))}</div>'


def to_html(markdown: str) -> str:
    """Headings, paragraphs, "- " lists, bold, italic, code and links; anything else stays as text."""
    # A heading needs no empty line after it.
    text = re.sub(r"(?m)^(#+ .*)$", r"\n\1\n", markdown.replace("\r\n", "\n"))
    return "</p>" + "".join(_block(block.strip()) for block in re.split(r"\n\s*\n", text) if block.strip())
