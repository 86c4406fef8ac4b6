"""WHU-TLC's pinhole format: image/VIEW/TILE.png and camera/VIEW/TILE.txt, VIEW counting from 0.

Read by SatMVS (https://github.com/WHU-GPCV/SatMVS, open_dataset_pinhole; Gao, Liu and Ji, ICCV 2021): cam_from_world
(4, 4); ``f x0 y0``; ``DEPTH_MIN DEPTH_MAX DEPTH_INTERVAL``; ``INDEX 0 0 0 0 WIDTH HEIGHT``. The format has one
focal length and the network stacks the views: so pixels become square here, and all images of a tile get one size. Its
homographies count pixels from the centre of the first one.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Tuple

import numpy as np

from ..runtime.workspace import write_text
from .formats import ExportFormat
from .model import ExportView, TileModel
from .mvsnet import matrix_text

_SIDE_STEP = 64  # the network halves its features several times


def square_pixels(model: TileModel) -> TileModel:
    """The model with one focal length a view (the larger one, which loses nothing) and one image size for all views."""
    scales = [max(np.diag(view.camera.K)[:2]) / np.diag(view.camera.K)[:2] for view in model.views]
    largest = np.max([np.array(view.size) * scale for view, scale in zip(model.views, scales)], axis=0)
    width, height = (-(-int(np.ceil(side)) // _SIDE_STEP) * _SIDE_STEP for side in largest)
    resampled = (v.resampled(np.diag([*scale, 1.0]), (width, height)) for v, scale in zip(model.views, scales))
    return replace(model, views=tuple(resampled))


def camera_text(view: ExportView, index: int) -> str:
    """The contents of a camera's file."""
    K, (low, high) = view.camera.K, view.depths
    return (
        f"{matrix_text(view.cam_from_world)}\n\n{float(K[0, 0])!r} {float(K[0, 2])!r} {float(K[1, 2])!r}\n\n"
        f"{low!r} {high!r} {view.depth_interval!r}\n{index} 0 0 0 0 {view.size[0]} {view.size[1]}\n"
    )


def write_whutlc(model: TileModel, images: Tuple[str, ...], folder: Path) -> None:
    """Write the cameras."""
    for index, view in enumerate(model.views):
        write_text(str(folder / "camera" / str(index) / f"{model.tile.id}.txt"), camera_text(view, index))


def _image(model: TileModel, index: int) -> str:
    return f"image/{index}/{model.tile.id}"


WHUTLC = ExportFormat("whutlc", _image, ".png", write_whutlc, prepare=square_pixels)
