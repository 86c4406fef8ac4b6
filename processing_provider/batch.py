"""repm:batch."""

from __future__ import annotations

import os

from qgis.core import (
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeedback,
    QgsProcessingParameterEnum,
    QgsProcessingParameterFile,
)

from ..repm_qgis.contracts.documents import JsonMapping, JsonObject
from ..repm_qgis.contracts.options import BATCH_PRODUCTS, BatchOptions
from ..repm_qgis.contracts.products import SO_FAR
from . import parameters
from .last_scene import remember_workspace
from .pipeline import Pipeline

_MOST_REMEMBERED = 20  # of the scenes, so that workspaces of other runs stay in the panel


class Batch(Pipeline):
    """The pipeline for many scenes, one after the other."""

    ID = "batch"
    STEP = 3
    TAGS = "batch,bulk,many,sites,series,folder,table,CSV,STAC,catalogue,block"

    def title(self) -> str:
        return self.tr("Make DSMs of many scenes")

    def shortDescription(self) -> str:
        return self.tr(
            "A DSM of each subfolder, STAC item or row of a table, with a layer and a report of all of them."
        )

    def parameters(self) -> list:
        kinds = QgsProcessingParameterFile.Behavior
        folder = QgsProcessingParameterFile("FOLDER", self.tr("Folder of scenes"), kinds.Folder, optional=True)
        tables = f"{self.tr('Tables and STAC files')} (*.csv *.json *.geojson)"
        table = QgsProcessingParameterFile(
            "TABLE", self.tr("Table or STAC file of scenes"), kinds.File, optional=True, fileFilter=tables
        )
        products = QgsProcessingParameterEnum(
            "PRODUCTS",
            self.tr("Products of each scene beside its DSM"),
            list(BATCH_PRODUCTS),
            allowMultiple=True,
            defaultValue=list(BatchOptions.default_of("products")),
            optional=True,
            usesStaticStrings=True,
        )
        crs, *stages = parameters.of_all_stages()
        return [
            parameters.helped(
                folder,
                self.tr("Each of its subfolders and ZIP or TAR files is a scene: it holds the images with RPCs."),
            ),
            parameters.helped(
                table,
                self.tr(
                    "In place of a folder: a CSV file with a row for each scene, whose columns are scene (its name), "
                    "images (files, a folder or an archive; with ; between) and options in small letters, such as "
                    "extent or resolution, which go before those below. Or a STAC item, collection or catalogue."
                ),
            ),
            parameters.helped(products, self.tr("Each takes time and space for each scene.")),
            parameters.references(optional=True),
            parameters.resolution(),
            parameters.vertical_datum(),
            parameters.preset(),
            parameters.basic(parameters.quality()),
            parameters.ortho_ready_height(),
            crs,
            parameters.advanced(parameters.extent()),
            *(each for each in stages if each.name() not in map(str.upper, BatchOptions.OF_ONE)),
            parameters.cluster(),
            *(parameters.product(self.ID, name) for name in ("workspace", "output", "mosaic", "report")),
        ]

    def complete(self, options: JsonObject) -> JsonObject:
        return options

    def processAlgorithm(
        self, parameters: JsonMapping, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> JsonObject:
        try:
            made = super().processAlgorithm(parameters, context, feedback)
        except QgsProcessingException:
            path = os.path.join(self.parameterAsString(parameters, "WORKSPACE", context), f"{SO_FAR}.gpkg")
            if os.path.exists(path):
                feedback.pushInfo(self.tr("The scenes that were complete by then are in '{path}'.").format(path=path))
            raise
        self._folders = [os.path.dirname(dsm) for dsm in made["DSMS"]]
        return made

    def postProcessAlgorithm(self, context: QgsProcessingContext, feedback: QgsProcessingFeedback) -> JsonObject:
        for folder in reversed(self._folders[:_MOST_REMEMBERED]):  # which the panel of scenes shows, the first on top
            remember_workspace(folder)
        return super().postProcessAlgorithm(context, feedback)

    def _scene_name(self, options: JsonMapping) -> str:
        from ..repm_qgis.names import folder_name

        return folder_name(options["workspace"])
