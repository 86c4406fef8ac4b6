"""The altitude range from the images: it holds the true range, and is not much wider."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import OptionError
from repm_qgis.geometry.footprints import ray_slope
from repm_qgis.geometry.frames import geodetic_from_projected, mean_place, projected_from_geodetic, utm_crs
from repm_qgis.planning import altitude_range as altitude_range_module
from repm_qgis.planning.altitude_range import SweepResult, altitude_range, sweep_altitudes, sweep_patches
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.rpc.writers import rpc_txt
from repm_qgis.runtime.workspace import write_text
from repm_qgis.stages import run_stage

NONE = (None, None)
SWEEP = PLANNING.sweep


@pytest.mark.parametrize("kind, wider", (("urban", 90.0), ("mountains", 90.0)))
@pytest.mark.parametrize("search", ((-100.0, 1500.0), None))
def test_the_true_range_is_inside_and_the_range_is_not_absurd(request, told, kind, wider, search):
    scene = request.getfixturevalue(kind)
    seen = float(scene.surface.min()), float(scene.surface.max())
    search = search or scene.views[0].rpc.height_range
    found = sweep_altitudes(scene.views, scene.crs, scene.bounds, search=search, progress=told())
    assert found.altitudes[0] <= seen[0] and found.altitudes[1] >= seen[1]
    assert np.diff(found.altitudes)[0] < seen[1] - seen[0] + wider + 2 * found.step_m
    assert search[0] <= found.altitudes[0] and found.altitudes[1] <= search[1]
    assert found.matched > 60 and found.matched <= found.cells


@pytest.mark.parametrize("side", (900, 1600, 2000, 2600, 4000, 12000))
def test_patches_of_the_sweep_do_not_overlap(side):
    patches = sweep_patches((0.0, 0.0, float(side), float(side)), 1.0, PLANNING.sweep)
    starts, ends = sorted({p[0] for p in patches}), sorted({p[2] for p in patches})
    assert len(patches) == len(starts) ** 2 and starts[0] == 0 and ends[-1] == side
    assert all(end <= start + 1e-6 for end, start in zip(ends, starts[1:]))
    assert sum((p[2] - p[0]) * (p[3] - p[1]) for p in patches) >= min(0.99 * side**2, 9 * 1280**2)


def test_real_pairs(shared_data, told):
    """S2P's DSM of the real pair tells what is there."""
    from osgeo import gdal

    from repm_qgis.scene import load_views

    folder = shared_data / "pleiades_pair"
    views = load_views(tuple(str(path) for path in sorted(folder.glob("img*.tif"))))
    dataset = gdal.Open(str(folder / "s2p_dsm.tif"))
    west, cell, _, north, _, _ = dataset.GetGeoTransform()
    heights, crs = dataset.ReadAsArray(), dataset.GetSpatialRef().GetAuthorityCode(None)
    dataset = None
    heights = heights[np.isfinite(heights) & (heights > -1000)]
    bounds = (west + 50, north - 400, west + 450, north - 50)
    found = sweep_altitudes(views, f"EPSG:{crs}", bounds, search=views[0].rpc.height_range, progress=told())
    low, high = np.percentile(heights, (1, 99))
    assert found.altitudes[0] <= low and found.altitudes[1] >= high
    assert np.diff(found.altitudes)[0] < 2.5 * (high - low) + 100


@pytest.mark.slow
def test_stripes_of_zeros_do_not_widen_the_range(told, tmp_path):
    """A quarter of all rows: false matches of black on black, and of the stripes' edges, lay 350 and 900 m away."""
    from osgeo import gdal

    from repm_qgis.imagery.collars import write_collar_mask
    from repm_qgis.scene import load_views
    from repm_qgis.stages import run_stage

    made = run_stage("sampledata", {"folder": str(tmp_path), "kind": "urban", "size": 800, "seed": 3}, told())
    views, search = load_views(made.images[:2]), (-300.0, 2500.0)
    dataset = gdal.Open(made.truth)
    surface, (west, cell, _, north, _, _) = dataset.ReadAsArray(), dataset.GetGeoTransform()
    crs = f"EPSG:{dataset.GetSpatialRef().GetAuthorityCode(None)}"
    bounds = (west, north - surface.shape[0] * cell, west + surface.shape[1] * cell, north)
    plain = sweep_altitudes(views, crs, bounds, search=search, progress=told())
    masked = []
    for view in views:
        dataset = gdal.Open(view.image, gdal.GA_Update)
        values = dataset.ReadAsArray()
        for row in range(40, view.height, 130):
            values[row : row + 30] = 0
        dataset.GetRasterBand(1).WriteArray(values)
        dataset = None
        mask = str(tmp_path / f"mask_{view.name}.tif")
        assert write_collar_mask(view.image, view.band, "", target=mask) > 0.2
        masked.append(replace(view, mask=mask))
    found = sweep_altitudes(masked, crs, bounds, search=search, progress=told())
    assert found.altitudes[0] > plain.altitudes[0] - 50.0 and found.altitudes[1] < plain.altitudes[1] + 50.0
    low, high = np.percentile(surface, (0.5, 99.5))
    assert found.altitudes[0] < low and found.altitudes[1] > high


def test_slopes_are_what_two_heights_say(urban):
    """The direction of a ray, from the simulated sensor's own RPC by another path: two localised ends in UTM."""
    view = urban.true_views[0]
    lon_lat = geodetic_from_projected(
        urban.crs, np.array([(urban.bounds[0] + urban.bounds[2]) / 2, (urban.bounds[1] + urban.bounds[3]) / 2])
    )
    slope = ray_slope(view, lon_lat, 200.0)
    tilt = np.degrees(np.arctan(np.linalg.norm(slope)))
    look = urban.record["views"][0]
    # Pitch and roll of the satellite make a little more at the curved ground.
    aimed = np.degrees(np.arctan(np.hypot(*np.tan(np.radians([look["pitch_deg"], look["roll_deg"]])))))
    assert aimed < tilt < 1.25 * aimed + 0.5


def test_what_the_user_gives_comes_first(urban, told):
    search = urban.views[0].rpc.height_range
    assert altitude_range(
        urban.views, urban.crs, urban.bounds, search=search, given=(150.0, 300.0), dem=None, progress=told()
    ) == (
        (150.0, 300.0),
        "given",
    )
    wide = (0.0, 900.0)
    found, source = altitude_range(
        urban.views, urban.crs, urban.bounds, search=wide, given=(100.0, None), dem=None, progress=told()
    )
    assert found[0] == 100.0 and source == "given and images" and found[1] >= urban.surface.max()
    with pytest.raises(
        OptionError, match="ALTITUDE_MIN is 5000.0: it leaves no altitude range: the ground lies between [12]?[0-9]{2} "
    ):
        altitude_range(
            urban.views, urban.crs, urban.bounds, search=search, given=(5000.0, None), dem=None, progress=told()
        )


def test_a_range_that_only_the_search_ended_is_the_rpcs(urban, told):
    """The ground lies between, and the margins of what the images show reach beyond one or both ends."""
    low, high = urban.surface.min(), urban.surface.max()
    for search, wanted in (
        ((low - 10.0, high + 20.0), "RPC"),
        ((low - 10.0, high + 400.0), "RPC and images"),
        ((low - 400.0, high + 20.0), "images and RPC"),
        ((low - 400.0, high + 400.0), "images"),
    ):
        found, source = altitude_range(
            urban.views, urban.crs, urban.bounds, search=search, given=NONE, dem=None, progress=told()
        )
        assert source == wanted
        assert [end == most for end, most in zip(found, search)] == [
            wanted in ("RPC", "RPC and images"),
            wanted in ("RPC", "images and RPC"),
        ]


def test_a_dem_comes_before_the_images(urban, told):
    said = told()
    found, source = altitude_range(
        urban.views, urban.crs, urban.bounds, search=(0.0, 9000.0), given=NONE, dem=urban.truth, progress=said
    )
    assert source == "DEM" and len(said.warnings) == 1 and "above the WGS 84 ellipsoid" in said.warnings[0]
    assert found[0] == pytest.approx(urban.surface.min() - 20, abs=1.0)
    assert found[1] == pytest.approx(urban.surface.max() + 60, abs=5.0)


def test_images_that_do_not_tell(urban, told, tmp_path, write_image):
    from repm_qgis.scene import load_views

    noise = np.random.default_rng(0).integers(100, 1000, (3, 400, 400)).astype(np.uint16)
    views = load_views(
        tuple(write_image(tmp_path / f"{i}.tif", noise[i], view.rpc) for i, view in enumerate(urban.views))
    )
    said = told()
    assert altitude_range(
        views, urban.crs, urban.bounds, search=(100.0, 400.0), given=NONE, dem=None, progress=said
    ) == ((100.0, 400.0), "RPC")
    assert "altitude range could not be found" in said.warnings[0]


def test_a_scene_across_180_degrees(urban, told, tmp_path):
    """The town turned about the Earth's axis, so that half of it has longitudes of -180 degrees: the same range."""
    plain = sweep_altitudes(urban.views, urban.crs, urban.bounds, search=(0.0, 500.0), progress=told())
    corners = np.array([urban.bounds[:2], urban.bounds[2:]])
    lon_lat = geodetic_from_projected(urban.crs, corners)
    turn = 180.0 - lon_lat[:, 0].mean()
    views = [replace(view, rpc=replace(view.rpc, lon_off=view.rpc.lon_off + turn)) for view in urban.views]
    crs = utm_crs(180.0, lon_lat[0, 1])
    xy = projected_from_geodetic(crs, lon_lat + [turn, 0.0])
    bounds = (xy[:, 0].min(), xy[:, 1].min(), xy[:, 0].max(), xy[:, 1].max())
    found = sweep_altitudes(views, crs, bounds, search=(0.0, 500.0), progress=told())
    np.testing.assert_allclose(found.altitudes, plain.altitudes, atol=2 * found.step_m)
    assert found.matched > 0.8 * plain.matched


@pytest.mark.long
def test_a_run_across_180_degrees(urban, told, tmp_path):
    """As the images are delivered: RPCs beside them, on either side of the line, and no altitudes from the user."""
    turn = 180.0 - np.mean([view.rpc.lon_off for view in urban.views])
    rpcs = []
    for side, view in zip((0.0, 360.0, 0.0), urban.views):
        rpcs.append(str(tmp_path / f"{view.name}_RPC.TXT"))
        write_text(rpcs[-1], rpc_txt(replace(view.rpc, lon_off=view.rpc.lon_off + turn - side)))
    job = {"images": urban.images, "rpcs": rpcs, "workspace": str(tmp_path / "w"), "output": str(tmp_path / "dsm.tif")}
    run_stage("pipeline", {**job, "resolution": 1.0, "workers": 1, "report": str(tmp_path / "r.html")}, told())
    heights = gdal.Open(job["output"]).ReadAsArray()
    heights = heights[heights > -1000]
    assert heights.size > 20_000
    np.testing.assert_allclose(np.percentile(heights, (5, 50, 95)), np.percentile(urban.surface, (5, 50, 95)), atol=8)


def test_of_several_pairs_that_with_most_heights_counts(monkeypatch, told):
    """Pairs are tried one after the other, until one shows enough of the ground."""
    matched, asked = {"ab": 3, "ac": 7, "bc": 5, "bd": 900}, []

    def swept(first, second, *rest, **more):
        asked.append(first + second)
        count = matched[asked[-1]]
        return SweepResult((0.0, float(count)), count, 1000, 1.0, np.empty((0, 3))) if count else None

    monkeypatch.setattr(altitude_range_module, "_pairs", lambda *given: [(pair[0], pair[1], 0.3) for pair in matched])
    monkeypatch.setattr(altitude_range_module, "_swept", swept)
    three = replace(SWEEP, pairs=3)

    def best():
        return sweep_altitudes(
            (), "", Bounds(0.0, 0.0, 1.0, 1.0), search=(0.0, 100.0), progress=told(), parameters=three
        )

    assert best().matched == 7 and asked == ["ab", "ac", "bc"]
    asked.clear()
    matched.update(ac=100)  # a tenth of the cells is enough
    assert best().matched == 100 and asked == ["ab", "ac"]
    matched.update(ab=0, ac=0, bc=0)
    assert best() is None


def test_pairs_of_one_day_and_of_the_best_ratio_come_first(urban):
    """Images of two seasons hardly correlate, whatever their ratio; narrow pairs measure nothing."""
    a, b, c = urban.views
    search = urban.height_range

    def order(*views):
        found = altitude_range_module._pairs(views, Bounds(*urban.bounds), urban.crs, search, SWEEP)
        return [{first.name, second.name} for first, second, _ in found]

    ratios = {
        frozenset((first.name, second.name)): ratio
        for first, second, ratio in altitude_range_module._pairs(
            (a, b, c), Bounds(*urban.bounds), urban.crs, search, SWEEP
        )
    }
    day, winter = "2020-06-01T10:30:00Z", "2020-12-01T10:30:00Z"
    for early, late in ((a, b), (b, c), (a, c)):
        other = next(view for view in (a, b, c) if view not in (early, late))
        dated = [replace(early, acquired=day), replace(late, acquired=day), replace(other, acquired=winter)]
        assert order(*dated)[0] == {early.name, late.name}
    same = [replace(view, acquired=day) for view in (a, b, c)]
    wanted = sorted(ratios, key=lambda pair: abs(np.log(ratios[pair] / SWEEP.best_base_to_height)))
    assert order(*same) == [set(pair) for pair in wanted]
    narrow = replace(b, name="narrow", rpc=a.rpc.shifted(3.0, 0.0))
    assert {"narrow", a.name} not in order(a, narrow, c)


@pytest.mark.parametrize("cells", (-2, 0, 1, 3))
def test_errors_of_rpcs_across_the_parallax_are_found_in_whole_cells(urban, cells):
    """They would hide the correlation; along the parallax they are heights."""
    first, second = urban.true_views[:2]
    patch = sweep_patches(Bounds(*urban.bounds), first.gsd_m, SWEEP)[0]
    planes = np.arange(urban.height_range[0] - 20.0, urban.height_range[1] + 20.0, 4.0)
    sweep = altitude_range_module._Sweep(first, second, urban.crs, planes, SWEEP)
    centre = mean_place(altitude_range_module._lattice(urban.crs, patch).reshape(-1, 2))
    slopes = [ray_slope(view, centre, float(planes.mean())) for view in (first, second)]
    east, north = (slopes[1] - slopes[0]) / np.hypot(*(slopes[1] - slopes[0]))
    # A ground place that lies so many cells across the parallax, in the second image's pixels.
    away = np.array([-north, east]) * cells * SWEEP.reduction * first.gsd_m
    degrees = away / 111_320.0 / (np.cos(np.radians(centre[1])), 1.0)
    here = np.array([*centre, planes.mean()])
    moved = second.project(here + (*degrees, 0.0)) - second.project(here)
    wrong = replace(sweep, second=replace(second, rpc=second.rpc.shifted(*(-moved))))
    score, _, shift = altitude_range_module._cross_shift(wrong, patch)
    wanted = np.round([-cells * east, -cells * north])  # rows run south
    assert score > 0.5 and tuple(wanted) == shift
