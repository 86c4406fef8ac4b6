"""repm:mosaic."""

from __future__ import annotations

from qgis.core import (
    QgsProcessing,
    QgsProcessingParameterCrs,
    QgsProcessingParameterMultipleLayers,
)

from ..repm_qgis.contracts.documents import JsonMapping
from ..repm_qgis.contracts.options import MosaicOptions
from . import parameters
from .base import RepmAlgorithm


class Mosaic(RepmAlgorithm):
    """Puts many DSMs together to one."""

    ID = "mosaic"
    GROUP = "mosaic"
    STEP = 1
    TAGS = "mosaic,merge,seam,blend,offset,block adjustment,surface model"
    USES_WORKERS = True

    def title(self) -> str:
        return self.tr("Make a mosaic of DSMs")

    def shortDescription(self) -> str:
        return self.tr(
            "One DSM from many that overlap: without vertical offsets between them, and without visible seams."
        )

    def parameters(self) -> list:
        rasters = QgsProcessing.SourceType.TypeRaster
        return [
            parameters.helped(
                parameters.Rasters("DSMS", self.tr("DSMs"), rasters, optional=True),
                self.tr(
                    "DSMs of this plugin or of others, in any CRS, with heights of one datum. Two or more, "
                    "together with the scenes."
                ),
            ),
            parameters.helped(
                QgsProcessingParameterMultipleLayers(
                    "SCENES", self.tr("Scenes"), QgsProcessing.SourceType.TypeFile, optional=True
                ),
                self.tr(
                    "Reconstructed scenes (reconstructed.json or registered.json): each is fused to a DSM first. "
                    "Heights of a scene that was registered, or has ground control points, stay as they are."
                ),
            ),
            parameters.helped(
                parameters.Rasters("FIXED", self.tr("DSMs or scenes whose heights are right"), rasters, optional=True),
                self.tr(
                    "Their heights stay, and all others are brought to them. Scenes that were registered, or have "
                    "ground control points, and DSMs of such scenes are included automatically. Where there is none, "
                    "the mean of all offsets is zero."
                ),
            ),
            parameters.number(
                MosaicOptions,
                "resolution",
                self.tr("Resolution (m)"),
                self.tr("Cell size in units of the CRS. 0: the first DSM's."),
            ),
            parameters.helped(
                QgsProcessingParameterCrs("CRS", self.tr("CRS of the mosaic"), optional=True),
                self.tr("A projected CRS. Empty: the first DSM's."),
            ),
            parameters.confidences(
                self.tr("The better of two heights counts for more. Empty: all heights count equally.")
            ),
            parameters.cluster(),
            *(parameters.product(self.ID, name) for name in ("output", "sources", "report")),
        ]

    def _scene_name(self, options: JsonMapping) -> str:
        from ..repm_qgis.names import mosaic_name

        return mosaic_name(options["output"] or "", [*options["dsms"], *options["scenes"]])
