"""The options of every stage: a frozen dataclass each, with every default and bound in one place.

Names are the Processing parameters' names in lower case. Files and folders are strings; "" or None means "not
wanted" for outputs and "not given" for inputs. A field states its bounds or choices; dialogs take them from here.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Dict, List, Optional, Tuple, Type, TypeVar, get_args, get_origin

from .checks import Choice, Given, Number, Rectangle, Switch, types_of, unfit
from .documents import JsonMapping, JsonObject, Keywords
from .errors import OptionError
from .file_kinds import is_cloud, is_delivery, is_ply, is_textured
from .paths import real_path

MODELS = ("none", "homography", "polynomial", "terrain")
KERNELS = ("bilinear", "cubic", "lanczos")
BACKENDS = ("auto", "sgm", "colmap")
POINTINGS = ("auto", "shift", "affine", "jitter")
PAIRS = ("best", "fewest")
QUALITIES = ("fast", "default", "best")
INTENSITY, LEARNED = "intensity", "learned"
MATCHING_COSTS = ("auto", INTENSITY, LEARNED)
ADJUSTMENTS = ("rpc", "colmap")
METHODS = ("median", "mean")
FILLS = ("none", "occlusions", "all")
WATERS = ("keep", "flatten")
ALIGNMENTS = ("none", "vertical", "3d")
COMPARED_ALIGNMENTS = (*ALIGNMENTS, "icp")
SHIFTS = ("shift", "tilt")
VOIDS = ("inside", "none")
CAMERA_FORMATS = ("colmap", "mvsnet", "whutlc", "nerfstudio")
BIT_DEPTHS = ("8", "16")
KINDS = ("urban", "mountains")
COLOURS = ("auto", "greys", "all")

TERRAIN_TILE_PX = 1300
"""Side of automatic tiles with the model terrain: its error does not grow with the tile, only the memory does."""

VIEWER_CELLS = 4_000_000
"""Most cells of a page for the browser: it has 5 to 15 MB, and opens in seconds without a graphics card."""

SERIES_DATES = 250
"""Most DSMs of a series: the numbers of its dates are stored in a byte."""

PREVIEW = "preview"
"""The preset of a run on reduced images, in a folder of this name in the workspace."""

PRESETS: Dict[str, Keywords] = {
    "none": {},
    "city": {"model": "polynomial", "method": "mean", "fill": "occlusions"},
    "mountains": {"model": "polynomial", "method": "mean", "fill": "all"},
    "fast": {"quality": "fast", "pointing": "shift", "fill": "none"},
    PREVIEW: {"quality": "fast", "pointing": "shift", "matching_cost": INTENSITY, "fill": "none"},
}
"""Values that go together, for options of the pipeline that are not given; docs/algorithms/pipeline.md has what each
costs and gives."""

SCENES_AFTER = {"refine": "refined", "reconstruct": "reconstructed", "register": "registered"}
"""What the scene after a stage is called, beside the scene before it, where the user has not named it."""

BATCH_PRODUCTS = ("confidence", "ortho", "water_mask", "cloud", "ept", "mesh", "view_heights", "viewer", "stac")
"""What may be made beside the DSM of each of many scenes."""

Extent = Annotated[Tuple[float, float, float, float], Rectangle()]
T = TypeVar("T", bound="Options")


Default = Any
"""What a field of a dataclass is set to, whatever its type: the checker takes it for a value of that type."""


def choice(default: str, choices: Tuple[str, ...]) -> Default:
    return field(default=default, metadata={"check": Choice(choices)})


def number(default: Optional[float], low: float, high: float, unit: str = "", automatic: bool = False) -> Default:
    return field(default=default, metadata={"check": Number(low, high, unit, False, automatic)})


def whole(default: int, low: int, high: int, unit: str = "", automatic: bool = False) -> Default:
    return field(default=default, metadata={"check": Number(low, high, unit, True, automatic)})


def switch(default: bool) -> Default:
    return field(default=default, metadata={"check": Switch()})


def given() -> Default:
    return field(metadata={"check": Given()})


def read(*default: object) -> Default:
    """A file or files that a stage reads, by their paths; without a default they must be given."""
    return field(default=default[0], metadata=_READ) if default else field(metadata={"check": Given(), **_READ})


_READ = {"read": True}


class _ByName(type):
    """Classes whose fields are given by name only: a field added between others must not shift values."""

    def __call__(cls, *positional: Any, **named: Any) -> Any:
        if positional:
            raise TypeError(f"{cls.__name__} takes its fields by name, and was given {len(positional)} without")
        return super().__call__(**named)


@dataclass(frozen=True)
class Options(metaclass=_ByName):
    """The base of all stages' options: checks, and reading from and writing to JSON."""

    def __post_init__(self) -> None:
        types = types_of(type(self))
        for each in dataclasses.fields(self):
            value, check = getattr(self, each.name), each.metadata.get("check")
            if check and not (value is None and each.default is None):
                problem = check.problem(value)
            else:
                problem = unfit(types[each.name], value)
            if problem:
                raise OptionError(each.name.upper(), value, problem)

    @classmethod
    def names(cls) -> List[str]:
        """The names that JSON may have."""
        return [each.name for each in dataclasses.fields(cls)]

    @classmethod
    def option(cls, name: str) -> "dataclasses.Field[Any]":
        """The declaration of one option: its default, and its check in ``metadata``."""
        return next(each for each in dataclasses.fields(cls) if each.name == name)

    @classmethod
    def owner_of(cls, name: str) -> "Type[Options]":
        """The class that declares an option: this one, unless it consists of others."""
        return cls

    @classmethod
    def kind_of(cls, name: str) -> Any:
        """The type of an option's value, without what says that there may be none and what bounds it."""
        kind: Any = types_of(cls.owner_of(name))[name]
        while get_origin(kind) not in (None, tuple):
            kind = next(each for each in get_args(kind) if each is not type(None))
        return kind

    @classmethod
    def default_of(cls, name: str) -> Default:
        """The default of an option that has one."""
        return cls.option(name).default

    @classmethod
    def from_json(cls: Type[T], values: JsonMapping) -> T:
        """Build from a JSON object; an unknown name is an error, lists become tuples. Raises OptionError."""
        for name in values:
            if name not in cls.names():
                known = ", ".join(sorted(cls.names()))
                raise OptionError(name, values[name], f"is not an option of this stage; its options are {known}")
        return cls._of({name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})

    @classmethod
    def _of(cls: Type[T], values: JsonMapping, **set_here: object) -> T:
        """Build from those of the values that are fields of this class; raises OptionError where one is missing."""
        fields = dataclasses.fields(cls)
        mine = {**{each.name: values[each.name] for each in fields if each.name in values}, **set_here}
        for each in fields:
            if each.name not in mine and each.default is dataclasses.MISSING:
                raise OptionError(each.name.upper(), None, "must be given")
        return cls(**mine)

    def parts(self) -> Tuple["Options", ...]:
        """The options of each stage that these consist of, and these themselves."""
        values = (getattr(self, each.name) for each in dataclasses.fields(self))
        return (*(value for value in values if isinstance(value, Options)), self)

    def read_paths(self) -> List[Tuple[str, str]]:
        """The name of each option that names what is read, with each path that it has."""
        found = []
        for part in self.parts():
            for each in dataclasses.fields(part):
                if each.metadata.get("read"):
                    value = getattr(part, each.name)
                    found += [
                        (each.name, path) for path in ([value] if isinstance(value, str) else value or ()) if path
                    ]
        return found

    def to_json(self) -> JsonObject:
        return dataclasses.asdict(self)


def _place_scene(stage: str, options: "RefineOptions | ReconstructOptions | RegisterOptions") -> None:
    """Put the scene after a stage beside that before it, where no file is named."""
    if not options.output_scene and isinstance(options.scene, str):
        path = os.path.join(os.path.dirname(options.scene), f"{SCENES_AFTER[stage]}.json")
        object.__setattr__(options, "output_scene", path)


def require_page(name: str, path: str) -> None:
    """Raise OptionError for a page for the browser that no browser would take for one."""
    if not path.lower().endswith((".html", ".htm")):
        raise OptionError(name, path, "must end with .html")


def require_cloud(path: str) -> None:
    """Raise OptionError for a cloud of a kind that is not written."""
    if not (is_cloud(path) or is_ply(path)):
        raise OptionError("CLOUD", path, "must end with .laz, .las or .ply")


def require_mesh(path: str) -> None:
    """Raise OptionError for a mesh of a kind that is not written."""
    if not (is_textured(path) or is_ply(path)):
        raise OptionError("MESH", path, "must end with .ply, .glb or .obj")


def _check_images(images: Tuple[str, ...], **beside: Tuple[str, ...]) -> None:
    """Raise OptionError for an invalid list of images, or lists of files ``beside`` them that do not fit it."""
    if not all(images):
        raise OptionError("IMAGES", images, "must be a list of image files")
    if len(set(images)) != len(images):
        raise OptionError("IMAGES", list(images), "must not name the same image twice")
    for name, files in beside.items():
        if files and len(files) != len(images):
            count = f"{len(images)} files: one for each of IMAGES, in their order"
            raise OptionError(name, list(files), f"must be empty, or name {count}")


@dataclass(frozen=True)
class InspectOptions(Options):
    """Inspect images and their RPCs before any matching: where they lie, how they overlap, and which pairs fit.

    ``images`` and ``rpcs`` as in :class:`EpmFitOptions`; one image is enough. ``footprints`` and ``overlaps`` are the
    polygon layers to write, ``report`` the HTML page; None = not wanted.
    """

    images: Tuple[str, ...] = field(metadata=_READ)
    rpcs: Tuple[str, ...] = read(())
    footprints: Optional[str] = None
    overlaps: Optional[str] = None
    report: Optional[str] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.images:
            raise OptionError("IMAGES", list(self.images), "must name an image")
        _check_images(self.images, RPCS=self.rpcs)


@dataclass(frozen=True)
class EpmFitOptions(Options):
    """Fit pinhole cameras to the RPCs of images, tile by tile.

    ``images`` are files; any tile of a product stands for the whole image; a folder, an archive or a STAC item for all
    its images. ``rpcs`` names the images' RPC files in the images' order, "" where the RPC is in the image or in a
    sidecar file; empty: all are to be found. ``masks`` names in the same order rasters of the images' size whose pixels
    that are neither zero nor nodata are not to be used (clouds, water), "" where there is none; empty: none at all.
    ``ortho_ready_height`` is the height, m above the ellipsoid, to which ortho-ready images were projected whose
    metadata do not state it; None: it is found with a DEM, or assumed. ``extent`` is xmin, ymin, xmax, ymax, None takes
    all that two images see, or the only one; ``extent_crs`` is its CRS, any PROJ text. ``altitude_min`` and
    ``altitude_max`` in metres above the ellipsoid; None takes the DEM's range, or the RPCs'. ``tile_size`` in px of the
    finest image, 0 = the largest that keeps the equivalent error under ``error_budget`` px; ``error_budget`` is the
    largest equivalent error of such a tile. ``tiles`` and ``report`` name the vector file and the HTML page to write;
    None puts them into the workspace.
    """

    images: Tuple[str, ...] = field(metadata=_READ)
    workspace: str = given()
    rpcs: Tuple[str, ...] = read(())
    masks: Tuple[str, ...] = read(())
    extent: Optional[Extent] = None
    extent_crs: str = "EPSG:4326"
    dem: Optional[str] = read(None)
    altitude_min: Optional[float] = number(None, -12000, 10000, "m")
    altitude_max: Optional[float] = number(None, -12000, 10000, "m")
    ortho_ready_height: Optional[float] = number(None, -12000, 10000, "m")
    tile_size: int = whole(0, 256, 20000, "px", automatic=True)
    error_budget: float = number(0.1, 0.001, 100, "px")
    crs: Optional[str] = None
    tiles: Optional[str] = None
    report: Optional[str] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.images:
            raise OptionError("IMAGES", list(self.images), "must name an image, or at least two images for heights")
        _check_images(self.images, RPCS=self.rpcs, MASKS=self.masks)
        if self.altitude_min is not None and self.altitude_max is not None and self.altitude_min >= self.altitude_max:
            limit = f"must be below ALTITUDE_MAX ({self.altitude_max:g} m)"
            raise OptionError("ALTITUDE_MIN", self.altitude_min, limit)


@dataclass(frozen=True)
class ErrorMapOptions(Options):
    """Map one view's equivalent error on the ground.

    ``view`` is a view's name, "" the first. ``altitude`` in metres above the ellipsoid, None the middle of the
    scene's range.
    """

    scene: str = read()
    output: str = given()
    view: str = ""
    altitude: Optional[float] = number(None, -12000, 10000, "m")
    report: Optional[str] = None


@dataclass(frozen=True)
class RefineOptions(Options):
    """Find the map from each refined pixel to its original pixel that makes the pinhole camera exact.

    ``output_scene`` is the scene after the stage, "" beside that before it. ``dem`` is the terrain model's surface;
    None takes the heights that the scene already has. ``order`` is the polynomial's, ``kernel`` resamples the refined
    images. ``workers`` and ``memory`` as in :class:`ReconstructOptions`.
    """

    scene: str = read()
    output_scene: str = ""
    model: str = choice("polynomial", MODELS)
    dem: Optional[str] = read(None)
    order: int = whole(2, 2, 5)
    kernel: str = choice("bilinear", KERNELS)
    write_images: bool = switch(True)
    report: Optional[str] = None
    workers: int = whole(0, 0, 1024)
    memory: int = whole(0, 0, 1 << 24, "MiB")

    def __post_init__(self) -> None:
        _place_scene("refine", self)
        super().__post_init__()


@dataclass(frozen=True)
class ExportCamerasOptions(Options):
    """Write refined images with their cameras for other software.

    ``folder`` gets one model a tile; ``tile`` is a tile's name, "" all. ``bits``: "8" stretched PNG or JPEG, "16" TIFF
    with the images' own values. ``kernel`` resamples images that the refinement did not write. ``centre`` turns each
    camera towards its image's middle, as COLMAP's triangulation and software in single precision need it.
    """

    scene: str = read()
    folder: str = given()
    format: str = choice("colmap", CAMERA_FORMATS)
    tile: str = ""
    bits: str = choice("8", BIT_DEPTHS)
    kernel: str = choice("bilinear", KERNELS)
    centre: bool = switch(True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.format == "whutlc" and self.bits != "8":
            raise OptionError("BITS", self.bits, "must be 8 for whutlc: its readers take nothing else")


@dataclass(frozen=True)
class ExportRpcOptions(Options):
    """Write the images' RPCs, with the scene's pointing in them, for other software.

    ``rpc_folder`` gets three files for each image, and replaces an earlier export as a whole. ``gcps`` and
    ``gcp_datum`` as in :class:`ReconstructOptions`: points that shift the images of a scene without pointing.
    """

    scene: str = read()
    rpc_folder: str = given()
    gcps: Optional[str] = read(None)
    gcp_datum: str = ""
    report: Optional[str] = None


@dataclass(frozen=True)
class ReconstructOptions(Options):
    """Tie points, relative pointing and dense matching.

    ``output_scene`` as in :class:`RefineOptions`. ``heights`` is the folder for the height maps and ``tie_points`` the
    vector file; None puts them next to the scene.
    ``gcps`` is a table or layer of ground control points, ``gcp_datum`` the datum of their heights (a vertical CRS; ""
    is the ellipsoid). ``pointing`` is each view's correction (``jitter``: with waves of its lines). ``adjustment`` is
    against the original RPCs, or COLMAP's of principal points (shifts only, and without ground control). ``workers`` 0
    means one for each core. ``memory`` in MiB bounds what the workers take together, 0 means three quarters of what is
    free. ``cluster`` is the address or the scheduler file of a Dask cluster whose workers do the work; "" is this
    machine. ``geometric``, ``colmap_fusion``, ``window_radius`` (px) and ``gpu_memory`` (GiB, 0 = what is free) are the
    backend colmap's. ``pairs``: ``best``, each view's best ones, or ``fewest``, those that connect all views.
    ``quality``: the time and the accuracy of matching, ``fast``, ``default`` or ``best`` (stages/parameters.py);
    ``fast`` takes the fewest pairs, too. ``matching_cost``: what tells that two pixels match, ``intensity``
    or ``learned`` features; ``auto`` decides it for each pair (matching/pair_backend.py). ``own_surface``: before the
    matching, refine with the terrain model on the surface that the coarse level finds.
    """

    scene: str = read()
    output_scene: str = ""
    backend: str = choice("auto", BACKENDS)
    gcps: Optional[str] = read(None)
    gcp_datum: str = ""
    pointing: str = choice("auto", POINTINGS)
    tie_points: Optional[str] = None
    heights: Optional[str] = None
    workers: int = whole(0, 0, 1024)
    adjustment: str = choice("rpc", ADJUSTMENTS)
    memory: int = whole(0, 0, 1 << 24, "MiB")
    cluster: str = ""
    geometric: bool = switch(True)
    colmap_fusion: bool = switch(False)
    window_radius: int = whole(5, 1, 20, "px")
    gpu_memory: float = number(0.0, 0, 1024, "GiB")
    own_surface: bool = switch(False)
    pairs: str = choice("best", PAIRS)
    quality: str = choice("default", QUALITIES)
    matching_cost: str = choice("auto", MATCHING_COSTS)

    def __post_init__(self) -> None:
        _place_scene("reconstruct", self)
        super().__post_init__()
        if self.adjustment == "colmap" and self.pointing in ("affine", "jitter"):
            reason = "must be auto or shift where ADJUSTMENT is colmap, which moves principal points only"
            raise OptionError("POINTING", self.pointing, f"{reason}; choose rpc for affine corrections and jitter")
        if self.adjustment == "colmap" and self.gcps:
            reason = "must be rpc where there are GCPS: COLMAP's adjustment is relative"
            raise OptionError("ADJUSTMENT", self.adjustment, reason)


@dataclass(frozen=True)
class RegisterOptions(Options):
    """Lay reconstructed scenes onto references, and put the shifts into the images' pointing.

    ``reference`` names rasters, points or clouds with heights of known place; ``reference_datum`` the datum of those
    heights: ``auto`` (the one that each file states, else the one that fits), ``ellipsoid``, or a vertical CRS.
    ``model`` ``shift`` or ``tilt`` (a shift and a tilt, where the heights carry one). ``stable`` are polygons, or a
    raster that is not zero, of ground that has not changed; None = all. ``others`` are scenes that overlap ``scene``:
    all are placed together. ``output_scene`` is for ``scene``, "" beside it; each of the others is written beside its
    own file. ``differences``: a raster with the reference minus the surface, before and after; ``offsets``: a layer of
    points with the shift that each part of the scene would need; ``report``: a page; None = not wanted. ``workers``,
    ``memory`` and ``cluster`` as in ``ReconstructOptions``.
    """

    scene: str = read()
    output_scene: str = ""
    reference: Tuple[str, ...] = read(())
    reference_datum: str = "auto"
    model: str = choice("shift", SHIFTS)
    stable: Optional[str] = read(None)
    others: Tuple[str, ...] = read(())
    differences: Optional[str] = None
    offsets: Optional[str] = None
    report: Optional[str] = None
    workers: int = whole(0, 0, 1024)
    memory: int = whole(0, 0, 1 << 24, "MiB")
    cluster: str = ""

    def __post_init__(self) -> None:
        _place_scene("register", self)
        super().__post_init__()
        if not all(self.reference) or not (self.reference or self.others):
            raise OptionError("REFERENCE", list(self.reference), "must name a raster, points or a cloud with heights")
        if not all(self.others) or self.scene in self.others:
            raise OptionError("OTHERS", list(self.others), "must be other scenes than SCENE")


@dataclass(frozen=True)
class DsmFuseOptions(Options):
    """Fuse height maps into a DSM.

    ``resolution`` in units of the CRS, 0 = twice the ground sampling distance; ``crs`` any projected CRS, None the
    scene's UTM zone. ``vertical_datum`` is the datum of heights (a vertical CRS; "" is the ellipsoid). ``method`` of
    the heights of a cell that agree. ``fill``: ``occlusions``, cells that one image hides from the other take the
    background's height, and those that a shadow leaves without texture that of the ground where it ends; ``all``,
    remaining holes are interpolated besides; or ``none``. ``water``: ``keep`` it as it was matched, or ``flatten`` it
    to the level of its shore; ``water_mask`` says where it is. ``outlier_radius`` in metres, 0 = off. ``confidence``,
    ``ortho``, ``cloud``, ``mesh``, ``viewer`` (a page for the browser), ``stac`` (an item for catalogues): files to
    write, None = not wanted; ``ept`` is a folder, and ``view_heights`` one for the DSM of each pair alone; ``report``
    is a page about the DSM. ``ortho_resolution`` are the orthophoto's cells, in units of the CRS, 0 = the ground
    sampling distance of the finest image that it shows. ``mesh_vertices``: at most so many in the mesh, 0 = one a cell.
    ``colour`` of orthophoto, clouds and mesh: ``auto``, the natural ones where the images or ``xs`` have them;
    ``greys``; ``all``, all their bands. ``xs`` are multispectral images beside panchromatic ones, in any order; empty:
    those that lie beside the images under the vendors' names. ``pansharpen`` gives them the detail of the panchromatic
    images. ``cloud_normals`` gives the points of ``cloud`` normals. ``memory`` and ``cluster`` as in
    ``ReconstructOptions``.
    """

    scene: str = read()
    output: str = given()
    resolution: float = number(0.0, 0.01, 1000, "m", automatic=True)
    crs: Optional[str] = None
    method: str = choice("mean", METHODS)
    fill: str = choice("occlusions", FILLS)
    water: str = choice("keep", WATERS)
    outlier_radius: float = number(0.0, 0, 1000, "m")
    confidence: Optional[str] = None
    ortho: Optional[str] = None
    water_mask: Optional[str] = None
    cloud: Optional[str] = None
    workers: int = whole(0, 0, 1024)
    vertical_datum: str = ""
    memory: int = whole(0, 0, 1 << 24, "MiB")
    cluster: str = ""
    ept: Optional[str] = None
    mesh: Optional[str] = None
    mesh_vertices: int = whole(500_000, 0, 2**31 - 1)  # a PLY's indices
    view_heights: Optional[str] = None
    viewer: Optional[str] = None
    stac: Optional[str] = None
    colour: str = choice("auto", COLOURS)
    xs: Tuple[str, ...] = read(())
    pansharpen: bool = switch(True)
    cloud_normals: bool = switch(False)
    ortho_resolution: float = number(0.0, 0.01, 1000, "m", automatic=True)
    report: Optional[str] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.viewer:
            require_page("VIEWER", self.viewer)
        if self.stac and not self.stac.lower().endswith((".json", ".geojson")):
            raise OptionError("STAC", self.stac, "must end with .json")
        if not all(self.xs) or len(set(self.xs)) != len(self.xs):
            raise OptionError("XS", list(self.xs), "must be a list of multispectral images, each named once")
        if self.xs and self.colour == "greys":
            raise OptionError("COLOUR", self.colour, "must be auto or all where there are XS, which give the colours")
        if self.cloud:
            require_cloud(self.cloud)
        if self.mesh:
            require_mesh(self.mesh)


@dataclass(frozen=True)
class PipelineOptions(Options):
    """From images to a DSM: the options of all stages, each of which takes the scene that the one before wrote.

    JSON has them all in one object, without those that the pipeline sets itself; options that are not given there have
    the ``preset``'s value, or else the default. ``report`` is the whole run's page, ``command`` the command line that
    it shows.
    """

    fit: EpmFitOptions
    refine: RefineOptions
    reconstruct: ReconstructOptions
    fuse: DsmFuseOptions
    register: Optional[RegisterOptions] = None
    preset: str = choice("none", tuple(PRESETS))
    report: Optional[str] = None
    command: Optional[str] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        images = self.fit.images
        if len(images) < 2 and not any(map(is_delivery, images)):
            raise OptionError("IMAGES", list(images), "must name at least two images: one image has no heights")
        if self.preset == PREVIEW and self.reconstruct.gcps:
            reason = "must be empty with PRESET preview, which reads reduced images: their pixels are not the points'"
            raise OptionError("GCPS", self.reconstruct.gcps, reason)

    OWN: ClassVar[Tuple[str, ...]] = ("preset", "report", "command")
    STAGES: ClassVar[Tuple[Type[Options], ...]] = (
        EpmFitOptions,
        RefineOptions,
        ReconstructOptions,
        DsmFuseOptions,
        RegisterOptions,
    )
    SET_HERE: ClassVar[Tuple[str, ...]] = (
        *("scene", "output_scene", "heights", "kernel", "write_images", "own_surface"),
        *("others", "differences", "offsets"),
    )

    @classmethod
    def names(cls) -> List[str]:
        names = dict.fromkeys(name for stage in cls.STAGES for name in stage.names() if name not in cls.SET_HERE)
        return list(dict.fromkeys([*names, *cls.OWN]))

    @classmethod
    def owner_of(cls, name: str) -> Type[Options]:
        return cls if name in cls.OWN else next(stage for stage in cls.STAGES if name in stage.names())

    @classmethod
    def option(cls, name: str) -> "dataclasses.Field[Any]":
        return super().option(name) if name in cls.OWN else cls.owner_of(name).option(name)

    @classmethod
    def _of(cls, values: JsonMapping, **set_here: object) -> "PipelineOptions":
        own = {name: values[name] for name in cls.OWN if name in values}
        values = {**PRESETS.get(str(own.get("preset", "none")), {}), **values}
        folder = Path(str(values.get("workspace", "")))
        if own.get("preset") == PREVIEW and values.get("workspace"):
            folder = folder / PREVIEW
            values["workspace"] = str(folder)
        names = ("scene", "refined", "reconstructed", "registered")
        fitted, refined, matched, placed = (str(folder / f"{name}.json") for name in names)
        register = None
        if values.get("reference"):
            ends = {"scene": matched, "output_scene": placed}
            register = RegisterOptions._of(values, model="shift", report=None, **ends)
        terrain = values.get("model") == "terrain"
        # Without a DEM the surface is that of the coarse level, which needs the pointing: matching refines on it.
        own_surface = terrain and not values.get("dem")
        tile_size = values.get("tile_size") or (TERRAIN_TILE_PX if terrain else 0)
        model = {"model": "polynomial"} if own_surface else {}
        dem = values.get("dem") if terrain else None
        model.update(scene=fitted, output_scene=refined)
        return cls(
            fit=EpmFitOptions._of(values, tile_size=tile_size, report=None),
            refine=RefineOptions._of(values, dem=dem, write_images=False, report=None, **model),
            reconstruct=ReconstructOptions._of(values, scene=refined, output_scene=matched, own_surface=own_surface),
            fuse=DsmFuseOptions._of(values, scene=placed if register else matched, report=None),
            register=register,
            **own,
        )


@dataclass(frozen=True)
class BatchOptions(Options):
    """Make the DSMs of many scenes, one after the other, each in its own folder of the workspace.

    ``folder`` has a subfolder or an archive for each scene; ``table`` in its place is a CSV file with a row for each
    scene, whose columns are options that it has for itself, or a STAC item, collection or catalogue, each of whose
    items is a scene. ``workspace`` gets a folder for each scene, with its DSM. ``products`` are made beside each DSM.
    ``output`` is the layer of footprints with the figures of each scene, ``mosaic`` one DSM of all, ``report`` the page
    about all of them; None = not wanted. ``common`` are the options of the pipeline that all scenes share; JSON has
    them in one object with the others.
    """

    workspace: str = given()
    folder: Optional[str] = read(None)
    table: Optional[str] = read(None)
    products: Tuple[str, ...] = ("confidence",)
    output: Optional[str] = None
    report: Optional[str] = None
    mosaic: Optional[str] = None
    common: JsonObject = field(default_factory=dict)

    OWN: ClassVar[Tuple[str, ...]] = ("folder", "table", "workspace", "products", "output", "report", "mosaic")
    OF_ONE: ClassVar[Tuple[str, ...]] = ("images", "rpcs", "masks", "gcps", "xs")
    """The options of the pipeline that no two scenes share, for a table's columns only."""
    PLACES: ClassVar[Tuple[str, ...]] = (
        *("workspace", "report", "command", "tiles", "tie_points", "heights", "output"),
        *BATCH_PRODUCTS,
    )
    """Those that say where the pipeline writes, which follows from a scene's name."""
    MACHINE: ClassVar[Tuple[str, ...]] = ("workers", "memory", "cluster")
    """Those that say what computes: never a table's business, nor do results depend on them."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.folder) == bool(self.table):
            raise OptionError("FOLDER", self.folder, "must be given, or TABLE, and not both: either lists the scenes")
        if self.folder and real_path(self.folder) == real_path(self.workspace):
            same = "is also FOLDER, where products would lie among images: choose another folder"
            raise OptionError("WORKSPACE", self.workspace, same)
        for name in self.products:
            if name not in BATCH_PRODUCTS:
                raise OptionError("PRODUCTS", name, f"must be one of {', '.join(BATCH_PRODUCTS)}")
        PipelineOptions.from_json({**self.common, "images": ["a", "b"], "workspace": "w", "output": "dsm.tif"})

    @classmethod
    def common_names(cls) -> List[str]:
        """The options of the pipeline that all scenes may share."""
        return [name for name in PipelineOptions.names() if name not in (*cls.OF_ONE, *cls.PLACES)]

    @classmethod
    def column_names(cls) -> List[str]:
        """The options that a table may have columns for."""
        return [*cls.OF_ONE, *(name for name in cls.common_names() if name not in cls.MACHINE)]

    @classmethod
    def names(cls) -> List[str]:
        return [*cls.OWN, *cls.common_names()]

    @classmethod
    def owner_of(cls, name: str) -> Type[Options]:
        return cls if name in cls.OWN else PipelineOptions.owner_of(name)

    @classmethod
    def option(cls, name: str) -> "dataclasses.Field[Any]":
        return super().option(name) if name in cls.OWN else PipelineOptions.option(name)

    @classmethod
    def _of(cls, values: JsonMapping, **set_here: object) -> "BatchOptions":
        common = {name: value for name, value in values.items() if name not in cls.OWN}
        return super()._of({name: value for name, value in values.items() if name in cls.OWN}, common=common)


@dataclass(frozen=True)
class CompareDsmOptions(Options):
    """Compare a DSM with a reference, on the reference's grid.

    ``dsm`` and ``reference`` are rasters, or point clouds, which become rasters of their first returns.
    ``align`` removes a vertical offset, or a 3-D shift, first: ``3d`` by the slopes of cells, ``icp`` by points.
    ``thresholds`` in metres, for the completeness. ``others`` are further DSMs for the same table, each aligned for
    itself; ``classes`` is a raster whose values errors are grouped by; ``profiles`` is a line layer along which all
    surfaces are shown, None = two lines through the middle. ``cluster`` as in ``ReconstructOptions``.
    """

    dsm: str = read()
    reference: str = read()
    align: str = choice("none", COMPARED_ALIGNMENTS)
    thresholds: Tuple[float, ...] = (1.0, 2.5, 5.0)
    others: Tuple[str, ...] = read(())
    classes: Optional[str] = read(None)
    profiles: Optional[str] = read(None)
    error: Optional[str] = None
    report: Optional[str] = None
    cluster: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(self.others):
            raise OptionError("OTHERS", self.others, "must be a list of rasters or clouds")
        for name, path in (("DSM", self.dsm), *(("OTHERS", other) for other in self.others)):
            if real_path(path) == real_path(self.reference):
                raise OptionError(
                    "REFERENCE", path, f"is the same file as {name}: a surface has no errors against itself"
                )
        if not self.thresholds or any(Number(1e-6, 10000).problem(height) for height in self.thresholds):
            raise OptionError("THRESHOLDS", self.thresholds, "must be heights in metres up to 10000, such as 1; 2.5; 5")


@dataclass(frozen=True)
class MosaicOptions(Options):
    """Put many DSMs together to one.

    ``scenes`` are reconstructed scenes, each of which is fused to a DSM first and has its place after ``dsms``.
    ``fixed`` are those of all these whose heights stay (they were registered), as those of scenes that
    have ground control points do; without any, the mean of all offsets is zero. ``confidences`` names in the order of
    ``dsms`` rasters with the expected error of each height, "" where there is none; empty: none at all. ``resolution``
    in units of the CRS, 0 = the first DSM's cells; ``crs`` any projected CRS, None the first DSM's. ``output`` and
    ``sources`` are VRTs with a folder of tiles where they end in .vrt, else GeoTIFFs; ``sources`` says from which DSM
    each height comes, None = not wanted. ``memory`` and ``cluster`` as in ``ReconstructOptions``.
    """

    output: str = given()
    dsms: Tuple[str, ...] = read(())
    scenes: Tuple[str, ...] = read(())
    fixed: Tuple[str, ...] = read(())
    confidences: Tuple[str, ...] = read(())
    resolution: float = number(0.0, 0.01, 1000, "m", automatic=True)
    crs: Optional[str] = None
    sources: Optional[str] = None
    report: Optional[str] = None
    workers: int = whole(0, 0, 1024)
    memory: int = whole(0, 0, 1 << 24, "MiB")
    cluster: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, files in (("DSMS", self.dsms), ("SCENES", self.scenes), ("FIXED", self.fixed)):
            if not all(files):
                raise OptionError(name, list(files), f"must be a list of {'scenes' if name == 'SCENES' else 'rasters'}")
        if len(self.dsms) + len(self.scenes) < 2:
            few = "must name at least two DSMs, or as many together with SCENES: one alone needs no mosaic"
            raise OptionError("DSMS", list(self.dsms), few)
        places = [real_path(path) for path in (*self.dsms, *self.scenes)]
        for path, place in zip((*self.dsms, *self.scenes), places):
            if places.count(place) > 1:
                name, kind = ("DSMS", "DSM") if path in self.dsms else ("SCENES", "scene")
                raise OptionError(name, path, f"is named twice: name each {kind} once")
        for path in self.fixed:
            if real_path(path) not in places:
                raise OptionError("FIXED", path, "must be one of DSMS or SCENES: add it there, or leave it out here")
        if self.confidences and len(self.confidences) != len(self.dsms):
            count = f"{len(self.dsms)} rasters: one for each of DSMS, in their order"
            raise OptionError("CONFIDENCES", list(self.confidences), f"must be empty, or name {count}")


@dataclass(frozen=True)
class ChangeOptions(Options):
    """Find what changed between the DSMs of two dates.

    ``before`` and ``after`` are the DSMs. ``before_confidence`` and ``after_confidence`` are rasters with the expected
    error of each height; both or none are used. ``align`` moves ``after`` onto ``before`` by what did not change.
    ``min_area`` in m2: smaller changes are left out. ``output`` is the difference, after minus before; ``significant``
    and ``volumes`` are the raster and the polygons of significant changes, ``report`` the HTML page, None = not wanted.
    ``cluster`` as in ``ReconstructOptions``.
    """

    before: str = read()
    after: str = read()
    output: str = given()
    before_confidence: Optional[str] = read(None)
    after_confidence: Optional[str] = read(None)
    align: str = choice("3d", ALIGNMENTS)
    min_area: float = number(50.0, 0, 1e9, "m2")
    significant: Optional[str] = None
    volumes: Optional[str] = None
    report: Optional[str] = None
    cluster: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if real_path(self.before) == real_path(self.after):
            raise OptionError("AFTER", self.after, "is the same file as BEFORE: give the DSM of another date")
        if bool(self.before_confidence) != bool(self.after_confidence):
            lacking = "AFTER" if self.before_confidence else "BEFORE"
            both = "must be given where the other date's is: give both, or none"
            raise OptionError(f"{lacking}_CONFIDENCE", None, both)


@dataclass(frozen=True)
class SeriesOptions(Options):
    """Follow one surface over three dates or more.

    ``dsms`` in any order; ``dates`` are their times in the same order (days or ISO 8601), empty: those that the files
    state. ``confidences`` names in that order rasters with the expected error of each height, "" where there is none;
    empty: none at all. ``align`` moves each DSM onto the first by what did not change. ``areas`` are polygons whose
    volumes are followed, outside of which the ground is stable; None: the outlines of what changed; ``min_area`` is the
    smallest of these. ``output`` has a band of heights for each date; ``layers`` is a folder with a map layer of each;
    ``trend``, ``changed``, ``volumes`` and ``table`` are the maps of the trend and of the dates of change, the polygons
    and their table; None = not wanted. ``cluster`` as in ``ReconstructOptions``.
    """

    dsms: Tuple[str, ...] = field(metadata=_READ)
    output: str = given()
    dates: Tuple[str, ...] = ()
    confidences: Tuple[str, ...] = read(())
    align: str = choice("none", ALIGNMENTS)
    areas: Optional[str] = read(None)
    min_area: float = number(50.0, 0, 1e9, "m2")
    trend: Optional[str] = None
    changed: Optional[str] = None
    volumes: Optional[str] = None
    table: Optional[str] = None
    layers: Optional[str] = None
    report: Optional[str] = None
    cluster: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(self.dsms) or not 3 <= len(self.dsms) <= SERIES_DATES:
            many = f"must name 3 to {SERIES_DATES} DSMs: two dates have a change (repm:change), and no trend"
            raise OptionError("DSMS", list(self.dsms), many)
        places = [real_path(path) for path in self.dsms]
        for path, place in zip(self.dsms, places):
            if places.count(place) > 1:
                raise OptionError("DSMS", path, "is named twice: name each DSM once")
        for name, values in (("DATES", self.dates), ("CONFIDENCES", self.confidences)):
            if values and len(values) != len(self.dsms):
                count = f"{len(self.dsms)} values: one for each of DSMS, in their order"
                raise OptionError(name, list(values), f"must be empty, or have {count}")
        if self.table and not self.table.lower().endswith(".csv"):
            raise OptionError("TABLE", self.table, "must end with .csv")


@dataclass(frozen=True)
class ViewerOptions(Options):
    """Show a DSM in 3-D in a page for the browser.

    ``ortho``, ``confidence`` and ``difference`` are rasters to drape over it: a picture, the confidence of this
    plugin's DSM or one band with the expected error in metres, and a difference of heights in metres; None = none.
    ``cells`` is how many the page has at most; each is a mean where the DSM has more.
    """

    dsm: str = read()
    viewer: str = given()
    ortho: Optional[str] = read(None)
    confidence: Optional[str] = read(None)
    difference: Optional[str] = read(None)
    cells: int = whole(VIEWER_CELLS, 10_000, 16_000_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_page("VIEWER", self.viewer)


@dataclass(frozen=True)
class Tiles3dOptions(Options):
    """Write a DSM as 3-D Tiles.

    ``tiles3d`` is the folder to write, ``ortho`` a picture to drape over it, None: a hillshade. ``dsm`` may be a point
    cloud (LAZ, LAS) instead, whose points have colours of their own.
    """

    dsm: str = read()
    tiles3d: str = given()
    ortho: Optional[str] = read(None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.ortho and is_cloud(self.dsm):
            own = "must be empty where DSM is a point cloud: its points keep the colours that they have in the file"
            raise OptionError("ORTHO", self.ortho, own)


@dataclass(frozen=True)
class DtmOptions(Options):
    """Find the terrain below the houses and trees of a DSM.

    ``dsm`` is the DSM, ``scene`` in its place a reconstructed scene, which is fused first. ``confidence`` is the DSM's
    raster of expected errors, None where there is none; a scene's is made. ``largest`` is the width of the largest
    object, ``slope`` the steepest ground. ``voids``: ``inside``, cells without a height that heights surround get a
    terrain, or ``none``. ``heights`` is the DSM minus the terrain, ``mask`` where objects stand; None = not wanted.
    ``workers``, ``memory`` and ``cluster`` as in ``ReconstructOptions``.
    """

    output: str = given()
    dsm: Optional[str] = read(None)
    scene: Optional[str] = read(None)
    confidence: Optional[str] = read(None)
    largest: float = number(150.0, 2, 500, "m")
    slope: float = number(40.0, 5, 300, "%")
    voids: str = choice("inside", VOIDS)
    heights: Optional[str] = None
    mask: Optional[str] = None
    report: Optional[str] = None
    workers: int = whole(0, 0, 1024)
    memory: int = whole(0, 0, 1 << 24, "MiB")
    cluster: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.dsm) == bool(self.scene):
            many = "must be given, or SCENE, and not both: one surface has one terrain"
            raise OptionError("DSM", self.dsm, many)
        if self.scene and self.confidence:
            reason = "must be empty where SCENE is given: a scene's confidence is made with its DSM"
            raise OptionError("CONFIDENCE", self.confidence, reason)


@dataclass(frozen=True)
class BuildingsOptions(Options):
    """Find the buildings of a DSM: footprints, heights with errors, and simple roofs.

    ``dtm`` is the terrain below it, None: it is made first. ``confidence`` is the DSM's raster of expected errors, and
    ``ortho`` an orthophoto whose near infrared tells plants; None where there is none. ``min_height`` is the least
    height of a building, ``min_area`` its least area. ``output`` are the footprints, ``cityjson`` the solids; None =
    not wanted. ``workers``, ``memory`` and ``cluster``, for the terrain, as in ``ReconstructOptions``.
    """

    dsm: str = read()
    output: str = given()
    dtm: Optional[str] = read(None)
    confidence: Optional[str] = read(None)
    ortho: Optional[str] = read(None)
    min_height: float = number(2.5, 1, 100, "m")
    min_area: float = number(50.0, 4, 1e6, "m2")
    cityjson: Optional[str] = None
    report: Optional[str] = None
    workers: int = whole(0, 0, 1024)
    memory: int = whole(0, 0, 1 << 24, "MiB")
    cluster: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cityjson and not self.cityjson.lower().endswith(".json"):
            raise OptionError("CITYJSON", self.cityjson, "must end with .json, such as town.city.json")


@dataclass(frozen=True)
class EditDsmOptions(Options):
    """Apply edits to a DSM, in the order of their numbers, and write a new one.

    ``edits`` is a layer of polygons and lines with fields as in :mod:`repm_qgis.editing.edits`. ``confidence`` is the
    DSM's raster of expected errors, and ``edited_confidence`` where the edited one goes, in which the source of edited
    heights is "edited"; None = there is none, or it is not wanted.
    """

    dsm: str = read()
    edits: str = read()
    output: str = given()
    confidence: Optional[str] = read(None)
    edited_confidence: Optional[str] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.edited_confidence and not self.confidence:
            raise OptionError("CONFIDENCE", self.confidence, "must be given where EDITED_CONFIDENCE is to be written")


@dataclass(frozen=True)
class CheckGcpsOptions(Options):
    """Measure a scene's RPCs and pointing, and a DSM, at ground control points.

    ``scene`` and ``dsm``: one of them may be left out. ``gcps`` is a table or point layer, ``gcp_datum`` what its
    heights refer to (a vertical CRS; "" is the ellipsoid). ``output`` is the point layer to write, None = not wanted.
    """

    gcps: str = read()
    scene: Optional[str] = read(None)
    dsm: Optional[str] = read(None)
    gcp_datum: str = ""
    output: Optional[str] = None
    report: Optional[str] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.scene and not self.dsm:
            raise OptionError("SCENE", self.scene, "must be given, or DSM, or both: there is nothing to check")


@dataclass(frozen=True)
class SampleDataOptions(Options):
    """Make a truth scene: simulated images of a known surface.

    ``folder`` gets the files. ``kind`` of surface, ``size`` of an image's side, ``seed`` of the random numbers.
    """

    folder: str = given()
    kind: str = choice("urban", KINDS)
    size: int = whole(800, 128, 20000, "px")
    seed: int = whole(1, 0, 2**31 - 1)


@dataclass(frozen=True)
class EnvironmentOptions(Options):
    """Report what is installed here and what is missing, or make or remove the engine's own environment.

    ``install`` makes the environment with the Python that runs the stage, or renews it, ``remove`` removes it;
    ``folder`` is where it lies. ``proxy`` is what the package index is reached through, ``wheels`` a folder that
    replaces the index. The report
    is of the Python that runs the stage, so it is not written then.
    """

    install: bool = switch(False)
    remove: bool = switch(False)
    folder: str = ""
    wheels: str = ""
    proxy: str = ""
    report: Optional[str] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.install and self.remove:
            raise OptionError("REMOVE", self.remove, "cannot be chosen together with INSTALL")
        if self.wheels and not os.path.isdir(self.wheels):
            raise OptionError("WHEELS", self.wheels, "must be a folder that holds wheels (files that end with .whl)")
