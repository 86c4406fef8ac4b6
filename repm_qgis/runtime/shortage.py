"""Lack of memory, disk space or open files: recognised from the errors of any library, and reported in a sentence."""

from __future__ import annotations

import errno
import re
from contextlib import contextmanager
from typing import Iterator, List, Optional

from ..contracts.errors import OutOfMemoryError, RepmError, WorkspaceError
from .containers import own_rest
from .workspace import OF_THE_DISK, cannot_write

MEMORY_REMEDY = "use fewer WORKERS, a smaller TILE_SIZE or EXTENT, or set MEMORY to what all workers may take"
_BUFFERS = 192 << 20  # OpenBLAS takes 128 MiB on x86-64
# numpy, OpenCV, GDAL, C++, the dynamic linker, Python's threads, OpenBLAS, and Windows with a full paging file.
_MEMORY_WORDS = re.compile(
    r"insufficient memory|out of memory|cannot allocate|unable to allocate|failed to allocate|bad_alloc|bad alloc"
    r"|failed to map segment|can't start new thread|cannot start new thread|pthread_create"
    r"|thread pool has not been|paging file|memory ran out",
    re.IGNORECASE,
)


def speaks_of_memory(text: str) -> bool:
    """Whether a library's message means that memory ran out."""
    return _MEMORY_WORDS.search(text) is not None


def reserve_buffers() -> None:
    """Where the address space is bounded, have linear algebra take its buffer now; raises OutOfMemoryError.

    OpenBLAS tries forever to get a buffer that it cannot have. To be called once numpy is imported.
    """
    rest = own_rest()
    if rest is None:
        return
    if rest < _BUFFERS:
        left = f"only {rest / 2**20:.0f} MiB of address space are left, and {_BUFFERS >> 20} MiB are needed to start"
        raise OutOfMemoryError(f"Memory ran out ({left}): raise the limit (ulimit -v), or {MEMORY_REMEDY}.")
    import numpy as np

    square = np.ones((256, 256))
    square @ square


@contextmanager
def shortage_as_error() -> Iterator[None]:
    """Within the block, a lack of memory, disk space or open files raises OutOfMemoryError or WorkspaceError."""
    try:
        yield
    except (OutOfMemoryError, WorkspaceError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:  # a panic of a library in Rust is no Exception
        said = _sentence(error)
        if said is None:
            raise
        raise said from error


def _sentence(error: BaseException) -> Optional[RepmError]:
    chain = _chain(error)
    for each in chain:
        if _is_memory(each):
            words = " ".join(str(each).split())[:200]
            return OutOfMemoryError(f"Memory ran out{f' ({words})' if words else ''}: {MEMORY_REMEDY}.")
    if isinstance(error, RepmError):
        return None
    for each in chain:
        if isinstance(each, OSError) and each.errno in OF_THE_DISK:
            if each.filename:
                return cannot_write(str(each.filename), each)
            remedy = "free some space, raise the limit of open files (ulimit -n), or use fewer workers"
            return WorkspaceError(f"No file or pipe can be opened or written ({each.strerror}): {remedy}.")
    return None


def _is_memory(error: BaseException) -> bool:
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    return not isinstance(error, RepmError) and speaks_of_memory(str(error))


def _chain(error: BaseException) -> List[BaseException]:
    """An error and those that it came from, which a library may have replaced by its own."""
    found: List[BaseException] = []
    rest: Optional[BaseException] = error
    while rest is not None and rest not in found:
        found.append(rest)
        rest = rest.__cause__ or rest.__context__
    return found
