"""The table of control points in the picker: places can be edited, figures are computed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from qgis.PyQt.QtCore import QAbstractTableModel, QModelIndex, Qt, pyqtSignal

from ..processing_provider.language import said

if TYPE_CHECKING:  # the engine is imported when it is needed
    from ..repm_qgis.pointing.gcp_measuring import GcpMeasuring, PointCheck
    from ..repm_qgis.pointing.ground_control import Gcp

_IMAGES, _OFFSET, _MISS, _CHECK_ONLY = 1, 2, 3, 4
FIELDS = {0: "id", 5: "height", 6: "lon", 7: "lat"}  # that can be edited, by column


class PointTable(QAbstractTableModel):
    """The points of a :class:`repm_qgis.pointing.gcp_measuring.GcpMeasuring`, one a row."""

    edited = pyqtSignal(str)  # the point's name after the change
    refused = pyqtSignal(str)

    def __init__(self, measuring: GcpMeasuring, parent: object = None) -> None:
        super().__init__(parent)
        self._measuring = measuring
        self._checks: dict[str, PointCheck] = {}

    def renew(self) -> None:
        """Points or pixels have changed."""
        self.beginResetModel()
        self._checks = {}
        self.endResetModel()

    def check(self, row: int) -> PointCheck:
        """How well a row's pixels agree, computed once."""
        from ..repm_qgis.pointing.gcp_measuring import check_point

        gcp = self._measuring.points[row]
        if gcp.id not in self._checks:
            self._checks[gcp.id] = check_point(gcp, self._measuring.views)
        return self._checks[gcp.id]

    def rowCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: B008 - Qt's signature
        return 0 if parent.isValid() else len(self._measuring.points)

    def columnCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: B008 - Qt's signature
        return 0 if parent.isValid() else 8

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        if orientation != Qt.Orientation.Horizontal or role != Qt.ItemDataRole.DisplayRole:
            return None
        return (
            self.tr("Point"),
            self.tr("Images"),
            self.tr("Offset (m)"),
            self.tr("Miss (px)"),
            self.tr("Check only"),
            self.tr("Height (m)"),
            self.tr("Longitude (°)"),
            self.tr("Latitude (°)"),
        )[section]

    def flags(self, index: QModelIndex) -> Qt.ItemFlags:
        own = Qt.ItemFlag.ItemIsEditable if index.column() in FIELDS else Qt.ItemFlag.NoItemFlags
        return super().flags(index) | (Qt.ItemFlag.ItemIsUserCheckable if index.column() == _CHECK_ONLY else own)

    def data(self, index: QModelIndex, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        gcp, column = self._measuring.points[index.row()], index.column()
        if role == Qt.ItemDataRole.EditRole and column in FIELDS:
            value = getattr(gcp, FIELDS[column])
            return value if isinstance(value, str) else f"{value:.9f}".rstrip("0").rstrip(".")
        if role == Qt.ItemDataRole.CheckStateRole and column == _CHECK_ONLY:
            return Qt.CheckState.Checked if gcp.role == "check" else Qt.CheckState.Unchecked
        if role == Qt.ItemDataRole.DisplayRole and column != _CHECK_ONLY:
            return self._shown(gcp, index.row(), column)
        return None

    def _shown(self, gcp: Gcp, row: int, column: int) -> str:
        if column in FIELDS:
            value = getattr(gcp, FIELDS[column])
            return value if isinstance(value, str) else f"{value:.2f}" if FIELDS[column] == "height" else f"{value:.6f}"
        check = self.check(row)
        if column == _IMAGES:
            return str(len(check.residuals))
        if check.offset is None:
            return ""
        return f"{check.distance_m:.2f}" if column == _OFFSET else f"{check.largest_miss_px:.2f}"

    def setData(self, index: QModelIndex, value: object, role: int = Qt.ItemDataRole.EditRole) -> bool:
        from ..repm_qgis.contracts.errors import InputTableError

        if role == Qt.ItemDataRole.CheckStateRole and index.column() == _CHECK_ONLY:
            checked = value in (Qt.CheckState.Checked, 2)  # Qt 6 gives the number
            changed = {"role": "check" if checked else "control"}
        elif role == Qt.ItemDataRole.EditRole and index.column() in FIELDS:
            changed = {FIELDS[index.column()]: str(value)}
        else:
            return False
        try:
            gcp = self._measuring.edit(self._measuring.points[index.row()].id, **changed)
        except InputTableError as error:
            self.refused.emit(said(str(error)))
            return False
        self.edited.emit(gcp.id)
        return True
