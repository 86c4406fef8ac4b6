"""A map layer for each date: a small VRT that shows one band of the stack, with a style that has the date's period.

QGIS's temporal controller takes periods of layers; those of a raster's bands it knows from 3.38 on only.
"""

from __future__ import annotations

import html
import os
import re
from pathlib import Path
from typing import List, Sequence

from osgeo import gdal

from ..contracts.errors import WorkspaceError
from ..imagery.raster import opened, quiet
from ..reports.styles import height_limits, write_style
from ..runtime.workspace import whole_folder
from .times import DatedDsm, periods


def layer_name(label: str) -> str:
    """The file's name of a date's layer: what no file system refuses."""
    return label.replace(":", "").replace(" ", "T") + ".vrt"


def write_layers(folder: str, stack: str, series: Sequence[DatedDsm]) -> List[str]:
    """Write the folder, whole or not at all, and give the paths of the layers, the latest first.

    Raises ImageError where the stack cannot be read, WorkspaceError where the folder cannot be written.
    """
    names = [layer_name(each.label) for each in series]
    limits = height_limits(stack)
    with whole_folder(folder) as made:
        for band, (name, period) in enumerate(zip(names, periods(series)), start=1):
            target = str(made / name)
            _one_band(stack, target, band, folder)
            write_style("dated", target, limits, (period[0], period[1]))
    return [os.path.join(folder, name) for name in reversed(names)]


def _one_band(stack: str, target: str, band: int, folder: str) -> None:
    """A VRT of one band, which names the stack by its place beside the folder where both are on one drive."""
    with opened(stack) as dataset, quiet():
        made = gdal.Translate(target, dataset, format="VRT", bandList=[band])
        if made is None:
            raise WorkspaceError(f"'{target}' cannot be written ({gdal.GetLastErrorMsg()}): free space on its disk.")
        made.FlushCache()
        made = None
    try:
        place, relative = os.path.relpath(os.path.abspath(stack), os.path.abspath(folder)).replace(os.sep, "/"), 1
    except ValueError:  # on another drive of Windows
        place, relative = os.path.abspath(stack), 0
    named = f'<SourceFilename relativeToVRT="{relative}">{html.escape(place)}</SourceFilename>'
    text = Path(target).read_text(encoding="utf-8")
    text = re.sub(r"<SourceFilename.*?</SourceFilename>", lambda _: named, text, flags=re.DOTALL)
    Path(target).write_text(text, encoding="utf-8")
