"""What is removed after an engine process was killed, and what is not."""

from __future__ import annotations

import os
import time


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
