"""Makes the engine's environment: complete at the end, or absent."""

from __future__ import annotations

import os
import re
import shutil
import subprocess  # nosec B404 # see its uses
import time
from contextlib import suppress
from datetime import datetime
from typing import Callable, List, Sequence, TextIO, Tuple

from ..contracts.errors import MissingPackageError, OptionError, WorkspaceError
from ..contracts.findings import Finding
from ..contracts.paths import real_path
from ..runtime.locks import exclusive
from ..runtime.packages import PACKAGES, REPLACEABLE, constraints, name_of
from ..runtime.progress import Part, Progress
from ..runtime.workspace import cannot_write, ensure_folder
from . import environments, pip
from .environments import Plan
from .interpreter import WINDOWS, Interpreter, asked, program_in, variables

LOG = "install.log"


def log_of(folder: str) -> str:
    """The log of the last installation into a folder; it lies beside it, so that it stays when that fails."""
    return f"{folder}-{LOG}"


def planned(python: Interpreter, folder: str, extras: Sequence[str] = (), wheels: str = "", proxy: str = "") -> Plan:
    """The plan of an installation with this Python.

    Raises MissingPackageError where that Python lacks what QGIS brings, OptionError where ``wheels`` holds no wheel.
    """
    if wheels and not any(name.endswith(".whl") for name in (os.listdir(wheels) if os.path.isdir(wheels) else ())):
        raise OptionError("WHEELS", wheels, "must be a folder that holds wheels (files that end with .whl)")
    if python.lacks():
        raise MissingPackageError(
            f"The Python '{python.program}' lacks {', '.join(python.lacks())}: install QGIS 3.22 or newer with its "
            "Python modules, and name its Python in REPM_QGIS_PYTHON if it is another one."
        )
    missing = [name for name in REPLACEABLE if name not in python.versions]
    return environments.plan(python.program, folder, extras, missing, wheels, proxy)


def described(plan: Plan) -> str:
    """What will be installed, from where, how large, into which folder and how much is free, in sentences."""
    names = ", ".join(plan.all)
    source = (
        f"the folder '{plan.wheels}'" if plan.wheels else "the Python Package Index, or the index in pip's settings"
    )
    free = "" if plan.free_mb is None else f"; {plan.free_mb:.0f} MB are free there"
    return (
        f"{names} will be installed from {source} (about {plan.download_mb:.0f} MB to download) into "
        f"'{plan.folder}' (about {plan.disk_mb:.0f} MB{free}), for the Python '{plan.program}'."
    )


def install(
    program: str,
    folder: str,
    progress: Progress,
    extras: Sequence[str] = (),
    wheels: str = "",
    proxy: str = "",
) -> bool:
    """Make or renew the environment ``folder`` with the Python ``program``; False where it is whole already.

    A second installation beside it waits for the first. An environment that a killed one left is made again; after a
    cancel or a failure only the log remains. Raises RepmError in one sentence, and Cancelled.
    """
    python = asked(program)
    plan = planned(python, folder, extras, wheels, proxy)
    progress.info(described(plan))
    ensure_folder(os.path.dirname(os.path.abspath(folder)))
    with exclusive(
        "installation", progress, files=[os.path.join(os.path.dirname(os.path.abspath(folder)), "installation")]
    ):
        if environments.is_current(folder, program, plan.requirements, plan.missing):
            return False
        if plan.free_mb is not None and plan.free_mb < plan.needed_mb:
            raise WorkspaceError(
                f"'{folder}' needs {plan.needed_mb:.0f} MB, and {plan.free_mb:.0f} MB are free: free some space, or "
                "choose a folder on another disk."
            )
        try:
            with open(log_of(folder), "w", encoding="utf-8") as stream:
                _make(plan, python, progress, _logger(stream))
        except OSError as error:
            raise cannot_write(folder, error) from error
    left = environments.remove(environments.superseded(folder, program))
    if left:
        progress.warn(
            Finding("environment-left", f"An earlier environment is in use and stays for now: {', '.join(left)}.")
        )
    progress.step(1.0, "installed")
    return True


def _logger(stream: TextIO) -> Callable[[str], None]:
    def log(line: str) -> None:
        stream.write(line + "\n")
        stream.flush()

    return log


def _make(plan: Plan, python: Interpreter, progress: Progress, log: Callable[[str], None]) -> None:
    began, folder, whole = time.monotonic(), plan.folder, False
    log(f"{datetime.now().astimezone().isoformat(timespec='seconds')} {described(plan)}")
    old = environments.stamp_of(folder)
    # One that is whole is brought up to date (a checkout's, which has a name of its own); all others begin anew.
    renewed = old.get("program") == real_path(plan.program) or _is_of(folder, plan.program)
    try:
        if renewed:
            environments.unmark(folder)
        else:
            _begin(plan, progress)
        own = program_in(folder)
        kept = os.path.join(folder, "constraints.txt")
        with open(kept, "w", encoding="utf-8") as stream:
            stream.write("\n".join([*constraints(python.versions), ""]))
        expected = 1e6 * (plan.download_mb + plan.disk_mb)
        share = Part(progress, 0.05, 0.9)
        pip.install(
            own,
            plan.all,
            kept,
            share,
            plan.wheels,
            plan.proxy,
            expected,
            log,
        )
        _link_proj(folder, python)
        progress.step(0.92, "checking that the packages can be imported")
        verify(own, folder, plan.all, progress=progress)
        environments.remove([os.path.join(folder, "tmp")])
        progress.check_cancelled()
        seconds, size = time.monotonic() - began, environments.disk_bytes(folder)
        more = {"missing": plan.missing, "seconds": round(seconds, 1), "bytes": size, "versions": asked(own).versions}
        environments.mark(folder, plan.program, plan.requirements, plan.extras, **more)
        whole = True
        said = f"The engine's packages are installed in '{folder}' ({size / 1e6:.0f} MB, {seconds:.0f} s)."
        log(said)
        progress.info(said)
    except Exception as error:
        log(str(error))
        raise
    finally:
        if not whole and not renewed:
            environments.remove([folder])


def _is_of(folder: str, program: str) -> bool:
    """Whether a folder is the environment of this Python that ``scripts/setup`` of version 0.1.0 made."""
    own = program_in(folder)
    return os.path.exists(os.path.join(folder, ".repm-setup")) and real_path(own) == real_path(program)


def _begin(plan: Plan, progress: Progress) -> None:
    """An environment without packages, which sees those of its Python."""
    left = environments.remove([plan.folder])
    if left:
        raise WorkspaceError(f"'{plan.folder}' cannot be removed: end what runs in it, then install again.")
    progress.step(0.0, "making the environment")
    command = [plan.program, "-m", "venv", "--without-pip", "--system-site-packages", plan.folder]
    done = subprocess.run(  # nosec B603 # no shell, and an argument list of our own
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=variables(plan.program),
        check=False,
    )
    if WINDOWS and not done.returncode and not os.path.exists(program_in(plan.folder)):
        _copy_program(plan.program, os.path.dirname(program_in(plan.folder)))
    if done.returncode or not os.path.exists(program_in(plan.folder)):
        said = " ".join(done.stdout.decode("utf-8", "replace").split())[-300:] or f"exit code {done.returncode}"
        raise MissingPackageError(
            f"'{plan.program}' cannot make a virtual environment ({said}): on Debian and Ubuntu, run 'sudo apt install "
            "python3-venv'; elsewhere, install QGIS's Python with its module venv."
        )


def _copy_program(program: str, scripts: str) -> None:
    """The interpreter itself with its libraries, where its build lacks the launcher that venv copies on Windows.

    ``pyvenv.cfg`` leads it to its own modules, as it does the launcher.
    """
    own = os.path.dirname(program)
    libraries = [name for name in os.listdir(own) if re.fullmatch(r"(python3|vcruntime)\w*\.dll", name.lower())]
    shutil.copy2(program, os.path.join(scripts, "python.exe"))
    for name in libraries:
        shutil.copy2(os.path.join(own, name), scripts)


def _link_proj(folder: str, python: Interpreter) -> None:
    """Show pyproj its data, which a distribution's looks for below the environment; Windows's carries its own."""
    if not WINDOWS and os.path.exists(os.path.join(python.proj, "proj.db")):
        share = os.path.join(folder, "share")
        os.makedirs(share, exist_ok=True)
        with suppress(FileExistsError):
            os.symlink(python.proj, os.path.join(share, "proj"))


_VERIFY = """
import sys
for name in sys.argv[2:]:
    print(name, flush=True)
    __import__(name)
print("", flush=True)
import numpy, os
own = os.path.realpath(sys.argv[1])
if os.path.realpath(numpy.__file__).startswith(own):
    raise SystemExit("a second numpy was installed beside QGIS's")
"""


def verify(program: str, folder: str, requirements: Sequence[str], *, progress: Progress) -> None:
    """Import every package of the engine that is installed or QGIS's.

    Raises MissingPackageError with what fails, and Cancelled: the first import of so many libraries takes long where a
    virus scanner reads them.
    """
    wanted = {name_of(line) for line in requirements}
    modules: List[str] = [
        each.module for each in PACKAGES if not each.download_mb or name_of(each.distribution) in wanted
    ]
    try:
        with subprocess.Popen(  # nosec B603 # no shell, and an argument list of our own
            [program, "-c", _VERIFY, folder, *modules],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=folder,
            env={**variables(program), "PYTHONNOUSERSITE": "1"},
        ) as process:
            try:
                printed, complained = _until_its_end(process, progress)
            finally:
                process.kill()
    except OSError as error:
        raise MissingPackageError(f"'{program}' cannot be started ({error}): install again.") from error
    if process.returncode:
        name = "".join(printed.decode("utf-8", "replace").splitlines()[-1:])
        said = "".join(complained.decode("utf-8", "replace").strip().splitlines()[-1:])[:300]
        raise MissingPackageError(
            f"The package '{name or 'numpy'}' was installed, but cannot be used ({said or process.returncode}): "
            "send us the log."
        )


def _until_its_end(process: "subprocess.Popen[bytes]", progress: Progress) -> Tuple[bytes, bytes]:
    """What a process writes to its two outputs until it ends."""
    while True:
        progress.check_cancelled()
        try:
            return process.communicate(timeout=pip.POLL_S)
        except subprocess.TimeoutExpired:
            continue
