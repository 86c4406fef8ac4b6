"""Which datum heights have that do not say so: found from how they fit, said with numbers, and refused when unsure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.errors import MissingPackageError, OptionError
from repm_qgis.contracts.records import GroundShift
from repm_qgis.geometry import vertical
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.registration.datums import likely_datum
from repm_qgis.registration.found import FoundHeights
from repm_qgis.registration.parameters import REGISTRATION
from repm_qgis.registration.references import in_datum
from repm_qgis.registration.solve import Prior, Shift, solve_shift
from repm_qgis.registration.surfaces import Reference, SupportMeans

UTM, WEST, NORTH, CELL, SIDE = "EPSG:32631", 500_000.0, 4_000_000.0, 30.0, 64
EGM2008, EGM96 = "EPSG:3855", "EPSG:5773"


@pytest.fixture
def geoids(monkeypatch):
    """geoids({code: m at the scene's west}): geoids that rise by 0.1 m across the scene; others have no grid."""

    def install(levels):
        class Operation:
            def __init__(self, level):
                self._level = level

            def transform(self, lon, lat, height):
                return lon, lat, height - self._level - 0.1 * (lon - 3.0) / 0.0213

        def best(code, bounds):
            if code not in levels:
                raise vertical._MissingGridsError([f"grid_of_{code[5:]}.tif"])
            return Operation(levels[code])

        monkeypatch.setattr(vertical, "_best_operation", best)

    return install


@pytest.fixture(scope="module")
def scene():
    """The own surface, and the heights above the ellipsoid of the truth 4 m above it and 12 m east of it."""
    at = (np.arange(SIDE) + 0.5) * CELL
    x, y = np.meshgrid(WEST + at, NORTH - at)

    def relief(x, y):
        return 300 + 60 * np.sin((x - WEST) / 310) * np.cos((y - NORTH) / 270) + 40 * np.sin((x + y) / 520)

    noise = np.random.default_rng(1).normal(size=(2, SIDE, SIDE))
    own = relief(x + 12.0, y) - 4.0 + noise[0] * 0.3
    truth = relief(x, y) + noise[1] * 0.5
    return CellGrid(WEST, NORTH, CELL, own.shape), own, np.column_stack([x.ravel(), y.ravel()]), truth.ravel()


@pytest.fixture
def heights(scene):
    """heights(datum): the reference, whose heights are above it and do not say so; and what quickly finds its shift,
    whose horizontal part is known."""
    _, _, xy, truth = scene
    calls = []

    def solved(reference: Reference):
        calls.append(reference)
        up = float(np.median(reference.xyz[:, 2] - truth)) + 4.0
        weight = np.arange(len(xy)) % 2
        nothing = np.zeros(len(xy))
        return Shift(
            GroundShift((12.0, 0.0, up), (0.0, 0.0), (WEST, NORTH)),
            np.eye(5),
            np.eye(2),
            xy,
            nothing,
            nothing,
            weight,
            0.0,
        )

    def made(datum):
        above = truth - HeightDatum.of(datum).undulation(UTM, xy)
        return FoundHeights("glo30.tif", xy, above, (CELL, CELL)), solved, calls

    return made


def test_a_geoid_is_found_where_it_alone_fits(geoids, heights):
    geoids({EGM2008: 49.05, EGM96: 49.75})
    found, solved, calls = heights("EGM2008")
    choice = likely_datum(found, UTM, solved, 2.0)
    assert choice.datum == HeightDatum.of("EGM2008") and choice.certain and len(calls) == 2
    assert choice.shift.moved == pytest.approx([12.0, 0.0, 4.0], abs=0.05)
    assert choice.sentence == (
        "'glo30.tif' does not say what its heights refer to; the scene's heights change by +4.0 m if that is the "
        "EGM2008 geoid, and by -45.1 m if it is the ellipsoid: they are assumed to be EGM2008 heights; give "
        "REFERENCE_DATUM if that is wrong. With EGM96 instead, the scene's heights change by +4.7 m."
    )


@pytest.mark.parametrize("datum, level", (("EGM2008", 49.0), ("EGM96", -32.5)))
@pytest.mark.long
def test_the_mean_undulation_is_what_another_solution_would_find(geoids, scene, heights, datum, level):
    """A geoid that is no plane on the level moves the solution a little, so it is found again with what is taken."""
    geoids({EGM2008: level, EGM96: level})
    grid, own, _, _ = scene
    found, _, _ = heights(datum)

    def solved(reference):
        surface = SupportMeans(grid, own, reference, REGISTRATION.covered)
        return solve_shift(surface, reference, Prior(horizontal_m=8.0, up_m=2.0, most_m=60.0))

    on_ellipsoid = solved(in_datum(found, UTM, HeightDatum.of("ellipsoid")))
    again = solved(in_datum(found, UTM, HeightDatum.of(datum)))
    used = on_ellipsoid.xy[on_ellipsoid.weight > 0]
    mean = HeightDatum.of(datum).undulation(UTM, used).mean()
    assert again.moved == pytest.approx([12.0, 0.0, 4.0], abs=0.3)
    assert on_ellipsoid.moved[2] + mean == pytest.approx(again.moved[2], abs=0.05)
    assert on_ellipsoid.moved[:2] == pytest.approx(again.moved[:2], abs=0.2)


def test_heights_above_the_ellipsoid_are_found(geoids, heights):
    geoids({EGM2008: 49.05, EGM96: 49.75})
    found, solved, calls = heights("ellipsoid")
    choice = likely_datum(found, UTM, solved, 2.0)
    assert choice.datum == HeightDatum.of("ellipsoid") and choice.certain and len(calls) == 1
    assert "change by +53.1 m if that is the EGM2008 geoid, and by +4.0 m if it is the ellip" in choice.sentence
    assert choice.sentence.endswith("assumed to be above the ellipsoid; give REFERENCE_DATUM if that is wrong.")


def test_a_grid_that_is_missing_is_named(geoids, heights):
    geoids({EGM96: 49.7})
    found, solved, _ = heights("EGM96")
    choice = likely_datum(found, UTM, solved, 2.0)
    assert choice.datum == HeightDatum.of("EGM96") and not choice.certain
    assert (
        "they are assumed to be EGM96 heights" in choice.sentence and "grid_of_3855.tif is not inst" in choice.sentence
    )
    assert choice.sentence.endswith(", or give another REFERENCE_DATUM.")


def test_geoids_that_differ_by_much_are_uncertain(geoids, heights):
    geoids({EGM2008: 49.0, EGM96: 51.5})
    found, solved, _ = heights("EGM2008")
    assert not likely_datum(found, UTM, solved, 2.0).certain


@pytest.mark.parametrize(
    "levels, promised, words",
    (
        ({EGM2008: 49.0, EGM96: 49.0}, 20.0, "both are within 60.0 m"),
        ({EGM2008: 49.0, EGM96: 49.0}, 1.0, "neither is within 3.0 m"),
        (
            {},
            2.0,
            "what its heights refer to. .*grid_of_3855.tif is not installed: .*put .*grid_of_5773.tif is not inst",
        ),
    ),
)
def test_nothing_is_guessed(geoids, heights, levels, promised, words):
    geoids({EGM2008: 49.0})
    found, solved, _ = heights("EGM2008")
    geoids(levels)
    with pytest.raises(OptionError, match=words) as caught:
        likely_datum(found, UTM, solved, promised)
    assert str(caught.value).startswith("REFERENCE_DATUM is 'auto': it must be given") and "glo30.tif" in str(
        caught.value
    )


def test_a_grid_that_is_missing_for_a_given_datum_is_a_sentence(geoids, heights):
    geoids({})
    found, _, _ = heights("ellipsoid")
    with pytest.raises(MissingPackageError, match="or give a reference whose heights are above the ellipsoid"):
        in_datum(found, UTM, HeightDatum.of("EGM2008"))


def test_heights_that_may_be_in_feet_are_asked_for(geoids, heights):
    geoids({EGM2008: 49.0, EGM96: 49.7})
    found, solved, calls = heights("ellipsoid")
    doubtful = replace(found, places_in="US survey foot")
    with pytest.raises(OptionError, match="must be given, such as EPSG:6360 .* has places in US survey foot, and does"):
        likely_datum(doubtful, UTM, solved, 2.0)
    assert not calls


@pytest.mark.parametrize("places_in, unit", ((None, 1.0), ("metre", 1200 / 3937), ("US survey foot", 1200 / 3937)))
def test_heights_of_no_unit_are_in_that_of_the_datum(geoids, places_in, unit):
    geoids({"EPSG:6360": 0.0})
    found = FoundHeights("a", np.array([[500_000.0, 4_000_000.0]]), np.array([100.0]), (1.0, 1.0), places_in=places_in)
    found = replace(found, slopes=np.array([[1.0, 2.0]]))
    reference = in_datum(found, UTM, HeightDatum.of("EPSG:6360"))
    assert reference.xyz[0, 2] == pytest.approx(100.0 * unit, abs=1e-6)
    np.testing.assert_allclose(reference.slopes, [[unit, 2 * unit]])


def test_a_reference_keeps_what_its_heights_are(geoids):
    geoids({EGM96: 10.0})
    xy = np.array([[500_000.0, 4_000_000.0]])
    found = FoundHeights("a", xy, np.array([5.0]), (12.0, 40.0), True, np.array([[0.1, 0.2]]), None)
    reference = in_datum(found, UTM, HeightDatum.of("EGM96"))
    assert reference.xyz[0] == pytest.approx([500_000.0, 4_000_000.0, 15.0], abs=1e-3)
    assert (reference.width_m, reference.disc, reference.name) == ((12.0, 40.0), True, "a")
    assert (reference.slopes == [[0.1, 0.2]]).all()
