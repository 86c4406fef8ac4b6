"""What a process of our own does not print."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

_WORKER = "from repm_qgis.runtime.process_limits import prepare_process\nprepare_process()"
_ENGINE = """
from repm_qgis.engine_process import _run
from repm_qgis.contracts.errors import OptionError
try:
    _run(lambda: ("none", {}), None)
except (OptionError, AttributeError):
    pass
"""


@pytest.mark.parametrize("begin", (_WORKER, _ENGINE), ids=("worker", "engine"))
def test_gdals_own_messages_are_not_in_the_log(begin):
    """They name files that are then read in another way; those that matter are in our sentences."""
    code = f"{begin}\nfrom osgeo import gdal\ngdal.Open('/no/such/image.tif')\ngdal.Error(3, 1, 'noise')"
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], cwd=Path(__file__).parents[3], capture_output=True, text=True
    )
    assert (ended.returncode, ended.stderr) == (0, "")
