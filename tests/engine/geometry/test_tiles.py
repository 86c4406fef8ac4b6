"""Tiles cover the area and nothing twice; windows hold what the RPC sees of a tile."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import ogr

from repm_qgis.geometry.footprints import box, geometry_of
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.geometry.tiles import largest_within, lay_tiles, pixel_window

AREAS = {
    "square": box((500000.0, 4800000.0, 501000.0, 4801000.0)),
    "broken metres": box((500000.9, 4800000.1, 500840.9, 4800700.9)),
    "thin": box((500000.5, 4800000.0, 503000.2, 4800040.0)),
    "slanted": geometry_of(
        np.array([[500100.3, 4800000.2], [501500.7, 4800300.9], [501200.4, 4801400.6], [499800.1, 4801100.3]])
    ),
    "tiny": box((500000.4, 4800000.4, 500000.6, 4800000.6)),
}


@pytest.mark.parametrize("name", AREAS)
@pytest.mark.parametrize("size", (128.0, 333.3, 800.0))
def test_tiles_cover_the_area_without_overlap(name, size):
    area = AREAS[name]
    tiles = lay_tiles(area, size)
    union, total = ogr.Geometry(ogr.wkbPolygon), 0.0
    for tile in tiles:
        shape = box(tile.bounds)
        union, total = union.Union(shape), total + shape.GetArea()
        width, height = tile.bounds[2] - tile.bounds[0], tile.bounds[3] - tile.bounds[1]
        assert width <= size + 1.0 and height <= size + 1.0
        assert all(value == int(value) for value in tile.bounds)
        assert shape.Intersects(area)
    assert area.Difference(union).GetArea() < 1e-6 * area.GetArea()
    assert total == pytest.approx(union.GetArea(), rel=1e-9)
    assert len({tile.id for tile in tiles}) == len(tiles)


def test_rows_count_from_the_north_and_columns_from_the_west():
    tiles = {tile.id: tile.bounds for tile in lay_tiles(AREAS["square"], 500.0)}
    assert tiles["r000c000"] == (500000.0, 4800500.0, 500500.0, 4801000.0)
    assert tiles["r001c001"] == (500500.0, 4800000.0, 501000.0, 4800500.0)


def test_a_window_holds_every_point_of_its_tile(urban):
    low, high = urban.height_range
    x0, y0, _, _ = urban.bounds
    bounds = (x0 + 30, y0 + 30, x0 + 90, y0 + 80)
    points = np.random.default_rng(3).uniform((bounds[0], bounds[1], low), (bounds[2], bounds[3], high), (3000, 3))
    for view in urban.views:
        window = pixel_window(
            view.project, lambda xy: geodetic_from_projected(urban.crs, xy), bounds, (low, high), view.size
        )
        pixels = view.project(np.column_stack([geodetic_from_projected(urban.crs, points[:, :2]), points[:, 2]]))
        inside = ((pixels >= 0) & (pixels <= np.array(view.size) - 1)).all(axis=1)
        offset = pixels[inside] - window[:2]
        assert (offset >= 0).all() and (offset <= np.array(window[2:]) - 1).all()
        # And it is hardly larger than it must be: random points miss the corners by some px.
        assert (np.array(window[2:]) <= np.ptp(pixels, axis=0) + 30).all()
        grown = pixel_window(
            view.project, lambda xy: geodetic_from_projected(urban.crs, xy), bounds, (low, high), view.size, margin=10
        )
        assert grown[0] == max(window[0] - 10, 0) and grown[2] >= window[2]


def test_what_the_image_does_not_see_has_no_window(urban):
    view = urban.views[0]
    x0, y0, x1, y1 = urban.bounds

    def window(bounds):
        return pixel_window(
            view.project, lambda xy: geodetic_from_projected(urban.crs, xy), bounds, urban.height_range, view.size
        )

    assert window((x1 + 5000, y0, x1 + 5100, y1)) is None
    assert (
        window((x0 + 50, y0 + 50, x0 + 51, y0 + 51)) is None
        or min(window((x0 + 50, y0 + 50, x0 + 51, y0 + 51))[2:]) >= 48
    )
    whole = window((x0 - 1000, y0 - 1000, x1 + 1000, y1 + 1000))
    assert whole == (0, 0, *view.size)


def test_the_largest_size_within_the_budget():
    asked = []

    def error_of(size):
        asked.append(size)
        return size / 1000.0

    assert largest_within(1.2, (1600, 1200, 800), error_of) == (1200, 1.2)
    assert asked == [1600, 1200]
    assert largest_within(0.1, (1600, 1200, 800), error_of) == (800, 0.8)
