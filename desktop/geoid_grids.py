"""Geoid grids from PROJ's content network into the folder where PROJ looks for the user's own."""

from __future__ import annotations

import importlib
import os
from types import ModuleType
from typing import NamedTuple, Optional

from qgis.core import QgsFileDownloader
from qgis.gui import QgisInterface
from qgis.PyQt.QtCore import QCoreApplication, QEvent, QUrl
from qgis.PyQt.QtWidgets import QDialog, QGridLayout, QLabel, QProgressBar, QPushButton

from ..processing_provider.language import said

ENDPOINT = "https://cdn.proj.org"  # as in PROJ, whose own variable PROJ_NETWORK_ENDPOINT takes its place here too


def _tr(text: str) -> str:
    return QCoreApplication.translate("GeoidGridsDialog", text)


class Grid(NamedTuple):
    """A file of PROJ's network, what it is for, and about how large it is, MB."""

    name: str
    use: str
    size_mb: int


def _datadir() -> ModuleType:
    """pyproj's module of PROJ's folders, whose types leave some of its functions out."""
    return importlib.import_module("pyproj.datadir")


def user_folder() -> str:
    """The folder of the user's own grids; PROJ looks there without a restart."""
    return str(_datadir().get_user_data_dir(create=True))


def is_there(name: str) -> bool:
    """Whether PROJ has a grid."""
    datadir = _datadir()
    folders = os.pathsep.join((datadir.get_data_dir(), datadir.get_user_data_dir()))
    return any(os.path.exists(os.path.join(folder, name)) for folder in folders.split(os.pathsep) if folder)


def address(name: str) -> QUrl:
    """Where a grid lies."""
    return QUrl(f"{os.environ.get('PROJ_NETWORK_ENDPOINT') or ENDPOINT}/{name}")


class GeoidGridsDialog(QDialog):
    """One line for each grid: what it is for, and a button that fetches it; QGIS's own proxy is used."""

    def __init__(self, iface: QgisInterface) -> None:
        super().__init__(iface.mainWindow())
        self.setWindowTitle(_tr("REPM: geoid grids"))
        self._loading: Optional[QgsFileDownloader] = None
        self.buttons: dict[str, QPushButton] = {}
        layout = QGridLayout(self)
        layout.setColumnStretch(0, 1)
        layout.setVerticalSpacing(12)
        intro = QLabel(
            _tr(
                "Heights above a geoid, as most maps have them, are brought to the ellipsoid with a grid. QGIS ships "
                "few of them. They are fetched from PROJ's network into your profile, and can be used at once."
            )
        )
        intro.setWordWrap(True)
        layout.addWidget(intro, 0, 0, 1, 2)
        for row, grid in enumerate(self.grids(), start=1):
            label = QLabel(f"<b>{grid.name}</b> ({grid.size_mb} MB)<br>{grid.use}")
            label.setWordWrap(True)
            label.setMinimumWidth(380)
            button = QPushButton()
            button.setAutoDefault(False)
            button.clicked.connect(lambda _=False, name=grid.name: self.fetch(name))
            layout.addWidget(label, row, 0)
            layout.addWidget(button, row, 1)
            self.buttons[grid.name] = button
        self.bar = QProgressBar()
        self.bar.setRange(0, 100)
        self.said = QLabel()
        self.said.setWordWrap(True)
        layout.addWidget(self.bar, len(self.buttons) + 1, 0, 1, 2)
        layout.addWidget(self.said, len(self.buttons) + 2, 0, 1, 2)
        self.refresh()

    @staticmethod
    def grids() -> list[Grid]:
        """The grids that DSMs and references need most."""
        return [
            Grid("us_nga_egm08_25.tif", _tr("EGM2008: Copernicus DEM, most vendors' heights above sea level"), 77),
            Grid("us_nga_egm96_15.tif", _tr("EGM96: SRTM, older products"), 3),
            Grid("us_noaa_g2018u0.tif", _tr("NAVD88 (GEOID18): lidar of the contiguous United States"), 21),
        ]

    def showEvent(self, event: QEvent) -> None:
        self.refresh()
        super().showEvent(event)

    def refresh(self) -> None:
        """Show for each grid whether it is installed."""
        for name, button in self.buttons.items():
            there = is_there(name)
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
        self._say(_tr("Fetching {name}…").format(name=name))
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

    def _say(self, text: str) -> None:
        """Show a sentence; the window grows for its lines, which would take those of the grids."""
        self.said.setText(text)
        self.resize(self.width(), max(self.height(), self.layout().totalHeightForWidth(self.width())))

    def _ended(self, error: str, name: str = "") -> None:
        self._loading = None
        self.bar.setValue(0 if error else 100)
        self._say(
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
