"""What the environment survey finds, against what the machine says by other ways."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import subprocess
import sys
import types

import pytest

from repm_qgis.contracts.errors import INSTALL_REMEDY, MissingPackageError
from repm_qgis.runtime import environment
from repm_qgis.runtime.environment import remedy_for, survey, version_of
from repm_qgis.runtime.packages import PACKAGES, Package


@pytest.fixture(scope="module")
def found():
    return survey()


def test_versions_are_those_of_the_packages_themselves(found):
    import numpy
    import pyproj
    from osgeo import gdal

    assert found["versions"]["numpy"] == numpy.__version__
    assert found["versions"]["GDAL"] == gdal.__version__
    assert found["versions"]["pyproj"] == pyproj.__version__
    assert found["versions"]["opencv-python-headless"] == importlib.metadata.version("opencv-python-headless")
    assert found["python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["interpreter"] == sys.executable


def test_what_is_missing_comes_with_what_installs_it(monkeypatch):
    gone = Package("surely_no_such_module", "opencv-python-headless", "", "a test", 1.0, 1.0)
    system = Package("surely_no_such_module_either", "scipy", "python3-scipy", "a test")
    monkeypatch.setattr(environment, "PACKAGES", (*PACKAGES[:3], gone, system))
    monkeypatch.setattr(environment.shutil, "which", lambda name: "/usr/bin/apt-get" if name == "apt-get" else None)
    missing = {entry["package"]: entry["remedy"] for entry in survey()["missing"]}
    assert set(missing) == {"opencv-python-headless", "scipy"}
    # Debian and others refuse pip in QGIS's own Python: no remedy may name it.
    assert missing["opencv-python-headless"] == INSTALL_REMEDY and "pip" not in INSTALL_REMEDY
    assert missing["scipy"].endswith("apt-get install -y python3-scipy'")
    monkeypatch.setattr(environment.shutil, "which", lambda name: None)
    assert "QGIS again with its Python modules" in remedy_for(system)


@pytest.fixture
def in_an_environment(monkeypatch):
    """As where the engine has an environment of its own, and not that of QGIS."""
    monkeypatch.setattr(sys, "prefix", os.path.join(sys.base_prefix, "environment"))


def test_the_remedy_for_cuda_is_no_pip_in_qgis_own_python(in_an_environment, monkeypatch):
    assert "-m pip uninstall -y pycolmap" in environment.cuda_remedy(built=False, device=True)  # in the environment
    monkeypatch.setattr(sys, "prefix", sys.base_prefix)
    remedy = environment.cuda_remedy(built=False, device=True)
    assert INSTALL_REMEDY in remedy and "pip" not in remedy


def test_a_pycolmap_that_lacks_a_library_of_the_system_says_which(tmp_path, monkeypatch):
    """The wheel with CUDA needs libraries of X, which servers lack; its error has the reason as its cause."""
    (tmp_path / "pycolmap.py").write_text(
        "try:\n    raise ImportError('libSM.so.6: cannot open shared object file')\n"
        "except ImportError as error:\n    raise RuntimeError('Cannot import the backend.') from error\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pycolmap", raising=False)
    found = environment.cuda()
    assert not found["usable"] and "cannot be imported (libSM.so.6: cannot open" in found["remedy"]
    with pytest.raises(MissingPackageError, match="choose rpc"):
        environment.required_pycolmap("ADJUSTMENT colmap needs", "choose rpc")


def test_a_module_that_is_not_there_has_no_version():
    assert version_of(Package("surely_no_such_module", "x", "", "")) is None
    assert version_of(PACKAGES[0]) is not None


def test_memory_and_cores_agree_with_the_kernel(found):
    if hasattr(os, "sysconf"):
        pages = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        assert found["memory"]["total_bytes"] == pytest.approx(pages, rel=0.01)
    assert 0 < found["memory"]["available_bytes"] <= found["memory"]["total_bytes"]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert found["cores"] == cores
    assert found["disk_free_bytes"] > 0


def test_cuda_needs_a_build_and_a_device(in_an_environment, monkeypatch):
    for built in (True, False):
        for devices in ([], [environment.Gpu(0, "NVIDIA X", 80 << 30, 79 << 30)]):
            monkeypatch.setattr(environment, "fresh_answer", lambda code, built=built: str(built))
            monkeypatch.setattr(environment, "gpus", lambda devices=devices: devices)
            usable, found = built and bool(devices), environment.cuda()
            assert (found["built"], found["usable"]) == (built, usable) and environment.cuda_usable() == usable
            assert found["devices"] == ["NVIDIA X, 80 GiB"] * len(devices)
            assert ("pycolmap-cuda12" in found["remedy"]) == (not built)
            assert ("no CUDA device answers" in found["remedy"]) == (not devices)
            assert bool(found["remedy"]) == (not usable) and "\n" not in found["remedy"]


_DRIVER = """
#include <stddef.h>
#include <string.h>
int cuInit(unsigned flags) { return 0; }
int cuDeviceGetCount(int *count) { *count = 3; return 0; }
int cuDeviceGet(int *device, int index) { *device = index; return 0; }
int cuDeviceGetName(char *name, int size, int device) { strncpy(name, device ? "Card B" : "Card A", size); return 0; }
int cuDevicePrimaryCtxRetain(void **context, int device) { return device == 1 ? 46 : 0; }
int cuCtxSetCurrent(void *context) { return 0; }
int cuMemGetInfo_v2(size_t *free, size_t *total) { *free = 7ul << 30; *total = 8ul << 30; return 0; }
"""


@pytest.mark.skipif(not shutil.which("gcc"), reason="no C compiler to make a driver with")
def test_devices_are_those_that_give_a_context(tmp_path, monkeypatch):
    """A driver of our own with three cards, of which the second is taken by somebody else."""
    (tmp_path / "driver.c").write_text(_DRIVER)
    subprocess.run(
        ["gcc", "-shared", "-fPIC", "-o", str(tmp_path / "libcuda.so.1"), str(tmp_path / "driver.c")],
        check=True,
        timeout=60,
    )
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
    assert environment.gpus() == [
        environment.Gpu(0, "Card A", 8 << 30, 7 << 30),
        environment.Gpu(2, "Card B", 8 << 30, 7 << 30),
    ]
    assert [str(gpu) for gpu in environment.gpus()] == ["Card A, 8 GiB", "Card B, 8 GiB"]


@pytest.mark.parametrize("answer", ("", "nonsense", "[[1, 2]]", "{}", '[["a", "b", "c", "d"]]'))
def test_a_driver_that_answers_nonsense_is_none(monkeypatch, answer):
    monkeypatch.setattr(environment, "fresh_answer", lambda code, options: answer)
    assert environment.gpus() == []


def test_a_package_that_crashes_when_imported_does_not_end_the_survey():
    assert environment.fresh_answer("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)") == ""
    assert environment.fresh_answer("print('yes')") == "yes"


def test_proj_grids_are_looked_for_where_proj_looks(found, tmp_path, monkeypatch):
    import pyproj

    assert found["proj"]["version"] == pyproj.proj_version_str
    assert os.path.exists(os.path.join(found["proj"]["folders"][0], "proj.db"))
    monkeypatch.setattr(pyproj.datadir, "get_user_data_dir", lambda: str(tmp_path))
    assert not environment.proj()["grids"]["us_nga_egm08_25.tif"] or found["proj"]["grids"]["us_nga_egm08_25.tif"]
    (tmp_path / "us_nga_egm08_25.tif").touch()
    assert environment.proj()["grids"]["us_nga_egm08_25.tif"]


def test_the_survey_imports_none_of_the_heavy_packages():
    code = (
        "import sys; from repm_qgis.runtime.environment import survey; survey();"
        "print(sorted(set(sys.modules) & {'cv2', 'pycolmap', 'laspy', 'lazrs', 'pyfqmr', 'qgis'}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        cwd=os.path.dirname(os.path.dirname(os.path.dirname(environment.__file__))),
    )
    assert done.stdout.strip() == "[]"


def test_a_pycolmap_that_is_too_old_is_a_sentence(monkeypatch):
    """Python 3.9 has none newer than 3.13, which lacks what exports and the adjustment call."""
    monkeypatch.setitem(sys.modules, "pycolmap", types.SimpleNamespace(__version__="3.13.0"))
    words = (
        "COLMAP models are written with the Python package 'pycolmap' in version 4 or newer, and this Python has 3.13.0"
    )
    with pytest.raises(MissingPackageError, match=words) as caught:
        environment.required_pycolmap("COLMAP models are written with", "choose another FORMAT")
    assert str(caught.value).endswith("choose another FORMAT.")
    newer = types.SimpleNamespace(__version__="4.2.1")
    monkeypatch.setitem(sys.modules, "pycolmap", newer)
    assert environment.required_pycolmap("It needs", "choose another") is newer
