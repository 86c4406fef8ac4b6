"""Which pairs are matched."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.errors import EmptyResultError
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.mvs.pairing import convergence
from repm_qgis.scene import Scene, Tile
from repm_qgis.sfm.view_pairs import choose_pairs


def scene_of(views, urban):
    lon, lat = views[0].rpc.lon_off, views[0].rpc.lat_off
    tile = Tile("r000c000", urban.bounds, (150.0, 250.0), {view.name: None for view in views})
    return Scene(list(views), EnuFrame(lon, lat), urban.crs, "", (150.0, 250.0), [tile])


def named(view, name):
    return view.__class__(**{**vars(view), "name": name})


def test_convergence_is_the_angle_between_the_looks(urban):
    """Rays from the middle up, in ECEF, by another path than ENU."""
    from repm_qgis.geometry.frames import ecef_from_geodetic

    a, b = urban.true_views[0], urban.true_views[2]
    place = a.localise(np.array([200.0, 200.0]), 200.0)
    rays = []
    for view in (a, b):
        pixel = view.project(place)
        ends = ecef_from_geodetic(view.localise(np.array([pixel, pixel]), np.array([190.0, 210.0])))
        rays.append((ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]))
    angle, ratio = convergence(a, b, place[0], place[1], 200.0)
    assert angle == pytest.approx(np.degrees(np.arccos(rays[0] @ rays[1])), abs=1e-3)
    looks = urban.record["views"]
    slopes = np.tan(np.radians([look["pitch_deg"] for look in looks]))
    assert ratio == pytest.approx(abs(slopes[0] - slopes[2]), rel=0.25)


def test_three_views_make_three_pairs(urban):
    pairs = choose_pairs(scene_of(urban.views, urban))
    assert len(pairs) == 3
    badness = [abs(np.log(pair.base_to_height / 0.35)) for pair in pairs]
    assert badness == sorted(badness)


def test_many_views_stay_few_pairs_and_connected(urban):
    views = [named(urban.views[i % 3], f"v{i}") for i in range(9)]
    pairs = choose_pairs(scene_of(views, urban))
    assert len(pairs) <= 3 * 9 and all(pair.base_to_height >= 0.05 for pair in pairs)
    group = {"v0"}
    for _ in views:
        for pair in pairs:
            if {pair.first, pair.second} & group:
                group |= {pair.first, pair.second}
    assert group == {view.name for view in views}


def test_views_from_the_same_place_are_refused_with_their_angle(urban):
    with pytest.raises(EmptyResultError, match="again: 0.0 degrees"):
        choose_pairs(scene_of([urban.views[0], named(urban.views[0], "again")], urban))
