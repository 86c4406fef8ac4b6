"""The resources of one process: threads of linear algebra, freed memory, the cache of GDAL."""

from __future__ import annotations

import ctypes
import glob
import os
import sys
import threading
from contextlib import contextmanager
from typing import Callable, Iterator, List, Tuple

from .shortage import reserve_buffers

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of glibc's mallopt (malloc.h)


def one_thread_for_sums() -> None:
    """Let linear algebra use one thread, from its import on: call it before numpy is imported.

    Sums in another order differ in their last bits with the number of threads, and rounding makes whole pixels of
    them: results must not depend on it. In a worker, N threads for each of N workers would be too many, besides.
    """
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"


_BLAS_THREADS = (
    *(
        (f"{before}openblas_get_num_threads{after}", f"{before}openblas_set_num_threads{after}")
        for before in ("", "scipy_")
        for after in ("", "64_")
    ),
    ("MKL_Get_Max_Threads", "MKL_Set_Num_Threads"),
)
_linear_algebra = threading.Lock()
_threads_before: List[Tuple[Callable[[int], object], int]] = []
_pinned = [0]  # how many blocks have one thread now


@contextmanager
def one_thread_for_loaded_sums() -> Iterator[None]:
    """Within the block linear algebra that is loaded already uses one thread; then as many as before.

    For a process that is not ours, such as QGIS's or a notebook's: its settings affect other code too. Several of its
    threads may be in such a block at the same time. Apple's Accelerate has no such setting, and stays as it is.
    """
    with _linear_algebra:
        if not _pinned[0]:
            _threads_before[:] = [(put, get()) for get, put in _thread_settings()]
            for put, _ in _threads_before:
                put(1)
        _pinned[0] += 1
    try:
        yield
    finally:
        with _linear_algebra:
            _pinned[0] -= 1
            if not _pinned[0]:
                for put, count in _threads_before:
                    put(count)


def _thread_settings() -> Iterator[Tuple[Callable[[], int], Callable[[int], object]]]:
    """The functions that read and set the number of threads of each library of linear algebra that numpy and SciPy have
    loaded."""
    import numpy.linalg

    modules = ("numpy.linalg._umath_linalg", "scipy.linalg._fblas", "scipy.linalg._flapack")
    files = [str(getattr(sys.modules.get(name), "__file__", "")) for name in modules]  # which know what they need
    folder = os.path.dirname(os.path.dirname(str(numpy.__file__)))
    files += glob.glob(os.path.join(glob.escape(folder), "*.libs", "*openblas*.dll"))  # Windows looks into no others
    for file in filter(None, files):
        try:
            library = ctypes.CDLL(file)
        except OSError:
            continue
        for get, put in _BLAS_THREADS:
            if hasattr(library, get) and hasattr(library, put):
                yield getattr(library, get), getattr(library, put)


def keep_freed_memory() -> None:
    """Let glibc keep freed memory for the next array, not hand it back and have it zeroed again page by page.

    That is a tenth of the time of arithmetic on tiles; the peak stays. Elsewhere nothing is done.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return
    mallopt(_MMAP_THRESHOLD, 32 << 20)
    mallopt(_TRIM_THRESHOLD, 128 << 20)


def bound_cache(megabytes: int = 128) -> None:
    """Keep GDAL's block cache small: its default takes a twentieth of the machine. For processes of our own only."""
    from osgeo import gdal

    gdal.SetCacheMax(megabytes << 20)


def silence_gdal() -> None:
    """Keep GDAL's messages off the console: they come in our exceptions, and those of a file that is then read in
    another way mean nothing. For processes of our own only."""
    from osgeo import gdal

    gdal.SetErrorHandler("CPLQuietErrorHandler")


def prepare_process() -> None:
    """Have one thread and a small cache of GDAL in a process that does one task at a time."""
    one_thread_for_sums()
    keep_freed_memory()
    import cv2

    cv2.setNumThreads(1)
    bound_cache(64)
    silence_gdal()
    reserve_buffers()
