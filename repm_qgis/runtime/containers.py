"""The memory limits of this process: those of its control groups (containers), and its own.

References
----------
Linux kernel documentation: admin-guide/cgroup-v2.rst, admin-guide/cgroup-v1/memory.rst; proc(5); cgroups(7).
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, Optional


@dataclass(frozen=True)
class _Version:
    """The files of one version of control groups; ``hierarchy`` is the field that names it in /proc/self/cgroup."""

    filesystem: str
    hierarchy: str
    limit: str
    used: str
    reclaimable: str
    events: str


_VERSIONS = (
    _Version("cgroup2", "", "memory.max", "memory.current", "inactive_file", "memory.events"),
    _Version(
        filesystem="cgroup",
        hierarchy="memory",
        limit="memory.limit_in_bytes",
        used="memory.usage_in_bytes",
        reclaimable="total_inactive_file",
        events="memory.oom_control",
    ),
)


def container_rest(root: str = "/") -> Optional[int]:
    """The memory that the limits of this process's control groups leave, bytes; None without a limit. ``root`` is for
    tests.

    Every group from the process's own up to the mounted one may have a limit, so the smallest rest counts. Cached
    files that were not used lately do not count as used: the kernel drops them before it refuses memory.
    """
    rests = []
    for version in _VERSIONS:
        for folder in _groups(version, root):
            limit, used = _number(folder / version.limit), _number(folder / version.used)
            if limit is not None and used is not None:
                cached = _table(folder / "memory.stat").get(version.reclaimable, 0)
                rests.append(max(limit - max(used - cached, 0), 0))
    return min(rests, default=None)


def memory_kills(root: str = "/") -> Optional[int]:
    """How many processes of this process's control group, or else of this machine, were killed for want of memory.

    A number that has risen between two calls is proof of it; None where the system does not count.
    """
    for version in _VERSIONS:
        for folder in _groups(version, root):
            counted = _table(folder / version.events).get("oom_kill")
            if counted is not None:
                return counted
            break  # the groups above also count what others do
    return _table(Path(root) / "proc" / "vmstat").get("oom_kill")


def own_rest(root: str = "/") -> Optional[int]:
    """The memory that the limit of this process's address space (``ulimit -v``) leaves, bytes; None without one."""
    if sys.platform == "win32":
        return None
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return None
    pages = _text(Path(root) / "proc" / "self" / "statm").split()
    return max(limit - (int(pages[0]) * os.sysconf("SC_PAGE_SIZE") if pages else 0), 0)


def _groups(version: _Version, root: str) -> Iterator[Path]:
    """The folders of this process's control group and of those above it, as far up as they are mounted."""
    own = None
    for line in _text(Path(root) / "proc" / "self" / "cgroup").splitlines():
        _, controllers, path = [*line.split(":", 2), "", ""][:3]
        if version.hierarchy in controllers.split(","):
            own = path
    if own is None:
        return
    for line in _text(Path(root) / "proc" / "self" / "mountinfo").splitlines():
        before, _, after = line.partition(" - ")
        fields, kind = before.split(), [*after.split(), "", "", ""][:3]
        if len(fields) < 5 or kind[0] != version.filesystem or version.hierarchy not in ["", *kind[2].split(",")]:
            continue
        mount, top = Path(root) / fields[4].lstrip("/"), fields[3].rstrip("/")
        # A container may see its own group as the mounted root, although the file states the whole path.
        inside = own[len(top) :] if own == top or own.startswith(f"{top}/") else ""
        folder = mount / inside.strip("/")
        if ".." in Path(inside).parts or not folder.is_dir():
            folder = mount
        yield folder
        while folder != mount:
            folder = folder.parent
            yield folder
        return


def _number(path: Path) -> Optional[int]:
    text = _text(path).strip()
    return int(text) if text.isdigit() else None  # "max" is no number: no limit


def _table(path: Path) -> Dict[str, int]:
    rows = (line.split() for line in _text(path).splitlines())
    return {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}


def _text(path: Path) -> str:
    """The text of a file of the kernel, "" where there is none."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
