"""The documents of docs/ in the system's browser."""

from __future__ import annotations

from qgis.core import QgsApplication
from qgis.PyQt.QtCore import QUrl
from qgis.PyQt.QtGui import QDesktopServices


def open_document(name: str) -> None:
    """Show a document of docs/ by its name; where the profile cannot be written, the document as it is stored."""
    from ..processing_provider import helppages
    from ..processing_provider.engine import PLUGIN_FOLDER
    from ..repm_qgis.contracts.errors import WorkspaceError

    try:
        for algorithm in QgsApplication.processingRegistry().providerById("repm").algorithms():
            algorithm.helpUrl()  # writes its page, to which documents lead
        address = helppages.document(name, QgsApplication.locale() or "en")
    except WorkspaceError:
        address = QUrl.fromLocalFile(f"{PLUGIN_FOLDER}/docs/{name}.md").toString()
    QDesktopServices.openUrl(QUrl(address))
