"""Whether two rasters hold the same heights: a copy is no second opinion."""

from __future__ import annotations

import hashlib
from typing import Dict, List, Mapping, Sequence, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import Window
from ..contracts.errors import OptionError
from ..evaluation.grids import Grid, metric_of
from ..geometry.frames import on_earth, vertical_part
from ..geometry.vertical import PLACED_TAG
from ..imagery.heights import read_heights
from ..imagery.raster import opened

_MOST_ROWS = 64
_STEP_M = 1e-3


def content_of(dataset: gdal.Dataset) -> str:
    """A value that two rasters share where they have the same heights (to 1 mm) at the same place, under whatever name,
    format and compression. Raises ImageError for a raster that cannot be read, or lies nowhere."""
    columns, rows = dataset.RasterXSize, dataset.RasterYSize
    grid = Grid.of(dataset)  # the same numbers are other heights above another datum, and elsewhere
    datum, middle = None, (0.0, 0.0)
    if grid.wkt:
        datum, middle = vertical_part(on_earth(grid.crs, grid.path)), metric_of(grid).place
    numbers = [f"{number:.9g}" for number in grid.transform] + [f"{degrees:.6f}" for degrees in middle]
    stated = dataset.GetMetadataItem(PLACED_TAG)  # by ground control, such as of a scene that was placed again
    place = [columns, rows, bool(grid.wkt), datum, stated, *numbers]
    digest = hashlib.blake2b("|".join(map(str, place)).encode(), digest_size=16)
    for row in np.unique(np.linspace(0, rows - 1, min(rows, _MOST_ROWS)).astype(int)):
        heights = read_heights(dataset, Window(0, int(row), columns, 1)).astype(np.float64)
        whole = np.where(np.isfinite(heights), np.round(heights / _STEP_M), np.iinfo(np.int64).min)
        digest.update(np.clip(whole, -(2.0**62), 2.0**62).astype(np.int64).tobytes())
    return digest.hexdigest()


def copies(paths: Sequence[str]) -> List[Tuple[str, str]]:
    """Each raster that is a copy of an earlier one, with that one."""
    first: Dict[str, str] = {}
    pairs = []
    for path in paths:
        with opened(path) as dataset:
            content = content_of(dataset)
        if content in first:
            pairs.append((path, first[content]))
        first.setdefault(content, path)
    return pairs


def require_distinct_content(named: Mapping[str, Sequence[str]], why: str) -> None:
    """Raise OptionError for a raster of the named options that is a copy of another one: ``why`` says what would follow
    ("it would count twice")."""
    owners = [(path, option) for option, paths in named.items() for path in paths]
    options = dict(owners)
    for path, other in copies([path for path, _ in owners]):
        reason = f"must not have the same heights as '{other}', or {why}: give another one, or leave it out"
        raise OptionError(options[path], path, reason)
