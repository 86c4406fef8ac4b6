"""The plugin on Qt 6 without QGIS 4: real PyQt6, and stand-ins for the part of QGIS 4's API that the provider uses.

``python qt6_stubs.py FOLDER`` with PyQt6 in FOLDER loads the plugin, registers its provider, makes every algorithm
with its parameters, opens every entry of the menu, and prints as JSON what the toolbox would show, and which names of
QGIS had no stand-in. Those
accept everything, and are only proven to be imported and called. The stand-ins know no unscoped enum, take only the
arguments that QGIS 4's constructors take, and refuse values of other types, an int for an enum too. Names and
arguments are those of QGIS's own Python bindings (python/PyQt6/core/auto_generated/processing).
"""

from __future__ import annotations

import enum
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import inspect
import json
import pathlib
import sys
import tempfile
import types
from unittest import mock

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.insert(0, sys.argv[1])
PYQT = {}
for _name in ("QtCore", "QtGui", "QtWidgets", "QtNetwork", "QtXml", "QtSvg", "QtTest", "QtPrintSupport", "uic", "sip"):
    PYQT[_name] = importlib.import_module(f"PyQt6.{_name}")
QtCore, QtGui, QtWidgets = PYQT["QtCore"], PYQT["QtGui"], PYQT["QtWidgets"]
# PyQt's own question knows its objects alone; QGIS's, which are stand-ins here, are never deleted.
_is_deleted = PYQT["sip"].isdeleted
PYQT["sip"].isdeleted = lambda owner: not isinstance(owner, mock.NonCallableMock) and _is_deleted(owner)
sys.path.insert(0, str(ROOT / "tests"))
import qt6_gui_stubs as gui_stubs  # noqa: E402 - it needs the folder with PyQt6
import qt6_windows  # noqa: E402

# As QGIS's own qgis.PyQt.QtWidgets does.
QtWidgets.QAction, QtWidgets.QShortcut = QtGui.QAction, QtGui.QShortcut

SourceType = enum.Enum(
    "ProcessingSourceType",
    "TypeMapLayer TypeVectorAnyGeometry TypeVectorPoint TypeVectorLine TypeVectorPolygon TypeRaster TypeFile TypeVector"
    " TypeMesh TypePlugin TypeAnnotation TypePointCloud",
)
NumberType = enum.Enum("ProcessingNumberParameterType", "Integer Double")
FileBehavior = enum.Enum("ProcessingFileParameterBehavior", "File Folder")
ParameterFlag = enum.Flag("ProcessingParameterFlag", "FlagAdvanced FlagHidden FlagOptional FlagIsModelOutput")
LayerHint = enum.Enum("LayerHint", "UnknownType Vector Raster Mesh PointCloud Annotation VectorTile TiledScene")

_DEFAULT, _OPTIONAL, _CREATED = (
    ("defaultValue", object, None),
    ("optional", bool, False),
    ("createByDefault", bool, True),
)
PARAMETERS = {
    "Boolean": ("boolean", [_DEFAULT, _OPTIONAL]),
    "Crs": ("crs", [_DEFAULT, _OPTIONAL]),
    "Enum": (
        "enum",
        [
            ("options", list, []),
            ("allowMultiple", bool, False),
            _DEFAULT,
            _OPTIONAL,
            ("usesStaticStrings", bool, False),
        ],
    ),
    "Extent": ("extent", [_DEFAULT, _OPTIONAL]),
    "File": (
        "file",
        [
            ("behavior", FileBehavior, FileBehavior.File),
            ("extension", str, ""),
            _DEFAULT,
            _OPTIONAL,
            ("fileFilter", str, ""),
        ],
    ),
    "FileDestination": ("fileDestination", [("fileFilter", str, ""), _DEFAULT, _OPTIONAL, _CREATED]),
    "FolderDestination": ("folderDestination", [_DEFAULT, _OPTIONAL, _CREATED]),
    "MapLayer": ("layer", [_DEFAULT, _OPTIONAL, ("types", list, [])]),
    "MultipleLayers": ("multilayer", [("layerType", SourceType, SourceType.TypeVector), _DEFAULT, _OPTIONAL]),
    "Number": (
        "number",
        [
            ("type", NumberType, NumberType.Integer),
            _DEFAULT,
            _OPTIONAL,
            ("minValue", (int, float), -sys.float_info.max),
            ("maxValue", (int, float), sys.float_info.max),
        ],
    ),
    "RasterDestination": ("rasterDestination", [_DEFAULT, _OPTIONAL, _CREATED]),
    "RasterLayer": ("raster", [_DEFAULT, _OPTIONAL]),
    "String": ("string", [_DEFAULT, ("multiLine", bool, False), _OPTIONAL]),
    "VectorDestination": (
        "vectorDestination",
        [("type", SourceType, SourceType.TypeVectorAnyGeometry), _DEFAULT, _OPTIONAL, _CREATED],
    ),
    "VectorLayer": ("vector", [("types", list, []), _DEFAULT, _OPTIONAL]),
}
OUTPUTS = ("File", "Folder", "Html", "MultipleLayers", "Number", "RasterLayer", "String", "VectorLayer")


class QgsProcessingParameterDefinition:
    Flag = ParameterFlag
    KIND, FIELDS = "", []

    def __init__(self, *args, **kwargs):
        if len(args) == 1 and isinstance(args[0], QgsProcessingParameterDefinition):  # what clone() calls
            self.__dict__.update(args[0].__dict__)
            return
        fields = [("name", str, inspect.Parameter.empty), ("description", str, ""), *self.FIELDS]
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        signature = inspect.Signature([inspect.Parameter(name, kind, default=value) for name, _, value in fields])
        bound = signature.bind(*args, **kwargs)
        for name, kinds, _ in fields:
            if name in bound.arguments and not isinstance(bound.arguments[name], kinds):
                raise TypeError(f"{type(self).__name__}{args}: {name} is {bound.arguments[name]!r}")
        bound.apply_defaults()
        self.values, self._help = bound.arguments, ""
        self._flags = ParameterFlag.FlagOptional if self.values["optional"] else ParameterFlag(0)

    def name(self):
        return self.values["name"]

    def description(self):
        return self.values["description"]

    def type(self):
        return self.KIND

    def defaultValue(self):
        return self.values["defaultValue"]

    def usesStaticStrings(self):
        return self.values["usesStaticStrings"]

    def layerType(self):
        return self.values["layerType"]

    def isDestination(self):
        return self.KIND.endswith("Destination")

    def flags(self):
        return self._flags

    def setFlags(self, flags):
        if not isinstance(flags, ParameterFlag):
            raise TypeError(f"the flags of {self.name()} are {flags!r}")
        self._flags = flags

    def help(self):
        return self._help

    def setHelp(self, text):
        self._help = text + ""

    def setMetadata(self, metadata):
        self.metadata = dict(metadata)

    def setMinimumNumberInputs(self, number):
        self.minimum = int(number)


class Output:
    def __init__(self, name, description=""):
        self._name, self._description = name + "", description + ""

    def name(self):
        return self._name

    def description(self):
        return self._description


class QgsProcessingAlgorithm:
    def __init__(self):
        self._parameters, self._outputs, self._provider = [], [], None

    def create(self, configuration=None):
        made = self.createInstance()
        made._provider = self._provider
        made.initAlgorithm(configuration or {})
        return made

    def addParameter(self, parameter, createOutput=True):
        if parameter.name() in (known.name() for known in self._parameters):
            return False
        self._parameters.append(parameter)
        if parameter.isDestination() and createOutput:
            self.addOutput(Output(parameter.name(), parameter.description()))
        return True

    def addOutput(self, output):
        if not isinstance(output, Output):
            raise TypeError(f"{output!r} is no output")
        self._outputs.append(output)
        return True

    def parameterDefinitions(self):
        return list(self._parameters)

    def parameterDefinition(self, name):
        return next((each for each in self._parameters if each.name() == name), None)

    def parameterAsString(self, parameters, name, context):
        return str(parameters.get(name) or "")

    def outputDefinitions(self):
        return list(self._outputs)

    def provider(self):
        return self._provider


class QgsProcessingProvider(QtCore.QObject):  # type: ignore[name-defined]
    def __init__(self, parent=None):
        super().__init__(parent)
        self._algorithms = []

    def addAlgorithm(self, algorithm):
        algorithm._provider = self
        algorithm.initAlgorithm({})
        self._algorithms.append(algorithm)
        return True

    def refreshAlgorithms(self):
        self._algorithms.clear()
        self.loadAlgorithms()

    def algorithms(self):
        return list(self._algorithms)


class QgsProcessingModelAlgorithm(QgsProcessingAlgorithm):
    _path, _provider = "", None

    def loadVariant(self, description):
        return False  # the models' own format is QGIS's matter

    def toVariant(self):
        return {}

    def name(self):
        return "model"

    def setName(self, name):
        pass

    def setSourceFilePath(self, path):
        self._path = path + ""

    def setProvider(self, provider):
        self._provider = provider

    def provider(self):
        return mock.Mock(id=lambda: "repm")

    def toFile(self, path):
        return bool(pathlib.Path(path).write_text("", encoding="utf-8") == 0)


class Registry:
    def __init__(self):
        self._providers = {}

    def addProvider(self, provider):
        self._providers[provider.id()] = provider
        return provider.load()

    def removeProvider(self, provider):
        self._providers.pop(provider.id()).unload()

    def providerById(self, name):
        return self._providers.get(name, mock.MagicMock(name=name))

    def algorithmById(self, name):
        provider, _, own = name.partition(":")
        return next(each for each in self._providers[provider].algorithms() if each.name() == own)


class _Anything(type(QtWidgets.QWidget)):
    """The type of a class without a stand-in: every name in it is there, and calls give None."""

    def __getattr__(cls, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return mock.MagicMock(name=f"{cls.__name__}.{name}")


class QgsApplication(QtWidgets.QApplication, metaclass=_Anything):  # type: ignore[name-defined]
    _registry = Registry()

    _profile = tempfile.TemporaryDirectory(prefix="repm-qt6-")

    @staticmethod
    def platform():
        return "desktop"

    @staticmethod
    def locale():
        return "en"

    @staticmethod
    def getThemeIcon(name):
        return QtGui.QIcon(name + "")

    @classmethod
    def qgisSettingsDirPath(cls):
        return cls._profile.name

    @classmethod
    def processingRegistry(cls):
        return cls._registry


class QgsProcessingException(Exception):
    pass


ON_TRUST = set()


class Library(types.ModuleType):
    """A module of QGIS: what has a stand-in, and classes that accept everything for the rest (``ON_TRUST``)."""

    def __init__(self, name, base, known):
        super().__init__(name)
        self._base = base
        self.__dict__.update(known)

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)
        ON_TRUST.add(f"{self.__name__}.{name}")
        members = {
            "__init__": lambda own, *given, **named: self._base.__init__(own),
            "__getattr__": lambda own, member: mock.MagicMock(name=member),
        }
        made = _Anything(name, (self._base,), members)
        setattr(self, name, made)
        return made


class Processing(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds every module of QGIS's plugin Processing; the settings have no value yet."""

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "processing":
            return importlib.machinery.ModuleSpec(name, self, is_package=True)
        return None

    def create_module(self, spec):
        known = dict(gui_stubs.PROCESSING.get(spec.name, {}))
        if spec.name == "processing.core.ProcessingConfig":
            unset = {"getSetting": staticmethod(lambda name, readable=False: None), "settingIcons": {}}
            known["Setting"] = gui_stubs.Setting
            known["ProcessingConfig"] = _Anything("ProcessingConfig", (QtCore.QObject,), unset)
        return Library(spec.name, QtCore.QObject, known)

    def exec_module(self, module):
        pass


def install():
    """Put the stand-ins where ``import qgis`` finds them."""
    core = {
        each.__name__: each
        for each in (
            QgsProcessingParameterDefinition,
            QgsProcessingAlgorithm,
            QgsProcessingProvider,
            QgsProcessingModelAlgorithm,
            QgsApplication,
            QgsProcessingException,
        )
    }
    own = {"Number": {"Type": NumberType}, "File": {"Behavior": FileBehavior}}
    for name, (kind, fields) in PARAMETERS.items():
        members = {"KIND": kind, "FIELDS": fields, **own.get(name, {})}
        core[f"QgsProcessingParameter{name}"] = type(
            f"QgsProcessingParameter{name}", (QgsProcessingParameterDefinition,), members
        )
    for name in OUTPUTS:
        core[f"QgsProcessingOutput{name}"] = type(f"QgsProcessingOutput{name}", (Output,), {})
    core["QgsProcessing"] = type(
        "QgsProcessing", (), {"SourceType": SourceType, "TEMPORARY_OUTPUT": "TEMPORARY_OUTPUT"}
    )
    utils = {
        "LayerHint": LayerHint,
        "tempFolder": staticmethod(lambda: "/none"),
        "mapLayerFromString": staticmethod(lambda text, context, allowLoadingNewLayers=True: None),
    }
    core["QgsProcessingUtils"] = type("QgsProcessingUtils", (), utils)
    core["QgsSettings"] = QtCore.QSettings
    core.update(gui_stubs.CORE)
    core["NULL"] = None
    packages = {"qgis": types.ModuleType("qgis"), "qgis.PyQt": types.ModuleType("qgis.PyQt")}
    for name, module in PYQT.items():
        packages[f"qgis.PyQt.{name}"] = module
        setattr(packages["qgis.PyQt"], name, module)
    packages["qgis.core"] = Library("qgis.core", QtCore.QObject, core)
    packages["qgis.gui"] = Library("qgis.gui", QtWidgets.QWidget, gui_stubs.GUI)
    packages["qgis.utils"] = Library("qgis.utils", QtCore.QObject, {"iface": None})
    for name in ("qgis", "qgis.PyQt"):
        packages[name].__path__ = []
    sys.modules.update(packages)
    sys.meta_path.insert(0, Processing())
    for name in ("PyQt", "core", "gui", "utils"):
        setattr(packages["qgis"], name, packages[f"qgis.{name}"])


def shown(algorithm):
    """What the toolbox and a dialog show of one algorithm."""
    made = algorithm.create()
    if made.icon().isNull():
        raise ValueError(f"{made.name()} has no icon")
    return {
        "texts": [made.displayName(), made.group(), made.groupId(), made.shortDescription(), *made.tags()],
        "help": made.shortHelpString(),
        "parameters": [
            [
                each.name(),
                each.type(),
                each.description(),
                each.help(),
                ParameterFlag.FlagAdvanced in each.flags(),
                ParameterFlag.FlagOptional in each.flags(),
            ]
            for each in made.parameterDefinitions()
        ],
        "outputs": sorted(each.name() for each in made.outputDefinitions()),
    }


def main():
    QtCore.QLocale.setDefault(QtCore.QLocale("en"))
    application = QgsApplication([])
    QtCore.QCoreApplication.setOrganizationName("repm-qt6-test")
    kind, scope = QtCore.QSettings.Format.NativeFormat, QtCore.QSettings.Scope.UserScope
    QtCore.QSettings.setPath(kind, scope, QgsApplication.qgisSettingsDirPath())  # a new profile each time
    spec = importlib.util.spec_from_file_location("repm", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules["repm"] = package
    spec.loader.exec_module(package)
    names = []
    for path in sorted([*(ROOT / "processing_provider").rglob("*.py"), *(ROOT / "desktop").rglob("*.py")]):
        parts = path.relative_to(ROOT).with_suffix("").parts
        names.append(".".join(["repm", *parts]).replace(".__init__", ""))
    iface, parts = gui_stubs.interface()
    sys.modules["qgis.utils"].iface = iface
    for name in names:
        importlib.import_module(name)
    qt6_windows.watch(name for name in names if name.startswith("repm.desktop."))
    plugin = package.classFactory(iface)
    plugin.initGui()
    opened = []
    for call in iface.addPluginToMenu.call_args_list:
        opened.append(call.args[1].text())
        call.args[1].trigger()  # an exception in it ends a program on PyQt6
        application.processEvents()
    used = qt6_windows.use(plugin.menu, parts, "repm.repm_qgis")
    found = {each.name(): shown(each) for each in plugin.provider.algorithms()}
    plugin.unload()
    result = {"qt": QtCore.QT_VERSION_STR, "algorithms": found, "opened": opened, "used": used}
    result["on_trust"] = sorted(ON_TRUST)
    print(json.dumps(result))
    del parts, application


if __name__ == "__main__":
    install()
    main()
