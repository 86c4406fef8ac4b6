"""Tiles cover the area and nothing twice; windows hold what the RPC sees of a tile."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import ogr

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.geometry.footprints import box, geometry_of
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.geometry.tiles import enclosing, largest_within, lay_tiles, pixel_window

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
            view.project,
            lambda xy: geodetic_from_projected(urban.crs, xy),
            bounds,
            altitudes=(low, high),
            size=view.size,
        )
        pixels = view.project(np.column_stack([geodetic_from_projected(urban.crs, points[:, :2]), points[:, 2]]))
        inside = ((pixels >= 0) & (pixels <= np.array(view.size) - 1)).all(axis=1)
        offset = pixels[inside] - window[:2]
        assert (offset >= 0).all() and (offset <= np.array(window[2:]) - 1).all()
        # And it is hardly larger than it must be: random points miss the corners by some px.
        assert (np.array(window[2:]) <= np.ptp(pixels, axis=0) + 30).all()
        grown = pixel_window(
            view.project,
            lambda xy: geodetic_from_projected(urban.crs, xy),
            bounds,
            altitudes=(low, high),
            size=view.size,
            margin=10,
        )
        assert grown[0] == max(window[0] - 10, 0) and grown[2] >= window[2]


def test_what_the_image_does_not_see_has_no_window(urban):
    view = urban.views[0]
    x0, y0, x1, y1 = urban.bounds

    def window(bounds):
        return pixel_window(
            view.project,
            lambda xy: geodetic_from_projected(urban.crs, xy),
            bounds,
            altitudes=urban.height_range,
            size=view.size,
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


def test_tiles_are_equal_and_begin_at_whole_metres_in_the_north_west():
    tiles = lay_tiles(box((99.4, 200.6, 1299.2, 900.3)), 500.0)
    # 1199.8 m need three columns, 699.7 m two rows: from 99 and 901, of ceil(1200.2 / 3) by ceil(700.4 / 2) m.
    assert [tile.id for tile in tiles] == [f"r{i:03d}c{j:03d}" for i in range(2) for j in range(3)]
    assert [tile.bounds for tile in tiles] == [
        (99.0 + 401 * j, 901.0 - 351 * (i + 1), 99.0 + 401 * (j + 1), 901.0 - 351 * i)
        for i in range(2)
        for j in range(3)
    ]
    side = 33.3 + 33.3 + 33.3 + 33.3 + 33.3 + 33.3  # a little more than 6 * 33.3, which sum() gives from Python 3.12 on
    assert side / 33.3 > 6 and [tile.id for tile in lay_tiles(box((0.0, 0.0, side, side)), 33.3)][-1] == "r005c005"


def test_tiles_outside_the_area_are_omitted():
    corner = geometry_of(np.array([[0.0, 0.0], [1000.0, 0.0], [0.0, 900.0]]))
    assert [tile.id for tile in lay_tiles(corner, 400.0)] == [
        "r000c000", "r001c000", "r001c001", "r002c000", "r002c001", "r002c002",
    ]  # fmt: skip


@pytest.mark.parametrize("size", (400.0, 10000.0))
def test_a_small_area_is_one_tile(size):
    (tile,) = lay_tiles(box((10.5, 20.5, 390.0, 110.0)), size)
    assert tile.id == "r000c000" and tile.bounds == (10.0, 20.0, 390.0, 110.0)


def test_the_rectangle_around_rectangles():
    boxes = [Bounds(0.0, 5.0, 4.0, 9.0), Bounds(-2.0, 6.0, 1.0, 7.0), Bounds(1.0, 4.0, 8.0, 5.0)]
    assert enclosing(boxes) == Bounds(-2.0, 4.0, 8.0, 9.0) and enclosing(boxes[:1]) == boxes[0]


@pytest.mark.parametrize(
    "bounds, margin, window",
    (
        ((100.2, 100.7, 180.4, 190.1), 0, (100, 109, 84, 92)),  # columns 100.2 to 182.4, rows 109.9 to 199.3
        ((100.2, 100.7, 180.4, 190.1), 5, (95, 104, 94, 102)),
        ((-50.0, 100.7, 60.4, 190.1), 0, (0, 109, 64, 92)),  # cut at the left border,
        ((350.0, 100.7, 500.0, 190.1), 0, (350, 109, 50, 92)),  # at the right one,
        ((100.2, 250.0, 180.4, 400.0), 0, (100, 0, 84, 51)),  # at the top
        ((100.2, -100.0, 180.4, 52.0), 3, (97, 245, 90, 55)),  # and at the bottom
        ((100.0, 100.0, 145.0, 190.0), 0, (100, 110, 48, 91)),  # as small as it may be,
        ((100.0, 100.0, 144.9, 190.0), 0, (100, 110, 48, 91)),
        ((100.0, 100.0, 143.9, 190.0), 0, None),  # and smaller
        ((100.0, 100.0, 200.0, 144.0), 0, None),
        ((410.0, 100.0, 500.0, 190.0), 0, None),
    ),
)
def test_a_window_reaches_from_the_first_pixel_to_the_last_at_all_altitudes(bounds, margin, window):
    """An image of 400 x 300 px with pixels of 1 m, whose columns grow by 0.01 px for each metre of altitude."""

    def project(points):
        assert points.shape == (25, 3)
        return np.column_stack([points[:, 0] + 0.01 * points[:, 2], 300.0 - points[:, 1]])

    found = pixel_window(project, lambda xy: xy, bounds, altitudes=(0.0, 200.0), size=(400, 300), margin=margin)
    assert found == window


def test_a_window_that_the_model_cannot_place_is_none():
    def project(points):
        return np.where(points[:, :1] > 140, np.nan, points[:, :2])

    assert pixel_window(project, lambda xy: xy, (0.0, 0.0, 150.0, 150.0), altitudes=(0.0, 1.0), size=(400, 300)) is None
    assert pixel_window(project, lambda xy: xy, (0.0, 0.0, 139.0, 150.0), altitudes=(0.0, 1.0), size=(400, 300)) == (
        0,
        0,
        140,
        151,
    )
