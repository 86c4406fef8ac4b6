"""The menu Plugins > REPM."""

from __future__ import annotations

from typing import Callable, Optional

from qgis.core import QgsProject
from qgis.gui import QgisInterface
from qgis.PyQt.QtCore import QCoreApplication, Qt, QTimer
from qgis.PyQt.QtGui import QIcon
from qgis.PyQt.QtWidgets import QAction

from ..processing_provider import installation
from ..processing_provider.base import resource
from . import batch_pages, confidence_link, model_copy
from .control_points import ControlPointsDock
from .docking import dock_beside_map
from .documents import open_document
from .first_steps import FirstSteps, show_once
from .geoid_grids import GeoidGridsDialog
from .group_zoom import GroupZoom
from .hillshades import Hillshades
from .install import InstallDialog, offer_once
from .next_step import STEPS
from .scenes import ScenesDock
from .surface_editing import SurfaceEditingDock

TITLE = "REPM"


class PluginMenu:
    """Our entries in QGIS's menu, and the windows that they open; ``remove`` takes both away again."""

    def __init__(self, iface: QgisInterface) -> None:
        self._iface = iface
        self._actions: list[QAction] = []
        self._panel: Optional[FirstSteps] = None
        self._installer: Optional[InstallDialog] = None
        self._grids: Optional[GeoidGridsDialog] = None
        self._offer: object = None
        self._toolbox_actions = model_copy.register()
        batch_pages.allow_missing_times()
        self._hillshades = Hillshades(iface=iface)
        self._group_zoom = GroupZoom(iface)
        confidence_link.register(iface)
        self._dock: Optional[ControlPointsDock] = None
        self._editor: Optional[SurfaceEditingDock] = None
        self._scenes: Optional[ScenesDock] = None
        STEPS.edit_dsm = self.edit_dsm
        QgsProject.instance().cleared.connect(STEPS.begin_again)
        self.add(self.tr("First steps"), "repm", self.first_steps)
        self.add(self.tr("Inspect images…"), "inspect", lambda: self.open("repm:inspect"))
        self.add(self.tr("Make a DSM…"), "pipeline", lambda: self.open("repm:pipeline"))
        self.add(self.tr("Scenes"), "repm", self.scenes)
        self.add(self.tr("Measure control points…"), "checkgcps", self.measure_control_points)
        self.add(self.tr("Edit a DSM…"), "editdsm", self.edit_dsm)
        self.add(self.tr("Install the engine's packages…"), "environment", self.install)
        self.add(self.tr("Geoid grids…"), "", self.geoid_grids)
        self.add(self.tr("Tutorial"), "", lambda: open_document("tutorial"))
        self.add(self.tr("Help"), "", lambda: open_document("guide"))
        # QGIS is still starting: a window now would lie behind its splash screen.
        QTimer.singleShot(0, self._begin)

    def _begin(self) -> None:
        if self._actions:  # otherwise the plugin was unloaded meanwhile
            show_once(self.first_steps)
            self._offer = offer_once(self._iface, self.install)

    def tr(self, text: str) -> str:
        return QCoreApplication.translate("PluginMenu", text)

    def add(self, title: str, icon: str, run: Callable[[], object]) -> QAction:
        """Add an entry, with an icon of resources/icons ("": none)."""
        action = QAction(QIcon(resource("icons", f"{icon}.svg")) if icon else QIcon(), title, self._iface.mainWindow())
        action.triggered.connect(lambda: run())
        self._iface.addPluginToMenu(TITLE, action)
        self._actions.append(action)
        return action

    def remove(self) -> None:
        for action in self._actions:
            self._iface.removePluginMenu(TITLE, action)
            action.deleteLater()
        for dock in (self._dock, self._editor, self._scenes):
            if dock is not None:
                dock.close_down()
                dock.deleteLater()
        self._dock = self._editor = self._scenes = None
        if self._panel is not None:
            self._panel.close()
            self._panel.deleteLater()
            self._panel = None
        for window in (self._installer, self._grids):
            if window is not None:
                window.close_down()
                window.deleteLater()
        self._installer = self._grids = None
        QgsProject.instance().cleared.disconnect(STEPS.begin_again)
        STEPS.forget()
        STEPS.edit_dsm = None
        model_copy.unregister(self._toolbox_actions)
        batch_pages.require_times_again()
        self._group_zoom.stop()
        confidence_link.unregister()
        self._hillshades.stop()
        self._actions, self._toolbox_actions = [], []

    def measure_control_points(self) -> ControlPointsDock:
        """Show the dock, below the map where it has not been moved."""
        if self._dock is None:
            self._dock = ControlPointsDock(self._iface)
            self._iface.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, self._dock)
        self._dock.setUserVisible(True)
        return self._dock

    def edit_dsm(self) -> SurfaceEditingDock:
        """Show the dock, beside the map where it has not been moved."""
        if self._editor is None:
            self._editor = SurfaceEditingDock(self._iface)
            dock_beside_map(self._iface, self._editor)
        self._editor.setUserVisible(True)
        return self._editor

    def scenes(self) -> ScenesDock:
        """Show the dock, beside the map where it has not been moved."""
        if self._scenes is None:
            self._scenes = ScenesDock(self._iface, self.measure_control_points)
            dock_beside_map(self._iface, self._scenes)
        self._scenes.setUserVisible(True)
        return self._scenes

    def open(self, algorithm: str) -> None:
        """Show an algorithm's dialog."""
        import processing

        processing.createAlgorithmDialog(algorithm).show()

    def first_steps(self) -> None:
        if self._panel is None:
            self._panel = FirstSteps(self._iface, self.install)
        self._panel.show()
        self._panel.raise_()

    def geoid_grids(self) -> GeoidGridsDialog:
        """Show the dialog that fetches geoid grids."""
        if self._grids is None:
            self._grids = GeoidGridsDialog(self._iface)
        self._grids.show()
        self._grids.raise_()
        return self._grids

    def install(self) -> None:
        """Show the dialog that installs the engine's packages."""
        if self._installer is None:
            self._installer = InstallDialog(self._iface)
            self._installer.changed.connect(self._packages_changed)
        self._installer.show()
        self._installer.raise_()

    def _packages_changed(self) -> None:
        """The texts of the offer and the panel may be out of date."""
        if self._offer is not None and installation.state() == installation.FINE:
            self._iface.messageBar().popWidget(self._offer)
            self._offer = None
        if self._panel is not None:
            self._panel.refresh()
