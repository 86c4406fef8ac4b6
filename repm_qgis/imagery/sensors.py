"""The satellites that are recognised, and what their vendors promise without ground control: one row for each.

``ce90_m`` is the radius of the circle on the ground that holds nine of ten points, ``le90_m`` the same for heights of
the vendor's stereo pairs, both as published and without the terrain's part. None: nothing published was found; the
satellite is recognised, and the figure for unknown ones is taken. An RMSE of positions (the root of the sum over both
directions) is converted with 2.146 / sqrt(2), one of heights with 1.645 (normal distribution). Messages quote the
sources in the middle of a sentence.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Dict, Optional, Pattern, Tuple

_MOST_TEXT = 8192


@dataclass(frozen=True)
class Sensor:
    """A satellite, how files and their names call it, its promise (m), and where that is published."""

    name: str
    calls: Pattern[str]
    ce90_m: Optional[float] = None
    le90_m: Optional[float] = None
    source: str = ""


def _sensor(
    name: str, calls: str, ce90_m: Optional[float] = None, le90_m: Optional[float] = None, source: str = ""
) -> Sensor:
    """A row; no letter may precede the satellite's name in a file, so that a part of another word does not match."""
    return Sensor(name, re.compile(f"(?<![A-Za-z])(?:{calls})", re.ASCII | re.IGNORECASE), ce90_m, le90_m, source)


_GUIDE = "DigitalGlobe, Core Imagery Product Guide 2.0, 2014"
_PLEIADES = "Astrium, Pleiades Imagery User Guide, 2012"
_SPOT = "Astrium, SPOT 6 & SPOT 7 Imagery User Guide, 2013"
_KOMPSAT = "SI Imaging Services, Geolocation Accuracy of KOMPSAT, 2013"

# The first row that fits is taken: KOMPSAT-3A stands before KOMPSAT-3.
SENSORS: Tuple[Sensor, ...] = (
    _sensor("WorldView-1", r"WV01|WORLDVIEW[-_ ]?0?1(?!\d)", 5.0, None, _GUIDE),
    _sensor("WorldView-2", r"WV02|WORLDVIEW[-_ ]?0?2(?!\d)", 5.0, None, _GUIDE),
    _sensor(
        "WorldView-3",
        r"WV03|WORLDVIEW[-_ ]?0?3(?!\d)",
        3.5,
        None,
        "DigitalGlobe, in Barazzetti 2016, ISPRS Archives XLI-B1",
    ),
    _sensor("WorldView-4", r"WV04|WORLDVIEW[-_ ]?0?4(?!\d)", 4.0, None, "DigitalGlobe, WorldView-4, 2016"),
    _sensor("GeoEye-1", r"GE01|GEOEYE[-_ ]?0?1(?!\d)", 5.0, None, _GUIDE),
    _sensor("QuickBird", r"QB0[12]|QUICKBIRD", 23.0, None, _GUIDE),
    _sensor(
        "IKONOS", r"IK01|IKONOS", 15.0, 22.0, "IKONOS Imagery Products Guide 1.5, 2006; Space Imaging, IKONOS Accuracy"
    ),
    _sensor("Pleiades Neo", r"PNEO|PL.IADES[-_ ]?NEO", 5.0, None, "Airbus, in International Charter, Pleiades Neo"),
    _sensor("Pleiades 1A", r"PHR[-_ ]?1A|PL.IADES[-_ ]?1A", 8.5, None, _PLEIADES),
    _sensor("Pleiades 1B", r"PHR[-_ ]?1B|PL.IADES[-_ ]?1B", 8.5, None, _PLEIADES),
    # Specified: an RMSE of 50 m.
    _sensor("SPOT 5", r"SPOT[-_ ]?5(?!\d)", 75.9, None, "CNES, in Bouillon & Gigord 2004, ISPRS Archives XXXV-B1"),
    _sensor("SPOT 6", r"SPOT[-_ ]?6(?!\d)", 35.0, None, _SPOT),
    _sensor("SPOT 7", r"SPOT[-_ ]?7(?!\d)", 35.0, None, _SPOT),
    _sensor("KOMPSAT-2", r"KOMPSAT[-_ ]?2(?!\d)", 80.0, None, _KOMPSAT),
    _sensor("KOMPSAT-3A", r"KOMPSAT[-_ ]?3A|K3A_\d{8}"),
    _sensor("KOMPSAT-3", r"KOMPSAT[-_ ]?3(?!\d)|K3_\d{8}", 70.0, None, _KOMPSAT),
    # Measured in ten regions: RMSE of 10 m and 5 m.
    _sensor("ZY-3", r"ZY-?3|ZI ?YUAN[-_ ]?3", 15.2, 8.2, "Wang 2014, IEEE GRSL 11(6)"),
    # Said at the first images: 5 m horizontally; measured: an RMSE of 2.15 m in height.
    _sensor(
        "GF-7",
        r"GF-?7(?:0\d)?(?!\d)|GAO ?FEN[-_ ]?7(?!\d)",
        7.6,
        3.5,
        "CNSA 2019; Remote Sensing 14:5868, 2022",
    ),
    # Measured errors reach kilometres (Baltsavias et al. 2007), so that there is no figure to give.
    _sensor("Cartosat-1", r"CARTOSAT[-_ ]?1(?!\d)|IRS[-_ ]?P5(?!\d)"),
    _sensor("Cartosat-2", r"CARTOSAT[-_ ]?2[A-F]?(?!\d)", 100.0, None, "NRSC, Cartosat-2"),
    _sensor("Cartosat-3", r"CARTOSAT[-_ ]?3(?!\d)"),
    _sensor("SuperView-1", r"SV1-0\d|SUPERVIEW[-_ ]?1(?!\d)", 20.0, None, "CATALYST, SuperView"),
    _sensor("SuperView-2", r"SV2-0\d|SUPERVIEW[-_ ]?2(?!\d)", 10.0, None, "CATALYST, SuperView"),
    _sensor("TripleSat", r"TRIPLESAT"),
    _sensor("Deimos-2", r"DEIMOS[-_ ]?2(?!\d)|GEOSAT[-_ ]?2(?!\d)|DE2_[A-Z\d]{3}_L\d"),
    _sensor("ALOS PRISM", r"ALPSM[A-Z]\d|ALOS[-_ /]{0,3}PRISM"),
    _sensor("SkySat", r"SKYSAT|(?<=\d{6}_)SSC?\d{1,2}(?:D\d)?_"),
    # An RMSE of 10 m, where Planet's own control points have corrected the image.
    _sensor(
        "PlanetScope",
        r"PLANETSCOPE|PSSCENE|(?<!\d)20\d{6}_\d{6}_(?:\d\d_)?[0-9a-f]{4}_\d[AB]_",
        15.2,
        None,
        "Planet, help centre, 2020",
    ),
)
_BY_NAME: Dict[str, Sensor] = {sensor.name: sensor for sensor in SENSORS}


def sensor_in(text: str) -> str:
    """The name of the satellite that a text of a file, or its name, speaks of; "" where it names none."""
    text = text[:_MOST_TEXT]
    return next((sensor.name for sensor in SENSORS if sensor.calls.search(text)), "")


def sensor_named(name: str) -> Optional[Sensor]:
    """The row of a name that :func:`sensor_in` gave; None for any other."""
    return _BY_NAME.get(name)
