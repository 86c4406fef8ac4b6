"""The dock "Edit a DSM": shapes that are drawn on the map become records beside the DSM, which is made again of them.

The effect of edits on heights is the engine's (:mod:`repm_qgis.editing`); the algorithm repm:editdsm applies them here
as it does headless.
"""

from __future__ import annotations

import os
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Callable, Optional

from qgis.core import (
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsCsException,
    QgsDataProvider,
    QgsGeometry,
    QgsMapLayerProxyModel,
    QgsMapLayerStyle,
    QgsProcessingAlgRunnerTask,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProject,
    QgsRasterLayer,
    QgsWkbTypes,
)
from qgis.gui import QgisInterface, QgsDockWidget, QgsMapLayerComboBox, QgsRubberBand
from qgis.PyQt.QtCore import QEvent, Qt
from qgis.PyQt.QtGui import QColor, QKeySequence
from qgis.PyQt.QtWidgets import (
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QListWidget,
    QListWidgetItem,
    QPushButton,
    QShortcut,
    QVBoxLayout,
    QWidget,
)

from ..processing_provider.kept import is_lasting
from ..processing_provider.language import said
from ..processing_provider.values import layer_path
from .docking import scrolling, takes_the_rest
from .drawing_tool import BRUSH, LINE, POLYGON, DrawingTool

if TYPE_CHECKING:  # the engine is imported when it is needed
    from ..repm_qgis.editing.session import DsmEdits

_AUTOMATIC = -12_001.0  # of the value: below all heights
_BREAKLINE = "breakline"


class _Feedback(QgsProcessingFeedback):
    """Keeps the errors and notes of a run."""

    def __init__(self) -> None:
        super().__init__(False)
        self.errors: list[str] = []
        self.notes: list[str] = []

    def reportError(self, error: str, fatalError: bool = False) -> None:  # noqa: N803 - QGIS's name
        self.errors.append(error)

    def pushWarning(self, warning: str) -> None:
        self.notes.append(warning)


class SurfaceEditingDock(QgsDockWidget):
    """Draws edits of a DSM; ``close_down`` takes its marks and its tool off the map."""

    def __init__(self, iface: QgisInterface) -> None:
        super().__init__(iface.mainWindow())
        self.setObjectName("RepmSurfaceEditing")
        self.setWindowTitle(self.tr("Edit a DSM"))
        self._iface, self._canvas = iface, iface.mapCanvas()
        self.records: Optional[DsmEdits] = None
        self._layer_id, self._added, self._again = "", False, False
        self._task: Optional[QgsProcessingAlgRunnerTask] = None
        self._run: object = None  # what a running task needs: QGIS does not keep it
        self._tool = DrawingTool(self._canvas)
        self._tool.drawn.connect(self._take)
        kinds = QgsWkbTypes.GeometryType
        self._bands = [QgsRubberBand(self._canvas, kind) for kind in (kinds.PolygonGeometry, kinds.LineGeometry)]
        for band in self._bands:
            band.setColor(QColor("#ffd21f"))
            band.setFillColor(QColor(255, 210, 31, 30))
            band.setWidth(2)
        self._build()
        self._iface.currentLayerChanged.connect(self._follow_layer)
        self.layers.layerChanged.connect(self._open_layer)
        self._follow_layer(iface.activeLayer())
        if self.records is None:
            self._open_layer(self.layers.currentLayer())

    def _build(self) -> None:
        self.layers = QgsMapLayerComboBox()
        self.confidence = QgsMapLayerComboBox()
        for box in (self.layers, self.confidence):
            box.setFilters(QgsMapLayerProxyModel.Filter.RasterLayer)
            box.setAllowEmptyLayer(True)
        self.layers.setToolTip(self.tr("The DSM that is edited. It stays as it is: the edited one lies beside it."))
        self.confidence.setToolTip(
            self.tr("The confidence of this DSM, if there is one: a copy of it says which heights were edited by hand.")
        )
        self.operation = QComboBox()
        for name, text in (
            ("remove", self.tr("Remove heights")),
            ("fill", self.tr("Fill from the rim")),
            ("set", self.tr("Set to a height")),
            ("flatten", self.tr("Flatten water")),
            (_BREAKLINE, self.tr("Keep a breakline")),
        ):
            self.operation.addItem(text, name)
        self.value, self.width_m = QDoubleSpinBox(), QDoubleSpinBox()
        self.value.setRange(_AUTOMATIC, 10_000.0)
        self.width_m.setRange(0.1, 10_000.0)
        self.width_m.setValue(10.0)
        for box in (self.value, self.width_m):
            box.setSuffix(" m")
        self.width_m.setToolTip(self.tr("The width of the brush, or the width within which a breakline fades."))
        self.buttons = {
            POLYGON: self._button(self.tr("Polygon"), lambda: self.draw(POLYGON)),
            BRUSH: self._button(self.tr("Brush"), lambda: self.draw(BRUSH)),
            LINE: self._button(self.tr("Line"), lambda: self.draw(LINE)),
        }
        for button in self.buttons.values():
            button.setCheckable(True)
        self.undo_button = self._button(self.tr("Undo"), self.undo)
        self.undo_button.setToolTip(self.tr("Removes the last edit of the list."))
        shortcut = QShortcut(QKeySequence(QKeySequence.StandardKey.Undo), self)
        shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
        shortcut.activated.connect(self.undo)
        self.list = QListWidget()
        self.list.setToolTip(self.tr("The edits in their order. One without its tick is passed over."))
        self.list.itemChanged.connect(self._ticked)
        self.said = QLabel()
        self.said.setWordWrap(True)
        self.said.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        form = QFormLayout()
        form.addRow(self.tr("DSM:"), self.layers)
        form.addRow(self.tr("Confidence:"), self.confidence)
        form.addRow(self.tr("Edit:"), self.operation)
        form.addRow(self.tr("Height:"), self.value)
        form.addRow(self.tr("Width:"), self.width_m)
        row = QHBoxLayout()
        for button in (*self.buttons.values(), self.undo_button):
            row.addWidget(button)
        inside = QWidget()
        layout = QVBoxLayout(inside)
        layout.addLayout(form)
        layout.addLayout(row)
        takes_the_rest(self.list)
        layout.addWidget(self.list, 1)
        layout.addWidget(self.said)
        self.setWidget(scrolling(inside))
        self.operation.currentIndexChanged.connect(lambda _: self._choose_operation())
        self.width_m.valueChanged.connect(lambda _: self._renew_tool())
        self._canvas.scaleChanged.connect(self._renew_tool)
        self._canvas.mapToolSet.connect(lambda *_: self._show_tool())
        self._choose_operation()

    def _button(self, text: str, run: Callable[[], object]) -> QPushButton:
        button = QPushButton(text)
        button.clicked.connect(lambda: run())
        return button

    # --- the DSM ---

    def _follow_layer(self, layer: object) -> None:
        """The active layer is the one to edit, where it is a raster."""
        if isinstance(layer, QgsRasterLayer) and layer.bandCount() == 1:
            self.layers.setLayer(layer)

    def _open_layer(self, layer: object) -> None:
        """Take up the records of a layer's DSM; an edited DSM stands for its original."""
        from ..repm_qgis.editing.session import DsmEdits, original_of

        if not isinstance(layer, QgsRasterLayer) or layer.providerType() != "gdal":
            self.records = None
            return self._refresh(self.tr("Choose the DSM that is to be edited."))
        path = original_of(layer_path(layer))
        if self.records is not None and self.records.dsm == path:
            return None
        self.records, self._layer_id, found = None, layer.id(), []
        if self._tried(lambda: found.append(DsmEdits(path))):
            self.records = found[0]
            self.confidence.setLayer(self._confidence_of(layer))
            temporary = self.tr(
                "This DSM is a temporary file: its edits are gone when QGIS ends. Save the layer first."
            )
            self._refresh("" if is_lasting(os.path.dirname(path)) else temporary)
        return None

    def _confidence_of(self, layer: QgsRasterLayer) -> Optional[QgsRasterLayer]:
        """A confidence raster of the project with the cells of a DSM."""
        from ..repm_qgis.imagery.confidence import CONFIDENCE_BANDS

        def frame(raster: QgsRasterLayer) -> object:
            return raster.width(), raster.height(), raster.extent()

        for other in QgsProject.instance().mapLayers().values():
            if isinstance(other, QgsRasterLayer) and other.bandCount() > 1:
                named = CONFIDENCE_BANDS[0] in other.bandName(1)
                if named and frame(other) == frame(layer) and "_edited" not in os.path.basename(layer_path(other)):
                    return other
        return None

    # --- drawing ---

    def draw(self, kind: str) -> None:
        """Draw shapes of a kind on the map from now on."""
        self._tool.choose(kind, self._brush_px())
        self._canvas.setMapTool(self._tool)
        self._show_tool()
        self._say(self._how())

    def _how(self) -> str:
        if self._tool.kind == BRUSH:
            return self.tr("Hold the left button down and paint.")
        return self.tr(
            "Left click: a vertex. Right click: the shape is finished. Backspace: one vertex less. Esc: none."
        )

    def _renew_tool(self, *_: object) -> None:
        if self._canvas.mapTool() is self._tool and self._tool.kind == BRUSH:
            self._tool.choose(BRUSH, self._brush_px())

    def _brush_px(self) -> int:
        """The width of the brush in pixels of the screen, in the middle of the DSM: the map may show another place."""
        layer = QgsProject.instance().mapLayer(self._layer_id)
        if self.records is None or layer is None:
            return 1
        place = layer.extent().center()
        line = QgsGeometry.fromPolylineXY([place, place.__class__(place.x() + self.width_m.value(), place.y())])
        self._to_records(line, self.records, back=True)
        return max(1, round(line.length() / self._canvas.mapUnitsPerPixel()))

    def _to_records(self, geometry: QgsGeometry, records: DsmEdits, back: bool = False) -> None:
        """Transform from the map's CRS to that of the records, or back; raises QgsCsException."""
        crs = QgsCoordinateReferenceSystem()
        crs.createFromUserInput(records.crs)
        map_crs = self._canvas.mapSettings().destinationCrs()
        ends = (crs, map_crs) if back else (map_crs, crs)
        geometry.transform(QgsCoordinateTransform(*ends, QgsProject.instance()))

    def _show_tool(self) -> None:
        """Only the button of the tool that is in use is pressed."""
        for kind, button in self.buttons.items():
            button.setChecked(self._canvas.mapTool() is self._tool and self._tool.kind == kind)

    def _choose_operation(self) -> None:
        """Offer the inputs of the chosen operation."""
        name = self.operation.currentData()
        breakline = name == _BREAKLINE
        self.buttons[LINE].setVisible(breakline)
        for kind in (POLYGON, BRUSH):
            self.buttons[kind].setVisible(not breakline)
        self.value.setEnabled(name in ("set", "flatten"))
        if self.value.value() <= _AUTOMATIC:
            self.value.setValue(0.0)
        self.value.setMinimum(_AUTOMATIC if name == "flatten" else -12_000.0)
        self.value.setSpecialValueText(self.tr("from the shore") if name == "flatten" else "")
        if name == "flatten":
            self.value.setValue(_AUTOMATIC)
        if self._canvas.mapTool() is self._tool and (self._tool.kind == LINE) != breakline:
            self.draw(LINE if breakline else POLYGON)

    def _take(self, geometry: QgsGeometry) -> None:
        """A shape is finished: it becomes a record, and the DSM is made again."""
        records = self.records
        if records is None:
            self._say(self.tr("Choose the DSM that is to be edited."))
            return
        name = self.operation.currentData()
        try:
            self._to_records(geometry, records)
        except QgsCsException as error:
            self._say(str(error))
            return
        width = None if self._tool.kind == POLYGON else self.width_m.value()
        if width is not None and self._tool.kind == BRUSH:
            simpler = geometry.simplify(width / 20)
            geometry = simpler if simpler.length() > 0 else geometry
        value = self.value.value() if name in ("set", "flatten") else None
        value = None if value is not None and value <= _AUTOMATIC else value
        made = datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
        self._added = self._tried(lambda: records.add(name, geometry.asWkt(9), value, width, made))
        if self._added:
            self._changed()

    # --- records ---

    def undo(self) -> None:
        """Remove the last record, and make the DSM again."""
        if self.records is not None and self.records.edits and self._tried(self.records.undo):
            self._changed()

    def _ticked(self, item: QListWidgetItem) -> None:
        records, number = self.records, item.data(Qt.ItemDataRole.UserRole)
        on = item.checkState() == Qt.CheckState.Checked
        if records is not None and self._tried(lambda: records.enable(number, on)):
            self._changed()

    def _changed(self) -> None:
        self._refresh()
        self._make()

    def _make(self) -> None:
        """Run the algorithm; where it runs already, once more afterwards."""
        if self._task is not None:
            self._again = True
            return
        records = self.records
        if records is None:
            return
        from ..repm_qgis.runtime.workspace import temporary_name

        made: dict[str, str] = {}
        if not self._tried(lambda: made.update(OUTPUT=temporary_name(records.edited))):
            return
        given = {"DSM": records.dsm, "EDITS": records.path, **made}
        stated = self.confidence.currentLayer()
        if stated is not None:
            if not self._tried(lambda: made.update(EDITED_CONFIDENCE=temporary_name(records.edited_confidence))):
                return
            given.update(CONFIDENCE=layer_path(stated), **made)
        algorithm = QgsApplication.processingRegistry().algorithmById("repm:editdsm")
        context, feedback = QgsProcessingContext(), _Feedback()
        task = QgsProcessingAlgRunnerTask(algorithm, given, context, feedback)
        self._run = records, context, feedback
        task.executed.connect(lambda well, _: self._made(well, records, made, feedback))
        self._task = task
        self._say(self.tr("Making the edited DSM…"))
        QgsApplication.taskManager().addTask(task)

    def _made(self, well: bool, records: DsmEdits, made: dict[str, str], feedback: _Feedback) -> None:
        from ..repm_qgis.runtime.workspace import remove_temporary

        self._task = self._run = None
        text = " ".join(feedback.notes)
        if well:
            ends = {"OUTPUT": records.edited, "EDITED_CONFIDENCE": records.edited_confidence}
            well = all(self._put(path, ends[name], records) for name, path in made.items())
        else:
            text = feedback.errors[0] if feedback.errors else self.tr("The edited DSM could not be made.")
            if self._added and self._tried(records.undo):  # else no later edit could be applied
                text = self.tr("The edit was taken back. {reason}").format(reason=text)
            self._refresh(text)
        for path in made.values():
            for part in (path, f"{os.path.splitext(path)[0]}.qml", f"{path}.aux.xml"):
                remove_temporary(part)
        self._added = False
        if well:
            self._refresh(text)
        if self._again:
            self._again = False
            self._make()

    def _put(self, temporary: str, path: str, records: DsmEdits) -> bool:
        """Give a raster its name, and show it: layers close the older file first, because Windows requires it."""
        from ..repm_qgis.runtime.workspace import take_name

        project = QgsProject.instance()
        loaded = [
            layer
            for layer in project.mapLayers().values()
            if isinstance(layer, QgsRasterLayer) and layer.providerType() == "gdal" and layer_path(layer) == path
        ]
        options = QgsDataProvider.ProviderOptions()
        self._canvas.freeze(True)
        try:
            for layer in loaded:
                layer.setDataSource(records.dsm, layer.name(), "gdal", options)
            well = self._tried(lambda: take_name(temporary, path))
            for layer in loaded:
                layer.setDataSource(path, layer.name(), "gdal", options)
                layer.triggerRepaint()
            if well and not loaded:
                self._load(path, records)
        finally:
            self._canvas.freeze(False)
        self._canvas.refresh()
        return well

    def _load(self, path: str, records: DsmEdits) -> None:
        """Show a new raster above the one that it was made of, in its style."""
        project, is_dsm = QgsProject.instance(), path == records.edited
        source = project.mapLayer(self._layer_id) if is_dsm else self.confidence.currentLayer()
        layer = QgsRasterLayer(path, os.path.splitext(os.path.basename(path))[0])
        if source is None or not layer.isValid():
            return
        layer.setName(self.tr("Edited: {name}").format(name=source.name()))
        style = QgsMapLayerStyle()
        style.readFromLayer(source)
        style.writeToLayer(layer)
        layer.setCrs(source.crs())
        project.addMapLayer(layer, False)
        node = project.layerTreeRoot().findLayer(source.id())
        parent = node.parent() if node is not None else project.layerTreeRoot()
        place = parent.children().index(node) if node is not None else 0
        shown = parent.insertLayer(place, layer)
        shown.setExpanded(False)
        shown.setItemVisibilityChecked(is_dsm)
        if node is not None and is_dsm:
            for key in node.customProperties():
                shown.setCustomProperty(key, node.customProperty(key))
            node.setItemVisibilityChecked(False)

    # --- the dock itself ---

    def _refresh(self, text: str = "") -> None:
        """Show the records in the list and on the map."""
        edits = self.records.edits if self.records is not None else ()
        names = {self.operation.itemData(i): self.operation.itemText(i) for i in range(self.operation.count())}
        self.list.blockSignals(True)
        self.list.clear()
        for edit in edits:
            value = "" if edit.value is None else f", {edit.value:g} m"
            item = QListWidgetItem(f"{edit.number}: {names[edit.operation]}{value}")
            item.setFlags(item.flags() | Qt.ItemFlag.ItemIsUserCheckable)
            item.setCheckState(Qt.CheckState.Checked if edit.enabled else Qt.CheckState.Unchecked)
            item.setData(Qt.ItemDataRole.UserRole, edit.number)
            self.list.addItem(item)
        self.list.scrollToBottom()
        self.list.blockSignals(False)
        self.undo_button.setEnabled(bool(edits))
        for button in self.buttons.values():
            button.setEnabled(self.records is not None)
        self._show_on_map()
        if text or self.records is None:
            self._say(text)
        elif not edits:
            self._say(self.tr("Choose an edit, press Polygon or Brush, and draw on the map."))
        else:
            file = os.path.basename(self.records.edited)
            self._say(self.tr("Edits in {file}: {count}.").format(count=len(edits), file=file))

    def _show_on_map(self) -> None:
        records, kinds = self.records, QgsWkbTypes.GeometryType
        for band, kind in zip(self._bands, (kinds.PolygonGeometry, kinds.LineGeometry)):
            band.reset(kind)
        if records is None or not (self.isVisible() or self._canvas.isVisible()):
            return
        for edit in records.edits:
            geometry = QgsGeometry()
            geometry.fromWkb(edit.geometry)
            if edit.enabled:
                try:
                    self._to_records(geometry, records, back=True)
                except QgsCsException:
                    continue
                area = geometry.type() == kinds.PolygonGeometry
                self._bands[0 if area else 1].addGeometry(geometry, None)

    def _tried(self, work: Callable[[], object]) -> bool:
        from ..repm_qgis.contracts.errors import RepmError

        try:
            work()
        except RepmError as error:
            self._refresh(said(str(error)))
            return False
        return True

    def _say(self, text: str) -> None:
        self.said.setText(text)

    def closeEvent(self, event: QEvent) -> None:
        if self._canvas.mapTool() is self._tool:
            self._canvas.unsetMapTool(self._tool)
        for band, kind in zip(
            self._bands, (QgsWkbTypes.GeometryType.PolygonGeometry, QgsWkbTypes.GeometryType.LineGeometry)
        ):
            band.reset(kind)
        super().closeEvent(event)

    def showEvent(self, event: QEvent) -> None:
        self._follow_layer(self._iface.activeLayer())
        self._refresh(self.said.text())
        super().showEvent(event)

    def close_down(self) -> None:
        self._iface.currentLayerChanged.disconnect(self._follow_layer)
        if self._task is not None:
            self._task.executed.disconnect()
            self._task.cancel()
            self._task = None
        if self._canvas.mapTool() is self._tool:
            self._canvas.unsetMapTool(self._tool)
        for band in self._bands:
            self._canvas.scene().removeItem(band)
        self._iface.removeDockWidget(self)
