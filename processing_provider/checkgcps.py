"""repm:checkgcps."""

from __future__ import annotations

from qgis.core import (
    QgsProcessingParameterFile,
)

from . import parameters
from .base import RepmAlgorithm


class CheckGcps(RepmAlgorithm):
    """Measures RPCs, corrected RPCs and a DSM at ground control points."""

    ID = "checkgcps"
    GROUP = "evaluation"
    STEP = 2
    TAGS = "GCP,ground control,check points,accuracy,RMSE,localisation,georeferencing"
    HEAVY = False

    def title(self) -> str:
        return self.tr("Check against ground control points")

    def shortDescription(self) -> str:
        return self.tr("How far points of known position are from where RPCs, corrected RPCs and a DSM put them.")

    def parameters(self) -> list:
        scene = QgsProcessingParameterFile(
            "SCENE",
            self.tr("Scene (for the images' geometry)"),
            QgsProcessingParameterFile.Behavior.File,
            fileFilter=parameters.SCENE_FILTER,
            optional=True,
        )
        return [
            parameters.gcps(optional=False),
            parameters.helped(
                scene,
                self.tr("The scene.json of any stage; a reconstructed scene also shows how accurate its pointing is."),
            ),
            parameters.helped(
                parameters.Raster("DSM", self.tr("DSM (for the heights at the points)"), optional=True),
                self.tr("Its heights are compared with those of the points that lie on it."),
            ),
            parameters.gcp_datum(),
            *(parameters.product(self.ID, name) for name in ("output", "report")),
        ]
