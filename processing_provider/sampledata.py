"""repm:sampledata."""

from __future__ import annotations

import os

from qgis.core import (
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingUtils,
)
from qgis.PyQt.QtCore import QUrl, QUrlQuery

from ..repm_qgis.contracts.documents import JsonMapping, JsonObject
from ..repm_qgis.contracts.options import SampleDataOptions
from . import parameters, styles
from .base import RepmAlgorithm


class SampleData(RepmAlgorithm):
    """Makes a truth scene: simulated images of a known surface."""

    ID = "sampledata"
    GROUP = "tools"
    STEP = 2
    TAGS = "simulation,truth,example,tutorial,pushbroom,GCP"

    def title(self) -> str:
        return self.tr("Make sample images")

    def shortDescription(self) -> str:
        return self.tr(
            "Simulated tri-stereo images with RPCs of a known surface, to try the plugin and to measure its accuracy."
        )

    def parameters(self) -> list:
        return [
            parameters.choice(
                SampleDataOptions,
                "kind",
                self.tr("Landscape"),
                self.tr("urban: a town with houses, trees and cars; mountains: steep ground without houses."),
            ),
            parameters.number(
                SampleDataOptions,
                "size",
                self.tr("Size of the images (px)"),
                self.tr("Columns and rows of each image: 800 takes a quarter of the time of 1600."),
            ),
            parameters.number(
                SampleDataOptions, "seed", self.tr("Seed"), self.tr("The same seed makes the same files.")
            ),
            parameters.product(self.ID, "folder"),
        ]

    def processAlgorithm(
        self, parameters: JsonMapping, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> JsonObject:
        made = super().processAlgorithm(parameters, context, feedback)
        if context.project() is not None:
            self._load(made, context, feedback)
        return made

    def _load(self, made: JsonMapping, context: QgsProcessingContext, feedback: QgsProcessingFeedback) -> None:
        """Have the scene loaded as a group: QGIS knows the folder as the only result, and loads no folder."""
        from ..repm_qgis.names import folder_name

        run = styles.Run(folder_name(made["FOLDER"]) or self.tr("Sample images"), data=True)
        hints = QgsProcessingUtils.LayerHint
        points = QUrl.fromLocalFile(made["GCPS"])
        query = QUrlQuery()
        for item in (("type", "csv"), ("xField", "lon"), ("yField", "lat"), ("crs", "EPSG:4326")):
            query.addQueryItem(*item)
        points.setQuery(query)
        truth = styles.sidecar("dsm", made["TRUTH"], feedback)
        styles.load_too(context, made["TRUTH"], hints.Raster, run.name(self.tr("True DSM")), "dsm", run, truth)
        for image in made["IMAGES"]:
            name = os.path.splitext(os.path.basename(image))[0]
            styles.load_too(context, image, hints.Raster, name, "image", run)
        source = f"delimitedtext://{points.toString(QUrl.ComponentFormattingOption.FullyEncoded)}"
        styles.load_too(context, source, hints.Vector, run.name(self.tr("Ground control points")), "gcps", run)
