"""Where our docks go, so that they fit small screens: as tabs, and with contents that scroll."""

from __future__ import annotations

from qgis.gui import QgisInterface
from qgis.PyQt.QtCore import Qt
from qgis.PyQt.QtWidgets import QAbstractScrollArea, QDockWidget, QFrame, QScrollArea, QSizePolicy, QWidget

_LEAST_HEIGHT = 400  # px for each dock of a column; below, docks share their place as tabs
_LEAST_LIST = 60  # px, of two lines


def dock_beside_map(iface: QgisInterface, dock: QDockWidget) -> None:
    """Put a dock right of the map: below those that are there, or as a tab where the window is too low for that."""
    window, right = iface.mainWindow(), Qt.DockWidgetArea.RightDockWidgetArea
    others = [
        each
        for each in window.findChildren(QDockWidget)
        if each is not dock and each.isVisible() and not each.isFloating() and window.dockWidgetArea(each) == right
    ]
    iface.addDockWidget(right, dock)
    if others and window.centralWidget().height() < _LEAST_HEIGHT * (len(others) + 1):
        window.tabifyDockWidget(max(others, key=lambda each: each.height()), dock)


def takes_the_rest(inside: QAbstractScrollArea) -> None:
    """Have a list or a tree take the height that is left, however little that is: what is below it stays in sight."""
    inside.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
    inside.setMinimumHeight(_LEAST_LIST)


def scrolling(inside: QWidget) -> QScrollArea:
    """Contents of a dock that may be lower than they need; they keep their width."""
    area = QScrollArea()
    area.setFrameShape(QFrame.Shape.NoFrame)
    area.setWidgetResizable(True)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    area.setWidget(inside)
    area.setMinimumWidth(inside.minimumSizeHint().width() + area.verticalScrollBar().sizeHint().width())
    return area
