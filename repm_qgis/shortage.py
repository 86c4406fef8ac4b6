"""Want of memory, disk space or open files, told from the errors of whatever library met it, and said in a sentence."""

from __future__ import annotations

import errno
import re
from contextlib import contextmanager
from typing import Iterator, List, Optional

from .errors import OutOfMemoryError, RepmError, WorkspaceError
from .workspace import OF_THE_DISK, cannot_write

MEMORY_REMEDY = "use fewer WORKERS, a smaller TILE_SIZE or EXTENT, or set MEMORY to what all workers may take"
# numpy, OpenCV, GDAL, C++, the dynamic linker, Python's threads, OpenBLAS, and Windows with a full paging file.
_MEMORY_WORDS = re.compile(
    r"insufficient memory|out of memory|cannot allocate|unable to allocate|failed to allocate|bad_alloc|bad alloc"
    r"|failed to map segment|can't start new thread|cannot start new thread|pthread_create|paging file|memory ran out",
    re.IGNORECASE,
)


def speaks_of_memory(text: str) -> bool:
    """Whether a library's words say that memory ran out."""
    return _MEMORY_WORDS.search(text) is not None


@contextmanager
def said_in_a_sentence() -> Iterator[None]:
    """Within the block want of memory, disk space or open files raises OutOfMemoryError or WorkspaceError."""
    try:
        yield
    except (OutOfMemoryError, WorkspaceError):
        raise
    except Exception as error:
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
            return cannot_write(str(each.filename or "a temporary file"), each)
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
