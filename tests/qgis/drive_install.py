"""Runs inside a real QGIS desktop: the offer, the dialog that installs the engine's packages, cancel and removal."""

import os
import sys
import time

from qgis.core import QgsSettings
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QApplication, QMessageBox, QPushButton
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture, window  # noqa: E402

FOUND["name"] = "install"
TICKS = []


def module():
    return sys.modules["repm.processing_provider.installation"]


@guarded
def look_at_the_offer():
    from processing.core.ProcessingConfig import ProcessingConfig

    # What the desktop found at its start, without the tests' own interpreter.
    FOUND["algorithms"] = len(plugins["repm"].provider.algorithms())
    bar = iface.messageBar()
    buttons = [button for button in bar.findChildren(QPushButton) if "nstall" in button.text()]
    FOUND["offered"] = [button.text() for button in buttons]
    FOUND["state"] = module().state()
    FOUND["interpreter"] = ProcessingConfig.getSetting("REPM_ENGINE_PYTHON") or ""
    if not buttons:
        finish()
    picture(iface.mainWindow(), "offer.png")
    buttons[0].click()
    QTimer.singleShot(1500, install)


@guarded
def install():
    dialog = window("InstallDialog")
    FOUND["where"] = dialog.where.text()
    FOUND["packages"] = [
        dialog.packages.topLevelItem(row).text(0) for row in range(dialog.packages.topLevelItemCount())
    ]
    FOUND["proxy"] = dialog.proxy.text()
    QApplication.processEvents()
    picture(dialog, "dialog.png")
    if PLAN.get("wheels"):
        dialog.wheels.setFilePath(PLAN["wheels"])
    FOUND["where then"] = dialog.where.text()
    dialog.install.click()
    FOUND["enabled while running"] = [dialog.install.isEnabled(), dialog.cancel.isEnabled()]
    # QGIS stays alive: its event loop runs every 50 ms.
    timer = QTimer(dialog)
    timer.timeout.connect(lambda: TICKS.append(time.monotonic()))
    timer.start(50)
    QTimer.singleShot(600, lambda: watch(dialog, bool(PLAN.get("cancel"))))


def watch(dialog, cancel):
    if cancel and "asking for versions" in dialog.log.toPlainText():
        FOUND["cancelled at"] = time.monotonic()
        dialog.cancel.click()
        cancel = False
    if dialog._task is not None:
        if 0 < dialog.bar.value() < 100 and "picture" not in FOUND:
            FOUND["picture"] = picture(dialog, "running.png")
        QTimer.singleShot(50, lambda: watch(dialog, cancel))
        return
    FOUND["longest pause"] = max((b - a for a, b in zip(TICKS, TICKS[1:])), default=0.0)
    FOUND["ended"] = dialog.doing.text()
    FOUND["cancel seconds"] = time.monotonic() - FOUND.get("cancelled at", time.monotonic())
    FOUND["log"] = dialog.log.toPlainText()
    FOUND["state then"] = module().state()
    FOUND["folders"] = module().folders()
    picture(dialog, "installed.png")
    if FOUND["folders"]:
        QTimer.singleShot(300, lambda: remove(dialog))
    else:
        finish()


@guarded
def remove(dialog):
    # Here and not at once: Qt deletes what was taken off the message bar when it comes back to its event loop.
    FOUND["offered still"] = any("nstall" in each.text() for each in iface.messageBar().findChildren(QPushButton))
    QTimer.singleShot(500, lambda: QApplication.activeModalWidget().button(QMessageBox.StandardButton.Yes).click())
    dialog.remove.click()
    FOUND["left"] = module().folders()
    FOUND["home"] = os.path.exists(os.path.dirname(FOUND["folders"][0]))
    FOUND["state at the end"] = module().state()
    FOUND["offered before"] = bool(QgsSettings().value("repm/install_offered", ""))
    finish()


begin(look_at_the_offer)
