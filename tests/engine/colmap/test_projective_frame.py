"""The tile's frame: the same pixels as before, and good in single precision through every step of COLMAP's warp."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.colmap.projective_frame import ProjectiveFrame, tile_frame
from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import RpcInvalidError
from repm_qgis.geometry.equivalent_error import fit_pinhole, virtual_grid
from repm_qgis.geometry.frames import EnuFrame, geodetic_from_projected, projected_from_geodetic, utm_crs
from repm_qgis.geometry.parameters import VIRTUAL_GRID
from repm_qgis.geometry.pinhole import PinholeCamera
from repm_qgis.rpc.readers import read_rpc_file, rpc_of
from repm_qgis.scene import Scene, View
from tests.engine.colmap.emulation import worst_error

SITES = ("calanques", "giza", "lenclio", "melbourne", "new_york", "ossoue", "port_au_prince", "toulouse", "ubaye")
SENSORS = (
    "20191015_073816_ssc1d3_0011_basic_l1a_panchromatic_dn_RPC.TXT",
    "PHR1B_P_201709281038045_SEN_PRG_FC_178608-001.geom",
    "RPC_PHR1B_P_201709281038045_SEN_PRG_FC_178608-001.XML",
    "rpc_IKONOS.txt",
    "rpc_PLANET_L1A.txt",
    "rpc_PLANET_L1B.txt",
    "rpc_SPOT6.xml",
    "rpc_WV2.xml",
    "wv3_20.NTF",
    "wv3_30.NTF",
)
HALF_M = 400.0


def scene_of(views, altitudes):
    lon, lat, _ = views[0].localise(np.array([views[0].width / 2, views[0].height / 2]), sum(altitudes) / 2)
    crs = utm_crs(lon, lat)
    x, y = projected_from_geodetic(crs, np.array([lon, lat]))
    return Scene(views, EnuFrame(float(lon), float(lat)), crs, "", altitudes, [], "polynomial"), float(x), float(y)


def ground_enu(scene, x, y, half, altitudes, count=300):
    """(N, 3) random ground points, east, north, up."""
    numbers = np.random.default_rng(1)
    points = numbers.uniform((x - half, y - half, altitudes[0]), (x + half, y + half, altitudes[1]), (count, 3))
    return scene.frame.from_geodetic(np.column_stack([geodetic_from_projected(scene.crs, points[:, :2]), points[:, 2]]))


def planes(matrix, points, slope):
    """(N, 3) unit normals, in a frame of this 4 x 4 map, of planes through points with slopes up to this one."""
    numbers = np.random.default_rng(2)
    gradient = numbers.uniform(-slope, slope, (len(points), 2)) / np.sqrt(2)
    normals = np.column_stack([-gradient, np.ones(len(points))])
    plane = np.column_stack([normals, -(normals * points).sum(axis=1)]) @ np.linalg.inv(matrix)
    return plane[:, :3] / np.linalg.norm(plane[:, :3], axis=1, keepdims=True)


def errors(frame, first, second, points, slope):
    """Worst error in px of the float32 warp: cameras (camera, size) through the frame, pairs of old and new."""
    found = []
    for matrix, a, b in ((np.eye(4), first[0], second[0]), (frame.matrix, first[1], second[1])):
        world = points if a is first[0] else frame.from_enu(points)
        normals = planes(matrix, points, slope) @ a[0].R.T
        with np.errstate(all="ignore"):
            found.append(worst_error(a[0], b[0], a[1], a[0].project(world), a[0].depth(world), normals, b[1]))
    return found


def check(name, scene, tile, points, capsys):
    """The tile's frame against the bars; what the untransformed cameras would give is printed beside."""
    first, second = tile.views[:2]
    for view in tile.views:
        seen = view.camera.project(tile.frame.from_enu(points))
        before = np.column_stack([view.refined.camera.project(points), np.ones(len(points))]) @ view.from_refined.T
        assert np.abs(seen - before[:, :2] / before[:, 2:]).max() < 1e-4
        assert view.camera.K[0, 0] == view.camera.K[1, 1] > 0 and view.camera.K[0, 1] == 0
        assert np.linalg.det(view.camera.R) == pytest.approx(1.0)
    low, high = tile.depths(scene)
    assert 0.9 < low < high < 2.2
    pair = [((view.refined.camera, view.refined.size), (view.camera, view.size)) for view in (first, second)]
    flat, steep = (errors(tile.frame, *pair, points, slope) for slope in (0.0, 1.0))
    with capsys.disabled():
        print(
            f"\n{name}: float32 warp errs by {flat[1]:.4f} px on level ground, {steep[1]:.4f} px on slopes up to 45 "
            f"degrees; with the untransformed cameras by {flat[0]:.3f} and {steep[0]:.3f} px",
            end="",
        )
    assert max(flat[1], steep[1]) < 0.02
    assert flat[0] > 5 * flat[1]


@pytest.mark.parametrize("span", ("200 m", "the RPC's"))
@pytest.mark.parametrize("site", SITES)
def test_every_site(shared_data, site, span, capsys):
    views = []
    for path in sorted((shared_data / "rpc" / "pleiades").glob(f"{site}__*.XML"))[:3]:
        rpc = read_rpc_file(str(path))
        views.append(View(path.stem, "", 1, int(2 * rpc.col_off), int(2 * rpc.row_off), rpc, 0.5))
    middle = views[0].rpc.height_off
    altitudes = (middle - 100, middle + 100) if span == "200 m" else views[0].rpc.height_range
    scene, x, y = scene_of(views, altitudes)
    bounds = Bounds(x - HALF_M, y - HALF_M, x + HALF_M, y + HALF_M)
    tile = tile_frame(scene, [view.name for view in views], bounds, altitudes)
    check(f"{site}, {span}", scene, tile, ground_enu(scene, x, y, HALF_M, altitudes), capsys)


def test_images_that_need_no_shared_data(urban, capsys):
    altitudes = urban.height_range
    scene, x, y = scene_of(urban.views, altitudes)
    tile = tile_frame(scene, [view.name for view in urban.views], (x - 60, y - 60, x + 60, y + 60), altitudes)
    assert [view.view.name for view in tile.views] == [view.name for view in urban.views]
    check("simulated town", scene, tile, ground_enu(scene, x, y, 60.0, altitudes), capsys)


@pytest.mark.parametrize("turned_deg", (8.0, 25.0))
@pytest.mark.parametrize("name", SENSORS)
def test_every_sensor_beside_itself(shared_data, name, turned_deg, capsys):
    """One RPC has no stereo partner: its camera is turned around the ground to make one."""
    path = shared_data / "rpc" / "other" / name
    if name.endswith("NTF"):
        from repm_qgis.imagery.raster import opened

        with opened(str(path)) as dataset:
            rpc = rpc_of(dataset, str(path))
    else:
        rpc = read_rpc_file(str(path))
    run_sensor(rpc, turned_deg, name, capsys)


def test_a_made_up_sensor_beside_itself(synthetic_rpc, capsys):
    run_sensor(synthetic_rpc(), 15.0, "made-up RPC", capsys)


def run_sensor(rpc, turned_deg, name, capsys):
    window = (rpc.col_off - 500, rpc.row_off - 500, 1000, 1000)
    altitudes = (rpc.height_off - 100, rpc.height_off + 100)
    lon, lat, _ = rpc.localise(np.array([rpc.col_off, rpc.row_off]), rpc.height_off)
    local = EnuFrame(float(lon), float(lat), float(rpc.height_off))
    grid = virtual_grid(rpc.localise, window, altitudes, local, VIRTUAL_GRID.tile)
    first = fit_pinhole(grid).camera.without_skew().moved(window[0], window[1])
    angle = np.radians(turned_deg)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    second = PinholeCamera(first.K, first.R @ turn, first.t)
    points = grid.enu[np.random.default_rng(0).choice(len(grid.enu), 300, replace=False)]
    frame = ProjectiveFrame.over((first, second), grid.enu)
    pair = [((camera, (1000, 1000)), (square(frame, camera), (2000, 2000))) for camera in (first, second)]
    flat, steep = (errors(frame, *pair, points, slope) for slope in (0.0, 0.5))
    with capsys.disabled():
        print(
            f"\n{name}, {turned_deg:g} degrees: {flat[1]:.4f} and {steep[1]:.4f} px; untransformed {flat[0]:.3f} and "
            f"{steep[0]:.3f} px",
            end="",
        )
    assert max(flat[1], steep[1]) < 0.02


def square(frame, camera):
    """A camera of the frame with its skew taken out and square pixels, for an image around the points it sees."""
    there = frame.camera(camera)
    focal = max(there.K[0, 0], abs(there.K[1, 1]))
    moved = np.diag([focal, focal, 1.0]) @ np.linalg.inv(there.K)
    centre = moved @ np.append(camera.project(np.zeros(3)), 1.0)
    return PinholeCamera(np.diag([focal, focal, 1.0]), there.R, there.t).moved(*(centre[:2] - 1000))


def test_there_and_back(synthetic_rpc):
    rpc = synthetic_rpc()
    lon, lat, _ = rpc.localise(np.array([rpc.col_off, rpc.row_off]), 500.0)
    grid = virtual_grid(
        rpc.localise,
        (rpc.col_off, rpc.row_off, 1500, 1500),
        (400.0, 600.0),
        EnuFrame(float(lon), float(lat)),
        VIRTUAL_GRID.tile,
    )
    frame = ProjectiveFrame.over((fit_pinhole(grid).camera,), grid.enu)
    there = frame.from_enu(grid.enu)
    assert np.abs(there).max() < 1.5
    np.testing.assert_allclose(ProjectiveFrame(np.linalg.inv(frame.matrix)).from_enu(there), grid.enu, atol=1e-8)
    # Planes of equal height stay planes of equal height, and the inverse depth grows evenly with it.
    up = grid.enu[:, 2]
    depth = 4 / 3 - there[:, 2]
    fit = np.polyfit(up, 1 / depth, 1)
    assert np.abs(np.polyval(fit, up) - 1 / depth).max() < 1e-12


def test_a_camera_along_the_ground_is_refused():
    level = PinholeCamera(
        np.diag([1e6, 1e6, 1.0]), np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]]).T, np.array([0.0, 0.0, 6e5])
    )
    cube = np.array([[x, y, z] for x in (-9.0, 9) for y in (-9.0, 9) for z in (-9.0, 9)])
    with pytest.raises(RpcInvalidError, match="along the ground"):
        ProjectiveFrame.over((level,), cube)


def test_views_that_do_not_see_the_tile_are_left_out(urban):
    altitudes = urban.height_range
    scene, x, y = scene_of(urban.views, altitudes)
    names = [view.name for view in urban.views]
    assert tile_frame(scene, names, (x + 5000, y, x + 5100, y + 100), altitudes) is None
    assert tile_frame(scene, names[:1], (x - 50, y - 50, x + 50, y + 50), altitudes) is None
