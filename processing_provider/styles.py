"""How results look on the map: with the style file of each of them, grouped by scene, in order."""

from __future__ import annotations

import os

from qgis.core import (
    QgsLayerTreeGroup,
    QgsLayerTreeLayer,
    QgsLayerTreeNode,
    QgsMapLayer,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingLayerPostProcessorInterface,
    QgsProcessingUtils,
    QgsProject,
    QgsProviderRegistry,
    QgsRasterLayer,
)
from qgis.PyQt.QtCore import QCoreApplication

from ..repm_qgis.products import STYLES
from ..repm_qgis.translation import written_in
from .engine import PLUGIN_FOLDER
from .language import language, said

_FROM_TOP = [style.kind for style in STYLES]
_OFF = [style.kind for style in STYLES if style.off]
_ORDER = "repm/order"


def _tr(text: str) -> str:
    return QCoreApplication.translate("RepmStyles", text)


class LayerStyler(QgsProcessingLayerPostProcessorInterface):
    """Styles a result once QGIS has put it on the map, and puts it in its place among those of its scene.

    Processing does not look for style files of its results, and does not load them in our order.
    """

    _alive: list[LayerStyler] = []  # QGIS does not own post-processors: without a reference Python would drop them

    def __init__(self, style: str, kind: str, group: str) -> None:
        super().__init__()
        self._style, self._kind, self._group = style, kind, group

    @classmethod
    def make(cls, style: str, kind: str, group: str) -> LayerStyler:
        """``group`` is the scene's name; "" where it has none."""
        styler = cls(style, kind, group)
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
        node = context.project().layerTreeRoot().findLayer(layer.id()) if context.project() is not None else None
        if node is None or node.parent() is None:
            return
        placed = _place(node, self._kind, self._group)
        if self._kind == "dsm":
            _shade(layer, placed, context.project(), self._group)


def _shade(layer: QgsMapLayer, node: QgsLayerTreeLayer, project: QgsProject, group: str) -> None:
    """Lay the DSM's own hillshade over its colours: one raster layer can have only one of the two."""
    hillshade = QgsRasterLayer(layer.source(), f"{_tr('Hillshade')} {group}".strip(), layer.providerType())
    if not hillshade.isValid():
        return
    hillshade.loadNamedStyle(os.path.join(PLUGIN_FOLDER, "resources", "styles", "hillshade.qml"))
    hillshade.setCrs(layer.crs())
    project.addMapLayer(hillshade, False)
    above = node.parent().insertLayer(node.parent().children().index(node), hillshade)
    above.setCustomProperty(_ORDER, _FROM_TOP.index("hillshade"))
    above.setExpanded(False)


def _place(node: QgsLayerTreeLayer, kind: str, name: str) -> QgsLayerTreeLayer:
    """Move a layer into its scene's group (QGIS before 3.32 knows none), to its place from the top; gives its node."""
    parent = node.parent()
    group = _group(parent, name) if name else parent
    order = _FROM_TOP.index(kind)
    copy = node.clone()
    copy.setCustomProperty(_ORDER, order)
    copy.setItemVisibilityChecked(kind not in _OFF)
    copy.setExpanded(node.isExpanded() and kind not in _OFF)
    group.insertChildNode(_index(group, node, order), copy)
    parent.removeChildNode(node)
    return copy


def _group(parent: QgsLayerTreeGroup, name: str) -> QgsLayerTreeGroup:
    """The group of that name: the one that holds the layer, or one next to it, which is made where there is none."""
    if parent.parent() is not None and parent.name() == name:
        return parent
    for child in parent.children():
        if isinstance(child, QgsLayerTreeGroup) and child.name() == name:
            return child
    return parent.insertGroup(0, name)


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
        from ..repm_qgis.errors import RepmError

        try:
            from ..repm_qgis.evaluation.styles import write_style

            with written_in(language()):
                write_style(kind, path)
        except (RepmError, ImportError) as error:  # the result is there all the same
            feedback.pushWarning(said(f"'{os.path.basename(path)}' has no style: {error}"))
            return ""
    return style


def style_layer(
    context: QgsProcessingContext,
    feedback: QgsProcessingFeedback,
    kept_as: str,
    path: str,
    name: str,
    kind: str,
    group: str,
) -> None:
    """Style one result, name its layer, and have it put into its scene's group, where QGIS will load it.

    ``kept_as`` is QGIS's word for the file. QGIS loads rasters and vectors by itself, as the user chose; a cloud and a
    mesh are loaded where they were asked for, as it has no destination for them.
    """
    if kind in ("ept", "mesh"):
        style = os.path.join(path, "ept.qml") if kind == "ept" else os.path.splitext(path)[0] + ".qml"
        kept_as = _load_built(context, path, kind)
    else:
        style = sidecar(kind, path, feedback)
    if kept_as and context.willLoadLayerOnCompletion(kept_as):
        _dress(context, kept_as, name, kind, group, style)


def _dress(context: QgsProcessingContext, kept_as: str, name: str, kind: str, group: str, style: str) -> None:
    """Name, place and style a layer that QGIS will load."""
    details = context.layerToLoadOnCompletionDetails(kept_as)
    details.name = name
    if kind in ("ept", "image"):
        details.forceName = True  # the file's name is always the same, or says more than QGIS's
    if group and hasattr(details, "groupName"):  # QGIS 3.32
        details.groupName = group
    if hasattr(details, "layerSortKey"):
        details.layerSortKey = -_FROM_TOP.index(kind)
    details.setPostProcessor(LayerStyler.make(style, kind, group))


def load_too(
    context: QgsProcessingContext,
    source: str,
    hint: QgsProcessingUtils.LayerHint,
    name: str,
    kind: str,
    group: str,
    style: str = "",
) -> None:
    """Have a layer loaded that QGIS does not know as a result; the context must have a project."""
    details = QgsProcessingContext.LayerDetails(name, context.project(), "", hint)
    context.addLayerToLoadOnCompletion(source, details)
    _dress(context, source, name, kind, group, style)


def _load_built(context: QgsProcessingContext, path: str, kind: str) -> str:
    """Have a cloud or a mesh loaded; gives QGIS's word for it, "" without a project or where QGIS cannot show it."""
    provider = {"ept": "ept", "mesh": "mdal"}[kind]
    if context.project() is None or provider not in QgsProviderRegistry.instance().providerList():
        return ""
    hints = QgsProcessingUtils.LayerHint
    # With its provider's name: QGIS 3.22 takes all point clouds to be PDAL's.
    source, hint = (f"ept://{path}/ept.json", hints.PointCloud) if kind == "ept" else (path, hints.Mesh)
    context.addLayerToLoadOnCompletion(source, QgsProcessingContext.LayerDetails("", context.project(), "", hint))
    return source
