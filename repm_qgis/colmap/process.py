"""COLMAP's patch match in a process of its own: a lost GPU or a failed check in native code does not end the engine.

``python -m repm_qgis.colmap.process JOB.json``, a JSON object with ``workspace``, COLMAP's ``options``, and those
of its fusion in ``fusion`` (null: none). COLMAP's messages go to the standard streams, which the caller keeps.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Dict, List


def main(arguments: List[str]) -> None:
    """Run the job of a file; every failure ends the process with COLMAP's own message."""
    import pycolmap

    with open(arguments[0], encoding="utf-8") as stream:
        job = json.load(stream)
    options = pycolmap.PatchMatchOptions()
    for name, value in job["options"].items():
        setattr(options, name, value)
    pycolmap.patch_match_stereo(job["workspace"], options=options)
    if job["fusion"] is not None:
        fuse(job["workspace"], options.geom_consistency, job["fusion"])


def fuse(workspace: str, geometric: bool, values: Dict[str, object]) -> None:
    """Fuse a workspace's depth maps by COLMAP, on the CPU: (N, 3) points of its frame into ``fused.npy``."""
    import numpy as np
    import pycolmap

    options = pycolmap.StereoFusionOptions()
    for name, value in values.items():
        setattr(options, name, value)
    ply, kind = os.path.join(workspace, "fused.ply"), "geometric" if geometric else "photometric"
    found = pycolmap.stereo_fusion(ply, workspace, output_type="ply", options=options, input_type=kind)
    points = np.array([point.xyz for point in found.points3D.values()]).reshape(-1, 3)
    np.save(os.path.join(workspace, "fused.npy"), points)


if __name__ == "__main__":
    main(sys.argv[1:])
