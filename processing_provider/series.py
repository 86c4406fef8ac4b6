"""repm:series."""

from __future__ import annotations

import os
import re

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingParameterString,
    QgsProcessingUtils,
)

from ..repm_qgis.contracts.documents import JsonMapping, JsonObject
from ..repm_qgis.contracts.options import SeriesOptions
from . import parameters, styles
from .base import RepmAlgorithm


def dates(text: str) -> list[str]:
    """Days or times between commas or semicolons."""
    return [word.strip() for word in re.split(r"[,;]", text or "") if word.strip()]


class Series(RepmAlgorithm):
    """Follows one surface over three dates or more."""

    ID = "series"
    GROUP = "evaluation"
    STEP = 5
    TAGS = "time series,trend,Theil-Sen,glacier,mass balance,quarry,subsidence,temporal,volume over time"

    def title(self) -> str:
        return self.tr("Follow a surface over many dates")

    def shortDescription(self) -> str:
        return self.tr("Trends with their errors, dates of change and volumes over time, from three DSMs or more.")

    def parameters(self) -> list:
        return [
            parameters.helped(
                parameters.Rasters("DSMS", self.tr("DSMs of all dates"), QgsProcessing.SourceType.TypeRaster),
                self.tr(
                    "Three or more rasters of heights in metres, in any order and any CRS, with heights of one datum. "
                    "Register them before, or set the alignment."
                ),
            ),
            parameters.helped(
                QgsProcessingParameterString("DATES", self.tr("Dates of the DSMs"), optional=True),
                self.tr(
                    "One for each DSM, in the order of the DSMs, with commas between: 2022-05-01, 2023-04-17, ... "
                    "Empty: the files say it, as DSMs of this plugin and STAC items beside them do."
                ),
            ),
            parameters.helped(
                parameters.Points(
                    "AREAS",
                    self.tr("Areas whose volumes are followed"),
                    [QgsProcessing.SourceType.TypeVectorPolygon],
                    optional=True,
                ),
                self.tr(
                    "Polygons such as glaciers or quarries, named by their field 'name'; the ground outside of them is "
                    "taken as stable. Empty: what changed significantly is outlined."
                ),
            ),
            parameters.choice(
                SeriesOptions,
                "align",
                self.tr("Alignment on stable ground"),
                self.tr(
                    "none: offsets of the dates are reported and counted as errors; vertical: each DSM is moved up or "
                    "down until it agrees with the first where nothing changed; 3d: in all three axes."
                ),
            ),
            parameters.number(
                SeriesOptions,
                "min_area",
                self.tr("Smallest area (m²)"),
                self.tr("Smaller areas of change are not outlined; areas that you give have any size."),
            ),
            parameters.confidences(
                self.tr(
                    "Heights that were filled in do not count then, and each height has its own error. "
                    "Empty: one error for each date, found where nothing changed."
                )
            ),
            parameters.cluster(),
            *(
                parameters.product(self.ID, name)
                for name in ("output", "trend", "changed", "volumes", "layers", "table", "report")
            ),
        ]

    def complete(self, options: JsonObject) -> JsonObject:
        return {**options, "dates": dates(options["dates"])}

    def processAlgorithm(
        self, parameters: JsonMapping, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> JsonObject:
        made = super().processAlgorithm(parameters, context, feedback)
        if context.project() is not None and made.get("MAPS"):
            self._load(made["MAPS"], context)
        return made

    def _load(self, maps: list[str], context: QgsProcessingContext) -> None:
        """Have the layer of each date loaded: QGIS knows their folder as the result, and loads no folder."""
        run = styles.Run(self._scene_name(self._inputs), self._taken)
        for path in maps:
            stem = os.path.splitext(path)[0]
            name = run.name(self.tr("Heights"), os.path.basename(stem))
            styles.load_too(context, path, QgsProcessingUtils.LayerHint.Raster, name, "dated", run, f"{stem}.qml")

    def _scene_name(self, options: JsonMapping) -> str:
        from ..repm_qgis.names import dates_name

        return dates_name(*options["dsms"])

    def _days(self, options: JsonMapping, result: JsonMapping) -> list[str]:
        self._taken = [label.split(" ")[0] for label in result["dates"]]
        return self._taken
