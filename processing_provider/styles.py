"""How results look on the map: with the style file of each of them, grouped by run, in order."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Mapping, Optional, Sequence

from qgis.core import (
    QgsLayerTreeGroup,
    QgsLayerTreeLayer,
    QgsLayerTreeNode,
    QgsMapLayer,
    QgsMapLayerStyle,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingLayerPostProcessorInterface,
    QgsProcessingUtils,
    QgsProject,
    QgsProviderRegistry,
    QgsRasterLayer,
    QgsRasterRange,
)
from qgis.PyQt.QtCore import QCoreApplication

from ..repm_qgis.contracts.file_kinds import is_textured
from ..repm_qgis.contracts.products import STYLES
from ..repm_qgis.names import titled
from ..repm_qgis.runtime.translation import written_in
from .language import language, said

_FROM_TOP = [style.kind for style in STYLES]
_OFF = {style.kind: style.beside for style in STYLES if style.off}
_ORDER, _SCENE, _NUMBER = "repm/order", "repm/scene", "repm/number"
_BEFORE_A_DSM = {"gcps", "tie_points", "tiles", "footprints", "overlaps", "error"}
"""The kinds of layers that a DSM may join; all others belong to a DSM, such as the second comparison of an earlier one,
which has a group of its own."""
HILLSHADE = "repm/hillshade"
"""The property of a node in the tree of layers: 1 where the layer has a hillshade, 0 where the user switched it off."""

CONFIDENCE, CONFIDENCE_LINK = "repm/confidence", "repm_confidence"
"""The property of a DSM's layer that names the layer of its confidence, and the widget of its legend that leads there
(``desktop/confidence_link.py``)."""


def _tr(text: str) -> str:
    return QCoreApplication.translate("RepmStyles", text)


@dataclass
class Run:
    """One run of an algorithm: its layers come into one group, and bear its name.

    The group is the last one of the ``scene`` ("" for none: no group) where nothing of its ``kinds`` is in it yet, so
    that stages that follow each other share theirs; a run that is repeated makes a new one, with a number.
    ``days`` are those on which the images were taken. ``data``: the group holds what runs begin with, and is no run's.
    """

    scene: str
    days: Sequence[str] = ()
    kinds: set[str] = field(default_factory=set)
    number: int = 0
    data: bool = False
    layers: dict[str, QgsMapLayer] = field(default_factory=dict)  # that are on the map, by kind

    def link(self) -> None:
        """Lead from the legend of the DSM to the confidence, where both are there."""
        dsm, confidence = (self.layers.get(kind) for kind in ("dsm", "confidence"))
        if dsm is not None and confidence is not None:
            dsm.setCustomProperty(CONFIDENCE, confidence.id())
            dsm.setCustomProperty("embeddedWidgets/count", 1)
            dsm.setCustomProperty("embeddedWidgets/0/id", CONFIDENCE_LINK)
            dsm.legendChanged.emit()
            self.layers.clear()

    def label(self) -> str:
        """The name of the group: which scene, of when, of which of several runs."""
        return titled(f"{self.scene} ({self.number})" if self.number > 1 else self.scene, self.days)

    def name(self, title: str, more: str = "") -> str:
        """The name of a layer: what, of which scene, of when."""
        return " ".join(filter(None, (title, self.label(), f"({more})" if more else "")))

    def _identity(self) -> str:
        return f"data:{self.scene}" if self.data else self.scene

    def group(self, parent: QgsLayerTreeGroup) -> QgsLayerTreeGroup:
        """The run's group, in that of the layers which QGIS has put there, or next to it."""
        while parent.customProperty(_SCENE) and parent.parent() is not None:
            parent = parent.parent()
        mine = {
            int(child.customProperty(_NUMBER, 1)): child
            for child in parent.children()
            if isinstance(child, QgsLayerTreeGroup) and child.customProperty(_SCENE) == self._identity()
        }
        if not self.number:
            last = max(mine, default=0)
            there = _kinds(mine[last]) if last else set()
            measured = "dsm" in self.kinds and there - _BEFORE_A_DSM
            self.number = last + 1 if not last or there & self.kinds or measured else last
        if self.number not in mine:
            made = parent.insertGroup(0, self.label())
            made.setCustomProperty(_SCENE, self._identity())
            made.setCustomProperty(_NUMBER, self.number)
            return made
        return mine[self.number]


class LayerStyler(QgsProcessingLayerPostProcessorInterface):
    """Styles a result once QGIS has put it on the map, and puts it in its place among those of its run.

    Processing does not look for style files of its results, and does not load them in our order.
    """

    _alive: list[LayerStyler] = []  # QGIS does not own post-processors: without a reference Python would drop them

    def __init__(self, style: str, kind: str, run: Run, title: str, more: str, views: Mapping[str, str]) -> None:
        super().__init__()
        self._style, self._kind, self._run, self._title, self._more = style, kind, run, title, more
        self._views, self._given = views, run.name(title, more)

    @classmethod
    def make(
        cls, style: str, kind: str, run: Run, title: str = "", more: str = "", views: Optional[Mapping[str, str]] = None
    ) -> LayerStyler:
        """``title`` and ``more`` are what the layer's name has before and after its run's; ``views`` are further styles
        of the layer, by their names."""
        styler = cls(style, kind, run, title, more, views or {})
        cls._alive.append(styler)
        del cls._alive[:-256]
        return styler

    def postProcessLayer(
        self, layer: QgsMapLayer, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> None:
        if layer is None:
            return
        if os.path.exists(self._style):
            layer.loadNamedStyle(self._style)
            layer.triggerRepaint()
        if self._kind == "image" and isinstance(layer, QgsRasterLayer):
            _without_collar(layer)
        for name, text in self._views.items():
            layer.styleManager().addStyle(name, QgsMapLayerStyle(text))
        project = context.project()
        node = project.layerTreeRoot().findLayer(layer.id()) if project is not None else None
        if node is None or node.parent() is None:
            return
        placed = _place(node, self._kind, self._run)
        if self._title and layer.name() == self._given:  # else QGIS names results after their files, as the user chose
            layer.setName(self._run.name(self._title, self._more))
        if self._kind == "dsm" and isinstance(layer, QgsRasterLayer):
            shade(placed)
            _as_terrain(layer, project)
        self._run.layers[self._kind] = layer
        self._run.link()


def _without_collar(layer: QgsRasterLayer) -> None:
    """Make the surroundings of an image transparent: on the map it is rotated, and QGIS fills the corners with
    zeros."""
    nothing = QgsRasterRange(0, 0)
    for band in range(1, layer.bandCount() + 1):
        layer.dataProvider().setUserNoDataValue(band, [nothing])
    layer.setDefaultContrastEnhancement()  # the stretch without the zeros
    layer.triggerRepaint()


def shade(node: QgsLayerTreeLayer) -> None:
    """Have the desktop lay a hillshade over a layer's colours (``desktop/hillshades.py``)."""
    node.setCustomProperty(HILLSHADE, 1)


def _as_terrain(layer: QgsRasterLayer, project: QgsProject) -> None:
    """Make the DSM the project's terrain, for 3-D views and profiles, where the terrain was flat (QGIS 3.26)."""
    if not hasattr(project, "elevationProperties"):
        return
    from qgis.core import QgsRasterDemTerrainProvider

    terrain = project.elevationProperties().terrainProvider()
    if terrain is not None and terrain.type() == "flat":
        made = QgsRasterDemTerrainProvider()
        made.setLayer(layer)
        project.elevationProperties().setTerrainProvider(made)


def _place(node: QgsLayerTreeLayer, kind: str, run: Run) -> QgsLayerTreeLayer:
    """Move a layer into its run's group, to its place from the top; gives its node.

    Layers that would hide a DSM, or lie on it, are switched off where there is one.
    """
    parent = node.parent()
    group = run.group(parent) if run.scene else parent
    order = _FROM_TOP.index(kind)
    copy = node.clone()
    copy.setCustomProperty(_ORDER, order)
    covering = bool(_kinds(group) & set(_OFF.get(kind, ())))
    copy.setItemVisibilityChecked(not covering)
    copy.setExpanded(node.isExpanded() and not covering)
    group.insertChildNode(_index(group, node, order), copy)
    parent.removeChildNode(node)
    for other in group.children():
        if kind in _OFF.get(kind_of(other), ()):
            other.setItemVisibilityChecked(False)
            other.setExpanded(False)
    return copy


def kind_of(node: QgsLayerTreeNode) -> str:
    """The kind of a layer of ours, "" of any other."""
    order = int(node.customProperty(_ORDER, -1))
    return _FROM_TOP[order] if 0 <= order < len(_FROM_TOP) else ""


def is_run(node: QgsLayerTreeNode) -> bool:
    """Whether a node of the tree of layers is the group of a run."""
    return isinstance(node, QgsLayerTreeGroup) and bool(node.customProperty(_SCENE))


def _kinds(group: QgsLayerTreeGroup) -> set[str]:
    return {kind_of(child) for child in group.children()} - {""}


def _index(group: QgsLayerTreeGroup, node: QgsLayerTreeNode, order: int) -> int:
    """Where a layer goes: before the first of ours that belongs below it or is an earlier one of its kind, else after
    the last; where there is none, it stays where QGIS put it, or comes first."""
    orders = [int(child.customProperty(_ORDER, -1)) for child in group.children()]
    below = [i for i, other in enumerate(orders) if other >= order]
    if below:
        return below[0]
    above = [i for i, other in enumerate(orders) if other >= 0]
    if above:
        return above[-1] + 1
    return group.children().index(node) if node.parent() == group else 0


def sidecar(kind: str, path: str, feedback: QgsProcessingFeedback) -> str:
    """A result's style file, written now where its stage wrote none; "" where that fails."""
    style = os.path.splitext(path)[0] + ".qml"
    if not os.path.exists(style):
        from ..repm_qgis.contracts.errors import RepmError

        try:
            from ..repm_qgis.reports.styles import write_style

            with written_in(language()):
                write_style(kind, path)
        except (RepmError, ImportError) as error:  # the result exists all the same
            feedback.pushWarning(said(f"'{os.path.basename(path)}' has no style: {error}"))
            return ""
    return style


def _views(kind: str, path: str, feedback: QgsProcessingFeedback) -> dict[str, str]:
    """Further styles of a kind of layer, by their names, which QGIS offers beside the first one."""
    from ..repm_qgis.contracts.errors import RepmError
    from ..repm_qgis.reports.styles import style_text

    found = {}
    for style in STYLES:
        if style.view_of == kind:
            try:
                with written_in(language()):
                    found[said(style.title)] = style_text(style.kind, path)
            except RepmError as error:  # the result exists all the same
                feedback.pushWarning(said(f"'{os.path.basename(path)}' has no style: {error}"))
    return found


def style_layer(
    context: QgsProcessingContext,
    feedback: QgsProcessingFeedback,
    kept_as: str,
    path: str,
    kind: str,
    run: Run,
    title: str,
    more: str = "",
) -> None:
    """Style one result, name its layer, and have it put into its run's group, where QGIS will load it.

    ``kept_as`` is QGIS's word for the file. QGIS loads rasters and vectors by itself, as the user chose; a cloud and a
    mesh are loaded where they were asked for, as it has no destination for them.
    """
    if kind in ("ept", "mesh"):
        style = os.path.join(path, "ept.qml") if kind == "ept" else os.path.splitext(path)[0] + ".qml"
        kept_as = _load_built(context, path, kind)
    else:
        # A layer in memory has an id and no file: its style would lie in the folder that QGIS was started in.
        in_memory = context.temporaryLayerStore().mapLayer(path) is not None
        style = sidecar(kind, QgsProcessingUtils.generateTempFilename(kind) if in_memory else path, feedback)
    if kept_as and context.willLoadLayerOnCompletion(kept_as):
        styler = LayerStyler.make(style, kind, run, title, more, _views(kind, path, feedback))
        _dress(context, kept_as, run.name(title, more), kind, run, styler)


def _dress(context: QgsProcessingContext, kept_as: str, name: str, kind: str, run: Run, styler: LayerStyler) -> None:
    """Name, place and style a layer that QGIS will load."""
    run.kinds.add(kind)
    details = context.layerToLoadOnCompletionDetails(kept_as)
    details.name = name
    details.forceName = True  # QGIS prefers the file's name, which is "dsm" in every workspace
    if hasattr(details, "layerSortKey"):  # QGIS 3.32; its groupName would not know how often a run was repeated
        details.layerSortKey = -_FROM_TOP.index(kind)
    details.setPostProcessor(styler)


def load_too(
    context: QgsProcessingContext,
    source: str,
    hint: QgsProcessingUtils.LayerHint,
    name: str,
    kind: str,
    run: Run,
    style: str = "",
) -> None:
    """Have a layer loaded that QGIS does not know as a result; the context must have a project."""
    details = QgsProcessingContext.LayerDetails(name, context.project(), "", hint)
    context.addLayerToLoadOnCompletion(source, details)
    _dress(context, source, name, kind, run, LayerStyler.make(style, kind, run))


def _load_built(context: QgsProcessingContext, path: str, kind: str) -> str:
    """Have a cloud or a mesh loaded; gives QGIS's word for it, "" without a project, where QGIS cannot show it,
    and for glTF, which is for other programs."""
    provider = {"ept": "ept", "mesh": "mdal"}[kind]
    if is_textured(path) or context.project() is None or provider not in QgsProviderRegistry.instance().providerList():
        return ""
    hints = QgsProcessingUtils.LayerHint
    # With its provider's name: QGIS 3.22 takes all point clouds to be PDAL's.
    source, hint = (f"ept://{path}/ept.json", hints.PointCloud) if kind == "ept" else (path, hints.Mesh)
    context.addLayerToLoadOnCompletion(source, QgsProcessingContext.LayerDetails("", context.project(), "", hint))
    return source
