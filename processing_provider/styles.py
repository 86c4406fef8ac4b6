"""How results look on the map: the style that the engine wrote beside each of them."""

from __future__ import annotations

import os

from qgis.core import (
    QgsLayerTree,
    QgsMapLayer,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingLayerPostProcessorInterface,
    QgsVectorLayer,
)


class Dresser(QgsProcessingLayerPostProcessorInterface):
    """Styles a result once QGIS has put it on the map: Processing does not look for styles beside its results."""

    _alive: list[Dresser] = []  # QGIS does not own post-processors: without a reference Python would drop them

    def __init__(self, style: str, vectors: list[str]) -> None:
        super().__init__()
        self._style, self._vectors = style, vectors

    @classmethod
    def make(cls, style: str, vectors: list[str]) -> Dresser:
        """``vectors`` is one list for all results of a run: ids of the vector layers that are on the map already."""
        dresser = cls(style, vectors)
        cls._alive.append(dresser)
        del cls._alive[:-256]
        return dresser

    def postProcessLayer(self, layer: QgsMapLayer, context: QgsProcessingContext,
                         feedback: QgsProcessingFeedback) -> None:
        if layer is None:
            return
        if os.path.exists(self._style):
            layer.loadNamedStyle(self._style)
            layer.triggerRepaint()
        if isinstance(layer, QgsVectorLayer):
            self._vectors.append(layer.id())
        elif context.project() is not None:
            for identity in self._vectors:  # QGIS loads in no order of ours: a raster must not hide them
                _move_to_top(context.project().layerTreeRoot(), identity)


def _move_to_top(root: QgsLayerTree, identity: str) -> None:
    node = root.findLayer(identity)
    if node is not None and node.parent() is not None:
        parent = node.parent()
        parent.insertChildNode(0, node.clone())
        parent.removeChildNode(node)


def sidecar(kind: str, path: str, feedback: QgsProcessingFeedback) -> str:
    """The style file beside a result, written now where its stage wrote none; "" where that fails."""
    beside = os.path.splitext(path)[0] + ".qml"
    if not os.path.exists(beside):
        from ..repm_qgis.errors import RepmError

        try:
            from ..repm_qgis.evaluation.styles import write_style

            write_style(kind, path)
        except (RepmError, ImportError) as error:  # the result is there all the same
            feedback.pushWarning(f"'{os.path.basename(path)}' has no style: {error}")
            return ""
    return beside


def dress(context: QgsProcessingContext, feedback: QgsProcessingFeedback, kept_as: str, path: str, name: str,
          kind: str, vectors: list[str]) -> None:
    """Style one result, and name its layer where QGIS will load it.

    ``kept_as`` is QGIS's word for the file; ``vectors`` one list for all results of a run.
    """
    style = sidecar(kind, path, feedback)
    if kept_as and context.willLoadLayerOnCompletion(kept_as):
        details = context.layerToLoadOnCompletionDetails(kept_as)
        details.name = name
        details.setPostProcessor(Dresser.make(style, vectors))
