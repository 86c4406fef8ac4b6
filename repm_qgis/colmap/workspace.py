"""The folder of COLMAP's dense reconstruction: images, a sparse model, and which views are matched with which.

``images/*.png`` (8 bit, one stretch for each view), ``sparse/`` (PINHOLE cameras, poses, a grid of ground points over
the altitudes as tracks: COLMAP takes depth ranges and neighbours from them), ``stereo/patch-match.cfg`` and
``stereo/fusion.cfg``. The images' names are numbers: a name with a comma would be several in the lists.

Principal points are written for pixels whose first centre is (0, 0). COLMAP's sparse models count from the corner, but
its patch match and fusion use K with whole pixel numbers; so half a pixel more would rotate every ray.
``tests/engine/colmap/test_colmap_workspace.py`` checks what the installed version does.
"""

from __future__ import annotations

import os
from typing import Any, Mapping, Sequence, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Mask
from ..contracts.errors import WorkspaceError, reason_of
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked
from ..imagery.warping import warp
from ..runtime.workspace import ensure_folder, write_text
from ..scene import Scene
from ..stereo.pairing import ground_points
from .parameters import COLMAP, TrackParameters
from .projective_frame import FrameView, TileFrame

_GREY = np.array([128, 128, 128], dtype=np.uint8)


def image_name(index: int) -> str:
    """COLMAP's name of the view with this number in its tile."""
    return f"{index:04d}.png"


def map_path(folder: str, index: int, geometric: bool) -> str:
    """The file of a view's depth map in a workspace."""
    kind = "geometric" if geometric else "photometric"
    return os.path.join(folder, "stereo", "depth_maps", f"{image_name(index)}.{kind}.bin")


def view_intensity(view: FrameView, stretch: Stretch) -> FloatImage:
    """(height, width) intensity in 0..1 of a view's image, by one resampling of the original; NaN where it has none."""
    with opened_masked(view.view.image, view.view.mask) as dataset:
        return stretch.apply(warp(dataset, view.view.band, view.to_original, view.size, "cubic"))


def write_workspace(
    folder: str,
    scene: Scene,
    tile: TileFrame,
    images: Sequence[FloatImage],
    sources: Mapping[str, Sequence[str]],
    parameters: TrackParameters = COLMAP.tracks,
) -> None:
    """Write all that COLMAP needs for a tile; raises WorkspaceError where files cannot be written.

    ``images`` are the intensities in 0..1 of ``tile.views``; NaN becomes black, where nothing can be matched.
    ``sources`` gives for each reference view's name the names of the views that it is matched with.
    """
    for name in ("images", "sparse", "stereo/depth_maps", "stereo/normal_maps", "stereo/consistency_graphs"):
        ensure_folder(os.path.join(folder, name))
    for index, pixels in enumerate(images):
        _write_png(os.path.join(folder, "images", image_name(index)), pixels)
    _reconstruction(scene, tile, parameters).write(os.path.join(folder, "sparse"))
    images_of = {view.view.name: image_name(index) for index, view in enumerate(tile.views)}
    listed = {images_of[name]: ", ".join(images_of[other] for other in others) for name, others in sources.items()}
    pairs = "".join(f"{image}\n{others}\n" for image, others in listed.items())
    write_text(os.path.join(folder, "stereo", "patch-match.cfg"), pairs)
    write_text(os.path.join(folder, "stereo", "fusion.cfg"), "\n".join(listed) + "\n")


def _write_png(path: str, pixels: FloatImage) -> None:
    grey = np.rint(np.clip(np.nan_to_num(pixels, nan=0.0), 0.0, 1.0) * 255).astype(np.uint8)
    try:
        with open(path, "wb") as stream:
            stream.write(cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())
    except OSError as error:
        raise WorkspaceError(f"Cannot write '{path}' ({reason_of(error)}): is the disk full?") from error


def _reconstruction(scene: Scene, tile: TileFrame, parameters: TrackParameters) -> Any:
    """COLMAP's sparse model: cameras 1, 2 ..., images 1, 2 ..., and the tracks of a grid of ground points."""
    import pycolmap

    points, seen = _tracks(scene, tile, parameters)
    made = pycolmap.Reconstruction()
    places = np.cumsum(seen, axis=0) - 1  # a point's number among those that an image shows
    for index, view in enumerate(tile.views):
        K, number = view.camera.K, index + 1
        (width, height), numbers = view.size, [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        camera = pycolmap.Camera(camera_id=number, model="PINHOLE", width=width, height=height, params=numbers)
        made.add_camera_with_trivial_rig(camera)
        pixels = view.camera.project(points[seen[:, index]])
        image = pycolmap.Image(image_name(index), pixels.reshape(-1, 2), number, number)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(view.camera.R), view.camera.t)
        made.add_image_with_trivial_frame(image, pose)
    for point, row, place in zip(points, seen, places):
        elements = [pycolmap.TrackElement(int(index) + 1, int(place[index])) for index in np.flatnonzero(row)]
        made.add_point3D(point, pycolmap.Track(elements), _GREY)
    return made


def _tracks(scene: Scene, tile: TileFrame, parameters: TrackParameters) -> Tuple[FloatArray, Mask]:
    """(N, 3) points of the tile's frame that two views or more show, and (N, views) which show them."""
    levels = tuple(np.linspace(*tile.altitudes, parameters.altitudes))
    ground = ground_points(scene, tile.wide, levels, parameters.points)
    points = tile.frame.from_enu(scene.frame.from_geodetic(ground))
    pixels = [view.camera.project(points) for view in tile.views]
    inside = [((p >= 0) & (p <= np.array(view.size) - 1)).all(axis=1) for p, view in zip(pixels, tile.views)]
    seen = np.stack(inside, axis=1)
    shared = seen.sum(axis=1) >= 2
    return points[shared], seen[shared]
