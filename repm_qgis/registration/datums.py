"""What the heights of a reference refer to, where neither the user nor the file says so: found from how they fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, List, Tuple

from ..contracts.errors import MissingPackageError, OptionError
from ..geometry.vertical import HeightDatum
from .found import FoundHeights
from .parameters import REGISTRATION, RegistrationParameters
from .references import in_datum
from .solve import Shift
from .surfaces import Reference

_OPTION = "REFERENCE_DATUM"
_GEOIDS = ("EGM2008", "EGM96")  # of Copernicus GLO-30 and of SRTM; where both are possible, the first is taken


@dataclass(frozen=True)
class DatumChoice:
    """The vertical datum that is assumed for the heights, and the shift with it. ``sentence`` says why, with numbers.
    ``certain``: every other datum that is possible would change the heights by less than the vendor's standard
    deviation.
    """

    datum: HeightDatum
    shift: Shift
    sentence: str
    certain: bool


def likely_datum(
    found: FoundHeights,
    crs: str,
    solved: Callable[[Reference], Shift],
    promised_up_m: float,
    parameters: RegistrationParameters = REGISTRATION,
) -> DatumChoice:
    """Which of the WGS 84 ellipsoid, EGM2008 and EGM96 the heights of a reference refer to.

    A geoid lies up to 106 m from the ellipsoid, and the own surface is seldom wrong by much more than
    ``promised_up_m``, the standard deviation of its height that the vendor promises. So with the right datum the
    surface has to move up or down by a few metres only. ``solved`` finds the shift to a reference; ``crs`` is that of
    its places.

    The two geoids differ by decimetres to two metres, which no fit can distinguish: EGM2008 is taken.

    Raises OptionError, with the numbers, where the ellipsoid and a geoid both fit, or none, or where PROJ has no grid
    of a geoid; and what ``solved`` raises.
    """
    if found.places_in not in (None, "metre", "degree"):
        raise OptionError(
            _OPTION,
            "auto",
            f"must be given, such as EPSG:6360 (NAVD88 in feet) or EPSG:5703 (in metres), as '{found.name}' has places "
            f"in {found.places_in}, and does not say what its heights are in",
        )
    limit = parameters.believable * promised_up_m
    ellipsoid = HeightDatum.of("ellipsoid")
    shift = solved(in_datum(found, crs, ellipsoid))
    up = float(shift.moved[2])
    geoids, missing = _changes_of_heights(shift, crs)
    if not geoids:
        silent = f"must be given, as '{found.name}' does not say what its heights refer to"
        raise OptionError(_OPTION, "auto", f"{silent}. {' '.join(missing)}".rstrip("."))
    geoid, change = next((each for each in geoids if abs(each[1]) <= limit), geoids[0])
    numbers = (
        f"'{found.name}' does not say what its heights refer to; the scene's heights change by {change:+.1f} m if "
        f"that is the {geoid} geoid, and by {up:+.1f} m if it is the ellipsoid"
    )
    if (abs(up) <= limit) == (abs(change) <= limit):
        if abs(up) <= limit:
            raise OptionError(_OPTION, "auto", f"must be given, as {numbers}: both are within {limit:.1f} m")
        raise OptionError(_OPTION, "auto", f"must be given, as {numbers}: neither is within {limit:.1f} m")
    if abs(up) <= limit:
        text = f"{numbers}: they are assumed to be above the ellipsoid; give REFERENCE_DATUM if that is wrong."
        return DatumChoice(ellipsoid, shift, text, certain=True)
    said = [f"{numbers}: they are assumed to be {geoid} heights; give REFERENCE_DATUM if that is wrong."]
    others = [each for each in geoids if each[0] != geoid]
    said += [f"With {name} instead, the scene's heights change by {other:+.1f} m." for name, other in others]
    near = all(abs(other - change) <= promised_up_m for _, other in others)
    datum = HeightDatum.of(geoid)
    return DatumChoice(
        datum, solved(in_datum(found, crs, datum)), " ".join(said + missing), certain=near and not missing
    )


def _changes_of_heights(shift: Shift, crs: str) -> Tuple[List[Tuple[str, float]], List[str]]:
    """How much the own heights change with each geoid, m, and a sentence for each whose grid PROJ lacks.

    ``shift`` is that with the ellipsoid. Undulations are smooth: their mean, over the heights that have a weight, is
    added to it.
    """
    changes, missing = [], []
    used = shift.xy[shift.weight > 0]
    for name in _GEOIDS:
        try:
            undulation = HeightDatum.of(name).undulation(crs, used, "give another REFERENCE_DATUM")
        except MissingPackageError as error:
            missing.append(str(error))
        else:
            changes.append((name, float(shift.moved[2] + undulation.mean())))
    return changes, missing
