"""How a stage reports its progress, and checks whether it should stop."""

from __future__ import annotations

import json
import os
import threading
from itertools import accumulate
from typing import Callable, Iterable, List, Optional, Protocol, Sequence, TextIO

from ..contracts.findings import Finding

_MOST_NAMED = 6


class Progress(Protocol):
    """What every stage is given. Fractions run from 0 to 1 and never fall."""

    def step(self, fraction: float, text: str = "") -> None: ...

    def info(self, text: str) -> None: ...

    def warn(self, finding: Finding) -> None:
        """Something that the reader of the result should know; it stands in the report's verdict."""
        ...

    def check_cancelled(self) -> None:
        """Raise :class:`repm_qgis.contracts.errors.Cancelled` if the user asked to stop."""
        ...


def warn_all(progress: Progress, findings: Iterable[Finding]) -> None:
    """Warn of each."""
    for finding in findings:
        progress.warn(finding)


def counted(count: int, noun: str) -> str:
    """A number with its noun: "1 tile", "3 tiles"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def listed(names: Sequence[str], between: str = ", ") -> str:
    """The first six of names, and how many more there are."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return between.join(names[:_MOST_NAMED]) + more


class Silent:
    """Reports nothing and is never cancelled: for tests and for library use."""

    def step(self, fraction: float, text: str = "") -> None:
        pass

    def info(self, text: str) -> None:
        pass

    def warn(self, finding: Finding) -> None:
        pass

    def check_cancelled(self) -> None:
        pass


class Part:
    """The share [start, end] of a longer progress, under the name of one stage."""

    def __init__(self, whole: Progress, start: float, end: float, name: str = "") -> None:
        self._whole, self._start, self._end, self._name = whole, start, end, name

    def step(self, fraction: float, text: str = "") -> None:
        label = f"{self._name}: {text}" if self._name and text else (self._name or text)
        self._whole.step(self._start + (self._end - self._start) * min(max(fraction, 0.0), 1.0), label)

    def info(self, text: str) -> None:
        self._whole.info(text)

    def warn(self, finding: Finding) -> None:
        self._whole.warn(finding)

    def check_cancelled(self) -> None:
        self._whole.check_cancelled()

    def slow_down(self, factor: float, end: float = 1.0) -> None:
        """What comes until ``end`` takes so many times as long as was expected."""
        if isinstance(self._whole, Part):
            self._whole.slow_down(factor, self._start + (self._end - self._start) * end)


def slow_down(progress: Progress, factor: float) -> None:
    """The rest of a part takes so many times as long as was expected; who does not expect anything is not told."""
    if isinstance(progress, Part):
        progress.slow_down(factor)


KEPT = 0.02
"""Of the time of a task, for one whose result an earlier run has left."""


class Uneven(Part):
    """The share [start, end] of a longer progress for tasks that take these unequal ``times``, but report equal
    steps."""

    def __init__(self, whole: Progress, start: float, end: float, times: Sequence[float]) -> None:
        super().__init__(whole, start, end)
        self._ends = [0.0, *accumulate(times)]

    def step(self, fraction: float, text: str = "") -> None:
        last = len(self._ends) - 1
        index = min(int(fraction * last + 1e-6), last)  # of the tasks that have ended
        super().step(self._ends[index] / (self._ends[-1] or 1.0), text)


class Recorder(Part):
    """The record of a run: passes everything on, and keeps notes and findings, from which a report has its verdict.

    The same sentence is passed on once.
    """

    def __init__(self, whole: Progress, before: Sequence[Finding] = ()) -> None:
        """What was found ``before``, or is in the record that this one begins in, is part of it, and was passed on."""
        super().__init__(whole, 0.0, 1.0)
        self.notes: List[str] = []
        self.findings: List[Finding] = list(before or (whole.findings if isinstance(whole, Recorder) else ()))

    def info(self, text: str) -> None:
        self.notes.append(text)
        super().info(text)

    def warn(self, finding: Finding) -> None:
        if finding not in self.findings:
            self.findings.append(finding)
            super().warn(finding)


class JsonLines:
    """One JSON object a line, for the process that started the engine.

    The parent may also simply end the process tree. ``translate`` brings texts into the language of who reads them.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._fraction, self._closed = stream, 0.0, False
        self._cancelled: Optional[Callable[[], bool]] = None
        self.translate: Callable[[str], str] = str
        self._lock = threading.RLock()

    def cancelled_by(self, asked: Callable[[], bool]) -> None:
        """Call ``asked`` at every check from now on."""
        self._cancelled = asked

    def send(self, **message: object) -> None:
        with self._lock:
            self._stream.write(json.dumps(message, allow_nan=False) + "\n")
            self._stream.flush()
            self._closed = message["type"] in ("result", "error", "bug")

    def last_words(self, **message: object) -> None:
        """Send a closing message where none was sent, even if another thread is stuck while it sends."""
        free = self._lock.acquire(timeout=0.2)
        if not self._closed:
            os.write(self._stream.fileno(), (("" if free else "\n") + json.dumps(message) + "\n").encode())

    def step(self, fraction: float, text: str = "") -> None:
        self._fraction = max(self._fraction, min(max(float(fraction), 0.0), 1.0))
        self.send(type="progress", fraction=round(self._fraction, 4), text=self.translate(text))

    def info(self, text: str) -> None:
        self.send(type="info", text=self.translate(text))

    def warn(self, finding: Finding) -> None:
        self.send(type="warning", id=finding.id, level=finding.level, text=self.translate(str(finding)))

    def check_cancelled(self) -> None:
        if self._cancelled is not None and self._cancelled():
            from ..contracts.errors import Cancelled

            raise Cancelled
