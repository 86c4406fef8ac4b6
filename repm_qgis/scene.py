"""The scene: the only thing that one stage hands to the next, read and written only here.

A scene is a JSON file with a schema number; a stage's products lie in folders next to it that have its name. It may be
moved or copied with these: it names files below its own folder from there, and other files by their whole path, and
also finds them where they moved together with it.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from . import __version__
from .contracts.arrays import FloatArray, Size, Window
from .contracts.checks import Choice, Misfit, Number, file_name, mapping, member, shown, typed
from .contracts.documents import JsonMapping, JsonObject
from .contracts.errors import ImageError, OptionError, RpcInvalidError, SceneError, SceneVersionError, reason_of
from .contracts.findings import Finding
from .contracts.options import BACKENDS, MODELS, PRESETS
from .contracts.record import Record
from .contracts.records import (
    FilePath,
    Ground,
    HeightMapRecord,
    Heights,
    Name,
    OwnFilePath,
    Pointing,
    PointingFigures,
    RegistrationFigures,
    StageRecord,
    ViewPair,
    with_files,
)
from .files.untrusted import MOST_SIDE_PX
from .geometry.equivalent_error import EquivalentError, RefinedPinhole
from .geometry.footprints import bounds_of_wkt
from .geometry.frames import EnuFrame, projected_crs
from .geometry.jitter import Jitter
from .geometry.map_plane import MapPlane
from .geometry.pinhole import PinholeCamera
from .geometry.refinement import SensorModel, Terrain
from .geometry.tiles import enclosing
from .geometry.vertical import PLACED
from .imagery.acquisition import acquired, moment, sensor_of
from .imagery.enhancement import Stretch, view_stretch
from .imagery.ortho_ready import OrthoReady, plane_of
from .imagery.parameters import SAMPLING, STRETCH, StretchParameters
from .rpc import Rpc
from .runtime.workspace import write_text

SCHEMA = 2
_MAX_SCENE_BYTES = 512 << 20
_FIRST_STAGE = "'Fit equivalent pinhole cameras'"
_CHOOSE = f"choose the scene.json that {_FIRST_STAGE} wrote."
_GSD_M = 0.01, 1000.0
_GSD_RATIO = 1.3  # between the GSDs of RPC and image: relief and oblique views cause less, resampled pixels more
_IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

Side = Annotated[int, Number(1, MOST_SIDE_PX, "px", whole=True)]


@dataclass(frozen=True)
class ProjectedCrs:
    """A projected CRS in metres that PROJ knows."""

    def problem(self, value: str) -> str:
        try:
            projected_crs(value)
        except OptionError as error:
            return error.reason
        return ""


@dataclass(frozen=True)
class Area:
    """An area as WKT."""

    def problem(self, value: str) -> str:
        return "" if bounds_of_wkt(value) is not None else "must be an area as WKT"


@dataclass(frozen=True)
class View(Record):
    """One image with its RPC, and where it really looks.

    ``pointing`` (2, 3) is the affine map from the pixel the vendor's RPC gives to the pixel where the ground point
    is really seen; the identity until relative pointing is known. ``acquired`` is when the image was taken, ISO 8601 in
    UTC, and ``sensor`` by which satellite (a name of ``imagery/sensors.py``), "" where they are unknown. ``mask`` is a
    raster of the image's size whose pixels that are neither zero nor nodata are not to be used, "" where there is none.
    ``part`` is the window that shows the area of the run, None for the whole image: statistics are taken there.
    ``content`` is a digest that distinguishes the image from another one with its name, "" where there is none, and
    ``stated`` one of the RPC in the scene's file, by which a change there is seen; "" elsewhere.
    ``plane`` is the map that an ortho-ready image was projected to, None for an image in its sensor's geometry: then
    ``rpc`` gives lines of sight only, and ``model`` the pixels. ``jitter`` are waves of the attitude, which come on top
    of the pointing; None where none are known.
    """

    name: Name
    image: FilePath
    band: Annotated[int, Number(0, 65535, whole=True)]
    width: Side
    height: Side
    rpc: Rpc
    gsd_m: Annotated[float, Number(*_GSD_M, "m")]
    pointing: Pointing = field(default_factory=lambda: _IDENTITY.copy())
    acquired: str = ""
    mask: FilePath = ""
    sensor: str = ""
    part: Optional[Window] = None
    content: str = ""
    plane: Optional[MapPlane] = None
    jitter: Optional[Jitter] = None
    stated: str = ""

    def to_mapping(self) -> JsonObject:
        return {**super().to_mapping(), "stated": self.rpc.digest}

    def contradiction(self) -> str:
        if self.stated not in ("", self.rpc.digest):
            return f"has an RPC that is not the one which was read from '{self.image}'"
        turned = abs(np.linalg.det(self.pointing[:, :2]))
        if not 0.5 < turned < 2.0:
            return "has a pointing that is too large for a correction"
        whole = Window(0, 0, *self.size)
        return "" if self.part is None or self.part.common(whole) == self.part else "has a part outside its image"

    @property
    def model(self) -> Union[Rpc, OrthoReady]:
        """The exact model of the image's pixels, as the vendor delivered it."""
        return self.rpc if self.plane is None else OrthoReady(self.rpc, self.plane)

    @property
    def elongation(self) -> float:
        """How many times as long as wide pixels are on the ground, at the image's middle; 1 for squares."""
        middle = (np.array(self.size) - 1) / 2
        ground = self.localise(middle + np.array([[0, 0], [1, 0], [0, 1]]), self.rpc.height_off)
        places = EnuFrame(ground[0, 0], ground[0, 1]).from_geodetic(ground)
        sides = (places[1:] - places[0])[:, :2]
        long, short = np.linalg.svd(sides, compute_uv=False) if np.isfinite(sides).all() else (1.0, 1.0)
        return float(long / short) if short > 0 else 1.0

    @property
    def time(self) -> Optional[datetime]:
        """When the image was taken; None where it is unknown."""
        return moment(self.acquired)

    @property
    def size(self) -> Size:
        return self.width, self.height

    @property
    def missing(self) -> List[str]:
        """Its image and mask, as far as they are not where they should be; files that GDAL reads from elsewhere are
        assumed to exist."""
        files = [file for file in (self.image, self.mask) if os.path.isabs(file)]
        return [file for file in files if not (file.startswith("/vsi") or os.path.exists(file))]

    @property
    def replaced(self) -> bool:
        """Whether another image has taken the name of this one."""
        from .imagery.raster import content_of

        now = content_of(self.image) if self.content else ""
        return bool(now) and now != self.content

    def project(self, lon_lat_h: FloatArray) -> FloatArray:
        """(..., 3) longitude, latitude, height to (..., 2) column, row, pointing included."""
        pixels: FloatArray = self.model.project(lon_lat_h) @ self.pointing[:, :2].T + self.pointing[:, 2]
        return pixels if self.jitter is None else self.jitter.added(pixels)

    def localise(self, col_row: FloatArray, height: FloatArray | float) -> FloatArray:
        """(..., 2) column, row and heights to (..., 3) longitude, latitude, height, pointing included."""
        steady = np.asarray(col_row) if self.jitter is None else self.jitter.removed(np.asarray(col_row))
        offset: FloatArray = steady - self.pointing[:, 2]
        linear = self.pointing[:, :2]
        if (linear == _IDENTITY[:, :2]).all():  # a shift, as nearly always: many frames are placed many times
            return self.model.localise(offset, height)
        raw: FloatArray = offset @ np.linalg.inv(linear).T
        return self.model.localise(raw, height)

    def stretch(self, parameters: StretchParameters = STRETCH) -> Stretch:
        """The stretch of the view's intensities, the same in all stages. Raises ImageError where it shows nothing."""
        return view_stretch(self.image, self.band, self.mask, parameters, self.part)

    @property
    def steady(self) -> "View":
        """The view without jitter."""
        return self if self.jitter is None else replace(self, jitter=None)

    def with_pointing(self, pointing: FloatArray, jitter: Optional[Jitter] = None) -> "View":
        """The view with another correction in the place of its own."""
        return replace(self, pointing=np.asarray(pointing, dtype=np.float64), jitter=jitter)


def common_gsd_m(gsd_m: Sequence[float]) -> Tuple[float, ...]:
    """For each pair's GSD, the coarsest one of those that are about alike: keypoints of one view that are found at
    different scales are no common tie points, so that there are as few scales as possible."""
    common: Dict[float, float] = {}
    coarsest = math.inf
    for one in sorted(set(gsd_m), reverse=True):
        coarsest = coarsest if coarsest <= SAMPLING.alike * one else one
        common[one] = coarsest
    return tuple(common[one] for one in gsd_m)


def finest_gsd_m(views: Sequence[View]) -> float:
    """The finest ground sampling distance at which a pair of views can be matched: that of the finest view, unless it
    is much finer than all others."""
    finest, *others = sorted(view.gsd_m for view in views)
    return others[0] if others and others[0] > SAMPLING.alike * finest else finest


def pair_gsd_m(coarser: float, finest: float) -> float:
    """The ground sampling distance at which a pair is matched: that of its ``coarser`` view, where it is much coarser
    than the ``finest`` of the scene, else that."""
    return coarser if coarser > SAMPLING.alike * finest else finest


@dataclass(frozen=True)
class TileView(Record):
    """How one view sees one tile: pixel window, fitted camera with its error, and the refinement once it is made."""

    window: Window
    camera: PinholeCamera
    error: EquivalentError
    refined: Optional[RefinedPinhole] = None
    image: Optional[OwnFilePath] = None

    @classmethod
    def read(cls, values: JsonMapping, terrain: Callable[[], Optional[Terrain]]) -> "TileView":
        """From JSON; ``terrain`` gives what a terrain-aware refinement needs."""
        refined = values.get("refined")
        if isinstance(refined, Mapping):
            with member("refined"):
                refined = RefinedPinhole.read(refined, terrain)
        return cls.from_mapping({**values, "refined": refined})


@dataclass(frozen=True)
class Tile(Record):
    """A ground rectangle (in the scene's CRS) with the altitude range expected in it."""

    id: Name
    bounds: Ground
    altitudes: Heights
    views: Dict[str, TileView]
    heights: Tuple[HeightMapRecord, ...] = ()

    @classmethod
    def read(cls, values: JsonMapping, terrain: Callable[[str], Optional[Terrain]]) -> "Tile":
        """From JSON; ``terrain`` gives what a view's terrain-aware refinement needs."""
        views = {}
        for name, view in mapping(mapping(values).get("views")).items():
            with member("views"), member(name):
                views[name] = TileView.read(mapping(view), partial(terrain, name))
        return cls.from_mapping({**values, "views": views})

    def misplaced(self, views: Mapping[str, View]) -> str:
        """The part of the tile that does not belong to a scene with these views; "" where all does."""
        for name, seen in self.views.items():
            if name not in views:
                return f"has a view '{name}', which the scene does not have"
            view, (col, row, width, height) = views[name], seen.window
            if not (0 <= col < col + width <= view.width and 0 <= row < row + height <= view.height):
                return f"has a window {tuple(seen.window)} outside the view '{name}' of {view.width} x {view.height} px"
        for record in self.heights:
            named = {*record.pair, *record.sources, *record.views}
            if record.tile != self.id or not named <= set(views) or len(set(record.pair)) < 2:
                return f"has a height map of the tile '{record.tile}' and the views {', '.join(sorted(named))}"
        return ""


@dataclass(frozen=True)
class Scene(Record):
    """Views, local frame, ground area, tiles, and what was done so far. A stage makes a new scene of the one before.

    ``area`` is the outline, as WKT in ``crs``, of the ground that at least two views see. ``altitudes`` are metres
    above the ellipsoid. ``dem`` is the terrain model that was given, "" for none. ``refinement`` is the model's name
    ("" before any), ``order`` the polynomial's, ``surface`` the file of the terrain model's coarse surface. Matching
    adds the ``pairs`` of views, their ``pointing``, the layer of ``tie_points`` and the ``backend``. A
    ``registration`` has moved the views' pointing, tiles, area and altitudes since. ``preset`` is the
    one that the last run of the pipeline was given; its values are in the ``history``, with all other options.
    """

    views: Tuple[View, ...]
    frame: EnuFrame
    crs: Annotated[str, ProjectedCrs()]
    area: Annotated[str, Area()]
    altitudes: Heights
    tiles: Tuple[Tile, ...]
    refinement: Annotated[str, Choice(("", *MODELS))] = ""
    order: Annotated[int, Number(2, 5, whole=True)] = 2
    surface: OwnFilePath = ""
    dem: FilePath = ""
    pairs: Tuple[ViewPair, ...] = ()
    pointing: Optional[PointingFigures] = None
    tie_points: OwnFilePath = ""
    backend: Annotated[str, Choice(("", *BACKENDS))] = ""
    history: Tuple[StageRecord, ...] = ()
    path: Path = Path("scene.json")
    preset: Annotated[str, Choice(tuple(PRESETS))] = "none"
    registration: Optional[RegistrationFigures] = None

    def contradiction(self) -> str:
        views = {view.name: view for view in self.views}
        if not self.views or len(views) < len(self.views):
            return "has no views, or views without distinct names"
        for tile in self.tiles:
            wrong = tile.misplaced(views)
            if wrong:
                return f"has a tile '{tile.id}' that {wrong}"
        if len({tile.id for tile in self.tiles}) < len(self.tiles):
            return "has two tiles of the same name"
        unknown = {record.backend for tile in self.tiles for record in tile.heights} - {*BACKENDS[1:]}
        if unknown:
            return f"has height maps of the backend '{sorted(unknown)[0]}', which this version does not know"
        if not self._within_images():
            return "has an area or a tile that is larger than its images"
        for pair in (*(pair.names for pair in self.pairs), *self._tied):
            if pair[0] == pair[1] or not {*pair} <= set(views):
                return f"has a pair {pair[0]}, {pair[1]}, which are not two of its views"
        if self.registration and set(self.registration.matched) != set(views):
            return "has a registration of other views"
        waves = self.registration.matched_waves if self.registration else {}
        for name, values in waves.items():
            if (
                name not in views
                or len(values) < 2
                or Jitter(float(values[0, 0]), float(values[0, 1]), values[1:]).contradiction()
            ):
                return f"has a registration with invalid waves of '{name}'"
        if self.refinement == "terrain" and not self.surface:
            return "has the refinement 'terrain', and no surface"
        return ""

    def _within_images(self) -> bool:
        """Whether tiles and area are no larger than images of these sizes can show; products would be as large."""
        longest = [2.0 * math.hypot(*view.size) * view.gsd_m + 10.0 for view in self.views]
        outline, tiles = bounds_of_wkt(self.area), [tile.bounds for tile in self.tiles]
        whole = enclosing([*tiles, outline] if outline else tiles)
        sides = [max(box.xmax - box.xmin, box.ymax - box.ymin) for box in (whole, *tiles)]
        return sides[0] <= sum(longest) and max(sides[1:], default=0.0) <= max(longest)

    @property
    def _tied(self) -> List[Tuple[str, str]]:
        return [figures.pair for figures in self.pointing.pairs] if self.pointing else []

    def view(self, name: str) -> View:
        """A view by its name; raises SceneError with the names that exist."""
        views = {view.name: view for view in self.views}
        if name not in views:
            raise SceneError(f"The scene '{self.path}' has no view '{name}': it has {', '.join(views)}.")
        return views[name]

    def taken(self) -> Optional[Tuple[str, str]]:
        """When the first and the last image were taken (ISO 8601, UTC), of those whose time is known; None of none."""
        times = sorted(view.acquired for view in self.views if view.time is not None)
        return (times[0], times[-1]) if times else None

    def days(self) -> List[str]:
        """The days (UTC, ISO 8601) on which the images were taken, in order; empty where none is known."""
        return sorted({view.time.date().isoformat() for view in self.views if view.time is not None})

    def require_two_images(self) -> None:
        """Raise SceneError for a scene of one image, which has a camera and errors, but no heights."""
        if len(self.views) < 2:
            raise SceneError(
                f"The scene '{self.path}' has one image, '{self.views[0].image}', and heights need two: run "
                f"{_FIRST_STAGE} again with another image of this ground."
            )

    def require_images(self) -> None:
        """Raise SceneError with the images and masks that are not at their stored place and did not move with the
        scene, and with images that are others than those it was made from."""
        missing = [file for view in self.views for file in view.missing]
        if missing:
            names = ", ".join(f"'{file}'" for file in missing)
            raise SceneError(
                f"The scene '{self.path}' needs {names}, which is not there: restore the image, or run "
                f"{_FIRST_STAGE} again with the images where they are now."
            )
        self.require_same_images()

    def require_same_images(self) -> None:
        """Raise SceneError with images that others have replaced since the scene was made; of those that are there."""
        replaced = ", ".join(f"'{view.image}'" for view in self.views if view.replaced)
        if replaced:
            raise SceneError(
                f"The scene '{self.path}' was made from other pixels than {replaced} has now: restore the image, or "
                f"run {_FIRST_STAGE} again with this one."
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
        """The finest ground sampling distance at which a pair is matched (:func:`finest_gsd_m`)."""
        return finest_gsd_m(self.views)

    def matched_gsd_m(self, names: Sequence[str]) -> float:
        """The ground sampling distance at which views are matched with each other (:func:`pair_gsd_m`)."""
        return pair_gsd_m(max(self.view(name).gsd_m for name in names), self.gsd_m)

    def matched_side_m(self, names: Sequence[str]) -> float:
        """The longer side on the ground of the pixels at which views are matched with each other, m: those of an RPC
        with pixels of 0.06 x 0.5 m have a ground sampling distance of 0.17 m, and lie 0.5 m apart."""
        return self.matched_gsd_m(names) * math.sqrt(max(self.view(name).elongation for name in names))

    @property
    def placed(self) -> str:
        """How the scene's absolute position was determined, one of ``PLACED``; "" for the RPCs alone."""
        if self.registration is not None:
            return PLACED[0]
        return PLACED[1] if self.pointing is not None and self.pointing.controlled else ""

    @property
    def fingerprint(self) -> str:
        """The fingerprint of the last stage that worked on the scene."""
        return self.history[-1].fingerprint if self.history else ""

    def lean(self) -> "Scene":
        """The scene without tiles and history: what a worker needs of it."""
        return replace(self, tiles=(), pairs=(), pointing=None, history=())

    @property
    def as_matched(self) -> "Scene":
        """The scene with the pointing that its height maps were matched with."""
        if self.registration is None:
            return self
        matched, waves = self.registration.matched, self.registration.matched_waves
        views = tuple(
            view.with_pointing(
                matched[view.name], Jitter.unpacked(waves.get(view.name)) if self.waves_changed else view.jitter
            )
            for view in self.views
        )
        return replace(self, views=views)

    @property
    def waves_changed(self) -> bool:
        """Whether the views have other waves than their height maps were matched with."""
        return self.registration is not None and self.registration.waves_m is not None

    def with_tiles(self, change: Callable[[Tile], Tile]) -> "Scene":
        """The scene with each tile changed."""
        return replace(self, tiles=tuple(map(change, self.tiles)))

    def folder(self, kind: str) -> Path:
        """The folder of one kind of products: next to the scene's file, with its name."""
        return folder_of(self.path, kind)

    def recorded(
        self,
        stage: str,
        key: str,
        options: JsonMapping,
        seconds: float,
        warnings: Sequence[Finding] = (),
        parameters: Optional[JsonObject] = None,
    ) -> "Scene":
        """The scene with a finished stage in its history, where it replaces an earlier record of the same stage."""
        record = StageRecord(
            stage=stage,
            fingerprint=key,
            engine=__version__,
            seconds=round(seconds, 3),
            options=dict(options),
            warnings=tuple(warnings),
            parameters=parameters or {},
        )
        return replace(self, history=(*(entry for entry in self.history if entry.stage != stage), record))

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
            before = typed(str, document.get("folder", ""))
            find = partial(_found, os.path.dirname(os.path.abspath(path)), before)
            scene = with_files(cls.from_mapping({**document, "tiles": [], "path": Path(path)}), find)
            tiles = []
            with member("tiles"):
                for number, values in enumerate(typed(Tuple[object, ...], document.get("tiles"))):
                    # Stored refinements belong to the vendors' RPCs; pointing came later.
                    with member(number):
                        tile = Tile.read(values, lambda name: scene.terrain(scene.view(name).model))
                    tiles.append(with_files(tile, find))
            return cls.from_mapping({**vars(scene), "tiles": tiles})
        except (Misfit, RpcInvalidError, SceneError) as error:
            raise SceneError(f"The scene '{path}' is damaged ({error}): make it again with {_FIRST_STAGE}.") from error


def folder_of(scene: Path, kind: str) -> Path:
    """The folder of one kind of products of the scene with this file."""
    return scene.parent / f"{scene.stem}_{kind}"


_BELOW = "./"  # the beginning of stored paths that are relative to the scene's folder


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


def _document(path: str) -> JsonObject:
    """The JSON object of a scene file, with format and schema checked."""
    try:
        if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
            raise SceneError(f"The scene '{path}' is a pipe or a device, not a file: {_CHOOSE}")  # which would wait
        if os.path.getsize(path) > _MAX_SCENE_BYTES:
            raise SceneError(
                f"The scene '{path}' is larger than {_MAX_SCENE_BYTES >> 20} MiB: choose one that REPM wrote."
            )
        with open(path, encoding="utf-8") as stream:
            document = json.load(stream)
    except OSError as error:
        raise SceneError(f"Cannot read the scene '{path}' ({reason_of(error)}): {_CHOOSE}") from error
    except (ValueError, RecursionError) as error:
        raise SceneError(f"The scene '{path}' is not a JSON file ({error}): {_CHOOSE}") from error
    if not isinstance(document, dict) or document.get("format") != "repm-scene":
        raise SceneError(f"'{path}' is not a REPM scene: {_CHOOSE}")
    schema = document.get("schema")
    if not isinstance(schema, int) or schema > SCHEMA:
        found = f"has schema {shown(schema)}, this version of the plugin reads up to {SCHEMA}"
        raise SceneVersionError(f"The scene '{path}' {found}: update the plugin, or make the scene again.")
    if schema < SCHEMA:
        found = f"has schema {schema} of an earlier version of the plugin, this version reads {SCHEMA}"
        raise SceneError(f"The scene '{path}' {found}: make the scene again with {_FIRST_STAGE}.")
    return document


class SceneFacts(NamedTuple):
    """What a scene's file says without its tiles: views, the outline of their ground (WKT in ``crs``), the ``folder``
    in which it was written, and what was done."""

    views: Tuple[View, ...]
    crs: str
    area: str
    folder: str
    history: Tuple[StageRecord, ...]


def facts_of(path: str) -> SceneFacts:
    """The :class:`SceneFacts` of a scene, faster than the scene itself; raises SceneError where it cannot be read."""
    document = _document(path)
    try:
        folder = typed(str, document.get("folder", ""))
        find = partial(_found, os.path.dirname(os.path.abspath(path)), folder)
        views, history = (typed(Tuple[object, ...], document.get(name)) for name in ("views", "history"))
        return SceneFacts(
            tuple(with_files(View.from_mapping(mapping(entry)), find) for entry in views),
            typed(str, document.get("crs")),
            typed(str, document.get("area")),
            folder,
            tuple(StageRecord.from_mapping(mapping(entry)) for entry in history),
        )
    except (Misfit, RpcInvalidError) as error:
        raise SceneError(f"The scene '{path}' is damaged ({error}): make it again with {_FIRST_STAGE}.") from error


def origin(path: str) -> Tuple[str, List[str]]:
    """The workspace in which a scene began, "" where its file does not say it, and its images."""
    try:
        document = _document(path)
        first = {entry["stage"]: entry["options"] for entry in document["history"]}.get("epmfit", {})
        return str(first.get("workspace", "")), [str(view["image"]) for view in document["views"]]
    except (SceneError, KeyError, TypeError, AttributeError, IndexError):
        return "", []


def days(path: str) -> List[str]:
    """The days (UTC, ISO 8601) on which a scene's images were taken, in order; empty where none is known."""
    try:
        times = [moment(str(view["acquired"])) for view in _document(path)["views"]]
    except (SceneError, KeyError, TypeError):
        return []
    return sorted({time.date().isoformat() for time in times if time is not None})


def is_registered(path: str) -> bool:
    """Whether a scene was registered to a reference; False for a file that is no scene."""
    try:
        return _document(path).get("registration") is not None
    except (SceneError, AttributeError):
        return False


def serves(path: str, stage: str) -> bool:
    """Whether a stage can take a scene, and has not written it itself; False for a file that is no scene."""
    try:
        document = _document(path)
        if document["history"][-1]["stage"] == stage:
            return False
        if stage == "dsmfuse":
            return any(tile["heights"] for tile in document["tiles"])
        return stage != "exportcameras" or bool(document["refinement"])
    except (SceneError, KeyError, TypeError, IndexError):
        return False


class GroundSeen(NamedTuple):
    """Upper bounds of what images can show together: the finest ground sampling distance at which they can be matched
    and the longest side, m; their place."""

    gsd_m: float
    side_m: float
    lon: float
    lat: float

    @classmethod
    def of(cls, views: Sequence[View]) -> "GroundSeen":
        # Two images share no more than the smaller of the two largest shows.
        sides = sorted((math.hypot(*view.size) * view.gsd_m for view in views), reverse=True)
        lon, lat = middle_of(views)
        return cls(finest_gsd_m(views), sides[min(1, len(sides) - 1)], lon, lat)


def ground_of(path: str) -> Optional[GroundSeen]:
    """The :class:`GroundSeen` of a scene's images, from its views only, which is fast; None where the file is no
    scene."""
    try:
        entries = typed(Tuple[object, ...], _document(path).get("views"))
        views = [View.from_mapping(mapping(entry)) for entry in entries]
        return GroundSeen.of(views) if views else None
    except (SceneError, Misfit, RpcInvalidError, IndexError):
        return None


def reusable(path: str, stage: str, key: str) -> Optional[Scene]:
    """The scene at ``path`` if its last stage was this one, with the same fingerprint; else None."""
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


def load_views(
    images: Sequence[str],
    rpcs: Sequence[str] = (),
    masks: Sequence[str] = (),
    whole: bool = True,
    height: Optional[float] = None,
) -> Tuple[View, ...]:
    """Open images, read their RPCs, and make views; names are unique, in the order given.

    ``rpcs`` names the images' RPC files in the same order; "" is for an image whose RPC is to be found, as all are
    where the sequence is empty. ``masks`` likewise names rasters of what is not to be used, "" for none. ``whole``:
    no EXTENT says that only a part of them will be read, and files that hold almost nothing are refused. ``height`` is
    the plane's, m above the ellipsoid, of ortho-ready images whose metadata do not state it; None: unknown.

    Raises ImageError or an RpcError with the file's name.
    """
    views: List[View] = []
    none = [""] * len(images)
    for path, rpc_file, mask in zip(images, rpcs or none, masks or none):
        views.append(load_view(path, rpc_file, mask, views, whole, height))
    return tuple(views)


def load_view(
    path: str,
    rpc_file: str = "",
    mask: str = "",
    others: Sequence[View] = (),
    whole: bool = True,
    height: Optional[float] = None,
) -> View:
    """One of the views of :func:`load_views`, with a name that none of the others has."""
    from .imagery.raster import content_of, grey_band, name_of, opened_image, opened_masked
    from .imagery.spacing import stated_spacings
    from .rpc.readers import rpc_of

    with opened_image(path, whole) as dataset:
        rpc = rpc_of(dataset, path, rpc_file)
        plane = plane_of(dataset, path, rpc, height)
        columns, rows, band = dataset.RasterXSize, dataset.RasterYSize, grey_band(dataset)
        when, sensor = acquired(dataset, path), sensor_of(dataset, path)
        stated = tuple(stated_spacings(dataset))
    with opened_masked(path, mask):  # a mask of the wrong size is reported now, not later in a worker
        mask = os.path.abspath(mask) if os.path.exists(mask) else mask
    if min(columns, rows) < 64:
        raise ImageError(f"'{path}' is only {columns} x {rows} px: matching needs at least 64 px a side.")
    taken = {view.name.lower() for view in others}  # products are named after it: most file systems ignore case
    name = file_name(name_of(path))
    while name.lower() in taken:
        name = f"{name}_{len(others) + 1}"
    image = os.path.abspath(path) if os.path.exists(path) else path
    gsd = _gsd(path, rpc if plane is None else OrthoReady(rpc, plane), rpc.height_off, columns, rows)
    for metres, where in stated:
        if not 1 / _GSD_RATIO <= metres / gsd <= _GSD_RATIO:
            raise RpcInvalidError(
                f"The RPC of '{path}' gives pixels of {gsd:.3g} m on the ground, but {where} says {metres:.3g} m: if "
                "the image was resampled, give the RPC of these pixels; otherwise correct or remove the wrong one."
            )
    content = content_of(path)
    view = View(name, image, band, columns, rows, rpc, gsd, acquired=when, mask=mask, sensor=sensor, content=content)
    return replace(view, plane=plane)


def middle_of(views: Sequence[View]) -> Tuple[float, float]:
    """The mean longitude and latitude of views that are near each other, on the first one's side of the date line."""
    first = views[0].rpc.lon_off
    lon = first + float(np.mean([(view.rpc.lon_off - first + 180.0) % 360.0 - 180.0 for view in views]))
    return lon, float(np.mean([view.rpc.lat_off for view in views]))


def common_heights(views: Sequence[View]) -> Tuple[float, float]:
    """The heights that most RPCs were made for, m above the ellipsoid; all of theirs where no two have any in common.

    So an RPC that was made for other heights than all others does not widen the range that these have in common.
    """
    lows, highs = zip(*(view.rpc.height_range for view in views))
    ends = sorted({*lows, *highs})
    shared = [sum(low <= a and b <= high for low, high in zip(lows, highs)) for a, b in zip(ends, ends[1:])]
    if max(shared) < min(2, len(views)):
        return ends[0], ends[-1]
    most = [number for number, count in enumerate(shared) if count == max(shared)]
    return ends[most[0]], ends[most[-1] + 1]


def _gsd(path: str, model: Union[Rpc, OrthoReady], middle: float, width: int, height: int) -> float:
    """Ground sampling distance at the image's centre and the RPC's middle height, geometric mean of both axes, m."""
    centre = np.array([[width / 2, height / 2]]) + np.array([[0, 0], [1, 0], [0, 1]])
    ground = model.localise(centre, middle)
    if not np.isfinite(ground).all():
        place = f"the image's centre (column {width / 2:g}, row {height / 2:g})"
        question = "is it another image's RPC, or that of the uncropped image?"
        raise RpcInvalidError(f"The RPC of '{path}' does not see {place}: {question}")
    enu = EnuFrame(ground[0, 0], ground[0, 1]).from_geodetic(ground)
    gsd = math.sqrt(float(np.linalg.norm(enu[1] - enu[0]) * np.linalg.norm(enu[2] - enu[0])))
    if not _GSD_M[0] <= gsd <= _GSD_M[1]:
        found = f"gives pixels of {gsd:g} m on the ground, which no satellite has"
        raise RpcInvalidError(f"The RPC of '{path}' {found}: give the image's own RPC.")
    return gsd
