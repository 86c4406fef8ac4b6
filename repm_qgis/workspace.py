"""Files that are whole or absent, folders that can be written, and fingerprints that say what may be reused."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from pathlib import Path
from typing import Any

from . import __version__
from .errors import WorkspaceError


def ensure_folder(path: str) -> Path:
    """Make a folder with its parents and see that files can be written there; raises WorkspaceError."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise WorkspaceError(f"Cannot write into the folder '{path}' ({error.strerror or error}): choose another one, "
                             "or change its permissions.") from error
    return folder


def temporary_name(path: str) -> str:
    """A name beside ``path`` to write to before renaming; its folder is made, its extension kept.

    The name is the same for every attempt, so that what a killed run left behind is overwritten by the next.
    """
    target = Path(path)
    ensure_folder(str(target.parent))
    return str(target.with_name(f".{target.stem}.part{target.suffix}"))


def take_name(temporary: str, path: str) -> None:
    """Give a whole file its name; raises WorkspaceError where the name is taken by a folder, say."""
    try:
        os.replace(temporary, path)
    except OSError as error:
        raise WorkspaceError(f"Cannot write '{path}' ({error.strerror or error}): choose another place.") from error


def write_text(path: str, text: str) -> str:
    """Write a UTF-8 text file, whole or not at all; raises WorkspaceError."""
    temporary = temporary_name(path)
    try:
        with open(temporary, "w", encoding="utf-8") as stream:
            stream.write(text)
        take_name(temporary, path)
    except WorkspaceError:
        raise
    except OSError as error:
        raise WorkspaceError(f"Cannot write '{path}' ({error.strerror or error}): choose another place.") from error
    finally:
        if os.path.exists(temporary):
            os.unlink(temporary)
    return path


def file_identity(path: str) -> list[Any]:
    """What tells a file apart from a changed one without reading it all: path, size and time of change."""
    try:
        status = os.stat(path)
    except OSError:
        return [str(path)]
    return [os.path.abspath(path), status.st_size, status.st_mtime_ns]


def fingerprint(*parts: Any) -> str:
    """A short hash of JSON-able parts and the engine's version: equal hash, equal result."""
    text = json.dumps([__version__, *parts], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:24]
