"""The DSM as a triangle mesh: as PLY, which QGIS shows as a mesh layer, or as GLB or OBJ with a picture on it."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import Optional

import numpy as np
from osgeo import gdal

from ..contracts.arrays import AnyArray, FloatArray, IntArray
from ..contracts.errors import EmptyResultError
from ..contracts.file_kinds import is_textured
from ..contracts.options import require_mesh
from ..geometry.vertical import ELLIPSOID, TAG
from ..imagery.raster import opened
from ..runtime.progress import Progress, Silent
from ..runtime.workspace import whole_file
from . import ply
from .derived import FinishedDsm
from .gltf import write_glb
from .lattice import Surface
from .obj import write_obj
from .painting import Colours, opened_paint
from .parameters import SOLIDS, SolidsParameters
from .simplification import reduced

_COLOURED = np.dtype([("place", "<f8", 3), ("colour", "u1", 3)])
_FACE = np.dtype([("corners", "u1"), ("vertices", "<i4", 3)])


@dataclass(frozen=True)
class MeshFacts:
    """A written mesh of a DSM of so many ``cells`` with heights."""

    vertices: int
    faces: int
    cells: int


def make(finished: FinishedDsm, path: str, progress: Progress) -> Optional[str]:
    """The surface of a finished DSM as a PLY, GLB or OBJ; gives its path."""
    options = finished.options
    ortho = finished.ortho or (options.ortho if is_textured(path) else None)  # greys are no colours, but a picture
    mesh = write_mesh(options.output, path, options.mesh_vertices, progress, finished.parameters, ortho)
    fewer = f", chosen from {mesh.cells} cells (MESH_VERTICES)" if mesh.vertices < mesh.cells else ""
    progress.info(f"Mesh of {mesh.vertices} vertices and {mesh.faces} triangles{fewer}.")
    return path


def write_mesh(
    dsm: str,
    path: str,
    max_vertices: int = 0,
    progress: Optional[Progress] = None,
    parameters: SolidsParameters = SOLIDS,
    ortho: Optional[str] = None,
) -> MeshFacts:
    """Write a DSM's surface as a binary PLY or, by the name's end, as glTF (.glb) or OBJ; completely or not at all.

    Vertices are cells that have a height, in the DSM's CRS and heights, double precision. Where these are more than
    ``max_vertices`` (0: no limit), edges are collapsed until so many are left (solids/simplification.py). No triangle
    lies on a cell without a height, so holes stay open; of a square's two diagonals the flatter one is
    taken, which keeps edges of roofs straight. A PLY's vertices have the colours of
    ``ortho``, an orthophoto on the DSM's cells or finer ones; a GLB and an OBJ have its picture, and places from the
    DSM's middle.

    Raises OptionError for another extension, EmptyResultError for a DSM without heights, WorkspaceError where the file
    cannot be written.
    """
    require_mesh(path)
    progress = progress or Silent()
    with ExitStack() as stack:
        dataset = stack.enter_context(opened(dsm))
        paint = stack.enter_context(opened_paint(ortho, parameters.painting)) if ortho else None
        surface, cells = reduced(dataset, max_vertices, parameters, progress=progress, paint=paint)
        vertices, faces = surface.counts()
        if not vertices:
            raise EmptyResultError(f"The DSM '{dsm}' has no heights: there is nothing to write into '{path}'.")
        with whole_file(path) as temporary:
            if path.lower().endswith(".obj"):
                write_obj(temporary, path, surface)
            elif is_textured(path):
                write_glb(temporary, surface, vertices, faces)
            else:
                _write(temporary, surface, vertices, faces)
    return MeshFacts(vertices, faces, cells)


def _write(path: str, surface: Surface, vertices: int, faces: int) -> None:
    with open(path, "wb") as stream:
        stream.write(_header(surface.dataset, vertices, faces, surface.paint is not None))
        for places, colours in surface.painted():
            stream.write(_vertices(places, colours))
        for corners in surface.triangles():
            stream.write(_faces(corners).tobytes())


def _vertices(places: FloatArray, colours: Optional[Colours]) -> bytes:
    if colours is None:
        return places.astype("<f8").tobytes()
    records = np.empty(len(places), _COLOURED)
    records["place"], records["colour"] = places, colours >> 8
    return records.tobytes()


def _header(dataset: gdal.Dataset, vertices: int, faces: int, coloured: bool) -> bytes:
    properties = [*ply.PLACE, *(ply.COLOUR if coloured else ())]
    elements = [("vertex", vertices, properties), ("face", faces, ["property list uchar int vertex_indices"])]
    return ply.header(dataset.GetProjection(), dataset.GetMetadataItem(TAG) or ELLIPSOID, elements)


def _faces(corners: IntArray) -> AnyArray:
    faces = np.empty(len(corners), _FACE)
    faces["corners"], faces["vertices"] = 3, corners
    return faces
