"""Report what is installed for the engine, what is missing, and what hardware this machine has; or install what is
missing."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from typing import Dict, List, Optional, Tuple

from .. import __version__
from ..contracts.documents import JsonObject
from ..contracts.errors import OptionError, WorkspaceError
from ..contracts.findings import Finding
from ..contracts.options import EnvironmentOptions
from ..contracts.results import EnvironmentResult
from ..installer.interpreter import base_program
from ..reports.report import Report
from ..runtime.environment import GRIDS, survey
from ..runtime.imports import numpy_misfit
from ..runtime.packages import PACKAGES
from ..runtime.progress import Progress, Recorder


def run(options: EnvironmentOptions, progress: Progress) -> EnvironmentResult:
    """Look around, say what is missing, and write the report if one is asked for; gives the findings too."""
    if options.install or options.remove:
        return _changed(options, progress)
    progress.step(0.0, "checking packages and devices")
    found, run = survey(tempfile.gettempdir()), Recorder(progress)
    for names, remedy in _by_remedy(found):
        run.warn(Finding("packages-missing", f"Not installed: {names}. To install what is missing, {remedy}."))
    misfit = numpy_misfit()
    if misfit:
        run.warn(Finding("numpy-misfit", misfit))
    elif not found["missing"]:
        progress.info(f"{found['interpreter']} has every package that the engine uses.")
    if not found["cuda"]["usable"]:
        progress.info(f"BACKEND colmap cannot run: {found['cuda']['remedy']}.")
    if options.report:
        _report(found).write(options.report, run)
    progress.step(1.0, "reported")
    return EnvironmentResult.from_mapping({**found, "report": options.report, "folder": None})


def _changed(options: EnvironmentOptions, progress: Progress) -> EnvironmentResult:
    """Make, renew or remove the engine's own environment."""
    from ..installer import environments
    from ..installer.install import install, log_of

    if not options.folder:
        raise OptionError("folder", options.folder, "must be the environment to install into, or to remove")
    if options.remove:
        left = environments.remove([options.folder])
        if left:
            raise WorkspaceError(f"'{left[0]}' cannot be removed: end what runs in it, then try again.")
        with suppress(OSError):  # the log, and the folder of environments if this was the last
            os.unlink(log_of(options.folder))
            os.rmdir(os.path.dirname(options.folder))
        progress.info(f"The environment '{options.folder}' is removed.")
    elif not install(base_program(), options.folder, progress, wheels=options.wheels, proxy=options.proxy):
        progress.info(f"Nothing is missing in '{options.folder}'.")
    return EnvironmentResult(
        report=None,
        folder=options.folder,
        python=None,
        interpreter=None,
        platform=None,
        versions={},
        missing=(),
        cuda=None,
        memory=None,
        cores=None,
        disk_free_bytes=None,
        proj=None,
    )


def _by_remedy(found: JsonObject) -> List[Tuple[str, str]]:
    """What is missing, "a: for this; b: for that", with what installs it."""
    named: Dict[str, List[str]] = {}
    for entry in found["missing"]:
        named.setdefault(entry["remedy"], []).append(f"{entry['package']}: {entry['purpose']}")
    return [("; ".join(names), remedy) for remedy, names in named.items()]


def _report(found: JsonObject) -> Report:
    page = Report("Environment", f"REPM {__version__} on {found['platform']}")
    page.verdict("Every package that the engine uses is installed.")
    page.section("Packages")
    page.facts([("Engine interpreter", found["interpreter"]), ("Python", found["python"])])
    purposes = {package.distribution: package.purpose for package in PACKAGES}
    versions = [[name, version or "missing", purposes[name]] for name, version in found["versions"].items()]
    page.table(["Package", "Version", "For"], versions)
    page.section("Machine")
    memory = found["memory"]
    page.facts(
        [
            ("Cores", found["cores"]),
            ("Memory", _gib(memory["total_bytes"])),
            ("Memory available", _gib(memory["available_bytes"])),
            ("Disk free for temporary files", _gib(found["disk_free_bytes"])),
            ("CUDA", _cuda(found["cuda"])),
        ]
    )
    if not found["cuda"]["usable"]:
        page.paragraph(
            f"Dense matching with COLMAP on a GPU (BACKEND colmap) cannot run: {found['cuda']['remedy']}. "
            "Everything else works without it."
        )
    _proj(page, found["proj"])
    return page


def _cuda(found: JsonObject) -> str:
    devices = "; ".join(found["devices"]) or "no CUDA device answers"
    used, built = "usable" if found["usable"] else "not used", "with" if found["built"] else "without"
    return f"{used} ({devices}; pycolmap was built {built} it)"


def _proj(page: Report, found: Optional[JsonObject]) -> None:
    page.section("PROJ")
    if found is None:
        page.paragraph("pyproj is missing.")
        return
    folders = os.pathsep.join(found["folders"])
    page.facts([("PROJ", found["version"]), ("Data", folders), ("Downloads missing grids", found["network"])])
    page.table(["Grid", "For", "Installed"], [[name, use, found["grids"][name]] for name, use in GRIDS])
    if found["network"]:
        return
    from ..geometry.frames import install_grid  # here, as this page is for those who have no pyproj, too

    geoids = {use: install_grid([name]) for name, use in GRIDS[:2]}
    if not any(found["grids"].values()):
        text = "No geoid grid is installed: heights above a geoid cannot be brought to the ellipsoid, or back."
        page.paragraph(f"{text} What to do: {geoids[GRIDS[0][1]]}.")
    page.paragraph(
        "To install one: " + "; ".join(f"for the {use}, {how}" for use, how in geoids.items()) + ". "
        "With access to the internet, the environment variable PROJ_NETWORK=ON does the same by itself."
    )


def _gib(size: Optional[int]) -> str:
    return "unknown" if size is None else f"{size / 2**30:.1f} GiB"
