"""Point clouds as LAS and LAZ: their extensions, the package laspy, and how it compresses LAZ."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .containers import own_rest
from .errors import INSTALL_REMEDY, MissingPackageError

EXTENSIONS = (".laz", ".las")


def is_cloud(path: str) -> bool:
    """Whether a file is a point cloud, by its extension."""
    return Path(path).suffix.lower() in EXTENSIONS


def required_laspy(option: str) -> Any:
    """The package laspy; raises MissingPackageError with the option that needs it."""
    try:
        import laspy
    except ImportError as error:
        raise MissingPackageError(
            f"Point clouds need the package 'laspy': {INSTALL_REMEDY}, or leave {option} empty."
        ) from error
    return laspy


def laz_backend(laspy: Any) -> Any:
    """Compression by all cores, but by one where the address space is bounded: threads that find none end the process.

    The files are the same.
    """
    bounded = own_rest() is not None
    return laspy.LazBackend.Lazrs if bounded else laspy.LazBackend.detect_available()
