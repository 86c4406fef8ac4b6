"""What can be done with a scene of the panel: on the map, in dialogs, on the disk."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import TYPE_CHECKING, Callable, Mapping, Optional

from qgis.core import (
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsCsException,
    QgsLayerTreeNode,
    QgsMapLayer,
    QgsMapLayerStyle,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProject,
    QgsRasterLayer,
    QgsRectangle,
    QgsVectorLayer,
)
from qgis.gui import QgisInterface
from qgis.PyQt.QtCore import QCoreApplication, QLocale, QObject, QUrl, pyqtSignal
from qgis.PyQt.QtGui import QDesktopServices
from qgis.PyQt.QtWidgets import QApplication, QFileDialog, QMessageBox, QWidget

from ..processing_provider import last_scene, styles
from ..processing_provider.language import language, said
from ..processing_provider.parameters import tr
from ..processing_provider.values import command_line, layer_path
from ..repm_qgis.runtime.translation import written_in
from .arrival import zoom_to
from .control_points import ControlPointsDock
from .next_step import STEPS, bring_out, layer_of, push_message

if TYPE_CHECKING:  # the engine is imported when it is needed
    from ..repm_qgis.workspaces.facts import ProductFacts, Value, Workspace

_FILE_LAYERS = ("raster", "points", "polygons")


class SceneActions(QObject):
    """The actions of the panel ``window``; ``measure`` shows the panel of control points. ``changed`` is emitted where
    the list of workspaces or their files are other ones, with a workspace to open, ``shown`` where the map is."""

    changed = pyqtSignal(str)
    shown = pyqtSignal()

    def __init__(self, iface: QgisInterface, window: QWidget, measure: Callable[[], ControlPointsDock]) -> None:
        super().__init__(window)
        self._iface, self._window, self._measure = iface, window, measure

    def put_on_map(self, made: ProductFacts, scene: Workspace, shown: bool = True) -> Optional[QgsMapLayer]:
        """Show a product on the map, or hide it; gives its layer."""
        layer = layer_of(made.path)
        if layer is None and shown:
            layer = self._add_layer(made, scene)
        node = QgsProject.instance().layerTreeRoot().findLayer(layer.id()) if layer is not None else None
        if layer is not None and node is not None and shown:
            bring_out(layer.id())
            _expand_groups(node)
        elif node is not None:
            node.setItemVisibilityChecked(False)
        self.shown.emit()
        return layer

    def _add_layer(self, made: ProductFacts, scene: Workspace) -> Optional[QgsMapLayer]:
        from ..repm_qgis.contracts.errors import RepmError
        from ..repm_qgis.files.untrusted import refusal_of
        from ..repm_qgis.reports.styles import style_text

        refused = refusal_of(made.path)
        if refused:
            self._iface.messageBar().pushWarning("REPM", f"'{made.path}' {said(refused)}")
            return None
        kind, path = made.product.style, made.path
        run = styles.Run(scene.title, scene.days)
        name = run.name(tr(made.product.layer or made.product.title))
        # Our style instead of the file beside the product: that of a stranger's workspace may hold code.
        layer: QgsMapLayer
        if made.product.form == "raster":
            layer = QgsRasterLayer(path, name, "gdal", QgsRasterLayer.LayerOptions(False))
        else:
            layer = QgsVectorLayer(path, name, "ogr", QgsVectorLayer.LayerOptions(False))
        if not layer.isValid():
            self._iface.messageBar().pushWarning("REPM", self.tr("QGIS cannot open '{path}'.").format(path=path))
            return None
        context, feedback = QgsProcessingContext(), QgsProcessingFeedback()
        context.setProject(QgsProject.instance())
        run.kinds.add(kind)
        with suppress(RepmError), written_in(language()):  # without a style it is shown all the same
            QgsMapLayerStyle(style_text(kind, path)).writeToLayer(layer)
        QgsProject.instance().addMapLayer(layer)
        styles.LayerStyler.make("", kind, run).postProcessLayer(layer, context, feedback)
        return layer

    def zoom_to_product(self, made: ProductFacts, scene: Workspace) -> None:
        layer = self.put_on_map(made, scene)
        if layer is not None:
            self._zoom(layer.extent(), layer.crs())

    def zoom(self, scene: Workspace) -> None:
        """Show the ground of a scene."""
        if scene.bounds is not None:
            self._zoom(QgsRectangle(*scene.bounds), QgsCoordinateReferenceSystem(scene.crs))

    def _zoom(self, extent: QgsRectangle, crs: QgsCoordinateReferenceSystem) -> None:
        canvas = self._iface.mapCanvas()
        to_map = QgsCoordinateTransform(crs, canvas.mapSettings().destinationCrs(), QgsProject.instance())
        try:
            place = to_map.transformBoundingBox(extent)
        except QgsCsException:
            return
        zoom_to(self._iface, place)

    def run_again(self, options: Mapping[str, Value]) -> None:
        """Open the dialog with the options of a run."""
        from ..repm_qgis.workspaces.options import safe_inputs

        STEPS.open("pipeline", parameters_of(safe_inputs(options)))

    def copy_command(self, options: Mapping[str, Value]) -> None:
        QApplication.clipboard().setText(command_line("repm:pipeline", dict(options)))
        self._iface.messageBar().pushInfo("REPM", self.tr("The command is in the clipboard."))

    def edit(self, scene: Workspace, surface: Optional[ProductFacts]) -> None:
        layer = self.put_on_map(surface, scene) if surface is not None else None
        if layer is not None and STEPS.edit_dsm is not None:
            self._iface.setActiveLayer(layer)
            STEPS.edit_dsm()

    def make_page(self, scene: Workspace, surface: Optional[ProductFacts]) -> None:
        """Make a print layout of a DSM, and its PDF beside the DSM; a message opens either."""
        from .client_page import make_page, page_path, write_pdf

        dsm = self.put_on_map(surface, scene) if surface is not None else None
        if surface is None or dsm is None:
            return
        ortho = scene.product("dsmfuse", "ortho")
        drawn = (layer_of(ortho.path) or self._add_layer(ortho, scene)) if ortho is not None else None
        QCoreApplication.processEvents()  # hillshades are made once QGIS is at rest
        run = next((each for each in scene.runs if each.verdict), None)
        layout, path = make_page(scene, run, dsm, drawn), page_path(surface.path)
        if not write_pdf(layout, path):
            text = self.tr("The page could not be written to '{path}': check the folder.").format(path=path)
            self._iface.messageBar().pushWarning("REPM", text)
            return
        edit = (self.tr("Edit the page"), lambda: self._iface.openLayoutDesigner(layout))
        show = (self.tr("Open the PDF"), lambda: show_file(path))
        text = self.tr("The page is '{name}'.").format(name=os.path.basename(path))
        push_message(self._iface.messageBar(), text, [show, edit])

    def measure(self, scene: Workspace) -> None:
        """Measure control points in the images of a scene."""
        dock = self._measure()
        dock.open_images([each.path for each in scene.images if each.there and not each.remote])

    def remove(self, folder: str, products: list[ProductFacts]) -> None:
        """Remove products from the disk and the map, after a question that names them."""
        from ..repm_qgis.contracts.errors import RepmError
        from ..repm_qgis.workspaces.products import remove_products

        lines = [f"{os.path.basename(each.path)}  ({QLocale().formattedDataSize(each.size)})" for each in products]
        text = self.tr("These files are removed from the disk, and cannot be restored:") + "\n\n" + "\n".join(lines)
        buttons = QMessageBox.StandardButton
        answer = QMessageBox.question(self._window, self.tr("Remove products"), text, buttons.Yes | buttons.Cancel)
        if answer != buttons.Yes:
            return
        layers = [layer for layer in map(layer_of, (each.path for each in products)) if layer is not None]
        QgsProject.instance().removeMapLayers([layer.id() for layer in layers])
        try:
            remove_products(folder, products)
        except RepmError as error:
            self._iface.messageBar().pushWarning("REPM", said(str(error)))
        self.changed.emit("")

    def add_workspace(self) -> None:
        """Show a workspace that lies elsewhere, such as one that was received."""
        self._choose(self.tr("A folder with a scene"), "")

    def relink(self, folder: str) -> None:
        """Show a workspace at its new place, and its layers with it."""
        self._choose(self.tr("Where is '{name}' now?").format(name=os.path.basename(folder)), folder)

    def _choose(self, title: str, before: str) -> None:
        from ..repm_qgis.workspaces.reading import is_workspace

        folder = QFileDialog.getExistingDirectory(self._window, title, os.path.dirname(before))
        if not folder:
            return
        folder = os.path.abspath(folder)
        if not is_workspace(folder):
            text = self.tr("'{folder}' holds no scene of REPM: choose the folder with scene.json.")
            self._iface.messageBar().pushWarning("REPM", text.format(folder=folder))
            return
        last_scene.remember_workspace(folder, before)
        for layer in QgsProject.instance().mapLayers().values() if before else ():
            path = layer_path(layer)
            moved = os.path.join(folder, os.path.relpath(path, before)) if path.startswith(before + os.sep) else ""
            if moved and os.path.exists(moved) and layer.providerType() in ("gdal", "ogr"):
                layer.setDataSource(layer.source().replace(path, moved), layer.name(), layer.providerType())
        self.changed.emit(folder)

    def forget(self, folder: str) -> None:
        """Take a workspace out of the list; its files stay."""
        last_scene.forget_workspace(folder)
        self.changed.emit("")


def parameters_of(options: Mapping[str, Value]) -> dict[str, object]:
    """The values of a dialog for the recorded options of a run: texts of commands become numbers and switches."""
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline")
    found: dict[str, object] = {}
    value: object
    for name, value in options.items():
        definition = algorithm.parameterDefinition(name.upper())
        if definition is None:
            continue
        kind = definition.type()
        if kind == "boolean":
            value = str(value).lower() in ("true", "1", "yes")
        elif kind == "number":
            try:
                number = float(str(value))
            except (TypeError, ValueError):
                continue
            value = int(number) if number.is_integer() else number
        elif kind == "enum":
            if value not in definition.options():
                continue
        elif kind == "multilayer":
            value = list(value) if isinstance(value, tuple) else [value]
        elif isinstance(value, tuple):
            value = ",".join(value)
        found[name.upper()] = value
    return found


def _expand_groups(node: QgsLayerTreeNode) -> None:
    """Have a layer in sight in the tree of layers."""
    group = node.parent()
    while group is not None:
        group.setExpanded(True)
        group = group.parent()


def show_file(path: str) -> None:
    QDesktopServices.openUrl(QUrl.fromLocalFile(path))


def can_show(made: ProductFacts) -> bool:
    """Whether QGIS opens a product by its file."""
    return bool(made.product.style) and made.product.form in _FILE_LAYERS
