"""Attitude jitter in the adjustment: found where it is, not where it is not, and taken out of pairs and heights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.geometry.map_plane import MapPlane
from repm_qgis.pointing.adjustment import adjust
from repm_qgis.pointing.ground_control import Gcp, intersect
from repm_qgis.pointing.jitter import can_jitter, ladder
from repm_qgis.pointing.vertical_parallax import tracks_of_pair
from repm_qgis.rpc.fit import fit_rpc
from repm_qgis.scene import View
from repm_qgis.simulation.scene import SceneSpec, make_views
from repm_qgis.simulation.sensor import ZY3, jitter_px
from repm_qgis.ties.tracks import Track

SIZE, HEIGHTS = 2048, (300.0, 1200.0)
SPEC = SceneSpec("mountains", SIZE, 11, ZY3, 5.0, 2, base_m=300.0, relief_m=900.0, lon=6.65, lat=44.38)
BIAS = np.array([[1.2, -0.7], [-0.5, 0.4], [0.8, 0.9]])


class Case:
    """Three views of a rough surface, which the RPCs describe but for their shift and jitter."""

    def __init__(self, jitter_px_: float, count: int = 1200, noise: float = 0.08) -> None:
        self.true = make_views(replace(SPEC, jitter_px=jitter_px_))
        numbers = np.random.default_rng(4)
        pixels = numbers.uniform(250, SIZE - 250, (count, 2))
        self.ground = self.true[1].localise(pixels, numbers.uniform(*HEIGHTS, count))
        seen = [view.project(self.ground) for view in self.true]
        inside = np.all([(p > 0).all(axis=1) & (p < SIZE - 1).all(axis=1) for p in seen], axis=0)
        self.ground, self.seen = self.ground[inside], [p[inside] for p in seen]
        self.views = []
        for view, bias in zip(self.true, BIAS):
            rpc = fit_rpc(view.steady.localise, view.size, (250.0, 1250.0)).rpc.shifted(*-bias)
            self.views.append(View(view.name, f"{view.name}.tif", 1, SIZE, SIZE, rpc, view.look.gsd_m))
        self.noise = numbers.normal(0.0, noise, (3, len(self.ground), 2))

    def tracks(self, numbers=(0, 1, 2)):
        return [
            Track({self.views[i].name: self.seen[i][k] + self.noise[i, k] for i in numbers})
            for k in range(len(self.ground))
        ]

    def heights_m(self, views):
        """The standard deviation of the heights' errors, where a tilt of the whole is taken out."""
        found = EnuFrame(*map(float, self.ground.mean(axis=0)))
        errors = []
        for k in range(0, len(self.ground), 10):
            pixels = {view.name: self.seen[i][k] for i, view in enumerate(self.views)}
            errors.append(intersect(_Point(*self.ground[k], pixels), views)[2])
        places = found.from_geodetic(self.ground[::10])[:, :2]
        design = np.column_stack([np.ones(len(places)), places])
        errors = np.array(errors)
        return float(np.std(errors - design @ np.linalg.lstsq(design, errors, rcond=None)[0]))


class _Point:
    """What `intersect` reads of a control point."""

    def __init__(self, lon, lat, height, pixels):
        self.lon, self.lat, self.height, self.pixels = float(lon), float(lat), float(height), pixels
        self.lon_lat_h = np.array([lon, lat, height])


@pytest.fixture(scope="module")
def shaken():
    return Case(0.8)


@pytest.mark.slow
def test_three_views_tell_most_of_the_waves(shaken):
    found = adjust(shaken.views, shaken.tracks(), 700.0, "auto")
    steady = adjust(shaken.views, shaken.tracks(), 700.0, "shift")
    assert set(found.jitter) == {view.name for view in shaken.views} and "residuals show jitter" in found.reason
    assert np.median(steady.residual_px) > 3 * np.median(found.residual_px)
    assert np.median(found.residual_px) < 0.08
    before, after = (shaken.heights_m(each.applied(shaken.views)) for each in (steady, found))
    assert before > 1.2 and after < 0.6 * before
    waves = [jitter_px(view.jitter, np.arange(300.0, 1700.0)) for view in shaken.true]
    for true, view in zip(waves, shaken.views):  # columns are seen by vertical parallax, but for a trend
        own = found.jitter[view.name].at(np.arange(300.0, 1700.0))
        assert np.corrcoef(own[:, 0], true[:, 0])[0, 1] > 0.9


def test_a_pair_loses_its_vertical_parallax(shaken):
    pair = [shaken.views[0], shaken.views[2]]
    tracks = shaken.tracks((0, 2))
    parallax = {}
    for model in ("shift", "auto"):
        found = adjust(pair, tracks, 700.0, model)
        parallax[model] = tracks_of_pair(found.applied(pair), tracks, found.ground)[1]
    assert np.std(parallax["shift"]) > 0.3 and np.std(parallax["auto"]) < 0.15


def test_steady_views_get_no_waves_and_the_same_pointing():
    case = Case(0.0, count=700)
    found = adjust(case.views, case.tracks(), 700.0, "auto")
    assert not found.jitter and "jitter" not in found.reason
    for name, pointing in adjust(case.views, case.tracks(), 700.0, found.model).pointing.items():
        np.testing.assert_array_equal(pointing, found.pointing[name])
    wanted = adjust(case.views, case.tracks(), 700.0, "jitter")
    assert set(wanted.jitter) == set(found.pointing)
    assert max(max(jitter.rms_px) for jitter in wanted.jitter.values()) < 0.3


def test_few_ties_and_maps_get_no_waves(shaken):
    found = adjust(shaken.views, shaken.tracks()[:25], 700.0, "jitter")
    assert not found.jitter and "too few lines or ties for waves" in found.reason
    assert ladder([np.linspace(0, 300, 900)] * 3) == []  # so short a part of an image shows no waves
    of_a_map = replace(shaken.views[0], plane=MapPlane("EPSG:32632", (0.0, 2.0, 0.0, 0.0, 0.0, -2.0), 500.0, ""))
    assert can_jitter(shaken.views) and not can_jitter([of_a_map, *shaken.views[1:]])
    assert len(ladder([np.linspace(0, 9000, 9000)] * 40)) == 1  # many views have fewer splines each
    assert ladder([np.linspace(0, 9000, 9000)] * 40)[0].count == 1200 // 80 + 3


@pytest.mark.long
def test_good_control_points_are_not_rejected_because_the_satellite_shook(shaken):
    numbers = np.random.default_rng(8)
    gcps = []
    for k in range(0, len(shaken.ground), len(shaken.ground) // 12):
        pixels = {view.name: shaken.seen[i][k] + numbers.normal(0, 0.1, 2) for i, view in enumerate(shaken.views)}
        gcps.append(Gcp(f"P{k}", *map(float, shaken.ground[k]), "control", pixels))
    found = adjust(shaken.views, shaken.tracks(), 700.0, "auto", gcps)
    assert found.jitter and found.rejected == ()
    errors = np.array([intersect(gcp, found.applied(shaken.views)) for gcp in gcps])
    assert found.control_noise_px < 0.3 and np.sqrt(np.mean(errors**2, axis=0)).max() < 1.0
