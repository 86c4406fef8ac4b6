"""What a run found that the reader of its result should know: a warning, with an id and a level.

A run's findings are its record (:class:`~repm_qgis.runtime.progress.Recorder`), and its report's verdict is computed
from them: it is "Good." only where there are none.
"""

from __future__ import annotations

from typing import Dict, Iterable, List, Literal, Mapping, Tuple

from .checks import Misfit

Level = Literal["look", "doubt"]
"""``look``: the result may be right, and somebody should look at it. ``doubt``: it contradicts what is known."""


_TAKEN_FOR_GRANTED = ("datum-unknown",)


class Finding(str):
    """A sentence for the user, with the figure or the file and a remedy, under an ``id`` that stays the same whatever
    the sentence says, and a ``level``."""

    id: str
    level: Level

    def __new__(cls, id: str, text: str, level: Level = "look") -> Finding:
        finding = super().__new__(cls, text)
        finding.id, finding.level = id, level
        return finding

    def __getnewargs__(self) -> Tuple[str, str, Level]:  # type: ignore[override]  # str has one argument
        return self.id, str(self), self.level

    def to_mapping(self) -> Dict[str, str]:
        return {"id": self.id, "level": self.level, "text": str(self)}

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> Finding:
        """Raises Misfit for what is no finding."""
        parts = [values.get(name) for name in ("id", "text", "level")] if isinstance(values, Mapping) else [None]
        if not all(isinstance(part, str) for part in parts) or parts[-1] not in ("look", "doubt"):
            raise Misfit("must be a warning with an id, a level and a text", str(values)[:80])
        identity, text, level = map(str, parts)
        return cls(identity, text, "doubt" if level == "doubt" else "look")


def distinct(findings: Iterable[Finding]) -> List[Finding]:
    """Each sentence once, in their order."""
    return list({str(each): each for each in findings}.values())


def by_severity(findings: Iterable[Finding]) -> List[Finding]:
    """Each sentence once: what contradicts the result first, and what was taken for granted last."""
    return sorted(distinct(findings), key=lambda each: (each.level != "doubt", each.id in _TAKEN_FOR_GRANTED))


def verdict_of(findings: Iterable[Finding]) -> Literal["good", "look", "doubt"]:
    """What a result is worth by all that its run found; pages say "Good." for none."""
    levels = {each.level for each in findings}
    return "doubt" if "doubt" in levels else "look" if levels else "good"


def as_percent(share: float) -> str:
    """A share as text, never 0 or 100 % where it is not."""
    percent = 100.0 * share
    if 0.0 < percent < 0.1:
        return "less than 0.1 %"
    return f"{min(percent, 99.9):.1f} %" if share < 1.0 else "100 %"
