"""repm:inspect."""

from __future__ import annotations

from . import parameters
from .base import RepmAlgorithm


class Inspect(RepmAlgorithm):
    """Shows where images lie, how they overlap, and which pairs are worth matching, before anything is computed."""

    ID = "inspect"
    GROUP = "tools"
    STEP = 3
    TAGS = "footprint,overlap,coverage,GSD,base-to-height,B/H,convergence,incidence,off-nadir,sun,date,pair selection"
    HEAVY = False

    def title(self) -> str:
        return self.tr("Inspect images")

    def shortDescription(self) -> str:
        return self.tr("Footprints, overlaps, and the pairs that are worth matching: in seconds, before any matching.")

    def parameters(self) -> list:
        return [
            parameters.images(least=1),
            parameters.rpcs(),
            *(parameters.product(self.ID, name) for name in ("footprints", "overlaps", "report")),
        ]
