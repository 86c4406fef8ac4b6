"""One run at a time where two would write the same files: the second says whom it waits for, and waits.

The operating system holds the locks (flock, or LockFile on Windows), so they end with their process, however it ends:
there are no stale locks. The file only says who has it.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import sys
import time
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from typing import Iterator, Sequence, Set

from .progress import Progress
from .workspace import cannot_write, ensure_folder, real_target

_POLL_S = 0.3
_UNKNOWN = (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL, errno.ENOSYS)  # file systems that have no locks
_held: Set[str] = set()


@contextmanager
def exclusive(stage: str, progress: Progress, folders: Sequence[str] = (), files: Sequence[str] = ()) -> Iterator[None]:
    """Keep folders and files for this process within the block; waits while another process has one of them.

    A path that this process holds already is passed over, so that a run holds what its stages ask for. Raises
    Cancelled while it waits, WorkspaceError where no lock can be made.
    """
    with ExitStack() as stack:
        inside = {str(real_target(folder) / ".repm.lock") for folder in folders}
        beside = {str(path.with_name(f".{path.name}.lock")) for path in map(real_target, files)}
        for path in sorted(inside | beside):  # in one order: no two runs wait for each other
            if path not in _held:
                stack.enter_context(_locked(path, stage, progress))
        yield


@contextmanager
def _locked(path: str, stage: str, progress: Progress) -> Iterator[None]:
    folder = os.path.dirname(path)
    made = False
    announced = False
    while True:
        made = made or not os.path.isdir(folder)
        descriptor = _opened(path)
        try:
            if _lock(descriptor) and _is_file(descriptor, path):
                break
        except OSError as error:
            if error.errno in _UNKNOWN:
                progress.warn(
                    f"The disk of '{path}' does not support locks: make sure that no other run writes there meanwhile."
                )
                os.close(descriptor)
                yield
                return
            os.close(descriptor)
            raise cannot_write(path, error) from error
        owner = _owner(path)
        os.close(descriptor)
        if not announced:
            progress.warn(f"'{os.path.dirname(path)}' is in use by {owner}: this run waits until that one ends.")
            announced = True
        progress.check_cancelled()
        time.sleep(_POLL_S)
    _held.add(path)
    try:
        _sign(descriptor, stage)
        yield
    finally:
        _held.discard(path)
        with suppress(OSError):  # Windows does not remove an open file; the next run finds it unlocked
            os.unlink(path)
        os.close(descriptor)
        with suppress(OSError):
            if os.name == "nt":
                os.unlink(path)
            if made:  # a run that is refused leaves no folder behind; one that holds something stays
                os.rmdir(folder)


def _opened(path: str) -> int:
    """The lock's file, open; its folder is made, again where the run before has just removed it."""
    attempts = 2
    while True:
        ensure_folder(os.path.dirname(path))
        attempts -= 1
        try:
            return os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            if not attempts or error.errno != errno.ENOENT:
                raise cannot_write(path, error) from error


def _lock(descriptor: int) -> bool:
    """Take the lock if it is free; False where another process has it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, 1 << 20, os.SEEK_SET)  # beyond the text, which others read
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    return True


def _is_file(descriptor: int, path: str) -> bool:
    """Whether the locked file still has its name: the run before removes it as it ends."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False


def _sign(descriptor: int, stage: str) -> None:
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    text = json.dumps({"process": os.getpid(), "computer": socket.gethostname(), "stage": stage, "since": now})
    os.lseek(descriptor, 0, os.SEEK_SET)
    os.truncate(descriptor, 0)
    os.write(descriptor, text.encode())


def _owner(path: str) -> str:
    """Who has the lock, as its file says; a run that has just begun may not have signed yet."""
    try:
        with open(path, encoding="utf-8") as stream:
            known = json.loads(stream.read(4096))
        since = datetime.fromisoformat(str(known["since"])).strftime("%H:%M:%S on %Y-%m-%d")
        return f"process {int(known['process'])} on {known['computer']} ({known['stage']}, since {since})"
    except (OSError, ValueError, KeyError, TypeError):
        return "another run"
