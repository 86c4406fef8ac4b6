"""repm:register."""

from __future__ import annotations

from qgis.core import (
    QgsProcessing,
    QgsProcessingParameterMultipleLayers,
)

from ..repm_qgis.contracts.options import RegisterOptions
from . import parameters
from .base import RepmAlgorithm


class Register(RepmAlgorithm):
    """Lays scenes onto references."""

    ID = "register"
    GROUP = "surface"
    STEP = 2
    TAGS = (
        "registration,co-registration,georeferencing,reference,Copernicus,GLO-30,SRTM,lidar,ICESat-2,GEDI,"
        "Nuth and Kaab,shift,absolute position"
    )
    USES_WORKERS = True

    def title(self) -> str:
        return self.tr("Register to a reference")

    def shortDescription(self) -> str:
        return self.tr(
            "Moves a scene onto a DEM, lidar or other known heights by correcting the pointing of its images."
        )

    def parameters(self) -> list:
        return [
            parameters.scene(),
            parameters.references(),
            parameters.reference_datum(),
            parameters.choice(
                RegisterOptions,
                "model",
                self.tr("Correction"),
                self.tr("shift: a shift in three dimensions; tilt: also a tilt, where the heights determine one."),
            ),
            parameters.stable(),
            parameters.advanced(
                parameters.helped(
                    QgsProcessingParameterMultipleLayers(
                        "OTHERS",
                        self.tr("Other scenes that overlap"),
                        QgsProcessing.SourceType.TypeFile,
                        optional=True,
                    ),
                    self.tr(
                        "Reconstructed scenes of the same strip or mosaic: all are placed together, so that no step is "
                        "left between their DSMs. Each is written beside its own file (..._registered.json)."
                    ),
                )
            ),
            parameters.cluster(),
            *(parameters.product(self.ID, name) for name in ("output_scene", "differences", "offsets", "report")),
        ]
