"""PROJ's grids of vertical datums, as its content network names them."""

from __future__ import annotations

import pytest

from repm_qgis.contracts.errors import OptionError
from repm_qgis.geometry.geoids import geoid_grids
from repm_qgis.geometry.vertical import LISTED


@pytest.mark.parametrize(
    ("datum", "agency", "area"),
    [
        ("EGM2008", "us_nga_egm08", "World"),
        ("EPSG:5720", "fr_ign_RA", "France"),
        ("EPSG:5701", "uk_os_OSGM", "Great Britain"),
        ("EPSG:5703", "us_noaa_g2018", "CONUS"),
        ("EPSG:5709", "nl_", "Netherlands"),
    ],
)
def test_the_best_grid_of_a_datum_is_its_agencys(datum, agency, area):
    grids = geoid_grids(datum)
    assert grids[0].name.startswith(agency) and area in grids[0].area
    assert len({grid.area for grid in grids}) == len(grids) <= 4  # earlier geoids of an area are left out


def test_datums_without_a_grid():
    assert geoid_grids("ellipsoid") == []
    with pytest.raises(OptionError, match="vertical CRS"):
        geoid_grids("EPSG:4326")
    assert sum(bool(geoid_grids(datum)) for datum in LISTED) >= len(LISTED) - 1  # PROJ 9.1 knows none of Germany's
