"""``python -m repm_qgis STAGE JOB.json``; see :mod:`repm_qgis.engine_process`."""

from __future__ import annotations

import os
import signal
import sys


def _cancelled_at_the_start(number: int, frame: object) -> None:
    """Imports take a moment, and a cancel may come before the engine can clean up."""
    os.write(1, b'{"type": "error", "kind": "Cancelled", "text": "Cancelled by the user."}\n')
    os._exit(1)


if __name__ == "__main__":
    for _number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(_number, _cancelled_at_the_start)
    from .engine_process import main

    sys.exit(main(sys.argv[1:]))
