"""QGIS's entry *Zoom to Group* in the tree of layers, for groups that hold a hillshade of ours.

QGIS asks the project for each layer of the group, and crashes where the project has it not; a hillshade is a layer of
the tree alone (see hillshades.py).
"""

from __future__ import annotations

from qgis.core import QgsRectangle
from qgis.gui import QgisInterface
from qgis.PyQt import sip
from qgis.PyQt.QtCore import QCoreApplication, QEvent, QObject, QTimer
from qgis.PyQt.QtWidgets import QApplication, QMenu

_EDGE = 1.05  # of the group's extent, as QGIS has it


class GroupZoom(QObject):
    """While it is there, *Zoom to Group* is ours; ``stop`` gives it back."""

    def __init__(self, iface: QgisInterface) -> None:
        super().__init__()
        self._canvas, self._view = iface.mapCanvas(), iface.layerTreeView()
        # The mouse opens the menu in the viewport, a key in the view.
        self._watched = [self._view, self._view.viewport()]
        for widget in self._watched:
            widget.installEventFilter(self)

    def stop(self) -> None:
        for widget in self._watched:
            if not sip.isdeleted(widget):
                widget.removeEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ContextMenu:
            # QGIS 3.22 gives no signal for the menu that it shows now: the menu exists once events are handled again.
            QTimer.singleShot(0, self._take_over)
        return False

    def _take_over(self) -> None:
        menu = QApplication.activePopupWidget()
        if not isinstance(menu, QMenu):
            return
        title = QCoreApplication.translate("QgsLayerTreeViewDefaultActions", "&Zoom to Group")
        for action in menu.actions():
            if action.text() == title:
                action.triggered.disconnect()
                action.triggered.connect(lambda *_: self.zoom())

    def zoom(self) -> None:
        """Show all layers of the current group on the map."""
        group = self._view.currentGroupNode()
        layers = [node.layer() for node in group.findLayers()] if group is not None else []
        settings, extent = self._canvas.mapSettings(), QgsRectangle()
        for layer in layers:
            if layer is not None and not layer.extent().isNull():
                place = settings.layerExtentToOutputExtent(layer, layer.extent())
                if extent.isNull():
                    extent = QgsRectangle(place)
                extent.combineExtentWith(place)
        if not extent.isNull():
            extent.scale(_EDGE)
            self._canvas.setExtent(extent, True)
            self._canvas.refresh()
