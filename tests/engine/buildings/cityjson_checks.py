"""What any CityJSON 2.0 file of solids must be, checked from the file alone and by nothing of the engine.

The structure is that of https://www.cityjson.org/specs/2.0.1/, the geometry that of ISO 19107 as val3dity asks for it:
closed shells, every edge twice and in opposite directions, faces that are flat, valid polygons and look outward.
"""

from __future__ import annotations

import json
import re
from collections import Counter

import numpy as np
from osgeo import ogr

SURFACES = {"GroundSurface", "WallSurface", "RoofSurface"}


def checked(path, flat_m=0.01):
    """The city of a file, and for each building its solids by LoD as lists of (kind, rings of (N, 3) corners in m)."""
    with open(path, encoding="utf-8") as stream:
        city = json.load(stream)
    assert city["type"] == "CityJSON" and city["version"] == "2.0"
    assert {"transform", "CityObjects", "vertices"} <= set(city)
    scale, start = np.array(city["transform"]["scale"]), np.array(city["transform"]["translate"])
    assert scale.shape == start.shape == (3,) and (scale > 0).all()
    system = city.get("metadata", {}).get("referenceSystem")
    assert system is None or re.fullmatch(r"https://www\.opengis\.net/def/crs/[A-Z]+/[0-9.]+/\w+", system)
    assert all(len(corner) == 3 and all(type(value) is int for value in corner) for corner in city["vertices"])
    assert len(set(map(tuple, city["vertices"]))) == len(city["vertices"])
    corners = np.array(city["vertices"]).reshape(-1, 3) * scale + start
    used, found = set(), {}
    for name, each in city["CityObjects"].items():
        assert each["type"] == "Building" and isinstance(each["attributes"], dict)
        found[name] = {solid["lod"]: _solid(solid, corners, used, flat_m) for solid in each["geometry"]}
    assert used == set(range(len(corners))), "no corner is left over"
    if len(corners):
        extent = city["metadata"]["geographicalExtent"]
        assert np.allclose(extent, [*corners.min(axis=0), *corners.max(axis=0)], atol=0.0015)
    return city, found


def _solid(solid, corners, used, flat_m):
    assert solid["type"] == "Solid" and isinstance(solid["lod"], str) and len(solid["boundaries"]) == 1
    shell, (values,) = solid["boundaries"][0], solid["semantics"]["values"]
    kinds = [surface["type"] for surface in solid["semantics"]["surfaces"]]
    assert len(values) == len(shell) and set(kinds) <= SURFACES
    edges, faces = Counter(), []
    for face, value in zip(shell, values):
        for ring in face:
            assert len(ring) >= 3 and len(set(ring)) == len(ring), "a ring visits no corner twice"
            edges.update(zip(ring, [*ring[1:], ring[0]]))
            used.update(ring)
        faces.append((kinds[value], [corners[ring] for ring in face]))
    assert set(edges.values()) == {1}, "no edge twice in one direction"
    assert all((b, a) in edges for a, b in edges), "each edge in both directions"
    for kind, rings in faces:
        _face(kind, rings, flat_m)
    assert volume(faces) > 0, "faces look outward"
    return faces


def _face(kind, rings, flat_m):
    normal = vector_area(rings[0])
    size = np.linalg.norm(normal)
    assert size > 1e-6
    away = (np.concatenate(rings) - rings[0].mean(axis=0)) @ (normal / size)
    assert np.abs(away).max() <= flat_m, (kind, np.abs(away).max())
    up = normal[2] / size
    assert up > 0.1 if kind == "RoofSurface" else up < -0.999 if kind == "GroundSurface" else abs(up) < 1e-3
    assert all(vector_area(hole) @ normal < 0 for hole in rings[1:])
    assert _on_its_plane(rings, normal / size).IsValid(), "rings cross neither themselves nor each other"


def _on_its_plane(rings, normal):
    """A face as a polygon of two coordinates: GEOS judges it by the OGC's rules, as val3dity does (its codes 2xx)."""
    east = np.cross([0.0, 0.0, 1.0], normal) if abs(normal[2]) < 0.9 else np.cross([0.0, 1.0, 0.0], normal)
    axes = np.array([east / np.linalg.norm(east), np.cross(normal, east / np.linalg.norm(east))])
    made = ogr.Geometry(ogr.wkbPolygon)
    for ring in rings:
        line = ogr.Geometry(ogr.wkbLinearRing)
        for x, y in (ring - rings[0][0])[[*range(len(ring)), 0]] @ axes.T:
            line.AddPoint_2D(float(x), float(y))
        made.AddGeometry(line)
    return made


def vector_area(ring):
    """(3,) the area of a ring, in the direction from which it runs counterclockwise."""
    moved = ring - ring[0]
    return sum(np.cross(a, b) for a, b in zip(moved, np.roll(moved, -1, axis=0))) / 2


def volume(faces):
    """m3, by Gauss' theorem for the field (0, 0, z): the integral of z over each face's area seen from above."""
    low = min(ring[:, 2].min() for _, rings in faces for ring in rings)
    total = 0.0
    for _, rings in faces:
        for ring in rings:
            moved = ring - np.array([*rings[0][0, :2], low])
            for b, c in zip(moved[1:-1], moved[2:]):
                area = ((b - moved[0])[0] * (c - moved[0])[1] - (b - moved[0])[1] * (c - moved[0])[0]) / 2
                total += area * (moved[0, 2] + b[2] + c[2]) / 3
    return float(total)
