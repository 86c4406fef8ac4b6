"""Findings of the verdict that need no scene: at and beyond each bound, with the figures they name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from repm_qgis.contracts.records import GroundShift, OtherRelief, ReferenceFigures, RegistrationFigures
from repm_qgis.evaluation.gcp_accuracy import GcpAccuracy
from repm_qgis.evaluation.metrics import HeightMetrics
from repm_qgis.pointing.ground_control import Gcp
from repm_qgis.reports import verdict
from repm_qgis.reports.parameters import VERDICT
from repm_qgis.rpc.correction import DELIVERED


def reference(name, seen, used, other_relief=None):
    no = (0.0, 0.0, 0.0)
    return ReferenceFigures(
        name, "d", "f", (1.0, 1.0), seen, used, no, no, (), 2.0, 1.0, 0.0, 30.0, other_relief=other_relief
    )


def registration(moved=(1.0, 1.0, 1.0), references=(), directions=2):
    return RegistrationFigures(
        shift=GroundShift(moved),
        matched={},
        latest=GroundShift(moved),
        deviation=(0.5, 0.5, 0.5),
        determined=((1.0, 0.0), (0.0, 1.0))[:directions],
        control=False,
        promised_m=(8.5, 9.0),
        pointing_px=0.1,
        references=tuple(references),
    )


def test_a_registration_within_what_vendors_promise_is_good():
    half = reference("/far/dem.tif", 10_000, 5_000)  # exactly the least share: a forest leaves less than that
    assert verdict.of_registration(registration(references=[half])) == []


def test_a_position_that_is_not_determined_has_its_own_cause():
    """Of a real town's lidar, with a relief of 42 m, it was said that flat ground only determines the height."""
    good = reference("lidar.tif", 6146, 5449)
    (town,) = verdict.of_registration(registration(references=[replace(good, unsure_m=(0.65, 0.49))], directions=0))
    assert town.id == "position-unsure" and "deviation of 0.65 m (needed: 0.49 m)" in town and "Flat" not in town
    for flat in (None, (30.0, 0.49)):
        (plain,) = verdict.of_registration(registration(references=[replace(good, unsure_m=flat)], directions=0))
        assert plain.id == "relief-level"
    causes = {
        OtherRelief(0.0, 770.0): "'d.tif' has no relief, and the surface has: choose one",
        OtherRelief(0.0, 0.001): "The surface has no relief, and 'd.tif' has",
        OtherRelief(
            -0.01, 1.6
        ): "not that of 'd.tif' (correlation -0.01, 1.60 times as high): it may be of another place",
    }
    for other, words in causes.items():
        found = verdict.of_registration(registration(references=[reference("d.tif", 9, 8, other)], directions=0))
        assert [each.id for each in found] == ["relief-other"] and words in found[0]


def test_a_registration_is_judged_by_relief_shift_and_agreement():
    (plain,) = verdict.of_registration(registration(directions=1))
    assert "does not determine the horizontal position" in plain
    (far,) = verdict.of_registration(registration(moved=(6.0, 8.0, 0.0)))
    assert "The shift of 10.0 m horizontally is more than expected (nine of ten scenes need at most 8.5 m" in far
    (high,) = verdict.of_registration(registration(moved=(0.0, 0.0, -33.0)))
    assert "The shift of 33.0 m in height is more than expected (nine of ten scenes need at most 9.0 m" in high
    few = [reference("/far/good.tif", 100, 90), reference("/far/other.tif", 1000, 240)]
    (share,) = verdict.of_registration(registration(references=few))
    assert share.startswith("Only 24 % of the heights of 'other.tif' agree") and "at least 50 %" in share
    # No height of a reference lies on the surface: none agrees, and nothing is divided by zero.
    (none,) = verdict.of_registration(registration(references=[reference("dem.tif", 0, 0)]))
    assert none.startswith("Only 0 % of the heights of 'dem.tif'")
    (turned,) = verdict.of_registration(registration(references=[reference("/x/d.tif", 9, 8, OtherRelief(-0.9, 1.0))]))
    assert "not that of 'd.tif' (correlation -0.90" in turned and "upside down" in turned


def test_one_height_that_agrees_is_the_whole_of_a_reference_of_one():
    most = replace(VERDICT, least_used_share=0.9)
    assert verdict.of_registration(registration(references=[reference("one.csv", 1, 1)]), most) == []


def test_a_change_is_judged_by_share_shift_and_level():
    assert verdict.of_change(0.3, (0.0, 0.0, -10.0), 3.0) == []  # the bounds themselves
    (most,) = verdict.of_change(0.42, (0.0, 0.0, 0.0), 1.0)
    assert "42 % of the ground changed (usual: at most 30 %)" in most
    for dz in (-46.2, 46.2):
        (shift,) = verdict.of_change(0.1, (0.0, 0.0, dz), 1.0)
        assert f"differ by {dz:+.1f} m as a whole" in shift
    (beside,) = verdict.of_change(0.1, (-6.0, 8.1, 0.0), 1.0)
    assert "lie 10.1 m beside each other" in beside
    (level,) = verdict.of_change(0.1, (0.0, 0.0, 0.0), 4.5)
    assert "Only changes of more than 4.5 m" in level and "at most 3 m" in level


def exported(method, most_px):
    return SimpleNamespace(method=method, max_px=most_px)


def test_exported_rpcs_are_judged_by_what_they_cannot_hold():
    (none,) = verdict.of_rpcs({"a": exported(DELIVERED, 0.0), "b": exported(DELIVERED, 0.0)})
    assert "RPCs as delivered" in none
    # One view that stays as it was, beside a corrected one, is no missing correction: it is the one that the others
    # were laid onto.
    assert verdict.of_rpcs({"a": exported(DELIVERED, 0.0), "b": exported("shifted", 0.0005)}) == []
    (large,) = verdict.of_rpcs({"a": exported("shifted", 0.0005), "b": exported("fitted", 0.25)})
    assert "RPC of b differs" in large and "0.250 px (usual: at most 0.01 px)" in large


def metrics(bias=0.0, nmad=1.0, cells=60):
    return HeightMetrics(cells, 100, 1.0, 1.0, 1.0, nmad, bias, 1.0, ())


def test_a_comparison_at_its_bounds_is_good_and_beyond_them_not():
    assert verdict.of_comparison(metrics(bias=-2.0, nmad=1.0)) == []  # two NMADs
    assert verdict.of_comparison(metrics(bias=0.5, nmad=0.1)) == []  # five NMADs, but half a metre
    assert verdict.of_comparison(metrics(nmad=10.0)) == verdict.of_comparison(metrics(cells=50)) == []
    (low,) = verdict.of_comparison(metrics(bias=-2.1, nmad=1.0))
    assert "differ by -2.10 m as a whole" in low
    (spread,) = verdict.of_comparison(metrics(nmad=10.4))
    assert "spread by 10.4 m" in spread and "at most 10 m" in spread
    (coarse,) = verdict.of_comparison(metrics(nmad=46.0), 30.0)
    assert "at most 30 m" in coarse
    (cover,) = verdict.of_comparison(metrics(cells=49))
    assert "covers only 49.0 %" in cover


def test_a_mosaic_names_the_overlap_that_is_worst():
    apart = [
        verdict.Difference(1, 2, -3.0, 0.2),
        verdict.Difference(2, 3, 2.0, 0.2),
        verdict.Difference(3, 4, 0.0, 0.2),
    ]
    (finding,) = verdict.of_mosaic(apart)
    assert "after the offsets: 2 of 3, at most 3.00 m (DSMs 1 and 2)" in finding
    other = [
        verdict.Difference(1, 2, 0.0, 12.0),
        verdict.Difference(2, 3, 0.0, 117.0),
        verdict.Difference(3, 4, 0.0, 10.0),
    ]
    (finding,) = verdict.of_mosaic(other)
    assert "2 of 3; those of DSMs 2 and 3 differ by 117.0 m (NMAD; usual: at most 10 m)" in finding


def checked(up, pixels, wrong=()):
    """Points whose DSM is off by ``up`` m, and that images miss by (across, along) px."""
    gcps = [Gcp(f"P{k}", 1.0 + k / 1e4, 43.0, 100.0, "check", {"a": np.zeros(2)}) for k in range(len(up))]
    errors = np.full((len(up), 3), np.nan)
    errors[:, 2] = up
    return GcpAccuracy(gcps, {"dsm": errors}, {"scene": [{"a": np.array(each)} for each in pixels]}, wrong=wrong)


def test_four_points_are_enough_and_one_that_is_wrong_counts_for_nothing():
    near = [(0.2, 0.0)] * 4
    assert verdict.of_points(checked([0.1, -0.1, 0.2, 0.0], near)) == []
    far = [*near, (300.0, 0.0), (300.0, 0.0), (300.0, 0.0), (300.0, 0.0), (300.0, 0.0)]
    high = [0.1, -0.1, 0.2, 0.0, 90.0, 90.0, 90.0, 90.0, 90.0]
    wrong = tuple(f"P{k}" for k in range(4, 9))
    assert verdict.of_points(checked(high, far, wrong)) == []


def test_what_points_miss_the_images_by_is_a_distance_in_both_directions():
    (finding,) = verdict.of_points(checked([0.0] * 4, [(1.2, 1.6)] * 4))
    assert "in the images is 2.00 px" in finding
    assert verdict.of_points(checked([0.0] * 4, [(1.2, 0.9)] * 4)) == []  # 1.5 px: the bound


def test_heights_of_points_are_judged_against_their_own_spread():
    near = [(0.2, 0.0)] * 5
    spread = np.array([-3.0, -1.5, 0.0, 1.5, 3.0])  # NMAD 2.2 m
    assert verdict.of_points(checked(spread + 4.0, near)) == []
    (finding,) = verdict.of_points(checked(spread - 5.0, near))
    assert "differ from the points' by -5.00 m as a whole" in finding
    assert verdict.of_points(checked(spread / 100 + 0.5, near)) == []
    # The DSM has no height at any point: its heights cannot be judged, and are not.
    assert verdict.of_points(checked([np.nan] * 5, near)) == []


def camera(fitted, refined=None):
    done = None if refined is None else SimpleNamespace(error=SimpleNamespace(rmse=refined))
    return SimpleNamespace(error=SimpleNamespace(rmse=fitted), refined=done)


def run_of(warnings=((),), cameras=None, **others):
    """A scene as a verdict sees it: what its stages warned of, tie points, a registration, the cameras of tiles."""
    ties = SimpleNamespace(after_px=0.5, pairs=(), rejected_gcps=())
    members = {"pointing": ties, "registration": None, **others}
    tiles = [SimpleNamespace(views=cameras or {"a": camera(0.5, 0.3), "b": camera(0.2, 0.1)})]
    return SimpleNamespace(tiles=tiles, history=[SimpleNamespace(warnings=each) for each in warnings], **members)


def covered(percent, offset=None):
    return SimpleNamespace(valid_percent=percent, dem_offset=offset)


def test_a_run_at_its_bounds_is_good_and_what_it_lacks_is_not_judged():
    pair = SimpleNamespace(pair=("a", "b"), after_px=0.5)
    ties = SimpleNamespace(after_px=0.5, pairs=(pair,), rejected_gcps=())
    assert verdict.of_run(run_of(pointing=ties), covered(80.0)) == []
    assert verdict.of_run(run_of(pointing=None)) == verdict.of_run(run_of(cameras={"a": camera(0.9)})) == []
    expected = SimpleNamespace(unexpected=False, sentence=lambda: "x")
    assert verdict.of_run(run_of(), covered(99.0, expected)) == []


def test_each_figure_of_a_run_beyond_its_bound_is_one_finding():
    (few,) = verdict.of_run(run_of(), covered(60.0))
    assert "Only 60 % of the ground" in few and "at least 80 %" in few
    offset = SimpleNamespace(unexpected=True, sentence=lambda: "42 m above the DEM.")
    assert verdict.of_run(run_of(), covered(99.0, offset)) == ["42 m above the DEM."]
    pairs = [SimpleNamespace(pair=("a", "b"), after_px=0.2), SimpleNamespace(pair=("a", "c"), after_px=14.03)]
    ties = SimpleNamespace(after_px=0.3, pairs=pairs, rejected_gcps=())
    (parallax,) = verdict.of_run(run_of(pointing=ties))
    assert parallax.startswith("a and c keep a vertical parallax of 14.03 px (usual: at most 0.5 px)")
    block = [SimpleNamespace(pair=("a", str(number)), after_px=1.0 + number) for number in range(40)]
    found = verdict.of_run(run_of(pointing=SimpleNamespace(after_px=0.3, pairs=block, rejected_gcps=())))
    assert len(found) == 6 and found[0].startswith("a and 39 keep a vertical parallax of 40.00 px")
    assert found[-1] == "The same holds for 35 more pairs: see 'Tie points'."
    (residual,) = verdict.of_run(run_of(pointing=SimpleNamespace(after_px=0.7, pairs=(), rejected_gcps=())))
    assert "tie points is 0.70 px (usual: at most 0.5 px)" in residual
    (gcps,) = verdict.of_run(run_of(pointing=SimpleNamespace(after_px=0.1, pairs=(), rejected_gcps=("P1", "P2"))))
    assert "contradict the others (P1, P2)" in gcps
    far = registration(moved=(30.0, 0.0, 0.0))
    (moved,) = verdict.of_run(run_of(registration=far))
    assert "The shift of 30.0 m horizontally" in moved
    (wrong,) = verdict.of_run(run_of(cameras={"a": camera(0.1, 0.2), "b": camera(0.1, 0.8)}))
    assert "differ from the RPC by 0.80 px (RMSE; usual: at most 0.3 px)" in wrong


def test_a_warning_that_two_stages_repeat_counts_once_in_every_verdict():
    scene = run_of(warnings=(("x", "y"), ("x",)), cameras={"a": camera(0.3, 0.3)})
    assert verdict.of_history(scene) == ["x", "y"]


def test_cameras_before_and_after_refinement_are_judged_by_their_own_error():
    scene = run_of(cameras={"a": camera(0.9, 0.3), "b": camera(0.2, 0.1), "c": camera(0.4)})
    assert (verdict.fitted_error_px(scene), verdict.largest_error_px(scene)) == (0.9, 0.3)
    assert verdict.of_refinement(scene) == []
    (finding,) = verdict.of_fit(scene)
    assert "differ from the RPC by 0.90 px" in finding and "refine the images" in finding
    assert verdict.of_error_map(0.3, True) == verdict.of_error_map(0.3, False) == []
    (plain,), (refined,) = verdict.of_error_map(0.4, False), verdict.of_error_map(0.4, True)
    assert plain.endswith("refine the images.") and "another MODEL" in refined


def test_shares_are_named_in_per_cent_to_the_nearest():
    for share, words in ((0.4949, "49 %"), (0.4951, "50 %")):
        sample = reference("d.tif", 10_000, round(10_000 * share))
        (finding,) = verdict.of_registration(registration(references=[sample]))
        assert finding.startswith(f"Only {words} of the heights")
        bounds = replace(VERDICT, least_used_share=share, most_changed_share=share)
        (finding,) = verdict.of_registration(registration(references=[reference("d.tif", 100, 20)]), bounds)
        assert f"at least {words}" in finding
        (finding,) = verdict.of_change(share, (0.0, 0.0, 0.0), 1.0)
        assert finding.startswith(f"{words} of the ground")
        (finding,) = verdict.of_change(0.9, (0.0, 0.0, 0.0), 1.0, bounds)
        assert f"at most {words}" in finding


def test_the_cells_of_a_coarse_surface_and_the_spread_of_heights_set_the_bounds_together():
    coarse = replace(VERDICT, most_spread_cells=2.0)
    assert verdict.of_comparison(metrics(nmad=59.0), 30.0, coarse) == []
    # Without cells of its own a comparison has the plain bound, however many cells count.
    assert len(verdict.of_comparison(metrics(nmad=15.0), bounds=replace(VERDICT, most_spread_cells=20.0))) == 1
    wide = replace(VERDICT, most_bias_nmads=4.0)
    assert verdict.of_comparison(metrics(bias=3.0, nmad=1.0), bounds=wide) == []
    assert len(verdict.of_comparison(metrics(bias=1.5, nmad=0.3))) == 1


def test_a_check_without_residuals_or_without_a_dsm_judges_what_it_has():
    found = checked([0.1] * 4, [(0.2, 0.0)] * 4)
    assert verdict.of_points(replace(found, residuals={})) == []
    assert verdict.of_points(replace(found, errors={})) == []
    nowhere = replace(found, residuals={"scene": [{} for _ in found.gcps]})  # no point is measured in an image
    assert verdict.of_points(nowhere) == []
