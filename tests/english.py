"""Which texts are English: by words that no other language of ours has, outside of what is quoted."""

from __future__ import annotations

import re

# Only words that German does not have: "in", "an", "so", "was", "die" are both.
_WORDS = re.compile(
    r"\b(the|of|is|are|and|with|from|that|which|by|to|for|not|has|have|its|it|be|this|these|each|where|no|or|than|only|"
    r"at|on|as|tiles?|heights|cells?|errors?|weights?|layers|choose|give|run|must|north|south|middle|corrected|"
    r"registered|determined|horizontally)\b"
)
_QUOTED = re.compile(
    r"„[^“]*“|'[^']*'|`[^`]*`|<i>.*?</i>|<code>.*?</code>|\*[^*]+\*|\S*[/\\]\S*|<[^>]*>|\S+\.\w{2,4}\b"
)


def english_in(texts) -> list[str]:
    """Those of the texts that are English, or in which a part is."""
    return [text for text in texts if text and _WORDS.search(_QUOTED.sub(" ", text))]
