"""The engine stands alone: every module imports where QGIS and Qt cannot be, and light stages need no wheel."""

from __future__ import annotations

import ast
import json
import pkgutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ENGINE = ROOT / "repm_qgis"
MODULES = sorted(info.name for info in pkgutil.walk_packages([str(ENGINE)], "repm_qgis."))
OPTIONAL = {"repm_qgis.runtime.cluster": "distributed"}
"""Modules that are imported only where somebody has installed their package (requirements-cluster.txt)."""


def python(code):
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, check=False
    )


@pytest.mark.long
def test_every_module_imports_without_qgis():
    assert len(MODULES) > 50 and "repm_qgis.stages.pipeline" in MODULES
    names = [name for name in MODULES if name not in OPTIONAL or find_spec(OPTIONAL[name])]
    done = python(
        "import importlib, sys\nfor name in ('qgis', 'PyQt5', 'PyQt6', 'processing'):\n"
        "    sys.modules[name] = None\n"
        f"for name in {names!r}:\n    importlib.import_module(name)"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "" and "Error" not in done.stderr


LIGHT = [
    f"stages.{name}"
    for name in ("epmfit", "errormap", "exportrpc", "comparedsm", "change", "series", "checkgcps", "environment")
]


def test_light_stages_and_the_registry_need_only_what_qgis_ships():
    """numpy, GDAL, pyproj and jinja2: these modules run in QGIS's own process, where the wheels may be missing."""
    done = python(
        "import importlib, sys\n"
        "for name in ('cv2', 'pycolmap', 'laspy', 'lazrs', 'pyfqmr', 'open3d', 'scipy', 'qgis'):\n"
        f"    sys.modules[name] = None\nfor module in {(*LIGHT, 'matching.backends')!r}:\n"
        "    importlib.import_module(f'repm_qgis.{module}')"
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("blocked", ("cv2 pycolmap laspy lazrs scipy qgis", "cv2 scipy qgis jinja2"))
@pytest.mark.long
def test_reports_need_jinja2_and_no_wheel(blocked, tmp_path):
    """The survey itself runs without jinja2, or nothing could tell that it is missing."""
    done = python(
        f"import sys\nfor name in {blocked.split()!r}:\n    sys.modules[name] = None\n"
        "from repm_qgis.contracts.errors import MissingPackageError\nfrom repm_qgis.runtime.progress import Silent\n"
        "from repm_qgis.stages import run_stage\nrun_stage('environment', {}, Silent())\n"
        f"try:\n    run_stage('environment', {{'report': {str(tmp_path / 'r.html')!r}}}, Silent())\n"
        "except MissingPackageError as error:\n    print(error)"
    )
    assert done.returncode == 0, done.stderr
    assert ("jinja2" in done.stdout) == ("jinja2" in blocked) and (tmp_path / "r.html").exists() != (
        "jinja2" in blocked
    )


def test_heavy_packages_are_imported_only_where_they_are_used():
    done = python(
        "import sys\nimport repm_qgis, repm_qgis.contracts.options, repm_qgis.stages, repm_qgis.scene\n"
        "import repm_qgis.stages.epmfit\n"
        "print([n for n in ('cv2', 'pycolmap', 'laspy', 'open3d', 'scipy') if n in sys.modules])"
    )
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_no_file_prints_exits_or_reaches_for_qgis():
    """Read as syntax, so that no comment or string is mistaken."""
    found = []
    for path in ENGINE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = getattr(getattr(node, "func", None), "id", "")
            if isinstance(node, ast.Call) and name in ("print", "eval", "exec", "input"):
                found.append(f"{path.name}: {name}")
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                names = [alias.name for alias in node.names] + [getattr(node, "module", "") or ""]
                # Pickles go from this process to its workers, in one module, and come from no file.
                refused = ("qgis", "PyQt5", "random", *(() if path.name == "parallel.py" else ("pickle",)))
                found += [f"{path.name}: {n}" for n in names if n.split(".")[0] in refused]
            if isinstance(node, ast.Assert):
                found.append(f"{path.name}: assert")
            program = path.name in ("__main__.py", "command_line.py")
            if isinstance(node, ast.Attribute) and node.attr == "exit" and not program:
                found.append(f"{path.name}: exit")
    assert found == []


def test_the_command_line_counts_a_bug_as_2(tmp_path):
    """An exception that is not ours: code 2 and the traceback as a message."""
    (tmp_path / "job.json").write_text("{}")
    done = python(
        "import sys\nimport repm_qgis.stages as s\n"
        "def broken(*a):\n    raise ZeroDivisionError('a bug')\n"
        "s.run_stage = broken\nfrom repm_qgis.engine_process import main\n"
        f"sys.exit(main(['environment', {str(tmp_path / 'job.json')!r}]))"
    )
    assert done.returncode == 2
    last = json.loads(done.stdout.splitlines()[-1])
    assert last["type"] == "bug" and "ZeroDivisionError: a bug" in last["text"]


@pytest.mark.long
def test_the_command_line_runs_a_pipeline(hamlet, tmp_path):
    """One heavy stage as QGIS starts it: JSON lines alone, rising progress, the result last."""
    job = {"images": hamlet.images[:2], "workspace": str(tmp_path / "ws"), "output": str(tmp_path / "dsm.tif")}
    (tmp_path / "job.json").write_text(json.dumps(job))
    done = subprocess.run(
        [sys.executable, "-m", "repm_qgis", "pipeline", str(tmp_path / "job.json")],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    said = [json.loads(line) for line in done.stdout.splitlines()]
    fractions = [message["fraction"] for message in said if message["type"] == "progress"]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    titles = " ".join(message["text"] for message in said if message["type"] == "progress")
    assert all(name in titles for name in ("Pinhole cameras", "Refinement", "Reconstruction", "Fusion"))
    assert said[-1]["type"] == "result" and (tmp_path / "dsm.tif").exists()
    assert said[-1]["result"]["valid"] > 10000
