"""repm:dsmfuse."""

from __future__ import annotations

from . import parameters
from .base import RepmAlgorithm


class DsmFuse(RepmAlgorithm):
    """Fuses height maps into a DSM."""

    ID = "dsmfuse"
    GROUP = "surface"
    STEP = 3
    TAGS = "fusion,gridding,outliers,point cloud,orthophoto,surface model"
    USES_WORKERS = True

    def title(self) -> str:
        return self.tr("Fuse heights into a DSM")

    def shortDescription(self) -> str:
        return self.tr("Makes one DSM from the height maps of all pairs, without outliers, and with its confidence.")

    def parameters(self) -> list:
        return [
            parameters.scene(),
            parameters.resolution(),
            parameters.crs(),
            parameters.vertical_datum(),
            *parameters.fusion(),
            *parameters.colours(),
            parameters.cluster(),
            *parameters.dsm_products(),
            parameters.product(self.ID, "report"),
        ]
