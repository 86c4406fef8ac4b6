"""The scene: the only thing that stages hand to each other, read and written only here.

A scene is a JSON file with a schema number; what a stage makes lies in folders beside it, named after it.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from . import __version__
from .arrays import FloatArray
from .errors import ImageError, RpcInvalidError, SceneError, SceneVersionError
from .geometry.equivalent_error import EquivalentError, RefinedPinhole
from .geometry.frames import EnuFrame
from .geometry.pinhole import PinholeCamera
from .geometry.refinement import SensorModel, Terrain, map_from_mapping
from .imagery.acquisition import acquired, moment
from .records import HeightMapRecord
from .rpc import Rpc
from .workspace import write_text

SCHEMA = 1
_MAX_SCENE_BYTES = 512 << 20
_IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class View:
    """One image with its RPC, and where it really looks.

    ``pointing`` (2, 3) is the affine map from the pixel the vendor's RPC gives to the pixel where the ground point
    is really seen; the identity until relative pointing is known. ``acquired`` is when the image was taken, ISO 8601 in
    UTC, "" where nothing tells. ``mask`` is a raster of the image's size whose pixels that are neither zero nor nodata
    are not to be used, "" where there is none.
    """

    name: str
    image: str
    band: int
    width: int
    height: int
    rpc: Rpc
    gsd_m: float
    pointing: FloatArray = field(default_factory=lambda: _IDENTITY.copy())
    acquired: str = ""
    mask: str = ""

    @property
    def time(self) -> Optional[datetime]:
        """When the image was taken; None where nothing tells."""
        return moment(self.acquired)

    @property
    def size(self) -> Tuple[int, int]:
        return self.width, self.height

    def project(self, lon_lat_h: FloatArray) -> FloatArray:
        """(..., 3) longitude, latitude, height to (..., 2) column, row, pointing included."""
        return self.rpc.project(lon_lat_h) @ self.pointing[:, :2].T + self.pointing[:, 2]

    def localise(self, col_row: FloatArray, height: FloatArray | float) -> FloatArray:
        """(..., 2) column, row and heights to (..., 3) longitude, latitude, height, pointing included."""
        raw = (np.asarray(col_row) - self.pointing[:, 2]) @ np.linalg.inv(self.pointing[:, :2]).T
        return self.rpc.localise(raw, height)

    def with_pointing(self, pointing: FloatArray) -> "View":
        return replace(self, pointing=np.asarray(pointing, dtype=np.float64))

    def to_mapping(self) -> Dict[str, Any]:
        return {
            "name": self.name,
            "image": self.image,
            "band": self.band,
            "width": self.width,
            "height": self.height,
            "gsd_m": self.gsd_m,
            "pointing": self.pointing.tolist(),
            "acquired": self.acquired,
            "rpc": self.rpc.to_mapping(),
            "mask": self.mask,
        }

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> "View":
        return cls(
            str(values["name"]),
            str(values["image"]),
            int(values["band"]),
            int(values["width"]),
            int(values["height"]),
            Rpc.from_mapping(values["rpc"]),
            float(values["gsd_m"]),
            np.array(values["pointing"], dtype=np.float64).reshape(2, 3),
            str(values.get("acquired") or ""),
            str(values.get("mask") or ""),
        )


@dataclass
class TileView:
    """How one view sees one tile: pixel window, fitted camera with its error, and the refinement once it is made."""

    window: Tuple[int, int, int, int]
    camera: PinholeCamera
    error: EquivalentError
    refined: Optional[RefinedPinhole] = None
    image: Optional[str] = None

    def to_mapping(self) -> Dict[str, Any]:
        return {
            "window": list(self.window),
            "camera": self.camera.to_mapping(),
            "error": self.error.to_mapping(),
            "refined": self.refined.to_mapping() if self.refined else None,
            "image": self.image,
        }

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], terrain: Callable[[], Terrain]) -> "TileView":
        return cls(
            tuple(int(v) for v in values["window"]),
            PinholeCamera.from_mapping(values["camera"]),
            EquivalentError(**values["error"]),
            _refined_from(values["refined"], terrain) if values.get("refined") else None,
            values.get("image"),
        )


def _refined_from(values: Mapping[str, Any], terrain: Callable[[], Terrain]) -> RefinedPinhole:
    camera = PinholeCamera.from_mapping(values["camera"])
    return RefinedPinhole(
        camera,
        map_from_mapping(values["to_original"], camera, terrain),
        tuple(int(v) for v in values["size"]),
        EquivalentError(**values["error"]),
    )


@dataclass
class Tile:
    """A ground rectangle (in the scene's CRS) with the altitude range expected in it."""

    id: str
    bounds: Tuple[float, float, float, float]
    altitudes: Tuple[float, float]
    views: Dict[str, TileView]
    heights: Tuple[HeightMapRecord, ...] = ()

    def to_mapping(self) -> Dict[str, Any]:
        return {
            "id": self.id,
            "bounds": list(self.bounds),
            "altitudes": list(self.altitudes),
            "views": {name: view.to_mapping() for name, view in self.views.items()},
            "heights": [record.to_mapping() for record in self.heights],
        }

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], terrain: Callable[[str], Terrain]) -> "Tile":
        return cls(
            str(values["id"]),
            tuple(map(float, values["bounds"])),
            tuple(map(float, values["altitudes"])),
            {
                str(name): TileView.from_mapping(view, lambda name=name: terrain(str(name)))
                for name, view in values["views"].items()
            },
            tuple(HeightMapRecord.from_mapping(record) for record in values["heights"]),
        )


@dataclass
class Scene:
    """Views, local frame, ground area, tiles, and what was done so far.

    ``area`` is the outline, as WKT in ``crs``, of the ground that at least two views see. ``altitudes`` are metres
    above the ellipsoid. ``refinement`` is the model's name ("" before any), ``order`` the polynomial's, ``surface``
    the coarse surface's file of the terrain model.
    """

    views: List[View]
    frame: EnuFrame
    crs: str
    area: str
    altitudes: Tuple[float, float]
    tiles: List[Tile]
    refinement: str = ""
    order: int = 2
    surface: str = ""
    history: List[Dict[str, Any]] = field(default_factory=list)
    path: Path = Path("scene.json")

    def view(self, name: str) -> View:
        """A view by its name; raises SceneError with the names there are."""
        for view in self.views:
            if view.name == name:
                return view
        names = ", ".join(view.name for view in self.views)
        raise SceneError(f"The scene '{self.path}' has no view '{name}': it has {names}.")

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
        return str(self.history[-1]["fingerprint"]) if self.history else ""

    def lean(self) -> "Scene":
        """The scene without tiles and history: what a worker needs of it."""
        return replace(self, tiles=[], history=[])

    def folder(self, kind: str) -> Path:
        """Where products of a kind lie: beside the scene's file, named after it."""
        return self.path.parent / f"{self.path.stem}_{kind}"

    def record(self, stage: str, key: str, options: Mapping[str, Any], seconds: float, **facts: Any) -> None:
        """Add a finished stage to the history; an earlier record of the same stage gives way."""
        self.history = [entry for entry in self.history if entry["stage"] != stage]
        self.history.append(
            {
                "stage": stage,
                "fingerprint": key,
                "engine": __version__,
                "seconds": round(seconds, 3),
                "options": dict(options),
                **facts,
            }
        )

    def facts(self, stage: str) -> Dict[str, Any]:
        """The record of a finished stage; empty where it has not been run."""
        return next((entry for entry in self.history if entry["stage"] == stage), {})

    def save(self, path: str) -> str:
        """Write the scene, whole or not at all; its products are looked for beside the new place from now on."""
        self.path = Path(path)
        document = {
            "format": "repm-scene",
            "schema": SCHEMA,
            "engine": __version__,
            "frame": self.frame.to_mapping(),
            "crs": self.crs,
            "area": self.area,
            "altitudes": list(self.altitudes),
            "refinement": self.refinement,
            "order": self.order,
            "surface": self.surface,
            "views": [view.to_mapping() for view in self.views],
            "tiles": [tile.to_mapping() for tile in self.tiles],
            "history": self.history,
        }
        return write_text(str(path), json.dumps(document, indent=1, allow_nan=False))

    @classmethod
    def load(cls, path: str) -> "Scene":
        """Read a scene.

        Raises SceneError where the file is missing, damaged or no scene, SceneVersionError where a newer version of
        the plugin wrote it.
        """
        document = _document(path)
        try:
            scene = cls(
                [View.from_mapping(view) for view in document["views"]],
                EnuFrame.from_mapping(document["frame"]),
                str(document["crs"]),
                str(document["area"]),
                tuple(map(float, document["altitudes"])),
                [],
                str(document["refinement"]),
                int(document["order"]),
                str(document["surface"]),
                list(document["history"]),
                Path(path),
            )
            # Stored refinements belong to the vendors' RPCs; pointing came later.
            scene.tiles = [
                Tile.from_mapping(tile, lambda name: scene.terrain(scene.view(name).rpc)) for tile in document["tiles"]
            ]
            return scene
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError, IndexError) as error:
            raise SceneError(
                f"The scene '{path}' is damaged ({type(error).__name__}: {error}): make it anew with "
                "'Fit equivalent pinhole cameras'."
            ) from error


def _document(path: str) -> Dict[str, Any]:
    """The JSON object of a scene file, with format and schema checked."""
    try:
        if os.path.getsize(path) > _MAX_SCENE_BYTES:
            raise SceneError(f"The scene '{path}' is larger than {_MAX_SCENE_BYTES >> 20} MiB: it is no scene of ours.")
        with open(path, encoding="utf-8") as stream:
            document = json.load(stream)
    except OSError as error:
        raise SceneError(
            f"Cannot read the scene '{path}' ({error.strerror or error}): choose the scene.json that "
            "'Fit equivalent pinhole cameras' wrote."
        ) from error
    except (ValueError, RecursionError) as error:
        raise SceneError(
            f"The scene '{path}' is not a JSON file ({error}): choose the scene.json that "
            "'Fit equivalent pinhole cameras' wrote."
        ) from error
    if not isinstance(document, dict) or document.get("format") != "repm-scene":
        raise SceneError(
            f"'{path}' is not a REPM scene: choose the scene.json that 'Fit equivalent pinhole cameras' wrote."
        )
    schema = document.get("schema")
    if not isinstance(schema, int) or schema > SCHEMA:
        raise SceneVersionError(
            f"The scene '{path}' has schema {schema}, this version of the plugin reads up to "
            f"{SCHEMA}: update the plugin, or make the scene anew."
        )
    return document


def origin(path: str) -> Tuple[str, str]:
    """The workspace in which a scene began, and its first image; "" for what its file does not tell."""
    try:
        document = _document(path)
        first = next((entry["options"] for entry in document["history"] if entry["stage"] == "epmfit"), {})
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
    last = scene.history[-1] if scene.history else {}
    return scene if last.get("stage") == stage and last.get("fingerprint") == key else None


def load_views(images: Sequence[str], rpcs: Sequence[str] = (), masks: Sequence[str] = ()) -> List[View]:
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
        with opened_masked(path, mask):  # a mask that does not fit is told now, not in a worker later
            mask = os.path.abspath(mask) if os.path.exists(mask) else mask
        if min(width, height) < 64:
            raise ImageError(f"'{path}' is only {width} x {height} px: matching needs at least 64 px a side.")
        taken = {view.name for view in views}
        name = name_of(path)
        while name in taken:
            name = f"{name}_{len(views) + 1}"
        views.append(
            View(
                name,
                os.path.abspath(path) if os.path.exists(path) else path,
                band,
                width,
                height,
                rpc,
                _gsd(path, rpc, width, height),
                acquired=when,
                mask=mask,
            )
        )
    return views


def _gsd(path: str, rpc: Rpc, width: int, height: int) -> float:
    """Ground sampling distance at the image's centre and the RPC's middle height, geometric mean of both axes, m."""
    centre = np.array([[width / 2, height / 2]]) + np.array([[0, 0], [1, 0], [0, 1]])
    ground = rpc.localise(centre, rpc.height_off)
    if not np.isfinite(ground).all():
        raise RpcInvalidError(
            f"The RPC of '{path}' does not see the image's centre (column {width / 2:g}, row "
            f"{height / 2:g}): is it another image's RPC, or that of the uncropped image?"
        )
    enu = EnuFrame(ground[0, 0], ground[0, 1]).from_geodetic(ground)
    gsd = math.sqrt(float(np.linalg.norm(enu[1] - enu[0]) * np.linalg.norm(enu[2] - enu[0])))
    if not 0.01 <= gsd <= 1000:
        raise RpcInvalidError(f"The RPC of '{path}' gives pixels of {gsd:g} m on the ground: no satellite's.")
    return gsd
