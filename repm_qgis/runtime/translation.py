"""The engine's English in a reader's language, by templates: the code stays plain English, and nothing is marked.

``i18n/engine_XX.json`` is the catalogue of a language: each sentence that a person may read, with numbered fields for
what is filled in (``"{0} tiles of up to {1} px"``), and its translation with the same fields in any order.
``scripts/i18n.py`` collects the sentences from the source, and says which ones lack a translation.

A text is compared with the templates, the most literal first; the contents of a field are translated in the same way,
because sentences consist of phrases. Texts that no template fits stay as they are: paths, names; numbers take the
decimal comma of a language that has one, but in lists and coordinates.
"""

from __future__ import annotations

import json
import re
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Callable, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence

from ..contracts.data_folder import DATA_FOLDER
from ..contracts.errors import OptionError

SOURCE_LANGUAGE = "en"
_FOLDER = DATA_FOLDER / "i18n"
_FIELD = re.compile(r"\{(\d+)\}")
_LETTERS = re.compile(r"[^\W\d_]{2}")
_WORDS = re.compile(r"[^\W\d_]{2}[,;:]?\s+[^\W\d_]{2}")
_DECIMAL = re.compile(r"(?<![\w.:/\\])(\d{1,5})\.(\d{1,4})(?!\w|[.:/\\]\S)")
_COMMA = ("de",)
"""Languages with a decimal comma."""
_MOST_SPLITS, _MOST_TRIES = 12, 4000
_JOINTS = (". ", "? ", ": ", "; ", ", ")
"""Where a text that no template fits is cut, and its parts are translated by themselves."""
_FEW_LETTERS = 8
_ADDED = (" ", ",", ".", ";", ":")
_CODE = re.compile(r"[a-z]{2,3}([_-][A-Za-z]{2,8})*")


class _Found(NamedTuple):
    """A translation; ``whole`` where no words in it are left as they were."""

    text: str
    whole: bool


class _Template:
    """A sentence with fields, and its translation."""

    def __init__(self, source: str, target: str) -> None:
        before, after = source[:1] in _ADDED, source[-1:] == " "
        self._pieces = [*([""] if before else []), *_FIELD.split(source)[::2], *([""] if after else [])]
        self._numbers = [*([-1] if before else []), *map(int, _FIELD.findall(source)), *([-2] if after else [])]
        self._target = ("{-1}" if before else "") + target + ("{-2}" if after else "")
        # A path or a name in quotation marks is not translated, nor what somebody is to type.
        around = zip(self._pieces, self._pieces[1:])
        self._kept = [left[-1:] == "=" or (left[-1:] == "'" and right[:1] == "'") for left, right in around]
        self.weight = sum(map(len, self._pieces))
        self._is_short = sum(letter.isalpha() for piece in self._pieces for letter in piece) < _FEW_LETTERS

    def may_be(self, text: str) -> bool:
        """Whether a text begins and ends as this does."""
        first, last = self._pieces[0], self._pieces[-1]
        return text.startswith(first) and text.endswith(last) and len(text) >= self.weight

    def translated(self, text: str, search: _Search) -> Optional[_Found]:
        """The translation of a text for which this :meth:`may_be` the template; None where it is not."""
        first, *middle, last = self._pieces
        inside, best = text[len(first) : len(text) - len(last)], None
        for fields in islice(_splits(inside, middle), _MOST_SPLITS):
            found = [
                _Found(field, "'" not in field) if kept else search.of(field) for field, kept in zip(fields, self._kept)
            ]
            values = dict(zip(self._numbers, (each.text for each in found)))
            whole = all(each.whole for each in found)
            if whole or (best is None and not self._is_short):  # "{0} to {1}" would fit half of all sentences
                best = _Found(_filled(self._target, values), whole)
            if whole:
                break
        return best


def _filled(target: str, values: Mapping[int, str]) -> str:
    return re.sub(r"\{(-?\d+)\}", lambda field: values[int(field[1])], target)


def _splits(text: str, pieces: Sequence[str]) -> Iterator[List[str]]:
    """The ways to cut a text at the pieces, in their order, the earliest first: what stands between them.

    Where one piece is not found behind another, it is not found behind a later one: the search ends.
    """
    if not pieces:
        yield [text]
        return
    at = text.find(pieces[0])
    while at >= 0:
        none = True
        for rest in _splits(text[at + len(pieces[0]) :], pieces[1:]):
            none = False
            yield [text[:at], *rest]
        if none:
            return
        at = text.find(pieces[0], at + 1)


def _is_addition(source: str) -> bool:
    """Whether a phrase is added to another one: it begins with a space or a comma, or ends with a space."""
    return source[:1] in _ADDED or source[-1:] == " "


class Translator:
    """The catalogue of one language; ``language`` is "en" where there is none."""

    def __init__(self, language: str, catalogue: Mapping[str, str]) -> None:
        self.language = language
        known = {source: target for source, target in catalogue.items() if target}
        self._exact = {source: target for source, target in known.items() if not _FIELD.search(source)}
        templates = [_Template(a, b) for a, b in known.items() if _FIELD.search(a) or _is_addition(a)]
        self._templates = sorted(templates, key=lambda template: -template.weight)
        self.search = lru_cache(maxsize=4096)(self._search)

    @classmethod
    def of(cls, language: str) -> Translator:
        """The translator for a language's code, such as "de" or "de_AT"."""
        for name in (language.replace("-", "_"), re.split("[_-]", language)[0]):
            path = _FOLDER / f"engine_{name}.json"
            if _CODE.fullmatch(name) and path.exists():
                return _loaded(name, path)
        return _ENGLISH

    def translate(self, text: str) -> str:
        """The text in this language; unknown parts stay as they are."""
        return self.search(text).text

    def _search(self, text: str) -> _Found:
        comma = self.language.split("_")[0] in _COMMA
        return _Search(self._exact, self._templates, comma).of(text) if self._exact else _Found(text, False)


class _Search:
    """The translation of one text, with those of its parts; gives up after so much work, as texts may be hostile."""

    def __init__(self, exact: Mapping[str, str], templates: Sequence[_Template], comma: bool) -> None:
        self._exact, self._templates, self._comma = exact, templates, comma
        self._known: Dict[str, _Found] = {}
        self._left = _MOST_TRIES

    def of(self, text: str) -> _Found:
        """The best of the ways to translate a text: one that leaves no words, else the first that leaves few."""
        if text in self._exact:
            return _Found(self._exact[text], True)
        if not _LETTERS.search(text):
            return _Found(_DECIMAL.sub(r"\1,\2", text) if self._comma and ", " not in text else text, True)
        if text not in self._known:
            self._known[text] = _Found(text, not _WORDS.search(text))  # where its own part leads back to it
            best = None
            for found in self._ways(text) if self._left > 0 else ():
                best = found if best is None or found.whole else best
                if best.whole:
                    break
            self._known[text] = best or self._known[text]
        return self._known[text]

    def _ways(self, text: str) -> Iterator[_Found]:
        if " " in text.strip():
            for template in self._templates:
                if template.may_be(text) and self._left > 0:
                    self._left -= 1
                    found = template.translated(text, self)
                    if found is not None:
                        yield found
        # A phrase that was made a sentence: with a full stop, or with a capital.
        if text[-1:] == ".":
            yield from self._changed(text[:-1], lambda word: f"{word}.")
        for joint in _JOINTS:
            yield from self._by_parts(text, joint)
        if text[:1].isupper() and not text[1:2].isupper():
            yield from self._changed(text[0].lower() + text[1:], lambda word: word[0].upper() + word[1:])

    def _changed(self, other: str, back: Callable[[str], str]) -> Iterator[_Found]:
        found = self.of(other)
        if found.text != other:
            yield _Found(back(found.text), found.whole)

    def _by_parts(self, text: str, joint: str) -> Iterator[_Found]:
        """The parts of a text translated by themselves."""
        parts = text.split(joint)
        if joint == ". ":
            parts = [f"{part}." for part in parts[:-1]] + parts[-1:]
        found = [self.of(part) for part in parts] if len(parts) > 1 else []
        if any(each.text != part for each, part in zip(found, parts)):
            joined = (" " if joint == ". " else joint).join(each.text for each in found)
            yield _Found(joined, all(each.whole for each in found))


_ENGLISH = Translator(SOURCE_LANGUAGE, {})


@lru_cache(maxsize=8)
def _loaded(language: str, path: Path) -> Translator:
    return Translator(language, json.loads(path.read_text(encoding="utf-8")))


_reader: ContextVar[Translator] = ContextVar("reader", default=_ENGLISH)
_NO_LABELS: Mapping[str, str] = MappingProxyType({})
_labels: ContextVar[Mapping[str, str]] = ContextVar("labels", default=_NO_LABELS)


@contextmanager
def written_in(language: Optional[str], labels: Optional[Mapping[str, str]] = None) -> Iterator[None]:
    """Within the block, reports and legends are written in this language; None is English.

    ``labels`` are the dialog's labels of the options, by their names in capitals: reports use these instead. Raises
    OptionError for what is no language's code or no labels. A language without a catalogue is English.
    """
    if labels is not None and not (
        isinstance(labels, Mapping) and all(isinstance(text, str) for pair in labels.items() for text in pair)
    ):
        raise OptionError("labels", labels, "must be texts by the names of options")
    if language is not None and not (isinstance(language, str) and _CODE.fullmatch(language)):
        raise OptionError("language", language, "must be a language's code, such as en or de")
    token, named = _reader.set(Translator.of(language or SOURCE_LANGUAGE)), _labels.set(labels or {})
    try:
        yield
    finally:
        _reader.reset(token)
        _labels.reset(named)


def reader() -> Translator:
    """The reader of the texts that are written now."""
    return _reader.get()


def labels() -> Mapping[str, str]:
    """The labels of the options in the reader's dialog, by their names in capitals; empty where there is no dialog."""
    return _labels.get()


def said(text: str) -> str:
    """A text of a report or a legend in its reader's language."""
    return _reader.get().translate(text)
