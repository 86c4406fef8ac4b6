"""Runs inside a real QGIS desktop: geoid grids by a button, a batch run with reports, what the log says of loading."""

import os
import sys

from qgis.core import QgsApplication
from qgis.PyQt import sip
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QApplication, QLabel
from qgis.utils import iface, loadPlugin, plugins, startPlugin, unloadPlugin

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture  # noqa: E402

FOUND.update(name="helpers", log=[])


@guarded
def load_again():
    QgsApplication.messageLog().messageReceived.connect(lambda text, tag, level: FOUND["log"].append(text))
    unloadPlugin("repm")
    loadPlugin("repm")
    startPlugin("repm")
    QTimer.singleShot(1500, look_at_windows)


@guarded
def look_at_windows():
    menu = plugins["repm"].menu
    menu.first_steps()
    menu.install()
    QApplication.processEvents()
    installer = menu._installer
    FOUND["default"] = [installer.install.isDefault(), installer.close_button.isDefault()]
    picture(menu._panel, "first_steps.png")
    picture(installer, "install.png")
    menu._panel.close()
    installer.close()
    dialog = menu.geoid_grids()
    dialog.other.setText("EPSG:5709")
    dialog.look_up.click()
    FOUND["looked up"] = dialog.said.text()
    dialog.other.setText("EPSG:4326")
    dialog.look_up.click()
    FOUND["no datum"] = dialog.said.text()
    FOUND["grids"] = {name: button.text() for name, button in dialog.buttons.items()}
    dialog.buttons["us_nga_egm08_25.tif"].click()
    QTimer.singleShot(3000, lambda: look_at_grids(dialog))


@guarded
def look_at_grids(dialog):
    FOUND["said"] = dialog.said.text()
    FOUND["fetched"] = {name: button.text() for name, button in dialog.buttons.items()}
    picture(dialog, "grids.png")
    dialog.buttons["us_nga_egm96_15.tif"].click()
    QTimer.singleShot(2500, lambda: run_batch(dialog))


@guarded
def run_batch(dialog):
    FOUND["failed"] = dialog.said.text()
    labels = [label for label in dialog.findChildren(QLabel) if label.text()]
    FOUND["cut"] = [label.text() for label in labels if label.height() < label.heightForWidth(label.width())]
    picture(dialog, "failed.png")
    FOUND["parts"] = [name for name in os.listdir(PLAN["folder_of_grids"]) if name.endswith(".part")]
    dialog.close()
    from processing.core.ProcessingResults import resultsList
    from processing.gui.BatchAlgorithmDialog import BatchAlgorithmDialog

    algorithm = QgsApplication.processingRegistry().createAlgorithmById("repm:inspect")
    batch = BatchAlgorithmDialog(algorithm, iface.mainWindow())
    rows, panel = PLAN["rows"], batch.mainWidget()
    panel.batchRowCount = lambda: len(rows)
    panel.parametersForRow = lambda row, *_, **__: (rows[row], True)
    batch.show()  # QGIS 3.44 lets go of one that nobody sees as soon as its first row is done, and shows no pages
    batch.runAlgorithm()
    look_at_pages(batch, resultsList)


@guarded
def look_at_pages(batch, results, more=20):
    """QGIS 3.22 comes back when all rows are done; later versions run them from the event loop."""
    FOUND["pages"] = [each.filename for each in results.getResults()]
    if len(FOUND["pages"]) < len(PLAN["rows"]) and more:
        QTimer.singleShot(1000, lambda: look_at_pages(batch, results, more - 1))
        return
    if not sip.isdeleted(batch):  # QGIS 3.40 may have let it go when its rows were done
        batch.close()
    finish()


begin(load_again)
