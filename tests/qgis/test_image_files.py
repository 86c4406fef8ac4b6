"""What the list of images offers: files to add one by one, and those that a folder gives."""

import pytest
from qgis.core import QgsFileUtils
from qgis.gui import QgsProcessingMultipleInputPanelWidget
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QApplication, QFileDialog, QPushButton


@pytest.fixture
def panel(plugin, monkeypatch):
    """The panel that opens behind the "..." of the images."""
    algorithm = next(a for a in plugin.provider.algorithms() if a.name() == "pipeline").create()
    widget = QgsProcessingMultipleInputPanelWidget(algorithm.parameterDefinition("IMAGES"), [], [])
    widget.kept = algorithm
    return widget


def filters_of(panel, seen):
    """The filters of the dialog that *Add File(s)...* opens; it is closed at once."""

    def look():
        for dialog in QApplication.topLevelWidgets():
            if isinstance(dialog, QFileDialog):
                seen.extend(dialog.nameFilters())
                dialog.reject()

    button = next(b for b in panel.findChildren(QPushButton) if b.text().startswith("Add File"))
    QTimer.singleShot(300, look)
    button.click()
    return seen


def test_products_archives_and_items_can_be_added(panel):
    first, *others = filters_of(panel, [])
    for pattern in ("*.tif", "*.JP2", "*TIL", "DIM*XML", "*zip", "*json"):
        assert pattern in first, pattern
    assert any(name.endswith("(*)") for name in others)


def test_a_folder_adds_images_only(panel):
    """QGIS adds all files of a folder with endings of the filter: sidecar files in XML and JSON are no images."""
    definition = panel.kept.parameterDefinition("IMAGES")
    endings = {end.lower() for end in QgsFileUtils.extensionsFromFilter(definition.createFileFilter())}
    assert endings == {"tif", "tiff", "jp2", "ntf", "nitf"}
