"""What open3d makes of clouds and meshes, and what it and trimesh read: run by REPM_SOLIDS_PYTHON, prints JSON.

``read FILE``; ``distance MESH TRUTH``; ``simplify MESH TRUTH TRIANGLES``; ``poisson CLOUD TRUTH``; ``pivoting CLOUD
TRUTH``. TRUTH is an npz of points (N, 3) by names, and their ``origin``, because open3d casts rays in single precision.
The parts that stand beside our own ones (beside_open3d.py) take one npz and write one: ``apart``, ``normals``,
``ransac``, ``patches``, ``icp``; ``shells CITY``; ``picture`` and ``version`` take nothing.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any, Callable, Dict

import numpy as np
import open3d
import trimesh

_DEPTH, _THIN = 9, 0.02  # of Poisson's octree, and the share of its vertices of least density, which hang in the air
_ROUNDED_M = 0.001  # of the corners in a CityJSON file
_RADII = (1.0, 2.0, 4.0)  # of the pivoting balls, in distances between points
_NEIGHBOURS = 16  # of a point whose normal is estimated, as our own parts have
_TRIES, _MOST_PLANES = 1000, 8  # planes that RANSAC tries for each one that it keeps, and how many a roof may have
_TUKEY_M, _STEPS = 0.5, 50  # of ICP: distances that count nothing, and steps within a reach


def read(path: str) -> Dict[str, object]:
    if path.endswith(".cloud.ply"):
        cloud = open3d.io.read_point_cloud(path)
        other = trimesh.load(path)
        parts = [len(cloud.points), len(other.vertices)]
        return {"counts": parts, "normals": cloud.has_normals(), "colours": cloud.has_colors()}
    mesh = open3d.io.read_triangle_mesh(path, True)
    other = trimesh.load(path, force="mesh", process=False)
    return {"counts": [len(mesh.triangles), len(other.faces)], "picture": mesh.has_textures()}


def _scores(mesh: Any, truth: str) -> Dict[str, object]:
    """Distances of the truth's points from a mesh: RMS (m), and the share within 0.5 m (%)."""
    points = np.load(truth)
    scene = open3d.t.geometry.RaycastingScene()
    moved = open3d.geometry.TriangleMesh(mesh).translate(-points["origin"])
    scene.add_triangles(open3d.t.geometry.TriangleMesh.from_legacy(moved))
    found: Dict[str, object] = {"triangles": len(mesh.triangles)}
    for name in points.files:
        if name != "origin":
            places = (points[name] - points["origin"]).astype(np.float32)
            away = scene.compute_distance(open3d.core.Tensor(places)).numpy()
            found[name] = [float(np.sqrt(np.mean(away**2))), 100.0 * float((away < 0.5).mean())]
    return found


def _cloud(path: str, truth: str) -> Any:
    """The part of a cloud around the truth's points."""
    points = np.load(truth)
    every = np.concatenate([points[name] for name in points.files if name != "origin"])
    low, high = every.min(axis=0) - 5, every.max(axis=0) + 5
    return open3d.io.read_point_cloud(path).crop(open3d.geometry.AxisAlignedBoundingBox(low, high))


def simplify(path: str, truth: str, triangles: str) -> Dict[str, object]:
    mesh = open3d.io.read_triangle_mesh(path)
    return _scores(mesh.simplify_quadric_decimation(int(triangles)), truth)


def distance(path: str, truth: str) -> Dict[str, object]:
    return _scores(open3d.io.read_triangle_mesh(path), truth)


def poisson(path: str, truth: str) -> Dict[str, object]:
    cloud = _cloud(path, truth)
    mesh, density = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=_DEPTH, n_threads=1)
    mesh.remove_vertices_by_mask(np.asarray(density) < np.quantile(np.asarray(density), _THIN))
    return _scores(mesh, truth)


def pivoting(path: str, truth: str) -> Dict[str, object]:
    cloud = _cloud(path, truth)
    apart = float(np.median(np.asarray(cloud.compute_nearest_neighbor_distance())))
    radii = open3d.utility.DoubleVector([radius * max(apart, 0.25) for radius in _RADII])
    return _scores(open3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(cloud, radii), truth)


# Beside our own parts ---------------------------------------------------------------------------------------------


def apart(data: str, found: str) -> Dict[str, object]:
    """Signed distances of points (N, 3) from the mesh of a raster's cells: ``reference`` (rows, columns) heights, m,
    ``cell`` their side, m; x and y count from the first cell's middle, to the east and to the south."""
    given = np.load(data)
    heights, cell = given["reference"], float(given["cell"])
    rows, columns = heights.shape
    row, column = np.indices(heights.shape)
    corners = np.stack([column * cell, row * cell, heights], axis=-1).reshape(-1, 3).astype(np.float32)
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    beside, below = first + 1, first + columns
    triangles = np.concatenate(
        [np.stack(part, axis=1) for part in ((first, beside, below), (beside, below + 1, below))]
    )
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.core.Tensor(corners), open3d.core.Tensor(triangles.astype(np.uint32)))
    points = given["points"].astype(np.float32)
    nearest = scene.compute_closest_points(open3d.core.Tensor(points))
    away = points - nearest["points"].numpy()
    # compute_signed_distance counts the walls of a closed body, and a surface has no other side.
    upward = nearest["primitive_normals"].numpy()
    upward *= np.where(upward[:, 2:] < 0, -1.0, 1.0)
    np.savez(found, distances=np.linalg.norm(away, axis=1) * np.sign((away * upward).sum(axis=1)))
    return {}


def normals(data: str, found: str) -> Dict[str, object]:
    """Normals of the clouds ``xyz_0``, ``xyz_1`` ..., each turned to its ``camera_`` (3,) of the same number."""
    given = np.load(data)
    made = {}
    for number in range(len(given.files) // 2):
        cloud = _of(given[f"xyz_{number}"])
        cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(_NEIGHBOURS))
        cloud.orient_normals_towards_camera_location(given[f"camera_{number}"])
        made[f"normals_{number}"] = np.asarray(cloud.normals)
    np.savez(found, **made)
    return {}


def _of(points: np.ndarray) -> Any:
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))


def ransac(data: str, found: str) -> Dict[str, object]:
    """The planes of roofs, the one with the most points first: see ``_roofs``."""

    def planes(points: np.ndarray, tolerance: float, least: int) -> np.ndarray:
        numbers, left = np.full(len(points), -1), np.arange(len(points))
        open3d.utility.random.seed(0)
        for number in range(_MOST_PLANES):
            if len(left) < max(least, 3):
                break
            _, on = _of(points[left]).segment_plane(tolerance, 3, _TRIES)
            if len(on) < least:
                break
            numbers[left[on]] = number
            left = np.delete(left, on)
        return numbers

    return _roofs(data, found, planes)


def patches(data: str, found: str) -> Dict[str, object]:
    """The planar patches of roofs (Araujo and Oliveira 2020), with open3d's own settings: see ``_roofs``."""

    def planes(points: np.ndarray, tolerance: float, least: int) -> np.ndarray:
        numbers = np.full(len(points), -1)
        if len(points) < 3 * _NEIGHBOURS:
            return numbers
        cloud = _of(points)
        cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(_NEIGHBOURS))
        boxes = cloud.detect_planar_patches(
            min_num_points=least, search_param=open3d.geometry.KDTreeSearchParamKNN(_NEIGHBOURS)
        )
        for number, box in enumerate(sorted(boxes, key=lambda each: each.extent[0] * each.extent[1])):
            high = open3d.geometry.OrientedBoundingBox(box.center, box.R, [*box.extent[:2], 2 * tolerance])
            numbers[high.get_point_indices_within_bounding_box(cloud.points)] = number
        return numbers

    return _roofs(data, found, planes)


def _roofs(data: str, found: str, planes: Callable[[np.ndarray, float, int], np.ndarray]) -> Dict[str, object]:
    """For the ``points`` (N, 3) of roofs with the ``ends`` (n,) of each, the number of each point's plane on its roof,
    -1 for none; ``tolerance``, m, and ``least`` (n,) points of a plane."""
    given = np.load(data)
    parts = np.split(given["points"], given["ends"][:-1])
    numbers = [planes(part, float(given["tolerance"]), int(least)) for part, least in zip(parts, given["least"])]
    np.savez(found, numbers=np.concatenate(numbers))
    return {}


def icp(data: str, found: str) -> Dict[str, object]:
    """The shift (3,) of ``points`` onto a ``reference`` from a ``start``, within three ``reaches`` (m)."""
    given = np.load(data)
    middle = given["points"].mean(axis=0)
    moving, still = _of(given["points"] - middle), _of(given["reference"] - middle)
    still.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(_NEIGHBOURS))
    kind = open3d.pipelines.registration
    plane = kind.TransformationEstimationPointToPlane(kind.TukeyLoss(_TUKEY_M))
    place = np.eye(4)
    place[:3, 3] = given["start"]
    for reach in given["reaches"]:
        steps = kind.ICPConvergenceCriteria(max_iteration=_STEPS)
        place = kind.registration_icp(moving, still, float(reach), place, plane, steps).transformation
    np.savez(found, shift=place[:3, 3])
    return {}


def shells(path: str) -> Dict[str, object]:
    """How many solids a CityJSON file has, and of these how many are closed, and do not cut through themselves."""
    import mapbox_earcut  # which the other parts do without

    with open(path, encoding="utf-8") as stream:
        city = json.load(stream)
    corners = np.array(city["vertices"], np.float64) * city["transform"]["scale"]
    found: Dict[str, Any] = {"solids": 0, "closed": 0, "oriented": 0, "apart": 0}
    for each in city["CityObjects"].values():
        for solid in each["geometry"]:
            triangles = [
                _triangles(corners, face, mapbox_earcut.triangulate_float64) for face in solid["boundaries"][0]
            ]
            used, numbers = np.unique(np.concatenate(triangles), return_inverse=True)
            mesh = open3d.geometry.TriangleMesh(
                open3d.utility.Vector3dVector(corners[used] - corners[used].mean(axis=0)),
                open3d.utility.Vector3iVector(numbers.reshape(-1, 3)),
            )
            found["solids"] += 1
            found["closed"] += mesh.is_edge_manifold(allow_boundary_edges=False)
            found["oriented"] += mesh.is_orientable()
            corners_of = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
            # open3d also names triangles that only touch: a place is rounded to a millimetre, and lies beside a line.
            pairs = np.asarray(mesh.get_self_intersecting_triangles()).reshape(-1, 2)
            found["apart"] += all(_depth_m(corners_of[a], corners_of[b]) < _ROUNDED_M for a, b in pairs)
    return found


def _depth_m(first: np.ndarray, second: np.ndarray) -> float:
    """How far an edge of one triangle (3, 3) goes through the other one, and how far from that one's rim, m."""
    deepest = 0.0
    for edges, face in ((first, second), (second, first)):
        normal = np.cross(face[1] - face[0], face[2] - face[0])
        normal /= np.linalg.norm(normal) or 1.0
        for start, end in zip(edges, np.roll(edges, -1, axis=0)):
            above, below = (start - face[0]) @ normal, (end - face[0]) @ normal
            if above * below < 0:
                place = start + above / (above - below) * (end - start)
                sides = np.roll(face, -1, axis=0) - face
                inward = np.cross(normal, sides / np.linalg.norm(sides, axis=1, keepdims=True))
                rim = ((place - face) * inward).sum(axis=1).min()
                deepest = max(deepest, min(abs(above), abs(below), rim))
    return deepest


def _triangles(corners: np.ndarray, face: Any, divided: Callable[..., np.ndarray]) -> np.ndarray:
    """A flat face with holes as triangles of its own corners."""
    numbers = np.concatenate(face).astype(np.int64)
    places = corners[numbers] - corners[numbers[0]]
    ring = places[: len(face[0])]
    normal = np.abs(np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0))
    flat = np.delete(places, int(np.argmax(normal)), axis=1)  # seen along the axis that it is turned to the most
    return numbers[divided(np.ascontiguousarray(flat), np.cumsum([len(each) for each in face]).astype(np.uint32))]


def version() -> Dict[str, object]:
    return {"version": open3d.__version__}


def picture() -> Dict[str, object]:
    """Draw a sphere without a display."""
    renderer = open3d.visualization.rendering.OffscreenRenderer(640, 480)
    material = open3d.visualization.rendering.MaterialRecord()
    renderer.scene.add_geometry("sphere", open3d.geometry.TriangleMesh.create_sphere(), material)
    return {"size": np.asarray(renderer.render_to_image()).shape[:2]}


def main() -> None:
    start = time.process_time()
    found = globals()[sys.argv[1]](*sys.argv[2:])
    # The peak of getrusage would begin with the memory of the process that started this one.
    with open("/proc/self/status", encoding="utf-8") as status:
        peak = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
    print(json.dumps({**found, "cpu_s": time.process_time() - start, "mib": peak / 1024}))


if __name__ == "__main__":
    main()
