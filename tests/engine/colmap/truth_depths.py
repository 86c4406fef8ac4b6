"""The depths that a view of a truth scene really has: its rays followed down to the known surface, by its true RPC."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from repm_qgis.colmap.projective_frame import tile_frame
from repm_qgis.geometry.frames import EnuFrame, geodetic_from_projected, projected_from_geodetic
from repm_qgis.imagery.sampling import sample
from repm_qgis.scene import Scene
from repm_qgis.stereo.parameters import STEREO
from repm_qgis.stereo.triangulation import NodeTable, nodes


def true_scene(truth):
    """A scene whose views know where they look, and the altitudes of its surface."""
    low, high = truth.height_range
    x0, y0, x1, y1 = truth.bounds
    lon, lat = geodetic_from_projected(truth.crs, np.array([(x0 + x1) / 2, (y0 + y1) / 2]))
    altitudes = (float(low) - 5.0, float(high) + 5.0)
    return Scene(truth.true_views, EnuFrame(float(lon), float(lat)), truth.crs, "", altitudes, [], "polynomial")


def middle(truth, half):
    """A rectangle of the truth's middle."""
    x0, y0, x1, y1 = truth.bounds
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - half, y - half, x + half, y + half


def true_frame(truth, half):
    scene = true_scene(truth)
    names = [view.name for view in scene.views]
    return scene, tile_frame(
        scene, names, middle(truth, half), scene.altitudes, stereo=replace(STEREO, tile_margin_px=16)
    )


def surface_at(truth, x, y):
    """Heights of the true DSM, bilinear between its cells; NaN outside."""
    x0, cell, _, y1, _, _ = truth.transform
    return sample(truth.surface, (x - x0) / cell - 0.5, (y1 - y) / cell - 0.5)


def true_heights(scene, tile, view, truth, step=0.5):
    """(H, W) height where each pixel's ray first meets the surface, from above; NaN where it never does."""
    columns, rows = (nodes(n, STEREO.node_step_px) for n in view.size)
    levels = np.linspace(*tile.altitudes, 5)
    z, r, c = np.meshgrid(levels, rows, columns, indexing="ij")
    ground = view.view.localise(view.to_original(np.stack([c, r], axis=-1)), z)
    xy = projected_from_geodetic(scene.crs, ground)
    tables = [NodeTable.fit(columns, rows, z, xy[..., i])[0] for i in (0, 1)]
    across, down = (np.arange(n, dtype=np.float64) for n in view.size)

    def clearance(height):
        x, y = (table.on_grid(across, down, height) for table in tables)
        return height - surface_at(truth, x, y)

    height = np.full(view.size[::-1], np.nan)
    above = np.full(view.size[::-1], tile.altitudes[1])
    free = clearance(above)
    for level in np.arange(tile.altitudes[1] - step, tile.altitudes[0], -step):
        now = clearance(np.full(view.size[::-1], level))
        hit = np.isnan(height) & (now <= 0) & (free > 0)
        height[hit] = level + step * now[hit] / (now[hit] - free[hit])
        free = now
    # Regula falsi between the two levels has left millimetres on slopes, and steps at walls; both are as they should.
    return height


def depths_of(scene, tile, view, heights):
    """(H, W) float32 depths of heights, 0 where there is none: by the RPC to the ground, and through T."""
    rows, columns = np.indices(heights.shape)
    known = np.isfinite(heights)
    pixels = np.column_stack([columns[known], rows[known]]).astype(np.float64)
    ground = view.view.localise(view.to_original(pixels), heights[known])
    depth = np.zeros(heights.shape, dtype=np.float32)
    depth[known] = view.camera.depth(tile.frame.from_enu(scene.frame.from_geodetic(ground)))
    return depth


def calm_at(truth, x, y, metres, cells=13):
    """Whether the surface around places rises and falls by less than so many metres: no wall is near."""
    x0, cell, _, y1, _, _ = truth.transform
    square = np.ones((cells, cells), dtype=np.uint8)
    spread = cv2.dilate(truth.surface, square) - cv2.erode(truth.surface, square)
    with np.errstate(invalid="ignore"):
        return sample(spread, (x - x0) / cell - 0.5, (y1 - y) / cell - 0.5) < metres
