"""What the pinhole model costs: on full Pleiades scenes as docs/benchmarks.md has it, and by the paper's formula."""

from __future__ import annotations

import re

import numpy as np
import pytest

from repm_qgis.geometry.equivalent_error import (
    EquivalentError,
    fit_pinhole,
    predicted_error,
    refine_pinhole,
    virtual_grid,
)
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.geometry.parameters import VIRTUAL_GRID
from repm_qgis.rpc.readers import read_rpc_file

# docs/benchmarks.md: RMSE and max in px, uncorrected and after the polynomial of second order.
TABLE = {
    "giza": ((22.5, 64.4), (1.23, 4.66)),
    "toulouse": ((19.0, 52.0), (1.13, 4.05)),
    "calanques": ((5.50, 20.5), (4.37, 13.0)),
    "ubaye": ((8.86, 25.7), (6.37, 19.4)),
    "ossoue": ((14.0, 48.0), (13.9, 44.2)),
}


def full_scene(shared_data, site):
    """The site's first RPC, and the window of the whole image: RFM_Validity's last column and row are its size."""
    path = sorted((shared_data / "rpc" / "pleiades").glob(f"{site}__*.XML"))[0]
    text = path.read_text()
    text = text[text.index("<RFM_Validity>") :]
    size = [int(re.search(f"<LAST_{name}>([0-9]+)<", text).group(1)) for name in ("COL", "ROW")]
    return read_rpc_file(str(path)), (0, 0, *size)


def measured(rpc, window, altitudes):
    grid = virtual_grid(rpc.localise, window, altitudes, EnuFrame(rpc.lon_off, rpc.lat_off, 0.0))
    return grid, fit_pinhole(grid)


@pytest.mark.parametrize("site", TABLE)
def test_full_scenes_are_as_designed(shared_data, site):
    rpc, window = full_scene(shared_data, site)
    grid, fitted = measured(rpc, window, rpc.height_range)
    refined = refine_pinhole("polynomial", fitted.camera, grid, window=window)
    for error, (rmse, largest) in zip((fitted.error, refined.error), TABLE[site]):
        assert error.rmse == pytest.approx(rmse, rel=0.006)
        assert error.max == pytest.approx(largest, rel=0.006)
    homography = refine_pinhole("homography", fitted.camera, grid, window=window)
    assert homography.error.rmse == pytest.approx(fitted.error.rmse, rel=1e-3)
    none = refine_pinhole("none", fitted.camera, grid, window=window)
    assert none.error.rmse == pytest.approx(fitted.error.rmse, rel=1e-6)


def test_the_grid_sits_in_window_and_altitudes_and_is_seen_where_it_says(synthetic_rpc):
    rpc, window = synthetic_rpc(), (5000, 7000, 1600, 1200)
    frame = EnuFrame(rpc.lon_off, rpc.lat_off, 0.0)
    grid = virtual_grid(rpc.localise, window, (200.0, 700.0), frame)
    assert len(grid.pixels) == np.prod(VIRTUAL_GRID.scene)
    assert grid.pixels.min(axis=0).tolist() == [5000, 7000] and grid.pixels.max(axis=0).tolist() == [6599, 8199]
    assert (grid.ground[:, 2].min(), grid.ground[:, 2].max()) == (200.0, 700.0)
    np.testing.assert_allclose(rpc.project(grid.ground), grid.pixels, atol=1e-6)
    np.testing.assert_allclose(grid.enu, frame.from_geodetic(grid.ground), atol=1e-9)


def test_statistics_are_what_the_paper_calls_them():
    error = EquivalentError.of(np.array([[3.0, 4.0], [0.0, 0.0], [-3.0, 4.0]]), 9.0)
    assert error.samp_rmse == pytest.approx(np.sqrt(18 / 3)) and error.line_rmse == pytest.approx(np.sqrt(32 / 3))
    assert error.rmse == pytest.approx(np.sqrt(50 / 3)) and error.max == pytest.approx(5.0)
    assert EquivalentError(**error.to_mapping()) == error


def test_predicted_error_is_the_papers_formula(urban):
    view = urban.true_views[0]
    grid, fitted = measured(view.rpc, (20, 30, 300, 200), (150.0, 250.0))
    depth = (np.column_stack([grid.enu, np.ones(len(grid.enu))]) @ fitted.camera.P.T)[:, 2]
    x = np.hypot(grid.pixels[:, 0] - 169.5, grid.pixels[:, 1] - 129.5)
    worst = np.max(np.abs(x * (depth - depth.mean()) / depth.mean()))
    assert predicted_error(fitted.camera, grid) == pytest.approx(worst, rel=1e-6)
    assert fitted.error.predicted == pytest.approx(worst, rel=1e-6)
    # It is a bound for the pure altitude effect: half the window's diagonal, times half the range, over the distance.
    assert worst == pytest.approx(np.hypot(149.5, 99.5) * 50 / np.median(depth), rel=0.1)


def test_the_error_grows_with_the_window_and_the_refined_image_holds_it(shared_data):
    rpc, _ = full_scene(shared_data, "ossoue")
    rmse = []
    for side in (1000, 2500, 5120):
        window = (19000 - side // 2, 18000 - side // 2, side, side)
        grid, fitted = measured(rpc, window, rpc.height_range)
        refined = refine_pinhole("polynomial", fitted.camera, grid, window=window)
        corners = np.array(
            [
                [window[0], window[1]],
                [window[0] + side - 1, window[1] + side - 1],
                [window[0] + side - 1, window[1]],
                [window[0], window[1] + side - 1],
            ]
        )
        inside = refined.to_original.refined_from_original(corners)
        assert (inside >= -1e-3).all() and (inside <= np.array(refined.size) - 1 + 1e-3).all()
        assert abs(refined.size[0] - side) < 0.1 * side and refined.camera.K[0, 1] == 0
        rmse.append(fitted.error.rmse)
    assert rmse[0] < rmse[1] < rmse[2]
    assert rmse[2] == pytest.approx(1.85, rel=0.05)  # the central tile


def test_the_refined_camera_sees_what_m_says(shared_data):
    rpc, window = full_scene(shared_data, "toulouse")
    grid, fitted = measured(rpc, window, rpc.height_range)
    for model in ("none", "homography", "polynomial"):
        refined = refine_pinhole(model, fitted.camera, grid, window=window)
        difference = refined.to_original.original_from_refined(refined.camera.project(grid.enu)) - grid.pixels
        assert np.sqrt((difference**2).sum(axis=1).mean()) == pytest.approx(refined.error.rmse, rel=1e-6)
        assert np.sqrt((difference**2).sum(axis=1).max()) == pytest.approx(refined.error.max, rel=1e-6)
