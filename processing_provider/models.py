"""The models of resources/models in the toolbox: under readable names, in QGIS's language, with styled layers."""

from __future__ import annotations

from typing import Mapping

from qgis.core import (
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingModelAlgorithm,
    QgsProcessingParameterDefinition,
    QgsXmlUtils,
)
from qgis.PyQt.QtCore import QCoreApplication
from qgis.PyQt.QtGui import QIcon
from qgis.PyQt.QtXml import QDomDocument

from ..repm_qgis.names import surface_name
from . import styles
from .base import RepmAlgorithm, group_title, numbered, resource
from .language import said
from .parameters import tr


class ShippedModel(QgsProcessingModelAlgorithm):
    """A model under a readable name: the one in its file is an id for scripts."""

    FILE = ""  # in resources/models
    GROUP = ""
    STEP = 0
    ICON = ""

    def read(self) -> bool:
        """Read the model's file, whose labels and explanations are shown in QGIS's language."""
        document = QDomDocument()
        with open(resource("models", self.FILE), encoding="utf-8") as stream:
            document.setContent(stream.read())
        # Read once: for a model that is read twice QGIS logs that each output exists already.
        return bool(self.loadVariant(_in_language(QgsXmlUtils.readVariant(document.firstChildElement()))))

    def createCustomParametersWidget(self, parent: object = None) -> object:
        return RepmAlgorithm.createCustomParametersWidget(self, parent)

    def createInstance(self) -> ShippedModel:
        model = type(self)()
        model.read()
        return model

    def title(self) -> str:
        """The name without its number."""
        raise NotImplementedError

    def displayName(self) -> str:
        return numbered(self.GROUP, self.STEP, self.title())

    def tr(self, text: str) -> str:
        return QCoreApplication.translate(type(self).__name__, text)

    def group(self) -> str:
        return group_title(self.GROUP)

    def groupId(self) -> str:
        return self.GROUP

    def tags(self) -> list[str]:
        return RepmAlgorithm().tags()

    def icon(self) -> QIcon:
        return QIcon(self.svgIconPath())

    def svgIconPath(self) -> str:
        return resource("icons", self.ICON)


class StagesModel(ShippedModel):
    """The stages of the pipeline, whose own layers are styled by themselves."""

    FILE, GROUP, STEP, ICON = "repm_stages.model3", "whole", 2, "pipeline.svg"

    def title(self) -> str:
        return self.tr("Make a DSM stage by stage (model)")


class MapModel(ShippedModel):
    """Contours, slope, hillshade, ruggedness and breaklines of a DSM, by algorithms of QGIS."""

    FILE, GROUP, STEP, ICON = "repm_map.model3", "derived", 3, "dsm_to_map.svg"
    KINDS = {
        "contours": "contours",
        "slope": "slope",
        "hillshade": "shading",
        "ruggedness": "ruggedness",
        "breaklines": "breaklines",
    }
    """The kinds of layers by the steps that make them."""

    def title(self) -> str:
        return self.tr("Make map layers of a DSM (model)")

    def read(self) -> bool:
        well = super().read()
        for output in self.parameterDefinitions():
            if output.isDestination():  # each layer may be left out, whatever the step that makes it says
                output.setFlags(output.flags() | QgsProcessingParameterDefinition.Flag.FlagOptional)
        return well

    def processAlgorithm(
        self, parameters: Mapping[str, object], context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict[str, object]:
        # QGIS gives a step the step's own default where a value of the model is not given.
        inputs = (each for each in self.parameterDefinitions() if not each.isDestination())
        parameters = {**{each.name(): each.defaultValue() for each in inputs}, **parameters}
        self._leave_out_unwanted(parameters)
        results = super().processAlgorithm(parameters, context, feedback)
        dsm = self.parameterAsRasterLayer(parameters, "DSM", context)
        run = styles.Run(surface_name(dsm.source()) if dsm is not None else "")
        for output in self.outputDefinitions():
            kind, path = self.KINDS.get(output.name().split(":")[0], ""), results.get(output.name())
            if kind and path:
                styles.style_layer(context, feedback, path, path, kind, run, output.description())
        return dict(results)

    def _leave_out_unwanted(self, parameters: Mapping[str, object]) -> None:
        """Take steps out that no wanted layer needs: GDAL's would fail without the name of a file to write."""
        children = self.childAlgorithms()
        wanted = [
            name for name in children if any(parameters.get(f"{name}:{key}") for key in children[name].modelOutputs())
        ]
        needed = set(wanted).union(*(self.dependsOnChildAlgorithms(name) for name in wanted))
        for name in set(children) - needed:
            children[name].setActive(False)
            self.setChildAlgorithm(children[name])


MODELS = (StagesModel, MapModel)


def _in_language(value: object, key: str = "") -> object:
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
