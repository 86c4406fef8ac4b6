"""A run's layers come into sight: the map shows their place, and the tree of layers their group.

QGIS moves the map for the first layer of a project alone, and leaves the tree of layers where it was scrolled.
"""

from __future__ import annotations

from typing import Iterable

from qgis.core import QgsLayerTreeLayer, QgsProject, QgsRectangle
from qgis.gui import QgisInterface

from ..processing_provider.styles import is_run, kind_of
from .next_step import layer_of

_EDGE = 1.05  # of the layers' extent
_HIDDEN = 0.9  # of an earlier run's extent that a new DSM covers


def bring_into_sight(iface: QgisInterface, results: Iterable[object]) -> None:
    """Show the layers of a run's results (their files): zoom to them where the map shows another place, open and scroll
    to their group. Earlier runs that a new DSM hides are switched off: the labels of what it hides would lie on it."""
    root = QgsProject.instance().layerTreeRoot()
    layers = [layer for layer in (layer_of(each) for each in results if isinstance(each, str)) if layer is not None]
    nodes = [node for node in (root.findLayer(layer.id()) for layer in layers) if node is not None]
    groups = [node.parent() for node in nodes if is_run(node.parent())]
    if not groups:
        return
    surface = next((node for node in nodes if kind_of(node) == "dsm"), None)
    if surface is not None:
        _switch_off_hidden(iface, surface)
    group = groups[0]
    group.setExpanded(True)
    view = iface.layerTreeView()
    view.scrollTo(view.node2index(group))
    place = extent_of(iface, nodes)
    if not place.isNull() and not place.intersects(iface.mapCanvas().extent()):
        zoom_to(iface, place)


def extent_of(iface: QgisInterface, nodes: Iterable[QgsLayerTreeLayer]) -> QgsRectangle:
    """The extent of layers in the map's CRS, a null one where none has any."""
    settings, extent = iface.mapCanvas().mapSettings(), QgsRectangle()
    for node in nodes:
        layer = node.layer()
        if layer is not None and not layer.extent().isNull():
            place = settings.layerExtentToOutputExtent(layer, layer.extent())
            if extent.isNull():
                extent = QgsRectangle(place)
            extent.combineExtentWith(place)
    return extent


def zoom_to(iface: QgisInterface, extent: QgsRectangle) -> None:
    """Show an extent of the map's CRS, with an edge."""
    shown = QgsRectangle(extent)
    shown.scale(_EDGE)
    iface.mapCanvas().setExtent(shown, True)
    iface.mapCanvas().refresh()


def _switch_off_hidden(iface: QgisInterface, surface: QgsLayerTreeLayer) -> None:
    new, own = extent_of(iface, [surface]), surface.parent()
    groups = own.parent().children()
    for other in filter(is_run, groups[groups.index(own) + 1 :]):
        shown = extent_of(iface, other.findLayers())
        area = shown.width() * shown.height()
        covered = shown.intersect(new)
        if area > 0 and covered.width() * covered.height() >= _HIDDEN * area:
            other.setItemVisibilityChecked(False)
            other.setExpanded(False)
