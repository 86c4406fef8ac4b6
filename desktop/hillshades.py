"""A DSM with its hillshade is one layer for the user.

A raster layer of QGIS has one renderer: colours or a hillshade. So the hillshade is a second layer, but one that only
the tree of layers and the map know, as a private one: it is no layer of the project. No list of layers names it,
Identify ignores it, and a project's file does not contain it. Only a property of the DSM's node is stored, and the
hillshade is made again from it when the project is opened. Without the plugin the DSM has its colours alone.
"""

from __future__ import annotations

from functools import partial
from typing import Callable, Optional

from qgis.core import (
    QgsLayerTreeLayer,
    QgsLayoutItemMap,
    QgsMapLayer,
    QgsMapLayerType,
    QgsMapThemeCollection,
    QgsProject,
    QgsRasterLayer,
)
from qgis.gui import QgisInterface
from qgis.PyQt import sip
from qgis.PyQt.QtCore import QCoreApplication, QObject, QTimer
from qgis.PyQt.QtWidgets import QAction
from qgis.PyQt.QtXml import QDomDocument, QDomElement

from ..processing_provider.base import resource
from ..processing_provider.styles import HILLSHADE

_OF = "repm/shaded"
"""The property of a hillshade's node that names the DSM's layer. Until 2026-11 that was a layer of the project."""


def shade_of(layer: QgsMapLayer) -> list[QgsMapLayer]:
    """The hillshade that lies on a DSM now: one, or none."""
    nodes = QgsProject.instance().layerTreeRoot().findLayers()
    return [each.layer() for each in nodes if each.customProperty(_OF) == layer.id() and each.layer() is not None]


def _wanted(node: QgsLayerTreeLayer) -> bool:
    return str(node.customProperty(HILLSHADE)) == "1"


Connection = tuple[QObject, str, Callable[..., object]]
"""An object, its signal, and what follows."""


class Hillshades:
    """While it is there, DSMs of the project have their hillshades; ``stop`` removes these.

    With QGIS's ``iface``, the menu of a DSM in the tree of layers can switch its hillshade on and off.
    """

    def __init__(self, project: Optional[QgsProject] = None, iface: QgisInterface = None) -> None:
        self._project, self._iface = project or QgsProject.instance(), iface
        self._root = self._project.layerTreeRoot()
        self._shades: dict[str, QgsRasterLayer] = {}  # by the DSM's layer; the project does not keep them for us
        self._soon = QTimer()
        self._soon.setSingleShot(True)
        self._soon.timeout.connect(self.arrange)
        later = lambda *_: self._soon.start(0)  # noqa: E731 - while the tree is being changed, it must not be changed
        self._connections: list[Connection] = [
            (self._root, "addedChildren", later),
            (self._root, "removedChildren", later),
            (self._root, "customPropertyChanged", lambda _, key: later() if key == HILLSHADE else None),
            (self._root, "visibilityChanged", self._shown),
            (self._project, "readProject", lambda *_: self.arrange()),
            (self._project, "writeProject", self._leave_out),
        ]
        self._followed: dict[str, list[Connection]] = {}
        self._offered: set[str] = set()
        self._usual_opacity = 1.0
        self._action: Optional[QAction] = None
        if iface is not None:
            self._action = QAction(self.tr("Hillshade"), iface.mainWindow())
            self._action.setCheckable(True)
            self._action.triggered.connect(self._switch)
            iface.addCustomActionForLayerType(self._action, "", QgsMapLayerType.RasterLayer, False)
            self._connections.append((iface, "currentLayerChanged", lambda *_: self._show_state()))
        _connect(self._connections)
        self.arrange()

    def tr(self, text: str) -> str:
        return QCoreApplication.translate("Hillshades", text)

    def stop(self) -> None:
        _disconnect(self._connections)
        self._connections = []  # they keep references to us, and we to the project, which would outlive QGIS
        self._soon.stop()
        if self._action is not None:
            self._iface.removeCustomActionForLayerType(self._action)
            self._action.deleteLater()
            self._action = None
        for node in [] if sip.isdeleted(self._root) else self._nodes():
            node.parent().removeChildNode(node)
        for layer in list(self._shades):
            self._forget(layer)

    # --- what there is ---

    def _nodes(self) -> list[QgsLayerTreeLayer]:
        return [node for node in self._root.findLayers() if node.customProperty(_OF)]

    def arrange(self) -> None:
        """Make, move and remove hillshades until each DSM that is to have one has it right above it."""
        changed = self._project.isDirty()
        self._take_over_older()
        dsms = {node.layerId(): node for node in self._root.findLayers() if _wanted(node) and _is_raster(node.layer())}
        placed = set()
        for node in self._nodes():
            dsm = dsms.get(node.customProperty(_OF))
            shade = self._shades.get(node.customProperty(_OF))
            # A node that was dragged along with its group is read from a text, and lost the layer.
            if dsm is None or node.layer() is None or node.layer() is not shade or not _lies_on(node, dsm):
                node.parent().removeChildNode(node)
            else:
                placed.add(dsm.layerId())
        for layer in set(self._shades) - set(dsms):
            self._forget(layer)
        for layer, node in dsms.items():
            if layer not in placed:
                self._place(node)
        self._join_themes()
        self._join_layouts()
        self._offer()
        self._project.setDirty(changed)  # a layer that is not stored is no change of the project

    def _place(self, dsm: QgsLayerTreeLayer) -> None:
        layer = dsm.layer()
        if layer.id() not in self._shades:
            self._make(layer)
        shade = self._shades[layer.id()]
        above = dsm.parent().insertLayer(dsm.parent().children().index(dsm), shade)
        above.setCustomProperty(_OF, layer.id())
        above.setCustomProperty("legend/title-style", "hidden")  # in the legends of layouts
        above.setExpanded(False)
        above.setItemVisibilityChecked(dsm.itemVisibilityChecked())
        if self._root.hasCustomLayerOrder():  # where QGIS puts what is new at the end
            order = [each for each in self._root.customLayerOrder() if each != shade]
            order.insert(order.index(layer) if layer in order else 0, shade)
            self._root.setCustomLayerOrder(order)

    def _join_themes(self) -> None:
        """A theme that shows a DSM shows its hillshade: of those in a project's file QGIS found no layer."""
        themes = self._project.mapThemeCollection()
        for name in themes.mapThemes():
            state = themes.mapThemeState(name)
            shown = {each.layer() for each in state.layerRecords()}
            missing = [shade for layer, shade in self._of_project() if layer in shown and shade not in shown]
            for shade in missing:
                state.addLayerRecord(QgsMapThemeCollection.MapThemeLayerRecord(shade))
            if missing:
                themes.update(name, state)

    def _join_layouts(self) -> None:
        """The same for maps of layouts whose layers are locked. There QGIS takes the DSM, which has the same file, for
        the hillshade that it does not find, and has it twice."""
        for layout in self._project.layoutManager().printLayouts():
            for item in layout.items():
                if isinstance(item, QgsLayoutItemMap) and item.keepLayerSet():
                    layers = list({each.id(): each for each in item.layers()}.values())
                    for layer, shade in self._of_project():
                        if layer in layers and shade not in layers:
                            layers.insert(layers.index(layer), shade)
                    if layers != item.layers():
                        item.setLayers(layers)

    def _of_project(self) -> list[tuple[QgsMapLayer, QgsRasterLayer]]:
        """The DSMs, each with its hillshade."""
        found = [(self._project.mapLayer(layer), shade) for layer, shade in self._shades.items()]
        return [(layer, shade) for layer, shade in found if layer is not None]

    def _make(self, layer: QgsRasterLayer) -> None:
        name = self.tr("Hillshade of {name}").format(name=layer.name())
        shade = QgsRasterLayer(layer.source(), name, layer.providerType())
        shade.loadNamedStyle(resource("styles", "hillshade.qml"))
        shade.setFlags((shade.flags() | QgsMapLayer.LayerFlag.Private) & ~QgsMapLayer.LayerFlag.Identifiable)
        shade.setTransformContext(self._project.transformContext())
        self._usual_opacity = shade.opacity()
        self._shades[layer.id()] = shade
        # By the layer's id: what a signal holds lives longer than the layer, and QGIS crashes at its end where that
        # is a raster.
        restyle = partial(self._restyle, layer.id())
        reload = partial(self._reload, layer.id())
        followed: list[Connection] = [
            (layer, "styleChanged", restyle),
            (layer, "crsChanged", restyle),
            (layer, "dataSourceChanged", reload),
        ]
        _connect(followed)
        self._followed[layer.id()] = followed
        restyle()

    def _restyle(self, layer_id: str) -> None:
        layer, shade = self._project.mapLayer(layer_id), self._shades.get(layer_id)
        if layer is None or shade is None:
            return
        shade.setCrs(layer.crs())
        shade.setOpacity(self._usual_opacity * layer.opacity())
        shade.setScaleBasedVisibility(layer.hasScaleBasedVisibility())
        shade.setMinimumScale(layer.minimumScale())
        shade.setMaximumScale(layer.maximumScale())
        shade.triggerRepaint()

    def _reload(self, layer_id: str) -> None:
        """The same file has another content after an edit; and Windows needs the older one to be closed."""
        layer, shade = self._project.mapLayer(layer_id), self._shades.get(layer_id)
        if layer is not None and shade is not None:
            shade.setDataSource(layer.source(), shade.name(), layer.providerType(), False)
            self._restyle(layer_id)

    def _forget(self, layer: str) -> None:
        _disconnect(self._followed.pop(layer))
        del self._shades[layer]

    def _take_over_older(self) -> None:
        """Hillshades of older projects are layers of the project: take them out."""
        older = [node for node in self._nodes() if self._project.mapLayer(node.layerId()) is not None]
        for node in older:
            dsm = self._root.findLayer(node.customProperty(_OF))
            if dsm is not None and dsm.customProperty(HILLSHADE) is None:
                dsm.setCustomProperty(HILLSHADE, 1)
        self._project.removeMapLayers([node.layerId() for node in older])

    # --- what the user does ---

    def _shown(self, _: object) -> None:
        """A hillshade is shown where its DSM is, whatever was clicked or which theme was chosen."""
        for node in self._nodes():
            dsm = self._root.findLayer(node.customProperty(_OF))
            if dsm is not None and node.itemVisibilityChecked() != dsm.itemVisibilityChecked():
                node.setItemVisibilityChecked(dsm.itemVisibilityChecked())

    def _current(self) -> Optional[QgsLayerTreeLayer]:
        layer = self._iface.activeLayer() if self._iface is not None else None
        return self._root.findLayer(layer.id()) if layer is not None else None

    def _switch(self, on: bool) -> None:
        node = self._current()
        if node is not None:
            node.setCustomProperty(HILLSHADE, int(on))

    def _offer(self) -> None:
        """Give our action to the menus of layers that have a hillshade, or had one."""
        if self._action is None:
            return
        for node in self._root.findLayers():
            if node.customProperty(HILLSHADE) is not None and node.layer() is not None:
                if node.layerId() not in self._offered:
                    self._iface.addCustomActionForLayer(self._action, node.layer())
                    self._offered.add(node.layerId())
        self._show_state()

    def _show_state(self) -> None:
        if self._action is not None:
            node = self._current()
            self._action.setChecked(node is not None and _wanted(node))

    def _leave_out(self, document: QDomDocument) -> None:
        """Take hillshades out of a project's file: a QGIS without the plugin would look for layers that do not
        exist."""
        ids = {shade.id() for shade in self._shades.values()}
        nodes, items = (_elements(document, tag) for tag in ("layer-tree-layer", "item"))  # of the tree, of an order
        gone = [node for node in nodes if node.attribute("id") in ids]
        for each in [*gone, *(item for item in items if item.text() in ids)]:
            each.parentNode().removeChild(each)


def _elements(document: QDomDocument, tag: str) -> list[QDomElement]:
    found = document.elementsByTagName(tag)
    return [found.at(index).toElement() for index in range(found.count())]


def _is_raster(layer: object) -> bool:
    return isinstance(layer, QgsRasterLayer) and layer.isValid()


def _lies_on(node: QgsLayerTreeLayer, dsm: QgsLayerTreeLayer) -> bool:
    if node.parent() != dsm.parent():
        return False
    return node.parent().children().index(dsm) == node.parent().children().index(node) + 1


def _connect(connections: list[Connection]) -> None:
    for owner, signal, slot in connections:
        getattr(owner, signal).connect(slot)


def _disconnect(connections: list[Connection]) -> None:
    for owner, signal, slot in connections:
        if not sip.isdeleted(owner):  # QGIS crashes where a signal of a layer that has gone is asked for
            getattr(owner, signal).disconnect(slot)
