"""COLMAP: images/, masks/, sparse/0 (binary), sparse_text (the same as text) and database.db.

Cameras and images have the same numbers in the database and in the model, so that COLMAP's feature_extractor, matchers
and point_triangulator can continue from here.

Conventions (https://colmap.github.io/format.html): camera model PINHOLE with fx, fy, cx, cy, the first pixel's centre
at (0.5, 0.5), poses cam_from_world. Each image has a camera of its own. Tie points have no tracks, because
their measured pixels belong to the original images.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any, Tuple

from ..runtime.environment import required_pycolmap
from .formats import ExportFormat
from .model import TileModel

_GREY = (128, 128, 128)


def write_colmap(model: TileModel, images: Tuple[str, ...], folder: Path) -> None:
    """Write the model in both forms."""
    import pycolmap

    made = pycolmap.Reconstruction()
    for number, (view, image) in enumerate(zip(model.views, images), start=1):
        K = view.corner_K
        params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        width, height = view.size
        camera = pycolmap.Camera(camera_id=number, model="PINHOLE", width=width, height=height, params=params)
        made.add_camera_with_trivial_rig(camera)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(view.camera.R), view.camera.t)
        shown = pycolmap.Image(image_id=number, camera_id=number, name=PurePosixPath(image).name)
        made.add_image_with_trivial_frame(shown, pose)
    for xyz, residual in zip(model.points, model.residuals_px):
        number = made.add_point3D(xyz, pycolmap.Track(), _GREY)
        made.points3D[number].error = float(residual)
    for name, write in (("sparse/0", made.write_binary), ("sparse_text", made.write_text)):
        (folder / name).mkdir(parents=True)
        write(str(folder / name))
    _write_database(made, folder / "database.db")


def _write_database(model: Any, path: Path) -> None:
    import pycolmap

    opened: Any = getattr(pycolmap.Database, "open", pycolmap.Database)
    database = opened(str(path))
    try:
        for kind in ("camera", "rig", "frame", "image"):
            for thing in getattr(model, f"{kind}s").values():
                getattr(database, f"write_{kind}")(thing, True)
    finally:
        database.close()


COLMAP = ExportFormat(
    "colmap",
    lambda model, index: f"images/{model.file_name(index)}",
    ".png",
    write_colmap,
    mask=lambda image: f"masks/{PurePosixPath(image).name}.png",  # COLMAP looks for the image's whole name + .png
    require=lambda: required_pycolmap("COLMAP models are written with", "choose another FORMAT"),
)
