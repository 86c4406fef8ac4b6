"""QGIS's entry *Zoom to Group* in the tree of layers, for groups that hold a hillshade of ours.

QGIS asks the project for each layer of the group, and crashes where the project has it not; a hillshade is a layer of
the tree alone (see hillshades.py).
"""

from __future__ import annotations

from qgis.gui import QgisInterface
from qgis.PyQt import sip
from qgis.PyQt.QtCore import QCoreApplication, QEvent, QObject, QTimer
from qgis.PyQt.QtWidgets import QApplication, QMenu

from .arrival import extent_of, zoom_to


class GroupZoom(QObject):
    """While it is there, *Zoom to Group* is ours; ``stop`` gives it back."""

    def __init__(self, iface: QgisInterface) -> None:
        super().__init__()
        self._iface, self._view = iface, iface.layerTreeView()
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
        extent = extent_of(self._iface, group.findLayers() if group is not None else [])
        if not extent.isNull():
            zoom_to(self._iface, extent)
