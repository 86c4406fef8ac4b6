"""After a run: a message with a button for the next step, whose dialog is filled in.

The path is *inspect, run, compare, register, run again, compare again, edit*: from the first DSM to one in the right
place, with its errors edited.
"""

from __future__ import annotations

import math
import os
from functools import partial
from typing import Callable, Mapping, Optional

from qgis.core import (
    Qgis,
    QgsLayerTreeNode,
    QgsMapLayer,
    QgsProcessing,
    QgsProcessingContext,
    QgsProject,
    QgsRasterLayer,
    QgsVectorLayer,
)
from qgis.gui import QgisInterface, QgsMessageBar, QgsMessageBarItem
from qgis.PyQt.QtCore import QCoreApplication, QSizeF, Qt
from qgis.PyQt.QtWidgets import QPushButton, QSizePolicy, QTextBrowser, QWidget

from ..processing_provider import last_scene
from ..processing_provider.kept import is_lasting
from ..processing_provider.language import said
from ..processing_provider.values import any_paths, is_empty, layer_path
from ..repm_qgis.contracts.documents import JsonMapping, JsonObject
from ..repm_qgis.contracts.options import DsmFuseOptions
from ..repm_qgis.contracts.paths import real_path
from ..repm_qgis.contracts.products import STYLES, products_of
from ..repm_qgis.scene import is_registered
from .preview import draw_area, taken_over

_LEAST_TEXT = 120  # px of a message beside its buttons
_PATH = ("inspect", "pipeline", "dsmfuse", "comparedsm", "register")
Button = tuple[str, Callable[[], object]]
Step = tuple[str, list[Button], list[Button]]
"""A message, its buttons, and those that show something first."""


def _tr(text: str) -> str:
    return QCoreApplication.translate("RepmNextStep", text)


class NextSteps:
    """Leads from one step to the next; one for a session, which knows the reference and the fusion that were used."""

    def __init__(self) -> None:
        self._reference: list[str] = []
        self._fused: dict[str, tuple[JsonObject, dict[str, str]]] = {}
        """How the DSM of a scene, by its folder, was made: parameters, and products."""
        self._given: JsonMapping = {}
        self._iface: QgisInterface = None
        self._bar: Optional[QgsMessageBar] = None
        self._shown: Optional[QgsMessageBarItem] = None
        self.edit_dsm: Optional[Callable[[], object]] = None
        """Shows the panel that edits the active layer; the menu, which has it, puts it here."""
        self.followers: list[Callable[[], object]] = []
        """Called when a run of ours has ended well."""

    def after(
        self, iface: QgisInterface, algorithm: str, given: JsonMapping, results: JsonMapping
    ) -> tuple[str, list[Button]]:
        """Show in QGIS's message bar what can be done after a run; gives the text and the buttons that open dialogs."""
        for follow in self.followers:
            follow()
        if algorithm not in _PATH:
            return "", []
        named = {name: _paths(given.get(name)) for name in ("DSM", "SCENE", "REFERENCE")}
        self._reference = named["REFERENCE"] or self._reference
        self._given = given
        scene = results.get("SCENE") if algorithm == "pipeline" else next(iter(named["SCENE"]), None)
        if algorithm in ("pipeline", "dsmfuse") and scene and not results.get("OVERLAPS"):
            inputs = {name: given[name] for name in _fusion_inputs() if not is_empty(given.get(name))}
            names = (each.option.upper() for each in products_of("dsmfuse"))
            made = {name: str(results[name]) for name in names if is_lasting(os.path.dirname(results.get(name) or ""))}
            self._fused[os.path.dirname(scene)] = inputs, made
        self._iface = iface
        text, buttons, views = getattr(self, f"_after_{algorithm}")(named, results)
        if text:  # one message at a time: the step before is finished
            self.forget()
            self._bar, self._shown = iface.messageBar(), push_message(iface.messageBar(), text, [*views, *buttons])
        return text, buttons

    def _after_inspect(self, named: Mapping[str, list[str]], results: JsonMapping) -> Step:
        titles = {"PAIR": _tr("DSM of the best pair…"), "TRIPLET": _tr("DSM of the best triplet…")}
        best = {title: results[name] for name, title in titles.items() if results.get(name)}
        buttons: list[Button] = [(title, partial(self.make, images)) for title, images in best.items()]
        return _tr("The images are inspected.") if buttons else "", buttons, []

    def _after_pipeline(self, named: Mapping[str, list[str]], results: JsonMapping) -> Step:
        if results.get("OVERLAPS"):
            return self._after_preview(results)
        return self._of_a_dsm(results.get("SCENE"), results.get("OUTPUT"))

    def _after_preview(self, results: JsonMapping) -> Step:
        """The DSM with what a preview shows: its altitudes, and the images that matched."""
        given = taken_over(self._given, results)
        text = _tr("The preview is on the map.")
        if "LOWEST" in results:
            text = _tr("The preview is on the map: altitudes {low} to {high} m for the DSM.")
            text = text.format(low=f"{results['LOWEST']:.0f}", high=f"{results['HIGHEST']:.0f}")
        draw = (_tr("Draw the area on it…"), lambda: draw_area(self.open("pipeline", given)))
        return text, [draw, (_tr("Make the DSM…"), lambda: self.open("pipeline", given))], []

    def _after_dsmfuse(self, named: Mapping[str, list[str]], results: JsonMapping) -> Step:
        return self._of_a_dsm(next(iter(named["SCENE"]), None), results.get("OUTPUT"))

    def _of_a_dsm(self, scene: Optional[str], dsm: Optional[str]) -> Step:
        text = _tr("Is the DSM in the right place?")
        if scene and is_registered(scene):  # in a run of its own, or in the same run
            text = _tr("Is the DSM in the right place now?")
        return text, self._measuring(scene, dsm), []

    def _after_comparedsm(self, named: Mapping[str, list[str]], results: JsonMapping) -> Step:
        dsm = next(iter(named["DSM"]), "")
        scene = last_scene.of_surface(dsm)
        if not scene or is_registered(scene):
            edit = self._editing(dsm) if scene else []
            return _tr("Is the DSM wrong somewhere? Edit it.") if edit else "", edit, []
        text = _tr("Is the DSM off by too much? Register its scene.")
        return text, [(_tr("Register to this reference…"), lambda: self.register(scene))], []

    def _after_register(self, named: Mapping[str, list[str]], results: JsonMapping) -> Step:
        scene = results.get("OUTPUT_SCENE")
        moved = math.sqrt(sum(float(results.get(name) or 0.0) ** 2 for name in ("EAST", "NORTH", "UP")))
        text = _tr("The scene was moved by {distance} m.")
        views: list[Button] = []
        layer = layer_of(results.get("DIFFERENCES"))
        if layer is not None:
            bring_out(layer.id())
            views = [
                (_tr("Before"), lambda: _show_view(layer.id(), "differences_before")),
                (_tr("After"), lambda: _show_view(layer.id(), "")),
            ]
        again = (_tr("Make the DSM again…"), lambda: self.fuse(str(scene)))
        return text.format(distance=f"{moved:.2f}"), [again] if scene else [], views

    def _measuring(self, scene: Optional[str], dsm: Optional[str]) -> list[Button]:
        buttons: list[Button] = []
        if dsm:
            buttons.append((_tr("Compare with a reference…"), lambda: self.compare(str(dsm))))
        if scene and not is_registered(scene):
            buttons.append((_tr("Register to a reference…"), lambda: self.register(str(scene))))
        elif dsm and scene:
            buttons += self._editing(dsm)
        return buttons

    def _editing(self, dsm: str) -> list[Button]:
        """The last step; none where the DSM is not on the map."""
        layer = layer_of(dsm)
        return [(_tr("Edit the DSM…"), lambda: self.edit(layer.id()))] if layer is not None and self.edit_dsm else []

    # --- the dialogs ---

    def make(self, images: list[str]) -> None:
        self.open("pipeline", {"IMAGES": images})

    def compare(self, dsm: str) -> None:
        layer = layer_of(dsm)
        given: JsonObject = {"DSM": dsm if layer is None else layer.id()}
        if self._reference:
            given["REFERENCE"] = self._reference[0]
        self.open("comparedsm", given)

    def register(self, scene: str) -> None:
        given: JsonObject = {"SCENE": scene}
        if self._reference:  # as layers that QGIS does not open: it drops what it cannot, such as clouds
            given["REFERENCE"] = [QgsVectorLayer(path, "", "none") for path in self._reference]
        if is_lasting(os.path.dirname(scene)):
            given["OUTPUT_SCENE"] = free_path(os.path.join(os.path.dirname(scene), "registered.json"))
        self.open("register", given)

    def fuse(self, scene: str) -> None:
        """As the DSM was made before, with all its products, of the registered scene."""
        folder = os.path.dirname(scene)
        inputs, made = self._fused.get(folder, ({}, {}))
        given: JsonObject = {**inputs, "SCENE": scene}
        for name, path in {"OUTPUT": os.path.join(folder, "dsm.tif"), **made}.items():
            if is_lasting(os.path.dirname(path)):
                given[name] = free_path("_registered".join(os.path.splitext(path)))
        self.open("dsmfuse", given)

    def edit(self, layer_id: str) -> None:
        layer = QgsProject.instance().mapLayer(layer_id)
        if layer is not None and self.edit_dsm is not None:
            self.forget()
            self._iface.setActiveLayer(layer)
            bring_out(layer_id)
            self.edit_dsm()

    def open(self, algorithm: str, given: JsonMapping) -> QWidget:
        """Show the dialog of an algorithm with these values filled in."""
        import processing

        self.forget()
        dialog = processing.createAlgorithmDialog(f"repm:{algorithm}", dict(given))
        dialog.show()
        return dialog

    def begin_again(self) -> None:
        """Forget what was done in another project."""
        self.forget()
        self._reference, self._fused = [], {}

    def forget(self) -> None:
        """Remove the message."""
        if self._bar is not None and self._shown in self._bar.items():
            self._bar.popWidget(self._shown)
        self._shown = None


STEPS = NextSteps()


def push_message(bar: QgsMessageBar, text: str, buttons: list[Button]) -> QgsMessageBarItem:
    """Put a message with buttons into a bar, where it stays."""
    message = bar.createMessage("REPM", text)
    for title, run in buttons:
        button = QPushButton(title, message)
        button.clicked.connect(lambda *_, run=run: run())
        message.layout().addWidget(button)
    for browser in message.findChildren(QTextBrowser):
        _show_whole(browser)
        message.layout().setStretchFactor(browser, 1)
    return bar.pushWidget(message, Qgis.MessageLevel.Info, 0)


def _show_whole(browser: QTextBrowser) -> None:
    """Give a text beside buttons the lines that it needs: QGIS has place for one, and a scroll bar for the second."""

    def grow(size: QSizeF) -> None:
        line = browser.fontMetrics().lineSpacing()
        more = line if size.height() > 2 * line else 0  # QGIS's style sheet begins a line of its own height lower
        browser.setMinimumHeight(math.ceil(size.height()) + 2 * browser.frameWidth() + more)

    # Else a text takes 256 px at least, and on a small screen the map takes the place of the panels beside it.
    browser.setSizePolicy(QSizePolicy.Policy.Ignored, browser.sizePolicy().verticalPolicy())
    browser.setMinimumWidth(_LEAST_TEXT)
    browser.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    layout = browser.document().documentLayout()
    layout.documentSizeChanged.connect(grow)
    grow(layout.documentSize())


def _fusion_inputs() -> list[str]:
    """The parameters that say how a DSM is made, but for its scene and products."""
    products = {each.option for each in products_of("dsmfuse")}
    others = {"scene", "workers", "memory", *products}
    return [name.upper() for name in DsmFuseOptions.names() if name not in others]


def _paths(value: object) -> list[str]:
    context = QgsProcessingContext()
    context.setProject(QgsProject.instance())
    return [path for path in any_paths(value, context, only_named=True) if path]


def free_path(path: str) -> str:
    """A name that no file has, with a number where the first is taken."""
    stem, end = os.path.splitext(path)
    number = 1
    while os.path.lexists(path):
        number += 1
        path = f"{stem}_{number}{end}"
    return path


def layer_of(path: Optional[str]) -> Optional[QgsMapLayer]:
    """The layer of a result, None where it is not on the map."""
    if is_empty(path) or path == QgsProcessing.TEMPORARY_OUTPUT:
        return None
    place = real_path(str(path))
    layers = QgsProject.instance().mapLayers().values()
    return next((layer for layer in layers if real_path(layer_path(layer)) == place), None)


def _show_view(layer_id: str, kind: str) -> None:
    """Show a layer in one of its further styles; "" is its first one."""
    layer = QgsProject.instance().mapLayer(layer_id)
    if layer is None:
        return
    styles = layer.styleManager()
    further = {said(style.title): style.kind for style in STYLES if style.view_of}
    name = next((each for each in styles.styles() if further.get(each, "") == kind), styles.currentStyle())
    styles.setCurrentStyle(name)
    layer.triggerRepaint()
    bring_out(layer_id)


def bring_out(layer_id: str) -> None:
    """Switch a layer on, and off the rasters of its group that would hide it, such as an earlier comparison."""
    node = QgsProject.instance().layerTreeRoot().findLayer(layer_id)
    if node is None:
        return
    node.setItemVisibilityCheckedParentRecursive(True)
    for other in node.parent().children():
        if other == node:
            break
        if other.nodeType() == QgsLayerTreeNode.NodeType.NodeLayer and isinstance(other.layer(), QgsRasterLayer):
            other.setItemVisibilityChecked(False)
