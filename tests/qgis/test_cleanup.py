"""What is removed after an engine process was killed, and what is not."""

from __future__ import annotations

import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest


def test_only_the_stages_own_fresh_temporary_files_go(plugin, tmp_path):
    from repm.processing_provider.cleanup import remove_half_written

    start = time.time()
    workspace, out = tmp_path / "work [1]", tmp_path / "out"
    (workspace / "heights").mkdir(parents=True)
    out.mkdir()
    ours = [
        workspace / ".scene.part.json",
        workspace / "heights" / ".t0.part.tif",
        out / ".dsm.part.tif",
        out / ".m.part.ply",
        out / ".my.ept.part",
    ]
    others = [
        workspace / "scene.json",
        workspace / "a.part.tif",
        out / ".other.part.tif",
        out / "dsm.tif",
        workspace / ".old.part.tif",
    ]
    ours[-1].mkdir()
    for path in ours[:-1] + others:
        path.touch()
    (ours[-1] / "spill").touch()
    os.utime(workspace / ".old.part.tif", (start - 1000, start - 1000))
    removed = remove_half_written(
        {
            "workspace": str(workspace),
            "output": str(out / "dsm.tif"),
            "resolution": 0.5,
            "images": [str(out / "image.tif")],
            "report": None,
            "mesh": str(out / "m.ply"),
            "ept": str(out / "my.ept"),
        },
        start,
    )
    assert sorted(removed) == sorted(map(str, ours))
    assert all(path.exists() for path in others) and not any(path.exists() for path in ours)


def test_the_name_of_temporary_files_is_the_engines(plugin, tmp_path):
    from repm.processing_provider.cleanup import remove_half_written

    from repm_qgis.runtime.workspace import temporary_name

    target = tmp_path / "dsm.tif"
    half = temporary_name(str(target))
    open(half, "w").close()
    assert remove_half_written({"output": str(target)}, 0) == [half]


_KILLED = """
import os, signal, sys
from repm_qgis.contracts.stages import STAGES
from repm_qgis.runtime.together import together
from repm_qgis.runtime.workspace import write_text
from repm_qgis.stages import provisional
options = STAGES["change"].options.from_json({"before": "b.tif", "after": "a.tif", "output": sys.argv[1]})
with together(provisional("change", options)[0]):
    write_text(sys.argv[1], "new")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
def test_what_a_killed_engine_had_replaced_comes_back(plugin, tmp_path):
    from repm.processing_provider.engine import _give_back

    from repm_qgis.contracts.stages import STAGES

    output = tmp_path / "change.tif"
    output.write_text("old")
    root = pathlib.Path(__file__).parents[2]
    assert subprocess.run([sys.executable, "-c", _KILLED, str(output)], cwd=root).returncode == -signal.SIGKILL
    assert output.read_text() == "new"
    _give_back(STAGES["change"], {"before": "b.tif", "after": "a.tif", "output": str(output)})
    assert output.read_text() == "old" and [path.name for path in tmp_path.iterdir()] == ["change.tif"]
