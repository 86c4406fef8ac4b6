"""How many workers fit into memory: free memory, the memory of a task, and what to do where one task alone needs too
much."""

from __future__ import annotations

import ctypes
import os
import sys
from dataclasses import dataclass
from typing import Any, Callable, Dict, Optional, Sequence

from ..contracts.errors import ClusterError, OptionError
from .containers import container_rest, own_rest
from .parallel import cores, task_mib
from .progress import Progress

_SHARE = 0.75  # of what is free, where no budget is given
_MIB = 1024.0 * 1024.0
_SMALLEST_TILE_PX = 256  # of TILE_SIZE


def free_mib() -> Optional[float]:
    """Memory that this process and its workers may still take, MiB; None where the system does not say.

    On Linux the kernel's own estimate, or what the limits of containers and of the shell (``ulimit -v``) leave,
    whichever is least; elsewhere the free (Windows) or a half of all physical memory.
    """
    known = kernel_memory().get("MemAvailable"), container_rest(), own_rest()
    found = [value / _MIB for value in known if value is not None]
    if found:
        return min(found)
    if sys.platform == "win32":
        return _windows_mib()
    total = physical_memory()
    return None if total is None else total / _MIB / 2


def kernel_memory() -> Dict[str, int]:
    """Linux's own figures, bytes by their names in /proc/meminfo; empty elsewhere."""
    found = {}
    try:
        with open("/proc/meminfo", encoding="ascii", errors="replace") as stream:
            for line in stream:
                name, _, value = line.partition(":")
                if value.strip().endswith("kB"):
                    found[name] = int(value.split()[0]) * 1024
    except (OSError, ValueError):
        pass
    return found


def physical_memory() -> Optional[int]:
    """All memory of this machine, bytes; None where the system does not say."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def _windows_mib() -> Optional[float]:
    class Status(ctypes.Structure):
        _fields_ = [("length", ctypes.c_ulong), ("load", ctypes.c_ulong)] + [
            (name, ctypes.c_ulonglong)
            for name in ("total", "free", "page", "page_free", "virtual", "virtual_free", "extended")
        ]

    status = Status()
    status.length = ctypes.sizeof(Status)
    windll: Any = getattr(ctypes, "windll")  # noqa: B009 - there is none elsewhere
    return float(status.free) / _MIB if windll.kernel32.GlobalMemoryStatusEx(ctypes.byref(status)) else None


@dataclass(frozen=True)
class Work:
    """The work of one task: its ``name`` in messages, its peak memory in MiB, as estimated below, and what the user may
    choose so that it fits into a given memory, as the rest of a sentence."""

    name: str
    mib: float
    remedy: Callable[[float], str]


def tile_work(tile_px: int, mib: float) -> Work:
    """A tile of so many px a side, which may be made smaller."""

    def remedy(room_mib: float) -> str:
        side = largest_tile(tile_px, mib, room_mib)
        if side:
            return f"choose a TILE_SIZE of {side} px or less"
        return "use a machine with more memory, as no tile is small enough"

    return Work(f"one tile of {tile_px} px", mib, remedy)


def workers_within(workers: int, work: Work, budget_mib: int, progress: Progress) -> int:
    """The number of workers whose tasks fit into the budget together, at least one.

    Parameters
    ----------
    workers : wanted, 0 means one a core. work : of one worker.
    budget_mib : for all workers together, 0 means three quarters of what is free.

    Raises OptionError where one task alone exceeds a budget that was given; where it exceeds what is free, one worker
    tries, and a warning says so. What is computed does not depend on the number of workers.
    """
    wanted, limit, each_mib = workers or cores(), task_mib(), work.mib
    takes = f"{work.name[:1].upper()}{work.name[1:]} takes {each_mib:.0f} MiB, and"
    if limit is not None:
        if each_mib > limit:
            raise ClusterError(f"{takes} the cluster's smallest worker has {limit:.0f} MiB: {work.remedy(limit)}.")
        return wanted
    free = None if budget_mib else free_mib()
    budget = float(budget_mib) if budget_mib else None if free is None else _SHARE * free
    if budget is None:
        return wanted
    if each_mib > budget:
        remedy = work.remedy(budget)
        if budget_mib:
            least = f"the {each_mib:.0f} MiB that {work.name} takes"
            raise OptionError("MEMORY", budget_mib, f"is less than {least}; allow more, or {remedy}")
        progress.info(f"{takes} only {free:.0f} MiB are free: if memory runs out, {remedy}.")
        return 1
    fitting = int(budget // each_mib)
    if fitting < wanted:
        reason = f"each takes up to {each_mib:.0f} MiB, and {budget:.0f} MiB are allowed"
        progress.info(f"{fitting} instead of {wanted} workers: {reason}.")
    return min(wanted, fitting)


_PROCESS_MIB = 125.0  # a worker with its libraries, before it does anything
_LEAN_PROCESS_MIB = 111.0  # the same of one that needs no SciPy
_BYTES_PER_PX = 115.0  # of the rectified tile
_RECTIFIED = 1.2  # side of a rectified tile by that of its ground, where memory is planned
_BYTES_PER_REFINED_PX = 22_000.0  # of a refined image's width: it is made in strips of 512 rows
_BYTES_PER_COST = 4.0  # of a cost and its sum over eight directions, which OpenCV keeps for the whole tile
_BYTES_PER_STRIP_PX = 16.0  # of the second image's strip that only far disparities reach


def matching_mib(width: float, height: float, disparities: float, paths: int = 3) -> float:
    """Peak memory of a worker that matches a rectified tile of width x height px over so many disparities, MiB.

    ``paths`` are the directions of aggregation: with 8, the costs of all these disparities are kept, as they are of
    learned features. Fitted to measured
    peaks of 0.2 to 2.1 Mpx; tests/engine/runtime/test_memory.py holds it to them within a factor of 1.5.
    """
    volume = _BYTES_PER_COST * (width + disparities) * height * disparities if paths == 8 else 0.0
    frame = _BYTES_PER_PX * width * height + _BYTES_PER_STRIP_PX * disparities * height
    return _PROCESS_MIB + (frame + volume) / _MIB


def planned_mib(side: float, disparities: float, paths: int = 3) -> float:
    """:func:`matching_mib` of a square of ground ``side`` px wide, before its rectification is known."""
    return matching_mib(_RECTIFIED * side, _RECTIFIED * side, disparities, paths)


def refining_mib(width: float) -> float:
    """Peak memory of a worker that writes refined images ``width`` px wide, MiB; with 0, of one that writes none.

    Fitted to the peaks of workers that wrote images 1200 px wide, 133 MiB, and none, 108 MiB.
    """
    return _LEAN_PROCESS_MIB + _BYTES_PER_REFINED_PX * width / _MIB


_PART_CELLS = 536**2  # that are fused at once, with their margin (fusion/tile_fusion.py)


def fusing_mib(pixels: Sequence[int], cells: int) -> float:
    """Peak memory of a worker that fuses height maps of so many pixels each into a tile of so many cells, MiB.

    Maps are read one after the other, as much of each as a part of the tile needs; their heights stay as observations,
    and where these disagree each is compared with each. Fitted to measured peaks of 1 to 26 maps on 0.02 to 6.3 million
    cells, as :func:`matching_mib`.
    """
    maps, part = len(pixels), min(cells, _PART_CELLS)
    share = min(1.0, 1.3 * _PART_CELLS / max(cells, 1))
    read = (115.0 * max(pixels, default=0) + 8.0 * sum(pixels[1:])) * share
    fused = read + (45.0 * maps + 4.0 * maps * (maps - 1)) * part + 115.0 * cells
    return 105.0 + fused / _MIB


def gathering_mib(pixels: Sequence[int], cells: int) -> float:
    """Peak memory of a worker that gathers the points of height maps of so many pixels each on so many cells, MiB.

    Maps are read one after the other, each as a whole. Fitted to measured peaks of 1 to 4 maps of 1.5 Mpx: 345 to 371
    MiB, and 377 with normals.
    """
    return 105.0 + (155.0 * max(pixels, default=0) + 30.0 * cells) / _MIB


def fitting_mib(cells: int) -> float:
    """Peak memory of a worker that compares so many cells with the images (fusion/surface.py), MiB. Fitted to measured
    peaks of 0.02 to 1.2 million cells, with six views: 149 to 313 MiB."""
    return 150.0 + 155.0 * cells / _MIB


def colouring_mib(cells: int, views: int, bands: int) -> float:
    """Peak memory of a worker that colours a block of so many cells with so many views (ortho/colour_blocks.py), MiB.

    Fitted to measured peaks of 1 to 8 views of 3 bands and 1 to 3 pansharpened ones of 4, on 0.1 to 0.9 million cells:
    one view alone takes what its own colours need, several take what choosing between them needs. The visibility test
    comes before that, up to 512 cells away, and takes less.
    """
    alone, together = 90.0 + 20.0 * bands, 4.0 * views * (4.0 * bands + 5.0 + 0.56 * views)
    return 115.0 + max(alone, together) * cells / _MIB


def largest_tile(tile_px: int, each_mib: float, budget_mib: float) -> int:
    """The side of the largest tile that fits, px, in whole tens; 0 where not even the smallest that can be set does."""
    room = max(budget_mib - _PROCESS_MIB, 0.0) / max(each_mib - _PROCESS_MIB, 1.0)
    side = int(0.95 * tile_px * room**0.5) // 10 * 10
    return side if side >= _SMALLEST_TILE_PX else 0
