"""How results look on the map: the style that the engine wrote beside each of them."""

from __future__ import annotations

import os

from qgis.core import (
    QgsMapLayer,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingLayerPostProcessorInterface,
)


class Dresser(QgsProcessingLayerPostProcessorInterface):
    """Styles a result once QGIS has put it on the map: Processing does not look for styles beside its results."""

    _alive: list[Dresser] = []  # QGIS does not own post-processors: without a reference Python would drop them

    def __init__(self, style: str) -> None:
        super().__init__()
        self._style = style

    @classmethod
    def make(cls, style: str) -> Dresser:
        dresser = cls(style)
        cls._alive.append(dresser)
        del cls._alive[:-256]
        return dresser

    def postProcessLayer(self, layer: QgsMapLayer, context: QgsProcessingContext,
                         feedback: QgsProcessingFeedback) -> None:
        if layer is not None and os.path.exists(self._style):
            layer.loadNamedStyle(self._style)
            layer.triggerRepaint()


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
          kind: str) -> None:
    """Style one result, and name its layer where QGIS will load it; ``kept_as`` is QGIS's word for the file."""
    style = sidecar(kind, path, feedback)
    if kept_as and context.willLoadLayerOnCompletion(kept_as):
        details = context.layerToLoadOnCompletionDetails(kept_as)
        details.name = name
        if style:
            details.setPostProcessor(Dresser.make(style))
