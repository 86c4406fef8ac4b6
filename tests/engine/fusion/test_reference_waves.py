"""Waves that a reference shows: height maps follow the views, and what was put into a reference is found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.records import GroundShift, RegistrationFigures
from repm_qgis.fusion.reference_waves import with_reference_waves
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.geometry.jitter import Jitter
from repm_qgis.matching.backends import height_source, wave_geometry
from repm_qgis.numerics.robust import nmad
from repm_qgis.registration.surfaces import Reference
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage

WIDTH = 6.0


def registered(scene, **more):
    """The scene as a registration leaves it that moves nothing."""
    none = GroundShift((0.0, 0.0, 0.0))
    matched = {view.name: view.pointing for view in scene.views}
    figures = RegistrationFigures(none, matched, none, (0.1,) * 3, (), False, (5.0, 5.0), 0.0, (), **more)
    return replace(scene, registration=figures)


@pytest.fixture(scope="module")
def steady(mountains_run):
    return registered(Scene.load(str(mountains_run.workspace / "reconstructed.json")))


@pytest.fixture(scope="module")
def shaken(steady):
    """The same with waves along the parallax of its first and last view, which its maps were not matched with."""
    level = {view.name: Jitter(0.0, view.height - 1.0, np.zeros((12, 2))) for view in steady.views}
    tile, views = steady.tiles[0], {v.name: v.with_pointing(v.pointing, level[v.name]) for v in steady.views}
    record = next(each for each in tile.heights if set(each.pair) == {steady.views[0].name, steady.views[2].name})
    geometry = wave_geometry(steady, tile.bounds, record, steady.crs)
    for name, along, seed in zip(record.pair, geometry.along, (1, 2)):
        view, angle = views[name], 2 * np.pi * np.arange(12) / 8.0 + seed
        waves = Jitter(0.0, view.height - 1.0, 0.6 * np.sin(angle)[:, None] * along)
        views[name] = view.with_pointing(view.pointing, waves)
    return registered(replace(steady, views=tuple(views.values())), waves_m=(1.0, 1.0))


def points_of(scene, pair):
    """(N, 3) x, y, height of every fourth pixel of a pair's map, where it has one."""
    tile = scene.tiles[0]
    record = next(each for each in tile.heights if each.pair == pair)
    found = height_source(scene, tile.bounds, record, scene.crs).read(None, 4)
    return np.stack([found.x, found.y, found.height], axis=-1)


def test_a_map_follows_waves_that_were_found_later(steady, shaken):
    pair = next(
        record.pair
        for record in steady.tiles[0].heights
        if set(record.pair) == {steady.views[0].name, steady.views[2].name}
    )
    before, after = (points_of(scene, pair) for scene in (steady, shaken))
    known = np.isfinite(before[..., 2]) & np.isfinite(after[..., 2])
    assert 0.3 < nmad((after - before)[known][:, 2]) < 3.0
    for name in pair:  # the pixels of a point stay where they are
        pixels = []
        for scene, points in ((steady, before), (shaken, after)):
            place = np.column_stack([geodetic_from_projected(scene.crs, points[known][:, :2]), points[known][:, 2]])
            pixels.append(scene.view(name).project(place))
        assert np.abs(pixels[1] - pixels[0]).max() < 0.08  # of 0.6 px: effects are those of the frame's middle
    assert shaken.as_matched.views[0].jitter is None and shaken.waves_changed and not steady.waves_changed


def reference_of(scene):
    """Means of a map's points in cells, as a DEM without errors has them."""
    pair = (scene.views[0].name, scene.views[2].name)
    pair = pair if any(record.pair == pair for record in scene.tiles[0].heights) else pair[::-1]
    xyz = points_of(scene, pair).reshape(-1, 3)
    xyz = xyz[np.isfinite(xyz[:, 2])]
    cell = np.floor(xyz[:, :2] / WIDTH).astype(int)
    _, which, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    which = which.ravel()
    means = np.bincount(which, xyz[:, 2]) / count
    corners = np.stack([np.bincount(which, cell[:, k]) / count for k in (0, 1)], axis=1)
    return Reference("dem", np.column_stack([(corners + 0.5) * WIDTH, means])[count >= 2], (WIDTH, WIDTH))


def test_waves_of_a_reference_are_found_and_taken_out(steady, shaken, told):
    reference, said = reference_of(shaken), told()
    found = with_reference_waves(steady, [reference], 1, memory=0, progress=said)
    assert found.registration.waves_m[1] < 0.6 * found.registration.waves_m[0]
    assert any("shows jitter along the parallax" in text for text in said.notes)
    before, after, wanted = (reference_of(scene) for scene in (steady, found, shaken))
    far = [_difference(each, wanted) for each in (before, after)]
    assert far[1] < 0.6 * far[0]
    assert with_reference_waves(steady, [reference_of(steady)], 1, memory=0, progress=told()) is steady
    assert found.as_matched.views[0].jitter is None
    again = Scene.load(found.save(str(found.path.with_name("waves.json"))))
    assert again.registration.waves_m == found.registration.waves_m


@pytest.mark.long
def test_registering_again_keeps_what_the_maps_were_matched_with(steady, shaken, mountains, tmp_path, told):
    path, said = shaken.save(str(tmp_path / "shaken.json")), told()
    options = {"scene": path, "reference": [mountains.truth], "output_scene": str(tmp_path / "again.json")}
    run_stage("register", {**options, "workers": 1}, said)
    again = Scene.load(options["output_scene"])
    assert again.waves_changed and again.as_matched.views[0].jitter is None
    # The reference is without waves: those of the scene are found to be wrong, and taken out again.
    assert any("shows jitter along the parallax" in text for text in said.notes)
    left = [max(view.jitter.rms_px) for view in again.views if view.jitter]
    assert max(left) < 0.7 * max(max(view.jitter.rms_px) for view in shaken.views if view.jitter)


def _difference(first, second):
    """Of the heights in common cells, less a plane: a trend is the pointing's."""
    heights = {tuple(place): height for *place, height in first.xyz.tolist()}
    common = np.array(
        [(*place, z - heights[tuple(place)]) for *place, z in second.xyz.tolist() if tuple(place) in heights]
    )
    plane = np.column_stack([np.ones(len(common)), common[:, :2] - common[:, :2].mean(axis=0)])
    return nmad(common[:, 2] - plane @ np.linalg.lstsq(plane, common[:, 2], rcond=None)[0])
