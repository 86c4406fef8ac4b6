"""repm:tiles3d."""

from __future__ import annotations

from . import parameters
from .base import RepmAlgorithm


class Tiles3d(RepmAlgorithm):
    """Writes a DSM or a point cloud as 3-D Tiles."""

    ID = "tiles3d"
    GROUP = "evaluation"
    STEP = 6
    TAGS = "3D Tiles,Cesium,CesiumJS,globe,glTF,GLB,mesh,point cloud,LAZ,LAS,tileset,web,share"

    def title(self) -> str:
        return self.tr("Write a DSM or a point cloud as 3-D Tiles")

    def shortDescription(self) -> str:
        return self.tr(
            "The surface or the points as a tileset for CesiumJS, QGIS and other viewers that show it on the globe."
        )

    def parameters(self) -> list:
        return [
            parameters.surface_or_cloud(
                "DSM",
                self.tr("DSM or point cloud to write"),
                self.tr(
                    "A raster of heights, in any CRS: a surface or a terrain model, of this plugin or of others. Or a "
                    "point cloud (LAZ, LAS): its points are written, which QGIS does not draw, and CesiumJS does."
                ),
            ),
            parameters.helped(
                parameters.Raster("ORTHO", self.tr("Orthophoto"), optional=True),
                self.tr(
                    "A picture to drape over the surface, grey or in colour, in any CRS. Empty: a hillshade. For a "
                    "point cloud: leave it empty, its points keep their own colours."
                ),
            ),
            parameters.product(self.ID, "tiles3d"),
        ]
