"""repm:refine."""

from __future__ import annotations

from . import parameters
from .base import RepmAlgorithm


class Refine(RepmAlgorithm):
    """Makes images that a pinhole camera would have seen."""

    ID = "refine"
    GROUP = "cameras"
    STEP = 3
    USES_WORKERS = True
    TAGS = "EPM,REPM,resampling,polynomial,homography,terrain,relief"

    def title(self) -> str:
        return self.tr("Refine the images")

    def shortDescription(self) -> str:
        return self.tr("Resamples every view's tiles to what its pinhole camera would have seen.")

    def parameters(self) -> list:
        return [
            parameters.scene(),
            parameters.model(),
            parameters.surface(),
            parameters.advanced(parameters.order()),
            parameters.advanced(parameters.kernel()),
            *(parameters.product(self.ID, name) for name in ("output_scene", "report")),
        ]
