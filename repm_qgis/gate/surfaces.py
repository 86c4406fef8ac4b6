"""DSMs that are compared or put together, with their confidence rasters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence

from ..contracts.file_kinds import is_cloud
from ..contracts.findings import Finding
from .companions import confidence_findings
from .content import require_distinct_content


@dataclass(frozen=True)
class Entry:
    """A DSM and its confidence raster ("" for none), with the options that name them."""

    option: str
    path: str
    confidence: str = ""
    confidence_option: str = ""


def entries_of(dsms: Sequence[str], confidences: Sequence[str]) -> List[Entry]:
    """The DSMs of DSMS with the rasters of CONFIDENCES in that order, which may be none at all."""
    return [Entry("DSMS", path, own, "CONFIDENCES") for path, own in zip(dsms, confidences or [""] * len(dsms))]


def surface_findings(entries: Sequence[Entry], why: str) -> List[Finding]:
    """What is to be known of DSMs that are used together: copies are refused, or ``why`` ("it would count as a date
    of its own"), and confidence rasters must be theirs.

    Raises OptionError for a copy, ImageError for a raster that cannot be used.
    """
    named: dict[str, List[str]] = {}
    for entry in entries:
        if not is_cloud(entry.path):
            named.setdefault(entry.option, []).append(entry.path)
    require_distinct_content(named, why)
    with_errors = [each for each in entries if each.confidence]
    return [
        finding
        for each in with_errors
        for finding in confidence_findings(each.path, each.confidence, each.confidence_option)
    ]
