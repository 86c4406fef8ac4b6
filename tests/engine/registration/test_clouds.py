"""Point clouds as references: ground before all points, means over cells, units, datums, and what cannot be used."""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np
import pyproj
import pytest

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import Cancelled, ImageError, MissingPackageError, OverlapError
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.registration import clouds
from repm_qgis.registration.clouds import CellSums, opened_cloud, read_cloud
from repm_qgis.registration.parameters import REGISTRATION

laspy = pytest.importorskip("laspy", reason="the package laspy is not installed")

UTM = "EPSG:32631"
BOUNDS = Bounds(500_000.0, 4_000_000.0, 500_100.0, 4_000_060.0)


def plane(x, y):
    """Heights that rise by 0.3 to the east and fall by 0.1 to the north."""
    return 100.0 + 0.3 * (np.asarray(x) - 500_000.0) - 0.1 * (np.asarray(y) - 4_000_000.0)


def points(count=40_000, seed=1, margin=5.0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(BOUNDS.xmin - margin, BOUNDS.xmax + margin, count)
    y = rng.uniform(BOUNDS.ymin - margin, BOUNDS.ymax + margin, count)
    return x, y, plane(x, y)


def write(path, x, y, z, kind=2, crs=UTM, withheld=None, place_unit=1.0, height_unit=1.0, returns=None):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.0001), np.floor([x[0], y[0], 0.0])
    if crs:
        header.add_crs(pyproj.CRS.from_user_input(crs))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = np.asarray(x) / place_unit, np.asarray(y) / place_unit, np.asarray(z) / height_unit
    cloud.classification = np.broadcast_to(np.asarray(kind, dtype=np.uint8), len(x))
    if withheld is not None:
        cloud.withheld = withheld
    if returns is not None:
        cloud.return_number = returns
    cloud.write(str(path))
    return str(path)


def test_what_a_pulse_meets_first_is_its_first_return(tmp_path):
    x, y, z = points(400, margin=0.0)
    returns = np.arange(400) % 4  # 0: a file that does not count them
    path = write(tmp_path / "cloud.las", x, y, z, returns=returns)
    with opened_cloud(path) as cloud:
        (part,) = cloud.parts(UTM, BOUNDS)
    assert len(part.xyz) == 400
    np.testing.assert_array_equal(part.first, returns <= 1)


@pytest.mark.parametrize("name", ("cloud.las", "cloud.laz"))
def test_means_lie_on_the_ground_with_its_slopes(tmp_path, name):
    path = write(tmp_path / name, *points())
    found = read_cloud(path, UTM, BOUNDS, 2.0)
    assert len(found.height) == 50 * 30 and found.width_m == (2.0, 2.0) and not found.disc and found.datum is None
    np.testing.assert_allclose(found.height, plane(*found.xy.T), atol=1e-3)  # a mean at the mean place of its points
    known = np.isfinite(found.slopes).all(axis=1)
    assert known.sum() == 48 * 28
    np.testing.assert_allclose(found.slopes[known].mean(axis=0), [0.3, -0.1], atol=0.01)


def test_points_on_the_far_edges_belong_to_the_last_cells():
    """Of a grid of two rows and five columns, whose corner is in the north-west."""
    sums = CellSums(CellGrid(100.0, 50.0, 2.0, (2, 5)))
    sums.add(np.array([[110.0, 46.0, 7.0], [100.0, 46.0, 3.0], [110.0, 50.0, 5.0], [104.5, 48.5, 1.0]]))
    wanted = np.full((2, 5), np.nan)
    wanted[1, 4], wanted[1, 0], wanted[0, 4], wanted[0, 2] = 7.0, 3.0, 5.0, 1.0
    np.testing.assert_array_equal(sums.means(), wanted)
    assert np.isnan(sums.means(2)).all()


def test_what_a_cloud_and_bounds_share_ends_a_margin_around_the_cloud(tmp_path):
    x, y, z = points(margin=0.0)
    path = write(tmp_path / "cloud.las", x, y, z)
    wide = Bounds(BOUNDS.xmin - 500.0, BOUNDS.ymin - 500.0, BOUNDS.xmax + 500.0, BOUNDS.ymax + 500.0)
    with opened_cloud(path) as cloud:
        common = cloud.common(UTM, wide)
        assert cloud.common(UTM, BOUNDS) == pytest.approx(tuple(BOUNDS))
    margin = clouds._MARGIN_M
    assert common == pytest.approx((x.min() - margin, y.min() - margin, x.max() + margin, y.max() + margin), abs=1e-3)


def test_ground_only_where_there_is_some(tmp_path):
    x, y, z = points()
    tree, noise, wrong = (np.arange(len(x)) % 10 == n for n in range(3))
    kind = np.where(tree, 5, np.where(noise, 7, 2))
    z = z + 15.0 * tree + 300.0 * noise - 200.0 * wrong
    path = write(tmp_path / "cloud.las", x, y, z, kind, withheld=wrong)
    found = read_cloud(path, UTM, BOUNDS, 2.0)
    np.testing.assert_allclose(found.height, plane(*found.xy.T), atol=1e-3)
    unclassified = write(tmp_path / "all.las", x, y, z, np.where(noise, 18, 1), withheld=wrong)
    above = read_cloud(unclassified, UTM, BOUNDS, 2.0)
    assert (above.height - plane(*above.xy.T)).mean() == pytest.approx(15.0 / 8, abs=0.1)


def test_cells_with_few_points_are_left_out(tmp_path):
    x, y, z = points(6000)
    path = write(tmp_path / "cloud.las", x, y, z)
    assert REGISTRATION.cloud_points == 4
    found = read_cloud(path, UTM, BOUNDS, 2.0)
    inside = (x >= BOUNDS.xmin) & (x <= BOUNDS.xmax) & (y >= BOUNDS.ymin) & (y <= BOUNDS.ymax)
    cells = np.unique(
        np.floor(x[inside] / 2).astype(int) * 10_000_000 + np.floor(y[inside] / 2).astype(int), return_counts=True
    )[1]
    assert len(found.height) == (cells >= 4).sum() < len(cells)


def test_a_sparse_cloud_gives_its_points(tmp_path):
    """Hardly a cell had four of 6700 points over all of a scene: "no heights over the scene"."""
    x, y, z = points(700, margin=0.0)
    found = read_cloud(write(tmp_path / "cloud.las", x, y, z), UTM, BOUNDS, 2.0)
    assert len(found.height) == 700 and found.width_m == (0.0, 0.0) and found.slopes is None
    np.testing.assert_allclose(found.height, plane(*found.xy.T), atol=1e-3)
    assert found.about.startswith("Single points, 700 of them")
    thinned = read_cloud(
        str(tmp_path / "cloud.las"), UTM, BOUNDS, 2.0, parameters=replace(REGISTRATION, cloud_single=300)
    )
    assert len(thinned.height) == 234


def test_large_scenes_have_larger_cells_and_chunks_make_no_difference(tmp_path, monkeypatch):
    path = write(tmp_path / "cloud.las", *points())
    whole = read_cloud(path, UTM, BOUNDS, 2.0)
    monkeypatch.setattr(clouds, "_POINTS", 7000)
    checks = []
    parts = read_cloud(path, UTM, BOUNDS, 2.0, lambda: checks.append(1))
    assert len(checks) == 6
    np.testing.assert_allclose(parts.height, whole.height, atol=1e-9)
    np.testing.assert_allclose(parts.xy, whole.xy, atol=1e-6)
    few = read_cloud(path, UTM, BOUNDS, 0.0, parameters=replace(REGISTRATION, cloud_cells=60))
    assert few.width_m == (10.0, 10.0) and len(few.height) == 60

    def stop():
        raise Cancelled

    with pytest.raises(Cancelled):
        read_cloud(path, UTM, BOUNDS, 2.0, stop)


def test_cells_are_those_of_the_cloud_in_a_large_scene(tmp_path):
    path = write(tmp_path / "cloud.las", *points())
    few = replace(REGISTRATION, cloud_cells=2000)  # of 2 m: the cloud has 1925 of them, the scene 40000
    found = read_cloud(path, UTM, BOUNDS.grown(150.0), 0.0, parameters=few)
    assert found.width_m[0] == pytest.approx(2.0, abs=0.1) and len(found.height) > 1800
    np.testing.assert_allclose(found.height, plane(*found.xy.T), atol=1e-3)


def test_another_crs_in_feet_with_a_datum(tmp_path):
    """As the clouds of the United States are: state plane and NAVD88, both in feet."""
    system = "EPSG:2260+6360"  # NAD83 / New York East (ftUS) + NAVD88 height (ftUS)
    foot = 1200 / 3937
    lon, lat = -74.5, 42.0
    forth = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:2260", always_xy=True)
    scene = pyproj.Transformer.from_crs("EPSG:2260", "EPSG:32618", always_xy=True)
    x0, y0 = forth.transform(lon, lat)
    rng = np.random.default_rng(3)
    x, y = x0 + rng.uniform(0, 1000, 30_000), y0 + rng.uniform(0, 1000, 30_000)
    path = write(tmp_path / "feet.las", x, y, np.full(30_000, 500.0), crs=system)
    at = np.array(scene.transform(x0 + 500, y0 + 500))
    found = read_cloud(path, "EPSG:32618", Bounds(*(at - 100), *(at + 100)), 5.0)
    np.testing.assert_allclose(found.height, 500.0 * foot, atol=1e-6)
    assert found.datum.code == "EPSG:6360" and len(found.height) > 1500
    silent = write(tmp_path / "silent.las", x, y, np.full(30_000, 500.0), crs="EPSG:2260")
    found = read_cloud(silent, "EPSG:32618", Bounds(*(at - 100), *(at + 100)), 5.0)
    assert found.places_in == "US survey foot" and found.height == pytest.approx(500.0) and found.datum is None


@pytest.mark.parametrize(
    "crs, datum", ((UTM + "+5773", ("EPSG:5773", "EGM96 height")), ("EPSG:32631+3855", ("EPSG:3855", "EGM2008 height")))
)
def test_a_vertical_part_is_the_datum(tmp_path, crs, datum):
    found = read_cloud(write(tmp_path / "cloud.las", *points(4000), crs=crs), UTM, BOUNDS, 5.0)
    assert (found.datum.code, found.datum.name) == datum


def test_what_cannot_be_used_is_a_sentence(tmp_path, monkeypatch):
    bare = write(tmp_path / "bare.las", *points(100), crs=None)
    with pytest.raises(ImageError, match=r"bare\.las' has no coordinate reference system: assign it one first"):
        read_cloud(bare, UTM, BOUNDS, 2.0)
    path = write(tmp_path / "cloud.laz", *points(4000))
    with pytest.raises(OverlapError, match="has no heights over the scene"):
        read_cloud(path, UTM, Bounds(600_000.0, 4_000_000.0, 600_100.0, 4_000_100.0), 2.0)
    with open(path, "r+b") as stream:
        stream.truncate(12_000)
    with pytest.raises(ImageError, match=r"Cannot read the point cloud '.*cloud\.laz' .*: get it again"):
        read_cloud(path, UTM, BOUNDS, 2.0)
    (tmp_path / "text.las").write_text("not a cloud")
    for name in ("text.las", "missing.las"):
        with pytest.raises(ImageError, match="Cannot read the point cloud"):
            read_cloud(str(tmp_path / name), UTM, BOUNDS, 2.0)
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(MissingPackageError, match="need the package 'laspy'.*or leave REFERENCE empty"):
        read_cloud(bare, UTM, BOUNDS, 2.0)


def _changed(path, place, value):
    """The file with bytes of its header replaced."""
    with open(path, "r+b") as stream:
        stream.seek(place)
        stream.write(value)
    return path


CLAIMS = {  # what a header says at which byte (LAS 1.4 R15, table 3), and what is answered
    "records before the points": (100, b"\xff" * 4, "claims 4294967295 records before its points"),
    "half as many": (100, b"\0\0\0\x80", "claims 2147483648 records before its points"),
    "where the points begin": (96, b"\xff" * 4, "its points begin at byte 4294967295"),
    "records after the points": (243, b"\xff" * 4, "claims 4294967295 records after its points"),
    "one, at the file's beginning": (243, b"\1\0\0\0", "claims 1 records after its points, from byte 0"),
}


@pytest.mark.parametrize("name", ("cloud.las", "cloud.laz"))
@pytest.mark.parametrize("claim", CLAIMS)
def test_a_header_that_claims_more_than_its_file_has_is_refused_at_once(tmp_path, name, claim):
    place, value, answer = CLAIMS[claim]
    path = _changed(write(tmp_path / name, *points(400)), place, value)
    start = time.monotonic()
    with pytest.raises(ImageError, match=rf"Cannot read the point cloud .*{answer}.*: get it again"):
        read_cloud(path, UTM, BOUNDS, 2.0)
    assert time.monotonic() - start < 1.0


@pytest.mark.parametrize("kept", (24, 25, 26, 60, 104, 200, 226, 227, 300, 374))
def test_a_cloud_that_ends_in_its_header_is_refused(tmp_path, kept):
    path = write(tmp_path / "cloud.las", *points(400))
    with open(path, "r+b") as stream:
        stream.truncate(kept)
    with pytest.raises(ImageError, match=f"its {kept} bytes end in its header.*: get it again"):
        read_cloud(path, UTM, BOUNDS, 2.0)


def test_a_sound_cloud_may_have_records_after_its_points(tmp_path):
    path = write(tmp_path / "cloud.las", *points(4000))
    cloud = laspy.read(path)
    cloud.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("a", 1, "one", b"12345"), laspy.VLR("b", 2, "two", b"")])
    cloud.write(path)
    assert len(read_cloud(path, UTM, BOUNDS, 5.0).height) > 0


def test_few_points_all_over_are_taken_as_they_are(tmp_path):
    rng = np.random.default_rng(4)
    x, y = rng.uniform(BOUNDS.xmin, BOUNDS.xmax, 600), rng.uniform(BOUNDS.ymin, BOUNDS.ymax, 600)
    path = write(tmp_path / "few.laz", x, y, 100 + 0.01 * (x - BOUNDS.xmin))
    found = read_cloud(path, UTM, BOUNDS, 2.0)
    assert len(found.height) == 600 and found.width_m == (0.0, 0.0)
    assert np.abs(found.height - 100 - 0.01 * (found.xy[:, 0] - BOUNDS.xmin)).max() < 0.01
