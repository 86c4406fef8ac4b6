"""The grids that bring heights above a geoid to the ellipsoid, as PROJ's own database lists them."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from typing import Iterator, List, Optional

import pyproj
from pyproj.transformer import TransformerGroup

from .vertical import HeightDatum

_WORSE = 3.0  # times the accuracy of the best grid: those of earlier geoids are left out


@dataclass(frozen=True)
class GeoidGrid:
    """A file of PROJ's network: the datum and the area (PROJ's words) that it is for, its accuracy (m, None where PROJ
    does not know it), and whether PROJ has it here."""

    name: str
    datum: str
    area: str
    accuracy_m: Optional[float]
    installed: bool


def geoid_grids(datum: str) -> List[GeoidGrid]:
    """The grids for a vertical datum, the best of each area first; none where PROJ needs or knows none.

    Raises OptionError where PROJ knows no such vertical CRS.
    """
    named = HeightDatum.of(datum)
    if not named.code:
        return []
    grids = sorted(_grids(named), key=lambda grid: grid.accuracy_m or 1e3)
    best: List[GeoidGrid] = []
    for grid in grids:
        least = best[0].accuracy_m if best else grid.accuracy_m
        worse = bool(least and grid.accuracy_m and grid.accuracy_m > _WORSE * least)
        if not worse and not any(grid.area == other.area or grid.name == other.name for other in best):
            best.append(grid)
    return best


def _grids(datum: HeightDatum) -> Iterator[GeoidGrid]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of missing grids: they are what is looked for
        group = TransformerGroup("EPSG:4979", pyproj.CRS(datum.code), always_xy=True, allow_ballpark=False)
    ready = [operation for transformer in group.transformers for operation in transformer.operations or ()]
    for operation in (*ready, *group.unavailable_operations):
        area = operation.area_of_use.name if operation.area_of_use else ""
        accuracy = operation.accuracy if operation.accuracy > 0 else None
        for grid in operation.grids:
            name = os.path.basename(grid.url) or grid.short_name
            if grid.available or (grid.direct_download and name.endswith(".tif")):
                yield GeoidGrid(name, datum.name, area.rstrip("."), accuracy, bool(grid.available))
