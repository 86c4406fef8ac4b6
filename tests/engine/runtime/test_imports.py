"""Imports that fail: numpy and GDAL that do not fit, and packages that are not there, are one sentence each."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from repm_qgis.contracts.errors import MissingPackageError
from repm_qgis.runtime import imports

ROOT = Path(__file__).resolve().parents[3]

# As numpy 2 does it for a module that was compiled for numpy 1.
OLDER = """
import sys
sys.stderr.write("A module that was compiled using NumPy 1.x cannot be run in\\nNumPy 2.4.6 ...\\n\\nTraceback ...\\n")
raise ImportError("numpy.core.multiarray failed to import")
"""


@pytest.fixture
def broken(tmp_path):
    """Runs a stage where a module of GDAL or another package is replaced by code of the test."""

    def run(code, module="osgeo.gdal_array", numpy="2.4.6", stage="inspect", program="engine_process"):
        (tmp_path / "replaced.py").write_text(code, encoding="utf-8")
        (tmp_path / "job.json").write_text('{"images": ["a.tif"]}' if stage == "inspect" else "{}", encoding="utf-8")
        words = [stage, str(tmp_path / "job.json")] if program == "engine_process" else [stage, "--images", "a.tif"]
        main = f"""
import importlib.abc, importlib.util, sys
class Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == {module!r}:
            return importlib.util.spec_from_file_location(name, {str(tmp_path / "replaced.py")!r})
sys.meta_path.insert(0, Finder())
import numpy
numpy.__version__ = {numpy!r}
from repm_qgis.{program} import main
sys.exit(main({words!r}))
"""
        return subprocess.run([sys.executable, "-c", main], cwd=ROOT, capture_output=True, text=True, check=False)

    return run


def text_of(done):
    assert done.returncode == 1, done.stderr
    last = json.loads(done.stdout.splitlines()[-1])
    assert last["type"] == "error" and last["kind"] == "MissingPackageError" and "None" not in last["text"]
    return last["text"]


def test_gdal_for_numpy_1_under_numpy_2_is_one_sentence_with_what_to_type(broken):
    done = broken(OLDER)
    text = text_of(done)
    assert text.startswith("GDAL ") and " was built for numpy 1, and numpy 2.4.6 is installed in '" in text
    assert text.endswith('-m pip install "numpy<2".') and sys.executable in text
    assert done.stderr == "" and "Traceback" not in text


def test_on_a_terminal_it_is_the_only_line(broken):
    done = broken(OLDER, program="command_line")
    assert done.returncode == 1 and done.stdout == ""
    assert len(done.stderr.splitlines()) == 1 and done.stderr.startswith("repm: GDAL ")


def test_gdal_for_a_newer_numpy(broken):
    code = "raise RuntimeError('module compiled against ABI version 0x1000010 but this version of numpy is 0x100000e')"
    text = text_of(broken(code, numpy="1.20.3"))
    assert "was built for a newer numpy than 1.20.3" in text and text.endswith('-m pip install --upgrade "numpy<2".')


def test_gdal_without_numpy_is_built_again(broken):
    code = "raise ImportError(\"cannot import name '_gdal_array' from 'osgeo' (/x/osgeo/__init__.py)\", name='osgeo')"
    text = text_of(broken(code))
    assert "were built without numpy" in text and "--no-build-isolation gdal==" in text


def test_the_environment_is_reported_all_the_same(broken):
    done = broken(OLDER, stage="environment")
    said = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0 and said[-1]["type"] == "result"
    assert any(each["type"] == "warning" and "was built for numpy 1" in each["text"] for each in said)
    assert not any("has every package" in each.get("text", "") for each in said)


def raised(code, name="repm_test_package"):
    """The exception of a module with this code."""
    try:
        exec(compile(code, "module.py", "exec"), {"__name__": name})  # noqa: S102
    except Exception as error:
        return error
    raise AssertionError("it raised nothing")


def test_a_module_of_another_package_that_does_not_fit_is_named(monkeypatch):
    monkeypatch.setattr(imports, "numpy_misfit", lambda: "")
    for code in (
        "raise ImportError('numpy.core.multiarray failed to import')",
        "raise ValueError('numpy.dtype size changed, may indicate binary incompatibility')",
    ):
        error = raised(code)
        assert imports.is_import_failure(error)
        assert str(imports.import_failure(error)).startswith("repm_test_package was built for ")


def test_what_is_missing_and_what_is_broken_are_said_with_their_names():
    gone = imports.import_failure(raised("import surely_no_such_module"))
    assert str(gone).startswith("The Python package 'surely_no_such_module' is not installed for ")
    broken = imports.import_failure(raised("raise ImportError('libSM.so.6: cannot open shared object file')"))
    assert "'repm_test_package' cannot be imported by" in str(broken) and "libSM.so.6" in str(broken)
    assert isinstance(broken, MissingPackageError) and "None" not in f"{gone}{broken}"


def test_a_part_of_the_engine_and_other_errors_stay_bugs():
    assert not imports.is_import_failure(ImportError("x", name="repm_qgis.gone"))
    assert not imports.is_import_failure(ValueError("a number"))


def test_the_systems_own_python_is_told_what_its_pip_asks_for(tmp_path, monkeypatch):
    monkeypatch.setattr(imports.sysconfig, "get_path", lambda name: str(tmp_path))
    (tmp_path / "EXTERNALLY-MANAGED").touch()
    monkeypatch.setattr(sys, "prefix", sys.base_prefix)
    assert imports._pip().endswith("-m pip install --break-system-packages")
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert imports._pip() == f"{sys.executable} -m pip install"


def test_a_distributions_pyproj_is_shown_its_data_in_an_environment(tmp_path, monkeypatch):
    system = tmp_path / "system"
    for place in ("share/proj", "lib/python3/dist-packages/pyproj"):
        (system / place).mkdir(parents=True)
    (system / "share" / "proj" / "proj.db").touch()
    (system / "lib" / "python3" / "dist-packages" / "pyproj" / "__init__.py").touch()
    for name in ("PROJ_DATA", "PROJ_LIB"):
        monkeypatch.setenv(name, "")
    for name in [name for name in sys.modules if name.split(".")[0] == "pyproj"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "base_prefix", str(system))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "environment"))
    imports.show_proj_its_data()
    assert not os.environ["PROJ_DATA"]  # pyproj is no distribution's
    monkeypatch.syspath_prepend(str(system / "lib" / "python3" / "dist-packages"))
    imports.show_proj_its_data()
    assert os.environ["PROJ_DATA"] == os.environ["PROJ_LIB"] == str(system / "share" / "proj")
