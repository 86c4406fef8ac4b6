"""repm:dtm."""

from __future__ import annotations

from qgis.core import (
    QgsProcessingParameterFile,
)

from ..repm_qgis.contracts.options import DtmOptions
from . import parameters
from .base import RepmAlgorithm


class Dtm(RepmAlgorithm):
    """Finds the terrain below the houses and trees of a DSM."""

    ID = "dtm"
    GROUP = "derived"
    STEP = 2
    TAGS = "DTM,nDSM,bare earth,terrain model,ground filter,building heights,normalised surface model"
    USES_WORKERS = True

    def title(self) -> str:
        return self.tr("Find the terrain below houses and trees (DTM)")

    def shortDescription(self) -> str:
        return self.tr("Bare earth from a DSM, with the heights of objects on it and a mask of objects.")

    def parameters(self) -> list:
        scene = QgsProcessingParameterFile(
            "SCENE",
            self.tr("Scene (instead of the DSM)"),
            QgsProcessingParameterFile.Behavior.File,
            fileFilter=parameters.SCENE_FILTER,
            optional=True,
        )
        return [
            parameters.helped(
                parameters.Raster("DSM", self.tr("DSM with houses and trees"), optional=True),
                self.tr("A surface model of this plugin or of others, in a projected CRS; heights in metres."),
            ),
            parameters.helped(
                scene,
                self.tr("A reconstructed scene (reconstructed.json): it is fused to a DSM first, with its confidence."),
            ),
            parameters.helped(
                parameters.Raster("CONFIDENCE", self.tr("Confidence of the DSM"), optional=True),
                self.tr(
                    "The raster that was written with the DSM: heights that were interpolated do not count as ground, "
                    "and those with a wide expected error count for less."
                ),
            ),
            parameters.number(
                DtmOptions,
                "largest",
                self.tr("Largest object (m)"),
                self.tr(
                    "The width of the widest building, across its narrower side: wider objects count as ground. A "
                    "smaller value takes less time."
                ),
            ),
            parameters.number(
                DtmOptions,
                "slope",
                self.tr("Steepest ground (%)"),
                self.tr(
                    "An object has walls steeper than this around it. Choose more where hill tops are gone, such as "
                    "100 "
                    "in mountains, and less where low buildings stay in the terrain."
                ),
            ),
            parameters.advanced(
                parameters.choice(
                    DtmOptions,
                    "voids",
                    self.tr("Terrain where the DSM has no height"),
                    self.tr(
                        "inside: where heights surround the void, and it is no wider than the largest object; none: "
                        "nowhere."
                    ),
                )
            ),
            parameters.cluster(),
            *(parameters.product(self.ID, name) for name in ("output", "heights", "mask", "report")),
        ]
