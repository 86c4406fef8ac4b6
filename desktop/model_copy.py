"""The toolbox's menu entry that copies our model to the user's models: QGIS edits no model of a provider."""

from __future__ import annotations

import os

from processing.gui.ContextAction import ContextAction
from processing.gui.ProviderActions import ProviderContextMenuActions
from processing.modeler.ModelerDialog import ModelerDialog
from processing.modeler.ModelerUtils import ModelerUtils
from qgis.core import QgsApplication, QgsProcessingModelAlgorithm
from qgis.PyQt.QtCore import QCoreApplication
from qgis.PyQt.QtWidgets import QMessageBox


def _tr(text: str) -> str:
    return QCoreApplication.translate("RepmModelCopy", text)


class CopyModel(ContextAction):
    """Copies the model under the mouse into the user's models, and opens the copy in the graphical modeler."""

    def __init__(self) -> None:
        super().__init__()
        self.name = _tr("Copy to my models and edit…")

    def isEnabled(self) -> bool:
        algorithm = self.itemData
        return isinstance(algorithm, QgsProcessingModelAlgorithm) and algorithm.provider().id() == "repm"

    def execute(self) -> None:
        try:
            dialog = ModelerDialog.create(copied(self.itemData))
        except OSError as error:
            QMessageBox.warning(self.toolbox, self.name, str(error))
            return
        dialog.update_model.connect(_refresh)
        _refresh()
        dialog.show()
        dialog.activate()


def copied(model: QgsProcessingModelAlgorithm) -> QgsProcessingModelAlgorithm:
    """A copy of a model in the user's folder of models, which replaces no file; raises OSError where it fails."""
    folder = ModelerUtils.modelsFolders()[0]
    os.makedirs(folder, exist_ok=True)
    title, number = model.name(), 1
    while os.path.exists(os.path.join(folder, f"{title}.model3")):
        number += 1
        title = f"{model.name()}_{number}"
    path = os.path.join(folder, f"{title}.model3")
    copy = QgsProcessingModelAlgorithm()
    copy.loadVariant(model.toVariant())
    copy.setName(title)
    copy.setSourceFilePath(path)
    # QGIS ends with a segmentation fault when the designer runs a model that belongs to no provider.
    copy.setProvider(QgsApplication.processingRegistry().providerById("model"))
    if not copy.toFile(path):
        raise OSError(_tr("The model cannot be written to '{path}': check that you may write there.").format(path=path))
    return copy


def _refresh() -> None:
    QgsApplication.processingRegistry().providerById("model").refreshAlgorithms()


def register() -> list[ContextAction]:
    """Add the entry to the toolbox's menu; gives what :func:`unregister` takes."""
    actions = [CopyModel()]
    ProviderContextMenuActions.registerProviderContextMenuActions(actions)
    return actions


def unregister(actions: list[ContextAction]) -> None:
    ProviderContextMenuActions.deregisterProviderContextMenuActions(actions)
