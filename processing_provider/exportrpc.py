"""repm:exportrpc."""

from __future__ import annotations

from . import parameters
from .base import RepmAlgorithm


class ExportRpc(RepmAlgorithm):
    """Writes the images' RPCs with the scene's pointing in them for other software."""

    ID = "exportrpc"
    GROUP = "cameras"
    STEP = 5
    TAGS = "RPC,RPB,RPC.TXT,VRT,bias compensation,georeferencing,GDAL,gdalwarp,OTB,CARS,S2P,ASP,export"
    HEAVY = False

    def title(self) -> str:
        return self.tr("Export corrected RPCs")

    def shortDescription(self) -> str:
        return self.tr("The RPC of each image with its pointing correction, as GDAL, OTB, CARS, S2P and ASP read it.")

    def parameters(self) -> list:
        return [
            parameters.scene(self.tr("Scene")),
            parameters.gcps(),
            parameters.gcp_datum(),
            *(parameters.product(self.ID, name) for name in ("rpc_folder", "report")),
        ]
