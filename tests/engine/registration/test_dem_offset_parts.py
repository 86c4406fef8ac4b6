"""What is stated of a scene's absolute height, and the sign of a DSM's offset from its DEM: by hand calculation."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.registration import dem_offset as module
from repm_qgis.registration.dem_offset import dem_offset, stated_height_deviation
from repm_qgis.registration.parameters import REGISTRATION
from repm_qgis.registration.solve import Prior


def scene(registration=None, pointing=None):
    return SimpleNamespace(registration=registration, pointing=pointing, dem="dem.tif")


def ties(height_uncertainty_m=None, control_information=None):
    return SimpleNamespace(height_uncertainty_m=height_uncertainty_m, control_information=control_information)


def test_the_height_is_stated_by_the_registration_then_the_rpcs_then_the_control():
    placed = SimpleNamespace(deviation=(1.0, 2.0, 0.3))
    assert stated_height_deviation(scene(placed, ties(9.0))) == 0.3
    assert stated_height_deviation(scene(None, ties(9.0))) == 4.5  # stated as two deviations
    information = np.array([[4.0, 0.0, 2.0], [0.0, 1.0, 0.0], [2.0, 0.0, 17.0]])
    # Without east and north, which are adjusted too: 1 / (17 - 2 * 2 / 4).
    assert stated_height_deviation(scene(None, ties(None, information))) == pytest.approx(0.25)
    assert stated_height_deviation(scene()) is None and stated_height_deviation(scene(None, ties())) is None


def test_a_surface_that_must_be_lowered_lies_above_its_dem(monkeypatch):
    shift = SimpleNamespace(moved=(1.0, 2.0, -42.0), deviations=(5.0, 6.0, 0.7), other_relief=None)
    monkeypatch.setattr(module, "read_reference", lambda *where: SimpleNamespace(datum=None))
    monkeypatch.setattr(module, "in_datum", lambda found, crs, datum: found)
    monkeypatch.setattr(module, "SupportMeans", lambda *what: None)
    monkeypatch.setattr(module, "solve_shift", lambda *what, **how: shift)
    grid = SimpleNamespace(bounds=Bounds(0.0, 0.0, 100.0, 100.0), cell=1.0)
    found = dem_offset(scene(None, ties(9.0)), "EPSG:32631", grid, height=np.zeros((2, 2)), prior=Prior(8.0, 5.0, 60.0))
    assert (found.up_m, found.deviation_m) == (42.0, 0.7)
    assert found.most_m == pytest.approx(REGISTRATION.unexpected * math.hypot(4.5, 0.7, REGISTRATION.dem_m))
    assert found.unexpected and "42.0 m above the DEM 'dem.tif'" in found.sentence()
