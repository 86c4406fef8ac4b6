"""The engine's English in a reader's language, by templates: the code stays plain English, and nothing is marked.

``i18n/engine_XX.json`` is the catalogue of a language: each sentence that a person may read, with numbered fields for
what is filled in (``"{0} tiles of up to {1} px"``), and its translation with the same fields in any order.
``scripts/i18n.py`` collects the sentences from the source, and says which ones lack a translation.

A text is compared with the templates, the most literal first; what stands in a field is translated in the same way, as
sentences are made of phrases. What nothing fits stays as it is: numbers, paths, names.
"""

from __future__ import annotations

import json
import re
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import Iterator, List, Mapping, Optional

from .errors import OptionError

SOURCE_LANGUAGE = "en"
_FOLDER = Path(__file__).resolve().parents[1] / "i18n"
_FIELD = re.compile(r"\{(\d+)\}")
_LETTERS = re.compile(r"[^\W\d_]{2}")
_WORDS = re.compile(r"[^\W\d_]{2}\W+[^\W\d_]{2}")
_JOINTS = (". ", "? ", ": ", "; ", ", ")
"""Where a text that no template fits is cut, and its parts are translated by themselves."""
_FEW_LETTERS = 8
_CODE = re.compile(r"[a-z]{2,3}([_-][A-Za-z]{2,8})*")


class _Template:
    """A sentence with fields, and its translation."""

    def __init__(self, source: str, target: str) -> None:
        before, after = source[:1] in (" ", ","), source[-1:] == " "
        self._pieces = ["", *_FIELD.split(source)[::2]] if before else _FIELD.split(source)[::2]
        self._numbers = [*([-1] if before else []), *map(int, _FIELD.findall(source)), *([-2] if after else [])]
        self._pieces += [""] if after else []
        self._target = ("{-1}" if before else "") + target + ("{-2}" if after else "")
        # A path or a name in quotation marks is nobody's sentence.
        around = zip(self._pieces, self._pieces[1:])
        self._kept = [left[-1:] == "'" and right[:1] == "'" for left, right in around]
        self.weight = sum(map(len, self._pieces))
        self._short = sum(character.isalpha() for piece in self._pieces for character in piece) < _FEW_LETTERS

    def translated(self, text: str, translator: Translator) -> Optional[str]:
        """The translation of a text; None where this is not its template."""
        found = self._fields(text)
        if found is None:
            return None
        words = [field if kept else translator.find(field) for field, kept in zip(found, self._kept)]
        if self._short and any(_WORDS.search(field) for field, word in zip(found, words) if word is None):
            return None  # "{0} to {1}" would fit half of all sentences
        values = {number: field if word is None else word for number, field, word in zip(self._numbers, found, words)}
        return re.sub(r"\{(-?\d+)\}", lambda field: values[int(field[1])], self._target)

    def _fields(self, text: str) -> Optional[List[str]]:
        """What stands in the fields, each as short as can be; None where the text does not fit. Takes linear time."""
        first, *middle, last = self._pieces
        if not text.startswith(first) or not text.endswith(last) or len(text) < self.weight:
            return None
        at, end, found = len(first), len(text) - len(last), []
        for piece in middle:
            next_at = text.find(piece, at, end)
            if next_at < 0:
                return None
            found.append(text[at:next_at])
            at = next_at + len(piece)
        return [*found, text[at:end]]


def _is_addition(source: str) -> bool:
    """Whether a phrase is added to another one: it begins with a space or a comma, or ends with a space."""
    return source[:1] in (" ", ",") or source[-1:] == " "


class Translator:
    """The catalogue of one language; ``language`` is "en" where there is none."""

    def __init__(self, language: str, catalogue: Mapping[str, str]) -> None:
        self.language = language
        known = {source: target for source, target in catalogue.items() if target}
        self._whole = {source: target for source, target in known.items() if not _FIELD.search(source)}
        templates = [_Template(*pair) for pair in known.items() if _FIELD.search(pair[0]) or _is_addition(pair[0])]
        self._templates = sorted(templates, key=lambda template: -template.weight)
        self.find = lru_cache(maxsize=4096)(self._find)

    @classmethod
    def of(cls, language: str) -> Translator:
        """The translator for a language's code, such as "de" or "de_AT"."""
        for name in (language.replace("-", "_"), re.split("[_-]", language)[0]):
            path = _FOLDER / f"engine_{name}.json"
            if _CODE.fullmatch(name) and path.exists():
                return _loaded(name, path)
        return _ENGLISH

    def translate(self, text: str) -> str:
        """The text in this language, unchanged where nothing of it is known."""
        found = self.find(text)
        return text if found is None else found

    def _find(self, text: str) -> Optional[str]:
        """The text in this language; None where no template fits it or a part of it."""
        if not self._whole or not _LETTERS.search(text):
            return None
        if text in self._whole:
            return self._whole[text]
        if " " not in text.strip():
            return None
        for template in self._templates:
            found = template.translated(text, self)
            if found is not None:
                return found
        return self._by_parts(text)

    def _by_parts(self, text: str) -> Optional[str]:
        for joint in _JOINTS:
            parts = text.split(joint)
            if joint == ". ":
                parts = [f"{part}." for part in parts[:-1]] + parts[-1:]
            if len(parts) > 1:
                words = [self.find(part) for part in parts]
                if any(word is not None for word in words):
                    joined = [part if word is None else word for part, word in zip(parts, words)]
                    return (" " if joint == ". " else joint).join(joined)
        return None


_ENGLISH = Translator(SOURCE_LANGUAGE, {})


@lru_cache(maxsize=8)
def _loaded(language: str, path: Path) -> Translator:
    return Translator(language, json.loads(path.read_text(encoding="utf-8")))


_reader: ContextVar[Translator] = ContextVar("reader", default=_ENGLISH)


@contextmanager
def written_in(language: Optional[str]) -> Iterator[None]:
    """Within the block, reports and legends are written in this language; None is English.

    Raises OptionError for what is no language's code. A language without a catalogue is English.
    """
    if language is not None and not (isinstance(language, str) and _CODE.fullmatch(language)):
        raise OptionError("language", language, "must be a language's code, such as en or de")
    token = _reader.set(Translator.of(language or SOURCE_LANGUAGE))
    try:
        yield
    finally:
        _reader.reset(token)


def reader() -> Translator:
    """Who reads what is written now."""
    return _reader.get()


def said(text: str) -> str:
    """A text of a report or a legend in its reader's language."""
    return _reader.get().translate(text)
