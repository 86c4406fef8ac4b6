"""Qt 6 and QGIS 4: the rules of QGIS's migration script on all code that runs in QGIS, and the plugin on real PyQt6.

What this leaves untested on QGIS 4 is in docs/compatibility.md.
"""

from __future__ import annotations

import ast
import importlib
import json
import os
import pathlib
import subprocess
import sys
import tempfile

import pytest
from qgis.core import QgsProcessingParameterDefinition

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))
import qt6_rules  # noqa: E402

from repm_qgis.installer.pip import wheel_with_pip  # noqa: E402
from tests.every_file import wrong  # noqa: E402

FILES = [
    ROOT / "__init__.py",
    ROOT / "plugin.py",
    *sorted((ROOT / "processing_provider").rglob("*.py")),
    *sorted((ROOT / "desktop").rglob("*.py")),
    *sorted((ROOT / "scripts").glob("*.py")),
    *sorted((ROOT / "tests" / "qgis").glob("*.py")),
]


def test_nothing_that_qt_6_refuses():
    assert wrong(FILES, qt6_rules.problems) == {}


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("from PyQt5.QtCore import QUrl", "import from qgis.PyQt"),
        ("import PyQt6.QtGui", "import from qgis.PyQt"),
        ("import sip", "import it from qgis.PyQt"),
        ("from qgis.PyQt.Qt import QUrl", "import from QtCore"),
        ("from . import resources_rc\nfrom .resources_rc import x\nimport resources_rc", "load icons"),
        ("from qgis.PyQt.QtCore import QRegExp", "QRegularExpression"),
        ("from qgis.PyQt.QtWidgets import qApp", "QApplication.instance()"),
        ("from qgis.PyQt.QtCore import Qt\nQt.AlignLeft", "Qt.AlignLeft: write the enum's name"),
        ("from qgis.PyQt.QtCore import QProcess as P\nP.NormalExit", "write the enum's name"),
        ("from qgis.PyQt.QtWidgets import QMessageBox\nQMessageBox.Ok | QMessageBox.Cancel", "QMessageBox.Ok"),
        ("from qgis.core import QgsProcessing\nQgsProcessing.TypeRaster", "write the enum's name"),
        ("from qgis.core import QgsWkbTypes\nQgsWkbTypes.PointGeometry", "write the enum's name"),
        ("from qgis import core\ncore.QgsProcessing.TypeRaster", "write the enum's name"),
        ("dialog.exec_()", "use exec"),
        ("def exec_(self): ...", "define exec"),
        ("QVariant.Int", "QMetaType.Type"),
        ("QVariant()", "NULL"),
        ("QVariant(QVariant.Null)", "NULL"),
        ("QDateTime(QDate(1, 2, 3))", "QDate and a QTime"),
        ("QDateTime(1, 2, 3, 4, 5, 6, 7, 0)", "QDate and a QTime"),
        ("menu.addAction(icon, text, call, keys)", "make the QAction first"),
        ("box.activated[str].connect(f)", "activated[str]"),
        ("label.fontMetrics().width(text)", "horizontalAdvance"),
        ("QApplication.desktop()", "screen()"),
        ("event.globalX()", "globalPosition()"),
        ("Qt.MidButton", "MiddleButton"),
    ],
)
def test_the_rules_find_what_they_are_for(tmp_path, code, said):
    (tmp_path / "bad.py").write_text(code, encoding="utf-8")
    assert said in "\n".join(qt6_rules.problems(tmp_path / "bad.py"))


def test_the_rules_let_pass_what_works_under_both(tmp_path):
    (tmp_path / "good.py").write_text(
        "from qgis.PyQt.QtCore import QProcess, Qt, QVariant\nfrom qgis.core import Qgis, QgsProcessing\n"
        "Qt.AlignmentFlag.AlignLeft\nQProcess.ExitStatus.NormalExit\nQgsProcessing.SourceType.TypeRaster\n"
        "QgsProcessing.TEMPORARY_OUTPUT\nQgis.version()\nisinstance(value, QVariant)\ndialog.exec()\n",
        encoding="utf-8",
    )
    assert qt6_rules.problems(tmp_path / "good.py") == []


PYQT6 = "PyQt6>=6.5,<7"
STUBS = ROOT / "tests" / "qt6_stubs.py"


@pytest.fixture(scope="session")
def pyqt6():
    """A folder with PyQt6 in the user's cache, filled once; its Python must not see the PyQt5 that QGIS uses."""
    base = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache") / "repm"
    folder = base / f"pyqt6-{sys.version_info[0]}.{sys.version_info[1]}"
    if not folder.is_dir():
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=base) as part:
            words = [sys.executable, "-m", "pip", "install", "--quiet", "--target", f"{part}/pyqt6", PYQT6]
            # The installer makes environments without pip, as it needs none there after it: Python carries a wheel.
            with_pip = {**os.environ, "PYTHONPATH": wheel_with_pip(sys.executable, "")}
            done = subprocess.run(words, env=with_pip, capture_output=True, text=True)
            if done.returncode:
                said = (done.stderr.strip().splitlines() or ["pip is not here"])[-1]
                pytest.skip(f"PyQt6 cannot be had, so nothing was tried on Qt 6: {said}")
            os.replace(f"{part}/pyqt6", folder)
    return folder


def on_qt6(pyqt6, *arguments):
    environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True, timeout=300)
    if "cannot open shared object file" in done.stderr:
        pytest.skip(f"PyQt6 does not load here, so nothing was tried on Qt 6: {done.stderr.strip().splitlines()[-1]}")
    return done


@pytest.mark.long
def test_the_plugin_on_pyqt6_shows_what_it_shows_here(pyqt6, provider):
    done = on_qt6(pyqt6, str(STUBS), str(pyqt6))
    assert done.returncode == 0, done.stderr
    there = json.loads(done.stdout.splitlines()[-1])
    assert there["qt"].startswith("6.") and "First steps" in there["opened"]
    flag = QgsProcessingParameterDefinition.Flag
    here = {}
    for entry in provider.algorithms():
        if entry.name() in ("dsm_by_stages", "dsm_to_map"):  # models: QGIS alone reads it
            continue
        here[entry.name()] = {
            "texts": [entry.displayName(), entry.group(), entry.groupId(), entry.shortDescription(), *entry.tags()],
            "help": entry.shortHelpString(),
            "parameters": [
                [
                    each.name(),
                    each.type(),
                    each.description(),
                    each.help(),
                    bool(each.flags() & flag.FlagAdvanced),
                    bool(each.flags() & flag.FlagOptional),
                ]
                for each in entry.parameterDefinitions()
            ],
            "outputs": sorted(each.name() for each in entry.outputDefinitions()),
        }
    assert there["algorithms"] == here
    # What has no stand-in is only imported there: it must at least be a name of the QGIS that runs this test.
    missing = []
    for name in there["on_trust"]:
        module, _, member = name.rpartition(".")
        if not hasattr(importlib.import_module(module), member):
            missing.append(name)
    assert missing == []
    every_window_was_used(there["used"])


def every_window_was_used(used):
    """All classes of desktop/ were made on Qt 6, and all buttons of its windows pressed."""
    from repm.processing_provider import settings

    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "desktop").rglob("*.py")]
    classes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    classes = {node.name for node in classes if "NamedTuple" not in map(ast.unparse, node.bases)}
    assert len(classes) > 15 and set(used["made"]) == classes
    assert used["left"] == {}
    windows = {
        "FirstSteps",
        "InstallDialog",
        "GeoidGridsDialog",
        "ControlPointsDock",
        "SurfaceEditingDock",
        "Dialog",
        "ScenesDock",
    }
    assert windows <= set(used["pressed"])
    steps = {step.split(":")[0] for step in used["pressed"]["next steps"]}
    assert {"inspect", "pipeline", "register", "dsmfuse, registered", "comparedsm, registered"} <= steps
    assert set(used["settings"]) == {settings.ENGINE_PYTHON, settings.WORKERS, settings.MEMORY, settings.CLUSTER} | {
        *settings.COLMAP.values()
    }


REFUSED = (
    "QgsProcessingParameterNumber('A', 'a', 1)",
    "QgsProcessingParameterNumber('A', 'a', QgsProcessingParameterNumber.Integer)",
    "QgsProcessingParameterMultipleLayers('A', 'a', QgsProcessing.TypeRaster)",
    "QgsProcessingParameterBoolean('A', None)",
    "QgsProcessingParameterString('A', 'a', '', 'optional')",
    "QgsProcessingParameterString('A', 'a', '', colour=1)",
    "QgsProcessingParameterString('A', 'a').setFlags(4)",
    "QgsProcessing.SourceType.TypeRasters",
)
TRIED = """
import sys
sys.argv, codes = sys.argv[:2], sys.argv[2:]
sys.path.insert(0, STUBS)
import qt6_stubs
qt6_stubs.install()
from qgis.core import (QgsProcessing, QgsProcessingParameterBoolean, QgsProcessingParameterMultipleLayers,
                       QgsProcessingParameterNumber, QgsProcessingParameterString)
for code in codes:
    try:
        exec(code)
        print("passed")
    except (TypeError, AttributeError):
        print("refused")
"""


@pytest.mark.long
def test_the_stand_ins_refuse_what_qgis_4_refuses(pyqt6):
    fine = "QgsProcessingParameterString('A', 'a', '')"
    code = f"STUBS = {str(STUBS.parent)!r}\n{TRIED}"
    done = on_qt6(pyqt6, "-c", code, str(pyqt6), fine, *REFUSED)
    assert done.stdout.split() == ["passed", *["refused"] * len(REFUSED)], done.stderr
