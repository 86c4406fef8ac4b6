"""The dialog that installs the engine's packages: packages, source, size, progress, cancel, log."""

from __future__ import annotations

import os
from typing import Callable, Optional

from qgis.core import Qgis, QgsApplication, QgsProcessingException, QgsProcessingFeedback, QgsSettings, QgsTask
from qgis.gui import QgisInterface, QgsFileWidget
from qgis.PyQt.QtCore import QCoreApplication, QEvent, Qt, QUrl, pyqtSignal
from qgis.PyQt.QtGui import QDesktopServices
from qgis.PyQt.QtWidgets import (
    QDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QMessageBox,
    QPlainTextEdit,
    QProgressBar,
    QPushButton,
    QTreeWidget,
    QTreeWidgetItem,
    QVBoxLayout,
)

from ..processing_provider import installation, settings
from ..processing_provider.language import said as said_here

OFFERED = "repm/install_offered"


def _tr(text: str) -> str:
    return QCoreApplication.translate("RepmInstall", text)


def offer_once(iface: QgisInterface, install: Callable[[], object]) -> object:
    """Say in the message bar that packages are missing, or are those of an earlier version: once for each of these.

    Gives the message, None where there is none.
    """
    state = installation.state()
    said = {
        installation.MISSING: _tr("Python packages that REPM needs are missing."),
        installation.EARLIER: _tr("REPM now needs other Python packages than before."),
    }.get(state)
    known = f"{state} {installation.requirements_hash()}"
    if said is None or QgsSettings().value(OFFERED, "") == known:
        return None
    QgsSettings().setValue(OFFERED, known)
    message = iface.messageBar().createMessage("REPM", said)
    button = QPushButton(_tr("Install the packages…"), message)
    button.clicked.connect(lambda: install())
    message.layout().addWidget(button)
    return iface.messageBar().pushWidget(message, Qgis.MessageLevel.Info, 0)


class _Feedback(QgsProcessingFeedback):
    """The messages of the engine's process as signals: they are read in a separate thread."""

    said = pyqtSignal(str)
    doing = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__(False)

    def pushInfo(self, info: str) -> None:
        self.said.emit(info)

    def pushWarning(self, warning: str) -> None:
        self.said.emit(warning)

    def pushDebugInfo(self, info: str) -> None:
        self.said.emit(info)

    def setProgressText(self, text: str) -> None:
        self.doing.emit(text)


class _Task(QgsTask):
    """The installation in the background: QGIS stays alive, and its task manager shows and cancels it too."""

    def __init__(self, title: str, wheels: str, proxy: str, done: Callable[[str], object]) -> None:
        super().__init__(title, QgsTask.Flag.CanCancel)
        self.feedback = _Feedback()
        self.feedback.progressChanged.connect(self.setProgress)
        self._wheels, self._proxy, self._done, self._error = wheels, proxy, done, ""

    def run(self) -> bool:
        try:
            installation.install(self._wheels, self._proxy, self.feedback)
        except QgsProcessingException as error:
            self._error = str(error)
            return False
        except Exception as error:  # noqa: BLE001 - a bug must not end QGIS's thread in silence
            self._error = f"{type(error).__name__}: {error}"
            return False
        return True

    def cancel(self) -> None:
        self.feedback.cancel()
        super().cancel()

    def forget(self) -> None:
        self.feedback.disconnect()
        self._done = lambda error: None

    def finished(self, successful: bool) -> None:
        self._done("" if successful else self._error or _tr("The installation was cancelled."))


def _introduction() -> str:
    """What the dialog begins with: whether something has to be done."""
    chosen = settings.engine_python()
    if chosen:
        return _tr(
            "You have chosen {python} as the engine's interpreter; its packages are not checked here. To use the "
            "packages of this dialog, clear it in Settings > Options > Processing > Providers > REPM (or the variable "
            "REPM_ENGINE_PYTHON)."
        ).format(python=chosen)
    return {
        installation.FINE: _tr("The engine has all packages that it needs. Nothing has to be done."),
        installation.MISSING: _tr(
            "REPM's engine needs these packages, which QGIS does not ship. They get an environment of their "
            "own in your profile: QGIS itself is not changed, and an update of REPM finds them again."
        ),
        installation.EARLIER: _tr("This version of REPM needs other packages than the earlier one: install again."),
    }[installation.state()]


class InstallDialog(QDialog):
    """Makes or renews the engine's environment in the profile, or removes it."""

    changed = pyqtSignal()

    def __init__(self, iface: QgisInterface) -> None:
        super().__init__(iface.mainWindow())
        self._task: Optional[_Task] = None
        self.setWindowTitle(_tr("REPM: install the engine's packages"))
        self.resize(800, 620)
        self.intro = QLabel()
        self.intro.setWordWrap(True)
        self.packages = QTreeWidget()
        self.packages.setRootIsDecorated(False)
        self.packages.setHeaderLabels([_tr("Package"), _tr("For"), _tr("Download (MB)"), _tr("Disk (MB)")])
        self.packages.setMaximumHeight(130)
        self.where = QLabel()
        self.where.setWordWrap(True)
        self.where.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.wheels = QgsFileWidget()
        self.wheels.setStorageMode(QgsFileWidget.StorageMode.GetDirectory)
        self.wheels.lineEdit().setPlaceholderText(_tr("empty: from the Python Package Index"))
        self.wheels.fileChanged.connect(lambda _: self._plan())
        self.proxy = QLineEdit(installation.proxy())
        self.proxy.setEchoMode(QLineEdit.EchoMode.PasswordEchoOnEdit)
        self.proxy.setPlaceholderText("http://host:port")
        form = QFormLayout()
        form.addRow(_tr("Proxy (empty: none, or the system's)"), self.proxy)
        form.addRow(_tr("Folder of wheels (without a network)"), self.wheels)
        self.bar = QProgressBar()
        self.bar.setRange(0, 100)
        self.doing = QLabel()
        self.doing.setWordWrap(True)
        self.log = QPlainTextEdit()
        self.log.setReadOnly(True)
        self.install = self._button(_tr("Install"), self._install)
        self.cancel = self._button(_tr("Cancel"), self._cancel)
        self.remove = self._button(_tr("Remove the environment"), self._remove)
        self.open_log = self._button(_tr("Open the log"), self._open_log)
        self.close_button = self._button(_tr("Close"), self.close)
        buttons = QHBoxLayout()
        for button in (self.remove, self.open_log):
            buttons.addWidget(button)
        buttons.addStretch()
        for button in (self.install, self.cancel, self.close_button):
            buttons.addWidget(button)
        layout = QVBoxLayout(self)
        for widget in (self.intro, self.packages, self.where):
            layout.addWidget(widget)
        layout.addLayout(form)
        for widget in (self.bar, self.doing, self.log):
            layout.addWidget(widget)
        layout.addLayout(buttons)

    def _button(self, text: str, run: Callable[[], object]) -> QPushButton:
        button = QPushButton(text)
        button.setAutoDefault(False)
        button.clicked.connect(lambda: run())
        return button

    def showEvent(self, event: QEvent) -> None:
        if self._task is None:
            self._plan()
        super().showEvent(event)

    def _plan(self) -> None:
        """Show the size of an installation, as the fields are now."""
        self.intro.setText(_introduction())
        self.packages.clear()
        try:
            plan = installation.plan(self.wheels.filePath())
        except QgsProcessingException as error:
            self.where.setText(str(error))
            self._show_state(possible=False)
            return
        for name, purpose, download, disk in plan.rows():
            sizes = [f"{size:.1f}" if size else "?" for size in (download, disk)]
            self.packages.addTopLevelItem(QTreeWidgetItem([name, said_here(purpose), *sizes]))
        for column in range(4):
            self.packages.resizeColumnToContents(column)
        free = plan.free_mb
        self.where.setText(
            _tr(
                "To download: about {download:.0f} MB. On the disk: about {disk:.0f} MB in {folder} ({free} MB are "
                "free there). Python: {python}"
            ).format(
                download=plan.download_mb,
                disk=plan.disk_mb,
                folder=plan.folder,
                free="?" if free is None else f"{free:.0f}",
                python=plan.program,
            )
        )
        self._show_state()

    def _show_state(self, possible: bool = True) -> None:
        running = self._task is not None
        fine = installation.state() == installation.FINE
        self.install.setEnabled(possible and not running)
        self.install.setDefault(not fine)
        self.close_button.setDefault(fine)  # Enter should continue now
        self.cancel.setEnabled(running)
        self.remove.setEnabled(not running and bool(installation.folders()))
        self.open_log.setEnabled(os.path.exists(installation.log_path()))
        for field in (self.wheels, self.proxy):
            field.setEnabled(not running)

    def _install(self) -> None:
        self.log.clear()
        self.bar.setValue(0)
        self._task = _Task(
            _tr("Install REPM's packages"), self.wheels.filePath(), self.proxy.text().strip(), self._ended
        )
        self._task.feedback.said.connect(self.log.appendPlainText)
        self._task.feedback.doing.connect(self._say)
        self._task.feedback.progressChanged.connect(lambda percent: self.bar.setValue(int(percent)))
        QgsApplication.taskManager().addTask(self._task)
        self._show_state()

    def _say(self, text: str) -> None:
        self.doing.setText(text)
        self.log.appendPlainText(text)

    def close_down(self) -> None:
        """The plugin is unloaded: a running installation is cancelled, and sends nothing to this dialog any more."""
        if self._task is not None:
            self._task.forget()
            self._task.cancel()
        self.close()

    def _cancel(self) -> None:
        if self._task is not None:
            self.doing.setText(_tr("Cancelling…"))
            self._task.cancel()

    def _ended(self, error: str) -> None:
        self._task = None
        self._plan()
        if error:
            self.bar.setValue(0)
        self.changed.emit()
        self._say(error or _tr("The packages are installed: every algorithm of REPM can run now."))

    def _remove(self) -> None:
        sure = QMessageBox.question(
            self,
            self.windowTitle(),
            _tr("Remove the engine's environment? Do this before you uninstall REPM; it can be installed again."),
        )
        if sure != QMessageBox.StandardButton.Yes:
            return
        feedback = _Feedback()
        feedback.said.connect(self._say)
        try:
            installation.remove(feedback)
        except QgsProcessingException as error:
            self._say(str(error))
        self.changed.emit()
        self._plan()

    def _open_log(self) -> None:
        QDesktopServices.openUrl(QUrl.fromLocalFile(installation.log_path()))
