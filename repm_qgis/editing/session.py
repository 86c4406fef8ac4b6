"""The edits of a DSM in the GeoPackage beside it: each change is written at once, so that nothing drawn is lost."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Optional, Tuple

import pyproj
from osgeo import ogr

from ..contracts.checks import as_text
from ..contracts.errors import ImageError
from ..geometry.frames import flat_crs
from ..imagery.raster import opened
from ..terrain.inputs import surface_of
from .edits import Edit, read_edits, write_edits

ORIGIN = "EDITED_FROM"
"""The metadata item of an edited DSM with the name of the original's file."""


def original_of(path: str) -> str:
    """The DSM of which a raster was made by edits, where it lies beside it; else the raster itself."""
    try:
        with opened(path) as dataset:
            name = os.path.basename(as_text(dataset.GetMetadataItem(ORIGIN) or ""))
    except ImageError:
        return path
    original = os.path.join(os.path.dirname(path), name)
    return original if name and beside(original, "_edited.tif") == path and os.path.isfile(original) else path


def beside(dsm: str, end: str) -> str:
    """The name of a file that belongs to a DSM."""
    return f"{os.path.splitext(dsm)[0]}{end}"


class DsmEdits:
    """The records of one DSM, in ``path``; ``crs`` (its code, or WKT) is that of their shapes.

    Raises ImageError for a DSM that cannot be edited, and InputTableError where its records cannot be read.
    """

    def __init__(self, dsm: str) -> None:
        self.dsm, self.path = dsm, beside(dsm, "_edits.gpkg")
        self.edited, self.edited_confidence = (beside(dsm, f"_edited{end}.tif") for end in ("", "_confidence"))
        surface = surface_of(dsm, None)
        self.cell, self.crs = surface.cell, flat_crs(pyproj.CRS.from_user_input(surface.crs)).to_wkt("WKT2_2018")
        self.edits: Tuple[Edit, ...] = ()
        self.renew()

    def renew(self) -> None:
        """Read what the file holds now: its records can be changed as a layer as well. Raises InputTableError."""
        if os.path.exists(self.path):
            found = read_edits(self.path)
            self.edits, self.crs = found.edits, found.crs
        else:
            self.edits = ()

    def add(self, operation: str, wkt: str, value: Optional[float], width: Optional[float], made: str = "") -> Edit:
        """Add a record with the next number; raises WorkspaceError, and InputTableError for what is no edit."""
        self.renew()
        geometry = bytes(ogr.CreateGeometryFromWkt(wkt).ExportToIsoWkb())
        number = max((edit.number for edit in self.edits), default=0) + 1
        edit = Edit(number, operation, geometry, value, width, True, made)
        self._write((*self.edits, edit))
        return edit

    def undo(self) -> Optional[Edit]:
        """Remove the last record; None where there is none. Raises WorkspaceError."""
        self.renew()
        if not self.edits:
            return None
        last = self.edits[-1]
        self._write(self.edits[:-1])
        return last

    def enable(self, number: int, enabled: bool) -> None:
        """Have an edit applied, or passed over. Raises WorkspaceError."""
        self.renew()
        self._write(tuple(replace(edit, enabled=enabled) if edit.number == number else edit for edit in self.edits))

    def _write(self, edits: Tuple[Edit, ...]) -> None:
        before = self.edits
        write_edits(self.path, edits, self.crs)
        try:
            self.edits = read_edits(self.path).edits
        except Exception:  # the drawing is no valid edit: the file stays unchanged
            write_edits(self.path, before, self.crs)
            raise
