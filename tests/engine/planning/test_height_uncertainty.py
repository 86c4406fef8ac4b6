"""How uncertain the absolute height is: it must hold for RPCs that are as wrong as their vendors promise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.records import PairFigures, PointingFigures, ViewPair
from repm_qgis.planning.height_uncertainty import height_uncertainty, usual_height_deviation
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.pointing.adjustment import adjust
from repm_qgis.ties.tracks import Track

DRAWS = 100
UP = 200.0


def figures_of(views, shifts, tied=None):
    names = [view.name for view in views]
    pairs = tied or [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    return PointingFigures(
        40, 0.0, 0.0, "shift", "", shifts, tuple(PairFigures(pair, 40, 40, 0.0, 0.0, 0.0) for pair in pairs)
    )


def ties_of(views, count=24):
    """Exact ties of points that all views see."""
    rng = np.random.default_rng(4)
    width, height = views[0].size
    pixels = rng.uniform(0.2, 0.8, (count, 2)) * (width, height)
    ground = views[0].localise(pixels, UP + rng.uniform(-20, 20, count))
    seen = {view.name: view.project(ground) for view in views}
    return [Track({name: at[k] for name, at in seen.items()}) for k in range(count)], ground


def drawn(views, draws, seed, sensor="Pleiades 1A"):
    """(draws, 2) errors of the height and what was stated: each RPC is wrong on the ground as its vendor promises."""
    views = [replace(view, sensor=sensor) for view in views]
    rng, (tracks, ground) = np.random.default_rng(seed), ties_of(views)
    deviation_m = {"Pleiades 1A": 8.5, "": 20.0, "IKONOS": 15.0}[sensor] / 2.146
    found = []
    for _ in range(draws):
        wrong = []
        for view in views:
            middle = view.project(ground.mean(axis=0))
            east, north = rng.normal(0.0, deviation_m, 2) / 6371e3
            place = ground.mean(axis=0)
            place[:2] += np.degrees([east / np.cos(np.radians(place[1])), north])
            wrong.append(replace(view, rpc=view.rpc.shifted(*(view.project(place) - middle))))
        adjusted = adjust(wrong, tracks, UP)
        shifts = {name: tuple(map(float, shift)) for name, shift in adjusted.shifts.items()}
        stated = height_uncertainty(wrong, figures_of(wrong, shifts))
        found.append((np.median(adjusted.ground[:, 2] - ground[:, 2]), stated.deviation_m))
    return np.array(found)


@pytest.mark.parametrize("count", (2, 3))
@pytest.mark.long
def test_the_stated_deviations_hold_for_errors_as_promised(urban, count):
    """68 % within one and 95 % within two; three standard errors of the 100 draws."""
    up, stated = drawn(urban.views[:count], DRAWS, seed=count).T
    within = [float((np.abs(up) < factor * stated).mean()) for factor in (1, 2)]
    assert 0.60 <= within[0] <= 0.87 and 0.91 <= within[1], within
    # It is no larger than it must be: the errors' spread is what was stated.
    assert 0.75 < np.sqrt(np.mean(up**2)) / np.median(stated) < 1.3


def test_an_rpc_that_is_grossly_wrong_makes_the_height_as_uncertain_as_it_is(urban):
    """200 px, eighteen times what promised errors cause in a pair: where the disagreement tells it, three stated
    deviations hold the error, which has nothing of the promise any more."""
    views = [replace(view, sensor="Pleiades 1A") for view in urban.views[:2]]
    (tracks, ground), ratios = ties_of(views), []
    for azimuth in np.linspace(0.0, 2 * np.pi, 24, endpoint=False):
        moved = replace(views[1], rpc=views[1].rpc.shifted(200 * np.cos(azimuth), 200 * np.sin(azimuth)))
        adjusted = adjust([views[0], moved], tracks, UP)
        shifts = {name: tuple(map(float, shift)) for name, shift in adjusted.shifts.items()}
        stated = height_uncertainty([views[0], moved], figures_of(views, shifts))
        if stated.disagreement > 4.0:
            ratios.append(abs(np.median(adjusted.ground[:, 2] - ground[:, 2])) / stated.deviation_m)
    assert len(ratios) >= 16 and max(ratios) < 3.0, ratios


def test_rpcs_that_agree_are_more_certain_than_those_that_do_not(urban):
    views = [replace(view, sensor="Pleiades 1A") for view in urban.views]

    def deviation(count, scale):
        shifts = {view.name: (0.0, 0.0) for view in views[:count]}
        shifts["img_01"], shifts["img_02"] = (scale, scale), (-scale, -scale)
        return height_uncertainty(views[:count], figures_of(views[:count], shifts))

    for count, freedom in ((2, 1), (3, 3)):
        alike, promised, apart = (deviation(count, scale) for scale in (0.005, 8.0, 60.0))
        assert alike.freedom == freedom and alike.disagreement < 0.01
        assert alike.deviation_m < promised.deviation_m < apart.deviation_m / 1.5
        # Agreement across the parallax says little of the error along it.
        assert alike.deviation_m > 0.85 * alike.promised_m == 0.85 * apart.promised_m
    assert deviation(3, 0.005).deviation_m / deviation(3, 0.005).promised_m < 0.95


def test_a_published_accuracy_of_heights_is_taken(urban):
    views = [replace(view, sensor="IKONOS") for view in urban.views[:2]]
    found = height_uncertainty(views, figures_of(views, dict.fromkeys(("img_01", "img_02"), (0.0, 0.0))))
    assert found.promised_m == pytest.approx(22.0 / 1.645)


def test_an_image_without_ties_says_nothing(urban):
    shifts = {"img_01": (3.0, 3.0), "img_02": (-3.0, -3.0), "img_03": (0.0, 0.0)}
    two = height_uncertainty(urban.views[:2], figures_of(urban.views[:2], shifts))
    assert height_uncertainty(urban.views, figures_of(urban.views, shifts, [("img_01", "img_02")])) == two


def test_what_is_usual_is_less_than_what_is_promised(urban):
    pairs, figures = [ViewPair("img_01", "img_02", 20.0, 0.4, 1)], figures_of(urban.views[:2], {})
    assert usual_height_deviation(pairs, figures, 0.5) == pytest.approx(PLANNING.usual_px / np.sqrt(2) * 0.5 / 0.4)


def test_a_view_without_a_correction_was_not_moved(urban):
    views = urban.views[:2]
    moved = {views[0].name: (3.0, -5.0)}
    found, other = (
        height_uncertainty(views, figures_of(views, shifts)) for shifts in (moved, {**moved, views[1].name: (0.0, 0.0)})
    )
    assert found == other
