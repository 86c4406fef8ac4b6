"""Ground control points of the simulated town, as its true sensors see them."""

from __future__ import annotations

import csv

import numpy as np

from repm_qgis.geometry.frames import geodetic_from_projected

FIELDS = ("id", "lon", "lat", "height", "view", "col", "row", "role")


def ground_points(urban):
    """(12, 3) ground points on cells of the true surface: longitude, latitude, height."""
    numbers = np.random.default_rng(8)
    rows, cols = (numbers.integers(20, n - 20, 12) for n in urban.surface.shape)
    x, cell, _, y, _, _ = urban.transform
    xy = np.column_stack([x + (cols + 0.5) * cell, y - (rows + 0.5) * cell])
    return np.column_stack([geodetic_from_projected(urban.crs, xy), urban.surface[rows, cols]])


def write_gcps(
    path, urban, points, role=lambda k: "check" if k % 2 else "control", pixel=lambda k, name, p: p, views=3
):
    """A table of the points as the true sensors see them."""
    with open(path, "w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(FIELDS)
        for k, point in enumerate(points):
            for view in urban.true_views[:views] or [None]:
                seen = (
                    (view.name + ".tif", *map(repr, map(float, pixel(k, view.name, view.project(point)))))
                    if view
                    else ("", "", "")
                )
                table.writerow([f"P{k:02d}", *map(repr, map(float, point)), *seen, role(k)])
    return str(path)
