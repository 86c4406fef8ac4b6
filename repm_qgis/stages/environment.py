"""Report what is installed for the engine, what is missing, and what this machine has."""

from __future__ import annotations

import os
import tempfile
from typing import Any, Dict, Optional

from .. import __version__
from ..environment import GRIDS, PACKAGES, survey
from ..evaluation.report import Report
from ..options import EnvironmentOptions
from ..progress import Progress


def run(options: EnvironmentOptions, progress: Progress) -> Dict[str, Any]:
    """Look around, say what is missing, and write the report if one is wanted; gives the findings too."""
    progress.step(0.0, "checking packages and devices")
    found = survey(tempfile.gettempdir())
    for entry in found["missing"]:
        progress.warn(f"{entry['package']} is missing ({entry['purpose']}). Install it with: {entry['command']}")
    if not found["missing"]:
        progress.info(f"{found['interpreter']} has every package that the engine uses.")
    if not found["cuda"]["usable"]:
        progress.info(f"BACKEND colmap cannot run: {found['cuda']['remedy']}.")
    if options.report:
        _report(found).write(options.report)
    progress.step(1.0, "reported")
    return {**found, "report": options.report}


def _report(found: Dict[str, Any]) -> Report:
    page = Report("Environment", f"REPM {__version__} on {found['platform']}")
    page.section("Missing")
    if not found["missing"]:
        page.paragraph("Nothing: every package that the engine uses is installed.")
    for entry in found["missing"]:
        page.warning(f"{entry['package']} is not installed: needed for {entry['purpose']}.", "run this command.")
        page.command(entry["command"])
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


def _cuda(found: Dict[str, Any]) -> str:
    devices = "; ".join(found["devices"]) or "no CUDA device answers"
    used, built = "usable" if found["usable"] else "not used", "with" if found["built"] else "without"
    return f"{used} ({devices}; pycolmap was built {built} it)"


def _proj(page: Report, found: Optional[Dict[str, Any]]) -> None:
    page.section("PROJ")
    if found is None:
        page.paragraph("pyproj is missing.")
        return
    folders = os.pathsep.join(found["folders"])
    page.facts([("PROJ", found["version"]), ("Data", folders), ("Downloads missing grids", found["network"])])
    page.table(["Grid", "For", "Installed"], [[name, use, found["grids"][name]] for name, use in GRIDS])
    if not any(found["grids"].values()) and not found["network"]:
        page.warning(
            "No geoid grid is installed: DEMs whose heights are above a geoid cannot be brought to the "
            "ellipsoid exactly.",
            "install one of these grids into one of the folders above, for example "
            "with: projsync --file us_nga_egm08_25.tif",
        )


def _gib(size: Optional[int]) -> str:
    return "unknown" if size is None else f"{size / 2**30:.1f} GiB"
