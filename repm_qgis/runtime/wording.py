"""Texts as the reader of a dialog or report expects them: with its labels, and the decimals of the language."""

from __future__ import annotations

import re
from typing import Callable, Mapping

_COMMAS = ("de",)
"""Languages that write a comma before decimals."""
# fmt: off
_ALSO_WORDS = frozenset((
    "CRS", "DSM", "DEM", "EPT", "XS", "CLOUD", "MESH", "TILE", "VIEW", "MODEL", "FILL", "ERROR", "OUTPUT",
    "REPORT", "METHOD",
))
"""Names of parameters that are words as well: labels stand for them only where they are meant as names."""
# fmt: on
_DECIMAL = re.compile(r"(?<![\w.,:/\\])(\d+)\.(\d+)(?![.,]?\w)")


def with_labels(text: str, labels: Mapping[str, str], escape: Callable[[str], str] = str) -> str:
    """Names of parameters as the dialog shows them: "(GCPS)", "ALIGN=3d" and "DSM is ..." with their labels.

    ``labels`` are by the names in capitals, and pass through ``escape``.
    """
    if not labels:
        return text

    def label(name: str) -> str:
        return f"‘{escape(labels[name])}’"

    names = "|".join(sorted(map(re.escape, labels), key=len, reverse=True))
    text = re.sub(rf"^({names})(?= (?:is|ist|'|„))", lambda named: label(named[1]), text)
    text = re.sub(rf"(?<![\w\"'])({names})\s?=\s?(?=\w)", lambda named: f"{label(named[1])} = ", text)
    text = re.sub(rf"\(({names})\)", lambda named: f"({label(named[1])})", text)
    text = re.sub(r"(?i)\b(\w[^().<>]{3,60}?) \(‘\1’\)", r"‘\1’", text)  # whose label are the very words
    others = "|".join(name for name in names.split("|") if name not in _ALSO_WORDS and len(name) > 3)
    if not others:
        return text
    return re.sub(rf"(?<![\w\"'‘])({others})(?![\w’]|\.\w)", lambda named: label(named[1]), text)


def with_decimals(text: str, language: str) -> str:
    """Numbers with the decimals of a language, by its code."""
    return _DECIMAL.sub(r"\1,\2", text) if language.startswith(_COMMAS) else text
