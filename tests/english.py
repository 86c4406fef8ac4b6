"""Which texts are English, by words that no other language of ours has; and which of its constructions stop readers."""

from __future__ import annotations

import pathlib
import re
import tokenize

# Only words that German does not have: "in", "an", "so", "was", "die" are both.
_WORDS = re.compile(
    r"\b(the|of|is|are|and|with|from|that|which|by|to|for|not|has|have|its|it|be|this|these|each|where|no|or|than|only|"
    r"at|on|as|tiles?|heights|cells?|errors?|weights?|layers|choose|give|run|must|north|south|middle|corrected|"
    r"registered|determined|horizontally)\b"
)
_QUOTED = re.compile(
    r"„[^“]*“|'[^']*'|`[^`]*`|<i>.*?</i>|<code>.*?</code>|\*[^*]+\*|\S*[/\\]\S*|<[^>]*>|\S+\.\w{2,4}\b|--[a-z-]+"
)


_STOPPERS = re.compile(
    r"\b(?:lets? expect|(?:is|are) (?:heard|believed)|nobody tells|can(?:not)? be told|(?:is|are) told|tells? nothing|"
    r"(?:takes?|taken) (?:it )?(?:away|out)|(?:say|says) nothing|that (?:is|are) none[.,;:]|"
    r"wants tls|lonely|back and forth|has against|speaks for|lets them pass|in its word|stands? behind)",
    re.IGNORECASE,
)
"""Constructions at which readers stop whose first language is another one; each of them was in the code once."""
_PROSE = {tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", tokenize.COMMENT)}


def stoppers_in(text: str) -> list[str]:
    """The constructions in a text that stop readers, wherever its lines end."""
    return _STOPPERS.findall(" ".join(text.split()))


def prose_of(path: pathlib.Path) -> str:
    """What a module says to readers: its comments, docstrings and texts, one after the other, without marks."""
    with tokenize.open(path) as stream:
        tokens = [token.string for token in tokenize.generate_tokens(stream.readline) if token.type in _PROSE]
    return " ".join(token.strip("#\"' ") for token in tokens)


def english_in(texts) -> list[str]:
    """Those of the texts that are English, or in which a part is."""
    return [text for text in texts if text and _WORDS.search(_QUOTED.sub(" ", text))]
