"""Packages that cannot be imported: which one, why, and what to type, in a sentence without a traceback.

GDAL's bindings pass pixels to numpy through a module that was compiled for numpy 1 or for numpy 2. A pip that replaces
the numpy beside them breaks them, and numpy then prints paragraphs and a traceback on standard error.
"""

from __future__ import annotations

import importlib.util
import io
import os
import re
import sys
import sysconfig
from contextlib import redirect_stderr
from typing import List

from ..contracts.errors import INSTALL_REMEDY, MissingPackageError

_OF_NUMPY = re.compile(
    r"numpy\.core\.(multiarray|umath)|numpy\._core|_ARRAY_API|compiled using NumPy|numpy\.dtype size changed|"
    r"NumPy C-API|A[BP]I version 0x"
)
_ENGINE = __name__.split(".runtime")[0]  # in QGIS, repm.repm_qgis
_NOT_IT = {
    _ENGINE.split(".")[0],
    "",
    "numpy",
    "importlib",
    "__main__",
    *getattr(sys, "stdlib_module_names", ()),
}  # since Python 3.10
_NOT_BUILT = re.compile(r"cannot import name '_gdal_array'|No module named 'osgeo\._gdal_array'")


def numpy_misfit() -> str:
    """Why GDAL's bindings cannot pass pixels to the numpy that is installed, with the remedy; "" where they can.

    "" also where one of the two is missing: who needs it says so.
    """
    if "osgeo.gdal_array" in sys.modules:
        return ""
    told = io.StringIO()
    try:
        with redirect_stderr(told):
            import osgeo.gdal_array  # noqa: F401
    except Exception as error:  # numpy's own errors are of several kinds
        if isinstance(error, ModuleNotFoundError) and error.name in ("osgeo", "numpy"):
            return ""
        return _misfit("GDAL", f"{told.getvalue()} {error}")
    return ""


def require_fitting_numpy() -> None:
    """Raise MissingPackageError where GDAL's bindings do not fit numpy, before numpy can say so at length."""
    text = numpy_misfit()
    if text:
        raise MissingPackageError(text)


def show_proj_its_data() -> None:
    """Name PROJ's data to a distribution's pyproj, which looks for it below a virtual environment that sees it."""
    if sys.prefix == sys.base_prefix or os.environ.get("PROJ_DATA") or os.environ.get("PROJ_LIB"):
        return
    found = importlib.util.find_spec("pyproj") if "pyproj" not in sys.modules else None
    place = os.path.join(sys.base_prefix, "share", "proj")
    of_the_system = found is not None and (found.origin or "").startswith(os.path.join(sys.base_prefix, "lib"))
    linked = os.path.exists(os.path.join(sys.prefix, "share", "proj", "proj.db"))
    if of_the_system and not linked and os.path.exists(os.path.join(place, "proj.db")):
        os.environ.update(PROJ_DATA=place, PROJ_LIB=place)  # its name before PROJ 9.1


def is_import_failure(error: Exception) -> bool:
    """Whether an exception is of an import of somebody else's; a missing part of the engine itself is a bug."""
    if isinstance(error, ImportError):
        return not (error.name or "").startswith(_ENGINE)
    return _OF_NUMPY.search(str(error)) is not None  # compiled modules raise ValueError and RuntimeError as well


def import_failure(error: Exception) -> MissingPackageError:
    """What an import that failed means for the user."""
    if _OF_NUMPY.search(str(error)):
        return MissingPackageError(numpy_misfit() or _misfit(_importer(error), str(error)))
    reason = " ".join(str(error).split())[:300]
    package = getattr(error, "name", "") or _importer(error)
    if isinstance(error, ModuleNotFoundError):
        return MissingPackageError(
            f"The Python package '{package}' is not installed for {sys.executable} ({reason}): {INSTALL_REMEDY}."
        )
    return MissingPackageError(
        f"The Python package '{package}' cannot be imported by {sys.executable} ({reason}): {INSTALL_REMEDY}."
    )


def _misfit(package: str, said: str) -> str:
    import numpy

    if package == "GDAL":
        from osgeo import gdal

        package = f"GDAL {gdal.__version__}"
    if _NOT_BUILT.search(said):
        return (
            f"The Python bindings of {package} were built without numpy: take those of the system's packages or of "
            f"conda, or type {_pip()} --force-reinstall --no-cache-dir --no-build-isolation "
            f"gdal=={package.split()[-1]}."
        )
    installed, folder = str(numpy.__version__), os.path.dirname(os.path.dirname(str(numpy.__file__)))
    if int(installed.split(".")[0]) < 2:
        return (
            f"{package} was built for a newer numpy than {installed}, which is installed in '{folder}': type "
            f'{_pip()} --upgrade "numpy<2".'
        )
    return (
        f"{package} was built for numpy 1, and numpy {installed} is installed in '{folder}': type {_pip()} \"numpy<2\"."
    )


def _pip() -> str:
    """How this Python's pip is called; where the system's own refuses it, with the words that it asks for."""
    name = os.path.basename(sys.executable or "")
    program = sys.executable if name.startswith("python") else "python3"  # in QGIS it may be QGIS itself
    guarded = os.path.exists(os.path.join(sysconfig.get_path("stdlib"), "EXTERNALLY-MANAGED"))
    own = sys.prefix != sys.base_prefix
    return f"{program} -m pip install{' --break-system-packages' if guarded and not own else ''}"


def _importer(error: Exception) -> str:
    """The package whose import failed: that of the innermost module which is neither numpy's, Python's nor ours."""
    found: List[str] = []
    trace = error.__traceback__
    while trace is not None:
        name = str(trace.tb_frame.f_globals.get("__name__") or "")
        top = name.split(".")[0]
        found += [top] if top not in _NOT_IT and not name.startswith(_ENGINE) else []
        trace = trace.tb_next
    return found[-1] if found else _ENGINE
