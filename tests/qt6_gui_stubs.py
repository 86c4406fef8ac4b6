"""Stand-ins for the part of QGIS 4's windows that the plugin's own windows use: layers, map, bars, Processing's dialog.

:mod:`qt6_stubs` puts them where ``import qgis`` and ``import processing`` find them. Their widgets are Qt's own, with
the signals and arguments of QGIS's classes; shapes are OGR's. No map is drawn, and no algorithm runs.
"""
# ruff: noqa: N815 - QGIS's names

from __future__ import annotations

import enum
import os
from types import SimpleNamespace
from unittest import mock

from osgeo import gdal, ogr
from PyQt6 import QtCore, QtWidgets

Signal = QtCore.pyqtSignal


def _need(value, kind):
    if not isinstance(value, kind):
        raise TypeError(f"{value!r} is no {kind}")
    return value


class QgsPointXY:
    def __init__(self, x=0.0, y=0.0):
        self._place = float(x), float(y)

    def x(self):
        return self._place[0]

    def y(self):
        return self._place[1]

    def __eq__(self, other):
        return isinstance(other, QgsPointXY) and self._place == other._place

    __hash__ = None


class QgsRectangle:
    def __init__(self, xmin, ymin, xmax, ymax):
        self._box = xmin, ymin, xmax, ymax

    def __eq__(self, other):
        return isinstance(other, QgsRectangle) and self._box == other._box

    __hash__ = None

    def center(self):
        return QgsPointXY((self._box[0] + self._box[2]) / 2, (self._box[1] + self._box[3]) / 2)

    def contains(self, point):
        return (
            self._box[0] <= _need(point, QgsPointXY).x() <= self._box[2] and self._box[1] <= point.y() <= self._box[3]
        )


GeometryType = enum.Enum("GeometryType", "PointGeometry LineGeometry PolygonGeometry UnknownGeometry NullGeometry")
QgsWkbTypes = type("QgsWkbTypes", (), {"GeometryType": GeometryType})


class QgsGeometry:
    def __init__(self, shape=None):
        self._shape = shape

    @staticmethod
    def _of(kind, points):
        text = ", ".join(f"{_need(point, QgsPointXY).x()!r} {point.y()!r}" for point in points)
        shape = f"{kind} (({text}))" if kind == "POLYGON" else f"{kind} ({text})"
        return QgsGeometry(ogr.CreateGeometryFromWkt(shape) if points else None)

    @classmethod
    def fromPolygonXY(cls, rings):
        return cls._of("POLYGON", [*rings[0], rings[0][0]])

    @classmethod
    def fromPolylineXY(cls, points):
        return cls._of("LINESTRING", points)

    @classmethod
    def fromMultiPointXY(cls, points):
        return cls._of("MULTIPOINT", points)

    def fromWkb(self, data):
        self._shape = ogr.CreateGeometryFromWkb(bytes(data))

    def asWkt(self, precision=17):
        return self._shape.ExportToWkt()

    def length(self):
        return self._shape.Length()

    def simplify(self, tolerance):
        return QgsGeometry(self._shape.Simplify(float(tolerance)))

    def transform(self, transform):
        _need(transform, QgsCoordinateTransform)
        return 0

    def type(self):
        return GeometryType.PolygonGeometry if self._shape.GetDimension() == 2 else GeometryType.LineGeometry


class QgsCoordinateTransform:
    """The map has the CRS of what lies on it."""

    def __init__(self, source, destination, project):
        _need(project, QgsProject)

    def transform(self, point):
        return _need(point, QgsPointXY)


class QgsMapLayer(QtCore.QObject):
    styleChanged, crsChanged, dataSourceChanged = Signal(), Signal(), Signal()
    LayerFlag = enum.Flag("LayerFlag", "Identifiable Removable Searchable Private")

    def __init__(self, path="", name="", provider=""):
        super().__init__()
        self._path, self._name, self._provider = path + "", name + "", provider + ""

    def id(self):
        return f"{self._name}_{id(self)}"

    def name(self):
        return self._name

    def setName(self, name):
        self._name = name + ""

    def source(self):
        return self._path

    def setDataSource(self, path, name, provider, options):
        self._path = path + ""
        self.dataSourceChanged.emit()

    def providerType(self):
        return self._provider

    def isValid(self):
        return os.path.exists(self._path)

    def styleManager(self):
        return mock.MagicMock(name="the layer's styles")

    def crs(self):
        return None

    def setCrs(self, crs):
        self.crsChanged.emit()

    def triggerRepaint(self):
        pass


class _LayerOptions:
    def __init__(self, load_default_style=True):
        _need(load_default_style, bool)


class QgsVectorLayer(QgsMapLayer):
    LayerOptions = _LayerOptions

    def __init__(self, path="", name="", provider="ogr", options=None):
        super().__init__(path, name, provider)

    def geometryType(self):
        return GeometryType.PointGeometry

    def subsetString(self):
        return ""


class QgsRasterLayer(QgsMapLayer):
    LayerOptions = _LayerOptions

    def __init__(self, path="", name="", provider="gdal", options=None):
        super().__init__(path, name, provider)
        self._raster = gdal.Open(path)

    def bandCount(self):
        return self._raster.RasterCount

    def bandName(self, band):
        return self._raster.GetRasterBand(band).GetDescription()

    def width(self):
        return self._raster.RasterXSize

    def height(self):
        return self._raster.RasterYSize

    def extent(self):
        x, cell, _, y, _, _ = self._raster.GetGeoTransform()
        return QgsRectangle(x, y - cell * self.height(), x + cell * self.width(), y)


class QgsProviderRegistry:
    @classmethod
    def instance(cls):
        return cls()

    def decodeUri(self, provider, source):
        return {"path": source + ""}


class QgsProject(QtCore.QObject):
    readProject, writeProject = Signal(object), Signal(object)
    layersAdded, layersRemoved, cleared = Signal(object), Signal(object), Signal()
    _own = None

    @classmethod
    def instance(cls):
        cls._own = cls._own or cls()
        return cls._own

    def __init__(self):
        super().__init__()
        self._layers, self._tree = {}, mock.MagicMock(name="layer tree")
        self._tree.findLayers.return_value = []
        self._tree.findLayer.return_value = None

    def homePath(self):
        return ""

    def mapLayers(self):
        return dict(self._layers)

    def mapLayer(self, name):
        return self._layers.get(name)

    def addMapLayer(self, layer, to_legend=True):
        self._layers[layer.id()] = layer
        return layer

    def removeMapLayers(self, names):
        for name in names:
            del self._layers[name]

    def layerTreeRoot(self):
        return self._tree

    def mapThemeCollection(self):
        return mock.MagicMock(**{"mapThemes.return_value": []})

    def layoutManager(self):
        return mock.MagicMock(**{"printLayouts.return_value": []})

    def isDirty(self):
        return False

    def setDirty(self, dirty):
        pass


class QgsProcessingFeedback(QtCore.QObject):
    progressChanged, canceled = Signal(float), Signal()

    def __init__(self, log=True):
        super().__init__()

    def cancel(self):
        self.canceled.emit()

    def setProgress(self, percent):
        self.progressChanged.emit(percent)


class QgsTask(QtCore.QObject):
    Flag = enum.Flag("TaskFlag", "CanCancel CancelWithoutPrompt Hidden Silent")

    def __init__(self, title="", flags=Flag.CanCancel):
        super().__init__()
        _need(flags, self.Flag)
        self.cancelled = False

    def setProgress(self, percent):
        _need(percent, float)

    def cancel(self):
        self.cancelled = True


class QgsProcessingAlgRunnerTask(QgsTask):
    executed = Signal(bool, dict)

    def __init__(self, algorithm, parameters, context, feedback):
        super().__init__()
        _need(feedback, QgsProcessingFeedback)
        self.algorithm, self.parameters = algorithm, parameters


class QgsFileDownloader(QtCore.QObject):
    downloadProgress, downloadCompleted = Signal("qint64", "qint64"), Signal(QtCore.QUrl)
    downloadError = Signal(list)

    def __init__(self, address, path):
        super().__init__()
        self.path = path + ""
        _need(address, QtCore.QUrl)

    def cancelDownload(self):
        pass


class QgsDockWidget(QtWidgets.QDockWidget):
    def setUserVisible(self, visible):
        self.setVisible(visible)


class QgsMapLayerComboBox(QtWidgets.QComboBox):
    layerChanged = Signal(object)
    _layer = None

    def setLayer(self, layer):
        if layer is not self._layer:
            self._layer = layer
            self.layerChanged.emit(layer)

    def setExceptedLayerList(self, layers):
        pass

    def exceptedLayerList(self):
        return []

    def setFilters(self, filters):
        pass

    def setAllowEmptyLayer(self, allow):
        pass

    def currentLayer(self):
        return self._layer


class QgsFileWidget(QtWidgets.QWidget):
    fileChanged = Signal(str)
    StorageMode = enum.Enum("StorageMode", "GetFile GetDirectory GetMultipleFiles SaveFile")

    def __init__(self, parent=None):
        super().__init__(parent)
        self._line = QtWidgets.QLineEdit(self)
        self._line.textChanged.connect(self.fileChanged)

    def setStorageMode(self, mode):
        _need(mode, self.StorageMode)

    def lineEdit(self):
        return self._line

    def filePath(self):
        return self._line.text()


class QgsMapTool(QtCore.QObject):
    def __init__(self, canvas):
        super().__init__()
        self._canvas = _need(canvas, QgsMapCanvas)

    def canvas(self):
        return self._canvas

    def setCursor(self, cursor):
        _need(cursor, QtCore.Qt.CursorShape)

    def setButton(self, button):
        _need(button, QtWidgets.QAbstractButton)

    def keyPressEvent(self, event):
        event.ignore()

    def deactivate(self):
        pass


class QgsMapToolEmitPoint(QgsMapTool):
    canvasClicked = Signal(object, QtCore.Qt.MouseButton)


class QgsMapCanvas(QtWidgets.QWidget):
    scaleChanged, mapToolSet = Signal(float), Signal(object, object)
    _tool = None

    def __init__(self):
        super().__init__()
        self._scene = mock.MagicMock(name="the map's scene")

    def mapTool(self):
        return self._tool

    def setMapTool(self, tool):
        before, self._tool = self._tool, tool
        if before is not None and before is not tool:
            before.deactivate()
        self.mapToolSet.emit(tool, before)

    def unsetMapTool(self, tool):
        if tool is self._tool:
            self.setMapTool(None)

    def scene(self):
        return self._scene

    def mapSettings(self):
        return mock.MagicMock(name="the map's settings")

    def mapUnitsPerPixel(self):
        return 1.0

    def extent(self):
        return QgsRectangle(0.0, 0.0, 1.0, 1.0)

    def setCenter(self, point):
        _need(point, QgsPointXY)

    def freeze(self, frozen):
        _need(frozen, bool)

    def refresh(self):
        pass


class QgsMessageBar(QtWidgets.QWidget):
    def __init__(self, parent=None):
        super().__init__(parent)
        QtWidgets.QVBoxLayout(self)
        self._items = []

    def pushInfo(self, title, text):
        self.createMessage(title, text)

    pushWarning = pushInfo  # noqa: N815 - QGIS's name

    def createMessage(self, title, text):
        message = QtWidgets.QWidget(self)
        QtWidgets.QHBoxLayout(message).addWidget(QtWidgets.QLabel(f"{title}: {text}"))
        return message

    def pushWidget(self, widget, level=None, duration=0):
        self.layout().addWidget(_need(widget, QtWidgets.QWidget))
        self._items.append(widget)
        return widget

    def items(self):
        return list(self._items)

    def popWidget(self, widget):
        self._items.remove(widget)
        widget.hide()
        return True


class Wrapper(QtCore.QObject):
    """What Processing puts around the widget of a parameter."""

    widgetValueHasChanged = Signal(object)

    def __init__(self, definition, parent):
        super().__init__(parent)
        self._label, kind = QtWidgets.QLabel(definition.description(), parent), definition.type()
        if kind == "enum":
            self._widget = QtWidgets.QComboBox(parent)
            for option in definition.values["options"]:
                self._widget.addItem(option, option)
            self._widget.currentIndexChanged.connect(lambda _: self.widgetValueHasChanged.emit(self))
        elif kind == "boolean":
            self._widget = QtWidgets.QCheckBox(parent)
            self._widget.toggled.connect(lambda _: self.widgetValueHasChanged.emit(self))
        elif kind == "number":
            self._widget = QtWidgets.QDoubleSpinBox(parent)
            self._widget.setRange(-1e9, 1e9)
            self._widget.valueChanged.connect(lambda _: self.widgetValueHasChanged.emit(self))
        else:
            self._widget = QtWidgets.QLineEdit(parent)
            self._widget.textChanged.connect(lambda _: self.widgetValueHasChanged.emit(self))
        self.setParameterValue(definition.defaultValue(), None)

    def wrappedLabel(self):
        return self._label

    def wrappedWidget(self):
        return self._widget

    def parameterValue(self):
        if isinstance(self._widget, QtWidgets.QComboBox):
            return self._widget.currentData()
        if isinstance(self._widget, QtWidgets.QCheckBox):
            return self._widget.isChecked()
        return self._widget.value() if isinstance(self._widget, QtWidgets.QDoubleSpinBox) else self._widget.text()

    def setParameterValue(self, value, context):
        if isinstance(self._widget, QtWidgets.QComboBox):
            self._widget.setCurrentIndex(self._widget.findData(value))
        elif isinstance(self._widget, QtWidgets.QCheckBox):
            self._widget.setChecked(bool(value))
        elif isinstance(self._widget, QtWidgets.QDoubleSpinBox):
            self._widget.setValue(float(value or 0))
        else:
            self._widget.setText("" if value is None else str(value))


class ParametersPanel(QtWidgets.QWidget):
    """Processing's: a label and a widget for each parameter, the advanced ones in a group."""

    def __init__(self, parent, algorithm, in_place=False, active_layer=None):
        super().__init__(parent)
        self._algorithm, self.wrappers, self.processing_context = algorithm, {}, mock.MagicMock()
        self.initWidgets()

    def algorithm(self):
        return self._algorithm

    def initWidgets(self):
        from qgis.core import QgsProcessingParameterDefinition

        outer, group = QtWidgets.QVBoxLayout(self), QtWidgets.QGroupBox(self)
        inner = QtWidgets.QVBoxLayout(group)
        for definition in self._algorithm.parameterDefinitions():
            advanced = QgsProcessingParameterDefinition.Flag.FlagAdvanced in definition.flags()
            wrapper = Wrapper(definition, group if advanced else self)
            self.wrappers[definition.name()] = wrapper
            for widget in (wrapper.wrappedLabel(), wrapper.wrappedWidget()):
                (inner if advanced else outer).addWidget(widget)
        outer.addWidget(group)

    def setParameters(self, parameters):
        for name, value in parameters.items():
            self.wrappers[name].setParameterValue(value, self.processing_context)

    def createProcessingParameters(self):
        return {name: wrapper.parameterValue() for name, wrapper in self.wrappers.items()}


class AlgorithmDialogBase(QtWidgets.QDialog):
    algorithmFinished = Signal(bool, dict)

    class InvalidParameterValue(Exception):
        pass


class AlgorithmDialog(AlgorithmDialogBase):
    """Processing's; its runs are ended by who presses *Run*."""

    def __init__(self, algorithm, in_place=False, parent=None):
        super().__init__(parent)
        self._algorithm, self.in_place, self.active_layer = algorithm, in_place, None
        self._bar, self.runs, self._buttons = QgsMessageBar(self), 0, QtWidgets.QDialogButtonBox(self)
        self.panel = self.getParametersPanel(algorithm, self)
        run = QtWidgets.QPushButton("Run", self)
        run.clicked.connect(lambda: self.runAlgorithm())
        self._cancel = QtWidgets.QPushButton("Cancel")  # nobody presses it: nothing runs
        self._cancel.setEnabled(False)
        layout = QtWidgets.QVBoxLayout(self)
        for widget in (self._bar, self.panel, run):
            layout.addWidget(widget)

    def algorithm(self):
        return self._algorithm

    def cancelButton(self):
        return self._cancel

    def mainWidget(self):
        return self.panel

    def buttonBox(self):
        return self._buttons

    def messageBar(self):
        return self._bar

    def createProcessingParameters(self):
        return self.panel.createProcessingParameters()

    def runAlgorithm(self):
        self.runs += 1

    def finish(self, successful, result, context, feedback, in_place=False):
        self.algorithmFinished.emit(successful, result)


DIALOGS = []


def create_algorithm_dialog(name, parameters=None):
    """``processing.createAlgorithmDialog``."""
    from qgis.core import QgsApplication
    from qgis.utils import iface

    algorithm = QgsApplication.processingRegistry().algorithmById(name).create()
    dialog = algorithm.createCustomParametersWidget(iface.mainWindow())
    dialog.panel.setParameters(parameters or {})
    DIALOGS.append(dialog)
    return dialog


class ContextAction:
    def __init__(self):
        self.name, self.itemData, self.toolbox = "", None, None


class Setting:
    """A row of the options page."""

    FILE, INT, FLOAT, STRING = "file", "int", "float", "string"
    MADE = []

    def __init__(self, group, name, description, default, hidden=False, valuetype=None, validator=None, options=None):
        if not (group and name and description):
            raise ValueError(f"{group} {name} {description}")
        _need(default, {"int": int, "float": float, None: bool}.get(valuetype, str))
        self.MADE.append(name)


class ProcessingResults:
    """The results viewer's pages, each with its time."""

    def __init__(self):
        self.results = []

    def addResult(self, icon, name, timestamp, result):
        self.results.append((icon, name, timestamp, result))


class QgsMapLayerStyle:
    def __init__(self, text=""):
        self._text = text + ""

    def readFromLayer(self, layer):
        _need(layer, QgsMapLayer)

    def writeToLayer(self, layer):
        _need(layer, QgsMapLayer)


def _named(*classes):
    return {each.__name__: each for each in classes}


CORE = _named(
    *(QgsPointXY, QgsGeometry, QgsWkbTypes, QgsCoordinateTransform, QgsMapLayer, QgsVectorLayer, QgsRasterLayer),
    *(QgsProviderRegistry, QgsProject, QgsProcessingFeedback, QgsTask, QgsProcessingAlgRunnerTask, QgsFileDownloader),
    *(QgsMapLayerStyle,),
)
GUI = _named(QgsDockWidget, QgsMapLayerComboBox, QgsFileWidget, QgsMapTool, QgsMapToolEmitPoint)
PROCESSING = {
    "processing": {"createAlgorithmDialog": create_algorithm_dialog},
    "processing.gui.AlgorithmDialog": {"AlgorithmDialog": AlgorithmDialog},
    "processing.gui.AlgorithmDialogBase": {"AlgorithmDialogBase": AlgorithmDialogBase},
    "processing.gui.ParametersPanel": {"ParametersPanel": ParametersPanel},
    "processing.gui.ContextAction": {"ContextAction": ContextAction},
    "processing.core.ProcessingResults": {"resultsList": ProcessingResults()},
}


def interface():
    """QGIS's ``iface`` with a window, a map and a message bar that are real widgets."""
    window = QtWidgets.QMainWindow()
    parts = SimpleNamespace(window=window, canvas=QgsMapCanvas(), bar=QgsMessageBar(window), layer=None)
    iface = mock.MagicMock()
    iface.mainWindow.return_value = window
    iface.mapCanvas.return_value = parts.canvas
    iface.messageBar.return_value = parts.bar
    iface.activeLayer.side_effect = lambda: parts.layer
    iface.setActiveLayer.side_effect = lambda layer: setattr(parts, "layer", layer)
    return iface, parts
