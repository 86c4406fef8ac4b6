"""A finished page made readable: explained words, the dialog's labels, decimals of the language.

All is done to the finished page, between its tags: so every page has it, and texts need not be written for it.
"""

from __future__ import annotations

import html
import re
from functools import lru_cache, partial
from typing import Dict, Iterator, Mapping, Tuple

from ..contracts.data_folder import DATA_FOLDER
from ..runtime.translation import SOURCE_LANGUAGE
from ..runtime.wording import with_decimals, with_labels

_DOCS = DATA_FOLDER / "docs"
# fmt: off
_EVERYDAY = frozenset((
    "adjustment", "margin", "headroom", "tile", "track", "choice", "source", "provenance", "candidate",
    "evidence", "fusion", "support", "mosaic", "seam", "scene", "stage", "parameters", "gridding", "score",
    "backend", "localisation", "projection", "image", "refinement",
))
"""Words of the glossary that a page uses in their everyday sense, too."""
# fmt: on
_PARTS = re.compile(r"(<style>.*?</style>|<pre>.*?</pre>|<[^>]*>)", re.DOTALL)
_NO_WORDS = ("h1", "title", "a", "svg", "code")


def readable(page: str, language: str, labels: Mapping[str, str]) -> str:
    """A page with the first of each technical word in a section explained in a pop-up, the ``labels`` of parameters in
    place of their names, and decimals as the language has them."""
    explained = _Explained(language)
    inside: list[str] = []
    parts = []
    for number, part in enumerate(_PARTS.split(page)):
        if number % 2:
            _follow(part, inside)
            if part.startswith("<h2"):
                explained.forget()
            parts.append(part)
            continue
        if not part.strip() or "title" in inside:
            parts.append(part)
            continue
        text = part if "svg" in inside else with_labels(part, labels, partial(html.escape, quote=False))
        text = with_decimals(text, language)
        parts.append(text if any(tag in _NO_WORDS for tag in inside) else explained.of(text))
    return "".join(parts)


def _follow(tag: str, inside: list[str]) -> None:
    """Keep track of the tags around a text that matter here."""
    name = re.match(r"</?(\w+)", tag)
    if name is None or name[1] not in _NO_WORDS or tag.endswith("/>"):
        return
    if tag.startswith("</"):
        if name[1] in inside:
            inside.remove(name[1])
    else:
        inside.append(name[1])


class _Explained:
    """Marks words of the glossary, each once until they are forgotten."""

    def __init__(self, language: str) -> None:
        self._words, self._known = _glossary(language)
        self._seen: set[str] = set()

    def forget(self) -> None:
        self._seen.clear()

    def of(self, text: str) -> str:
        return self._words.sub(self._marked, text)

    def _marked(self, found: "re.Match[str]") -> str:
        word = found[0]
        forms = word, word.lower(), word[:-1], word[:-1].lower()
        meaning = next((self._known[form] for form in forms if form in self._known), "")
        if not meaning or meaning in self._seen:
            return word
        self._seen.add(meaning)
        return f'<abbr class="term" tabindex="0" title="{html.escape(meaning)}">{word}</abbr>'


@lru_cache(maxsize=4)
def _glossary(language: str) -> Tuple["re.Pattern[str]", Dict[str, str]]:
    """A pattern of the words that are explained, and the meaning of each; words in lower case stand for any case."""
    known: Dict[str, str] = {}
    for names, meaning in _rows(language):
        for name in filter(None, (each.strip() for each in re.split(r"[;,()]", names))):
            if name.lower() not in _EVERYDAY and not name.startswith(("in short", "kurz")):
                known.setdefault(name if name != name.lower() and len(name) <= 6 else name.lower(), meaning)
    choices = "|".join(
        f"(?:{re.escape(html.escape(name, quote=False))}s?)" if name != name.lower() else f"(?i:{re.escape(name)}s?)"
        for name in sorted(known, key=len, reverse=True)
    )
    return re.compile(rf"(?<![\w&#-])(?:{choices or '(?!)'})(?![\w-])"), known


def _rows(language: str) -> Iterator[Tuple[str, str]]:
    """Words and meanings of the glossary's table in a language; none where it has no glossary."""
    short = language.split("_")[0]
    path = _DOCS / ("glossary.md" if short == SOURCE_LANGUAGE else f"{short}/glossary.md")
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    began = False
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("|---"):
            began = True
        elif began and line.startswith("|") and len(cells) == 4 and cells[1]:
            yield cells[0].strip("*"), re.sub(r"[*`]|\[([^]]*)\]\([^)]*\)", r"\1", cells[1])
