"""The map tool that draws edits: polygons and lines by clicks, a brush by dragging."""

from __future__ import annotations

from typing import Optional

from qgis.core import QgsGeometry, QgsPointXY, QgsWkbTypes
from qgis.gui import QgsMapCanvas, QgsMapTool, QgsRubberBand
from qgis.PyQt.QtCore import QEvent, Qt, pyqtSignal
from qgis.PyQt.QtGui import QColor

POLYGON, LINE, BRUSH = "polygon", "line", "brush"
_LEAST = {POLYGON: 3, LINE: 2, BRUSH: 1}
_COLOUR = "#ff3d7f"


class DrawingTool(QgsMapTool):
    """Draws one shape after the other; ``drawn`` gives each in the map's CRS when it is finished.

    A left click adds a vertex, a right click ends the shape, Backspace takes the last vertex away, and Escape all of
    them. The brush draws as long as the left button is down.
    """

    drawn = pyqtSignal(QgsGeometry)

    def __init__(self, canvas: QgsMapCanvas) -> None:
        super().__init__(canvas)
        self.kind, self._brush_px = POLYGON, 1
        self._points: list[QgsPointXY] = []
        self._band: Optional[QgsRubberBand] = None
        self.setCursor(Qt.CursorShape.CrossCursor)

    def choose(self, kind: str, brush_px: int = 1) -> None:
        """Draw shapes of this kind from now on; the brush is so many pixels of the screen wide."""
        self._forget()
        self.kind, self._brush_px = kind, max(1, brush_px)

    def canvasPressEvent(self, event: QEvent) -> None:
        if self.kind == BRUSH and event.button() == Qt.MouseButton.LeftButton:
            self._points = [event.mapPoint()]
            self._show()

    def canvasMoveEvent(self, event: QEvent) -> None:
        if not self._points:
            return
        place = event.mapPoint()
        if self.kind == BRUSH:
            self._points.append(place)
            self._show()
        else:
            self._show(place)

    def canvasReleaseEvent(self, event: QEvent) -> None:
        left = event.button() == Qt.MouseButton.LeftButton
        if self.kind == BRUSH:
            if left and self._points:
                self._finish()
        elif left:
            self._points.append(event.mapPoint())
            self._show()
        elif event.button() == Qt.MouseButton.RightButton:
            self._finish()

    def keyPressEvent(self, event: QEvent) -> None:
        if event.key() == Qt.Key.Key_Escape:
            self._forget()
        elif event.key() in (Qt.Key.Key_Backspace, Qt.Key.Key_Delete) and self.kind != BRUSH:
            self._points = self._points[:-1]
            self._show()
            event.ignore()  # else QGIS's own shortcut takes it
        else:
            super().keyPressEvent(event)

    def deactivate(self) -> None:
        self._forget()
        super().deactivate()

    def _finish(self) -> None:
        points, kind = self._points, self.kind
        self._forget()
        distinct = [point for index, point in enumerate(points) if not index or point != points[index - 1]]
        if len(distinct) < _LEAST[kind]:
            return
        if kind == POLYGON:
            self.drawn.emit(QgsGeometry.fromPolygonXY([distinct]))
            return
        if len(distinct) == 1:  # a dab of the brush
            distinct = [
                distinct[0],
                QgsPointXY(distinct[0].x() + 1e-3 * self.canvas().mapUnitsPerPixel(), distinct[0].y()),
            ]
        self.drawn.emit(QgsGeometry.fromPolylineXY(distinct))

    def _show(self, ahead: Optional[QgsPointXY] = None) -> None:
        """Draw the shape so far on the map, and the line to the mouse."""
        self._clear_band()
        points = [*self._points, *([ahead] if ahead is not None and self._points else [])]
        if not points:
            return
        kinds = QgsWkbTypes.GeometryType
        area = self.kind == POLYGON and len(points) > 2
        self._band = QgsRubberBand(self.canvas(), kinds.PolygonGeometry if area else kinds.LineGeometry)
        colour = QColor(_COLOUR)
        if self.kind == BRUSH:
            colour.setAlpha(120)
        self._band.setColor(colour)
        fill = QColor(_COLOUR)
        fill.setAlpha(50)
        self._band.setFillColor(fill)
        self._band.setWidth(self._brush_px if self.kind == BRUSH else 2)
        for point in points:
            self._band.addPoint(point, False)
        self._band.show()
        self._band.updatePosition()
        self._band.update()

    def _clear_band(self) -> None:
        if self._band is not None:
            self.canvas().scene().removeItem(self._band)
            self._band = None

    def _forget(self) -> None:
        self._points = []
        self._clear_band()
