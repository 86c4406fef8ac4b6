"""The runs of a workspace, by their reports."""

from __future__ import annotations

import html
import os
import re
import stat
from typing import Dict, Iterator, List, Optional

from ..scene import SceneFacts
from .facts import SCENES, RunFacts, Value
from .options import commanded_options, differing_options, recorded_options, relocated_options
from .places import entries_of

_HEAD_BYTES, _TAIL_BYTES = (
    64 << 10,
    512 << 10,
)  # of a report that are read: its verdict, and the command behind pictures
_OWN_PAGES = ("equivalent_error.html", "refinement.html", "reconstruction.html")  # of the stages of a whole run
_VERDICT = re.compile(
    r'<div class="warning( good)?" role="note"><strong>([^<]{1,200})</strong>(.{0,20000}?)</div>', re.DOTALL
)


def runs_of(folder: str, facts: Optional[SceneFacts]) -> Iterator[RunFacts]:
    """The runs of a workspace, the newest first; without a report of a whole run, the scene's own record."""
    pages = [entry for entry in entries_of(folder) if entry.name.lower().endswith(".html") and entry.is_file()]
    names_there = {entry.name for entry in pages}
    found = []
    for entry in pages:
        if entry.name in _OWN_PAGES and "report.html" in names_there:
            continue
        run = _run_of_report(entry.path, folder, facts)
        if run is not None:
            found.append(run)
    if "report.html" not in names_there and facts is not None and facts.history:
        options = recorded_options(facts, folder)
        time = max((os.path.getmtime(path) for path in _existing(folder)), default=0.0)
        found.append(RunFacts("", "", time, stage="pipeline", options=options, differing=differing_options(options)))
    yield from sorted(found, key=lambda run: -run.time)


def _existing(folder: str) -> List[str]:
    return [path for path in (os.path.join(folder, name) for name in SCENES) if os.path.exists(path)]


def _run_of_report(path: str, folder: str, facts: Optional[SceneFacts]) -> Optional[RunFacts]:
    """A run by its report; None for a page that is no report of ours."""
    try:
        with open(path, "rb") as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                return None
            head = stream.read(_HEAD_BYTES).decode("utf-8", "replace")
            size = os.fstat(stream.fileno()).st_size
            stream.seek(max(0, size - _TAIL_BYTES))
            tail, time = stream.read(_TAIL_BYTES).decode("utf-8", "replace"), os.fstat(stream.fileno()).st_mtime
    except OSError:
        return None
    title = re.search(r"<h1>([^<]{1,400})</h1>", head)
    if title is None or "<footer>REPM" not in tail:
        return None
    said = _VERDICT.search(head)
    commanded = commanded_options(tail, "pipeline")
    whole = os.path.basename(path) == "report.html" or bool(commanded)
    options: Dict[str, Value] = {}
    if whole:
        recorded = recorded_options(facts, folder) if facts is not None else {}
        options = {**recorded, **relocated_options(commanded, folder)}
    return RunFacts(
        title=html.unescape(title.group(1)).strip(),
        report=path,
        time=time,
        verdict=html.unescape(said.group(2)).strip() if said else "",
        good=bool(said and said.group(1)),
        text=_as_text(said.group(3)) if said else "",
        stage="pipeline" if whole else "",
        options=options,
        differing=differing_options(options),
    )


def _as_text(part: str) -> str:
    """The text of a piece of a page, one line for each of its items."""
    lines = html.unescape(re.sub(r"<[^>]*>", "", part.replace("</li>", "\n"))).splitlines()
    return "\n".join(filter(None, (" ".join(line.split()) for line in lines)))
