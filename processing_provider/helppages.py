"""The documents of docs/ as HTML for a browser, without a network.

An algorithm's page has the labels of its parameters as the dialog shows them. A document of docs/LANGUAGE stands in
place of the English one; where an algorithm has no page there, its help in that language and all its parameters make
one, which leads to the English page. QGIS's Python has no renderer of
Markdown: this one knows what our documents use, that is headings, paragraphs, lists, tables, code, pictures, links,
and a test compares each document with what markdown-it-py makes of it.
"""

from __future__ import annotations

import html
import os
import re
from functools import cache
from typing import Mapping, Optional, Sequence

from qgis.core import QgsApplication
from qgis.PyQt.QtCore import QCoreApplication, QUrl

from .engine import PLUGIN_FOLDER
from .helptext import inline

_DOCS = os.path.join(PLUGIN_FOLDER, "docs")
_LABELLED = ("input", "parameter", "output")  # tables whose first column has ids
_FRAME = """<!DOCTYPE html>
<html lang="{language}"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title><style>
{style}
td:first-child{{overflow-wrap:anywhere;min-width:11rem}}img{{max-width:100%}}p,li{{max-width:46rem}}
</style></head><body><main>
{body}
</main></body></html>
"""


def page(name: str, language: str, labels: Mapping[str, str], more: Mapping[str, str], title: str = "") -> str:
    """Write an algorithm's page, and the documents that it leads to, where they are not as they should be; its address.

    ``labels`` are those of the parameters and outputs by their ids, ``more`` their explanations for those that the page
    does not have, ``title`` is the algorithm's. The pages lie in the user's profile. "" where there is no such page;
    raises WorkspaceError.
    """
    folder, short = _pages(language), _short(language)
    source = os.path.join(_DOCS, "algorithms", f"{name}.md")
    if not os.path.exists(source):
        return ""
    _write_documents(folder, short)
    target = os.path.join(folder, "algorithms", f"{name}.html")
    help_page = os.path.join(PLUGIN_FOLDER, "resources", "help", short, f"{name}.md")
    with open(source, encoding="utf-8") as stream:
        english = to_page(stream.read(), os.path.dirname(source), labels, more)
    if short != "en" and os.path.exists(help_page):
        _write(os.path.join(folder, "algorithms", f"{name}_en.html"), english)
        with open(help_page, encoding="utf-8") as stream:
            text = f"# {title}\n\n{stream.read()}\n\n[{_tr('The page in English, with all details')}]({name}_en.html)\n"
        _write(target, to_page(text, os.path.dirname(help_page), labels, more, short))
    else:
        _write(target, english)
    return QUrl.fromLocalFile(target).toString()


def document(name: str, language: str) -> str:
    """Write a document of docs/ and those that it leads to, without the algorithms' pages; its address.

    Raises WorkspaceError.
    """
    folder = _pages(language)
    _write_documents(folder, _short(language))
    return QUrl.fromLocalFile(os.path.join(folder, f"{name}.html")).toString()


def _pages(language: str) -> str:
    """The folder of the pages in the user's profile."""
    return os.path.join(QgsApplication.qgisSettingsDirPath(), "repm", "help", language)


def _short(language: str) -> str:
    """The language itself, without a country."""
    return re.split("[_-]", language)[0].lower() or "en"


@cache
def _write_documents(folder: str, language: str) -> None:
    """Write what the algorithms' pages link to, in a language as far as there is one: once in a session."""
    for place, folders, names in os.walk(_DOCS):
        if place == _DOCS:
            folders[:] = [each for each in folders if each not in _languages()]
        for name in names:
            if name.endswith(".md") and os.path.basename(place) != "algorithms":
                below = os.path.relpath(place, _DOCS)
                own = os.path.normpath(os.path.join(_DOCS, language, below))
                with open(os.path.join(place, name), encoding="utf-8") as stream:
                    text = stream.read()
                made = to_page(text, place)
                if os.path.exists(os.path.join(own, name)):
                    anchors = [_anchor(each) for each in re.findall(r"(?m)^#+ +(.*)$", text)]
                    _write(os.path.join(folder, below, f"{name[:-3]}_en.html"), made)
                    with open(os.path.join(own, name), encoding="utf-8") as stream:
                        made = to_page(stream.read(), own, language=language, anchors=anchors)
                _write(os.path.join(folder, below, name[:-3] + ".html"), made)


def _languages() -> list[str]:
    """The languages that documents are in, beside English."""
    return [name for name in os.listdir(_DOCS) if len(name) == 2 and os.path.isdir(os.path.join(_DOCS, name))]


def _anchor(title: str) -> str:
    """The name by which links lead to a heading, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", title).strip().lower().replace(" ", "-")


def _tr(text: str) -> str:
    return QCoreApplication.translate("RepmAlgorithm", text)


def _write(path: str, text: str) -> None:
    from ..repm_qgis.runtime.workspace import ensure_folder, write_text

    try:
        with open(path, encoding="utf-8") as stream:
            if stream.read() == text:
                return
    except (OSError, ValueError):
        pass
    ensure_folder(os.path.dirname(path))
    write_text(path, text)


def to_page(
    markdown: str,
    folder: str,
    labels: Optional[Mapping[str, str]] = None,
    more: Optional[Mapping[str, str]] = None,
    language: str = "en",
    anchors: Sequence[str] = (),
) -> str:
    """A whole page; ``folder`` is the document's, from which its pictures are found.

    ``anchors`` are more names for the headings, in their order: those of the English document, which others link to.
    """
    with open(os.path.join(PLUGIN_FOLDER, "resources", "templates", "report.css"), encoding="utf-8") as stream:
        style = stream.read()
    body = _Body(folder, labels or {}, anchors)
    text = body.html(markdown)
    left = [name for name in more or {} if name not in body.named]
    if left:
        rows = "\n".join(f"| {name} | {(more or {})[name]} |" for name in left)
        heading = _tr("Further parameters") if body.named else _tr("Parameters")
        text += body.html(f"## {heading}\n\n| parameter | |\n|---|---|\n{rows}").replace(
            "<th>parameter</th>", "<th></th>"
        )
    title = re.search(r"(?m)^# (.*)$", markdown)
    return _FRAME.format(
        language=language, title=html.escape(title[1].replace("`", "") if title else "REPM"), style=style, body=text
    )


class _Body:
    """Turns the blocks of one document into HTML, and remembers the ids in its tables."""

    def __init__(self, folder: str, labels: Mapping[str, str], anchors: Sequence[str] = ()) -> None:
        self._folder, self._labels, self._anchors = folder, labels, list(anchors)
        self.named: set[str] = set()

    def html(self, markdown: str) -> str:
        text = re.sub(r"(?ms)^```\w*\n(.*?)^```$", lambda code: _indented(code[1]), markdown.replace("\r\n", "\n"))
        text = re.sub(r"(?ms)^<!--.*?-->\n?", "", text)  # for those who write the document
        text = re.sub(r"(?m)^(#+ .*)$", r"\n\1\n", text)
        blocks = [block.strip("\n") for block in re.split(r"\n[ \t]*\n", text) if block.strip()]
        made = "\n".join(map(self._block, blocks))
        # Code and lists go on after an empty line.
        return re.sub(r"</(ul|ol)>\n<\1[^>]*>", "", made.replace("</pre>\n<pre>", "\n\n"))

    def _block(self, block: str) -> str:
        if block.startswith("    "):
            return f"<pre>{html.escape(re.sub(r'(?m)^    ', '', block))}</pre>"
        block = block.strip()
        if block.startswith("#"):
            level, title = len(block) - len(block.lstrip("#")), block.lstrip("#").strip()
            more = f'<a id="{self._anchors.pop(0)}"></a>' if self._anchors else ""
            return f'{more}<h{level} id="{_anchor(title)}">{self._inline(title)}</h{level}>'
        if block.startswith("|"):
            return self._table([row.strip().strip("|").split("|") for row in block.split("\n")])
        for mark, start, end in ((r"- ", "<ul>", "</ul>"), (r"\d+\. ", f'<ol start="{block.split(".")[0]}">', "</ol>")):
            if re.match(mark, block):
                items = re.split(rf"\n{mark}", "\n" + block)[1:]
                return start + "".join(f"<li>{self._inline(' '.join(item.split()))}</li>" for item in items) + end
        return f"<p>{self._inline(' '.join(block.split()))}</p>"

    def _table(self, rows: list[list[str]]) -> str:
        heads, body = rows[0], rows[2:]
        labelled = bool(self._labels) and heads[0].strip().startswith(_LABELLED)
        top = "".join(f"<th>{self._inline(cell.strip())}</th>" for cell in heads)
        made = []
        for first, *rest in body:
            name = self._labelled(first.strip()) if labelled else self._inline(first.strip())
            made.append(f"<td>{name}</td>" + "".join(f"<td>{self._inline(cell.strip())}</td>" for cell in rest))
        lines = "".join(f"<tr>{cells}</tr>" for cells in made)
        return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{lines}</tbody></table></div>'

    def _labelled(self, cell: str) -> str:
        """Ids, each under the label that the dialog shows; other words stay."""

        def named(found: re.Match[str]) -> str:
            self.named.add(found[0])
            return f"<strong>{html.escape(self._labels[found[0]])}</strong><br><code>{found[0]}</code>"

        parts = [part.strip("` ") for part in cell.split(",")]
        if not set(parts) & set(self._labels):
            return self._inline(cell)
        ids = "|".join(map(re.escape, self._labels))
        return "<br>".join(re.sub(rf"^(?:{ids})$", named, html.escape(part)) for part in parts)

    def _inline(self, text: str) -> str:
        text = inline(re.sub(r"!\[([^\]]*)\]\(([^)\s]+)\)", "\0\\1\0\\2\0", text))  # a picture is not yet a link
        text = re.sub(
            "\0([^\0]*)\0([^\0]*)\0", lambda found: f'<img alt="{found[1]}" src="{self._file(found[2])}">', text
        )
        return re.sub(r'<a href="(?![a-z]+:|#)([^"]*)">', lambda found: f'<a href="{self._link(found[1])}">', text)

    def _link(self, target: str) -> str:
        """Where a link leads: to the page of another document, or to a file of the plugin."""
        path, mark, anchor = target.partition("#")
        place = os.path.normpath(os.path.join(self._folder, path))
        if path.endswith(".md") and os.path.commonpath([place, _DOCS]) == _DOCS:
            path = self._between_languages(path, place)
            return f"{path[:-3]}.html{mark}{anchor}"
        if path.endswith(".html"):
            return path
        return self._file(path)

    def _between_languages(self, path: str, place: str) -> str:
        """The path of another document as their pages lie: one in another language takes the place of the English one,
        which is called ..._en.md beside it."""
        inside = os.path.relpath(self._folder, _DOCS).split(os.sep)
        if inside[0] not in _languages():
            return path
        theirs = os.path.relpath(place, _DOCS).split(os.sep)
        if theirs[0] == inside[0]:
            theirs = theirs[1:]
        elif os.path.exists(os.path.join(_DOCS, inside[0], *theirs)):
            theirs[-1] = f"{theirs[-1][:-3]}_en.md"
        return os.path.relpath("/".join(theirs), "/".join(inside[1:]) or ".").replace(os.sep, "/")

    def _file(self, path: str) -> str:
        return QUrl.fromLocalFile(os.path.normpath(os.path.join(self._folder, path))).toString()


def _indented(code: str) -> str:
    return "\n" + re.sub(r"(?m)^", "    ", code.rstrip("\n")) + "\n\n"
