"""The provider ``repm``: every algorithm of this folder, then the model of resources/models."""

from __future__ import annotations

import configparser
import os
from typing import Any

from qgis.core import QgsApplication, QgsProcessingModelAlgorithm, QgsProcessingProvider, QgsXmlUtils
from qgis.PyQt.QtCore import QCoreApplication
from qgis.PyQt.QtGui import QIcon
from qgis.PyQt.QtXml import QDomDocument

from . import settings
from .base import PLUGIN_FOLDER, RepmAlgorithm, group_title, numbered, resource
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
from .language import said
from .mosaic import Mosaic
from .parameters import tr
from .pipeline import Pipeline
from .reconstruct import Reconstruct
from .refine import Refine
from .register import Register
from .sampledata import SampleData
from .series import Series
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
    EditDsm,
    Pipeline,
    CompareDsm,
    CheckGcps,
    Viewer,
    Change,
    Series,
    SampleData,
    Environment,
    ExportCameras,
    ExportRpc,
)


MODEL = resource("models", "repm_stages.model3")


class ShippedModel(QgsProcessingModelAlgorithm):
    """The stages as a model, under a readable name: the one in its file is an id for scripts."""

    def read(self) -> bool:
        """Read the model's file, whose labels and explanations are shown in QGIS's language."""
        document = QDomDocument()
        with open(MODEL, encoding="utf-8") as stream:
            document.setContent(stream.read())
        # Read once: for a model that is read twice QGIS logs that each output exists already.
        return bool(self.loadVariant(_in_language(QgsXmlUtils.readVariant(document.firstChildElement()))))

    def createCustomParametersWidget(self, parent: Any = None) -> Any:
        return RepmAlgorithm.createCustomParametersWidget(self, parent)

    def createInstance(self) -> ShippedModel:
        model = ShippedModel()
        model.read()
        return model

    def displayName(self) -> str:
        return numbered("whole", 2, self.tr("Make a DSM stage by stage (model)"))

    def tr(self, text: str) -> str:
        return QCoreApplication.translate(type(self).__name__, text)

    def group(self) -> str:
        return group_title("whole")

    def groupId(self) -> str:
        return "whole"

    def tags(self) -> list[str]:
        return RepmAlgorithm().tags()

    def icon(self) -> QIcon:
        return QIcon(self.svgIconPath())

    def svgIconPath(self) -> str:
        return resource("icons", "pipeline.svg")


def _in_language(value: Any, key: str = "") -> Any:
    """A model's description with the texts in it that people read in QGIS's language."""
    if isinstance(value, dict):
        return {name: _in_language(inner, name) for name, inner in value.items()}
    if isinstance(value, list):
        return [_in_language(inner, key) for inner in value]
    if key not in ("description", "component_description", "help", "ALG_DESC", "SHORT_DESCRIPTION") or not isinstance(
        value, str
    ):
        return value
    words = tr(value)
    return words if words != value else said(value)


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
        model = ShippedModel()
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
