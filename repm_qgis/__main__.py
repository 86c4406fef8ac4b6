"""``python -m repm_qgis STAGE JOB.json``; see :mod:`repm_qgis.engine_process`."""

from __future__ import annotations

import os
import sys

from .runtime.standard_input import VARIABLE, Beginning, watched

if __name__ == "__main__":  # imports take a moment, and a cancel may come before the engine can clean up
    if {"-h", "--help"} & set(sys.argv[1:]):
        from .command_line import main as run_command

        sys.exit(run_command(sys.argv[1:]))
    if os.environ.get(VARIABLE):
        watched(sys.argv[2:] == ["-"])
    import signal

    _beginning = Beginning()
    for _number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(_number, lambda number, frame: _beginning.cancelled())
    from .engine_process import main

    sys.exit(main(sys.argv[1:]))
