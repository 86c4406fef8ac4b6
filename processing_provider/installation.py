"""The engine's own environment as QGIS sees it: whether one is needed, its size, making and removing it."""

from __future__ import annotations

import functools
import importlib.util
from urllib.parse import quote

from qgis.core import QgsNetworkAccessManager, QgsProcessingException, QgsProcessingFeedback
from qgis.PyQt.QtNetwork import QNetworkProxy

from ..repm_qgis.contracts.documents import JsonMapping
from ..repm_qgis.contracts.errors import RepmError
from ..repm_qgis.contracts.stages import ENVIRONMENT
from ..repm_qgis.installer import environments
from ..repm_qgis.installer.install import log_of, planned
from ..repm_qgis.installer.interpreter import Interpreter, program_in, qgis_python
from ..repm_qgis.runtime.packages import PACKAGES, REQUIREMENTS, requirements_of
from . import engine, settings
from .language import said

FINE, MISSING, EARLIER = "fine", "missing", "earlier"


def state() -> str:
    """FINE where the engine can run; MISSING where packages are; EARLIER where they are those of another version.

    Cheap: nothing is started or imported. An interpreter that the user chose is not checked.
    """
    if settings.engine_python():
        return FINE
    folder = environments.usable(engine.homes(), engine.own_programs(), engine.plugin_folder())
    if folder:
        kept = not any(folder.startswith(home) for home in engine.homes())
        return FINE if kept or environments.fits(folder, engine.own_programs()) else EARLIER
    own = [package for package in PACKAGES if package.download_mb]
    return MISSING if any(importlib.util.find_spec(package.module) is None for package in own) else FINE


def proxy() -> str:
    """The proxy of QGIS's settings as an address for pip; "" for none, and for one of another kind than HTTP."""
    found = QgsNetworkAccessManager.instance().fallbackProxy()
    if found.type() != QNetworkProxy.ProxyType.HttpProxy or not found.hostName():
        return ""
    user = ""
    if found.user():
        user = f"{quote(found.user(), safe='')}:{quote(found.password(), safe='')}@"
    return f"http://{user}{found.hostName()}:{found.port()}"


@functools.lru_cache(maxsize=1)
def _own_python() -> Interpreter:
    return qgis_python(engine.program_folders())


def plan(wheels: str = "", proxy_address: str = "") -> environments.Plan:
    """The plan of an installation; raises QgsProcessingException. It starts QGIS's Python, which takes a second."""
    try:
        python = _own_python()
        folder = environments.folder_for(engine.homes()[0], python.program)
        return planned(python, folder, wheels=wheels, proxy=proxy_address)
    except (RepmError, OSError) as error:
        raise QgsProcessingException(said(str(error))) from None


def install(wheels: str, proxy_address: str, feedback: QgsProcessingFeedback) -> str:
    """Install the engine's packages; the folder of the environment. Raises QgsProcessingException in one sentence."""
    made = plan(wheels, proxy_address)
    options = {"install": True, "folder": made.folder, "wheels": wheels, "proxy": proxy_address}
    return str(engine.run_apart(ENVIRONMENT, options, feedback, python=made.program).folder)


def log_path() -> str:
    """The log of the last installation in this profile; it need not be there."""
    own = engine.own_programs()
    return log_of(environments.folder_for(engine.homes()[0], own[0])) if own else ""


def requirements_hash() -> str:
    """A digest of the packages that this version of the plugin requires."""
    return environments.hash_of(requirements_of([REQUIREMENTS], engine.plugin_folder()))


def folders() -> list[str]:
    """The environments of this profile, whole or not."""
    return environments.in_home(engine.homes()[0])


def remove(feedback: QgsProcessingFeedback) -> None:
    """Remove the environments of this profile; raises QgsProcessingException where a program runs in one."""
    for folder in folders():
        engine.run_here(ENVIRONMENT, {"remove": True, "folder": folder}, feedback)
    if not folders():
        feedback.pushInfo(f"No environment of the engine is left in '{engine.homes()[0]}'.")


def run(options: JsonMapping, feedback: QgsProcessingFeedback) -> None:
    """Do what the options INSTALL, REMOVE and WHEELS of repm:environment request."""
    if options.get("remove"):
        remove(feedback)
    if options.get("install"):
        folder = install(options.get("wheels") or "", proxy(), feedback)
        feedback.pushInfo(f"The engine now runs with '{program_in(folder)}'; the log is '{log_of(folder)}'.")
