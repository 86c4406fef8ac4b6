"""When DSMs were taken: whether that can be, and whether what the user says is what their files say."""

from __future__ import annotations

from datetime import date, datetime, time, timedelta, timezone
from typing import List, Mapping, Optional

from ..contracts.errors import OptionError
from ..contracts.findings import Finding
from ..imagery.acquisition import acquired, moment
from ..imagery.raster import opened
from ..names import surface_days
from .parameters import GATE, GateParameters

_DAY = timedelta(days=1)


def read_time(text: str) -> Optional[datetime]:
    """A day (``2024-05-01``) or a time in ISO 8601 (UTC without a zone); None for anything else."""
    text = text.strip()
    try:
        return datetime.combine(date.fromisoformat(text), time(), timezone.utc)
    except ValueError:
        return moment(text)


def time_of(path: str) -> Optional[datetime]:
    """The time that a DSM's file, or a STAC item beside it, says; else the middle of the days of a DSM of this plugin.

    Raises ImageError for a file that cannot be read.
    """
    with opened(path) as dataset:
        said = acquired(dataset, path)
    days = [taken for taken in map(read_time, surface_days(path)) if taken is not None]
    return moment(said) if said else days[0] + (days[-1] - days[0]) / 2 if days else None


def require_possible(taken: datetime, option: str, value: str, parameters: GateParameters = GATE) -> None:
    """Raise OptionError for a time before the first satellite, or one that is still to come."""
    now = datetime.now(timezone.utc)
    if not parameters.least_year <= taken.year or taken > now + _DAY:
        when = f"{taken.year:04d}-{taken:%m-%d}"
        reason = f"would be of {when}: a satellite's images are of a day between {parameters.least_year} and today"
        raise OptionError(option, value, reason)


def time_findings(said: Mapping[str, datetime]) -> List[Finding]:
    """The DSMs, by their paths, whose files say another time than the user by more than a day."""
    findings = []
    for path, taken in said.items():
        own = time_of(path)
        if own is not None and abs(own - taken) > _DAY:
            text = f"DATES says {taken:%Y-%m-%d} for '{path}', and the file {own:%Y-%m-%d}"
            findings.append(Finding("date-contradicts", f"{text}: check the order of DATES.", "doubt"))
    return findings


def order_findings(before: str, after: str) -> List[Finding]:
    """Whether the DSM that is given as the earlier one is the later one by its file's own time."""
    first, second = time_of(before), time_of(after)
    if first is None or second is None or first <= second:
        return []
    text = f"'{before}' of BEFORE was taken on {first:%Y-%m-%d}, after '{after}' of AFTER ({second:%Y-%m-%d})"
    return [Finding("dates-reversed", f"{text}: gains and losses are exchanged.", "doubt")]
