"""The preview of a DSM in its dialog: a button, and what is taken over from it into the run of the DSM."""

from __future__ import annotations

from typing import Callable

from qgis.core import QgsProcessing, QgsProcessingOutputLayerDefinition, QgsProject
from qgis.PyQt.QtCore import QCoreApplication, QMetaObject
from qgis.PyQt.QtWidgets import QDialogButtonBox, QPushButton, QWidget

from ..repm_qgis.contracts.documents import JsonMapping
from ..repm_qgis.contracts.options import PRESETS, PREVIEW

PREVIEWED = "pipeline"
_SHARED = (
    *("IMAGES", "RPCS", "MASKS", "ORTHO_READY_HEIGHT", "DEM", "CRS", "VERTICAL_DATUM"),
    *("ALTITUDE_MIN", "ALTITUDE_MAX", "CLUSTER", "WORKSPACE"),
)
"""The parameters of a DSM that its preview has, too: what is read, and where it goes."""


def _tr(text: str) -> str:
    return QCoreApplication.translate("RepmPreview", text)


def preview_button(dialog: QWidget, run: Callable[[], None]) -> QPushButton:
    """A button beside those of Processing's dialog."""
    button = QPushButton(_tr("Preview"))
    button.setObjectName("preview")
    button.setToolTip(_tr("Show all the ground of these images at 8 times their ground sampling distance, in seconds"))
    button.clicked.connect(lambda *_: run())
    dialog.buttonBox().addButton(button, QDialogButtonBox.ButtonRole.ResetRole)  # which is at the left
    return button


def of_preview(parameters: JsonMapping) -> dict[str, object]:
    """The parameters of the preview of a run: its DSM alone, of all that the images show."""
    shown = QgsProcessingOutputLayerDefinition(QgsProcessing.TEMPORARY_OUTPUT, QgsProject.instance())
    shared = {name: parameters[name] for name in _SHARED if name in parameters}
    return {**shared, "PRESET": PREVIEW, "OUTPUT": shown, "TILES": None, "TIE_POINTS": None, "REPORT": None}


def taken_over(given: JsonMapping, results: JsonMapping) -> dict[str, object]:
    """The parameters of the DSM's run, after its preview: those ``given`` to the dialog, with the images that matched
    and the altitudes that the preview shows."""
    kept = dict(given)
    if kept.get("PRESET") == PREVIEW:  # it was chosen in the list, which filled its values in
        values = {"PRESET": PREVIEW, **{name.upper(): value for name, value in PRESETS[PREVIEW].items()}}
        kept = {name: value for name, value in kept.items() if name not in values or values[name] != value}
    if results.get("MATCHED_IMAGES") and not (kept.get("RPCS") or kept.get("MASKS")):  # which are in their order
        kept["IMAGES"] = list(results["MATCHED_IMAGES"])
    for name, end in (("ALTITUDE_MIN", "LOWEST"), ("ALTITUDE_MAX", "HIGHEST")):
        if results.get(end) is not None:
            kept[name] = round(float(results[end]), 1)
    return kept


def draw_area(dialog: QWidget) -> None:
    """Have the user draw a dialog's area on the map."""
    for widget in dialog.findChildren(QWidget):
        if widget.metaObject().className() == "QgsExtentWidget":  # which is a plain widget to Python in QGIS 3.22
            QMetaObject.invokeMethod(widget, "setOutputExtentFromDrawOnCanvas")
            return
