"""repm:editdsm."""

from __future__ import annotations

from qgis.core import QgsProcessing

from . import parameters
from .base import RepmAlgorithm


class EditDsm(RepmAlgorithm):
    """Applies edits to a DSM."""

    ID = "editdsm"
    GROUP = "derived"
    STEP = 1
    TAGS = "edit,manual editing,remove,fill,void,interpolate,flatten,water,lake,breakline,hydro-flattening"
    HEAVY = False

    def title(self) -> str:
        return self.tr("Apply edits to a DSM")

    def shortDescription(self) -> str:
        return self.tr(
            "Removes, fills or sets heights, flattens water and keeps breaklines, by the records of a GeoPackage."
        )

    def parameters(self) -> list:
        kinds = [QgsProcessing.SourceType.TypeVector]
        return [
            parameters.helped(
                parameters.Raster("DSM", self.tr("DSM to edit")),
                self.tr("A surface model of this plugin or of others, in a projected CRS. It is not changed."),
            ),
            parameters.helped(
                parameters.Points("EDITS", self.tr("Edits"), kinds),
                self.tr(
                    "A layer of polygons and lines with the fields number, operation (remove, fill, set, flatten or "
                    "breakline), value and width in metres, and enabled. Plugins > REPM > Edit a DSM writes one."
                ),
            ),
            parameters.helped(
                parameters.Raster("CONFIDENCE", self.tr("Confidence of the DSM"), optional=True),
                self.tr("The raster that was written with the DSM. It is not changed."),
            ),
            *(parameters.product(self.ID, name) for name in ("output", "edited_confidence")),
        ]
