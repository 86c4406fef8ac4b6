"""repm:reconstruct."""

from __future__ import annotations

from . import parameters
from .base import RepmAlgorithm


class Reconstruct(RepmAlgorithm):
    """Tie points, relative pointing and dense matching."""

    ID = "reconstruct"
    GROUP = "surface"
    STEP = 1
    TAGS = (
        "SfM,MVS,tie points,GCP,ground control,bundle adjustment,dense matching,SGM,disparity,COLMAP,"
        "PatchMatch,CUDA,GPU"
    )
    USES_WORKERS = True

    def title(self) -> str:
        return self.tr("Reconstruct heights")

    def shortDescription(self) -> str:
        return self.tr("Tie points and relative pointing of the views, then a height map of every pair and tile.")

    def parameters(self) -> list:
        return [
            parameters.scene(),
            parameters.backend(),
            parameters.gcps(),
            parameters.gcp_datum(),
            parameters.quality(),
            parameters.pairs(),
            parameters.matching_cost(),
            parameters.pointing(),
            parameters.adjustment(),
            *parameters.patch_match(),
            parameters.cluster(),
            *(parameters.product(self.ID, name) for name in ("output_scene", "tie_points", "heights")),
        ]
