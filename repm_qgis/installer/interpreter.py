"""Which Python is QGIS's own, never the one that happens to be first on PATH, and which packages it has."""

from __future__ import annotations

import json
import os
import subprocess  # nosec B404 # see its one use
import sys
from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

from ..contracts.errors import MissingPackageError
from ..contracts.paths import real_path
from ..runtime.packages import OF_QGIS, PACKAGES

STAMP = "repm-environment.json"
"""The file in an environment that the installer made: it is written last, so its absence means "not whole"."""
WINDOWS = os.name == "nt"
_ASK_S = 60
# Variables that QGIS, the shell, conda or a virtual environment may have set for another Python.
_MISLEADING = (
    "PYTHONHOME",
    "PYTHONPATH",
    "PYTHONSTARTUP",
    "PYTHONEXECUTABLE",
    "PYTHONUSERBASE",
    "PYTHONPLATLIBDIR",
    "VIRTUAL_ENV",
    "__PYVENV_LAUNCHER__",
)


def is_program(path: str) -> bool:
    return os.path.isfile(path) and os.access(path, os.X_OK)


def program_in(environment: str) -> str:
    """The interpreter of a virtual environment, by its folder."""
    return os.path.join(environment, *(("Scripts", "python.exe") if WINDOWS else ("bin", "python")))


def variables(python: str) -> Dict[str, str]:
    """The variables to start an interpreter with: nothing that is meant for another one.

    One of our environments does not see what the user has installed with ``pip install --user``: a numpy there would
    hide QGIS's.
    """
    values = {name: value for name, value in os.environ.items() if name not in _MISLEADING}
    if os.path.exists(os.path.join(os.path.dirname(os.path.dirname(python)), STAMP)):
        values["PYTHONNOUSERSITE"] = "1"
    return values


def base_program() -> str:
    """The Python of this process, or the one behind it where it is a virtual environment's; not for inside QGIS."""
    return str(getattr(sys, "_base_executable", "") or sys.executable)


def candidates(folders: Sequence[str] = ()) -> List[str]:
    """Where QGIS's Python may lie, the likeliest first, derived from the Python of this process.

    ``folders`` are further ones to look in: for example that of QGIS's program in the bundle of macOS. Inside QGIS
    ``sys.executable`` is no help: it is whatever ``python3`` comes first on PATH, or QGIS itself.
    """
    library = os.path.dirname(os.path.abspath(os.__file__))
    if WINDOWS:  # OSGeo4W and the MSI: apps\Python312\python.exe beside apps\Python312\Lib
        places = [sys.base_exec_prefix, sys.base_prefix, os.path.dirname(library), *folders]
        names: Tuple[str, ...] = ("python.exe", "python3.exe")
    else:  # .../bin/python3.11 beside .../lib/python3.11; the bundle has them in Contents/MacOS, or one level apart
        prefixes = [sys.base_exec_prefix, sys.base_prefix, os.path.dirname(os.path.dirname(library))]
        places = [os.path.join(prefix, "bin") for prefix in prefixes]
        places += [place for folder in folders for place in (os.path.join(folder, "bin"), folder)]
        places += [] if sys.platform == "darwin" else [os.path.join("/usr", "bin")]
        names = (f"python{sys.version_info[0]}.{sys.version_info[1]}", "python3")
    return list(dict.fromkeys(os.path.join(place, name) for place in places for name in names))


@dataclass(frozen=True)
class Interpreter:
    """The facts about a Python.

    ``versions`` are those of the engine's packages that it has, by distribution; ``gdal`` is where it has GDAL's
    bindings, "" for nowhere; ``proj`` is its folder of PROJ's data.
    """

    program: str
    version: Tuple[int, int]
    gdal: str
    proj: str
    versions: Dict[str, str]

    def lacks(self) -> List[str]:
        """The packages of QGIS that are missing: without them it cannot be the Python of a working QGIS."""
        return [name for name in OF_QGIS if name != "scipy" and name not in self.versions]


_QUESTION = """
import importlib.metadata, json, os, sys
versions, gdal, proj = {}, "", ""
for module, name in json.loads(sys.argv[1]):
    try:
        versions[name] = importlib.metadata.version(name)
    except Exception:
        try:
            versions[name] = str(getattr(__import__(module), "__version__", "unknown"))
        except Exception:
            pass
try:
    import osgeo.gdal
    gdal = os.path.dirname(os.path.abspath(osgeo.__file__))
    versions["GDAL"] = osgeo.gdal.__version__
except Exception:
    versions.pop("GDAL", None)
try:
    import pyproj.datadir
    proj = pyproj.datadir.get_data_dir().split(os.pathsep)[0]
except Exception:
    pass
print(json.dumps({"version": sys.version_info[:2], "gdal": gdal, "proj": proj, "versions": versions}))
"""


def asked(program: str) -> Interpreter:
    """The facts about a Python, by running it; raises MissingPackageError where it is no Python that runs."""
    packages = json.dumps([[package.module, package.distribution] for package in PACKAGES])
    try:
        done = subprocess.run(  # nosec B603 # no shell, and an argument list of our own
            [program, "-c", _QUESTION, packages],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=os.path.dirname(program) or None,  # no module of the folder that the user is in
            env=variables(program),
            timeout=_ASK_S,
            check=True,
        )
        said = json.loads(done.stdout.decode("utf-8", "replace").strip().splitlines()[-1])
        major, minor = said["version"]
        return Interpreter(program, (int(major), int(minor)), str(said["gdal"]), str(said["proj"]), said["versions"])
    except (OSError, ValueError, LookupError, TypeError, subprocess.SubprocessError) as error:
        raise MissingPackageError(f"'{program}' is no Python that runs ({error}): name QGIS's Python.") from error


def qgis_python(folders: Sequence[str] = ()) -> Interpreter:
    """The Python of the QGIS that this process is: of its version, and with its GDAL bindings.

    Raises MissingPackageError, which says where it was looked for.
    """
    try:
        import osgeo

        own = os.path.dirname(os.path.abspath(str(osgeo.__file__)))
    except ImportError:
        own = ""
    looked = candidates(folders)
    for program in filter(is_program, looked):
        try:
            found = asked(program)
        except MissingPackageError:
            continue
        same = not own or (found.gdal and real_path(found.gdal) == real_path(own))
        if found.version == sys.version_info[:2] and same:
            return found
    version = ".".join(map(str, sys.version_info[:2]))
    raise MissingPackageError(
        f"QGIS's own Python {version} was not found (looked for {', '.join(looked)}): "
        "name it in the variable REPM_QGIS_PYTHON."
    )
