"""The dock "REPM scenes": the workspaces of this project and those of late as one tree, with what can be done next.

All that it shows is read from the workspaces as they lie there (:mod:`repm_qgis.workspaces`), in a thread of its own;
only the list of folders is kept in the settings.
"""

from __future__ import annotations

import os
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Callable, Optional

from qgis.core import (
    QgsApplication,
    QgsMapLayer,
    QgsProject,
)
from qgis.gui import QgisInterface, QgsDockWidget
from qgis.PyQt.QtCore import QLocale, QPoint, QSize, Qt, pyqtSignal
from qgis.PyQt.QtGui import QIcon, QImage, QPalette, QPixmap
from qgis.PyQt.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QMenu,
    QPushButton,
    QTreeWidget,
    QTreeWidgetItem,
    QVBoxLayout,
    QWidget,
)

from ..processing_provider import last_scene
from ..processing_provider.base import resource
from ..processing_provider.kept import is_lasting
from ..processing_provider.language import said
from ..processing_provider.parameters import tr
from ..processing_provider.values import layer_path
from ..repm_qgis.names import period
from .control_points import ControlPointsDock
from .docking import scrolling, takes_the_rest
from .next_step import STEPS
from .scene_actions import SceneActions, can_show, show_file
from .scene_reading import THUMBNAIL_PX, Reader, picture_of

if TYPE_CHECKING:  # the engine is imported when it is needed
    from ..repm_qgis.workspaces.facts import ImageFacts, ProductFacts, RunFacts, Workspace

_FACTS = Qt.ItemDataRole.UserRole


class ScenesDock(QgsDockWidget):
    """Shows workspaces as a tree; ``close_down`` ends its thread. ``measure`` shows the panel of control points."""

    _ready = pyqtSignal(object, object)

    def __init__(self, iface: QgisInterface, measure: Callable[[], ControlPointsDock]) -> None:
        super().__init__(iface.mainWindow())
        self.setObjectName("RepmScenes")
        self.setWindowTitle(self.tr("REPM scenes"))
        self.act = SceneActions(iface, self, measure)
        self.act.changed.connect(self._open_and_refresh)
        self.act.shown.connect(self._follow_map)
        self._folders: list[str] = []
        self._found: dict[str, Workspace] = {}
        self._pictures: dict[str, QIcon] = {}
        self._open: dict[tuple[str, ...], bool] = {}
        self._building = False
        self._ready.connect(self._take)
        self._reader = Reader(self._ready.emit)
        self._build()
        STEPS.followers.append(self.refresh)
        project = QgsProject.instance()
        project.layersAdded.connect(self._follow_map)
        project.layersRemoved.connect(self._follow_map)
        project.readProject.connect(self.refresh)
        project.cleared.connect(self.refresh)
        project.layerTreeRoot().visibilityChanged.connect(self._follow_map)
        self.refresh()

    def _build(self) -> None:
        self.tree = QTreeWidget()
        self.tree.setColumnCount(2)
        self.tree.setHeaderLabels([self.tr("Scene"), self.tr("About it")])
        self.tree.setIconSize(QSize(THUMBNAIL_PX // 2, THUMBNAIL_PX // 2))
        self.tree.setColumnWidth(0, 190)
        self.tree.setIndentation(14)
        self.tree.setMinimumWidth(380)
        self.tree.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
        self.tree.customContextMenuRequested.connect(self._show_menu)
        self.tree.itemChanged.connect(self._ticked)
        self.tree.itemExpanded.connect(self._expanded)
        self.tree.itemCollapsed.connect(lambda item: self._note_open(item, False))
        self.tree.itemDoubleClicked.connect(self._double_clicked)
        self.tree.currentItemChanged.connect(lambda *_: self._show_state())
        self.said = QLabel()
        self.said.setWordWrap(True)
        self.actions = QPushButton(self.tr("What next"))
        self._menu = QMenu(self.actions)
        self._menu.aboutToShow.connect(lambda: self._fill(self._menu, self.tree.currentItem()))
        self.actions.setMenu(self._menu)
        add, refresh = QPushButton(self.tr("Add a workspace…")), QPushButton(self.tr("Refresh"))
        add.clicked.connect(lambda *_: self.act.add_workspace())
        refresh.clicked.connect(lambda *_: self.refresh())
        row = QHBoxLayout()
        for button in (self.actions, add, refresh):
            row.addWidget(button)
        row.addStretch()
        inside = QWidget()
        layout = QVBoxLayout(inside)
        takes_the_rest(self.tree)
        layout.addWidget(self.tree, 1)
        layout.addWidget(self.said)
        layout.addLayout(row)
        self.setWidget(scrolling(inside))

    def close_down(self) -> None:
        self._reader.stop()
        STEPS.followers.remove(self.refresh)
        project = QgsProject.instance()
        for signal, slot in (
            (project.layersAdded, self._follow_map),
            (project.layersRemoved, self._follow_map),
            (project.readProject, self.refresh),
            (project.cleared, self.refresh),
            (project.layerTreeRoot().visibilityChanged, self._follow_map),
        ):
            signal.disconnect(slot)

    # --- reading ---

    def is_reading(self) -> bool:
        return self._reader.waiting > 0

    def _open_and_refresh(self, folder: str) -> None:
        if folder:
            self._open[folder,] = True
        self.refresh()

    def refresh(self, *_: object) -> None:
        """Read all workspaces again: those of the project's layers, and those of late."""
        from ..repm_qgis.workspaces.reading import is_workspace, read_workspace

        places = dict.fromkeys(
            os.path.dirname(layer_path(layer)) for layer in QgsProject.instance().mapLayers().values()
        )
        of_project = [folder for folder in places if os.path.isabs(folder) and is_workspace(folder)]
        of_late = [each for each in last_scene.workspaces() if is_lasting(each) or is_workspace(each)]
        self._folders = list(dict.fromkeys(os.path.abspath(each) for each in (*of_project, *of_late)))
        self._found = {folder: self._found[folder] for folder in self._folders if folder in self._found}
        self._show()
        for folder in self._folders:
            self._reader.ask(("workspace", folder), partial(read_workspace, folder))

    def _take(self, about: tuple[str, str], result: object) -> None:
        """What the thread has read."""
        self._reader.waiting -= 1
        kind, name = about
        if isinstance(result, Exception):
            self.said.setText(str(result))
        elif kind == "workspace" and name in self._folders:
            self._found[name] = result  # type: ignore[assignment]
            self._show_workspace(name)
        elif kind == "picture" and isinstance(result, QImage):
            self._pictures[name] = QIcon(QPixmap.fromImage(result))
            for item in self._items():
                facts = item.data(0, _FACTS)
                if facts and facts[0] == "image" and facts[2].path == name:
                    item.setIcon(0, self._pictures[name])
        self._show_state()

    # --- the tree ---

    def _items(self) -> list[QTreeWidgetItem]:
        found = [self.tree.topLevelItem(row) for row in range(self.tree.topLevelItemCount())]
        for item in found:  # grows meanwhile
            found.extend(item.child(row) for row in range(item.childCount()))
        return found

    def item_of(self, folder: str) -> Optional[QTreeWidgetItem]:
        return next((item for item in self._items() if item.data(0, _FACTS) == ("workspace", folder)), None)

    def _show(self) -> None:
        """The tree of all folders, with what is known of them."""
        current = self.tree.currentItem()
        chosen = self._path(current) if current is not None else ()
        self.tree.clear()
        for number, folder in enumerate(self._folders):
            item = QTreeWidgetItem([os.path.basename(folder), ""])
            item.setData(0, _FACTS, ("workspace", folder))
            self.tree.addTopLevelItem(item)
            if folder in self._found:
                self._show_workspace(folder)
            item.setExpanded(self._open.get((folder,), number == 0))
        for item in self._items():
            if chosen and self._path(item) == chosen:
                self.tree.setCurrentItem(item)
        if self.tree.currentItem() is None and self.tree.topLevelItemCount():
            self.tree.setCurrentItem(self.tree.topLevelItem(0))
        self._show_state()

    def _show_workspace(self, folder: str) -> None:
        item, found = self.item_of(folder), self._found[folder]
        if item is None:
            return
        self._building = True
        chosen = self._path(self.tree.currentItem()) if self.tree.currentItem() is not None else ()
        item.takeChildren()
        item.setText(0, found.title)
        item.setIcon(0, _small(QIcon(resource("icons", "repm.svg"))))
        item.setToolTip(0, folder)
        about = said(found.problem) if found.problem else period(found.days)
        if found.writer:
            about = self.tr("In use by {owner}").format(owner=found.writer)
        item.setText(1, about if os.path.isdir(folder) else self.tr("not there"))
        item.setToolTip(1, about)
        if found.problem:
            self._grey(item)
        for title, kind, entries in (
            (self.tr("Images ({count})"), "image", found.images),
            (self.tr("Runs ({count})"), "run", found.runs),
            (self.tr("Products ({count})"), "product", found.products),
        ):
            if entries:
                part = QTreeWidgetItem(item, [title.format(count=len(entries)), ""])
                part.setData(0, _FACTS, ("part", folder, kind))
                for facts in entries:
                    getattr(self, f"_add_{kind}")(part, folder, facts)
                part.setExpanded(self._open.get((folder, kind), kind != "image"))
        for each in self._items():
            if chosen and self._path(each) == chosen:
                self.tree.setCurrentItem(each)
        self._building = False
        self._follow_map()

    def _path(self, item: QTreeWidgetItem) -> tuple[str, ...]:
        """What stays the same of an item when the tree is made again."""
        kind, folder, *facts = item.data(0, _FACTS)
        if kind == "part":
            return folder, facts[0]
        return (folder, *(str(getattr(each, "path", "") or getattr(each, "report", "")) for each in facts))

    def _grey(self, item: QTreeWidgetItem) -> None:
        colour = self.palette().brush(QPalette.ColorGroup.Disabled, QPalette.ColorRole.Text)
        for column in (0, 1):
            item.setForeground(column, colour)

    def _add_image(self, part: QTreeWidgetItem, folder: str, facts: ImageFacts) -> None:
        brief = whole = self.tr("time unknown")
        if facts.acquired:
            brief, whole = facts.acquired[:10], self.tr("{time} UTC").format(time=facts.acquired[:16].replace("T", " "))
        if facts.sun is not None:
            azimuth, elevation = map(round, facts.sun)
            brief += ", " + self.tr("sun {elevation}°").format(elevation=elevation)
            high = self.tr("sun {elevation}° high in {azimuth}°")
            whole += ", " + high.format(elevation=elevation, azimuth=azimuth)
        item = QTreeWidgetItem(part, [facts.name, brief if facts.there else self.tr("not there")])
        if not facts.there:
            self._grey(item)
        item.setToolTip(0, facts.path)
        item.setToolTip(1, whole)
        item.setData(0, _FACTS, ("image", folder, facts))
        if facts.path in self._pictures:
            item.setIcon(0, self._pictures[facts.path])

    def _add_run(self, part: QTreeWidgetItem, folder: str, run: RunFacts) -> None:
        when = datetime.fromtimestamp(run.time).strftime("%Y-%m-%d %H:%M")
        title = run.title.rpartition(": ")[0] or run.title or self.tr("Record of the scene")
        differing = ", ".join(run.differing) if run.differing else self.tr("all defaults") if run.options else ""
        verdict = run.verdict.rstrip(":")
        about = [verdict, differing] if run.stage else [title, verdict]
        item = QTreeWidgetItem(part, [when, "; ".join(filter(None, about))])
        kind = "mIconSuccess.svg" if run.good else "mIconWarning.svg"
        item.setIcon(0, _small(QgsApplication.getThemeIcon(f"/{kind}")) if run.verdict else QIcon())
        item.setToolTip(0, run.title)
        item.setToolTip(1, "\n".join(filter(None, (run.verdict, run.text, differing))))
        item.setData(0, _FACTS, ("run", folder, run))

    def _add_product(self, part: QTreeWidgetItem, folder: str, made: ProductFacts) -> None:
        size = QLocale().formattedDataSize(made.size) if made.there else self.tr("not there")
        name = os.path.basename(made.path)
        item = QTreeWidgetItem(part, [tr(made.product.title), f"{name}, {size}"])
        item.setToolTip(0, tr(made.product.help))
        item.setToolTip(1, made.path)
        item.setData(0, _FACTS, ("product", folder, made))
        if not made.there:
            self._grey(item)
        elif can_show(made):
            item.setFlags(item.flags() | Qt.ItemFlag.ItemIsUserCheckable)
            item.setCheckState(0, Qt.CheckState.Unchecked)

    def _follow_map(self, *_: object) -> None:
        """Have the ticks say what is on the map."""
        self._building, before = True, self._building
        layers = _layers_by_path()
        root = QgsProject.instance().layerTreeRoot()
        for item in self._items():
            facts = item.data(0, _FACTS)
            if facts and facts[0] == "product" and item.flags() & Qt.ItemFlag.ItemIsUserCheckable:
                layer = layers.get(_real(facts[2].path))
                node = root.findLayer(layer.id()) if layer is not None else None
                shown = node is not None and node.isVisible()
                item.setCheckState(0, Qt.CheckState.Checked if shown else Qt.CheckState.Unchecked)
        self._building = before

    def _show_state(self) -> None:
        self.actions.setEnabled(self.tree.currentItem() is not None)
        empty = self.tr("No scene yet: make a DSM, or add a workspace that you have.")
        self.said.setText("" if self._folders else empty)
        self.said.setVisible(not self._folders)

    def _note_open(self, item: QTreeWidgetItem, is_open: bool) -> None:
        self._open[self._path(item)] = is_open

    def _expanded(self, item: QTreeWidgetItem) -> None:
        self._note_open(item, True)
        facts = item.data(0, _FACTS)
        if facts[0] == "part" and facts[2] == "image":
            for image in self._found[facts[1]].images:
                if image.there and not image.remote and image.path not in self._pictures:
                    self._pictures[image.path] = QIcon()
                    self._reader.ask(("picture", image.path), partial(picture_of, image.path))

    # --- what can be done ---

    def _show_menu(self, place: QPoint) -> None:
        menu = QMenu(self.tree)
        self._fill(menu, self.tree.itemAt(place))
        if not menu.isEmpty():
            menu.popup(self.tree.viewport().mapToGlobal(place))

    def _fill(self, menu: QMenu, item: Optional[QTreeWidgetItem]) -> None:
        """The actions of an item."""
        menu.clear()
        if item is None:
            return
        kind, folder, *facts = item.data(0, _FACTS)
        found = self._found.get(folder)

        def add(title: str, act: Callable[[], object], enabled: bool = True) -> None:
            action = menu.addAction(title)
            action.setEnabled(bool(enabled))
            action.triggered.connect(lambda *_: act())

        if found is None or not os.path.isdir(folder):
            add(self.tr("Where is it now…"), lambda: self.act.relink(folder))
            add(self.tr("Forget this folder"), lambda: self.act.forget(folder))
            return
        run = facts[0] if kind == "run" else next((each for each in found.runs if each.options), None)
        made = facts[0] if kind == "product" else None
        if made is not None and made.there:
            if made.path.lower().endswith((".html", ".htm")):
                add(self.tr("Open in the browser"), lambda: show_file(made.path))
            elif can_show(made):
                add(self.tr("Zoom to it"), lambda: self.act.zoom_to_product(made, found))
        add(self.tr("Zoom to the scene"), lambda: self.act.zoom(found), found.bounds is not None)
        report = facts[0].report if kind == "run" else next((each.report for each in found.runs if each.report), "")
        add(self.tr("Open the report"), lambda: show_file(report), bool(report))
        add(self.tr("Show the folder"), lambda: show_file(folder))
        menu.addSeparator()
        options = run.options if run is not None else {}
        add(self.tr("Run again…"), lambda: self.act.run_again(options), bool(options))
        add(self.tr("Copy the command"), lambda: self.act.copy_command(options), bool(options))
        menu.addSeparator()
        for title, act, enabled in self._next_steps(found, made):
            add(title, act, enabled)
        menu.addSeparator()
        chosen = [made] if made is not None else list(found.products)
        removable = [each for each in chosen if each.there and each.removable]
        size = QLocale().formattedDataSize(sum(each.size for each in removable))
        title = self.tr("Remove ({size})…") if made is not None else self.tr("Remove all products ({size})…")
        add(title.format(size=size), lambda: self.act.remove(folder, removable), bool(removable and not found.writer))
        if folder in last_scene.workspaces():
            add(self.tr("Forget this folder"), lambda: self.act.forget(folder))

    def _next_steps(
        self, found: Workspace, made: Optional[ProductFacts]
    ) -> list[tuple[str, Callable[[], object], bool]]:
        """The steps that a scene and its DSM, or the one that is chosen, can take."""
        surface = made if made is not None and made.product.style == "dsm" else found.product("dsmfuse")
        dsm = surface.path if surface is not None and surface.there else ""
        has_heights = os.path.basename(found.scene) in ("reconstructed.json", "registered.json")

        def opened(algorithm: str) -> Callable[[], None]:
            return lambda: STEPS.open(algorithm, {"DSM": dsm})

        return [
            (self.tr("Compare with a reference…"), lambda: STEPS.compare(dsm), bool(dsm)),
            (self.tr("Register to a reference…"), lambda: STEPS.register(found.scene), has_heights),
            (self.tr("Terrain (DTM)…"), opened("dtm"), bool(dsm)),
            (self.tr("Buildings…"), opened("buildings"), bool(dsm)),
            (self.tr("Page for the browser (3-D)…"), opened("viewer"), bool(dsm)),
            (self.tr("Page for the client (PDF)"), lambda: self.act.make_page(found, surface), bool(dsm)),
            (self.tr("Edit the DSM…"), lambda: self.act.edit(found, surface), bool(dsm)),
            (self.tr("Measure control points…"), lambda: self.act.measure(found), any(e.there for e in found.images)),
        ]

    def _double_clicked(self, item: QTreeWidgetItem, _: int) -> None:
        kind, folder, *facts = item.data(0, _FACTS)
        if kind == "run" and facts[0].report:
            show_file(facts[0].report)
        elif kind == "product" and facts[0].there:
            if can_show(facts[0]):
                self.act.zoom_to_product(facts[0], self._found[folder])
            elif facts[0].path.lower().endswith((".html", ".htm")):
                show_file(facts[0].path)

    def _ticked(self, item: QTreeWidgetItem, column: int) -> None:
        facts = item.data(0, _FACTS)
        if self._building or column != 0 or not facts or facts[0] != "product":
            return
        self.act.put_on_map(facts[2], self._found[facts[1]], item.checkState(0) == Qt.CheckState.Checked)


def _layers_by_path() -> dict[str, QgsMapLayer]:
    return {_real(layer_path(layer)): layer for layer in QgsProject.instance().mapLayers().values()}


def _real(path: str) -> str:
    from ..repm_qgis.contracts.paths import real_path

    return real_path(path) if path else ""


def _small(icon: QIcon) -> QIcon:
    """An icon beside thumbnails that are larger than it."""
    return QIcon(icon.pixmap(QSize(16, 16)))
