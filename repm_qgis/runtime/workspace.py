"""Files that are whole or absent, folders that can be written, and fingerprints that say what may be reused."""

from __future__ import annotations

import ctypes
import errno
import glob
import hashlib
import json
import os
import re
import shutil
import socket
import stat
import sys
import tempfile
import threading
import time
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Callable, Dict, FrozenSet, Iterable, Iterator, List, Optional, Set

from .. import __version__
from ..contracts.errors import Cancelled, RepmError, WorkspaceError, reason_of
from ..contracts.paths import real_path
from . import windows

_kept: Dict[str, os.stat_result] = {}  # the folder that was found for each file of keeping_place


@contextmanager
def keeping_place(file: str) -> Iterator[None]:
    """Within the block, nothing is written into the folder of a file, or below it, once that folder has lost its name.

    A folder that somebody renames amid a run would be made again with half of what belongs into it.
    """
    folder = os.path.dirname(file)
    _kept[file] = os.stat(folder)
    try:
        yield
    except Cancelled:
        raise
    except Exception:
        _require_place(folder)  # otherwise the error would only say that some file is missing
        raise
    finally:
        del _kept[file]


def _require_place(path: str) -> None:
    """Raise WorkspaceError where a path lies in a folder of :func:`keeping_place` that is another one now."""
    place = real_path(path)
    for file, known in list(_kept.items()):
        folder = os.path.dirname(file)
        if os.path.join(place, "").startswith(os.path.join(folder, "")) and not os.path.lexists(file):
            try:
                same = os.path.samestat(os.stat(folder), known)
            except OSError:
                same = False
            if not same:
                raise WorkspaceError(
                    f"The folder '{folder}' was renamed, moved or removed while this run wrote there: give it its name "
                    "back, and run again."
                )


def ensure_folder(path: str) -> Path:
    """Make a folder with its parents and see that files can be written there; raises WorkspaceError."""
    folder = Path(path)
    _require_place(path)
    try:
        _make_and_try(folder)
    except OSError as error:
        if error.errno in OF_THE_DISK or _is_too_long(path, error):
            raise cannot_write(path, error) from error
        raise WorkspaceError(
            f"Cannot write into the folder '{path}' ({reason_of(error)}): choose another one, "
            "or change its permissions."
        ) from error
    return folder


def _make_and_try(folder: Path) -> None:
    """Make a folder and write a file there; again where another run, which had made it, has just removed it."""
    for last in (False, False, True):
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with tempfile.TemporaryFile(dir=folder):
                return
        except FileNotFoundError:
            if last:
                raise


_named: ContextVar[Optional[FrozenSet[str]]] = ContextVar("named", default=None)


@contextmanager
def following_links_of(paths: Iterable[str]) -> Iterator[None]:
    """Within the block, only these paths, which the user has named, may be links that are followed.

    All other names are the program's own. A workspace may have come from anybody: a link in it that has one of these
    names leads to a file that no user of it has named, and is replaced.
    """
    token = _named.set(frozenset(map(os.path.abspath, paths)))
    try:
        yield
    finally:
        _named.reset(token)


def temporary_name(path: str, own: bool = False) -> str:
    """A new name beside ``path`` to write to before renaming; its folder is made, its extension kept.

    The name holds this machine, this process and a random part, so that no two attempts share it. What processes of
    this machine that are gone have left of earlier attempts is removed. Raises WorkspaceError, also where ``path`` is
    there and is no regular file: a device, say. ``own``: no user has named ``path``, see :func:`real_target`.
    """
    target = real_target(path, own)
    ensure_folder(str(target.parent))
    drop_temporary(path, own)
    temporary = str(target.with_name(f"{_prefix(target)}{MACHINE}-{os.getpid()}-{os.urandom(4).hex()}{target.suffix}"))
    _own_temporaries.add(temporary)
    return temporary


def real_target(path: str, own: bool = False) -> Path:
    """The file or folder that writing to ``path`` replaces: links are followed, so that they stay links.

    A link is replaced itself where its name is the program's ``own``, or none of :func:`following_links_of`.
    Raises WorkspaceError where something is there that is neither a regular file nor a folder.
    """
    named = _named.get()
    if os.path.islink(path) and (own or (named is not None and os.path.abspath(path) not in named)):
        return Path(real_path(os.path.dirname(os.path.abspath(path))), os.path.basename(path))
    target = Path(real_path(path))
    if os.path.exists(target) and not (os.path.isfile(target) or os.path.isdir(target)):  # Path's raise for long names
        raise WorkspaceError(f"'{path}' is a device or a pipe, not a file: choose the name of a file.")
    return target


def drop_temporary(path: str, own: bool = False) -> None:
    """Remove the temporary files of earlier attempts to write ``path``, by processes of this machine that have
    ended."""
    target = real_target(path, own)
    _drop(target.parent, glob.escape(_prefix(target)))


def drop_temporaries(folder: str) -> None:
    """Remove the temporary files of attempts to write into a folder, by processes of this machine that have ended."""
    _drop(Path(folder), ".*.part-")


def _drop(folder: Path, prefix: str) -> None:
    for leftover in folder.glob(f"{prefix}{MACHINE}-*"):
        process = leftover.name.rsplit(f"{MACHINE}-", 1)[1].split("-")[0]
        if process.isdigit() and not process_exists(int(process)):
            remove_temporary(str(leftover))


def remove_own_temporaries() -> None:
    """Remove all files that this process is writing; for a process that is about to end itself."""
    for path in sorted(_own_temporaries):
        remove_temporary(path)


def _prefix(target: Path) -> str:
    return f".{target.stem}.part-"


def _machine() -> str:
    """A digest that distinguishes this machine from others that may write into the folder: its name, its process
    numbers."""
    try:
        space = os.readlink("/proc/self/ns/pid")
    except (OSError, AttributeError):
        space = ""
    return hashlib.sha256(f"{socket.gethostname()} {space}".encode()).hexdigest()[:8]


MACHINE = _machine()
kept_folders: Dict[str, str] = {}
"""Folders that are kept under another name when new ones take theirs, until a run ends (:mod:`.together`)."""
_own_temporaries: Set[str] = set()


def process_exists(number: int) -> bool:
    """Whether a process of this machine has this number."""
    if os.name == "nt":  # where signal 0 would end it
        return windows.process_exists(number)
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it exists, and belongs to another user
        return True
    return True


def remove_temporary(path: str) -> None:
    """Remove a file or folder that may be gone already."""
    if os.path.isdir(path) and not os.path.islink(path):
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            os.unlink(path)
    _own_temporaries.discard(path)


def take_name(temporary: str, path: str, own: bool = False) -> None:
    """Give a complete file its name, permanently: its contents are on the disk before its name is. It has the
    permissions of the file that it replaces. ``own`` as in :func:`temporary_name`.

    Raises WorkspaceError where the name is taken by a folder, say, and Cancelled after :func:`name_nothing_more`.
    """
    target = real_target(path, own)
    try:
        _keep_permissions(temporary, target)
        _sync(temporary)
        _require_naming()
        _replace(temporary, target)
        _sync(str(target.parent))
    except OSError as error:
        raise cannot_write(path, error) from error
    _own_temporaries.discard(temporary)


def _keep_permissions(temporary: str | os.PathLike[str], target: Path) -> None:
    """Give a new file or folder the permissions of the older one of its name: who may not read that may not read this.

    Its owner may always read it. Windows keeps permissions with the folder.
    """
    if os.name == "nt" or target.is_symlink():
        return
    with suppress(OSError):  # there is no older one, or the file system knows no permissions
        os.chmod(temporary, target.stat().st_mode & 0o777 | stat.S_IRUSR)


_IN_USE = (5, 32, 33)  # Windows: access denied, sharing violation, lock violation (winerror.h)
_FOR_REMOVAL = 6  # open files: to list a folder takes some for each level
_PATIENCE_S = 2.0  # because virus scanners and indexers open a new file for a moment


def _replace(source: str | os.PathLike[str], target: Path) -> None:
    """``os.replace``; Windows refuses it while another program has either open, and then it is tried for a while."""
    if os.name == "nt" and os.path.isdir(target) and not os.path.isdir(source):  # otherwise it is reported as in use
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
    end = time.monotonic() + _PATIENCE_S
    while True:
        try:
            os.replace(source, target)
            return
        except OSError as error:
            if not _in_use(error) or time.monotonic() > end:
                raise
        time.sleep(0.1)


def _in_use(error: OSError) -> bool:
    """Whether Windows says that another program has a file open; elsewhere files in use can be replaced."""
    return getattr(error, "winerror", None) in _IN_USE


def require_replaceable(path: str) -> None:
    """Raise WorkspaceError where an older file of that name cannot be replaced.

    Giving a file its own name changes nothing. Windows refuses it while another program has the file open, as it would
    refuse the new file its name at the end of the work.
    """
    target = real_target(path)
    try:
        if target.is_file():  # raises for names that are too long
            _replace(target, target)
    except OSError as error:
        raise cannot_write(path, error) from error


_naming_ended = threading.Event()


def name_nothing_more() -> None:
    """From now on no file or folder of this process takes its name: a cancel may have left it with a part missing."""
    _naming_ended.set()


def _require_naming() -> None:
    if _naming_ended.is_set():
        raise Cancelled


def _sync(path: str) -> None:
    """Have the disk hold what was written to a file, or a folder's names; Windows has no such thing for folders."""
    if os.path.isdir(path) and os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY if os.path.isdir(path) or os.name != "nt" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EROFS):  # file systems that know no fsync
            raise
    finally:
        os.close(descriptor)


_FULL = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))
_TOO_MANY = (errno.EMFILE, errno.ENFILE)
OF_THE_DISK = (*_FULL, *_TOO_MANY, errno.EFBIG, errno.EROFS)
"""The errors that keep any file from being written; no input is the cause."""
_PROBE = bytes(1 << 20)
# GDAL, libtiff and HDF5 where a file takes less than was written.
_CUT_SHORT = re.compile(
    r"TIFFAppendTo|write error|no space left|dirty block|failed to write|fwrite|disk full", re.IGNORECASE
)


def _has_no_inodes(path: str) -> bool:
    """Whether a disk takes no more files, though it may have space; False where the system does not say."""
    try:
        status = os.statvfs(existing_place(path))
    except (AttributeError, OSError):  # Windows
        return False
    return status.f_files > 0 and status.f_favail == 0  # Btrfs counts none and says 0


_LONGEST_PATH = 210 if os.name == "nt" else None  # of 259, as temporary names in it are up to 49 longer


def _is_too_long(path: str, error: OSError) -> bool:
    """Whether a path is long, and Windows found nothing there, which is all that it says of paths above its limit."""
    return _LONGEST_PATH is not None and error.errno == errno.ENOENT and len(os.path.abspath(path)) > _LONGEST_PATH


def cannot_write(path: str, error: OSError, written: int = 0) -> WorkspaceError:
    """The sentence for a file or folder that cannot be written: the obstacle and the remedy.

    ``written`` are the bytes of it that were. An error that is such a sentence already stays as it is.
    """
    if isinstance(error, WorkspaceError):
        return error
    if error.errno in _FULL and _has_no_inodes(path):
        return WorkspaceError(
            f"Cannot write '{path}': the disk takes no more files (it has no inode left): remove some, "
            "or choose a place on another disk."
        )
    if error.errno in _FULL:
        free = (free_bytes(path) or 0) / 2**20
        needed = f", more than {written / 2**20:.1f} MiB needed" if written else ""
        return WorkspaceError(
            f"Cannot write '{path}': the disk is full ({free:.1f} MiB free{needed}): free some space, or choose a "
            "place on another disk."
        )
    if _in_use(error) and os.path.exists(path):
        return WorkspaceError(
            f"Cannot write '{path}': another program has it open, QGIS perhaps as a layer: remove that layer, close "
            "that program, or choose another name."
        )
    if _is_too_long(path, error):
        return WorkspaceError(
            f"Cannot write '{path}': the path has {len(os.path.abspath(path))} characters, and Windows takes 259, "
            "temporary names included: choose a shorter place, or have Windows allow long paths (LongPathsEnabled)."
        )
    if error.errno == errno.EROFS:
        return WorkspaceError(f"Cannot write '{path}': the disk is read-only: choose a place on another disk.")
    if error.errno in _TOO_MANY:
        return WorkspaceError(
            f"Cannot write '{path}': this process has too many open files: raise the limit (ulimit -n), or use fewer "
            "workers."
        )
    return WorkspaceError(f"Cannot write '{path}' ({reason_of(error)}): choose another place.")


def not_written(path: str, reason: str, temporary: str = "") -> WorkspaceError:
    """The sentence for a file that a library could not write; its ``reason`` counts where the disk has none.

    Libraries seldom report that the disk is full: an attempt to write to ``temporary``, or beside ``path``, shows it.
    """
    error = _obstacle(temporary or os.path.dirname(real_path(path)))
    if error is not None:
        return cannot_write(path, error, size_of(temporary))
    if _CUT_SHORT.search(reason):  # the file that filled the disk may be gone by now, for example another worker's
        free = f"{(free_bytes(path) or 0) / 2**20:.1f} MiB free now"
        return WorkspaceError(
            f"Cannot write '{path}': the disk did not take all of it ({reason}; {free}): free some space, or choose a "
            "place on another disk."
        )
    return WorkspaceError(f"Cannot write '{path}' ({reason or 'no reason given'}): choose another place.")


def _obstacle(place: str) -> Optional[OSError]:
    """The error that keeps a file from growing, or a folder from getting another file, by an attempt; None if there is
    none."""
    try:
        with tempfile.TemporaryFile(dir=place) if os.path.isdir(place) else open(place, "ab") as stream:
            stream.write(_PROBE)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        return error
    return None


def foreign_entries(path: str | os.PathLike[str], is_ours: Callable[[str], bool]) -> List[str]:
    """The names of what a folder that is to be replaced holds beside our own, or of a file in its place, in order.

    Raises WorkspaceError for a folder that cannot be read.
    """
    folder = Path(path)
    try:
        if folder.is_dir():
            return sorted(each.name for each in folder.iterdir() if not is_ours(each.name))
        return [folder.name] if folder.exists() else []
    except OSError as error:  # too many open files, or a folder that may not be read
        raise cannot_write(str(path), error) from error


def require_no_strangers(folder: Path, is_ours: Callable[[str], bool], stranger: str, *, option: str) -> None:
    """Raise WorkspaceError where replacing a folder would lose an entry that is not ours.

    ``stranger`` says what such an entry is ("does not belong to an EPT"), and ``option`` is that of the folder.
    """
    others = foreign_entries(folder, is_ours)
    if others:
        reason = f"holds '{others[0]}', which {stranger} and would be lost"
        raise WorkspaceError(f"The folder '{folder}' {reason}: choose a new or empty folder for {option}.")


def size_of(path: str) -> int:
    """The bytes of a file, or of all files in a folder."""
    inside = [path, *(os.path.join(place, name) for place, _, names in os.walk(path) for name in names)]
    return sum(os.path.getsize(each) for each in inside if os.path.isfile(each))


@contextmanager
def writing(path: str, temporary: str = "") -> Iterator[None]:
    """Within the block, any error of writing ``path`` becomes a WorkspaceError, whichever library raises it.
    ``temporary`` is the file that is written first, under another name. Errors that have another cause stay as they
    are.
    """
    try:
        yield
    except RepmError:
        raise
    except OSError as error:
        raise cannot_write(path, error, size_of(temporary or path)) from error
    except Exception as error:
        obstacle = _obstacle(temporary or os.path.dirname(real_path(path)))
        if obstacle is None:
            raise
        raise cannot_write(path, obstacle, size_of(temporary or path)) from error


def existing_place(path: str) -> str:
    """A path, or the nearest folder above it that exists."""
    place = os.path.abspath(path)
    while not os.path.exists(place) and os.path.dirname(place) != place:
        place = os.path.dirname(place)
    return place


def free_bytes(path: str) -> Optional[int]:
    """The free space of the disk that a path lies on; None where the system does not say."""
    try:
        return shutil.disk_usage(existing_place(path)).free
    except OSError:
        return None


@contextmanager
def whole_file(path: str) -> Iterator[str]:
    """A temporary name to write to: the file takes its own only when the block ends without an error.

    Raises WorkspaceError where it cannot be written.
    """
    temporary = temporary_name(path)
    try:
        with writing(path, temporary):
            yield temporary
            take_name(temporary, path)
    finally:
        remove_temporary(temporary)


def write_text(path: str, text: str) -> str:
    """Write a UTF-8 text file, whole or not at all, the same bytes on every system; raises WorkspaceError."""
    with whole_file(path) as temporary, open(temporary, "w", encoding="utf-8", newline="\n") as stream:
        stream.write(text)
    return path


def with_copy(kept: str, wanted: Optional[str]) -> List[str]:
    """The path under which a workspace keeps a product, and the user's own path for it where that is another one.

    The user's path may be a temporary one that is gone at the next run, which needs the product.
    """
    return [kept, wanted] if wanted and real_path(wanted) != real_path(kept) else [kept]


@contextmanager
def temporary_folder(path: str) -> Iterator[str]:
    """A new folder beside ``path`` for files that exist only within the block."""
    folder = temporary_name(path)
    with _removed(folder):
        yield str(ensure_folder(folder))


@contextmanager
def _removed(folder: str) -> Iterator[None]:
    """Remove a folder after the block, even where the block ends because no more files can be opened."""
    spare: List[int] = []
    try:
        with writing(folder):
            while len(spare) < _FOR_REMOVAL:
                spare.append(os.open(os.devnull, os.O_RDONLY))
        yield
    finally:
        for each in spare:
            os.close(each)
        remove_temporary(folder)


@contextmanager
def whole_folder(path: str) -> Iterator[Path]:
    """A new folder to fill: it gets its name, and replaces an older one, only when the block ends without an error.

    The caller ensures that an older folder there may be removed. Raises WorkspaceError.
    """
    target = real_target(path)
    recover_folder(path)
    temporary = Path(temporary_name(path))
    with _removed(str(temporary)), writing(path, str(temporary)):
        temporary.mkdir()
        yield temporary
        for place, _, files in os.walk(temporary):
            for name in files:
                _sync(os.path.join(place, name))
            _sync(place)
        _take_place(temporary, target)


def _take_place(temporary: Path, target: Path) -> None:
    """Give a folder its name; an older one of that name is removed.

    Where the system can exchange two names in one step, a complete folder exists at every moment. Where it cannot, the
    older one is put aside first, and :func:`recover_folder` finds it there after a kill between the two steps.
    """
    _require_naming()
    _keep_permissions(temporary, target)
    kept = kept_folders.pop(str(target), "")
    if not os.path.lexists(target):
        _replace(temporary, target)
    elif _exchange(temporary, target):
        if kept:
            os.replace(temporary, kept)
    else:
        aside = _aside(target)
        remove_temporary(str(aside))
        _replace(target, aside)
        try:
            _replace(temporary, target)
        except OSError:
            os.replace(aside, target)
            raise
        if kept:
            os.replace(aside, kept)
        remove_temporary(str(aside))
    _sync(str(target.parent))


def recover_folder(path: str) -> None:
    """Put an older folder back that a killed run had put aside."""
    target = Path(real_path(path))
    aside = _aside(target)
    if aside.is_dir():
        if target.exists():
            remove_temporary(str(aside))
        else:
            os.replace(aside, target)


def _aside(target: Path) -> Path:
    return target.with_name(f".{target.name}.aside")


def _exchange(first: Path, second: Path) -> bool:
    """Exchange two names in one step; False where the system or the file system cannot.

    Linux: renameat2 with RENAME_EXCHANGE (2); macOS: renamex_np with RENAME_SWAP (2).
    """
    names = os.fsencode(first), os.fsencode(second)
    try:
        library = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "darwin":
            return bool(library.renamex_np(*names, 2) == 0)
        at_cwd = -100
        return bool(library.renameat2(at_cwd, names[0], at_cwd, names[1], 2) == 0)
    except (AttributeError, OSError, TypeError):
        return False


def file_identity(path: str) -> List[object]:
    """A digest that distinguishes a file from a changed one without reading it all.

    Path, size, time of modification, inode and time of change: the last two reveal a file whose old time was restored.
    """
    try:
        status = os.stat(path)
    except OSError:
        return [str(path)]
    changed = windows.change_time(path) or status.st_ctime_ns  # which on Windows is when the file was made
    return [os.path.abspath(path), status.st_size, status.st_mtime_ns, status.st_ino, changed]


_SAMPLES, _SAMPLE_BYTES = 16, 1 << 16


def file_sample(path: str) -> str:
    """A hash of a file's size and of sixteen evenly spread parts of 64 KiB: it stays where a file is copied or moved,
    and distinguishes it from another one under the same name; whole images would take seconds each. "" for what cannot
    be read."""
    try:
        with open(path, "rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            found = hashlib.sha256(str(size).encode())
            for number in range(_SAMPLES):
                stream.seek(max(size - _SAMPLE_BYTES, 0) * number // (_SAMPLES - 1))
                found.update(stream.read(_SAMPLE_BYTES))
    except OSError:
        return ""
    return found.hexdigest()[:24]


def fingerprint(*parts: object) -> str:
    """A short hash of JSON-able parts and the engine's version: equal hash, equal result."""
    text = json.dumps([__version__, *parts], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:24]
