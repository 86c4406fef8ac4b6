"""Calls of Windows' own functions; on other systems nothing is done."""

from __future__ import annotations

import ctypes
import sys
from typing import Optional

_QUERY, _STILL_ACTIVE = 0x1000, 259
_ATTRIBUTES, _SHARED, _EXISTING, _FOLDERS_TOO = 0x80, 7, 3, 0x02000000
_KILL_ON_JOB_CLOSE, _EXTENDED_LIMITS = 0x2000, 9  # winnt.h


class _Times(ctypes.Structure):
    """FILE_BASIC_INFO (winbase.h)."""

    _fields_ = [(name, ctypes.c_int64) for name in ("made", "read", "written", "changed", "attributes")]


class _Limits(ctypes.Structure):
    """JOBOBJECT_EXTENDED_LIMIT_INFORMATION (winnt.h)."""

    _fields_ = [
        ("process_time", ctypes.c_int64),
        ("job_time", ctypes.c_int64),
        ("flags", ctypes.c_uint32),
        ("least_working_set", ctypes.c_size_t),
        ("most_working_set", ctypes.c_size_t),
        ("processes", ctypes.c_uint32),
        ("affinity", ctypes.c_size_t),
        ("priority", ctypes.c_uint32),
        ("scheduling", ctypes.c_uint32),
        ("transfers", ctypes.c_uint64 * 6),
        ("memory", ctypes.c_size_t * 4),
    ]


def end_children_with_us() -> bool:
    """Have Windows end all that this process starts as soon as this process has ended, killed or not.

    Windows knows no process groups: whoever ends a process leaves its children. A job object, whose only handle this
    process holds until its end, takes them along. Gives whether that is so.
    """
    if sys.platform != "win32":
        return False
    kernel = ctypes.WinDLL("kernel32")
    kernel.CreateJobObjectW.restype = kernel.GetCurrentProcess.restype = ctypes.c_void_p
    job = ctypes.c_void_p(kernel.CreateJobObjectW(None, None))
    limits = _Limits(flags=_KILL_ON_JOB_CLOSE)
    size = ctypes.sizeof(limits)
    return bool(
        job
        and kernel.SetInformationJobObject(job, _EXTENDED_LIMITS, ctypes.byref(limits), size)
        and kernel.AssignProcessToJobObject(job, ctypes.c_void_p(kernel.GetCurrentProcess()))
    )


def process_exists(number: int) -> bool:
    """Whether a process of this machine has this number; False elsewhere than on Windows."""
    if sys.platform != "win32":
        return False
    kernel = ctypes.WinDLL("kernel32")
    kernel.OpenProcess.restype = ctypes.c_void_p
    handle = ctypes.c_void_p(kernel.OpenProcess(_QUERY, False, number))
    if not handle:
        return False
    code = exit_code(handle.value or 0)
    kernel.CloseHandle(handle)
    return code is None or code == _STILL_ACTIVE


def exit_code(handle: int) -> Optional[int]:
    """The exit code of a process by its handle, 259 while it runs; None where Windows gives none, and on other
    systems."""
    code = ctypes.c_ulong()
    if sys.platform == "win32" and ctypes.WinDLL("kernel32").GetExitCodeProcess(
        ctypes.c_void_p(handle), ctypes.byref(code)
    ):
        return code.value
    return None


def cancel_transfers(handle: int) -> None:
    """Have reads and writes that any thread of this process is waiting for on a handle fail now."""
    if sys.platform == "win32":
        ctypes.WinDLL("kernel32").CancelIoEx(ctypes.c_void_p(handle), None)


def change_time(path: str) -> int:
    """When a file or its metadata were last changed, in units of 100 ns; 0 where that is unknown.

    Unlike the time of the last writing, it cannot be set back.
    """
    if sys.platform != "win32":
        return 0
    kernel = ctypes.WinDLL("kernel32")
    kernel.CreateFileW.restype = ctypes.c_void_p
    handle = ctypes.c_void_p(kernel.CreateFileW(path, _ATTRIBUTES, _SHARED, None, _EXISTING, _FOLDERS_TOO, None))
    if handle.value in (None, ctypes.c_void_p(-1).value):
        return 0
    times = _Times()
    known = kernel.GetFileInformationByHandleEx(handle, 0, ctypes.byref(times), ctypes.sizeof(times))
    kernel.CloseHandle(handle)
    return int(times.changed) if known else 0
