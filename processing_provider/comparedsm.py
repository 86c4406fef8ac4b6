"""repm:comparedsm."""

from __future__ import annotations

import re

from qgis.core import (
    QgsProcessing,
    QgsProcessingParameterString,
)

from ..repm_qgis.contracts.documents import JsonObject
from ..repm_qgis.contracts.options import CompareDsmOptions
from . import parameters
from .base import RepmAlgorithm


def thresholds(text: str) -> object:
    """Numbers between commas, semicolons or spaces; anything else stays as it is, for the engine to refuse."""
    try:
        return [float(word) for word in re.split(r"[\s,;]+", text.strip()) if word]
    except ValueError:
        return text


class CompareDsm(RepmAlgorithm):
    """Compares a DSM with a reference."""

    ID = "comparedsm"
    GROUP = "evaluation"
    STEP = 1
    TAGS = "accuracy,RMSE,NMAD,completeness,co-registration,Nuth,LiDAR"

    def title(self) -> str:
        return self.tr("Compare a DSM with a reference")

    def shortDescription(self) -> str:
        return self.tr("Height errors of a DSM: map, statistics and completeness, after an optional alignment.")

    def parameters(self) -> list:
        return [
            parameters.surface_or_cloud(
                "DSM",
                self.tr("DSM or point cloud to measure"),
                self.tr(
                    "A raster of heights in metres, in any CRS, which is resampled to the reference's cells; or a "
                    "point cloud (LAZ, LAS)."
                ),
            ),
            parameters.surface_or_cloud(
                "REFERENCE",
                self.tr("Reference (DSM or point cloud)"),
                self.tr(
                    "A raster of heights in metres that are assumed to be right, such as one from lidar; or a point "
                    "cloud "
                    "(LAZ, LAS), whose first returns become means on the DSM's cells."
                ),
            ),
            parameters.choice(
                CompareDsmOptions,
                "align",
                self.tr("Alignment before the comparison"),
                self.tr(
                    "none: no alignment; vertical: a constant offset in height is removed; 3d: a shift in all three "
                    "axes is removed, found by the slopes of cells; icp: such a shift, found by the nearest points of "
                    "flat parts, which is more repeatable against point clouds and takes longer."
                ),
            ),
            parameters.helped(
                QgsProcessingParameterString(
                    "THRESHOLDS",
                    self.tr("Thresholds of the completeness (m)"),
                    "; ".join(f"{height:g}" for height in CompareDsmOptions.default_of("thresholds")),
                ),
                self.tr("For each of these: the share of the reference's cells whose height is right to within it."),
            ),
            parameters.helped(
                parameters.Rasters(
                    "OTHERS",
                    self.tr("Further DSMs for the same table"),
                    QgsProcessing.SourceType.TypeMapLayer,
                    optional=True,
                ),
                self.tr(
                    "Other DSMs of the same ground, such as another program's, as rasters or point clouds (LAZ, LAS): "
                    "the report shows all of them side by side, each aligned on its own."
                ),
            ),
            parameters.helped(
                parameters.Raster("CLASSES", self.tr("Class raster"), optional=True),
                self.tr(
                    "Whole numbers such as those of a land cover map or a mask, in any CRS: the "
                    "report gives the errors of each class."
                ),
            ),
            parameters.helped(
                parameters.Points(
                    "PROFILES", self.tr("Profile lines"), [QgsProcessing.SourceType.TypeVectorLine], optional=True
                ),
                self.tr(
                    "Lines along which heights are shown, named by their field 'name'. Empty: two lines through the "
                    "middle."
                ),
            ),
            parameters.cluster(),
            *(parameters.product(self.ID, name) for name in ("error", "report")),
        ]

    def complete(self, options: JsonObject) -> JsonObject:
        return {**options, "thresholds": thresholds(options["thresholds"])}
