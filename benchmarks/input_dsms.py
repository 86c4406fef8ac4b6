"""Bad input, the part on DSMs: surfaces that are wrong as a whole, and what reports say of them.

benchmarks/input.py runs the trials.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import List

import numpy as np
import pyproj

from benchmarks.input_case import Ended, Job, Trial
from repm_qgis.geometry.vertical import ELLIPSOID, TAG
from repm_qgis.imagery.raster import write

_SIDE = 300
_WRONG = {"times 3.28": 3.28, "upside down": -1.0, "displaced by 20 m": 1.0, "mirrored": 1.0, "right": 1.0}


def relief() -> np.ndarray:
    """A hilly place that is not its own mirror image, m, in cells of 1 m."""
    v, u = np.mgrid[:_SIDE, :_SIDE]
    return (300 + 40 * np.sin(u / 31.0 + 1.0) + 25 * np.cos(v / 23.0) + 0.1 * u).astype(np.float32)


def surface(folder: Path, name: str, wrong: str = "right", start: int = 0) -> str:
    """A DSM of that place from a column on, which is wrong in the named way; gives its path."""
    heights = _WRONG[wrong] * relief()
    heights = np.roll(heights, 20, axis=1) if wrong == "displaced by 20 m" else heights
    heights = heights[:, ::-1] if wrong == "mirrored" else heights
    place = (500000.0 + start, 1.0, 0.0, 4800000.0, 0.0, -1.0)
    crs, datum = pyproj.CRS("EPSG:32631").to_wkt("WKT1_GDAL"), {TAG: ELLIPSOID}
    return write(str(folder / f"{name}.tif"), [np.ascontiguousarray(heights[:, start:])], place, crs, metadata=datum)


def compared(wrong: str, folder: Path) -> List[Job]:
    reference, dsm = surface(folder, "reference"), surface(folder, "dsm", wrong)
    return [("comparedsm", {"dsm": dsm, "reference": reference, "align": "vertical", "report": str(folder / "r.html")})]


def verdict_of(ended: Ended) -> str:
    """What the report says at its top."""
    top = (ended.folder / "r.html").read_text(encoding="utf-8").split("<h2")[0]
    found = f"NMAD {ended.result['nmad']:.1f} m, " if "nmad" in ended.result else ""
    return f"exit 0: {found}{'“Good.”' if 'Good.' in top else '“Look at”'}"


TRIALS: List[Trial] = [
    Trial("10", f"a DSM that is {wrong}, compared with the truth", partial(compared, wrong), verdict_of)
    for wrong in _WRONG
]
