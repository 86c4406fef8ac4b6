"""The DSM's mesh as glTF in one binary file (GLB), with the orthophoto as its picture: for the web, games and CAD; and
the meshes and points of 3-D Tiles.

Coordinates are metres from the middle of the DSM in single precision, as glTF has no other: x to the east, y up, z to
the south. The middle, its CRS and the datum of the heights are in ``asset.extras``, so that the mesh can be put back.

References
----------
Khronos Group, glTF 2.0 Specification, 2021: sections 3.6 (buffers), 3.7 (meshes), 3.9 (materials) and 4.4 (GLB).
"""

from __future__ import annotations

import json
import struct
from functools import lru_cache
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, IntArray
from ..contracts.errors import OptionError
from ..geometry.vertical import ELLIPSOID, TAG
from .lattice import Surface
from .painting import Colours
from .texture import middle, picture, picture_places

_POSITION, _PLACE, _CORNERS = 12, 8, 12  # bytes: of a vertex, of its place in the picture, of a triangle
_FLOAT, _UINT, _USHORT = 5126, 5125, 5123  # glTF's names of types
_ARRAY, _ELEMENTS = 34962, 34963  # and of what buffers are for
_METADATA, _UNLIT = "EXT_structural_metadata", "KHR_materials_unlit"
_WHITE = 65535


def write_glb(path: str, surface: Surface, vertices: int, faces: int) -> None:
    """Write a mesh of so many vertices and triangles; the picture is there where the surface has paint.

    Memory does not grow with the DSM, but for the picture's. Raises OptionError beyond the 4 GiB that GLB can hold.
    """
    origin = middle(surface)
    low, high = _bounds(surface, origin)
    image = picture(surface.paint) if surface.paint is not None else None
    sizes = [vertices * _POSITION, vertices * _PLACE if image else 0, faces * _CORNERS, len(image or b"")]
    document, body = _document(_extras(surface, origin), (low, high), sizes), _even(sum(sizes))
    if body + len(document) + 28 >= 1 << 32:
        raise OptionError("MESH_VERTICES", vertices, "are more than a GLB can hold: choose 50000000, or a PLY")
    with open(path, "wb") as stream:
        stream.write(_head(document, body))
        for places in surface.parts():
            stream.write(turned(places - origin).astype("<f4").tobytes())
        if image:
            for places in surface.parts():
                stream.write(picture_places(surface, places).astype("<f4").tobytes())
        for corners in surface.triangles():
            stream.write(corners.astype("<u4").tobytes())
        stream.write((image or b"") + b"\0" * (body - sum(sizes)))


def small_glb(xyz: FloatArray, places: FloatArray, corners: IntArray, *, image: bytes) -> bytes:
    """A mesh that fits into memory as a GLB: (N, 3) east, north and up in metres, (N, 2) places in the picture
    ``image`` (JPEG), 0..1 to the right and down, and (M, 3) numbers of the triangles' vertices."""
    vertices = turned(xyz).astype("<f4")
    parts = [vertices.tobytes(), places.astype("<f4").tobytes(), corners.astype("<u4").tobytes(), image]
    ends = vertices.min(axis=0).astype(float).tolist(), vertices.max(axis=0).astype(float).tolist()
    return _joined(_document({}, ends, [len(part) for part in parts]), parts)


def points_glb(xyz: FloatArray, colours: Colours, intensity: FloatArray) -> bytes:
    """Points as a GLB: (N, 3) east, north and up in metres, (N, 3) colours as screens have them (sRGB), and (N,) values
    of 0..1, which are the points' property "intensity" (EXT_structural_metadata).

    Positions are relative to the points' middle, so that single precision holds them: the node moves them there.
    """
    places = turned(xyz)
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    near = (places - middle).astype("<f4")
    painted = np.full((len(xyz), 4), _WHITE, "<u2")
    painted[:, :3] = _linear()[colours]
    parts = [near.tobytes(), painted.tobytes(), intensity.astype("<f4").tobytes()]
    starts = [sum(map(len, parts[:n])) for n in range(3)]
    accessors: List[Dict[str, object]] = [
        {"componentType": _FLOAT, "type": "VEC3", "min": near.min(axis=0).tolist(), "max": near.max(axis=0).tolist()},
        {"componentType": _USHORT, "type": "VEC4", "normalized": True},
        {"componentType": _FLOAT, "type": "SCALAR"},
    ]
    primitive = {
        "attributes": {"POSITION": 0, "COLOR_0": 1, "_INTENSITY": 2},
        "material": 0,
        "mode": 0,
        "extensions": {_METADATA: {"propertyAttributes": [0]}},
    }
    attribute = {"class": "point", "properties": {"intensity": {"attribute": "_INTENSITY"}}}
    properties = {"intensity": {"type": "SCALAR", "componentType": "FLOAT32"}}
    schema = {"id": "points", "classes": {"point": {"properties": properties}}}
    document: Dict[str, object] = {
        "asset": {"version": "2.0", "generator": "REPM"},
        "extensionsUsed": [_METADATA, _UNLIT],
        "extensions": {_METADATA: {"schema": schema, "propertyAttributes": [attribute]}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": middle.tolist()}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"extensions": {_UNLIT: {}}}],
        "accessors": [{"bufferView": n, "count": len(xyz), **each} for n, each in enumerate(accessors)],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part), "target": _ARRAY}
            for start, part in zip(starts, parts)
        ],
        "buffers": [{"byteLength": sum(map(len, parts))}],
    }
    return _joined(_padded(json.dumps(document).encode("ascii"), b" "), parts)


@lru_cache(maxsize=1)
def _linear() -> Colours:
    """The colours that glTF has for those of screens (sRGB, IEC 61966-2-1), over the range of 16 bits."""
    shown = np.arange(_WHITE + 1) / _WHITE
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    table: Colours = np.rint(_WHITE * linear).astype(np.uint16)
    return table


def _joined(document: bytes, parts: Sequence[bytes]) -> bytes:
    """A whole file."""
    size = sum(map(len, parts))
    return _head(document, _even(size)) + b"".join(parts) + b"\0" * (_even(size) - size)


def _head(document: bytes, body: int) -> bytes:
    """All of the file that comes before its ``body`` of so many bytes."""
    whole = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(document) + 8 + body)
    return whole + struct.pack("<I4s", len(document), b"JSON") + document + struct.pack("<I4s", body, b"BIN\0")


def turned(xyz: FloatArray) -> FloatArray:
    """East, up and south of (N, 3) east, north and up."""
    return np.column_stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]])


def _bounds(surface: Surface, origin: FloatArray) -> Tuple[List[float], List[float]]:
    """The least and greatest coordinates, as single precision rounds them: readers compare them."""
    low, high = np.full(3, np.inf, np.float32), np.full(3, -np.inf, np.float32)
    for places in surface.parts():
        places = turned(places - origin).astype(np.float32)
        if len(places):
            low, high = np.minimum(low, places.min(axis=0)), np.maximum(high, places.max(axis=0))
    return [float(value) for value in low], [float(value) for value in high]


def _document(extras: Dict[str, object], ends: Tuple[List[float], List[float]], sizes: List[int]) -> bytes:
    """The JSON part of the file; ``sizes`` are bytes of positions, places in the picture, triangles and picture."""
    starts = [sum(sizes[:n]) for n in range(4)]
    kinds: List[Optional[int]] = [_ARRAY, _ARRAY, _ELEMENTS, None]
    used = [n for n in range(4) if sizes[n]]
    views = [
        {"buffer": 0, "byteOffset": starts[n], "byteLength": sizes[n], **({"target": kinds[n]} if kinds[n] else {})}
        for n in used
    ]
    vertices = sizes[0] // _POSITION
    accessors: List[Dict[str, object]] = [
        {"bufferView": 0, "componentType": _FLOAT, "count": vertices, "type": "VEC3", "min": ends[0], "max": ends[1]}
    ]
    attributes = {"POSITION": 0}
    matt: Dict[str, object] = {"metallicFactor": 0, "roughnessFactor": 1}
    document: Dict[str, object] = {"asset": {"version": "2.0", "generator": "REPM", "extras": extras}}
    if sizes[3]:
        accessors.append({"bufferView": 1, "componentType": _FLOAT, "count": vertices, "type": "VEC2"})
        attributes["TEXCOORD_0"] = 1
        matt["baseColorTexture"] = {"index": 0}
        document.update(textures=[{"source": 0, "sampler": 0}], samplers=[{"wrapS": 33071, "wrapT": 33071}])
        document["images"] = [{"bufferView": used.index(3), "mimeType": "image/jpeg"}]
    primitive: Dict[str, object] = {"attributes": attributes, "material": 0}
    if sizes[2]:
        view, count = used.index(2), sizes[2] // 4
        accessors.append({"bufferView": view, "componentType": _UINT, "count": count, "type": "SCALAR"})
        primitive["indices"] = len(accessors) - 1
    else:
        primitive["mode"] = 0  # cells without neighbours are points
    document.update(
        scene=0,
        scenes=[{"nodes": [0]}],
        nodes=[{"mesh": 0, "name": "DSM"}],
        meshes=[{"primitives": [primitive]}],
        materials=[{"doubleSided": True, "pbrMetallicRoughness": matt}],
        accessors=accessors,
        bufferViews=views,
        buffers=[{"byteLength": sum(sizes)}],
    )
    return _padded(json.dumps(document).encode("ascii"), b" ")


def _extras(surface: Surface, origin: FloatArray) -> Dict[str, object]:
    heights = surface.dataset.GetMetadataItem(TAG) or ELLIPSOID
    return {
        "origin": [float(value) for value in origin],
        "crs": surface.dataset.GetProjection(),
        "heights": f"metres above the {heights}",
        "axes": "x to the east, y up, z to the south, in metres from the origin",
    }


def _even(size: int) -> int:
    """Chunks are whole words of four bytes."""
    return -(-size // 4) * 4


def _padded(data: bytes, by: bytes) -> bytes:
    return data + by * (_even(len(data)) - len(data))
