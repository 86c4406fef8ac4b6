"""MVSNet: images/00000000.jpg, cams/00000000_cam.txt and pair.txt.

The format that MVSNet (https://github.com/YoYo000/MVSNet) and its descendants read: extrinsic cam_from_world (4, 4),
intrinsic (3, 3), then DEPTH_MIN DEPTH_INTERVAL DEPTH_NUM DEPTH_MAX. Its homographies count pixels as COLMAP does.
"""

from __future__ import annotations

from pathlib import Path
from typing import Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..runtime.workspace import write_text
from .formats import ExportFormat
from .model import ExportView, TileModel

_MOST_SOURCES = 10  # as in MVSNet's own pair.txt
_ANGLE_DEG, _BELOW_DEG, _ABOVE_DEG = 5.0, 1.0, 10.0  # view selection of Yao et al., MVSNet, ECCV 2018


def matrix_text(matrix: FloatArray) -> str:
    """Rows of numbers with all their digits."""
    return "\n".join(" ".join(repr(float(value)) for value in row) for row in matrix)


def cam_text(view: ExportView) -> str:
    """The contents of a cam.txt."""
    low, step, count = view.depths[0], view.depth_interval, view.depth_count
    return (
        f"extrinsic\n{matrix_text(view.cam_from_world)}\n\nintrinsic\n{matrix_text(view.corner_K)}\n\n"
        f"{low!r} {step!r} {count} {low + step * (count - 1)!r}\n"
    )


def pair_scores(model: TileModel) -> FloatArray:
    """(views, views) MVSNet's score of the angle at which two views see the tile's middle; 0 on the diagonal."""
    middle = _middle(model)
    rays = np.array([view.camera.centre - middle for view in model.views])
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    angle = np.degrees(np.arccos(np.clip(rays @ rays.T, -1.0, 1.0)))
    score = np.exp(-((angle - _ANGLE_DEG) ** 2) / (2 * np.where(angle <= _ANGLE_DEG, _BELOW_DEG, _ABOVE_DEG) ** 2))
    np.fill_diagonal(score, 0.0)
    return np.asarray(score)


def _middle(model: TileModel) -> FloatArray:
    """(3,) the point in the middle of the first view, at its middle depth."""
    view = model.views[0]
    col, row = (side / 2 for side in view.size)
    ray = np.linalg.solve(view.camera.K @ view.camera.R, np.array([col, row, 1.0]))
    return np.asarray(view.camera.centre + ray * sum(view.depths) / 2)


def pair_text(model: TileModel) -> str:
    """The contents of pair.txt: for each view the others, best first."""
    lines = [str(len(model.views))]
    for index, scores in enumerate(pair_scores(model)):
        others = [k for k in np.argsort(-scores, kind="stable") if k != index][:_MOST_SOURCES]
        lines += [str(index), " ".join([str(len(others))] + [f"{k} {float(scores[k])!r}" for k in others])]
    return "\n".join(lines) + "\n"


def write_mvsnet(model: TileModel, images: Tuple[str, ...], folder: Path) -> None:
    """Write cameras and pairs."""
    for index, view in enumerate(model.views):
        write_text(str(folder / "cams" / f"{index:08d}_cam.txt"), cam_text(view))
    write_text(str(folder / "pair.txt"), pair_text(model))


# MVSNet and its descendants read files with the extension .jpg only.
MVSNET = ExportFormat("mvsnet", lambda model, index: f"images/{index:08d}", ".jpg", write_mvsnet)
