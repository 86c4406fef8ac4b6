"""Geoid grids from PROJ's content network into the folder where PROJ looks for the user's own."""

from __future__ import annotations

import importlib
import os
from types import ModuleType
from typing import TYPE_CHECKING, Optional

from qgis.core import QgsFileDownloader
from qgis.gui import QgisInterface
from qgis.PyQt.QtCore import QCoreApplication, QEvent, QUrl
from qgis.PyQt.QtWidgets import (
    QDialog,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from ..processing_provider.language import said

if TYPE_CHECKING:
    from ..repm_qgis.geometry.geoids import GeoidGrid

ENDPOINT = "https://cdn.proj.org"  # as in PROJ, whose own variable PROJ_NETWORK_ENDPOINT takes its place here too
_SIZES_MB = {"us_nga_egm08_25.tif": 77, "us_nga_egm96_15.tif": 3, "us_noaa_g2018u0.tif": 21}  # PROJ states none
_AREA = 90  # characters of a grid's area


def _tr(text: str) -> str:
    return QCoreApplication.translate("GeoidGridsDialog", text)


def _datadir() -> ModuleType:
    """pyproj's module of PROJ's folders, whose types leave some of its functions out."""
    return importlib.import_module("pyproj.datadir")


def user_folder() -> str:
    """The folder of the user's own grids; PROJ looks there without a restart."""
    return str(_datadir().get_user_data_dir(create=True))


def _proj_version() -> str:
    return str(importlib.import_module("pyproj").proj_version_str)


def is_there(name: str) -> bool:
    """Whether PROJ has a grid."""
    datadir = _datadir()
    folders = os.pathsep.join((datadir.get_data_dir(), datadir.get_user_data_dir()))
    return any(os.path.exists(os.path.join(folder, name)) for folder in folders.split(os.pathsep) if folder)


def address(name: str) -> QUrl:
    """Where a grid lies."""
    return QUrl(f"{os.environ.get('PROJ_NETWORK_ENDPOINT') or ENDPOINT}/{name}")


class GeoidGridsDialog(QDialog):
    """One line for each grid of the datums that dialogs offer, and of any other that is looked up: what it is for, and
    a button that fetches it; QGIS's own proxy is used."""

    def __init__(self, iface: QgisInterface) -> None:
        super().__init__(iface.mainWindow())
        self.setWindowTitle(_tr("REPM: geoid grids"))
        self._loading: Optional[QgsFileDownloader] = None
        self.buttons: dict[str, QPushButton] = {}
        self._ready: set[str] = set()  # under other names, too
        layout = QVBoxLayout(self)
        intro = QLabel(
            _tr(
                "Heights above a geoid, as most maps have them, are brought to the ellipsoid with a grid. QGIS ships "
                "few of them. They are fetched from PROJ's network into your profile, and can be used at once."
            )
        )
        intro.setWordWrap(True)
        layout.addWidget(intro)
        lines = QWidget()
        self._lines = QGridLayout(lines)
        self._lines.setColumnStretch(0, 1)
        self._lines.setVerticalSpacing(12)
        area = QScrollArea()
        area.setWidget(lines)
        area.setWidgetResizable(True)
        layout.addWidget(area, 1)
        self.other = QLineEdit()
        self.other.setPlaceholderText(_tr("Another vertical datum, such as EPSG:5709"))
        self.look_up = QPushButton(_tr("Look up"))
        self.look_up.setAutoDefault(False)
        self.look_up.clicked.connect(lambda *_: self.add(self.other.text()))
        row = QHBoxLayout()
        row.addWidget(self.other, 1)
        row.addWidget(self.look_up)
        layout.addLayout(row)
        self.bar = QProgressBar()
        self.bar.setRange(0, 100)
        self.said = QLabel()
        self.said.setWordWrap(True)
        layout.addWidget(self.bar)
        layout.addWidget(self.said)
        self.resize(640, 560)
        self._add_listed()
        self.refresh()

    def _add_listed(self) -> None:
        from ..repm_qgis.geometry.geoids import geoid_grids
        from ..repm_qgis.geometry.vertical import LISTED

        uses = {
            "EGM2008": _tr("Copernicus DEM, most vendors' heights above sea level"),
            "EGM96": _tr("SRTM, older products"),
        }
        for datum in LISTED:
            for grid in geoid_grids(datum):
                self._add_line(grid, uses.get(datum, ""))

    def add(self, datum: str) -> None:
        """Add the grids of a vertical datum that the user names."""
        from ..repm_qgis.contracts.errors import RepmError
        from ..repm_qgis.geometry.geoids import geoid_grids

        try:
            grids = geoid_grids(datum)
        except RepmError as error:
            self.said.setText(said(str(error)))
            return
        for grid in grids:
            if grid.name not in self.buttons:
                self._add_line(grid)
        self.said.setText(
            ", ".join(grid.name for grid in grids)
            if grids
            else _tr("PROJ {version} knows no grid for '{datum}'.").format(version=_proj_version(), datum=datum)
        )
        self.refresh()

    def _add_line(self, grid: GeoidGrid, use: str = "") -> None:
        size = f" ({_SIZES_MB[grid.name]} MB)" if grid.name in _SIZES_MB else ""
        area = use or (grid.area if len(grid.area) <= _AREA else f"{grid.area[:_AREA].rsplit(' ', 1)[0]} …")
        label = QLabel(f"<b>{grid.datum}</b>: {grid.name}{size}<br>{area}")
        label.setWordWrap(True)
        label.setMinimumWidth(380)
        button = QPushButton()
        button.setAutoDefault(False)
        button.clicked.connect(lambda _=False, name=grid.name: self.fetch(name))
        row = self._lines.rowCount()
        self._lines.addWidget(label, row, 0)
        self._lines.addWidget(button, row, 1)
        self.buttons[grid.name] = button
        if grid.installed:
            self._ready.add(grid.name)

    def showEvent(self, event: QEvent) -> None:
        self.refresh()
        super().showEvent(event)

    def refresh(self) -> None:
        """Show for each grid whether it is installed."""
        for name, button in self.buttons.items():
            there = name in self._ready or is_there(name)
            button.setText(_tr("Installed") if there else _tr("Fetch"))
            button.setEnabled(not there and self._loading is None)

    def fetch(self, name: str) -> None:
        """Fetch a grid in the background; it gets its name when it is complete."""
        part = os.path.join(user_folder(), f".{name}.part")
        self._loading = QgsFileDownloader(address(name), part)
        self._loading.setParent(self)  # it deletes itself when it has ended: Python must not do so too
        self._loading.downloadProgress.connect(self._progressed)
        self._loading.downloadCompleted.connect(lambda *_: self._arrived(name, part))
        self._loading.downloadError.connect(self._failed)
        self.bar.setValue(0)
        self.said.setText(_tr("Fetching {name}…").format(name=name))
        self.refresh()

    def _progressed(self, received: int, total: int) -> None:
        self.bar.setValue(int(100 * received / total) if total > 0 else 0)

    def _arrived(self, name: str, part: str) -> None:
        from ..repm_qgis.contracts.errors import ImageError
        from ..repm_qgis.imagery.raster import opened

        try:
            with opened(part):
                pass
            os.replace(part, os.path.join(user_folder(), name))
        except (ImageError, OSError) as error:
            self._ended(said(str(error)))
            return
        self._ended("", name)

    def _failed(self, errors: list[str]) -> None:
        advice = _tr("Check the network, and the proxy under Settings > Options > Network.")
        self._ended(f"{'; '.join(errors).rstrip('.')}. {advice}")

    def _ended(self, error: str, name: str = "") -> None:
        self._loading = None
        self.bar.setValue(0 if error else 100)
        self.said.setText(
            _tr("The grid could not be fetched: {error}").format(error=error)
            if error
            else _tr("{name} is installed: heights above this geoid can be used now.").format(name=name)
        )
        self.refresh()

    def close_down(self) -> None:
        """The plugin is unloaded: downloads are cancelled."""
        if self._loading is not None:
            self._loading.cancelDownload()
            self._loading = None
        self.close()
