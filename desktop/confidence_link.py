"""A link in the legend of a DSM to its confidence: QGIS's tree of layers can show widgets in legends."""

from __future__ import annotations

from qgis.core import QgsMapLayer, QgsProject
from qgis.gui import QgisInterface, QgsGui, QgsLayerTreeEmbeddedWidgetProvider
from qgis.PyQt.QtCore import QCoreApplication
from qgis.PyQt.QtWidgets import QLabel

from ..processing_provider.styles import CONFIDENCE, CONFIDENCE_LINK


class ConfidenceLink(QgsLayerTreeEmbeddedWidgetProvider):
    """Makes the links, of layers that name their confidence in a property (``processing_provider/styles.py``)."""

    def __init__(self, iface: QgisInterface) -> None:
        super().__init__()
        self._iface = iface

    def id(self) -> str:
        return CONFIDENCE_LINK

    def name(self) -> str:
        return self.tr("Link to the confidence")

    def supportsLayer(self, layer: QgsMapLayer) -> bool:
        return bool(layer.customProperty(CONFIDENCE))

    def createWidget(self, layer: QgsMapLayer, number: int) -> QLabel:
        label = QLabel(f'<a href="confidence">{self.tr("Expected errors (confidence)")}</a>')
        label.setToolTip(self.tr("Shows the error that each height is expected to have, or hides it again."))
        label.linkActivated.connect(lambda _: self.turn(str(layer.customProperty(CONFIDENCE))))
        return label

    def turn(self, name: str) -> None:
        """Show the layer of an id, and make it the active one; hide it where it is shown."""
        node = QgsProject.instance().layerTreeRoot().findLayer(name)
        if node is None:
            text = self.tr("The confidence of this DSM is not in this project any more.")
            self._iface.messageBar().pushMessage("REPM", text)
            return
        shown = not node.isVisible()
        (node.setItemVisibilityCheckedParentRecursive if shown else node.setItemVisibilityChecked)(shown)
        node.setExpanded(shown)
        if shown:
            self._iface.setActiveLayer(node.layer())

    def tr(self, text: str) -> str:
        return QCoreApplication.translate("ConfidenceLink", text)


def register(iface: QgisInterface) -> None:
    QgsGui.layerTreeEmbeddedWidgetRegistry().addProvider(ConfidenceLink(iface))


def unregister() -> None:
    QgsGui.layerTreeEmbeddedWidgetRegistry().removeProvider(CONFIDENCE_LINK)
