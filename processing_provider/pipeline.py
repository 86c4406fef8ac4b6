"""repm:pipeline."""

from __future__ import annotations

import os
from typing import Mapping

from qgis.core import QgsProcessingContext, QgsProcessingUtils

from ..repm_qgis.contracts.documents import JsonMapping
from ..repm_qgis.contracts.options import PRESETS
from ..repm_qgis.contracts.results import PipelineResult
from . import parameters, styles
from .base import RepmAlgorithm
from .values import command_line


class Pipeline(RepmAlgorithm):
    """From images to a DSM: all stages in one workspace."""

    ID = "pipeline"
    GROUP = "whole"
    STEP = 1
    TAGS = "SfM,MVS,GCP,ground control,surface model,point cloud,orthophoto,REPM,tri-stereo"
    USES_WORKERS = True

    def title(self) -> str:
        return self.tr("Make a DSM from satellite images")

    def shortDescription(self) -> str:
        return self.tr("All stages in one run: pinhole cameras, refinement, tie points, dense matching, fusion.")

    def parameters(self) -> list:
        dsm, *extras = parameters.dsm_products()
        return [
            parameters.images(),
            parameters.extent(),
            parameters.gcps(),
            parameters.references(optional=True),
            parameters.resolution(),
            parameters.vertical_datum(),
            parameters.preset(),
            parameters.basic(parameters.quality()),
            parameters.rpcs(),
            parameters.masks(),
            parameters.ortho_ready_height(),
            *parameters.of_all_stages(),
            parameters.cluster(),
            dsm,
            *(parameters.product(self.ID, name) for name in ("workspace", "report", "tiles", "tie_points")),
            *extras,
        ]

    def left_to_engine(self, parameters: Mapping[str, object]) -> set[str]:
        """The parameters that the preset decides: QGIS's default of a parameter that was not given must not override
        it."""
        preset = PRESETS.get(str(parameters.get("PRESET")), {})
        return {name for name in preset if name.upper() not in parameters}

    def show_more(
        self, context: QgsProcessingContext, outputs: JsonMapping, kept_as: dict[str, str], run: styles.Run
    ) -> None:
        """The layers of a preview, where its DSM is shown."""
        if not context.willLoadLayerOnCompletion(kept_as.get("OUTPUT", "")):
            return
        for kind in ("footprints", "overlaps"):
            path = outputs.get(kind.upper())
            if path:
                title = parameters.tr(PipelineResult.outputs()[kind].label)
                style = os.path.splitext(path)[0] + ".qml"
                hint = QgsProcessingUtils.LayerHint.Vector
                styles.load_too(context, path, hint, run.name(title), kind, run, style)

    def complete(self, options: dict[str, object]) -> dict[str, object]:
        return {**options, "command": command_line(self.id(), options)}
