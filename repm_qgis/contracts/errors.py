"""All failures that are expected.

Each message is one sentence or two for the analyst: the file, the value, and what to do about it. Errors inherit
from :class:`RepmError` and from the builtin that fits, so library users may catch either.
"""

from __future__ import annotations

import errno
import os

from .data_folder import IN_WHEEL

INSTALL_REMEDY = (
    "install it with pip, but GDAL's bindings with the system's packages or with conda (docs/engine.md)"
    if IN_WHEEL
    else "choose Plugins > REPM > 'Install the engine's packages' in QGIS, or run 'Report the environment' "
    "(repm:environment) with INSTALL=true"
)
"""What to do where packages are missing: the same words in every message."""


class RepmError(Exception):
    """Root of all expected failures. A traceback of anything else is a bug."""

    def __str__(self) -> str:
        """One line, whatever the names of files that the message holds."""
        return " ".join(super().__str__().splitlines())


class OptionError(RepmError, ValueError):
    """An option has a value it cannot have."""

    def __init__(self, name: str, value: object, reason: str) -> None:
        shown = repr(value).replace("\\\\", "\\")  # one line, whatever is in it, and paths of Windows as they are
        empty = value is None or shown == "''"
        super().__init__(f"{name} is empty: it {reason}." if empty else f"{name} is {shown}: it {reason}.")
        self.name = name
        self.value = value
        self.reason = reason

    def __reduce__(self) -> tuple[object, ...]:
        # Pickled by what it is made of, so that it comes out of a worker process as itself.
        return type(self), (self.name, self.value, self.reason)


class ImageError(RepmError, OSError):
    """An image or raster cannot be read, or has no usable content."""


class RpcError(RepmError, ValueError):
    """The root of what can be wrong with an image's RPC."""


class RpcMissingError(RpcError):
    """No RPC was found for an image; the message lists where it was looked for."""


class RpcInvalidError(RpcError):
    """An RPC was found, but its numbers cannot be a sensor model."""


class InputTableError(RepmError, ValueError):
    """A table of points (GCPs) cannot be read, or a row of it is wrong; the message names the row."""


class OverlapError(RepmError, ValueError):
    """Images, extents or rasters do not meet on the ground."""


class SceneError(RepmError, ValueError):
    """A scene file is not one of ours, is damaged, or lacks what a stage needs."""


class SceneVersionError(SceneError):
    """A scene file was written by a newer version of the plugin."""


class WorkspaceError(RepmError, OSError):
    """A folder or file cannot be written."""


class OutOfMemoryError(RepmError, MemoryError):
    """Memory ran out in the engine or a worker; the message names the settings that need less."""


class MissingPackageError(RepmError, ImportError):
    """A Python package that a stage needs is not installed."""


class DeviceError(RepmError, RuntimeError):
    """A GPU is missing, lost or full."""


class ClusterError(RepmError, RuntimeError):
    """A cluster cannot be reached, its workers cannot do the work, or they were lost."""


class WorkerError(RepmError, RuntimeError):
    """A worker process could not begin, or ended without an answer: nothing is known of what it was to make, and no
    caller may treat that as an empty result."""


class EmptyResultError(RepmError, RuntimeError):
    """A stage ran, but its result is empty or too small to continue with; the message gives the counts."""


class Cancelled(RepmError):
    """The user asked to stop."""

    def __init__(self) -> None:
        super().__init__("Cancelled by the user.")

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), ()


def reason_of(error: OSError) -> str:
    """Why the system refused; where something is absent in the same words on each system, which translations know.

    Windows has words of its own there, in the language of the system.
    """
    return os.strerror(error.errno) if error.errno == errno.ENOENT else error.strerror or str(error)
