"""Photons by day, and granules of lasers as they are delivered."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.records import ReferenceFigures
from repm_qgis.geometry.frames import geodetic_from_projected, projected_from_geodetic, utm_crs
from repm_qgis.registration import photons
from repm_qgis.registration.lasers import read_lasers
from repm_qgis.registration.photons import dense
from repm_qgis.registration.references import read_reference
from tests.engine.registration.test_lasers import BOUNDS, UTM, write_hdf5


def track(signal=1500, noise=4000, seed=1):
    """A weak beam by day over a slope with hills: longitudes, latitudes, heights, which photons are signal, ground."""
    rng = np.random.default_rng(seed)
    along = rng.uniform(50, 1950, signal + noise)
    ground = 300.0 + 0.15 * along + 5.0 * np.sin(along / 60.0)
    real = np.arange(signal + noise) < signal
    height = np.where(real, ground + rng.normal(0, 0.25, real.size), 200.0 + rng.uniform(0, 500, real.size))
    xy = np.column_stack([500_500 + 0.1 * along, 4_000_000 + along])
    order = np.argsort(along)
    lon, lat = geodetic_from_projected(UTM, xy).T
    return lon[order], lat[order], height[order], real[order], ground[order]


def test_signal_lies_among_many_and_noise_does_not():
    lon, lat, height, real, ground = track()
    found = dense(lon, lat, height, ~real)
    assert found[real].mean() > 0.95
    assert (found & (np.abs(height - ground) > 4)).sum() < 5
    assert not dense(lon[:0], lat[:0], height[:0], real[:0]).any()
    shuffled = np.random.default_rng(2).permutation(len(lon))
    np.testing.assert_array_equal(dense(*(each[shuffled] for each in (lon, lat, height, ~real))), found[shuffled])


def test_blocks_hide_no_photon(monkeypatch):
    """The track is looked at in parts of eight cells, each with what lies around it."""
    lon, lat, height, real, ground = track()
    whole = dense(lon, lat, height, ~real)
    monkeypatch.setattr(photons, "_BLOCK", 8)
    parts = dense(lon, lat, height, ~real)
    assert parts[real].mean() > whole[real].mean() - 0.02
    assert (parts & (np.abs(height - ground) > 4)).sum() < 10


def test_few_photons_are_no_surface():
    lon, lat, height, real, _ = track(signal=150, noise=0)
    assert dense(lon, lat, height, ~real).mean() < 0.1, "two in a window"


def test_low_photons_of_a_day_count_where_they_lie_among_many(tmp_path):
    lon, lat, height, real, ground = track()
    confidence = np.zeros((len(lon), 5), dtype=np.int16)
    confidence[real, 0] = 2
    confidence[np.flatnonzero(real)[::40], 0] = 3
    confidence[np.flatnonzero(~real)[::8], 0] = 2  # noise that the product takes for signal of low confidence
    beam = {"lon_ph": lon, "lat_ph": lat, "h_ph": height.astype(np.float32), "signal_conf_ph": confidence}
    beam["delta_time"] = np.linspace(1e8, 1e8 + 0.3, len(lon))  # seconds since the beginning of 2018
    path = write_hdf5(tmp_path / "ATL03.h5", {f"gt1r/heights/{name}": each for name, each in beam.items()})
    found = read_lasers(path, UTM, BOUNDS)
    assert 1400 < len(found.height) < 1550  # 38 of medium confidence before
    assert found.about.startswith("ATL03, measured 2021-03-03, heights above the WGS 84 ellipsoid (ITRF2014); used are")
    assert found.about.endswith(f"{len(found.height)} of {len(lon)} around the scene.")
    away = [
        np.abs(h - np.interp(y, 4_000_000 + np.array([0, 1e4]), [300.0, 300.0 + 1500.0]))
        for h, y in zip(found.height, found.xy[:, 1])
    ]
    assert np.mean(np.array(away) < 8) > 0.99


def around(lon, lat, half_m):
    crs = utm_crs(lon, lat)
    x, y = projected_from_geodetic(crs, np.array([lon, lat]))
    return crs, Bounds(x - half_m, y - half_m, x + half_m, y + half_m)


GRANULES = {
    "atl03_clip.h5": (-106.5703, 41.5354, 2000, 1300, 1400, "ATL03, measured 2022-04-01"),
    "atl08_clip.h5": (-106.5703, 41.5354, 2000, 25, 25, "ATL08 (20 m), measured 2022-04-01"),
    "ATL06_20181013235645_02340114_209_01.h5": (-124.51, -24.0, 60000, 50, 500, "ATL06, measured 2018-10-13"),
    "GEDI02_A_2019108080338_O01964_T05337_02_001_01_sub.h5": (-44.125, -13.735, 5000, 301, 301, "GEDI L2A, measured"),
}


@pytest.mark.parametrize("name", GRANULES)
def test_real_granules_are_read_and_say_what_they_are(shared_data, name):
    lon, lat, half_m, least, most, words = GRANULES[name]
    crs, bounds = around(lon, lat, half_m)
    found = read_reference(str(shared_data / "lasers" / name), crs, bounds, 1.0)
    assert least <= len(found.height) <= most
    assert found.about.startswith(words) and "heights above the WGS 84 ellipsoid" in found.about
    assert found.datum.code == ""


def test_photons_of_a_real_day_lie_on_the_ground_and_trees_that_another_product_has(shared_data):
    """In a forest: ATL08 has its ground, and canopies of 5 to 10 m above it."""
    crs, bounds = around(-106.5703, 41.5354, 2000)
    photons, ground = (
        read_reference(str(shared_data / "lasers" / f"{name}_clip.h5"), crs, bounds, 1.0) for name in ("atl03", "atl08")
    )
    order = np.argsort(ground.xy[:, 1])
    above = photons.height - np.interp(photons.xy[:, 1], ground.xy[order, 1], ground.height[order])
    inside = (photons.xy[:, 1] > ground.xy[:, 1].min()) & (photons.xy[:, 1] < ground.xy[:, 1].max())
    assert inside.sum() > 1000
    assert ((above[inside] > -3) & (above[inside] < 14)).mean() > 0.98


def test_a_table_of_slide_rule_in_asps_columns(shared_data):
    crs, bounds = around(-156.58, 71.34, 10_000)
    found = read_reference(str(shared_data / "lasers" / "atl06sr_defaults_filtered.csv"), crs, bounds, 1.0)
    assert len(found.height) > 300 and found.datum.code == "", "its field is height_above_datum"


def test_a_scene_made_before_has_nothing_to_say_about_its_reference():
    figures = ReferenceFigures(
        "a.h5", "WGS 84", "the file says so", (1.0, 1.0), 9, 9, (0.0,) * 3, (0.1,) * 3, (), 1.0, 1.0, 0.0, 1.0
    )
    old = figures.to_mapping()
    del old["about"]
    assert ReferenceFigures.from_mapping(old).about == ""
