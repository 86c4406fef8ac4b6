"""Files that are whole or absent, folders that can be written, and fingerprints that say what may be reused."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterator

from . import __version__
from .errors import RepmError, WorkspaceError


def ensure_folder(path: str) -> Path:
    """Make a folder with its parents and see that files can be written there; raises WorkspaceError."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise WorkspaceError(
            f"Cannot write into the folder '{path}' ({error.strerror or error}): choose another one, "
            "or change its permissions."
        ) from error
    return folder


def temporary_name(path: str) -> str:
    """A name in the folder of ``path`` to write to before renaming, with the same extension; the folder is made.

    The name is the same for every attempt, so that what a killed run left behind is overwritten by the next.
    """
    target = Path(path)
    ensure_folder(str(target.parent))
    return str(_temporary(target))


def drop_temporary(path: str) -> None:
    """Remove the half-written file of a process that was ended."""
    _temporary(Path(path)).unlink(missing_ok=True)


def _temporary(target: Path) -> Path:
    return target.with_name(f".{target.stem}.part{target.suffix}")


def take_name(temporary: str, path: str) -> None:
    """Give a complete file its name; raises WorkspaceError where that fails, as where a folder has the name."""
    try:
        os.replace(temporary, path)
    except OSError as error:
        raise WorkspaceError(f"Cannot write '{path}' ({error.strerror or error}): choose another place.") from error


@contextmanager
def whole_file(path: str) -> Iterator[str]:
    """A temporary name to write to: the file takes its own only when the block ends without an error.

    Raises WorkspaceError where it cannot be written.
    """
    temporary = temporary_name(path)
    try:
        yield temporary
        take_name(temporary, path)
    except OSError as error:
        if isinstance(error, RepmError):
            raise
        raise WorkspaceError(f"Cannot write '{path}' ({error.strerror or error}): choose another place.") from error
    finally:
        if os.path.exists(temporary):
            os.unlink(temporary)


def write_text(path: str, text: str) -> str:
    """Write a UTF-8 text file, whole or not at all; raises WorkspaceError."""
    with whole_file(path) as temporary, open(temporary, "w", encoding="utf-8") as stream:
        stream.write(text)
    return path


@contextmanager
def whole_folder(path: str) -> Iterator[Path]:
    """A new folder to fill: it takes its name, and an older one's place, only when the block ends without an error.

    Whoever calls sees to it that an older folder there may go. Raises WorkspaceError.
    """
    target = Path(path)
    ensure_folder(str(target.parent))
    temporary, old = (target.with_name(f".{target.name}.part{end}") for end in ("", ".old"))
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        temporary.mkdir()
        yield temporary
        _take_place(temporary, target, old)
    except WorkspaceError:
        raise
    except OSError as error:
        if isinstance(error, RepmError):
            raise
        raise WorkspaceError(
            f"Cannot write the folder '{path}' ({error.strerror or error}): choose another place."
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _take_place(temporary: Path, target: Path, old: Path) -> None:
    """Rename a folder over another, which comes back if that fails."""
    shutil.rmtree(old, ignore_errors=True)
    if target.exists():
        os.replace(target, old)
    try:
        os.replace(temporary, target)
    except OSError:
        if old.exists():
            os.replace(old, target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def file_identity(path: str) -> list[Any]:
    """What distinguishes a file from a changed one without reading it: path, size and time of change."""
    try:
        status = os.stat(path)
    except OSError:
        return [str(path)]
    return [os.path.abspath(path), status.st_size, status.st_mtime_ns]


def fingerprint(*parts: Any) -> str:
    """A short hash of JSON-able parts and the engine's version: equal hash, equal result."""
    text = json.dumps([__version__, *parts], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:24]
