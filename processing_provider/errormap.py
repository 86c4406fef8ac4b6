"""repm:errormap."""

from __future__ import annotations

from qgis.core import QgsProcessingParameterString

from ..repm_qgis.contracts.options import ErrorMapOptions
from . import parameters
from .base import RepmAlgorithm


class ErrorMap(RepmAlgorithm):
    """Maps one view's equivalent error on the ground."""

    ID = "errormap"
    GROUP = "cameras"
    STEP = 2
    TAGS = "EPM,equivalent error,accuracy"
    HEAVY = False

    def title(self) -> str:
        return self.tr("Map the equivalent error")

    def shortDescription(self) -> str:
        return self.tr("The error of the pinhole model in one view, as a raster on the ground.")

    def parameters(self) -> list:
        return [
            parameters.scene(),
            parameters.helped(
                QgsProcessingParameterString("VIEW", self.tr("View"), "", optional=True),
                self.tr("A view's name as in the scene's report: its image file's name without extension."),
            ),
            parameters.number(
                ErrorMapOptions,
                "altitude",
                self.tr("Altitude (m)"),
                self.tr("Metres above the WGS 84 ellipsoid. Empty: the middle of the scene's range."),
            ),
            *(parameters.product(self.ID, name) for name in ("output", "report")),
        ]
