"""What vendors promise: of one image by its RPC, its satellite or neither, and of the ground of several."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.planning.advice import advice
from repm_qgis.planning.pair_selection import choose_pairs
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.planning.promises import promise_of, promised
from repm_qgis.pointing.pointing import point_views
from repm_qgis.scene import Scene, View, load_views
from repm_qgis.stages import run_stage
from repm_qgis.stereo.pairing import convergence


@pytest.mark.parametrize(
    ("accuracy", "sensor", "gsd", "horizontal", "vertical", "source"),
    (
        (None, "", 0.5, 20.0, None, "assumed"),
        (None, "", 2.5, 50.0, None, "assumed"),
        (None, "some new satellite", 0.5, 20.0, None, "assumed"),
        (None, "TripleSat", 0.8, 20.0, None, "assumed"),
        (None, "WorldView-3", 0.3, 3.5, None, "DigitalGlobe"),
        (None, "Pleiades 1B", 0.5, 8.5, None, "Astrium"),
        (None, "IKONOS", 1.0, 15.0, 22.0, "IKONOS"),
        (1.0, "", 0.5, 2.146, None, "ERR_BIAS"),
        (26.68, "IKONOS", 1.0, 57.26, 22.0, "ERR_BIAS"),
    ),
)
def test_the_rpcs_own_figure_comes_first_then_the_satellites(
    synthetic_rpc, accuracy, sensor, gsd, horizontal, vertical, source
):
    view = View("a", "a.tif", 1, 1000, 1000, replace(synthetic_rpc(), accuracy_m=accuracy), gsd, sensor=sensor)
    promise = promise_of(view)
    assert promise.horizontal_m == pytest.approx(horizontal, abs=0.01) and promise.vertical_m == vertical
    assert source in promise.source


def called(views, *sensors):
    return [replace(view, sensor=sensor) for view, sensor in zip(views, sensors)]


def test_heights_follow_from_the_base_where_the_vendor_publishes_none(urban):
    first, second = urban.views[:2]
    place = first.rpc.lon_off, first.rpc.lat_off, first.rpc.height_off
    ratio = convergence(first, second, *place)[1]
    assert 0.1 < ratio < 0.9
    found = promised(called((first, second), "Pleiades 1A", "Pleiades 1A"))
    assert found.horizontal_m == pytest.approx(8.5 / 2.146)
    assert found.vertical_m == pytest.approx(np.sqrt(2) * found.horizontal_m / ratio, rel=0.02)
    # One of two vendors is not enough; both are.
    mixed = promised(called((first, second), "IKONOS", "Pleiades 1A"))
    assert mixed.horizontal_m == pytest.approx(np.hypot(15.0, 8.5) / np.sqrt(2) / 2.146)
    assert mixed.vertical_m == pytest.approx(np.sqrt(2) * mixed.horizontal_m / ratio, rel=0.02)
    assert promised(called((first, second), "IKONOS", "ZY-3")).vertical_m == pytest.approx(22.0 / 1.645)


def test_errors_that_are_drawn_as_promised_scatter_as_the_deviations_say(urban):
    """Two lines of sight, each moved on the ground by independent errors: where they intersect."""
    views = called(urban.views[:2], "Pleiades 1A", "Pleiades 1A")
    found, rng = promised(views), np.random.default_rng(3)
    lon, lat, height = views[0].rpc.lon_off, views[0].rpc.lat_off, views[0].rpc.height_off
    slopes = []
    for view in views:
        pixel = view.project(np.array([lon, lat, height]))
        ends = view.localise(np.array([pixel, pixel]), np.array([height - 50, height + 50]))
        metres = np.radians(1) * 6371e3 * np.array([np.cos(np.radians(lat)), 1.0])
        slopes.append((ends[1] - ends[0])[:2] * metres / 100)
    base = slopes[0] - slopes[1]
    moved = rng.normal(0, 8.5 / 2.146, (20000, 2, 2))
    # Least squares: h minimises |e0 + s0 h - e1 - s1 h|.
    up = -((moved[:, 0] - moved[:, 1]) @ base) / (base @ base)
    assert np.std(up) == pytest.approx(found.vertical_m, rel=0.03)


def test_a_narrow_pair_and_one_image_have_no_certain_height(urban):
    one = promised(urban.views[:1])
    assert one == promised([urban.views[0]] * 2) and one.vertical_m == pytest.approx(
        np.sqrt(2) * one.horizontal_m / 0.05
    )


def test_a_pair_that_is_too_wide_to_be_matched_does_not_make_heights_certain(urban):
    found = [promised(pair) for pair in combinations(urban.views, 2)]
    ratios = sorted(np.sqrt(2) * each.horizontal_m / each.vertical_m for each in found)
    assert ratios[1] < ratios[2] * 0.99
    narrow = promised(urban.views, replace(PLANNING, pairs=replace(PLANNING.pairs, wide=ratios[2] * 0.995)))
    assert narrow.vertical_m == pytest.approx(np.sqrt(2) * narrow.horizontal_m / ratios[1], rel=0.02)
    assert narrow.vertical_m > promised(urban.views).vertical_m


def test_real_images(shared_data):
    wv3 = load_views(sorted(map(str, (shared_data / "jax_068").glob("*_RGB.tif"))))
    assert {view.sensor for view in wv3} == {"WorldView-3"} and len(wv3) == 19
    assert promised(wv3).horizontal_m == pytest.approx(3.5 / 2.146) and 1.5 < promised(wv3).vertical_m < 4.0
    ntf = load_views(sorted(map(str, (shared_data / "rpc" / "other").glob("wv3_*.NTF"))))
    assert {view.sensor for view in ntf} == {""}  # GDAL wrote these crops without any name
    assert promise_of(ntf[0]).horizontal_m == pytest.approx(2.146 * np.hypot(0.87, 0.33))


def warnings_of_rpcs(folder, told, images, altitudes, wrong_px=0.0):
    """What the pointing of real images warns of their RPCs; the second RPC is wrong by so many columns."""
    options = {"images": list(map(str, images)), "altitude_min": altitudes[0], "altitude_max": altitudes[1]}
    fitted = run_stage("epmfit", {**options, "workspace": str(folder)}, told()).scene
    scene = replace(Scene.load(fitted), refinement="polynomial")
    first, second, *others = scene.views
    moved = replace(second, rpc=second.rpc.shifted(-wrong_px, 0.0))
    scene = replace(scene, views=(first, moved, *others))
    pairs, said = choose_pairs(scene), told()
    stretches = {view.name: view_stretch(view.image, view.band) for view in scene.views}
    figures = point_views(scene, pairs, stretches, model="auto", gcps=[], progress=said).figures
    assert any(f"uncertain by {1.645 / 2 * figures.height_uncertainty_m:.1f} m (LE90" in text for text in said.notes)
    assert any("CE90" in text for text in said.notes)
    return scene, [text for text in advice(scene, pairs, figures) if "RPC" in text]


REAL = (
    ("pleiades_pair", "img_0[12].tif", (2200.0, 2450.0)),
    ("pleiades_triplet", "img_0[123].tif", (100.0, 250.0)),
    ("truth_urban", "img_0[12].tif", (0.0, 140.0)),
    ("jax_068", "JAX_068_00[235]_RGB.tif", (-30.0, 60.0)),
)


@pytest.mark.parametrize(("folder", "names", "altitudes"), REAL)
@pytest.mark.slow
def test_ordinary_real_images_are_not_warned_of(shared_data, tmp_path, told, folder, names, altitudes):
    images = sorted((shared_data / folder).glob(names))
    assert len(images) >= 2 and warnings_of_rpcs(tmp_path, told, images, altitudes)[1] == []


@pytest.mark.parametrize(("folder", "names", "altitudes"), REAL)
@pytest.mark.slow
def test_an_rpc_that_is_wrong_by_60_px_is(shared_data, tmp_path, told, folder, names, altitudes):
    images = sorted((shared_data / folder).glob(names))
    scene, texts = warnings_of_rpcs(tmp_path, told, images, altitudes, 60.0)
    assert len(texts) == 1 and scene.views[1].name in texts[0] and "CE90" in texts[0]
    assert len(images) == 2 or f"({scene.views[1].name} is in all of these pairs)" in texts[0]


@pytest.mark.long
def test_a_real_image_whose_rpc_is_off_by_ten_metres_is_found(shared_data, tmp_path, told):
    """JAX_068_016 contradicts all other images of the place, and its vendor promises 3.5 m."""
    images = [shared_data / "jax_068" / f"JAX_068_0{number}_RGB.tif" for number in (15, 16, 20)]
    _, texts = warnings_of_rpcs(tmp_path, told, images, (-30.0, 60.0))
    assert len(texts) == 1 and "(JAX_068_016_RGB is in all of these pairs)" in texts[0]
