"""An algorithm's dialog: Processing's own, with lists to choose from, and without parameters that have no effect at the
moment.

The widgets stay QGIS's: the graphical modeler and the batch dialog need them as they are, and do not load this module.
"""

from __future__ import annotations

import os
from contextlib import suppress
from typing import Callable, Mapping, Sequence

from processing.gui.AlgorithmDialog import AlgorithmDialog
from processing.gui.AlgorithmDialogBase import AlgorithmDialogBase
from processing.gui.ParametersPanel import ParametersPanel
from qgis.core import (
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingParameterDefinition,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QCoreApplication, QEvent, QPoint
from qgis.PyQt.QtWidgets import (
    QAbstractSpinBox,
    QCheckBox,
    QComboBox,
    QGroupBox,
    QLabel,
    QLineEdit,
    QMenu,
    QStyle,
    QVBoxLayout,
    QWidget,
)
from qgis.utils import iface

from ..processing_provider import settings, words
from ..processing_provider.kept import (
    PLACES,
    folder_for_products,
    in_folder,
    is_temporary,
    propose_for_many,
    propose_workspace,
)
from ..processing_provider.last_scene import last_scene
from ..processing_provider.values import any_paths, is_empty
from ..repm_qgis.contracts.documents import JsonMapping
from ..repm_qgis.contracts.options import PRESETS
from .arrival import bring_into_sight
from .next_step import STEPS, push_message
from .preview import PREVIEWED, of_preview, preview_button

_OF_SETTINGS = (*settings.COLMAP, "CLUSTER")  # the options page has these, for all runs
_FOLDERS = set("/\\:")
_LEAST_GROUPS = 3  # at least so many parameters below a heading


class Dialog(AlgorithmDialog):
    """Processing's dialog with our panel in it."""

    _previews = False  # what runs is a preview

    def getParametersPanel(self, alg: QgsProcessingAlgorithm, parent: object) -> Panel:
        self._preview_button = preview_button(self, self._preview) if alg.name() == PREVIEWED else None
        return Panel(parent, alg, self.in_place, self.active_layer)

    _given: Mapping[str, object] = {}  # of the last run
    _failed = False  # while QGIS finishes a run that failed
    _in_use: set[Dialog] = set()
    """Dialogs that are shown or run something. Python 3.14 forgets one that nobody else refers to, such as one of
    ``processing.createAlgorithmDialog``; the run then uses objects that no longer exist, and QGIS crashes."""

    def showEvent(self, event: QEvent) -> None:
        self._in_use.add(self)
        super().showEvent(event)

    def hideEvent(self, event: QEvent) -> None:
        super().hideEvent(event)
        if not self.cancelButton().isEnabled():  # else it runs something
            self._in_use.discard(self)

    def runAlgorithm(self) -> None:
        """Keeps the parameters of the run: the widgets may be changed before it ends."""
        self._given = {}
        with suppress(AlgorithmDialogBase.InvalidParameterValue):  # Processing says so itself
            self._given = self.mainWidget().createProcessingParameters()
        super().runAlgorithm()

    def _preview(self) -> None:
        """Run the algorithm on reduced images, of all the ground that they show; the parameters here stay."""
        self._previews = True
        try:
            self.runAlgorithm()
        finally:
            self._previews = False

    def createProcessingParameters(self, *how: object, **named: object) -> dict[str, object]:
        parameters = super().createProcessingParameters(*how, **named)
        return of_preview(parameters) if self._previews else parameters

    def blockAdditionalControlsWhileRunning(self) -> None:
        super().blockAdditionalControlsWhileRunning()
        self._enable_preview(False)

    def resetAdditionalGui(self) -> None:
        super().resetAdditionalGui()
        self._enable_preview(True)

    def _enable_preview(self, enabled: bool) -> None:
        if self._preview_button is not None:
            self._preview_button.setEnabled(enabled)

    def finish(self, successful: bool, result: JsonMapping, *more: object, **named: object) -> None:
        """Offers the next step on the map, and here as well, where this dialog stays open."""
        self._failed = not successful
        try:
            super().finish(successful, result, *more, **named)
        finally:
            self._failed = False
        if not self.isVisible():
            self._in_use.discard(self)
        if successful:
            bring_into_sight(iface, result.values())
            text, buttons = STEPS.after(iface, self.algorithm().name(), self._given, result)
            if buttons and self.isVisible():
                push_message(self.messageBar(), text, [(title, self._closing(run)) for title, run in buttons])

    def setInfo(self, text: str, *more: object, **named: object) -> None:
        """QGIS says that a run that failed has finished and made a page, too."""
        if not self._failed:
            super().setInfo(text, *more, **named)

    def _closing(self, run: Callable[[], object]) -> Callable[[], None]:
        """The action of a button of this dialog: the next step's dialog opens where this one stood."""

        def close_and_run() -> None:
            self.close()
            run()

        return close_and_run


class Panel(ParametersPanel):
    """Processing's panel of parameters; its additions depend on the parameters of the algorithm."""

    def initWidgets(self) -> None:
        super().initWidgets()
        for name in ("VERTICAL_DATUM", "GCP_DATUM"):
            self._offer(name, _datums)
        self._offer("REFERENCE_DATUM", _reference_datums)
        self._offer("VIEW", lambda: self._named("views", "name"))
        self._offer("TILE", lambda: self._named("tiles", "id"))
        self._take_up_last_scene()
        self._narrow()
        self._in_words()
        self._hint()
        self._left = {name: self._together((name,)) for name in _OF_SETTINGS if name in self.wrappers}
        for name in self._left:
            self._set(name, "" if name == "CLUSTER" else settings.of_parameter(name))
            self._follow(name, self._show_what_differs)
        self._head()
        self._preset = "none"
        self._follow("PRESET", self._fill_in)
        self._proposed = ""
        if "WORKSPACE" in self.wrappers:
            for name in ("IMAGES", "FOLDER", "TABLE"):
                self._follow(name, self._propose_workspace)
        outputs = (each.name() for each in self.algorithm().parameterDefinitions() if each.isDestination())
        lines = {name: self._line_of(name) for name in outputs}
        self._skipped: set[str] = set()
        self._lines = {name: line for name, line in lines.items() if line is not None}
        for line in self._lines.values():  # QGIS does not tell of what is typed into them
            line.textChanged.connect(lambda *_: self._show_places())
        for name in set(PLACES) & set(self.wrappers):
            self.wrappers[name].widgetValueHasChanged.connect(lambda *_: self._show_places())
        self._show_places()

    def createProcessingParameters(self, *how: object, **named: object) -> dict[str, object]:
        typed = {name for name, line in self._lines.items() if line.text().strip() and not _FOLDERS & set(line.text())}
        parameters = super().createProcessingParameters(*how, **named)
        return in_folder(self.algorithm(), parameters, typed, self.processing_context)

    def setParameters(self, parameters: Mapping[str, object]) -> None:
        """QGIS opens each file of a list as a layer, and drops those that are no layers, such as scenes and RPCs."""
        super().setParameters({name: self._kept(name, value) for name, value in parameters.items()})

    def _kept(self, name: str, value: object) -> object:
        """A list of files as layers without a provider, which keep their source whatever it is."""
        definition = self.algorithm().parameterDefinition(name)
        if definition is None or definition.type() != "multilayer" or is_empty(value):
            return value
        any_file = definition.layerType() == QgsProcessing.SourceType.TypeFile

        def is_dropped(file: str) -> bool:
            return isinstance(file, str) and (any_file or file.lower().endswith(".json"))  # scenes among rasters

        files = value if isinstance(value, (list, tuple)) else [value]
        return [QgsVectorLayer(file, "", "none") if is_dropped(file) else file for file in files]

    def _narrow(self) -> None:
        """Keep texts from making the panel wider than QGIS opens it: its buttons would lie outside."""
        for wrapper in self.wrappers.values():
            label = getattr(wrapper, "wrappedLabel", lambda: None)()
            if isinstance(label, QLabel):
                label.setWordWrap(True)
        for box in self.findChildren(QComboBox):
            box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
            box.setMinimumContentsLength(8)

    def _in_words(self) -> None:
        """Show choices in words; their values stay those of commands."""
        for definition in self.algorithm().parameterDefinitions():
            if definition.type() == "enum" and definition.usesStaticStrings() and definition.name() in self.wrappers:
                box = self.wrappers[definition.name()].wrappedWidget()
                for index in range(box.count() if isinstance(box, QComboBox) else 0):
                    value = box.itemData(index)
                    if isinstance(value, str):
                        box.setItemText(index, words.shown(definition.name(), value))

    def _hint(self) -> None:
        """Show what an empty line or a zero means, in its place."""
        for name, text in words.hints().items():
            widget = self.wrappers[name].wrappedWidget() if name in self.wrappers else None
            if isinstance(widget, QLineEdit):
                widget.setPlaceholderText(text)
            elif isinstance(widget, QWidget):
                empty = self.algorithm().parameterDefinition(name).defaultValue() is None  # else QGIS's "Not set" stays
                for box in (each for each in (widget, *widget.findChildren(QAbstractSpinBox))):
                    if isinstance(box, QAbstractSpinBox) and (empty or not box.specialValueText()):
                        box.setSpecialValueText(text)

    def _show_what_differs(self) -> None:
        """Parameters that the options page has are shown where this run's value is another one, as from the history."""
        for name, inner in self._left.items():
            usual = "" if name == "CLUSTER" else settings.of_parameter(name)
            value = self._value(name)
            inner.setVisible((value or "") != usual if name == "CLUSTER" else value != usual)
        advanced = QgsProcessingParameterDefinition.Flag.FlagAdvanced
        for group in self.findChildren(QGroupBox):  # of the advanced parameters, where there are others in it
            names = {each.name() for each in self.algorithm().parameterDefinitions() if each.flags() & advanced}
            group.setVisible(bool(names - set(self._left)) or any(not each.isHidden() for each in self._left.values()))

    def _head(self) -> None:
        """Show advanced parameters under headings, where they are many."""
        advanced = QgsProcessingParameterDefinition.Flag.FlagAdvanced
        found = []
        for title, names in words.groups():
            first = next((name for name in self.algorithm().parameterDefinitions() if name.name() in names), None)
            if first is not None and first.flags() & advanced and first.name() in self.wrappers:
                found.append((title, first.name()))
        self._headings = []  # without a reference from here, Python removes them
        for title, name in found if len(found) >= _LEAST_GROUPS else ():
            wrapper = self.wrappers[name]
            row = wrapper.wrappedLabel() or wrapper.wrappedWidget()
            layout = row.parentWidget().layout()
            heading = QLabel(f"<b>{title}</b>")
            heading.setObjectName("heading")
            heading.setContentsMargins(0, 10, 0, 0)
            layout.insertWidget(layout.indexOf(row), heading)
            self._headings.append(heading)

    def _value(self, name: str) -> object:
        return self.wrappers[name].parameterValue()

    def _set(self, name: str, value: object) -> None:
        self.wrappers[name].setParameterValue(value, self.processing_context)

    def _follow(self, name: str, act: Callable[[], None]) -> None:
        """Act now, and whenever a parameter has another value."""
        if name in self.wrappers:
            self.wrappers[name].widgetValueHasChanged.connect(lambda *_: act())
            act()

    def _offer(self, name: str, known: Callable[[], Sequence[tuple[str, str]]]) -> None:
        """A list of known words, each with its label, in a parameter's line; any other text can be written as well."""
        line = self.wrappers[name].wrappedWidget() if name in self.wrappers else None
        if not isinstance(line, QLineEdit):
            return
        arrow = line.style().standardIcon(QStyle.StandardPixmap.SP_TitleBarUnshadeButton)
        action = line.addAction(arrow, QLineEdit.ActionPosition.TrailingPosition)
        action.setToolTip(self.tr("Choose from a list"))
        action.setObjectName("list")

        def choose() -> None:
            menu = QMenu(line)
            for word, label in known():
                menu.addAction(label).triggered.connect(lambda *_, word=word: line.setText(word))
            if menu.isEmpty():
                menu.addAction(self.tr("Choose a scene first")).setEnabled(False)
            menu.popup(line.mapToGlobal(QPoint(0, line.height())))

        action.triggered.connect(choose)

    def _named(self, part: str, name: str) -> list[tuple[str, str]]:
        """The names of the views or tiles of the scene that is chosen; none where there is none that can be read."""
        from ..repm_qgis.contracts.errors import RepmError
        from ..repm_qgis.scene import Scene

        try:
            found = getattr(Scene.load(str(self._value("SCENE") or "")), part)
        except RepmError:
            return []
        return [(getattr(each, name), getattr(each, name)) for each in found]

    def _take_up_last_scene(self) -> None:
        optional = QgsProcessingParameterDefinition.Flag.FlagOptional
        definition = self.algorithm().parameterDefinition("SCENE")
        if definition is None or definition.flags() & optional:
            return
        scene = last_scene(self.algorithm().name())
        if scene:
            self._set("SCENE", scene)

    def _propose_workspace(self) -> None:
        """A workspace that lasts, unless the user has chosen one."""
        if self._value("WORKSPACE") not in (None, "", QgsProcessing.TEMPORARY_OUTPUT, self._proposed):
            return
        if "IMAGES" in self.wrappers:
            images = any_paths(self._value("IMAGES"), self.processing_context, only_named=True)
            self._proposed = propose_workspace(images)
        else:
            self._proposed = propose_for_many(str(self._value("FOLDER") or self._value("TABLE") or ""))
        self._set("WORKSPACE", self._proposed or QgsProcessing.TEMPORARY_OUTPUT)

    def _line_of(self, name: str) -> QLineEdit | None:
        """The line of a destination."""
        return self.wrappers[name].wrappedWidget().findChild(QLineEdit) if name in self.wrappers else None

    def _folder(self) -> str:
        given = {name: self._value(name) for name in PLACES if name in self.wrappers}
        return folder_for_products(self.algorithm(), given, self.processing_context)

    def _show_places(self) -> None:
        """Show where products without a name go. A product that was skipped and gets a name is loaded, as others."""
        folder = self._folder()
        text = self.tr("[Save in {folder}]").format(folder=os.path.basename(folder)) if folder else ""
        for name, line in self._lines.items():
            box = self.wrappers[name].wrappedWidget().findChild(QCheckBox)
            if name in self._skipped and line.text() and box is not None:
                box.setChecked(True)
            if text and name != "WORKSPACE" and is_temporary(self._value(name)):
                line.setPlaceholderText(text)
        self._skipped = {name for name in self._lines if is_empty(self._value(name))}

    def _together(self, names: Sequence[str]) -> QWidget:
        """Move consecutive parameters into a widget, to show and hide them together.

        It lies in another one: the group of the advanced parameters shows all that lies in it when it is opened.
        """
        first = self.wrappers[names[0]].wrappedWidget().parentWidget()
        outer, inner = QWidget(first), QWidget()
        for widget in (outer, inner):
            QVBoxLayout(widget).setContentsMargins(0, 0, 0, 0)
        rows = [
            each for name in names for each in (self.wrappers[name].wrappedLabel(), self.wrappers[name].wrappedWidget())
        ]
        rows = [row for row in rows if row is not None]
        first.layout().insertWidget(first.layout().indexOf(rows[0]), outer)
        outer.layout().addWidget(inner)
        for row in rows:
            inner.layout().addWidget(row)
        return inner

    def _fill_in(self) -> None:
        """Put a preset's values into their widgets, and reset those of the preset before that nobody has changed."""
        before, now = PRESETS[self._preset], PRESETS[str(self._value("PRESET"))]
        self._preset = str(self._value("PRESET"))
        for name, value in before.items():
            if name not in now and self._value(name.upper()) == value:
                self._set(name.upper(), self.algorithm().parameterDefinition(name.upper()).defaultValue())
        for name, value in now.items():
            self._set(name.upper(), value)

    def tr(self, text: str) -> str:
        return QCoreApplication.translate("Panel", text)


def _reference_datums() -> list[tuple[str, str]]:
    """The entry for datums that references state themselves, then the known datums."""
    (_, ellipsoid), *others = _datums()
    return [("auto", words.automatic_datum()), ("ellipsoid", ellipsoid), *others]


def _datums() -> list[tuple[str, str]]:
    """The vertical datums that are offered, with PROJ's names."""
    from ..repm_qgis.geometry.vertical import LISTED, HeightDatum

    return [("", words.hints()["VERTICAL_DATUM"])] + [
        (word, f"{word}  ({HeightDatum.of(word).name})") for word in LISTED
    ]
