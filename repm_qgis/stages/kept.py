"""Folders that keep the finished parts of a long run until its products are complete, so that the next run
continues."""

from __future__ import annotations

import re
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Iterator, Optional

from ..contracts.errors import Cancelled, ClusterError
from ..runtime.locks import exclusive
from ..runtime.progress import Progress
from ..runtime.workspace import drop_temporaries

_FINGERPRINT = re.compile(r"[0-9a-f]{24}")


@contextmanager
def kept_until_done(folder: Path, stage: str, progress: Progress) -> Iterator[Path]:
    """A folder for one folder a fingerprint: a run that was killed or cancelled, or that has lost its cluster, leaves
    them to the next one; after any other end they are removed.

    Two runs have it one after the other.
    """
    try:
        with exclusive(stage, progress, folders=[str(folder)]):
            try:
                yield folder
            except (Cancelled, ClusterError):
                for path in folder.iterdir():
                    drop_temporaries(str(path))  # a worker that is ended while it writes cannot clean up
                    with suppress(OSError):  # no part was finished
                        path.rmdir()
                raise
            except BaseException:
                drop_others(folder)
                raise
            drop_others(folder)
    finally:
        with suppress(OSError):  # another run may have it already
            folder.rmdir()


def drop_others(folder: Path, kept: Optional[Path] = None) -> None:
    """Remove the kept parts of all runs but one; files that are not ours stay."""
    for path in folder.iterdir():
        if path.is_dir() and path != kept and _FINGERPRINT.fullmatch(path.name):
            shutil.rmtree(path, ignore_errors=True)
