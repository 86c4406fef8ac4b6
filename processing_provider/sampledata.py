"""repm:sampledata."""

from __future__ import annotations

from qgis.core import (
    QgsProcessingOutputMultipleLayers,
    QgsProcessingOutputRasterLayer,
    QgsProcessingOutputVectorLayer,
)

from ..repm_qgis.options import SampleDataOptions
from . import parameters
from .base import RepmAlgorithm


class SampleData(RepmAlgorithm):
    """Makes a truth scene: simulated images of a known surface."""

    ID = "sampledata"
    GROUP = "tools"
    TAGS = "simulation,truth,example,tutorial,pushbroom,GCP"

    def displayName(self) -> str:
        return self.tr("Make sample images")

    def shortDescription(self) -> str:
        return self.tr(
            "Simulated tri-stereo images with RPCs of a known surface, to try the plugin and to measure its accuracy."
        )

    def parameters(self) -> list:
        return [
            parameters.choice(SampleDataOptions, "kind", self.tr("Landscape")),
            parameters.number(SampleDataOptions, "size", self.tr("Size of the images (px)")),
            parameters.number(
                SampleDataOptions, "seed", self.tr("Seed"), self.tr("The same seed makes the same files.")
            ),
            parameters.product(self.ID, "folder"),
        ]

    def extra_outputs(self) -> list:
        return [
            QgsProcessingOutputMultipleLayers("IMAGES", self.tr("Images")),
            QgsProcessingOutputRasterLayer("TRUTH", self.tr("True DSM")),
            QgsProcessingOutputVectorLayer("GCPS", self.tr("Ground control points")),
        ]
