"""repm:viewer."""

from __future__ import annotations

from ..repm_qgis.contracts.options import ViewerOptions
from . import parameters
from .base import RepmAlgorithm


class Viewer(RepmAlgorithm):
    """Shows a DSM in 3-D in a page for the browser."""

    ID = "viewer"
    GROUP = "evaluation"
    STEP = 3
    TAGS = "3D,viewer,WebGL,HTML,profile,cross section,drape,share,browser"
    HEAVY = False

    def title(self) -> str:
        return self.tr("Show a DSM in the browser (3-D)")

    def shortDescription(self) -> str:
        return self.tr("One HTML page with the surface in 3-D, what is draped over it, and profiles; needs no network.")

    def parameters(self) -> list:
        return [
            parameters.helped(
                parameters.Raster("DSM", self.tr("DSM to show")),
                self.tr("A raster of heights, in any CRS: a surface or a terrain model, of this plugin or of others."),
            ),
            parameters.helped(
                parameters.Raster("ORTHO", self.tr("Orthophoto"), optional=True),
                self.tr("A picture to drape over the surface, grey or in colour, in any CRS."),
            ),
            parameters.helped(
                parameters.Raster("CONFIDENCE", self.tr("Confidence"), optional=True),
                self.tr("The confidence raster that came with the DSM, or one band with the expected error in metres."),
            ),
            parameters.helped(
                parameters.Raster("DIFFERENCE", self.tr("Height difference"), optional=True),
                self.tr("A raster of differences in metres, such as the height error of a comparison."),
            ),
            parameters.advanced(
                parameters.number(
                    ViewerOptions,
                    "cells",
                    self.tr("Most cells of the page"),
                    self.tr(
                        "Where the DSM has more, each cell of the page is a mean. A page of 4 million has 5 to 15 MB."
                    ),
                )
            ),
            parameters.product(self.ID, "viewer"),
        ]
