"""The DSM's mesh as OBJ, with its material and the orthophoto as picture in two files beside it.

Coordinates are metres east, north and up from the middle of the DSM: readers of OBJ hold single precision. The middle,
its CRS and the datum of the heights are in comments.

References
----------
Wavefront Technologies, Advanced Visualizer manual, appendices B1 (OBJ) and B2 (MTL).
"""

from __future__ import annotations

import os
import re
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, Tuple

import numpy as np
from numpy.typing import NDArray

from ..contracts.errors import WorkspaceError
from ..geometry.vertical import ELLIPSOID, TAG
from ..runtime.workspace import whole_file
from .lattice import Surface
from .texture import middle, picture, picture_places

_MATERIAL = "newmtl orthophoto\nKd 1 1 1\nillum 1\nmap_Kd {name}.jpg\n"


def require_own_companions(path: str) -> None:
    """Raise WorkspaceError where the picture or the material of an OBJ would replace a file that is not such a one.

    A material of this module is known by its text, and the picture by the material, which is written before it.
    """
    name, *companions = _companions(path)
    taken = [each for each in companions if os.path.lexists(each)]
    try:
        ours = companions[1].read_bytes() == _MATERIAL.format(name=name).encode()
    except OSError:
        ours = False
    if taken and not ours:
        raise WorkspaceError(
            f"'{taken[0]}' is not of an earlier mesh, and the mesh '{path}' would replace it: move it, or choose "
            "another name for MESH."
        )


def _companions(path: str) -> Tuple[str, Path, Path]:
    """The name that an OBJ's picture and material begin with, and their paths."""
    name = re.sub(r"[^\w.-]", "_", Path(path).name)
    return name, Path(path).with_name(f"{name}.jpg"), Path(path).with_name(f"{name}.mtl")


def write_obj(temporary: str, path: str, surface: Surface) -> None:
    """Write the mesh that will be ``path`` into a temporary file; where the surface has paint, ``path.mtl`` and
    ``path.jpg`` too, which only belong to it. Their names have no spaces, which many readers do not take.

    Raises WorkspaceError where they would replace other files (:func:`require_own_companions`).

    Memory does not grow with the DSM, but for the picture's.
    """
    name, *companions = _companions(path)
    with ExitStack() as stack:
        stream = stack.enter_context(open(temporary, "wb"))
        if surface.paint is not None:
            require_own_companions(path)
            image, material = (stack.enter_context(whole_file(str(place))) for place in companions)
            Path(image).write_bytes(picture(surface.paint))
            Path(material).write_bytes(_MATERIAL.format(name=name).encode())
        _write(stream, surface, f"mtllib {name}.mtl\nusemtl orthophoto\n" if surface.paint is not None else "")


def _write(stream: BinaryIO, surface: Surface, material: str) -> None:
    origin = middle(surface)
    heights = surface.dataset.GetMetadataItem(TAG) or ELLIPSOID
    place = f"{origin[0]:.0f} {origin[1]:.0f} 0"
    stream.write(f"# origin: {place}, of x to the east, y to the north, z up, in metres\n".encode())
    stream.write(f"# heights: metres above the {heights}\n".encode())
    stream.write(f"# crs: {surface.dataset.GetProjection()}\n{material}".encode())
    for places in surface.parts():
        stream.write(_lines("v %.4f %.4f %.4f\n", places - origin))
    if material:
        for places in surface.parts():
            right, down = picture_places(surface, places).T
            stream.write(_lines("vt %.6f %.6f\n", np.column_stack([right, 1.0 - down])))
    corner = "%d/%d" if material else "%d"
    for corners in surface.triangles():
        numbers = np.repeat(corners + 1, 2 if material else 1, axis=1)
        stream.write(_lines(f"f {corner} {corner} {corner}\n", numbers))


def _lines(form: str, values: NDArray[np.generic]) -> bytes:
    """A line for each row of values."""
    return (form * len(values) % tuple(values.ravel().tolist())).encode("ascii")
