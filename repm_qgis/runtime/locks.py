"""One run at a time where two would write the same files: the second run names the first one, and waits for it.

The operating system holds the locks (flock, or LockFile on Windows), so they end with their process, however it ends:
there are no stale locks. The file only names the owner. Its name is predictable, and the folder may have come from
anybody: a link, a pipe or a file of the user under this name is neither followed nor waited for nor written to.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import stat
import sys
import time
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from typing import Iterator, Sequence, Set

from ..contracts.errors import WorkspaceError
from .progress import Progress
from .workspace import cannot_write, ensure_folder, keeping_place, real_target

_POLL_S = 0.3
_UNKNOWN = (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL, errno.ENOSYS)  # file systems that have no locks
_MOST_BYTES = 4096  # of what a lock's file says
# A link is not followed and a pipe not waited for; Windows knows neither flag.
_AS_IT_IS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)
_SIGNED = b'{"process":'  # what every lock's file begins with
_held: Set[str] = set()


@contextmanager
def exclusive(stage: str, progress: Progress, folders: Sequence[str] = (), files: Sequence[str] = ()) -> Iterator[None]:
    """Keep folders and files for this process within the block; waits while another process has one of them.

    A path that this process holds already is skipped, so that the stages of a run can lock what the run has locked.
    Raises Cancelled while it waits, WorkspaceError where no lock can be made, or where its name belongs to a file that
    is no lock.
    """
    with ExitStack() as stack:
        inside = {str(real_target(folder) / ".repm.lock") for folder in folders}
        beside = {str(path.with_name(f".{path.name}.lock")) for path in map(real_target, files)}
        for path in sorted(inside | beside):  # in one order: no two runs wait for each other
            if path not in _held:
                stack.enter_context(_locked(path, stage, progress))
        yield


def owner_of(folder: str) -> str:
    """Who writes into a folder now, as its lock says; "" where nobody does. Nothing is written or waited for."""
    path = str(real_target(folder) / ".repm.lock")
    if os.path.islink(path) or not os.path.isfile(path):
        return ""
    try:
        # Windows locks bytes of a file that is open for writing only.
        descriptor = os.open(path, (os.O_RDWR if os.name == "nt" else os.O_RDONLY) | _AS_IT_IS)
    except OSError:
        return ""
    try:
        return "" if _lock(descriptor) else _owner(descriptor)
    except OSError:  # a file system without locks
        return ""
    finally:
        os.close(descriptor)


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
                _require_ours(descriptor, path)
                break
        except OSError as error:
            if error.errno in _UNKNOWN:
                progress.info(
                    f"The disk of '{path}' does not support locks: make sure that no other run writes there meanwhile."
                )
                os.close(descriptor)
                yield
                return
            os.close(descriptor)
            raise cannot_write(path, error) from error
        except BaseException:
            os.close(descriptor)
            raise
        owner = _owner(descriptor)
        os.close(descriptor)
        if not announced:
            progress.info(f"'{os.path.dirname(path)}' is in use by {owner}: this run waits until that one ends.")
            announced = True
        progress.check_cancelled()
        time.sleep(_POLL_S)
    _held.add(path)
    try:
        _sign(descriptor, stage)
        with keeping_place(path):
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
            if os.path.islink(path):
                raise _no_lock(path)
            return os.open(path, os.O_RDWR | os.O_CREAT | _AS_IT_IS, 0o644)
        except OSError as error:
            if error.errno in (errno.ELOOP, errno.ENXIO):
                raise _no_lock(path) from error
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
    except OSError as error:
        if error.errno:
            raise
        return False  # Wine's C library gives no reason
    return True


def _is_file(descriptor: int, path: str) -> bool:
    """Whether the locked file still has its name: the run before removes it as it ends."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except FileNotFoundError:
        return False


def _require_ours(descriptor: int, path: str) -> None:
    """Raise WorkspaceError where the locked file is not one of this module's: it would be overwritten and removed.

    A lock's file has one name and holds what a run has signed, whole or cut by a kill: its beginning tells.
    """
    status = os.fstat(descriptor)
    plain = stat.S_ISREG(status.st_mode) and status.st_nlink <= 1
    if not plain or not _SIGNED.startswith(_read(descriptor, len(_SIGNED))):
        raise _no_lock(path)


def _no_lock(path: str) -> WorkspaceError:
    return WorkspaceError(
        f"'{path}' is a link, a pipe or a file that is not this program's, where a lock is needed: remove it, or "
        "choose another place."
    )


def _read(descriptor: int, most: int) -> bytes:
    """The first bytes of an open file."""
    os.lseek(descriptor, 0, os.SEEK_SET)
    return os.read(descriptor, most)


def _sign(descriptor: int, stage: str) -> None:
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    text = json.dumps({"process": os.getpid(), "computer": socket.gethostname(), "stage": stage, "since": now})
    os.ftruncate(descriptor, 0)
    os.lseek(descriptor, 0, os.SEEK_SET)
    os.write(descriptor, text.encode())


def _owner(descriptor: int) -> str:
    """Who has the lock, as its file says; a run that has just begun may not have signed yet."""
    try:
        known = json.loads(_read(descriptor, _MOST_BYTES))
        since = datetime.fromisoformat(str(known["since"])).strftime("%H:%M:%S on %Y-%m-%d")
        return f"process {int(known['process'])} on {known['computer']} ({known['stage']}, since {since})"
    except (OSError, ValueError, KeyError, TypeError):
        return "another run"
