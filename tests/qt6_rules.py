"""What must not stand in code that runs under Qt 5 and Qt 6, found on the syntax tree.

The rules are those of QGIS's own migration script (pyqt5_to_pyqt6.py: enums, imports, QVariant, ``exec``, calls whose
arguments changed) and of PyQt 6's list of differences from PyQt 5. Enums are looked up in the QGIS that runs the test.
"""

from __future__ import annotations

import ast
import enum
import importlib
import pathlib
from typing import Any, Iterator

REMOVED_MODULES = {
    "qgis.PyQt.Qt": "import from QtCore",
    "qgis.PyQt.QtWebKit": "Qt 6 has none",
    "qgis.PyQt.QtWebKitWidgets": "Qt 6 has none",
    "qgis.PyQt.QtXmlPatterns": "Qt 6 has none",
    "sip": "import it from qgis.PyQt",
    "resources_rc": "load icons and forms from their files",
}
REMOVED_NAMES = {
    "QRegExp": "use QRegularExpression",
    "QRegExpValidator": "use QRegularExpressionValidator",
    "QDesktopWidget": "use QScreen",
    "QTextCodec": "use Python's codecs",
    "QGLWidget": "use QOpenGLWidget",
    "QMatrix": "use QTransform",
    "qApp": "use QApplication.instance()",
    "QWebView": "use QTextBrowser or QDesktopServices",
}
REMOVED_MEMBERS = {
    "exec_": "use exec",
    "print_": "use print",
    "globalX": "use globalPosition()",
    "globalY": "use globalPosition()",
    "localPos": "use position()",
    "windowPos": "use scenePosition()",
    "screenPos": "use globalPosition()",
    "setTabStopWidth": "use setTabStopDistance",
    "tabStopWidth": "use tabStopDistance",
    "MidButton": "use MouseButton.MiddleButton",
    "TextColorRole": "use ItemDataRole.ForegroundRole",
    "BackgroundColorRole": "use ItemDataRole.BackgroundRole",
    "HighQualityAntialiasing": "use RenderHint.Antialiasing",
}
# In their place there are textActivated, textHighlighted, currentTextChanged, textChanged and idClicked.
REMOVED_SIGNALS = {
    *((name, "str") for name in ("activated", "highlighted", "currentIndexChanged", "valueChanged")),
    ("buttonClicked", "int"),
}


def problems(path: pathlib.Path) -> list[str]:
    """``line: what: remedy`` of everything in a file of Python that Qt 6 or PyQt 6 refuses; in the file's order."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imported = dict(_imported(tree))
    found = [(node.lineno, text) for node in ast.walk(tree) for text in _of_node(node, imported)]
    return [f"{line}: {text}" for line, text in sorted(set(found))]


def _imported(tree: ast.AST) -> Iterator[tuple[str, Any]]:
    """What the names stand for that come from QGIS and Qt, where this machine has them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "qgis":
            for alias in node.names:
                try:
                    yield alias.asname or alias.name, getattr(importlib.import_module(node.module), alias.name)
                except (ImportError, AttributeError):
                    continue  # a newer QGIS has it


def _of_node(node: ast.AST, imported: dict[str, Any]) -> Iterator[str]:
    if isinstance(node, ast.Import):
        for alias in node.names:
            yield from _of_module(alias.name)
    elif isinstance(node, ast.ImportFrom) and not node.level:
        yield from _of_module(node.module or "")
        for alias in node.names:
            if (node.module or "").startswith("qgis.PyQt") and alias.name in REMOVED_NAMES:
                yield f"{alias.name}: {REMOVED_NAMES[alias.name]}"
    elif isinstance(node, ast.Attribute):
        yield from _of_attribute(node, imported)
    elif isinstance(node, ast.Call):
        yield from _of_call(node)
    elif isinstance(node, ast.FunctionDef) and node.name == "exec_":
        yield "exec_: define exec"
    elif isinstance(node, ast.Subscript) and isinstance(node.value, ast.Attribute):
        kind = node.slice.id if isinstance(node.slice, ast.Name) else ""
        if (node.value.attr, kind) in REMOVED_SIGNALS:
            yield f"{node.value.attr}[{kind}]: connect the signal that has this argument alone"


def _of_module(name: str) -> Iterator[str]:
    if name.split(".")[0] in ("PyQt4", "PyQt5", "PyQt6", "PySide2", "PySide6"):
        yield f"{name}: import from qgis.PyQt"
    for removed, remedy in REMOVED_MODULES.items():
        if name == removed or name.split(".")[-1] == removed:
            yield f"{name}: {remedy}"


def _of_attribute(node: ast.Attribute, imported: dict[str, Any]) -> Iterator[str]:
    if node.attr in REMOVED_MEMBERS:
        yield f"{node.attr}: {REMOVED_MEMBERS[node.attr]}"
    if isinstance(node.value, ast.Name) and node.value.id == "QVariant":
        yield f"QVariant.{node.attr}: use QMetaType.Type"
        return
    if (
        node.attr == "width"
        and isinstance(node.value, ast.Call)
        and _called(node.value) in ("fontMetrics", "QFontMetrics")
    ):
        yield "QFontMetrics.width: use horizontalAdvance"
    owner = _value(node.value, imported)
    if isinstance(owner, type) and not _is_enum(owner) and _is_enum(type(getattr(owner, node.attr, None))):
        kind = type(getattr(owner, node.attr))
        yield f"{owner.__name__}.{node.attr}: write the enum's name before the member ({kind.__qualname__})"


def _of_call(node: ast.Call) -> Iterator[str]:
    name = _called(node)
    if name == "QVariant" and (not node.args or isinstance(node.args[0], ast.Attribute)):
        yield "QVariant(...): use None or qgis.core.NULL"
    if name == "QDateTime" and (len(node.args) >= 8 or len(node.args) == 1 and _called(node.args[0]) == "QDate"):
        yield "QDateTime(...): give it a QDate and a QTime"
    if name == "desktop" and not node.args:
        yield "desktop(): use QWidget.screen()"
    if name == "addAction" and isinstance(node.func, ast.Attribute) and len(node.args) >= 4:
        yield "addAction(...): make the QAction first"


def _called(node: ast.AST) -> str:
    """The name of a called function, without what it is called on; "" for what is no call by name."""
    function = node.func if isinstance(node, ast.Call) else None
    return getattr(function, "attr", getattr(function, "id", ""))


def _value(node: ast.AST, imported: dict[str, Any]) -> Any:
    """What a chain of names stands for; None where that is not known before the code runs."""
    if isinstance(node, ast.Name):
        return imported.get(node.id)
    if isinstance(node, ast.Attribute):
        return getattr(_value(node.value, imported), node.attr, None)
    return None


def _is_enum(kind: type) -> bool:
    """Python's enums, and SIP's of Qt 5, which are subclasses of int."""
    return issubclass(kind, enum.Enum) or (issubclass(kind, int) and kind not in (int, bool))
