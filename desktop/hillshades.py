"""A DSM and the hillshade over its colours are one thing for the user: they are shown, hidden and removed together.

QGIS needs two layers for the two: a raster layer has one renderer.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Optional

from qgis.core import QgsLayerTreeNode, QgsProject

from ..processing_provider.styles import SHADED


class HillshadesFollow:
    """While it is there, hillshades follow their DSMs in the project; ``stop`` ends it."""

    def __init__(self, project: Optional[QgsProject] = None) -> None:
        self._project = project or QgsProject.instance()
        self._root = self._project.layerTreeRoot()
        self._root.visibilityChanged.connect(self._shown)
        self._project.layersRemoved.connect(self._removed)

    def stop(self) -> None:
        with suppress(TypeError, RuntimeError):  # the project has gone before
            self._root.visibilityChanged.disconnect(self._shown)
            self._project.layersRemoved.disconnect(self._removed)

    def _shown(self, node: QgsLayerTreeNode) -> None:
        if node.nodeType() != QgsLayerTreeNode.NodeType.NodeLayer:
            return
        for hillshade in self._of(node.layerId()):
            hillshade.setItemVisibilityChecked(node.itemVisibilityChecked())

    def _removed(self, layers: list[str]) -> None:
        shades = [each.layerId() for layer in layers for each in self._of(layer)]
        self._project.removeMapLayers([shade for shade in shades if self._project.mapLayer(shade) is not None])

    def _of(self, layer: str) -> list:
        return [each for each in self._root.findLayers() if each.customProperty(SHADED) == layer]
