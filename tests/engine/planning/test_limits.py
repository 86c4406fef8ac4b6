"""What belongs to a limit itself, and what a refusal names: without images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.errors import OptionError
from repm_qgis.contracts.records import ViewPair
from repm_qgis.planning import altitude_range, promises
from repm_qgis.planning.advice import other_season
from repm_qgis.planning.altitudes import ALTITUDES
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.scene import View


def test_a_pair_as_wide_as_is_still_matched_tells_the_height(synthetic_rpc, monkeypatch):
    views = [View(name, f"{name}.tif", 1, 1000, 1000, synthetic_rpc(), 0.5) for name in "ab"]
    monkeypatch.setattr(promises, "convergence", lambda first, second, *place: (43.6, 0.8))
    for wide, ratio in ((0.8, 0.8), (0.79, PLANNING.pairs.least_base_to_height)):
        found = promises.promised(views, replace(PLANNING, pairs=replace(PLANNING.pairs, wide=wide)))
        assert found.vertical_m == pytest.approx(np.sqrt(2.0) * found.horizontal_m / ratio)


def test_plants_differ_only_beyond_the_days_of_a_season():
    pair = ViewPair("a", "b", 20.0, 0.35, 4, sun_deg=5.0)
    season, old = PLANNING.advice.season_days, PLANNING.advice.old_days
    assert not other_season(replace(pair, days=season)) and other_season(replace(pair, days=season + 0.1))
    assert not other_season(replace(pair, days=old)) and other_season(replace(pair, days=old + 0.1))


def test_an_altitude_beyond_the_dem_is_refused_with_both_ends_of_the_ground(monkeypatch):
    monkeypatch.setattr(altitude_range, "dem_range", lambda *place: (100.0, 150.0, True))
    low, high = ALTITUDES.around_dem(100.0, 150.0)
    for given, option in (((5000.0, None), "ALTITUDE_MIN"), ((None, -400.0), "ALTITUDE_MAX")):
        with pytest.raises(OptionError, match=option) as caught:
            altitude_range.altitude_range([], "", None, search=(0.0, 1.0), given=given, dem="dem.tif", progress=None)
        assert f"the ground lies between {low:.0f} and {high:.0f} m" in str(caught.value)
