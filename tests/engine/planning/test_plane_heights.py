"""The heights of ortho-ready images' planes where no metadata state them."""

from __future__ import annotations

import pytest

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.geometry.map_plane import MapPlane
from repm_qgis.planning.plane_heights import with_planes
from repm_qgis.scene import View

BOUNDS = Bounds(500_000.0, 4_800_000.0, 500_100.0, 4_800_100.0)


@pytest.fixture
def planes(synthetic_rpc, told):
    """What becomes of views whose planes have these heights and sources (None: an image in sensor geometry), and what
    is said of them."""

    def found(*known):
        views = [
            View(
                f"v{number}",
                f"v{number}.tif",
                1,
                1000,
                1000,
                synthetic_rpc(),
                0.5,
                plane=None if one is None else MapPlane("EPSG:32631", (0.0, 0.5, 0.0, 0.0, 0.0, -0.5), *one),
            )
            for number, one in enumerate(known)
        ]
        said = told()
        views, search = with_planes(views, "EPSG:32631", BOUNDS, search=(100.0, 300.0), dem=None, progress=said)
        return [view.plane and (view.plane.height, view.plane.source) for view in views], search, said

    return found


def test_heights_that_are_stated_stay(planes):
    found, search, said = planes((120.0, "metadata"), (140.0, "ORTHO_READY_HEIGHT"), None)
    assert found == [(120.0, "metadata"), (140.0, "ORTHO_READY_HEIGHT"), None] and search == (100.0, 300.0)
    assert not said.warnings


def test_an_unknown_height_is_the_mean_of_the_others_which_stay(planes):
    found, search, said = planes((120.0, "metadata"), (200.0, ""), (140.0, "metadata"))
    assert found == [(120.0, "metadata"), (130.0, "the other images"), (140.0, "metadata")] and search == (100.0, 300.0)
    assert "v1 were projected: 130 m" in said.warnings[0]


def test_heights_that_nobody_states_are_assumed_and_the_ground_is_sought_further(planes):
    found, search, said = planes((150.0, ""), (190.0, ""))
    assert found == [(170.0, ""), (170.0, "")] and search[0] < 100.0 and search[1] > 300.0
    assert "170 m above the ellipsoid is assumed" in said.warnings[0]
