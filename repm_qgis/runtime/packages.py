"""The Python packages that the engine uses, and which of them are installed for it: one table."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Sequence, Tuple

from ..contracts.data_folder import DATA_FOLDER

PLUGIN_FOLDER = Path(__file__).resolve().parents[2]
REQUIREMENTS = "requirements.txt"


@dataclass(frozen=True)
class Package:
    """A Python package: what to import, how it is called on PyPI and in Debian ("" = not there), and what it is for.

    ``download_mb`` and ``disk_mb`` were measured with Python 3.11 on Linux x86-64 (MB, 10^6 bytes), with the newest
    versions that numpy 1.24 allows.
    """

    module: str
    distribution: str
    debian: str
    purpose: str
    download_mb: float = 0.0
    disk_mb: float = 0.0


PACKAGES = (
    Package("numpy", "numpy", "python3-numpy", "all arithmetic"),
    Package("osgeo", "GDAL", "python3-gdal", "reading and writing rasters and vectors"),
    Package("pyproj", "pyproj", "python3-pyproj", "map projections and datums"),
    Package("jinja2", "Jinja2", "python3-jinja2", "pages of reports", 0.2, 1.0),
    Package("scipy", "scipy", "python3-scipy", "tie points, simulated scenes", 36.0, 115.0),
    Package("cv2", "opencv-python-headless", "", "keypoints, semi-global matching, resampling", 50.0, 144.0),
    Package("pycolmap", "pycolmap", "", "adjustment by COLMAP, scenes for COLMAP, matching on CUDA", 38.2, 142.0),
    Package("laspy", "laspy", "", "point clouds (LAS)", 0.1, 0.5),
    Package("lazrs", "lazrs", "", "compressed point clouds (LAZ)", 0.6, 2.0),
    Package("pyfqmr", "pyfqmr", "", "meshes of few vertices", 0.9, 3.3),
)
OF_QGIS = ("numpy", "scipy", "GDAL", "pyproj")
"""Always those that QGIS has: its compiled modules were built against them."""
REPLACEABLE = ("scipy", "Jinja2")
"""Of what QGIS ships, these may be installed for the engine where they are missing."""


def name_of(requirement: str) -> str:
    """The distribution that a line such as ``laspy>=2.5,<3`` asks for, in the spelling of PyPI's addresses."""
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    return re.sub(r"[-_.]+", "-", found.group(0)).lower() if found else ""


def requirements_of(names: Sequence[str], folder: Path = DATA_FOLDER) -> List[str]:
    """The lines of requirement files of the plugin, without comments; raises OSError where one is missing."""
    lines = [line for name in names for line in (folder / name).read_text(encoding="utf-8").splitlines()]
    return [line.strip() for line in lines if line.strip() and not line.strip().startswith("#")]


def package_of(requirement: str) -> Package:
    """The package that a requirement asks for; one without known sizes where it is not the engine's (Dask, say)."""
    name = name_of(requirement)
    known = {name_of(package.distribution): package for package in PACKAGES}
    return known.get(name, Package("", name, "", "an addition that was asked for"))


def constraints(versions: Dict[str, str]) -> List[str]:
    """What pip must keep: QGIS's own packages as they are (``versions`` by distribution)."""
    return [f"{name}=={versions[name]}" for name in OF_QGIS if versions.get(name)]


def sizes_mb(requirements: Sequence[str]) -> Tuple[float, float]:
    """What the requirements take to download and on the disk, MB, as measured."""
    packages = [package_of(line) for line in requirements]
    return sum(each.download_mb for each in packages), sum(each.disk_mb for each in packages)
