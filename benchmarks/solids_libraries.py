"""What open3d makes of clouds and meshes, and what it and trimesh read: run by REPM_SOLIDS_PYTHON, prints JSON.

``read FILE``; ``distance MESH TRUTH``; ``simplify MESH TRUTH TRIANGLES``; ``poisson CLOUD TRUTH``; ``pivoting CLOUD
TRUTH``. TRUTH is an npz of points (N, 3) by names, and their ``origin``, because open3d casts rays in single precision.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any, Dict

import numpy as np
import open3d
import trimesh

_DEPTH, _THIN = 9, 0.02  # of Poisson's octree, and the share of its vertices of least density, which hang in the air
_RADII = (1.0, 2.0, 4.0)  # of the pivoting balls, in distances between points


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


def main() -> None:
    start = time.process_time()
    found = globals()[sys.argv[1]](*sys.argv[2:])
    # The peak of getrusage would begin with the memory of the process that started this one.
    with open("/proc/self/status", encoding="utf-8") as status:
        peak = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
    print(json.dumps({**found, "cpu_s": time.process_time() - start, "mib": peak / 1024}))


if __name__ == "__main__":
    main()
