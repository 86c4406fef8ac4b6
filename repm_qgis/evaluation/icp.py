"""Lay points onto points: the shift between two clouds by iterative closest points, point to plane.

Each point looks for the nearest point of the reference, and its distance from the plane there is made small (Chen and
Medioni 1991, Proc. IEEE Robotics and Automation, 2724-2729), with Tukey's weights, and within reaches that shrink. Only
places count that are flat and have the same orientation in both clouds: at edges the nearest point belongs to another
face, and in trees there is none. Neither surface is resampled, so a shift by a part of a cell changes nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Callable

import numpy as np

from ..contracts.arrays import FloatArray, Mask
from ..contracts.errors import INSTALL_REMEDY, EmptyResultError, MissingPackageError
from ..geometry.neighbours import principal_axes
from ..numerics.robust import nmad, tukey
from .parameters import COREGISTRATION, ICP, IcpParameters


def shift_onto(
    points: FloatArray,
    reference: FloatArray,
    start: FloatArray,
    check: Callable[[], None] = lambda: None,
    parameters: IcpParameters = ICP,
) -> FloatArray:
    """The shift (3,) to add to ``points`` (N, 3) so that they lie on ``reference`` (M, 3); all in metres.

    ``start`` (3,) must be right to within about four times the distance between points. ``check`` is called between
    steps, and may raise to stop. Raises EmptyResultError where there are too few points near each other, or where
    their slopes do not determine the shift, MissingPackageError without scipy.
    """
    middle = reference.mean(axis=0)
    mine = _Planes.of(_thinned(points - middle, parameters.points), parameters)
    theirs = _Planes.of(_thinned(reference - middle, parameters.reference_points), parameters)
    flat = mine.flat
    xyz, normal = mine.xyz[flat], mine.normal[flat]
    shift = np.array(start, dtype=np.float64)
    for reach in np.array(parameters.reaches) * max(mine.spacing, theirs.spacing):
        for _ in range(parameters.iterations):
            check()
            step = _step(xyz + shift, normal, theirs, float(reach), parameters)
            shift = shift + step
            if np.linalg.norm(step) < parameters.converged_m:
                break
    return shift


@dataclass(frozen=True)
class _Planes:
    """Points (N, 3) with their unit normals, which of them lie on a flat part, and the distance between points, m."""

    xyz: FloatArray
    normal: FloatArray
    flat: Mask
    spacing: float
    tree: Any

    @classmethod
    def of(cls, xyz: FloatArray, parameters: IcpParameters) -> _Planes:
        """By principal axes of each point's neighbours."""
        if len(xyz) < parameters.least_points:
            raise _too_few(len(xyz), parameters)
        tree = _tree(xyz)
        normal, rough, beside = np.empty(xyz.shape), np.empty(len(xyz)), np.empty(len(xyz))
        for part, away, values, axes in principal_axes(tree, parameters.neighbours, parameters.at_once):
            normal[part], rough[part], beside[part] = axes[:, :, 0], np.sqrt(np.maximum(values[:, 0], 0)), away[:, 4]
        flat = rough <= parameters.flat_medians * max(float(np.median(rough)), parameters.least_rough_m)
        return cls(xyz, normal, flat, float(np.median(beside)), tree)


def _step(xyz: FloatArray, normal: FloatArray, theirs: _Planes, reach: float, parameters: IcpParameters) -> FloatArray:
    """The shift (3,) of one step: robust least squares of the distances from the planes of the nearest points."""
    away, near = theirs.tree.query(xyz, distance_upper_bound=reach)
    found = np.flatnonzero(np.isfinite(away))
    near = near[found]
    alike = np.abs((normal[found] * theirs.normal[near]).sum(axis=1)) >= parameters.alike
    use = alike & theirs.flat[near]
    found, near = found[use], near[use]
    if len(found) < parameters.least_points:
        raise _too_few(len(found), parameters)
    design = theirs.normal[near]
    distance = ((xyz[found] - theirs.xyz[near]) * design).sum(axis=1)
    scale = max(nmad(distance), parameters.least_rough_m)
    weight = tukey(distance / (COREGISTRATION.tukey * scale))
    matrix = (design * weight[:, None]).T @ design
    least = float(np.linalg.eigvalsh(matrix)[0]) / max(float(weight.sum()), 1e-12)
    independent = max(len(found) / COREGISTRATION.independent, 1.0)
    if least < 1e-8 or scale / math.sqrt(least * independent) > COREGISTRATION.most_uncertain:
        raise EmptyResultError(
            "The flat parts of both surfaces have too similar orientations for ALIGN=icp, which needs slopes in all "
            "directions: set ALIGN to 3d or vertical, or compare over a larger area."
        )
    return np.linalg.solve(matrix, -(design * weight[:, None]).T @ distance)


def _thinned(xyz: FloatArray, most: int) -> FloatArray:
    """At most so many of the points, always the same ones."""
    if len(xyz) <= most:
        return xyz
    return xyz[np.sort(np.random.default_rng(0).choice(len(xyz), most, replace=False))]


def _tree(xyz: FloatArray) -> Any:
    try:
        from scipy.spatial import cKDTree
    except ImportError as error:
        raise MissingPackageError(
            f"ALIGN=icp needs the package 'scipy': {INSTALL_REMEDY}, or set ALIGN to 3d."
        ) from error
    return cKDTree(xyz)


def _too_few(count: int, parameters: IcpParameters) -> EmptyResultError:
    few = f"Points of the DSM near flat parts of the reference: {count}; ALIGN=icp needs"
    return EmptyResultError(f"{few} {parameters.least_points}: choose a larger area, or set ALIGN to 3d or none.")
