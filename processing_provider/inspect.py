"""repm:inspect."""

from __future__ import annotations

from typing import Any, Mapping

from qgis.core import (
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingOutputMultipleLayers,
    QgsProcessingOutputNumber,
)

from . import parameters
from .base import RepmAlgorithm


class Inspect(RepmAlgorithm):
    """Shows where images lie, how they overlap, and which pairs are worth matching, before anything is computed."""

    ID = "inspect"
    GROUP = "tools"
    STEP = 3
    TAGS = "footprint,overlap,coverage,GSD,base-to-height,B/H,convergence,incidence,off-nadir,sun,date,pair selection"
    HEAVY = False

    def title(self) -> str:
        return self.tr("Inspect images")

    def shortDescription(self) -> str:
        return self.tr("Footprints, overlaps, and the pairs that are worth matching: in seconds, before any matching.")

    def parameters(self) -> list:
        return [
            parameters.images(least=1),
            parameters.rpcs(),
            *(parameters.product(self.ID, name) for name in ("footprints", "overlaps", "report")),
        ]

    def extra_outputs(self) -> list:
        return [
            QgsProcessingOutputNumber("N_IMAGES", self.tr("Number of images that can be used")),
            QgsProcessingOutputNumber("N_PAIRS", self.tr("Number of pairs that are worth matching")),
            QgsProcessingOutputMultipleLayers("PAIR", self.tr("Images of the best pair")),
            QgsProcessingOutputMultipleLayers("TRIPLET", self.tr("Images of the best triplet")),
        ]

    def processAlgorithm(
        self, parameters: Mapping[str, Any], context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict[str, Any]:
        self._found = super().processAlgorithm(parameters, context, feedback)
        return self._found

    def postProcessAlgorithm(self, context: QgsProcessingContext, feedback: QgsProcessingFeedback) -> dict[str, Any]:
        """In the desktop, buttons make a DSM of the images that fit best."""
        try:
            from ..desktop.next_steps import offer
        except ImportError:  # QGIS without its desktop
            return super().postProcessAlgorithm(context, feedback)
        words = {"PAIR": self.tr("DSM of the best pair…"), "TRIPLET": self.tr("DSM of the best triplet…")}
        steps = [
            (text, "repm:pipeline", {"IMAGES": self._found[name]})
            for name, text in words.items()
            if name in self._found
        ]
        offer(self.tr("The images are inspected."), steps, self.ID)
        return super().postProcessAlgorithm(context, feedback)
