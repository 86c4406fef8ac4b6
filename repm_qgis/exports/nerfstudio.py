"""nerfstudio: images/, masks/ and transforms.json (https://docs.nerf.studio/quickstart/data_conventions.html).

Cameras look along -z with y up (OpenGL); ``transform_matrix`` is world_from_camera; the centre of the first pixel is
(0.5, 0.5).
"""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath
from typing import Dict, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..runtime.workspace import write_text
from .formats import ExportFormat
from .model import ExportView, TileModel

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def world_from_opengl(view: ExportView) -> FloatArray:
    """(4, 4) transform_matrix."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = view.camera.R.T, view.camera.centre
    return np.asarray(matrix @ _OPENGL_FROM_OPENCV)


def _mask(image: str) -> str:
    return f"masks/{PurePosixPath(image).stem}.png"


def _frame(view: ExportView, image: str) -> Dict[str, object]:
    K = view.corner_K
    files = {"file_path": image, "mask_path": _mask(image), "w": view.size[0], "h": view.size[1]}
    intrinsics = zip(("fl_x", "fl_y", "cx", "cy"), map(float, (K[0, 0], K[1, 1], K[0, 2], K[1, 2])))
    return {**files, **dict(intrinsics), "transform_matrix": world_from_opengl(view).tolist()}


def write_nerfstudio(model: TileModel, images: Tuple[str, ...], folder: Path) -> None:
    """Write transforms.json."""
    frames = [_frame(view, image) for view, image in zip(model.views, images)]
    document = {"camera_model": "OPENCV", **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0), "frames": frames}
    write_text(str(folder / "transforms.json"), json.dumps(document, indent=1, allow_nan=False))


NERFSTUDIO = ExportFormat(
    "nerfstudio", lambda model, index: f"images/{model.file_name(index)}", ".png", write_nerfstudio, mask=_mask
)
