"""repm:exportcameras."""

from __future__ import annotations

from qgis.core import (
    QgsProcessingParameterString,
)

from ..repm_qgis.contracts.options import ExportCamerasOptions
from . import parameters
from .base import RepmAlgorithm


class ExportCameras(RepmAlgorithm):
    """Writes refined images with their pinhole cameras for other software."""

    ID = "exportcameras"
    GROUP = "cameras"
    STEP = 4
    TAGS = "EPM,COLMAP,MVSNet,WHU-TLC,SatMVS,nerfstudio,NeRF,Gaussian splatting,transforms.json,export"

    def title(self) -> str:
        return self.tr("Export images with pinhole cameras")

    def shortDescription(self) -> str:
        return self.tr("Refined images with their cameras as COLMAP, MVSNet, WHU-TLC or nerfstudio read them.")

    def parameters(self) -> list:
        return [
            parameters.scene(self.tr("Refined scene")),
            parameters.choice(
                ExportCamerasOptions,
                "format",
                self.tr("Format"),
                self.tr(
                    "colmap: PINHOLE cameras, binary and text; mvsnet: cam.txt and pair.txt; whutlc: WHU-TLC's pinhole "
                    "layout for SatMVS, with square pixels; nerfstudio: transforms.json."
                ),
            ),
            parameters.helped(
                QgsProcessingParameterString("TILE", self.tr("Tile"), "", optional=True),
                self.tr("A tile's name as in the TILES layer; each tile is a model of its own."),
            ),
            parameters.advanced(
                parameters.switch(
                    ExportCamerasOptions,
                    "centre",
                    self.tr("Turn the cameras towards their images"),
                    self.tr(
                        "On: principal points lie in the images' middle and pixels are square, as COLMAP's "
                        "triangulation and software in single precision need it. Off: the refined images and "
                        "cameras as they are in the scene."
                    ),
                )
            ),
            parameters.advanced(
                parameters.choice(
                    ExportCamerasOptions,
                    "bits",
                    self.tr("Bits of a pixel"),
                    self.tr(
                        "8: PNG (JPEG for mvsnet), intensity stretched as for matching; 16: TIFF with the images' own "
                        "values, which fewer programs read."
                    ),
                )
            ),
            parameters.advanced(parameters.kernel()),
            parameters.product(self.ID, "folder"),
        ]
