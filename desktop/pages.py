"""The documents of docs/ in a window of QGIS, with their pictures: they need no browser and no network."""

from __future__ import annotations

import os
from typing import Any, Callable

from qgis.PyQt.QtCore import Qt, QUrl
from qgis.PyQt.QtGui import QImage, QTextDocument
from qgis.PyQt.QtWidgets import QDialog, QHBoxLayout, QPushButton, QTextBrowser, QVBoxLayout

from ..processing_provider.engine import PLUGIN_FOLDER

_MARGIN_PX = 40  # of the text, and the scroll bar


class _Browser(QTextBrowser):
    """A browser of Markdown files whose pictures are no wider than the window."""

    def loadResource(self, kind: int, name: QUrl) -> Any:
        if kind != QTextDocument.ResourceType.ImageResource:
            return super().loadResource(kind, name)
        image = QImage(self.source().resolved(name).toLocalFile())
        width = max(200, self.viewport().width() - _MARGIN_PX)
        if image.width() <= width:
            return image
        return image.scaledToWidth(width, Qt.TransformationMode.SmoothTransformation)


class Page(QDialog):
    """Shows one document; links between documents are followed, links to the web open in the system's browser."""

    def __init__(self, iface: Any, show: Callable[..., Any]) -> None:
        super().__init__(iface.mainWindow())
        self.setWindowTitle(self.tr("REPM: documents"))
        self.resize(900, 760)
        self.browser = _Browser(self)
        self.browser.setOpenExternalLinks(True)
        back, contents, close = (QPushButton(text) for text in (self.tr("Back"), self.tr("Contents"), self.tr("Close")))
        back.setEnabled(False)
        self.browser.backwardAvailable.connect(back.setEnabled)
        back.clicked.connect(self.browser.backward)
        contents.clicked.connect(lambda: self.open("README.md"))
        close.clicked.connect(self.close)
        buttons = QHBoxLayout()
        for button in (back, contents):
            button.setAutoDefault(False)
            buttons.addWidget(button)
        buttons.addStretch()
        buttons.addWidget(close)
        layout = QVBoxLayout(self)
        layout.addWidget(self.browser)
        layout.addLayout(buttons)

    def open(self, name: str) -> None:
        """Show a document of docs/ by its file's name."""
        self.browser.setSource(QUrl.fromLocalFile(os.path.join(PLUGIN_FOLDER, "docs", name)))
