"""Where the engine's environments lie, which one is complete and fits, and the time and space of an installation.

Each environment of a profile is a folder of its own below ``<profile>/repm``, whose name holds a hash of its Python
and of the requirements. An update of the plugin with the same requirements finds it again; one with others makes a
new folder, and the old one serves until the new one is whole.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

from ..contracts.documents import JsonMapping, JsonObject
from ..contracts.paths import real_path
from ..runtime.packages import PLUGIN_FOLDER, REQUIREMENTS, package_of, requirements_of, sizes_mb
from ..runtime.workspace import free_bytes, write_text
from .interpreter import STAMP, is_program, program_in

_PREFIX = "engine-"
_MARGIN = 1.1
_OWN = ".venv"


def home_of(plugin: Path = PLUGIN_FOLDER) -> str:
    """The folder for environments of the profile that a plugin is installed in; "" for one that is in no profile."""
    parts = plugin.parts
    return str(plugin.parents[2] / "repm") if parts[-3:-1] == ("python", "plugins") else ""


def user_home() -> str:
    """The folder for environments of this user, where there is no profile."""
    if os.name == "nt":
        base = os.environ.get("LOCALAPPDATA") or os.path.expanduser(r"~\AppData\Local")
    elif sys.platform == "darwin":
        base = os.path.expanduser("~/Library/Application Support")
    else:
        base = os.environ.get("XDG_DATA_HOME") or os.path.expanduser("~/.local/share")
    return os.path.join(base, "repm")


def own_folder(plugin: Path = PLUGIN_FOLDER) -> str:
    """The environment in the plugin's folder: a checkout's, a cluster's, or that of version 0.1.0."""
    return str(plugin / _OWN)


def hash_of(requirements: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(sorted(requirements)).encode()).hexdigest()[:16]


def folder_for(home: str, program: str, requirements: Optional[Sequence[str]] = None) -> str:
    """The folder of the environment that an interpreter and these requirements need (None: the plugin's)."""
    lines = requirements_of([REQUIREMENTS]) if requirements is None else requirements
    mark = f"{os.path.normcase(real_path(program))} {hash_of(lines)}"
    return os.path.join(home, _PREFIX + hashlib.sha256(mark.encode()).hexdigest()[:10])


def stamp_of(folder: str) -> JsonObject:
    """The facts that the installer wrote when the environment was complete; empty where it is not."""
    try:
        with open(os.path.join(folder, STAMP), encoding="utf-8") as stream:
            known = json.load(stream)
    except (OSError, ValueError):
        return {}
    return known if isinstance(known, dict) and is_program(program_in(folder)) else {}


def mark(folder: str, program: str, requirements: Sequence[str], extras: Sequence[str], **more: object) -> None:
    """Mark the environment as complete."""
    known = {"program": real_path(program), "requirements": hash_of(requirements), "extras": list(extras)}
    write_text(os.path.join(folder, STAMP), json.dumps({**known, **more}, indent=1))


def unmark(folder: str) -> None:
    if os.path.lexists(os.path.join(folder, STAMP)):
        os.unlink(os.path.join(folder, STAMP))


def is_current(folder: str, program: str, requirements: Sequence[str], missing: Sequence[str] = ()) -> bool:
    """Whether an environment is whole, of this interpreter, and has these requirements and what QGIS lacks."""
    known = stamp_of(folder)
    same = known.get("program") == real_path(program)
    return same and known.get("requirements") == hash_of(requirements) and set(missing) <= set(known.get("missing", ()))


def in_home(home: str) -> List[str]:
    """The environments of a profile, whole or not."""
    try:
        paths = [os.path.join(home, name) for name in sorted(os.listdir(home)) if name.startswith(_PREFIX)]
    except OSError:
        return []
    return [path for path in paths if os.path.isdir(path)]


def fits(folder: str, programs: Optional[Sequence[str]]) -> bool:
    """Whether an environment is whole, of one of these interpreters, and has what the plugin asks for today."""
    known = stamp_of(folder)
    try:
        lines = requirements_of([REQUIREMENTS, *kept_extras(folder)])
    except OSError:  # the plugin is incomplete: the installed requirements are all that is known
        return False
    return _is_of(known, programs) and known.get("requirements") == hash_of(lines)


def _is_of(known: JsonMapping, programs: Optional[Sequence[str]]) -> bool:
    return bool(known) and (programs is None or known.get("program") in [real_path(program) for program in programs])


def usable(homes: Sequence[str], programs: Optional[Sequence[str]], plugin: Path = PLUGIN_FOLDER) -> str:
    """The folder of the environment to run the engine with; "" for none.

    One that has what the plugin asks for, else the one in the plugin's folder, else one that an earlier version of the
    plugin made, always with one of the Pythons that may be this QGIS's (None: any).
    """
    ours = [folder for home in homes for folder in in_home(home) if _is_of(stamp_of(folder), programs)]
    own = [own_folder(plugin)] if is_program(program_in(own_folder(plugin))) else []
    current = [folder for folder in ours if fits(folder, programs)]
    return next(iter([*current, *own, *ours]), "")


def remove(folders: Sequence[str]) -> List[str]:
    """Remove environments; gives those that could not be removed, for example because a program runs in them."""
    for folder in folders:
        if os.path.islink(folder):
            os.unlink(folder)
        elif os.path.isdir(folder):
            try:
                unmark(folder)
            except OSError:
                continue
            shutil.rmtree(folder, ignore_errors=True)
    return [folder for folder in folders if os.path.lexists(folder)]


def disk_bytes(folder: str) -> int:
    """The disk space of an environment; links count as links."""
    names = (os.path.join(place, name) for place, _, files in os.walk(folder) for name in files)
    return sum(os.lstat(name).st_size for name in names)


def superseded(folder: str, program: str) -> List[str]:
    """The environments that a new one beside them replaces: those of the same Python, broken ones, those of no
    Python."""
    real = real_path(program)
    others = [each for each in in_home(os.path.dirname(folder)) if each != folder]
    return [each for each in others if stamp_of(each).get("program") in (None, real)]


@dataclass(frozen=True)
class Plan:
    """The plan of an installation, before it begins.

    ``program`` is the Python that the environment is made with, ``folder`` where it will lie, ``wheels`` a folder of
    wheels to take in place of the index. ``extras`` are names of further requirement files, whose lines
    ``requirements`` has too; ``missing`` are packages that QGIS should have brought, which are installed as well.
    """

    program: str
    folder: str
    requirements: Tuple[str, ...]
    extras: Tuple[str, ...] = ()
    missing: Tuple[str, ...] = ()
    wheels: str = ""
    proxy: str = ""

    @property
    def all(self) -> Tuple[str, ...]:
        """The requirements for pip."""
        return (*self.requirements, *self.missing)

    @property
    def download_mb(self) -> float:
        """MB to download; nothing from a folder of wheels."""
        return 0.0 if self.wheels else sizes_mb(self.all)[0]

    @property
    def disk_mb(self) -> float:
        """MB on the disk when all is done."""
        return sizes_mb(self.all)[1]

    @property
    def needed_mb(self) -> float:
        """MB that must be free: the wheels lie on the same disk while they are unpacked."""
        return _MARGIN * sum(sizes_mb(self.all))

    @property
    def free_mb(self) -> Optional[float]:
        free = free_bytes(self.folder)
        return None if free is None else free / 1e6

    def rows(self) -> List[Tuple[str, str, float, float]]:
        """Requirement, what it is for, MB to download and on the disk, of each."""
        known = [(line, package_of(line)) for line in self.all]
        return [(line, each.purpose, each.download_mb, each.disk_mb) for line, each in known]


def plan(
    program: str,
    folder: str,
    extras: Sequence[str] = (),
    missing: Sequence[str] = (),
    wheels: str = "",
    proxy: str = "",
) -> Plan:
    """The installation of the plugin's requirements, those of ``extras`` and what QGIS lacks (``missing``)."""
    names = kept_extras(folder, extras)
    return Plan(
        program, folder, tuple(requirements_of([REQUIREMENTS, *names])), tuple(names), tuple(missing), wheels, proxy
    )


def kept_extras(folder: str, extras: Sequence[str] = ()) -> List[str]:
    """The further requirement files of an environment: those that are asked for, and those that it has already."""
    kept = [str(name) for name in stamp_of(folder).get("extras", []) if (PLUGIN_FOLDER / str(name)).is_file()]
    return list(dict.fromkeys([*extras, *kept]))
