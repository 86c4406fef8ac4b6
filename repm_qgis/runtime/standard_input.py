"""Standard input of an engine that watches it: its job, the word ``cancel``, and its end, from the first moment on.

The engine imports for a second before it can work, and for several on a busy Windows. A thread that began before
hears the word meanwhile, so this module imports next to nothing: with threading for _thread, a Python that takes 0.8 s
to begin on a busy Windows takes 1.7 s.
"""

from __future__ import annotations

import _thread
import os

MAX_JOB_BYTES = 64 << 20
VARIABLE = "REPM_ENGINE_WATCH_STDIN"  # set by whoever wants it watched
_CANCEL = b"cancel\n"  # a line
_LAST_WORDS = b'{"type": "error", "kind": "Cancelled", "text": "Cancelled by the user."}\n'


class Beginning:
    """What a cancel does before there is anything to clean up, or to translate the sentence with."""

    def __init__(self) -> None:
        self._output = os.dup(1)  # another one may soon be in its place

    def cancelled(self) -> None:
        """Called in the watching thread, or by a signal."""
        os.write(self._output, _LAST_WORDS)
        os._exit(1)

    def closed(self) -> None:
        """Whoever started this process is gone."""
        self.cancelled()


class Watched:
    """Standard input, read by a thread of its own. Where the job comes by it, that is its first line."""

    def __init__(self, job_first: bool, told: Beginning) -> None:
        self.told = told
        """Told of a cancel and of the end; may be replaced at any time."""
        self._job_first, self._line, self._whole = job_first, b"", _thread.allocate_lock()
        self._whole.acquire()
        self._pipe = _own_input() if os.name == "nt" else 0
        _thread.start_new_thread(self._listen, ())

    def line(self) -> bytes:
        """The job; waits for it."""
        with self._whole:
            return self._line

    def _listen(self) -> None:
        said = b""
        try:
            if self._job_first:
                self._line, said = first_line(self._pipe)
                self._whole.release()
            while True:
                if _CANCEL in said:
                    said = b""
                    self.told.cancelled()
                piece = os.read(self._pipe, 4096)
                if not piece:
                    break
                said = said[-len(_CANCEL) :] + piece
        except OSError:
            pass
        self.told.closed()


_watched: Watched | None = None


def watched(job_first: bool) -> Watched:
    """The process's standard input, watched from the first call on."""
    global _watched
    if _watched is None:
        _watched = Watched(job_first, Beginning())
    return _watched


def first_line(pipe: int = 0) -> tuple[bytes, bytes]:
    """The first line of a pipe, and what came with it: it is not read to its end, because the end means that the
    parent is gone."""
    read, piece = bytearray(), b""
    while b"\n" not in piece and len(read) <= MAX_JOB_BYTES:
        piece = os.read(pipe, 65536)
        if not piece:
            break
        read += piece
    line, _, rest = bytes(read).partition(b"\n")
    return line, rest


def _own_input() -> int:
    """Standard input under another number, and nothing in its place.

    Windows allows one request at a time on such a pipe: workers, which inherit standard input and query its type when
    they start, would wait until our read ends.
    """
    pipe, nothing = os.dup(0), os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    return pipe
