"""Buildings as CityJSON 2.0 (Ledoux et al. 2019, Open Geospat. Data, Softw. Stand. 4; cityjson.org/specs)."""

from __future__ import annotations

import json
import math
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
import pyproj

from ..contracts.documents import JsonObject
from ..geometry.vertical import HeightDatum
from ..runtime.workspace import write_text
from .building import Building
from .roofs import Plane
from .solids import ROOF, Corner, Face

_SCALE = 0.001  # m: corners are whole numbers of it
_CRS = "https://www.opengis.net/def/crs/EPSG/0/"
BLOCK_LOD, ROOFED_LOD = "1.2", "2.2"
"""Levels of detail (Biljecki et al. 2016): one height for each footprint; roofs by their planes."""


class _Corners:
    """The corners of all solids, each once, as whole numbers from an origin."""

    def __init__(self, origin: Corner) -> None:
        self.origin, self._numbers = origin, {}  # type: Corner, Dict[Tuple[int, int, int], int]

    def number(self, corner: Corner) -> int:
        x, y, z = (round((value - start) / _SCALE) for value, start in zip(corner, self.origin))
        return self._numbers.setdefault((x, y, z), len(self._numbers))

    @property
    def values(self) -> List[List[int]]:
        return [list(corner) for corner in self._numbers]


def write_cityjson(
    path: str, buildings: Sequence[Building], crs: pyproj.CRS, datum: Optional[HeightDatum], title: str
) -> str:
    """Write buildings in a projected CRS with heights of ``datum``; valid without any. Raises WorkspaceError."""
    return write_text(path, json.dumps(city(buildings, crs, datum, title), separators=(",", ":")))


def city(buildings: Sequence[Building], crs: pyproj.CRS, datum: Optional[HeightDatum], title: str) -> JsonObject:
    """The CityJSON object."""
    corners = _Corners(_origin(buildings))
    objects = {f"building-{each.number}": _object(each, corners, datum) for each in buildings}
    metadata: JsonObject = {"title": title}
    code = _code(crs, datum)
    if code:
        metadata["referenceSystem"] = f"{_CRS}{code}"
    values = corners.values
    if values:
        low, high = np.min(values, axis=0), np.max(values, axis=0)
        ends = [
            round(start + _SCALE * float(value), 3)
            for each in (low, high)
            for start, value in zip(corners.origin, each)
        ]
        metadata["geographicalExtent"] = ends
    return {
        "type": "CityJSON",
        "version": "2.0",
        "transform": {"scale": [_SCALE] * 3, "translate": list(corners.origin)},
        "metadata": metadata,
        "CityObjects": objects,
        "vertices": values,
    }


def _origin(buildings: Sequence[Building]) -> Corner:
    """The lowest whole metres of all solids."""
    corners = [corner for each in buildings for face in each.block for corner in face.rings[0]]
    if not corners:
        return 0.0, 0.0, 0.0
    x, y, z = (float(math.floor(value)) for value in np.min(corners, axis=0))
    return x, y, z


def _code(crs: pyproj.CRS, datum: Optional[HeightDatum]) -> Optional[int]:
    """EPSG's code of the CRS with its heights, or, where there is none, of the CRS alone; None where it has none."""
    if datum is not None and datum.code:
        compound = pyproj.CRS(datum.file_crs(crs.to_wkt("WKT2_2019")))
        code = compound.to_epsg()
        if code:
            return int(code)
    code = crs.to_epsg()
    return int(code) if code else None


def _object(building: Building, corners: _Corners, datum: Optional[HeightDatum]) -> JsonObject:
    solids = [(BLOCK_LOD, building.block), (ROOFED_LOD, building.roofed)]
    return {
        "type": "Building",
        "attributes": {**attributes(building), "heights_above": datum.name if datum else None},
        "geometry": [_solid(lod, faces, building.planes, corners) for lod, faces in solids if faces],
    }


def attributes(building: Building) -> JsonObject:
    """What is known of a building, with names of fields."""
    heights = building.heights
    figures = {
        "ground_m": heights.ground,
        "eave_m": heights.eave,
        "median_m": heights.median,
        "ridge_m": heights.ridge,
        "height_m": heights.tall,
        "error_m": heights.error,
        "residual_m": heights.residual,
        "area_m2": building.area,
        "volume_m3": building.volume,
        "measured": heights.measured,
        "gaps": heights.gaps,
    }
    return {
        **{name: round(float(value), 3) for name, value in figures.items()},
        "roof": building.kind,
        "planes": len(building.planes),
        "lod": building.lod,
    }


def _solid(lod: str, faces: Sequence[Face], planes: Sequence[Plane], corners: _Corners) -> JsonObject:
    surfaces: List[JsonObject] = []
    places: Dict[Tuple[str, int], int] = {}
    values = []
    for face in faces:
        key = face.kind, face.plane if lod == ROOFED_LOD else -1
        if key not in places:
            places[key] = len(surfaces)
            surface: JsonObject = {"type": face.kind}
            if face.kind == ROOF and lod == ROOFED_LOD:
                plane = planes[face.plane]
                surface["slope_deg"] = round(plane.slope_deg, 1)
                surface["faces_deg"] = round(plane.faces_deg, 1)
            surfaces.append(surface)
        values.append(places[key])
    shell = [[[corners.number(corner) for corner in ring] for ring in face.rings] for face in faces]
    return {
        "type": "Solid",
        "lod": lod,
        "boundaries": [shell],
        "semantics": {"surfaces": surfaces, "values": [values]},
    }
