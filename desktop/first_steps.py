"""The panel of the first start: sample images, a DSM of them, the tutorial."""

from __future__ import annotations

import glob
import os
from typing import Callable

from qgis.core import QgsSettings
from qgis.gui import QgisInterface
from qgis.PyQt.QtCore import QEvent, QStandardPaths, Qt
from qgis.PyQt.QtWidgets import QDialog, QGridLayout, QLabel, QPushButton

from ..processing_provider import installation
from ..repm_qgis.contracts.documents import JsonMapping
from .documents import open_document

SHOWN = "repm/first_steps_shown"
SAMPLE = "repm/sample_folder"


def show_once(show: Callable[[], object]) -> None:
    """Show the panel on the first start after the installation, and never again by itself."""
    if not QgsSettings().value(SHOWN, False, type=bool):
        QgsSettings().setValue(SHOWN, True)
        show()


def _sample_images() -> list[str]:
    folder = str(QgsSettings().value(SAMPLE, "") or "")
    return sorted(glob.glob(os.path.join(glob.escape(folder), "img_*.tif"))) if folder else []


class FirstSteps(QDialog):
    """The steps, each with one button: the DSM waits for the images; packages are a step where they are missing."""

    def __init__(self, iface: QgisInterface, install: Callable[[], object]) -> None:
        super().__init__(iface.mainWindow())
        self.setWindowTitle(self.tr("REPM: first steps"))
        self._layout = QGridLayout(self)
        self._layout.setColumnStretch(1, 1)
        self._layout.setVerticalSpacing(14)
        intro = QLabel(self.tr("From satellite images to a surface model on the map, step by step:"))
        self._layout.addWidget(intro, 0, 0, 1, 3)
        self.install = self._step(
            0,
            self.tr("<b>First, install the engine's packages.</b><br>QGIS does not ship them."),
            self.tr("Install the packages…"),
            install,
        )
        self.sample = self._step(
            1,
            self.tr("<b>Make sample images.</b><br>Three simulated images of a town, with RPCs (some 10 s, 10 MB)."),
            self.tr("Make the images…"),
            self._make_images,
        )
        self.dsm = self._step(
            2,
            self.tr("<b>Make a DSM of them.</b><br>The dialog is filled in: press Run (less than a minute)."),
            self.tr("Make the DSM…"),
            self._make_dsm,
        )
        self.tutorial = self._step(
            3,
            self.tr("<b>Read the tutorial.</b><br>From the order of images to a DSM that you can defend."),
            self.tr("Open the tutorial"),
            lambda: open_document("tutorial"),
        )
        later = QLabel(self.tr("You find these steps again in the menu Plugins > REPM."))
        self._layout.addWidget(later, 5, 0, 1, 3)
        self.refresh()

    def showEvent(self, event: QEvent) -> None:
        self.refresh()
        super().showEvent(event)

    def _step(self, number: int, text: str, button_text: str, run: Callable[[], object]) -> QPushButton:
        figure, label, button = QLabel(f"<big>{number or '!'}</big>"), QLabel(text), QPushButton(button_text)
        label.setWordWrap(True)
        label.setMinimumWidth(330)
        figure.setAlignment(Qt.AlignmentFlag.AlignTop)
        button.clicked.connect(lambda: run())
        for column, widget in enumerate((figure, label, button)):
            self._layout.addWidget(widget, number + 1, column)
        return button

    def refresh(self) -> None:
        """Enable what can be done now."""
        images = _sample_images()
        self.dsm.setEnabled(bool(images))
        self.dsm.setToolTip("" if images else self.tr("Make the sample images first."))
        missing = installation.state() != installation.FINE
        for column in range(3):
            self._layout.itemAtPosition(1, column).widget().setVisible(missing)

    def _make_images(self) -> None:
        documents = QStandardPaths.writableLocation(QStandardPaths.StandardLocation.DocumentsLocation)
        folder = str(QgsSettings().value(SAMPLE, "") or os.path.join(documents, "REPM", self.tr("sample images")))
        self._run("repm:sampledata", {"FOLDER": folder}, self._images_made)

    def _images_made(self, successful: bool, results: JsonMapping) -> None:
        if successful and results.get("FOLDER"):
            QgsSettings().setValue(SAMPLE, results["FOLDER"])
        self.refresh()

    def _make_dsm(self) -> None:
        workspace = os.path.join(os.path.dirname(str(QgsSettings().value(SAMPLE))), self.tr("sample town"))
        self._run("repm:pipeline", {"IMAGES": _sample_images(), "WORKSPACE": workspace})

    def _run(
        self, algorithm: str, parameters: dict[str, object], finished: Callable[..., object] = lambda *_: None
    ) -> None:
        """Open an algorithm's dialog with these parameters: progress, log and cancel are Processing's own."""
        import processing

        dialog = processing.createAlgorithmDialog(algorithm, parameters)
        dialog.algorithmFinished.connect(finished)
        dialog.show()
