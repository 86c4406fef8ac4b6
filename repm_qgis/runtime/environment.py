"""The installed and the missing packages, how to install the missing ones, and the hardware of this machine. This
module only reports: it imports no more than it has to, and changes nothing. The version of a package whose import may
take long or end the process is read from its metadata.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import platform
import shutil
import subprocess  # nosec B404 # see its one use
import sys
from dataclasses import dataclass
from types import ModuleType
from typing import Optional

from ..contracts.documents import JsonObject
from ..contracts.errors import INSTALL_REMEDY, MissingPackageError
from .memory import kernel_memory, physical_memory
from .packages import PACKAGES, Package
from .parallel import cores

CUDA_WHEEL = "pycolmap-cuda12>=4.2,<5"
"""COLMAP with CUDA; it takes the place of ``pycolmap``, as both are imported under that name."""

_ASK_SECONDS = 60


GRIDS = (
    ("us_nga_egm96_15.tif", "EGM96 geoid"),
    ("us_nga_egm08_25.tif", "EGM2008 geoid"),
    ("egm96_15.gtx", "EGM96 geoid, older format"),
    ("egm08_25.gtx", "EGM2008 geoid, older format"),
)


def version_of(package: Package) -> Optional[str]:
    """The installed version; "unknown" where a package does not say; None where it is missing."""
    if importlib.util.find_spec(package.module) is None:
        return None
    for name in (package.distribution, f"{package.distribution}-cuda12"):
        try:
            return importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    if package.module == "osgeo":
        from osgeo import gdal

        return str(gdal.__version__)
    module = importlib.import_module(package.module) if package.module in ("numpy", "pyproj", "scipy") else None
    return str(getattr(module, "__version__", "unknown"))


def remedy_for(package: Package) -> str:
    """How to install a missing package, in words that follow "To install it,": never pip into QGIS's own Python."""
    if package.download_mb:
        return INSTALL_REMEDY
    if shutil.which("apt-get"):
        sudo = "" if hasattr(os, "geteuid") and os.geteuid() == 0 else "sudo "
        return f"run '{sudo}apt-get install -y {package.debian}'"
    return "install QGIS again with its Python modules: it is part of QGIS's own Python"


def fresh_answer(code: str, options: tuple[str, ...] = ()) -> str:
    """The output of a fresh interpreter for this code: a crash in a native library stays there. "" on any failure.

    ``options`` are the interpreter's own.
    """
    try:
        done = subprocess.run(  # nosec B603 # this interpreter, with code of our own
            [sys.executable, *options, "-c", code],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=_ASK_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.decode("utf-8", "replace").strip() if done.returncode == 0 else ""


@dataclass(frozen=True)
class Gpu:
    """A CUDA device that answers: its number for CUDA, its name and memory."""

    index: int
    name: str
    total_bytes: int
    free_bytes: int

    def __str__(self) -> str:
        return f"{self.name}, {self.total_bytes / 2**30:.0f} GiB"


# CUDA's driver is queried directly: it respects CUDA_VISIBLE_DEVICES, needs no nvidia-smi, and a device whose memory
# can be read has a context, which is what a lost or reserved one refuses.
_DRIVER = """
import ctypes, json, sys
cuda = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
count, found = ctypes.c_int(0), []
if cuda.cuInit(0) == 0 and cuda.cuDeviceGetCount(ctypes.byref(count)) == 0:
    for index in range(count.value):
        device, context, name = ctypes.c_int(0), ctypes.c_void_p(), ctypes.create_string_buffer(128)
        free, total = ctypes.c_size_t(0), ctypes.c_size_t(0)
        if (cuda.cuDeviceGet(ctypes.byref(device), index) == 0 and cuda.cuDeviceGetName(name, 128, device) == 0
                and cuda.cuDevicePrimaryCtxRetain(ctypes.byref(context), device) == 0
                and cuda.cuCtxSetCurrent(context) == 0
                and cuda.cuMemGetInfo_v2(ctypes.byref(free), ctypes.byref(total)) == 0):
            found.append([index, name.value.decode("utf-8", "replace"), total.value, free.value])
print(json.dumps(found))
"""


def gpus() -> list[Gpu]:
    """The CUDA devices that answer here; none where there is no driver, whatever the reason."""
    try:
        found = json.loads(fresh_answer(_DRIVER, options=("-I", "-S")) or "[]")  # alone, it starts at once
        return [Gpu(int(index), str(name), int(total), int(free)) for index, name, total, free in found]
    except (ValueError, TypeError):
        return []


_HAS_CUDA = """
try:
    import pycolmap
    print(bool(pycolmap.has_cuda))
except Exception as error:
    print(error.__cause__ or error)
"""


def _built_with_cuda() -> tuple[bool, str]:
    """Whether pycolmap is made with CUDA; and why it cannot be imported although it is installed, else ""."""
    if importlib.util.find_spec("pycolmap") is None:
        return False, ""
    answer = fresh_answer(_HAS_CUDA)
    return answer == "True", "" if answer in ("True", "False", "") else " ".join(answer.split())[:200]


def cuda() -> JsonObject:
    """Whether CUDA can be used.

    ``built`` (pycolmap was made with it), ``devices`` that answer, ``usable`` (both), and ``remedy``: what to do where
    it is not usable, else "".
    """
    (built, fault), devices = _built_with_cuda(), [str(gpu) for gpu in gpus()]
    usable, remedy = bool(built and devices), cuda_remedy(built, bool(devices), fault)
    return {"built": built, "devices": devices, "usable": usable, "remedy": remedy}


def cuda_remedy(built: bool, device: bool, fault: str = "") -> str:
    """How to make CUDA usable here; "" where it is. ``fault`` is why the installed pycolmap cannot be imported."""
    if fault:
        libraries = "on a server without a desktop, install the libraries of X (libx11-6 libxext6 libsm6 libice6)"
        return f"the installed pycolmap cannot be imported ({fault}): install it again; {libraries}"
    numpy = version_of(PACKAGES[0])
    keep = f' "numpy=={numpy}"' if numpy else ""  # named, so that pip can never replace QGIS's own
    pip = f'"{sys.executable}" -m pip' if " " in sys.executable else f"{sys.executable} -m pip"
    if sys.prefix == sys.base_prefix:  # QGIS's own Python, which is not ours to change
        install = f"{INSTALL_REMEDY}; this report then says how to exchange pycolmap"
    else:
        install = f"run '{pip} uninstall -y pycolmap' and then '{pip} install \"{CUDA_WHEEL}\"{keep}'"
    if device:
        return "" if built else f"the installed pycolmap is made without CUDA: {install}"
    driver = "no CUDA device answers here: check the NVIDIA driver with nvidia-smi"
    return driver if built else f"{driver}, and {install}"


def cuda_usable() -> bool:
    """Whether a CUDA device answers and pycolmap is made for it, which is asked only then."""
    return bool(gpus()) and _built_with_cuda()[0]


def memory() -> dict[str, Optional[int]]:
    """``total_bytes`` and ``available_bytes`` of this machine; None where they are unknown."""
    known = kernel_memory()
    return {"total_bytes": known.get("MemTotal", physical_memory()), "available_bytes": known.get("MemAvailable")}


def proj() -> JsonObject:
    """PROJ's version and data folder, and which of the geoid grids are there: heights above a geoid need one."""
    pyproj, datadir, network = map(importlib.import_module, ("pyproj", "pyproj.datadir", "pyproj.network"))
    folders = [datadir.get_data_dir(), datadir.get_user_data_dir()]
    folders = [folder for entry in folders for folder in entry.split(os.pathsep) if folder]
    grids = {name: any(os.path.exists(os.path.join(folder, name)) for folder in folders) for name, _ in GRIDS}
    enabled = bool(network.is_network_enabled())
    return {"version": pyproj.proj_version_str, "folders": folders, "grids": grids, "network": enabled}


def required_pycolmap(use: str, instead: str) -> ModuleType:
    """The module pycolmap; raises MissingPackageError, which names the use and what to choose instead, without it.

    The same for versions before 4, which have no rigs of one camera: there is no newer one for Python 3.9.
    """
    try:
        import pycolmap
    except (ImportError, RuntimeError) as error:  # pycolmap's own where a library of the system is missing
        raise MissingPackageError(
            f"{use} the Python package 'pycolmap', which is not installed ({error}): {INSTALL_REMEDY}, or {instead}."
        ) from error
    version = str(pycolmap.__version__)
    if version.split(".")[0] in ("0", "1", "2", "3"):
        found = f"and this Python has {version}, as there is no newer one for Python 3.9"
        raise MissingPackageError(f"{use} the Python package 'pycolmap' in version 4 or newer, {found}: {instead}.")
    return pycolmap


def survey(folder: str = ".") -> JsonObject:
    """Everything above as one JSON-able object; ``folder`` is where free disk space is asked for."""
    versions = {package.distribution: version_of(package) for package in PACKAGES}
    missing = [
        {"package": package.distribution, "purpose": package.purpose, "remedy": remedy_for(package)}
        for package in PACKAGES
        if versions[package.distribution] is None
    ]
    return {
        "python": platform.python_version(),
        "interpreter": sys.executable,
        "platform": platform.platform(),
        "versions": versions,
        "missing": missing,
        "cuda": cuda(),
        "memory": memory(),
        "cores": cores(),
        "disk_free_bytes": shutil.disk_usage(folder).free,
        "proj": proj() if versions["pyproj"] else None,
    }
