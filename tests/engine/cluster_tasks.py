"""Tasks for tests of the cluster, in a module that workers can import."""

from __future__ import annotations

import os
import signal
import time

from repm_qgis.contracts.errors import OptionError


def square(x):
    return x * x


def who(x):
    time.sleep(0.1)
    return os.getpid()


def picky(x):
    if x == 7:
        raise OptionError("x", x, "must not be seven")
    return x


def slow(x):
    time.sleep(60)


def deadly_once(work):
    """End the worker by SIGKILL the first time; a file tells that it was."""
    x, mark = work
    if x == 3 and not os.path.exists(mark):
        open(mark, "w").close()
        os.kill(os.getpid(), signal.SIGKILL)
    return x * x


def deadly(x):
    time.sleep(0.5)  # so that no other task waits behind this one and shares its fate
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def noted(task, progress):
    progress.info(f"{task} was done")
    progress.warn("by another process")
    return os.getpid()
