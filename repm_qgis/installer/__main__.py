"""``python -m repm_qgis.installer``: makes, renews or removes the engine's environment; 'bash scripts/setup' runs it.

Run it in the plugin's folder with QGIS's own Python (the OSGeo4W Shell's python3, the bundle's, the distribution's).
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from typing import Sequence

from ..contracts.errors import Cancelled, RepmError
from ..contracts.findings import Finding
from ..runtime.packages import PLUGIN_FOLDER, REQUIREMENTS, requirements_of
from ..runtime.progress import Silent
from . import environments
from .install import described, install, log_of, planned
from .interpreter import asked, base_program


class _Printed(Silent):
    """Prints news on the terminal, a line each."""

    def __init__(self) -> None:
        self._text = ""

    def step(self, fraction: float, text: str = "") -> None:
        if text and text != self._text:
            self._text = text
            _say(text)

    def info(self, text: str) -> None:
        _say(text)

    def warn(self, finding: Finding) -> None:
        _say(finding)


def _say(text: str) -> None:
    sys.stdout.write(f"setup: {text}\n")
    sys.stdout.flush()


def _folder(given: str, program: str) -> str:
    if given:
        return os.path.abspath(given)
    home = environments.home_of()
    if not home and os.access(PLUGIN_FOLDER, os.W_OK):
        return environments.own_folder()
    return environments.folder_for(home or environments.user_home(), program)


def _cancel(number: int, frame: object) -> None:
    raise Cancelled


def main(arguments: Sequence[str]) -> int:
    """Do what the arguments ask for; the exit code is 0, or 1 after a sentence on standard error."""
    parser = argparse.ArgumentParser(prog="repm_qgis.installer", description="The engine's own Python environment.")
    parser.add_argument("--folder", default="", help="where it lies (default: in the profile, or .venv of a checkout)")
    parser.add_argument("--python", default="", help="the Python that QGIS uses (default: the one that runs this)")
    parser.add_argument("--wheels", default="", help="a folder of wheels to install from, without a network")
    parser.add_argument(
        "--proxy",
        default="",
        help="http://host:port (user:password@ before the host where it asks for them); better in HTTPS_PROXY",
    )
    parser.add_argument(
        "--extra", action="append", default=[], metavar="FILE", help="further requirements of the plugin"
    )
    parser.add_argument("--plan", action="store_true", help="say what would be installed, and do nothing")
    parser.add_argument("--remove", action="store_true", help="remove the environment")
    options = parser.parse_args(arguments)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _cancel)
    program = options.python or base_program()
    folder = _folder(options.folder, program)
    try:
        if options.remove:
            left = environments.remove([folder])
            _say(f"'{folder}' is in use: end what runs in it." if left else f"'{folder}' is removed.")
            return int(bool(left))
        if options.plan:
            _say(described(planned(asked(program), folder, options.extra, options.wheels, options.proxy)))
            return 0
        lines = requirements_of([REQUIREMENTS, *environments.kept_extras(folder, options.extra)])
        if environments.is_current(folder, program, lines):
            return 0  # without asking the Python, which takes longer
        install(program, folder, _Printed(), options.extra, options.wheels, options.proxy)
    except (RepmError, OSError) as error:
        log = f" The log is '{log_of(folder)}'." if os.path.exists(log_of(folder)) else ""
        sys.stderr.write(f"setup: {error}{log}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
