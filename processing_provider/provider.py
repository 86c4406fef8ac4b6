"""The provider ``repm``: every algorithm of this folder, then the models of resources/models."""

from __future__ import annotations

import configparser
import os

from qgis.core import QgsApplication, QgsProcessingProvider
from qgis.PyQt.QtGui import QIcon

from . import settings
from .base import PLUGIN_FOLDER, resource
from .batch import Batch
from .buildings import Buildings
from .change import Change
from .checkgcps import CheckGcps
from .comparedsm import CompareDsm
from .dsmfuse import DsmFuse
from .dtm import Dtm
from .editdsm import EditDsm
from .environment import Environment
from .epmfit import EpmFit
from .errormap import ErrorMap
from .exportcameras import ExportCameras
from .exportrpc import ExportRpc
from .inspect import Inspect
from .models import MODELS
from .mosaic import Mosaic
from .pipeline import Pipeline
from .reconstruct import Reconstruct
from .refine import Refine
from .register import Register
from .sampledata import SampleData
from .series import Series
from .tiles3d import Tiles3d
from .viewer import Viewer

ALGORITHMS = (
    Inspect,
    EpmFit,
    ErrorMap,
    Refine,
    Reconstruct,
    Register,
    DsmFuse,
    Mosaic,
    Dtm,
    Buildings,
    EditDsm,
    Pipeline,
    Batch,
    CompareDsm,
    CheckGcps,
    Viewer,
    Tiles3d,
    Change,
    Series,
    SampleData,
    Environment,
    ExportCameras,
    ExportRpc,
)


class RepmProvider(QgsProcessingProvider):
    """What the Processing Toolbox shows as "REPM"."""

    def id(self) -> str:
        return "repm"

    def name(self) -> str:
        return "REPM"

    def longName(self) -> str:
        return self.tr("REPM: surface models from satellite images ({version})").format(version=self.versionInfo())

    def versionInfo(self) -> str:
        metadata = configparser.ConfigParser(interpolation=None)
        metadata.read(os.path.join(PLUGIN_FOLDER, "metadata.txt"), encoding="utf-8")
        return metadata.get("general", "version", fallback="")

    def icon(self) -> QIcon:
        return QIcon(self.svgIconPath())

    def svgIconPath(self) -> str:
        return resource("icons", "repm.svg")

    def load(self) -> bool:
        settings.register(self.svgIconPath())
        self.refreshAlgorithms()
        return True

    def unload(self) -> None:
        settings.unregister()

    def loadAlgorithms(self) -> None:
        for algorithm in ALGORITHMS:
            self.addAlgorithm(algorithm())
        if QgsApplication.processingRegistry().providerById(self.id()) is None:
            return  # a model asks the registry for its children's outputs; plugin.py refreshes once we are known
        for model in (kind() for kind in MODELS):
            if model.read():
                self.addAlgorithm(model)

    def defaultVectorFileExtension(self, hasGeometry: bool = True) -> str:  # noqa: N803 - QGIS's name
        return "gpkg"

    def defaultRasterFileExtension(self) -> str:
        return "tif"

    def supportedOutputVectorLayerExtensions(self) -> list[str]:
        return ["gpkg"]

    def supportedOutputRasterLayerExtensions(self) -> list[str]:
        return ["tif", "tiff"]

    def supportsNonFileBasedOutput(self) -> bool:
        return False
