"""Paths of a workspace that may come from anybody: what lies in it, and what leads elsewhere."""

from __future__ import annotations

import os
import re
from typing import List

from ..contracts.checks import INLINE
from ..contracts.paths import real_path

_MOST_ENTRIES = 2000  # of a folder that are looked at
_REMOTE = re.compile(r"\s*(?:/vsi|[\\/]{2}|\w[\w+.-]+:(?:/|\w{2}))", re.IGNORECASE)


def is_remote(path: str) -> bool:
    """Whether a path may lead to the network, or is no plain path: nobody looks there before the user asks for it."""
    return bool(_REMOTE.match(path)) or path.lstrip().startswith(INLINE)


def lies_in(folder: str, path: str) -> bool:
    """Whether a path is below a folder, links followed, and is no link itself."""
    if is_remote(path) or not os.path.isabs(path) or os.path.islink(path):
        return False
    return real_path(path).startswith(os.path.join(real_path(folder), ""))


def entries_of(folder: str) -> List[os.DirEntry[str]]:
    """What lies in a folder, by names, without hidden files, links out of it, pipes and devices."""
    try:
        with os.scandir(folder) as listed:
            some = [entry for _, entry in zip(range(_MOST_ENTRIES), listed)]
    except OSError:
        return []
    plain = (entry for entry in some if not entry.name.startswith(".") and not entry.is_symlink())
    return sorted((entry for entry in plain if entry.is_file() or entry.is_dir()), key=lambda entry: entry.name)
