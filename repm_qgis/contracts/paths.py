"""Paths as the system knows them."""

from __future__ import annotations

import os
from typing import Union


def real_path(path: Union[str, "os.PathLike[str]"]) -> str:
    """An absolute path whose links are followed, as far as the system resolves them.

    ``os.path.realpath`` raises OSError on Windows where ``GetFinalPathNameByHandle`` fails in a way that Python does
    not expect: drives of some networks and RAM disks do so, and Wine does for paths of more than 260 characters. There
    the parent folder is resolved, and the name is kept: so two paths to one file stay equal.
    """
    try:
        return os.path.realpath(path)
    except OSError:
        folder, name = os.path.split(os.path.abspath(path))
        return os.path.join(real_path(folder), name) if name else folder
