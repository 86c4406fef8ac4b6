"""repm:epmfit."""

from __future__ import annotations

from . import parameters
from .base import RepmAlgorithm


class EpmFit(RepmAlgorithm):
    """Fits pinhole cameras to the RPCs of images, tile by tile.

    It takes seconds, and yet a process of its own: QGIS loads GSL's linear algebra (on Debian), which numpy then uses
    there, and whose sums differ in their last bits. The cameras would not be those of the pipeline.
    """

    ID = "epmfit"
    GROUP = "cameras"
    STEP = 1
    TAGS = "EPM,DLT,camera model,equivalent error,tiles"

    def title(self) -> str:
        return self.tr("Fit equivalent pinhole cameras")

    def shortDescription(self) -> str:
        return self.tr(
            "Fits pinhole cameras to images with RPCs, tile by tile, and measures the error that this causes."
        )

    def parameters(self) -> list:
        return [
            parameters.images(least=1),
            parameters.extent(),
            parameters.dem(),
            parameters.rpcs(),
            parameters.masks(),
            *parameters.altitudes(),
            parameters.ortho_ready_height(),
            *parameters.tiles_and_budget(),
            *(parameters.product(self.ID, name) for name in ("workspace", "tiles", "report")),
        ]
