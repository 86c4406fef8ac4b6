"""Gridding alone: points of a true surface in, as an image's pixels lie on the ground, a DSM out."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.evaluation.coregistration import align
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.gridding import grid_points
from repm_qgis.imagery.sampling import sample

GSD = 0.5


def surface_of(path):
    dataset = gdal.Open(str(path))
    values = dataset.ReadAsArray().astype(np.float64)
    values[values < -9000] = np.nan
    return values, dataset.GetGeoTransform()


def pixels_on_the_ground(transform, shape, turn=0.21, phase=0.37):
    """Places at the images' spacing on a lattice that is turned against the cells, as scans are."""
    width, height = shape[1] * transform[1], shape[0] * -transform[5]
    reach = np.hypot(width, height) / 2
    u, v = np.meshgrid(*(np.arange(-reach, reach, GSD) + phase,) * 2)
    x = transform[0] + width / 2 + u * np.cos(turn) - v * np.sin(turn)
    y = transform[3] - height / 2 + u * np.sin(turn) + v * np.cos(turn)
    inside = (np.abs(x - transform[0] - width / 2) < width / 2) & (np.abs(y - transform[3] + height / 2) < height / 2)
    return x[inside], y[inside]


def gridded(path, cell):
    """DSM of true points, and the true surface averaged over the same cells."""
    truth, transform = surface_of(path)
    x, y = pixels_on_the_ground(transform, truth.shape)

    def at(px, py):
        return sample(truth, (px - transform[0]) / transform[1] - 0.5, (py - transform[3]) / transform[5] - 0.5)

    height = at(x, y)
    known = np.isfinite(height)
    grid = CellGrid.covering(
        (
            transform[0],
            transform[3] + truth.shape[0] * transform[5],
            transform[0] + truth.shape[1] * transform[1],
            transform[3],
        ),
        cell,
    )
    dsm = grid_points(grid, x[known], y[known], height=height[known], score=np.ones(known.sum()), spacing=GSD)[0]
    xs, ys = grid.centres()
    offsets = (np.arange(5) - 2) / 5 * cell
    mean = np.mean([at(*np.meshgrid(xs + dx, ys + dy)) for dx in offsets for dy in offsets], axis=0)
    return dsm, mean


def measured(dsm, truth, cell):
    error = (dsm - truth)[np.isfinite(dsm) & np.isfinite(truth)]
    shift = align("3d", [(dsm.astype(np.float32), truth.astype(np.float32))], (cell, cell))
    return (
        1.4826 * np.median(np.abs(error - np.median(error))),
        np.hypot(shift.dx, shift.dy) / cell,
        abs(np.median(error)),
        np.isfinite(dsm[np.isfinite(truth)]).mean(),
    )


@pytest.mark.parametrize("cell", (0.5, 1.0))
@pytest.mark.parametrize("scene", ("truth_urban", "urban", "mountains"))
@pytest.mark.slow
def test_true_points_make_the_true_surface(request, capsys, scene, cell):
    if scene == "truth_urban":
        path = request.getfixturevalue("shared_data") / "truth_urban" / "truth.tif"
    else:
        path = request.getfixturevalue(scene).truth
    dsm, truth = gridded(path, cell)
    nmad, shift, bias, valid = measured(dsm, truth, cell)
    with capsys.disabled():
        print(f"\n{scene} at {cell:g} m: NMAD {nmad:.4f} m, shift {shift:.4f} cells, bias {bias:.4f} m")
    assert nmad < 0.05 and shift < 0.02 and bias < 0.02 and valid > 0.99
