"""Help pages in the little Markdown we write them in, as the HTML that QGIS shows."""

from __future__ import annotations

import html
import re


def _inline(text: str) -> str:
    text = html.escape(text, quote=False)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    text = re.sub(r"\*\*([^*]+)\*\*", r"<b>\1</b>", text)
    text = re.sub(r"\*([^*]+)\*", r"<i>\1</i>", text)
    return re.sub(r"\[([^\]]+)\]\(([^)\s]+)\)", r'<a href="\2">\1</a>', text)


def _block(block: str) -> str:
    if block.startswith("#"):
        return f"<h3>{_inline(block.lstrip('#').strip())}</h3>"
    if block.startswith("- "):
        items = re.split(r"\n- ", block[2:])
        return "<ul>" + "".join(f"<li>{_inline(' '.join(item.split()))}</li>" for item in items) + "</ul>"
    return f"<p>{_inline(' '.join(block.split()))}</p>"


def to_html(markdown: str) -> str:
    """Headings, paragraphs, "- " lists, bold, italic, code and links; anything else stays as text."""
    # A heading needs no empty line after it.
    text = re.sub(r"(?m)^(#+ .*)$", r"\n\1\n", markdown.replace("\r\n", "\n"))
    return "".join(_block(block.strip()) for block in re.split(r"\n\s*\n", text) if block.strip())
