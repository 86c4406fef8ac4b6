"""When the DSMs of a series were taken: as the user says, or else as their files do."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import List, Sequence

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.errors import OptionError
from ..gate.times import read_time, require_possible, time_of

_YEAR = timedelta(days=365.25)


@dataclass(frozen=True)
class DatedDsm:
    """A DSM's path, its confidence raster ("" = none) and when its images were taken, UTC; ``label`` is that as text:
    the day, or the day and the time where two DSMs have one day."""

    path: str
    confidence: str
    taken: datetime
    label: str = ""


def dated(dsms: Sequence[str], confidences: Sequence[str], dates: Sequence[str]) -> List[DatedDsm]:
    """The DSMs in the order of their times: those that are given, else the files' own.

    Raises OptionError where a DSM has no time, where two have the same, and for a text that is no time; ImageError for
    a file that cannot be read.
    """
    found = []
    for index, path in enumerate(dsms):
        taken = read_time(dates[index]) if dates else time_of(path)
        if taken is None and dates:
            raise OptionError("DATES", dates[index], "must be a day such as 2024-05-01, or a time in ISO 8601")
        if taken is None:
            reason = "has no time, neither in its metadata nor in a STAC item beside it: give all DATES"
            raise OptionError("DSMS", path, reason)
        require_possible(taken, "DATES" if dates else "DSMS", dates[index] if dates else path)
        found.append(DatedDsm(path, confidences[index] if confidences else "", taken))
    found.sort(key=lambda each: each.taken)
    for one, other in zip(found, found[1:]):
        if one.taken == other.taken:
            at = f"{one.taken:%Y-%m-%d %H:%M}"
            if dates:
                why = f"is the time of '{one.path}' and of '{other.path}': leave one of them out, or correct its date"
                raise OptionError("DATES", at, why)
            why = f"has the time of '{other.path}' ({at}): leave one out, or give the DATES"
            raise OptionError("DSMS", one.path, why)
    days = [each.taken.date() for each in found]
    form = "%Y-%m-%d" if len(set(days)) == len(days) else "%Y-%m-%d %H:%M:%S"
    return [DatedDsm(each.path, each.confidence, each.taken, each.taken.strftime(form)) for each in found]


def years_of(series: Sequence[DatedDsm]) -> FloatArray:
    """(dates,) years since the first date."""
    return np.array([(each.taken - series[0].taken) / _YEAR for each in series])


def periods(series: Sequence[DatedDsm]) -> List[List[str]]:
    """The first and the last moment, ISO 8601, that a map of each date stands for: up to the next date."""
    starts = [each.taken for each in series]
    ends = [*starts[1:], starts[-1] + (starts[-1] - starts[-2])]
    form = "%Y-%m-%dT%H:%M:%SZ"
    return [[start.strftime(form), (end - timedelta(seconds=1)).strftime(form)] for start, end in zip(starts, ends)]
