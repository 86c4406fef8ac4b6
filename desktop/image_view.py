"""One satellite image in sensor geometry, as large as the screen pixels need it: zoom, move, click a point.

QGIS's own canvas would load the image as a layer, and write statistics beside it.
"""

from __future__ import annotations

import math
from typing import Any, Optional

import numpy as np
from qgis.PyQt.QtCore import QEvent, QPointF, QRectF, QSize, Qt, QTimer, pyqtSignal
from qgis.PyQt.QtGui import QColor, QImage, QPainter, QPen
from qgis.PyQt.QtWidgets import QSizePolicy, QWidget

from ..processing_provider.language import said

_SCALES = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # screen px for an image px
_START = _SCALES.index(4.0)
_STEP_PX, _LARGE_STEP_PX = 0.1, 1.0  # of the arrow keys
_CLICK_PX = 4  # on the screen: a press that moves farther is a move of the image
_KEYS = {
    Qt.Key.Key_Left: (-1, 0),
    Qt.Key.Key_Right: (1, 0),
    Qt.Key.Key_Up: (0, -1),
    Qt.Key.Key_Down: (0, 1),
}


def position(event: QEvent) -> QPointF:
    """Where a mouse event happened: Qt 6 has another name for it than Qt 5."""
    return event.position() if hasattr(event, "position") else QPointF(event.pos())


class ImageView(QWidget):
    """Shows an image around a pixel. ``clicked`` has the pixel (column, row; the first pixel's centre is 0, 0)."""

    clicked = pyqtSignal(float, float)
    removed = pyqtSignal()
    skipped = pyqtSignal()
    failed = pyqtSignal(str)

    def __init__(self, path: str, band: int, size: tuple[int, int], parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self._path, self._band, self._size = path, band, size
        self._zoom, self._centre, self._whole = 0, (np.array(size) - 1) / 2, True  # until there is a point
        self.predicted: Optional[np.ndarray] = None
        self.measured: Optional[np.ndarray] = None
        self._picture: Optional[QImage] = None
        self._window: Any = None
        self._pressed: Optional[QPointF] = None
        self._moved = False
        self._later = QTimer(self)
        self._later.setSingleShot(True)
        self._later.setInterval(0)
        self._later.timeout.connect(self._read)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMinimumSize(180, 140)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setCursor(Qt.CursorShape.CrossCursor)

    def sizeHint(self) -> QSize:
        return QSize(280, 240)

    @property
    def scale(self) -> float:
        """Screen px for an image px."""
        return _SCALES[self._zoom]

    def show_point(self, predicted: Optional[np.ndarray], measured: Optional[np.ndarray], move: bool) -> None:
        """Mark a point; ``move`` brings it to the middle, at the scale that suits measuring."""
        self.predicted, self.measured = predicted, measured
        place = measured if measured is not None else predicted
        if move and place is not None:
            self._centre, self._zoom, self._whole = np.array(place), _START, False
            self._later.start()
        self.update()

    def zoom(self, steps: int, around: Optional[QPointF] = None) -> None:
        """Zoom in (out where ``steps`` is negative), keeping the pixel under a place of the screen there."""
        self._whole = False
        place = around or QPointF(self.width() / 2, self.height() / 2)
        before = self.pixel_at(place)
        self._zoom = min(max(self._zoom + steps, 0), len(_SCALES) - 1)
        self._centre = self._centre + before - self.pixel_at(place)
        self._later.start()
        self.update()

    def pixel_at(self, place: QPointF) -> np.ndarray:
        """(2,) the image's column and row at a place of the screen."""
        return self._centre + np.array([place.x() - self.width() / 2, place.y() - self.height() / 2]) / self.scale

    def place_of(self, pixel: np.ndarray) -> QPointF:
        """The place on the screen of a (2,) column and row."""
        x, y = (np.asarray(pixel) - self._centre) * self.scale
        return QPointF(float(x) + self.width() / 2, float(y) + self.height() / 2)

    def _read(self) -> None:
        from ..repm_qgis.contracts.errors import RepmError
        from ..repm_qgis.imagery.window_picture import window_picture

        size = (max(self.width(), 1), max(self.height(), 1))
        try:
            found = window_picture(self._path, self._band, self._centre, self.scale, size)
        except RepmError as error:
            self._picture = None
            self.failed.emit(said(str(error)))
            return
        self._picture = self._window = None
        if found is not None:
            grey, self._window = found
            height, width = grey.shape
            self._picture = QImage(grey.tobytes(), width, height, width, QImage.Format.Format_Grayscale8).copy()
        self.update()

    def paintEvent(self, event: QEvent) -> None:
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor("#303030"))
        if self._picture is not None:
            col, row, width, height = self._window
            corner = self.place_of(np.array([col - 0.5, row - 0.5]))
            painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
            target = QRectF(corner.x(), corner.y(), width * self.scale, height * self.scale)
            painter.drawImage(target, self._picture, QRectF(self._picture.rect()))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.predicted is not None:
            self._mark(painter, self.place_of(self.predicted), "#ffd21f", False)
        if self.measured is not None:
            self._mark(painter, self.place_of(self.measured), "#ff3d7f", True)
        if self.hasFocus():
            painter.setPen(QPen(self.palette().highlight().color(), 3))
            painter.drawRect(self.rect().adjusted(1, 1, -1, -1))
        painter.end()

    def _mark(self, painter: QPainter, place: QPointF, colour: str, cross: bool) -> None:
        """A ring where the point is predicted, a cross with an open middle where it was measured; both with a rim."""
        for width, pen in ((4.0, QColor("white")), (2.0, QColor(colour))):
            painter.setPen(QPen(pen, width))
            if not cross:
                painter.drawEllipse(place, 12.0, 12.0)
                continue
            for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                painter.drawLine(place + QPointF(4.0 * x, 4.0 * y), place + QPointF(16.0 * x, 16.0 * y))

    def resizeEvent(self, event: QEvent) -> None:
        if self._whole:
            most = min(self.width() / self._size[0], self.height() / self._size[1])
            self._zoom = max([number for number, scale in enumerate(_SCALES) if scale <= most], default=0)
        self._later.start()

    def wheelEvent(self, event: QEvent) -> None:
        steps = event.angleDelta().y()
        if steps:
            self.zoom(int(math.copysign(1, steps)), position(event))

    def mousePressEvent(self, event: QEvent) -> None:
        self._pressed, self._moved = position(event), False

    def mouseMoveEvent(self, event: QEvent) -> None:
        if self._pressed is None:
            return
        way = position(event) - self._pressed
        if self._moved or way.manhattanLength() > _CLICK_PX:
            self._moved, self._pressed = True, position(event)
            self._centre = self._centre - np.array([way.x(), way.y()]) / self.scale
            self._later.start()
            self.update()

    def mouseReleaseEvent(self, event: QEvent) -> None:
        if self._pressed is not None and not self._moved and event.button() == Qt.MouseButton.LeftButton:
            self.clicked.emit(*map(float, self.pixel_at(position(event))))
        self._pressed = None

    def keyPressEvent(self, event: QEvent) -> None:
        key = event.key()
        place = self.measured if self.measured is not None else self.predicted
        if key in _KEYS and place is not None:
            large = bool(event.modifiers() & Qt.KeyboardModifier.ShiftModifier)
            col, row = np.array(place) + np.array(_KEYS[key]) * (_LARGE_STEP_PX if large else _STEP_PX)
            self.clicked.emit(float(col), float(row))
        elif key in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and place is not None:
            self.clicked.emit(*map(float, place))
        elif key == Qt.Key.Key_Delete:
            self.removed.emit()
        elif key == Qt.Key.Key_S:
            self.skipped.emit()
        elif key in (Qt.Key.Key_Plus, Qt.Key.Key_Equal):
            self.zoom(1)
        elif key == Qt.Key.Key_Minus:
            self.zoom(-1)
        elif key == Qt.Key.Key_Home:
            self.show_point(self.predicted, self.measured, True)
        else:
            super().keyPressEvent(event)
