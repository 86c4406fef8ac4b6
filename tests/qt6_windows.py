"""Every class of desktop/ on PyQt6 and stand-ins: made, its buttons pressed, its events sent.

:func:`watch` notes which classes are made; :func:`use` uses them as a user would, with small simulated images. What a
button does outside (packages, files of the user, the browser) is noted in its place. An exception in a slot of Qt ends
the program on PyQt6, and so the test.
"""

from __future__ import annotations

import importlib
import inspect
import os
import pathlib
import shutil
import tempfile
from collections import defaultdict
from unittest import mock

import qt6_gui_stubs as gui
from PyQt6 import QtCore, QtGui, QtWidgets

MADE, BUTTONS, PRESSED = set(), defaultdict(set), defaultdict(set)
Qt, Box = QtCore.Qt, QtWidgets.QMessageBox.StandardButton
LEFT, RIGHT, NONE = Qt.MouseButton.LeftButton, Qt.MouseButton.RightButton, Qt.MouseButton.NoButton
RESULTS = {
    **{"PAIR": ["a.tif", "b.tif"], "TRIPLET": ["a.tif", "b.tif", "c.tif"], "SCENE": "scene.json"},
    **{"OUTPUT_SCENE": "scene.json", "EAST": 1.0, "NORTH": 2.0, "UP": 2.0},
}
ANSWERS = {}  # of file dialogs and questions, by the function's name


def watch(names):
    """Note every object of the classes of these modules."""
    for name in names:
        for kind in vars(importlib.import_module(name)).values():
            if inspect.isclass(kind) and kind.__module__ == name and not issubclass(kind, tuple):
                kind.__init__ = _noting(kind, kind.__init__)


def _noting(kind, init):
    def noted(own, *given, **named):
        MADE.add(kind.__name__)
        init(own, *given, **named)

    return noted


def _answer_instead():
    """Windows that wait for the user give an answer at once, if their arguments are those of Qt 6."""
    kinds = {
        (QtWidgets.QFileDialog, "getOpenFileNames"): (QtWidgets.QWidget, str, str, str),
        (QtWidgets.QFileDialog, "getOpenFileName"): (QtWidgets.QWidget, str, str, str),
        (QtWidgets.QFileDialog, "getSaveFileName"): (QtWidgets.QWidget, str, str, str),
        (QtWidgets.QFileDialog, "getExistingDirectory"): (QtWidgets.QWidget, str, str),
        (QtWidgets.QInputDialog, "getDouble"): (QtWidgets.QWidget, str, str, float, float, float, int),
        (QtWidgets.QMessageBox, "question"): (QtWidgets.QWidget, str, str, Box),
        (QtGui.QDesktopServices, "openUrl"): (QtCore.QUrl,),
    }
    for (owner, name), arguments in kinds.items():

        def answer(*given, name=name, arguments=arguments):
            wrong = [value for value, kind in zip(given, arguments) if not isinstance(value, kind)]
            if wrong or len(given) > len(arguments):
                raise TypeError(f"{name}{given}")
            return ANSWERS[name]

        setattr(owner, name, staticmethod(answer))


def press(window, *texts):
    """Press the buttons of a window that can be pressed, or those with these texts; all that it has are noted."""
    name = type(window).__name__
    for button in window.findChildren(QtWidgets.QPushButton):
        BUTTONS[name].add(button.text())
        if not (button.isEnabled() and (not texts or button.text() in texts)):
            continue
        if button.menu() is not None:  # it waits for a choice while it is open
            button.menu().aboutToShow.emit()
            for action in button.menu().actions():
                action.trigger()
        else:
            button.click()
        PRESSED[name].add(button.text())
        QtWidgets.QApplication.processEvents()


def _mouse(kind, x, y, button=NONE, buttons=NONE):
    place = QtCore.QPointF(x, y)
    return QtGui.QMouseEvent(kind, place, place, button, buttons, Qt.KeyboardModifier.NoModifier)


def _click(widget, x, y, button=LEFT):
    for kind in (QtCore.QEvent.Type.MouseButtonPress, QtCore.QEvent.Type.MouseButtonRelease):
        QtWidgets.QApplication.sendEvent(widget, _mouse(kind, x, y, button, button))


def _key(target, key, modifier=Qt.KeyboardModifier.NoModifier):
    event = QtGui.QKeyEvent(QtCore.QEvent.Type.KeyPress, key, modifier)
    if isinstance(target, QtWidgets.QWidget):
        QtWidgets.QApplication.sendEvent(target, event)
    else:
        target.keyPressEvent(event)


def use(menu, parts, engine):
    """Use all windows; gives what the test looks at. ``engine`` is the package repm_qgis."""
    stages, progress = (importlib.import_module(f"{engine}.{name}") for name in ("stages", "runtime.progress"))
    _answer_instead()
    ANSWERS["openUrl"] = True
    with tempfile.TemporaryDirectory(prefix="repm-qt6-") as name:
        folder = pathlib.Path(name)
        options = {"folder": str(folder / "sample"), "kind": "urban", "size": 240, "seed": 3}
        sample = stages.run_stage("sampledata", options, progress.Silent())
        first_steps(menu, sample)
        install(menu)
        grids(menu, folder)
        control_points(menu, parts, sample, folder)
        edit(menu, parts, sample, folder, lambda given: stages.run_stage("editdsm", given, progress.Silent()))
        fit = {"images": sample.images, "workspace": str(folder / "old town")}
        scenes(menu, stages.run_stage("epmfit", fit, progress.Silent()), folder / "old town")
        dialogs(menu, parts)
        copy_model(menu, folder)
        for action in menu._hillshades._action, *menu._actions:
            action.trigger()
        for window in QtWidgets.QApplication.topLevelWidgets():
            if isinstance(window, QtWidgets.QDialog):
                window.close()
    return {
        "made": sorted(MADE),
        "left": {
            window: sorted(texts - PRESSED[window]) for window, texts in BUTTONS.items() if texts - PRESSED[window]
        },
        "pressed": {window: sorted(texts) for window, texts in PRESSED.items()},
        "settings": gui.Setting.MADE,
    }


def first_steps(menu, sample):
    module = importlib.import_module(menu.first_steps.__module__.replace(".menu", ".first_steps"))
    menu.first_steps()
    installation = importlib.import_module(type(menu).__module__).installation
    with mock.patch.object(installation, "state", lambda: installation.MISSING):
        menu._panel.refresh()
        press(menu._panel)
        offer = importlib.import_module(f"{module.__package__}.install")
        QtCore.QSettings().remove(offer.OFFERED)
        message = offer.offer_once(menu._iface, menu.install)
        press(message)
        menu._iface.messageBar().popWidget(message)
    gui.DIALOGS[-1].algorithmFinished.emit(True, {"FOLDER": os.path.dirname(sample.images[0])})
    press(menu._panel)
    assert gui.DIALOGS[-1].algorithm().name() == "pipeline", "the step after the images"


def install(menu):
    """Nothing is installed or removed: the two functions that do it are noted in their place."""
    done = []
    menu.install()
    dialog, installation = menu._installer, importlib.import_module(type(menu).__module__).installation
    with mock.patch.multiple(
        installation,
        install=lambda *given: done.append(given),
        remove=lambda feedback: feedback.pushInfo("removed"),
        folders=lambda: ["an environment"],
    ):
        dialog._plan()
        assert dialog.packages.topLevelItemCount() > 2, dialog.where.text()
        press(dialog, "Install", "Cancel")
        task = dialog._task
        assert task.cancelled and task.run() and len(done) == 1
        task.feedback.pushInfo("a line")
        task.feedback.setProgressText("a step")
        task.feedback.progressChanged.emit(50.0)
        task.finished(True)
        assert "a line" in dialog.log.toPlainText() and dialog._task is None
        ANSWERS["question"] = Box.Yes
        with mock.patch.object(os.path, "exists", lambda path: True):
            dialog._show_state()
        press(dialog, "Remove the environment")
        assert "removed" in dialog.log.toPlainText()
        dialog.open_log.setEnabled(True)
        press(dialog, "Open the log", "Close")


def grids(menu, folder):
    dialog = menu.geoid_grids()
    module = importlib.import_module(type(dialog).__module__)
    with mock.patch.multiple(module, user_folder=lambda: str(folder), is_there=lambda name: False):
        dialog.refresh()
        press(dialog)
        dialog._loading.downloadProgress.emit(1, 2)
        assert dialog.bar.value() == 50
        dialog._loading.downloadError.emit(["no network"])
        assert "no network" in dialog.said.text()
        press(dialog)
        dialog._loading.downloadCompleted.emit(QtCore.QUrl("https://example.org"))
        assert "could not be fetched" in dialog.said.text()  # nothing came
    with mock.patch.object(module, "is_there", lambda name: True):
        dialog.refresh()
    texts = {button.text() for button in dialog.buttons.values()}
    assert texts == {"Installed"}
    BUTTONS[type(dialog).__name__] -= texts  # they are labels then


def control_points(menu, parts, sample, folder):
    dock = menu.measure_control_points()
    ANSWERS["getOpenFileNames"] = (sample.images, "")
    press(dock, "1. Images or scene…")
    assert len(dock.panels) == len(sample.images), dock.said.text()
    rpc = dock.measuring.views[0].rpc
    table = folder / "points.csv"
    rows = [f"p{step},{rpc.lon_off + 1e-5 * step},{rpc.lat_off},{rpc.height_off}" for step in range(3)]
    table.write_text("\n".join(["id,lon,lat,height", *rows]), encoding="utf-8")
    ANSWERS["getOpenFileName"] = (str(table), "")
    gui.QgsProject.instance().addMapLayer(gui.QgsVectorLayer(str(table), "points", "ogr"))
    press(dock, "2. Points")
    assert len(dock.measuring.points) == 3, dock.said.text()
    dock.resize(1200, 500)
    QtWidgets.QApplication.processEvents()
    image = dock.panels[0].image
    image.grab()  # paints it
    _click(image, 90, 70)
    for key in (Qt.Key.Key_Left, Qt.Key.Key_Return, Qt.Key.Key_Plus, Qt.Key.Key_Minus, Qt.Key.Key_Home, Qt.Key.Key_S):
        _key(image, key)
    _key(image, Qt.Key.Key_Up, Qt.KeyboardModifier.ShiftModifier)
    place, delta, modifier = QtCore.QPointF(20, 20), QtCore.QPoint(0, 120), Qt.KeyboardModifier.NoModifier
    wheel = QtGui.QWheelEvent(place, place, delta, delta, NONE, modifier, Qt.ScrollPhase.NoScrollPhase, False)
    QtWidgets.QApplication.sendEvent(image, wheel)
    for kind, x in (("MouseButtonPress", 20), ("MouseMove", 60), ("MouseButtonRelease", 60)):
        QtWidgets.QApplication.sendEvent(image, _mouse(QtCore.QEvent.Type[kind], x, 20, LEFT, LEFT))
    _click(dock.panels[1].image, 90, 70)
    QtWidgets.QApplication.processEvents()
    image.grab()
    assert dock.table.check(0).distance_m > 0 and "Point p" in dock.said.text()
    dock.rows.grab()
    tick, height = dock.table.index(1, 4), dock.table.index(1, 5)
    assert dock.table.setData(tick, Qt.CheckState.Checked.value, Qt.ItemDataRole.CheckStateRole)
    assert dock.table.data(tick, Qt.ItemDataRole.CheckStateRole) == Qt.CheckState.Checked
    assert dock.table.setData(height, "12.5") and not dock.table.setData(height, "high")
    ANSWERS["getSaveFileName"] = (str(folder / "saved"), "")
    ANSWERS["getDouble"] = (10.0, True)
    press(dock, "New point on the map")
    assert parts.canvas.mapTool() is dock._tool
    dock._tool.canvasClicked.emit(gui.QgsPointXY(rpc.lon_off, rpc.lat_off), LEFT)
    assert len(dock.measuring.points) == 4
    for shortcut in dock.findChildren(QtGui.QShortcut):
        shortcut.activated.emit()
    assert (folder / "saved.csv").exists()
    press(dock)
    dock._path = ""
    dock.measuring.measure(dock._current, dock.panels[0].name, [1.0, 1.0])
    ANSWERS["question"] = Box.Save
    dock.close()


def edit(menu, parts, sample, folder, apply):
    dsm = str(folder / "dsm.tif")
    shutil.copy(sample.truth, dsm)
    layer = gui.QgsRasterLayer(dsm, "dsm")
    gui.QgsProject.instance().addMapLayer(layer)
    dock = menu.edit_dsm()
    menu._iface.setActiveLayer(layer)
    dock._follow_layer(layer)
    assert dock.records is not None, dock.said.text()
    middle, tool = layer.extent().center(), dock._tool

    def event(x, y, button=LEFT):
        return mock.Mock(button=lambda: button, mapPoint=lambda: gui.QgsPointXY(middle.x() + x, middle.y() + y))

    def draw(*places, button=RIGHT):
        for x, y in places:
            tool.canvasMoveEvent(event(x, y))
            tool.canvasReleaseEvent(event(x, y))
        tool.canvasReleaseEvent(event(0, 0, button))

    press(dock, "Polygon")
    draw((0, 0), (9, 0), (9, 9), (0, 9))
    assert len(dock.records.edits) == 1, dock.said.text()
    task = dock._task
    apply({name.lower(): task.parameters[name] for name in ("DSM", "EDITS", "OUTPUT")})
    task.executed.emit(True, {})
    assert os.path.exists(dock.records.edited), dock.said.text()
    draw((0, 0), (5, 0), (5, 5))  # a run that fails takes its edit back
    dock._task.executed.emit(False, {})
    assert len(dock.records.edits) == 1, dock.said.text()
    dock.operation.setCurrentIndex(dock.operation.findData("flatten"))
    dock.operation.setCurrentIndex(dock.operation.findData("remove"))
    press(dock, "Brush")
    tool.canvasPressEvent(event(0, 0))
    for x in (2, 4, 6):
        tool.canvasMoveEvent(event(x, 1))
    tool.canvasReleaseEvent(event(6, 1))
    assert len(dock.records.edits) == 2, dock.said.text()
    dock.operation.setCurrentIndex(dock.operation.findData("breakline"))
    press(dock, "Line")
    _key(tool, Qt.Key.Key_Backspace)
    draw((0, 0), (20, 0))
    assert len(dock.records.edits) == 3, dock.said.text()
    for key in (Qt.Key.Key_Escape, Qt.Key.Key_A):
        _key(tool, key)
    dock.list.item(0).setCheckState(Qt.CheckState.Unchecked)
    assert not dock.records.edits[0].enabled
    parts.canvas.scaleChanged.emit(2.0)
    for shortcut in dock.findChildren(QtGui.QShortcut):
        shortcut.activated.emit()
    press(dock, "Undo")
    assert len(dock.records.edits) == 1
    feedback = dock._run[2]
    feedback.pushWarning("a note")
    feedback.reportError("an error")
    dock.close()


def scenes(menu, fitted, folder):
    """A workspace that is added, with a picture of each image, a product on the map, and all actions of its items."""
    dock = menu.scenes()
    module = importlib.import_module(type(dock).__module__)
    ANSWERS.update(getExistingDirectory=str(folder), question=Box.Cancel)
    dsm = folder / "dsm.tif"
    layers = gui.QgsProject.instance().mapLayers().values()
    shutil.copy(next(each.source() for each in layers if isinstance(each, gui.QgsRasterLayer)), dsm)

    def read():
        while dock.is_reading():
            QtWidgets.QApplication.processEvents()

    with mock.patch.object(module, "is_lasting", lambda path: True):
        press(dock, "Add a workspace…", "Refresh")
        read()
    item = dock.item_of(str(folder))
    parts = [item.child(row) for row in range(item.childCount())]
    assert [part.data(0, Qt.ItemDataRole.UserRole)[2] for part in parts] == ["image", "run", "product"]
    parts[0].setExpanded(True)
    read()
    assert not parts[0].child(0).icon(0).isNull()
    kept = mock.patch.multiple(dock.act, _zoom=mock.DEFAULT, forget=mock.DEFAULT, make_page=mock.DEFAULT)
    actions = importlib.import_module(type(dock.act).__module__)
    with mock.patch.object(actions.styles.LayerStyler, "postProcessLayer"), kept:
        for each in (item, *(part.child(0) for part in parts)):
            dock.tree.setCurrentItem(each)
            dock.tree.itemDoubleClicked.emit(each, 0)
            press(dock, "What next")
        product = next(each for each in dock._items() if each.text(0) == "DSM")
        product.setCheckState(0, Qt.CheckState.Checked)
    dock.tree.customContextMenuRequested.emit(dock.tree.visualItemRect(product).center())
    popup = QtWidgets.QApplication.activePopupWidget()
    if popup is not None:
        popup.close()
    ANSWERS["question"] = Box.Yes
    dock.act.remove(str(folder), [product.data(0, Qt.ItemDataRole.UserRole)[2]])
    read()
    assert not dsm.exists()
    shutil.rmtree(folder)
    dock.refresh()
    read()
    dock.act.relink(str(folder))
    dock.act.forget(str(folder))


def dialogs(menu, parts):
    """The dialog of every algorithm, its lists and presets, and what a run leads to."""
    from qgis.core import QgsApplication

    steps = importlib.import_module(f"{type(menu).__module__.rpartition('.')[0]}.next_step")
    layer = gui.QgsProject.instance().mapLayers()
    dsm = next(each.source() for each in layer.values() if isinstance(each, gui.QgsRasterLayer))
    for algorithm in QgsApplication.processingRegistry().providerById("repm").algorithms():
        dialog = gui.create_algorithm_dialog(f"repm:{algorithm.name()}")
        dialog.show()
        for action in dialog.findChildren(QtGui.QAction, "list"):
            action.trigger()
            popup = QtWidgets.QApplication.activePopupWidget()
            for choice in popup.actions():
                choice.trigger()
            popup.close()
        for box in dialog.findChildren(QtWidgets.QComboBox):
            for index in range(box.count()):
                box.setCurrentIndex(index)
        dialog.panel.setParameters({name: wrapper.parameterValue() for name, wrapper in dialog.panel.wrappers.items()})
        press(dialog)
        assert dialog.runs == (2 if algorithm.name() == "pipeline" else 1)  # its button for a preview runs it, too
        dialog.finish(True, {**RESULTS, "OUTPUT": dsm, "DIFFERENCES": dsm}, None, None)
        _follow(parts.bar, algorithm.name())
        _follow(dialog.messageBar(), algorithm.name())
        dialog.close()
    registered = {"is_registered": lambda scene: True}
    with (
        mock.patch.multiple(steps, **registered),
        mock.patch.object(steps.last_scene, "of_surface", lambda dsm: "scene"),
    ):
        for algorithm in ("dsmfuse", "comparedsm"):
            steps.STEPS.after(
                menu._iface, algorithm, {"DSM": dsm, "SCENE": "scene.json", "REFERENCE": dsm}, {"OUTPUT": dsm}
            )
            _follow(parts.bar, f"{algorithm}, registered")
    with mock.patch.object(steps.last_scene, "of_surface", lambda dsm: "scene.json"):
        steps.STEPS.after(menu._iface, "comparedsm", {"DSM": dsm, "REFERENCE": dsm}, {})
        _follow(parts.bar, "comparedsm, not registered")
    MADE.add(type(steps.STEPS).__name__)  # the module makes it


def _follow(bar, after):
    """Press each button of a bar's messages; one that opens a dialog takes its message away."""
    for message in bar.items():
        for button in message.findChildren(QtWidgets.QPushButton):
            PRESSED["next steps"].add(f"{after}: {button.text()}")
            button.click()
            QtWidgets.QApplication.processEvents()
        if message in bar.items():
            bar.popWidget(message)


def copy_model(menu, folder):
    from qgis.core import QgsProcessingModelAlgorithm

    module = importlib.import_module(f"{type(menu).__module__.rpartition('.')[0]}.model_copy")
    (action,) = menu._toolbox_actions
    action.itemData, action.toolbox = QgsProcessingModelAlgorithm(), QtWidgets.QWidget()
    with mock.patch.object(module.ModelerUtils, "modelsFolders", lambda: [str(folder / "models")], create=True):
        with mock.patch.object(module.ModelerDialog, "create", mock.MagicMock(), create=True) as create:
            assert action.isEnabled()
            action.execute()
            assert create.called and os.listdir(folder / "models")
