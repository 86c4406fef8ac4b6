"""An algorithm's dialog: Processing's own, with lists to choose from, and without what does not matter at the moment.

The widgets stay QGIS's: the graphical modeler and the batch dialog need them as they are, and do not load this module.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Callable, Mapping, Sequence

from processing.gui.AlgorithmDialog import AlgorithmDialog
from processing.gui.AlgorithmDialogBase import AlgorithmDialogBase
from processing.gui.ParametersPanel import ParametersPanel
from qgis.core import (
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingParameterDefinition,
    QgsProject,
    QgsVectorLayer,
)
from qgis.gui import QgsMapLayerComboBox
from qgis.PyQt import sip
from qgis.PyQt.QtCore import QCoreApplication, QPoint
from qgis.PyQt.QtWidgets import QComboBox, QLineEdit, QMenu, QStyle, QVBoxLayout, QWidget
from qgis.utils import iface

from ..processing_provider.last_scene import last_scene
from ..processing_provider.styles import hillshades
from ..processing_provider.values import is_empty
from ..repm_qgis.options import PRESETS
from .next_step import STEPS, push_message

_OF_COLMAP = ("GEOMETRIC", "COLMAP_FUSION", "WINDOW_RADIUS", "GPU_MEMORY")


class Dialog(AlgorithmDialog):
    """Processing's dialog with our panel in it."""

    def getParametersPanel(self, alg: QgsProcessingAlgorithm, parent: Any) -> Panel:
        return Panel(parent, alg, self.in_place, self.active_layer)

    _given: Mapping[str, Any] = {}  # of the last run

    def runAlgorithm(self) -> None:
        """Keeps what the run is given: the widgets may be changed before it ends."""
        self._given = {}
        with suppress(AlgorithmDialogBase.InvalidParameterValue):  # Processing says so itself
            self._given = self.createProcessingParameters()
        super().runAlgorithm()

    def finish(self, successful: bool, result: Any, *more: Any, **named: Any) -> None:
        """Offers the next step on the map, and here as well, where this dialog stays open."""
        super().finish(successful, result, *more, **named)
        if successful:
            text, buttons = STEPS.after(iface, self.algorithm().name(), self._given, result)
            if buttons and self.isVisible():
                closing = [(title, lambda run=run: (self.close(), run())) for title, run in buttons]
                push_message(self.messageBar(), text, closing)


class Panel(ParametersPanel):
    """Processing's panel of parameters; what it adds depends on which parameters there are."""

    def initWidgets(self) -> None:
        super().initWidgets()
        for name in ("VERTICAL_DATUM", "GCP_DATUM"):
            self._offer(name, _datums)
        self._offer("VIEW", lambda: self._named("views", "name"))
        self._offer("TILE", lambda: self._named("tiles", "id"))
        self._take_up_last_scene()
        if "BACKEND" in self.wrappers:
            colmap = self._together(_OF_COLMAP)
            self._follow("BACKEND", lambda: colmap.setVisible(self._value("BACKEND") == "colmap"))
        self._leave_out_hillshades(QgsProject.instance())
        self._preset = "none"
        self._follow("PRESET", self._fill_in)

    def setParameters(self, parameters: Mapping[str, Any]) -> None:
        """QGIS opens each file of a list as a layer, and drops those that are none, such as scenes and RPCs."""
        super().setParameters({name: self._kept(name, value) for name, value in parameters.items()})

    def _kept(self, name: str, value: Any) -> Any:
        """A list of files as layers without a provider, which keep their source whatever it is."""
        definition = self.algorithm().parameterDefinition(name)
        if definition is None or definition.type() != "multilayer" or is_empty(value):
            return value
        any_file = definition.layerType() == QgsProcessing.SourceType.TypeFile

        def is_dropped(file: Any) -> bool:
            return isinstance(file, str) and (any_file or file.lower().endswith(".json"))  # scenes among rasters

        files = value if isinstance(value, (list, tuple)) else [value]
        return [QgsVectorLayer(file, "", "none") if is_dropped(file) else file for file in files]

    def _value(self, name: str) -> Any:
        return self.wrappers[name].parameterValue()

    def _set(self, name: str, value: Any) -> None:
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
        from ..repm_qgis.errors import RepmError
        from ..repm_qgis.scene import Scene

        try:
            found = getattr(Scene.load(str(self._value("SCENE") or "")), part)
        except RepmError:
            return []
        return [(getattr(each, name), getattr(each, name)) for each in found]

    def _leave_out_hillshades(self, project: QgsProject) -> None:
        """A list of layers names each DSM once: its hillshade has the same source, and QGIS offers it first."""
        shades = hillshades(project)
        if not shades:
            return
        for box in self.findChildren(QComboBox):
            if box.metaObject().className() == "QgsMapLayerComboBox":
                box = sip.cast(box, QgsMapLayerComboBox)  # Python takes it for what it knows
                box.setExceptedLayerList([*box.exceptedLayerList(), *shades])

    def _take_up_last_scene(self) -> None:
        optional = QgsProcessingParameterDefinition.Flag.FlagOptional
        definition = self.algorithm().parameterDefinition("SCENE")
        if definition is None or definition.flags() & optional:
            return
        scene = last_scene(self.algorithm().name())
        if scene:
            self._set("SCENE", scene)

    def _together(self, names: Sequence[str]) -> QWidget:
        """Move parameters that follow each other into a widget, to show and hide them together.

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
        """Put a preset's values into their widgets, and take out those of the preset before that nobody has changed."""
        before, now = PRESETS[self._preset], PRESETS[str(self._value("PRESET"))]
        self._preset = str(self._value("PRESET"))
        for name, value in before.items():
            if name not in now and self._value(name.upper()) == value:
                self._set(name.upper(), self.algorithm().parameterDefinition(name.upper()).defaultValue())
        for name, value in now.items():
            self._set(name.upper(), value)

    def tr(self, text: str) -> str:
        return QCoreApplication.translate("Panel", text)


def _datums() -> list[tuple[str, str]]:
    """The vertical datums that are offered, with PROJ's names."""
    from ..repm_qgis.geometry.vertical import LISTED, HeightDatum

    return [("", QCoreApplication.translate("Panel", "WGS 84 ellipsoid"))] + [
        (word, f"{word}  ({HeightDatum.of(word).name})") for word in LISTED
    ]
