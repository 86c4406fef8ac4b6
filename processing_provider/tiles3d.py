"""repm:tiles3d."""

from __future__ import annotations

from qgis.core import QgsProcessingOutputFile

from . import parameters
from .base import RepmAlgorithm


class Tiles3d(RepmAlgorithm):
    """Writes a DSM as 3-D Tiles."""

    ID = "tiles3d"
    GROUP = "evaluation"
    STEP = 6
    TAGS = "3D Tiles,Cesium,CesiumJS,globe,glTF,GLB,mesh,tileset,web,share"

    def title(self) -> str:
        return self.tr("Write a DSM as 3-D Tiles")

    def shortDescription(self) -> str:
        return self.tr("The surface as a tileset for CesiumJS, QGIS and other viewers that show it on the globe.")

    def parameters(self) -> list:
        return [
            parameters.helped(
                parameters.Raster("DSM", self.tr("DSM to write")),
                self.tr("A raster of heights, in any CRS: a surface or a terrain model, of this plugin or of others."),
            ),
            parameters.helped(
                parameters.Raster("ORTHO", self.tr("Orthophoto"), optional=True),
                self.tr("A picture to drape over the surface, grey or in colour, in any CRS. Empty: a hillshade."),
            ),
            parameters.product(self.ID, "tiles3d"),
        ]

    def extra_outputs(self) -> list:
        return [QgsProcessingOutputFile("TILESET", self.tr("The file to open: tileset.json"))]
