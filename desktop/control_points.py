"""The dock "Measure control points": a point on the map or in a table, and the same point in each image.

The computation is the engine's (:mod:`repm_qgis.pointing.gcp_measuring`), and light enough for QGIS's own process.
"""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Callable, Optional, Sequence

import numpy as np
from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsGeometry,
    QgsMapLayerProxyModel,
    QgsPointXY,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProject,
    QgsSettings,
    QgsWkbTypes,
)
from qgis.gui import (
    QgisInterface,
    QgsDockWidget,
    QgsMapLayerComboBox,
    QgsMapToolEmitPoint,
    QgsRubberBand,
    QgsVertexMarker,
)
from qgis.PyQt.QtCore import QEvent, QModelIndex, Qt
from qgis.PyQt.QtGui import QColor, QKeySequence
from qgis.PyQt.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QFileDialog,
    QFormLayout,
    QHBoxLayout,
    QInputDialog,
    QLabel,
    QMenu,
    QMessageBox,
    QPushButton,
    QScrollArea,
    QShortcut,
    QSplitter,
    QTableView,
    QVBoxLayout,
    QWidget,
)

from ..processing_provider.language import said
from ..processing_provider.values import layer_path, points_path
from .image_view import ImageView
from .point_table import PointTable

if TYPE_CHECKING:  # the engine is imported when it is needed
    from ..repm_qgis.pointing.gcp_measuring import PointCheck
    from ..repm_qgis.scene import View

_WGS84 = QgsCoordinateReferenceSystem("EPSG:4326")
_FOLDER = "repm/control_points_folder"


class _ViewPanel(QWidget):
    """One image with its name, the result of the click, and its buttons."""

    def __init__(self, view: View, dock: ControlPointsDock) -> None:
        super().__init__()
        self.name = view.name
        self.image = ImageView(view.image, view.band, view.size, self)
        self.said, title = QLabel(), QLabel(f"<b>{view.name}</b>")
        skip, remove = QPushButton(self.tr("Not visible")), QPushButton(self.tr("Delete"))
        skip.setToolTip(self.tr("This image does not show the point (key S)."))
        remove.setToolTip(self.tr("Remove the mark (key Delete)."))
        row = QHBoxLayout()
        row.addWidget(title, 1)
        row.addWidget(skip)
        row.addWidget(remove)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(2, 2, 2, 2)
        layout.setSpacing(2)
        layout.addLayout(row)
        layout.addWidget(self.said)
        layout.addWidget(self.image, 1)
        self.image.setToolTip(
            self.tr(
                "Click: mark the point. Wheel, + and −: zoom. Drag: move the image. Arrow keys: move the mark by 0.1 "
                "px, with Shift by 1 px. Enter: the point is where it is predicted (yellow ring). Delete: remove the "
                "mark. S: not visible here. Home: back to the point."
            )
        )
        self.image.clicked.connect(lambda col, row: dock.measure(self.name, np.array([col, row])))
        self.image.removed.connect(lambda: dock.measure(self.name, None))
        self.image.skipped.connect(lambda: dock.skip(self.name))
        self.image.failed.connect(self.said.setText)
        skip.clicked.connect(lambda: dock.skip(self.name))
        remove.clicked.connect(lambda: dock.measure(self.name, None))


class ControlPointsDock(QgsDockWidget):
    """Measures control points; ``close_down`` takes its marks and its tool off the map."""

    def __init__(self, iface: QgisInterface) -> None:
        from ..repm_qgis.pointing.gcp_measuring import GcpMeasuring

        super().__init__(iface.mainWindow())
        self.setObjectName("RepmControlPoints")
        self._iface, self._canvas = iface, iface.mapCanvas()
        self.measuring, self._path, self._current = GcpMeasuring(), "", ""
        self.panels: list[_ViewPanel] = []
        self._tool = QgsMapToolEmitPoint(self._canvas)
        self._tool.canvasClicked.connect(lambda point, _: self.add_at(point))
        self._marks = QgsRubberBand(self._canvas, QgsWkbTypes.GeometryType.PointGeometry)
        self._marks.setIcon(QgsRubberBand.IconType.ICON_X)
        self._marks.setColor(QColor("#ff3d7f"))
        self._marks.setSecondaryStrokeColor(QColor("white"))
        self._chosen = QgsVertexMarker(self._canvas)
        self._chosen.setIconType(QgsVertexMarker.IconType.ICON_CIRCLE)
        self._chosen.setColor(QColor("#ffd21f"))
        self._chosen.setIconSize(18)
        self._chosen.setPenWidth(3)
        self._chosen.hide()
        self._build()
        self._shortcuts()
        self._refresh()

    def _build(self) -> None:
        self.table = PointTable(self.measuring, self)
        self.table.edited.connect(lambda name: self._changed(name, move=True))
        self.table.refused.connect(self._say)
        self.rows = QTableView()
        self.rows.setModel(self.table)
        self.rows.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.rows.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.rows.verticalHeader().hide()
        self.rows.selectionModel().currentRowChanged.connect(self._row_chosen)
        self.images_button = self._button(self.tr("1. Images or scene…"), self._choose_images)
        self.points_button = QPushButton(self.tr("2. Points"))
        menu = QMenu(self.points_button)
        menu.aboutToShow.connect(lambda: self._fill_menu(menu))
        self.points_button.setMenu(menu)
        self.new_button = self._button(self.tr("New point on the map"), self._choose_tool)
        self.new_button.setCheckable(True)
        self._tool.setButton(self.new_button)
        self.undo_button = self._button(self.tr("Undo"), self.undo)
        self.remove_button = self._button(self.tr("Delete point"), self.remove)
        self.save_button = self._button(self.tr("3. Save for GCPS…"), self._choose_file)
        self.datum = QComboBox()
        self.datum.setEditable(True)
        self.datum.addItems([self.tr("WGS 84 ellipsoid"), "EGM96", "EGM2008"])
        self.datum.setToolTip(
            self.tr(
                "The vertical datum of a table's heights when it is loaded: the ellipsoid, EGM96, EGM2008, or a "
                "vertical "
                "CRS such as EPSG:5773. They are saved above the ellipsoid: leave GCP_DATUM empty then."
            )
        )
        self.heights = QgsMapLayerComboBox()
        self.heights.setFilters(QgsMapLayerProxyModel.Filter.RasterLayer)
        self.heights.setAllowEmptyLayer(True)
        self.heights.setCurrentIndex(0)
        self.heights.setToolTip(self.tr("Where a new point takes its height from; empty: you are asked for it."))
        top = QHBoxLayout()
        for widget in (self.images_button, self.points_button, self.save_button):
            top.addWidget(widget)
        top.addStretch()
        below = QHBoxLayout()
        for widget in (self.new_button, self.undo_button, self.remove_button):
            below.addWidget(widget)
        left = QWidget()
        form = QFormLayout(left)
        form.setContentsMargins(0, 0, 0, 0)
        form.addRow(self.rows)
        form.addRow(below)
        form.addRow(self.tr("Heights of tables:"), self.datum)
        form.addRow(self.tr("New heights from:"), self.heights)
        self._views = QWidget()
        self._view_row = QHBoxLayout(self._views)
        self._view_row.setContentsMargins(0, 0, 0, 0)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setWidget(self._views)
        middle = QSplitter()
        middle.addWidget(left)
        middle.addWidget(area)
        middle.setSizes([400, 880])
        self.said = QLabel()
        self.said.setWordWrap(True)
        self.said.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        inside = QWidget()
        layout = QVBoxLayout(inside)
        layout.setContentsMargins(4, 4, 4, 4)
        layout.addLayout(top)
        layout.addWidget(middle, 1)
        layout.addWidget(self.said)
        self.setWidget(inside)

    def _button(self, text: str, run: Callable[[], object]) -> QPushButton:
        button = QPushButton(text)
        button.clicked.connect(lambda: run())
        return button

    def _shortcuts(self) -> None:
        pairs = (
            (QKeySequence(QKeySequence.StandardKey.Undo), self.undo, self.undo_button),
            (QKeySequence(QKeySequence.StandardKey.Save), self._choose_file, self.save_button),
            (QKeySequence("PgDown"), lambda: self._step(1), None),
            (QKeySequence("PgUp"), lambda: self._step(-1), None),
        )
        for keys, run, button in pairs:
            shortcut = QShortcut(keys, self.widget())
            shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
            shortcut.activated.connect(run)
            if button is not None:
                button.setToolTip(keys.toString(QKeySequence.SequenceFormat.NativeText))
        self.rows.setToolTip(self.tr("Page Up and Page Down go to another point. Double click a value to change it."))

    # --- what comes in ---

    def open_images(self, paths: list[str]) -> bool:
        """Show these images, or those of a scene; errors are shown in the dock."""
        from ..repm_qgis.scene import Scene, load_views

        scene = next((path for path in paths if path.lower().endswith(".json")), "")
        if not self._tried(lambda: self._set_views(Scene.load(scene).views if scene else load_views(paths))):
            return False
        return self._refresh(move=True)

    def open_points(self, path: str) -> bool:
        """Take the points of a table or layer, with the pixels that it has of these images."""
        from ..repm_qgis.pointing.ground_control import read_gcps

        datum = "" if self.datum.currentIndex() == 0 else self.datum.currentText()
        views = self.measuring.views or None
        elsewhere: list[str] = []
        if not self._tried(lambda: self.measuring.load(read_gcps(path, views, datum, elsewhere.append))):
            return False
        self._path = ""  # a table of the user's may have more columns than ours: it is not written over
        self._current = self.measuring.points[0].id
        self._refresh(move=True)
        if elsewhere:
            self._say(" ".join(map(said, elsewhere)))
        return True

    def add_at(self, point: QgsPointXY) -> None:
        """A new point at a place of the map."""
        crs = self._canvas.mapSettings().destinationCrs()
        place = QgsCoordinateTransform(crs, _WGS84, QgsProject.instance()).transform(point)
        height = self._height_at(place)
        if height is None:
            title, text = self.tr("New point"), self.tr("Height above the WGS 84 ellipsoid (m):")
            height, given = QInputDialog.getDouble(self, title, text, 0.0, -12000.0, 10000.0, 3)
            if not given:
                return
        row = {"id": self.measuring.new_name(), "lon": place.x(), "lat": place.y(), "height": height}
        self._tried(lambda: self._changed(self.measuring.add(row).id, move=True))

    def _height_at(self, place: QgsPointXY) -> Optional[float]:
        """The height of the chosen layer there, above the ellipsoid; None where there is none."""
        from ..repm_qgis.evaluation.gcp_accuracy import GcpAccuracy, measure_dsm
        from ..repm_qgis.imagery.raster import opened
        from ..repm_qgis.pointing.ground_control import point_of

        layer = self.heights.currentLayer()
        if layer is None:
            return None
        found = GcpAccuracy([point_of(layer.name(), {"id": "new", "lon": place.x(), "lat": place.y(), "height": 0})])

        def measure() -> None:
            with opened(layer_path(layer)) as dsm:
                measure_dsm(found, dsm, layer.name())

        if not self._tried(measure):
            return None
        self._say(" ".join(map(said, found.warnings)))
        height = math.nan if found.dsm_heights is None else float(found.dsm_heights[0])
        return height if math.isfinite(height) else None

    # --- what the user does with a point ---

    def measure(self, view: str, pixel: Optional[np.ndarray]) -> None:
        if self._current:
            self.measuring.measure(self._current, view, pixel)
            self._changed(self._current)

    def skip(self, view: str) -> None:
        if self._current:
            self.measuring.skip(self._current, view)
            self._changed(self._current)

    def undo(self) -> None:
        if self.measuring.undo():
            self._changed(self._current)

    def remove(self) -> None:
        if self._current:
            self.measuring.remove(self._current)
            self._changed("", move=True)

    def choose(self, name: str) -> None:
        """Go to a point."""
        self._current = name
        self._refresh(move=True)

    def save(self, path: str) -> bool:
        """Write the table; from now on every change is written to it at once."""
        if not self._tried(lambda: self.measuring.save(path)):
            return False
        self._path = path
        QgsSettings().setValue(_FOLDER, os.path.dirname(path))
        return self._refresh()

    def close_down(self) -> None:
        for item in (self._marks, self._chosen):
            self._canvas.scene().removeItem(item)
        if self._canvas.mapTool() is self._tool:
            self._canvas.unsetMapTool(self._tool)
        self._iface.removeDockWidget(self)

    # --- the dock itself ---

    def _choose_images(self) -> None:
        kinds = self.tr("Images and scenes") + " (*.tif *.tiff *.ntf *.nitf *.jp2 *.vrt *.img *.json);;(*)"
        paths, _ = QFileDialog.getOpenFileNames(self, self.tr("Images of the same ground, or a scene"), "", kinds)
        if paths:
            self.open_images(paths)

    def _fill_menu(self, menu: QMenu) -> None:
        menu.clear()
        menu.addAction(self.tr("From a file…"), self._choose_points)
        for layer in QgsProject.instance().mapLayers().values():
            kinds = QgsWkbTypes.GeometryType.PointGeometry, QgsWkbTypes.GeometryType.NullGeometry
            if hasattr(layer, "geometryType") and layer.geometryType() in kinds:
                menu.addAction(layer.name(), lambda layer=layer: self._open_layer(layer))

    def _open_layer(self, layer: object) -> None:
        try:
            self.open_points(str(points_path(layer, QgsProcessingContext())))
        except QgsProcessingException as error:
            self._say(said(str(error)))

    def _choose_points(self) -> None:
        kinds = self.tr("Tables and point layers") + " (*.csv *.gpkg *.geojson *.shp *.fgb);;(*)"
        folder = str(QgsSettings().value(_FOLDER, "") or "")
        path, _ = QFileDialog.getOpenFileName(self, self.tr("Control points"), folder, kinds)
        if path:
            self.open_points(path)

    def _choose_file(self) -> None:
        start = self._path or os.path.join(str(QgsSettings().value(_FOLDER, "") or ""), "gcps.csv")
        path, _ = QFileDialog.getSaveFileName(self, self.tr("Save for GCPS"), start, "CSV (*.csv)")
        if path:
            self.save(path if path.lower().endswith(".csv") else f"{path}.csv")

    def _choose_tool(self) -> None:
        self._canvas.setMapTool(self._tool)

    def _step(self, steps: int) -> None:
        names = [gcp.id for gcp in self.measuring.points]
        if names:
            at = names.index(self._current) if self._current in names else -steps
            self.choose(names[min(max(at + steps, 0), len(names) - 1)])

    def _row_chosen(self, row: QModelIndex, _: object) -> None:
        names = [gcp.id for gcp in self.measuring.points]
        if row.isValid() and names[row.row()] != self._current:
            self.choose(names[row.row()])

    def _set_views(self, views: Sequence[View]) -> None:
        self.measuring.views = tuple(views)
        for panel in self.panels:
            panel.deleteLater()
        self.panels = [_ViewPanel(view, self) for view in self.measuring.views]
        for panel in self.panels:
            self._view_row.addWidget(panel)

    def _changed(self, name: str, move: bool = False) -> None:
        names = [gcp.id for gcp in self.measuring.points]
        self._current = name if name in names else (names[0] if names else "")
        if self._path and not self._tried(lambda: self.measuring.save(self._path)):
            self._path = ""
            return
        self._refresh(move or name != self._current)

    def _tried(self, work: Callable[[], object]) -> bool:
        from ..repm_qgis.contracts.errors import RepmError

        try:
            work()
        except RepmError as error:
            return self._say(said(str(error)))
        return True

    def _say(self, text: str) -> bool:
        """Show a sentence below the images; always False, for those that fail with it."""
        self.said.setText(text)
        return False

    def _refresh(self, move: bool = False) -> bool:
        names = [gcp.id for gcp in self.measuring.points]
        self.table.renew()
        if self._current in names:
            self.rows.selectRow(names.index(self._current))
        self.rows.resizeColumnsToContents()
        for button in (self.remove_button, self.save_button):
            button.setEnabled(bool(names))
        self.undo_button.setEnabled(self.measuring.can_undo)
        self._show_views(move)
        self._show_on_map(move)
        self._say(self._summary())
        where = f"{os.path.basename(self._path)}{' *' if self.measuring.unsaved else ''}" if self._path else ""
        unsaved = self.tr("not saved") if self.measuring.unsaved and not self._path else where
        title = self.tr("Measure control points")
        self.setWindowTitle(f"{title} ({unsaved})" if unsaved else title)
        return True

    def _show_views(self, move: bool) -> None:
        gcp = self.measuring.point(self._current) if self._current else None
        check = None if gcp is None else self.table.check(self.measuring.points.index(gcp))
        for view, panel in zip(self.measuring.views, self.panels):
            if gcp is None:
                panel.image.show_point(None, None, False)
                panel.said.setText("")
                continue
            predicted, measured = self.measuring.predicted(gcp, view), gcp.pixels.get(view.name)
            panel.image.show_point(predicted, measured, move)
            if self.measuring.is_skipped(gcp.id, view.name):
                panel.said.setText(self.tr("not visible here"))
            elif check is not None and measured is not None:
                col, row = check.residuals[view.name]
                panel.said.setText(
                    self.tr("from the RPC: {col}, {row} px").format(col=f"{col:+.2f}", row=f"{row:+.2f}")
                )
            elif predicted is None:
                panel.said.setText(self.tr("outside this image"))
            else:
                panel.said.setText(self.tr("click the point"))

    def _show_on_map(self, move: bool) -> None:
        crs = self._canvas.mapSettings().destinationCrs()
        transform = QgsCoordinateTransform(_WGS84, crs, QgsProject.instance())
        self._chosen.hide()
        places = {gcp.id: transform.transform(QgsPointXY(gcp.lon, gcp.lat)) for gcp in self.measuring.points}
        self._marks.setToGeometry(QgsGeometry.fromMultiPointXY(list(places.values())), None)
        chosen = places.get(self._current)
        if chosen is None:
            return
        self._chosen.setCenter(chosen)
        self._chosen.show()
        if move and not self._canvas.extent().contains(chosen):
            self._canvas.setCenter(chosen)
            self._canvas.refresh()

    def _summary(self) -> str:
        if not self.measuring.views:
            return self.tr("Choose the images, or the scene of a run, that show the points.")
        if not self.measuring.points:
            return self.tr("Load points, or press New point on the map and click the place on an orthophoto.")
        gcp = self.measuring.point(self._current)
        check = self.table.check(self.measuring.points.index(gcp))
        if check.offset is None and len(self.measuring.views) > 1:
            return self.tr("Point {name}: mark it in at least two images.").format(name=gcp.id)
        if check.offset is None:
            return self._of_one_image(gcp.id, check)
        east, north, up = (f"{value:+.2f}" for value in check.offset)
        return self.tr(
            "Point {name}: the images see it {distance} m from its place (east {east}, north {north}, up {up} m), and "
            "contradict each other by {miss} px. If all points show the same offset, it is the vendor's pointing, "
            "which GCPS corrects; if one point differs, check its place and its marks."
        ).format(
            name=gcp.id,
            distance=f"{check.distance_m:.2f}",
            east=east,
            north=north,
            up=up,
            miss=f"{check.largest_miss_px:.2f}",
        )

    def _of_one_image(self, name: str, check: PointCheck) -> str:
        """What the only image says of a point: it sees no height, and where the RPC has the point."""
        found = check.residuals.get(self.measuring.views[0].name)
        if found is None:
            return self.tr("Point {name}: mark it in the image.").format(name=name)
        return self.tr(
            "Point {name}: the image shows it {distance} px from where the RPC has it. If all points show the same, it "
            "is the vendor's pointing, which GCPS of 'Export corrected RPCs' corrects; if one point differs, check its "
            "place and its mark."
        ).format(name=name, distance=f"{math.hypot(*found):.2f}")

    def closeEvent(self, event: QEvent) -> None:
        if self.measuring.unsaved and not self._path:
            buttons = QMessageBox.StandardButton.Save, QMessageBox.StandardButton.Discard
            question = self.tr("The measured points are not saved. Save them now? They stay here until QGIS closes.")
            asked = QMessageBox.question(self, self.windowTitle(), question, buttons[0] | buttons[1])
            if asked == buttons[0]:
                self._choose_file()
        if self._canvas.mapTool() is self._tool:
            self._canvas.unsetMapTool(self._tool)
        self._marks.reset(QgsWkbTypes.GeometryType.PointGeometry)
        self._chosen.hide()
        super().closeEvent(event)

    def showEvent(self, event: QEvent) -> None:
        self._refresh()
        super().showEvent(event)
