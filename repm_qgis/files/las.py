"""Point clouds as LAS and LAZ: the package laspy, and how it compresses LAZ."""

from __future__ import annotations

import os
import struct
from types import ModuleType

from ..contracts.errors import INSTALL_REMEDY, MissingPackageError
from ..runtime.containers import own_rest

# LAS 1.4 R15, table 3: the header's size, the offset of the points and the number of records before them; from version
# 1.4 on where the records after them begin, and their number. A record has a header of so many bytes (tables 6 and 7).
_BEFORE, _AFTER = (94, "<HII"), (235, "<QI")
_LEAST_HEADER, _LEAST_HEADER_1_4 = 227, 375
_RECORD, _LATER_RECORD = 54, 60
_LENGTH = 20  # where a later record's header states how many bytes follow it, 8 bytes


def impossible_header(path: str) -> str:
    """Why a file's header cannot be true, for the end of a sentence; "" where it can, and where the file is no cloud.

    A file that is cut, or one that claims 4294967295 records, has laspy read for hours, or ask for all memory. Raises
    OSError where the file cannot be read.
    """
    size = os.path.getsize(path)
    with open(path, "rb") as stream:
        head = stream.read(_LEAST_HEADER_1_4)
    if head[:4] != b"LASF":
        return ""
    later = len(head) > 25 and tuple(head[24:26]) >= (1, 4)
    if len(head) < (_LEAST_HEADER_1_4 if later else _LEAST_HEADER):
        return f"its {size} bytes end in its header"
    length, points, records = struct.unpack_from(_BEFORE[1], head, _BEFORE[0])
    if points > size:
        return f"its points begin at byte {points}, and it has {size}"
    if length + records * _RECORD > points:
        return f"its header claims {records} records before its points, which begin at byte {points}"
    if later:
        first, records = struct.unpack_from(_AFTER[1], head, _AFTER[0])
        if records and not points <= first <= _end_of_records(path, first, records) <= size:
            return f"its header claims {records} records after its points, from byte {first}, and it has {size} bytes"
    return ""


def _end_of_records(path: str, place: int, records: int) -> int:
    """The byte after the records that follow the points, each with the length that it states; beyond the file's end
    where they cannot all be there."""
    size = os.path.getsize(path)
    if place + records * _LATER_RECORD > size:
        return size + 1
    with open(path, "rb") as stream:
        for _ in range(records):
            if place + _LATER_RECORD > size:
                return size + 1
            stream.seek(place + _LENGTH)
            place += _LATER_RECORD + int.from_bytes(stream.read(8), "little")
    return place


def required_laspy(option: str) -> ModuleType:
    """The package laspy; raises MissingPackageError with the option that needs it."""
    try:
        import laspy
    except ImportError as error:
        raise MissingPackageError(
            f"Point clouds need the package 'laspy': {INSTALL_REMEDY}, or leave {option} empty."
        ) from error
    found: ModuleType = laspy
    return found


def laz_backend(laspy: ModuleType) -> object:
    """Compression by all cores, but by one where the address space is bounded: threads that find none end the process.

    The files are the same.
    """
    bounded = own_rest() is not None
    return laspy.LazBackend.Lazrs if bounded else laspy.LazBackend.detect_available()
