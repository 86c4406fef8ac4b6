"""RPCs fitted to the simulated sensor, on points that the fit has not seen."""

import numpy as np
import pytest

from repm_qgis.contracts.errors import RpcInvalidError
from repm_qgis.rpc.fit import fit_rpc
from repm_qgis.rpc.grid import virtual_grid
from repm_qgis.simulation.sensor import GF7, PLEIADES, ZY3, aim


@pytest.mark.parametrize(
    "sensor, size, heights",
    [
        (PLEIADES, 800, (150.0, 270.0)),
        (PLEIADES, 20000, (0.0, 2000.0)),
        (ZY3, 5120, (380.0, 1920.0)),
        (GF7, 8000, (0.0, 500.0)),
    ],
    ids=lambda v: getattr(v, "name", None),
)
def test_rpc_is_the_sensor(sensor, size, heights):
    rng = np.random.default_rng(5)
    for number, look in enumerate(sensor.looks):
        view = aim(
            sensor, look, (6.65, 44.38, np.mean(heights)), size=(size, size), heading_deg=191.0, seed=number, name="v"
        )
        fit = fit_rpc(view.localise, view.size, heights)
        ground = view.localise(rng.uniform(-0.5, size - 0.5, (4000, 2)), rng.uniform(*heights, 4000))
        error = np.linalg.norm(fit.rpc.project(ground) - view.project(ground), axis=1)
        assert error.max() < 0.01
        assert error.max() <= 1.5 * fit.max_px + 2e-6  # the residual it states is honest
        assert fit.rms_px <= fit.max_px
        assert fit.rpc.height_range == pytest.approx(heights)


def test_denominators_stay_near_one():
    view = aim(ZY3, ZY3.looks[0], (6.65, 44.38, 1000.0), size=(5120, 5120), heading_deg=191.0, seed=1, name="v")
    rpc = fit_rpc(view.localise, view.size, (400.0, 1900.0)).rpc
    ground = view.localise(*virtual_grid((5120, 5120), (400.0, 1900.0), (12, 12, 5)))
    lon, lat, h = (
        (ground - [rpc.lon_off, rpc.lat_off, rpc.height_off]) / [rpc.lon_scale, rpc.lat_scale, rpc.height_scale]
    ).T
    terms = np.stack(
        [
            np.ones_like(lon),
            lon,
            lat,
            h,
            lon * lat,
            lon * h,
            lat * h,
            lon**2,
            lat**2,
            h**2,
            lon * lat * h,
            lon**3,
            lon * lat**2,
            lon * h**2,
            lon**2 * lat,
            lat**3,
            lat * h**2,
            lon**2 * h,
            lat**2 * h,
            h**3,
        ]
    )
    for denominator in (rpc.row_den, rpc.col_den):
        np.testing.assert_allclose(np.array(denominator) @ terms, 1.0, atol=0.1)


def test_a_flat_height_range_or_a_blind_sensor_is_refused():
    view = aim(PLEIADES, PLEIADES.looks[0], (1.44, 43.6, 200.0), size=(200, 200), heading_deg=191.0, seed=1, name="v")
    with pytest.raises(RpcInvalidError, match="range"):
        fit_rpc(view.localise, view.size, (200.0, 200.0))
    with pytest.raises(RpcInvalidError, match="no ground point"):
        fit_rpc(lambda pixels, heights: np.full((len(pixels), 3), np.nan), (200, 200), (0.0, 100.0))
