"""The scene: the only thing that one stage hands to the next, read and written only here.

A scene is a JSON file with a schema number; a stage's products lie in folders next to it that have its name. It may be
moved or copied with these: it names files below its own folder from there, and other files by their whole path, from
which it finds them again where they moved with it.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from . import __version__
from .arrays import Altitudes, Bounds, FloatArray, Size, Window
from .errors import ImageError, RpcInvalidError, SceneError, SceneVersionError
from .geometry.equivalent_error import EquivalentError, RefinedPinhole
from .geometry.frames import EnuFrame
from .geometry.pinhole import PinholeCamera
from .geometry.refinement import SensorModel, Terrain, map_from_mapping
from .imagery.acquisition import acquired, moment
from .records import FilePath, HeightMapRecord, PointingFigures, Record, StageRecord, ViewPair, with_files
from .rpc import Rpc
from .workspace import write_text

SCHEMA = 2
_MAX_SCENE_BYTES = 512 << 20
_FIRST_STAGE = "'Fit equivalent pinhole cameras'"
_CHOOSE = f"choose the scene.json that {_FIRST_STAGE} wrote."
_IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class View(Record):
    """One image with its RPC, and where it really looks.

    ``pointing`` (2, 3) is the affine map from the pixel the vendor's RPC gives to the pixel where the ground point
    is really seen; the identity until relative pointing is known. ``acquired`` is when the image was taken, ISO 8601 in
    UTC, "" where it is unknown. ``mask`` is a raster of the image's size whose pixels that are neither zero nor nodata
    are not to be used, "" where there is none.
    """

    name: str
    image: FilePath
    band: int
    width: int
    height: int
    rpc: Rpc
    gsd_m: float
    pointing: FloatArray = field(default_factory=lambda: _IDENTITY.copy())
    acquired: str = ""
    mask: FilePath = ""

    @property
    def time(self) -> Optional[datetime]:
        """When the image was taken; None where it is unknown."""
        return moment(self.acquired)

    @property
    def size(self) -> Size:
        return self.width, self.height

    def project(self, lon_lat_h: FloatArray) -> FloatArray:
        """(..., 3) longitude, latitude, height to (..., 2) column, row, pointing included."""
        pixels: FloatArray = self.rpc.project(lon_lat_h) @ self.pointing[:, :2].T + self.pointing[:, 2]
        return pixels

    def localise(self, col_row: FloatArray, height: FloatArray | float) -> FloatArray:
        """(..., 2) column, row and heights to (..., 3) longitude, latitude, height, pointing included."""
        offset: FloatArray = np.asarray(col_row) - self.pointing[:, 2]
        raw: FloatArray = offset @ np.linalg.inv(self.pointing[:, :2]).T
        return self.rpc.localise(raw, height)

    def with_pointing(self, pointing: FloatArray) -> "View":
        return replace(self, pointing=np.asarray(pointing, dtype=np.float64))


@dataclass(frozen=True)
class TileView(Record):
    """How one view sees one tile: pixel window, fitted camera with its error, and the refinement once it is made."""

    window: Window
    camera: PinholeCamera
    error: EquivalentError
    refined: Optional[RefinedPinhole] = None
    image: Optional[FilePath] = None

    @classmethod
    def read(cls, values: Mapping[str, Any], terrain: Callable[[], Optional[Terrain]]) -> "TileView":
        """From JSON; ``terrain`` gives what a terrain-aware refinement needs."""
        view, refined = cls.from_mapping({**values, "refined": None}), values["refined"]
        if not refined:
            return view
        camera = PinholeCamera.from_mapping(refined["camera"])
        to_original = map_from_mapping(refined["to_original"], camera, terrain)
        width, height = map(int, refined["size"])
        error = EquivalentError(**refined["error"])
        return replace(view, refined=RefinedPinhole(camera, to_original, (width, height), error))


@dataclass(frozen=True)
class Tile(Record):
    """A ground rectangle (in the scene's CRS) with the altitude range expected in it."""

    id: str
    bounds: Bounds
    altitudes: Altitudes
    views: Dict[str, TileView]
    heights: Tuple[HeightMapRecord, ...] = ()

    @classmethod
    def read(cls, values: Mapping[str, Any], terrain: Callable[[str], Optional[Terrain]]) -> "Tile":
        """From JSON; ``terrain`` gives what a view's terrain-aware refinement needs."""
        views = {str(name): TileView.read(view, partial(terrain, str(name))) for name, view in values["views"].items()}
        return replace(cls.from_mapping({**values, "views": {}}), views=views)


@dataclass(frozen=True)
class Scene(Record):
    """Views, local frame, ground area, tiles, and what was done so far. A stage makes a new scene of the one before.

    ``area`` is the outline, as WKT in ``crs``, of the ground that at least two views see. ``altitudes`` are metres
    above the ellipsoid. ``dem`` is the terrain model that was given, "" for none. ``refinement`` is the model's name
    ("" before any), ``order`` the polynomial's, ``surface`` the file of the terrain model's coarse surface. Matching
    adds the ``pairs`` of views, their ``pointing``, the layer of ``tie_points`` and the ``backend``.
    """

    views: Tuple[View, ...]
    frame: EnuFrame
    crs: str
    area: str
    altitudes: Altitudes
    tiles: Tuple[Tile, ...]
    refinement: str = ""
    order: int = 2
    surface: FilePath = ""
    dem: FilePath = ""
    pairs: Tuple[ViewPair, ...] = ()
    pointing: Optional[PointingFigures] = None
    tie_points: FilePath = ""
    backend: str = ""
    history: Tuple[StageRecord, ...] = ()
    path: Path = Path("scene.json")

    def view(self, name: str) -> View:
        """A view by its name; raises SceneError with the names there are."""
        views = {view.name: view for view in self.views}
        if name not in views:
            raise SceneError(f"The scene '{self.path}' has no view '{name}': it has {', '.join(views)}.")
        return views[name]

    def require_images(self) -> None:
        """Raise SceneError with the images and masks that are not where the scene knows them, nor moved with it."""
        files = [file for view in self.views for file in (view.image, view.mask) if os.path.isabs(file)]
        missing = [file for file in files if not (file.startswith("/vsi") or os.path.exists(file))]
        if missing:
            names = ", ".join(f"'{file}'" for file in missing)
            raise SceneError(
                f"The scene '{self.path}' needs {names}, which is not there: put the image back, or run "
                f"{_FIRST_STAGE} again with the images where they are now."
            )

    def terrain(self, sensor: SensorModel) -> Optional[Terrain]:
        """The terrain that refines an image with this exact model; None unless the refinement is terrain-aware.

        Raises ImageError where the surface's file is gone.
        """
        if self.refinement != "terrain":
            return None
        from .imagery.dem import load_surface

        return Terrain(sensor, self.frame, load_surface(self.surface))

    @property
    def gsd_m(self) -> float:
        """The finest view's ground sampling distance."""
        return min(view.gsd_m for view in self.views)

    @property
    def fingerprint(self) -> str:
        """What the last stage that worked on the scene was made from."""
        return self.history[-1].fingerprint if self.history else ""

    def lean(self) -> "Scene":
        """The scene without tiles and history: what a worker needs of it."""
        return replace(self, tiles=(), pairs=(), pointing=None, history=())

    def with_tiles(self, change: Callable[[Tile], Tile]) -> "Scene":
        """The scene with each tile changed."""
        return replace(self, tiles=tuple(map(change, self.tiles)))

    def folder(self, kind: str) -> Path:
        """The folder of one kind of products: next to the scene's file, with its name."""
        return self.path.parent / f"{self.path.stem}_{kind}"

    def recorded(
        self,
        stage: str,
        key: str,
        options: Mapping[str, Any],
        seconds: float,
        warnings: Sequence[str] = (),
        parameters: Optional[Dict[str, Any]] = None,
    ) -> "Scene":
        """The scene with a finished stage in its history, where it replaces an earlier record of the same stage."""
        facts = round(seconds, 3), dict(options), tuple(warnings), parameters or {}
        earlier = (entry for entry in self.history if entry.stage != stage)
        return replace(self, history=(*earlier, StageRecord(stage, key, __version__, *facts)))

    def record_of(self, stage: str) -> Optional[StageRecord]:
        """The record of a finished stage; None where it has not been run."""
        return next((entry for entry in self.history if entry.stage == stage), None)

    def save(self, path: str) -> str:
        """Write the scene, completely or not at all."""
        folder = os.path.dirname(os.path.abspath(path))
        found = with_files(self, partial(_stored, folder)).to_mapping()
        document = {"format": "repm-scene", "schema": SCHEMA, "engine": __version__, "folder": folder, **found}
        del document["path"]
        return write_text(str(path), json.dumps(document, indent=1, allow_nan=False))

    @classmethod
    def load(cls, path: str) -> "Scene":
        """Read a scene.

        Raises SceneError where the file is missing, damaged or no scene, SceneVersionError where a newer version of
        the plugin wrote it.
        """
        document = _document(path)
        try:
            find = partial(_found, os.path.dirname(os.path.abspath(path)), str(document.get("folder", "")))
            scene = with_files(cls.from_mapping({**document, "tiles": [], "path": Path(path)}), find)
            # Stored refinements belong to the vendors' RPCs; pointing came later.
            tiles = [Tile.read(tile, lambda name: scene.terrain(scene.view(name).rpc)) for tile in document["tiles"]]
            return replace(scene, tiles=tuple(with_files(tile, find) for tile in tiles))
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError, IndexError) as error:
            reason = f"{type(error).__name__}: {error}"
            raise SceneError(f"The scene '{path}' is damaged ({reason}): make it anew with {_FIRST_STAGE}.") from error


_BELOW = "./"  # how a stored path begins that is relative to the scene's folder


def _stored(folder: str, path: str) -> str:
    """A file's path as a scene in this folder keeps it."""
    whole = os.path.abspath(path) if os.path.exists(path) else path
    below = whole.startswith(os.path.join(folder, ""))
    return _BELOW + Path(os.path.relpath(whole, folder)).as_posix() if below else whole


def _found(folder: str, before: str, path: str) -> str:
    """The file that a scene in this folder means, which may have been in another folder ``before``."""
    if path.startswith(_BELOW):
        return os.path.join(folder, *path[len(_BELOW) :].split("/"))
    if before in ("", folder) or not os.path.isabs(path) or os.path.exists(path):
        return path
    try:
        moved = os.path.normpath(os.path.join(folder, os.path.relpath(path, before)))
    except ValueError:  # another drive
        return path
    return moved if os.path.exists(moved) else path


def _document(path: str) -> Dict[str, Any]:
    """The JSON object of a scene file, with format and schema checked."""
    try:
        if os.path.getsize(path) > _MAX_SCENE_BYTES:
            raise SceneError(f"The scene '{path}' is larger than {_MAX_SCENE_BYTES >> 20} MiB: it is no scene of ours.")
        with open(path, encoding="utf-8") as stream:
            document = json.load(stream)
    except OSError as error:
        raise SceneError(f"Cannot read the scene '{path}' ({error.strerror or error}): {_CHOOSE}") from error
    except (ValueError, RecursionError) as error:
        raise SceneError(f"The scene '{path}' is not a JSON file ({error}): {_CHOOSE}") from error
    if not isinstance(document, dict) or document.get("format") != "repm-scene":
        raise SceneError(f"'{path}' is not a REPM scene: {_CHOOSE}")
    schema = document.get("schema")
    if not isinstance(schema, int) or schema > SCHEMA:
        found = f"has schema {schema}, this version of the plugin reads up to {SCHEMA}"
        raise SceneVersionError(f"The scene '{path}' {found}: update the plugin, or make the scene anew.")
    if schema < SCHEMA:
        found = f"has schema {schema} of an earlier version of the plugin, this version reads {SCHEMA}"
        raise SceneError(f"The scene '{path}' {found}: make the scene anew with {_FIRST_STAGE}.")
    return document


def origin(path: str) -> Tuple[str, str]:
    """The workspace in which a scene began, and its first image; "" for what its file does not contain."""
    try:
        document = _document(path)
        first = {entry["stage"]: entry["options"] for entry in document["history"]}.get("epmfit", {})
        return str(first.get("workspace", "")), str(document["views"][0]["image"])
    except (SceneError, KeyError, TypeError, AttributeError, IndexError):
        return "", ""


def reusable(path: str, stage: str, key: str) -> Optional[Scene]:
    """The scene at ``path`` if its last stage was this one, made from the very same things; else None."""
    if not os.path.exists(path):
        return None
    try:
        scene = Scene.load(path)
    except SceneVersionError:
        raise
    except SceneError:
        return None
    last = scene.history[-1] if scene.history else None
    return scene if last is not None and (last.stage, last.fingerprint) == (stage, key) else None


def load_views(images: Sequence[str], rpcs: Sequence[str] = (), masks: Sequence[str] = ()) -> Tuple[View, ...]:
    """Open images, read their RPCs, and make views; names are unique, in the order given.

    ``rpcs`` names the images' RPC files in the same order; "" is for an image whose RPC is to be found, as all are
    where the sequence is empty. ``masks`` likewise names rasters of what is not to be used, "" for none.

    Raises ImageError or an RpcError with the file's name.
    """
    from .imagery.raster import grey_band, name_of, opened, opened_masked
    from .rpc.readers import rpc_of

    views: List[View] = []
    none = [""] * len(images)
    for path, rpc_file, mask in zip(images, rpcs or none, masks or none):
        with opened(path) as dataset:
            rpc = rpc_of(dataset, path, rpc_file)
            width, height, band = dataset.RasterXSize, dataset.RasterYSize, grey_band(dataset)
            when = acquired(dataset, path)
        with opened_masked(path, mask):  # a mask that does not fit is reported now, not later in a worker
            mask = os.path.abspath(mask) if os.path.exists(mask) else mask
        if min(width, height) < 64:
            raise ImageError(f"'{path}' is only {width} x {height} px: matching needs at least 64 px a side.")
        taken = {view.name for view in views}
        name = name_of(path)
        while name in taken:
            name = f"{name}_{len(views) + 1}"
        image, gsd = os.path.abspath(path) if os.path.exists(path) else path, _gsd(path, rpc, width, height)
        views.append(View(name, image, band, width, height, rpc, gsd, acquired=when, mask=mask))
    return tuple(views)


def _gsd(path: str, rpc: Rpc, width: int, height: int) -> float:
    """Ground sampling distance at the image's centre and the RPC's middle height, geometric mean of both axes, m."""
    centre = np.array([[width / 2, height / 2]]) + np.array([[0, 0], [1, 0], [0, 1]])
    ground = rpc.localise(centre, rpc.height_off)
    if not np.isfinite(ground).all():
        middle = f"the image's centre (column {width / 2:g}, row {height / 2:g})"
        question = "is it another image's RPC, or that of the uncropped image?"
        raise RpcInvalidError(f"The RPC of '{path}' does not see {middle}: {question}")
    enu = EnuFrame(ground[0, 0], ground[0, 1]).from_geodetic(ground)
    gsd = math.sqrt(float(np.linalg.norm(enu[1] - enu[0]) * np.linalg.norm(enu[2] - enu[0])))
    if not 0.01 <= gsd <= 1000:
        raise RpcInvalidError(f"The RPC of '{path}' gives pixels of {gsd:g} m on the ground: no satellite's.")
    return gsd
