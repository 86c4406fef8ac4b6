"""QGIS's own Python is found from where QGIS has its library, on each system, and never on PATH."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from repm_qgis.contracts.errors import MissingPackageError
from repm_qgis.installer import environments, interpreter, pip
from repm_qgis.installer.interpreter import asked, base_program, candidates, qgis_python
from repm_qgis.runtime import packages

VERSION = f"{sys.version_info[0]}.{sys.version_info[1]}"


def test_it_is_this_pythons_whatever_is_first_on_path(tmp_path, monkeypatch):
    fake = tmp_path / "python3"
    fake.write_text("#!/bin/sh\nexit 3\n")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONHOME", str(tmp_path))
    monkeypatch.setattr(sys, "executable", str(fake))  # as inside QGIS
    found = qgis_python()
    assert os.path.realpath(found.program) == os.path.realpath(base_program())
    assert found.version == sys.version_info[:2] and found.lacks() == [] and os.path.isdir(found.gdal)
    assert not [path for path in candidates() if path.startswith(str(tmp_path))]


@pytest.mark.skipif(os.name == "nt", reason="starts shell scripts in place of interpreters")
def test_a_python_that_does_not_run_or_has_another_gdal_is_passed_over(tmp_path, monkeypatch):
    broken, other = tmp_path / "broken", tmp_path / "other"
    broken.write_text("#!/bin/sh\nexit 3\n")
    other.write_text(f"#!/bin/sh\nexec '{base_program()}' -S \"$@\"\n")  # without QGIS's packages
    for path in (broken, other):
        path.chmod(0o755)
    monkeypatch.setattr(interpreter, "candidates", lambda folders: [str(broken), str(other), base_program()])
    assert qgis_python().program == base_program()
    monkeypatch.setattr(interpreter, "candidates", lambda folders: [str(broken), str(other)])
    with pytest.raises(MissingPackageError, match="was not found .looked for .*broken, .*other.*REPM_QGIS_PYTHON"):
        qgis_python()
    assert "numpy" in asked(str(other)).lacks()
    with pytest.raises(MissingPackageError, match="broken' is no Python that runs"):
        asked(str(broken))


def test_osgeo4w_and_the_msi_have_it_beside_the_library(monkeypatch):
    """Their layout; the paths are joined as this system joins them."""
    drive = "C:\\" if os.name == "nt" else "/C:"
    root = os.path.join(drive, "OSGeo4W", "apps", "Python312")
    monkeypatch.setattr(interpreter, "WINDOWS", True)
    monkeypatch.setattr(sys, "base_exec_prefix", os.path.join(drive, "elsewhere"))
    monkeypatch.setattr(interpreter.os, "__file__", os.path.join(root, "Lib", "os.py"))
    found = candidates([os.path.join(drive, "OSGeo4W", "bin")])
    assert found[0] == os.path.join(drive, "elsewhere", "python.exe")
    assert os.path.join(root, "python.exe") in found and os.path.join(root, "python3.exe") in found
    assert os.path.join(drive, "OSGeo4W", "bin", "python3.exe") in found


@pytest.mark.skipif(os.name == "nt", reason="Windows does not know the paths of macOS")
def test_the_bundle_of_macos_has_it_in_contents(monkeypatch):
    contents = "/Applications/QGIS.app/Contents"
    monkeypatch.setattr(sys, "platform", "darwin")
    for name in ("base_prefix", "base_exec_prefix"):
        monkeypatch.setattr(sys, name, f"{contents}/Frameworks")
    monkeypatch.setattr(interpreter.os, "__file__", f"{contents}/Frameworks/lib/python{VERSION}/os.py")
    found = candidates([f"{contents}/MacOS"])
    assert f"{contents}/MacOS/bin/python{VERSION}" in found and f"{contents}/MacOS/python3" in found
    assert not [path for path in found if path.startswith("/usr/bin")]  # Apple's own


def test_pip_is_the_interpreters_own_or_its_bundled_wheel_or_a_sentence(tmp_path, monkeypatch):
    answers = {"import pip;": "23.0.1", "import ensurepip": "/bundled/pip-22.0-py3-none-any.whl"}

    def found(python, code):
        return next(answer for start, answer in answers.items() if code.startswith(start))

    monkeypatch.setattr(pip, "_found", found)
    assert pip.wheel_with_pip("python", "") == ""
    answers["import pip;"] = "19.1"  # too old to keep constraints
    assert pip.wheel_with_pip("python", "") == "/bundled/pip-22.0-py3-none-any.whl"
    answers.update({"import pip;": "", "import ensurepip": ""})
    with pytest.raises(MissingPackageError, match="neither pip nor ensurepip.*apt install python3-venv"):
        pip.wheel_with_pip("python", str(tmp_path))
    (tmp_path / "pip-24.0-py3-none-any.whl").touch()
    assert pip.wheel_with_pip("python", str(tmp_path)) == str(tmp_path / "pip-24.0-py3-none-any.whl")


def test_the_users_other_settings_of_pip_do_not_lead_it_elsewhere(monkeypatch):
    for name in ("TARGET", "PREFIX", "USER", "INDEX_URL", "CERT", "FIND_LINKS"):
        monkeypatch.setenv(f"PIP_{name}", "mine")
    values = pip.settings("python", "", "", "/tmp/t")
    assert {name for name in values if name.startswith("PIP_")} >= {"PIP_INDEX_URL", "PIP_CERT", "PIP_FIND_LINKS"}
    assert "PIP_TARGET" not in values and "PIP_PREFIX" not in values and values["PIP_USER"] == "0"
    assert "PIP_FIND_LINKS" not in pip.settings("python", "", "wheels", "/tmp/t")
    assert pip.settings("python", "host:8080", "", "/tmp/t")["HTTPS_PROXY"] == "http://host:8080"


def test_every_requirement_has_its_purpose_and_its_measured_size():
    for line in packages.requirements_of([packages.REQUIREMENTS]):
        found = packages.package_of(line)
        assert found.module and found.download_mb > 0 and found.disk_mb > found.download_mb, line


def test_the_home_is_the_profiles_or_the_users(tmp_path, monkeypatch):
    profile = tmp_path / "default"
    assert environments.home_of(profile / "python" / "plugins" / "repm") == str(profile / "repm")
    assert environments.home_of(tmp_path / "checkout") == ""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    if sys.platform.startswith("linux"):
        assert environments.user_home() == str(tmp_path / "repm")


def test_the_installer_needs_the_standard_library_alone():
    code = (
        "import sys\n"
        "for name in ('numpy', 'osgeo', 'pyproj', 'scipy', 'jinja2', 'cv2', 'qgis'):\n    sys.modules[name] = None\n"
        "import repm_qgis.installer.__main__, repm_qgis.installer.install"
    )
    done = subprocess.run(
        [base_program(), "-c", code], cwd=packages.PLUGIN_FOLDER, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
