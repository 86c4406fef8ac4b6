"""How far a finished surface lies above the elevation model that the user gave, and whether that is to be expected."""

from __future__ import annotations

import math
from typing import Callable, Optional

from ..contracts.arrays import Floats
from ..contracts.records import DemOffset
from ..geometry.cell_grid import CellGrid
from ..geometry.vertical import HeightDatum
from ..scene import Scene
from .estimation import deviations_of
from .parameters import REGISTRATION, RegistrationParameters
from .references import in_datum, read_reference
from .solve import Prior, solve_shift
from .surfaces import SupportMeans


def dem_offset(
    scene: Scene,
    crs: str,
    grid: CellGrid,
    *,
    height: Floats,
    prior: Prior,
    check: Callable[[], None] = lambda: None,
    parameters: RegistrationParameters = REGISTRATION,
) -> DemOffset:
    """Lay a surface, (rows, columns) heights above the ellipsoid in the cells of a grid, on the DEM of its scene.

    A DEM that does not state its vertical datum is taken as ellipsoidal, as everywhere. Raises what reading it raises,
    and EmptyResultError where too few of its cells see the surface.
    """
    around = grid.bounds.grown(prior.most_m)
    found = read_reference(scene.dem, crs, around, parameters.averaged_cells * grid.cell, check)
    reference = in_datum(found, crs, found.datum or HeightDatum.of("ellipsoid"))
    means = SupportMeans(grid, height, reference, parameters.covered)
    shift = solve_shift(means, reference, prior, check=check, parameters=parameters)
    # Added to the surface it would lie on the DEM: the surface lies above it by the amount that must be subtracted.
    up, deviation = -float(shift.moved[2]), float(shift.deviations[2])
    stated = stated_height_deviation(scene)
    most = None
    if stated is not None:
        most = parameters.unexpected * math.hypot(stated, deviation, parameters.dem_m)
    return DemOffset(scene.dem, up, deviation, most, shift.other_relief)


def stated_height_deviation(scene: Scene) -> Optional[float]:
    """The standard deviation of the absolute height that is stated for a scene, m: that of its registration, of its
    ground control, or without both of the RPCs; None where nothing is stated."""
    if scene.registration is not None:
        return scene.registration.deviation[2]
    ties = scene.pointing
    if ties is None:
        return None
    if ties.height_uncertainty_m is not None:
        return ties.height_uncertainty_m / 2.0
    if ties.control_information is None:
        return None
    return float(deviations_of(ties.control_information)[2])
