"""repm:buildings."""

from __future__ import annotations

from ..repm_qgis.contracts.options import BuildingsOptions
from . import parameters
from .base import RepmAlgorithm


class Buildings(RepmAlgorithm):
    """Finds the buildings of a DSM."""

    ID = "buildings"
    GROUP = "derived"
    STEP = 4
    TAGS = "buildings,footprints,roofs,CityJSON,CityGML,LoD1,LoD2,city model,3-D city,nDSM,building heights"
    USES_WORKERS = True

    def title(self) -> str:
        return self.tr("Find buildings: footprints, heights, roofs")

    def shortDescription(self) -> str:
        return self.tr("Footprints with heights and their errors, and closed solids with simple roofs (CityJSON).")

    def parameters(self) -> list:
        return [
            parameters.helped(
                parameters.Raster("DSM", self.tr("DSM with houses and trees")),
                self.tr("A surface model of this plugin or of others, in a projected CRS; heights in metres."),
            ),
            parameters.helped(
                parameters.Raster("DTM", self.tr("Terrain below it (DTM)"), optional=True),
                self.tr(
                    "Bare earth in any CRS, such as that of Find the terrain below houses and trees. Empty: it is made "
                    "of the DSM first."
                ),
            ),
            parameters.helped(
                parameters.Raster("CONFIDENCE", self.tr("Confidence of the DSM"), optional=True),
                self.tr(
                    "The raster that was written with the DSM: heights that were filled in do not count, and the "
                    "errors of the heights follow from it."
                ),
            ),
            parameters.helped(
                parameters.Raster("ORTHO", self.tr("Orthophoto with near infrared"), optional=True),
                self.tr(
                    "A picture whose bands are named red and near infrared: where it is green, there are trees. "
                    "Without it, smooth crowns may be taken for small buildings."
                ),
            ),
            parameters.number(
                BuildingsOptions,
                "min_height",
                self.tr("Lowest building (m)"),
                self.tr("Above the terrain; lower things are cars, hedges and garden sheds."),
            ),
            parameters.number(
                BuildingsOptions,
                "min_area",
                self.tr("Smallest building (m²)"),
                self.tr("The area of the footprint. Below 50 m², many of the smaller things are crowns of trees."),
            ),
            parameters.cluster(),
            *(parameters.product(self.ID, name) for name in ("output", "cityjson", "report")),
        ]
