"""One frozen, self-checking dataclass per stage: every knob, its default and its bounds in one place.

Names are the Processing parameters' names in lower case. Files and folders are strings; "" or None means "not
wanted" for outputs and "not given" for inputs.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Mapping, Optional, Tuple, TypeVar

from .errors import OptionError

MODELS = ("none", "homography", "polynomial", "terrain")
KERNELS = ("bilinear", "cubic", "lanczos")
BACKENDS = ("auto", "sgm", "colmap")
POINTINGS = ("auto", "shift", "affine")
ADJUSTMENTS = ("rpc", "colmap")
METHODS = ("median", "mean")
MAX_VERTICES = 2**31 - 1  # a PLY's indices
FILLS = ("none", "occlusions", "all")
ALIGNMENTS = ("none", "vertical", "3d")
CAMERA_FORMATS = ("colmap", "mvsnet", "whutlc", "nerfstudio")
BIT_DEPTHS = ("8", "16")
KINDS = ("urban", "mountains")

TERRAIN_TILE_PX = 1300
"""Side of automatic tiles under MODEL=terrain: its error does not grow with the tile, only memory does."""

Extent = Tuple[float, float, float, float]
T = TypeVar("T", bound="Options")


def _within(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    if not (isinstance(value, (int, float)) and math.isfinite(value) and low <= value <= high):
        raise OptionError(name, value, f"must lie between {low:g} and {high:g}{' ' + unit if unit else ''}")


def _whole(name: str, value: object, low: int, high: int, unit: str = "") -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise OptionError(name, value, f"must be a whole number from {low} to {high}{' ' + unit if unit else ''}")


def _one_of(name: str, value: object, choices: Tuple[str, ...]) -> None:
    if value not in choices:
        raise OptionError(name, value, f"must be one of {', '.join(choices)}")


def _given(name: str, value: object) -> None:
    if not value or not isinstance(value, str):
        raise OptionError(name, value, "must be the path of a file or folder")


@dataclass(frozen=True)
class Options:
    """What all stages' options share: reading from and writing to JSON, strictly."""

    @classmethod
    def from_json(cls: type[T], values: Mapping[str, Any]) -> T:
        """Build from a JSON object; an unknown name is an error, lists become tuples."""
        known = {field.name for field in dataclasses.fields(cls)}
        for name in values:
            if name not in known:
                raise OptionError(
                    name, values[name], f"is not an option of this stage; known are {', '.join(sorted(known))}"
                )
        return cls(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})

    def to_json(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class EpmFitOptions(Options):
    """Fit pinhole cameras to the RPCs of images, tile by tile.

    ``rpcs`` names the images' RPC files in the images' order, "" where the RPC is to be found in or beside the image;
    empty: all are to be found. ``masks`` names in the same order rasters of the images' size whose pixels that are
    neither zero nor nodata are not to be used (clouds, water), "" where there is none; empty: none at all.
    ``extent`` is xmin, ymin, xmax, ymax in ``extent_crs`` (any PROJ text); None takes all that two images see.
    ``altitude_min/max`` in metres above the ellipsoid; None takes the DEM's range, or the RPCs'. ``tile_size`` in
    px of the finest image, 0 = the largest that keeps the equivalent error under ``error_budget`` px.
    ``tiles`` and ``report`` name the vector file and the HTML page to write; None puts them into the workspace.
    """

    images: Tuple[str, ...]
    workspace: str
    rpcs: Tuple[str, ...] = ()
    masks: Tuple[str, ...] = ()
    extent: Optional[Extent] = None
    extent_crs: str = "EPSG:4326"
    dem: Optional[str] = None
    altitude_min: Optional[float] = None
    altitude_max: Optional[float] = None
    tile_size: int = 0
    error_budget: float = 0.1
    crs: Optional[str] = None
    tiles: Optional[str] = None
    report: Optional[str] = None

    def __post_init__(self) -> None:
        if isinstance(self.images, str) or not all(isinstance(i, str) and i for i in self.images):
            raise OptionError("IMAGES", self.images, "must be a list of image files")
        if len(self.images) < 2:
            raise OptionError("IMAGES", list(self.images), "must name at least two images: one image has no heights")
        if len(set(self.images)) != len(self.images):
            raise OptionError("IMAGES", list(self.images), "must not name the same image twice")
        for name, files, kind in (("RPCS", self.rpcs, "RPC files"), ("MASKS", self.masks, "rasters")):
            if isinstance(files, str) or not all(isinstance(i, str) for i in files):
                raise OptionError(name, files, f"must be a list of {kind}")
            if files and len(files) != len(self.images):
                raise OptionError(
                    name,
                    list(files),
                    f"must be empty, or name {len(self.images)} files: one for each of IMAGES, in their order",
                )
        _given("WORKSPACE", self.workspace)
        if self.extent is not None:
            if len(self.extent) != 4 or not all(isinstance(v, (int, float)) and math.isfinite(v) for v in self.extent):
                raise OptionError("EXTENT", self.extent, "must be four finite numbers: xmin, ymin, xmax, ymax")
            if self.extent[0] >= self.extent[2] or self.extent[1] >= self.extent[3]:
                raise OptionError("EXTENT", self.extent, "must have xmin < xmax and ymin < ymax")
        for name in ("altitude_min", "altitude_max"):
            if getattr(self, name) is not None:
                _within(name.upper(), getattr(self, name), -12000, 10000, "m")
        if self.altitude_min is not None and self.altitude_max is not None and self.altitude_min >= self.altitude_max:
            raise OptionError(
                "ALTITUDE_MIN", self.altitude_min, f"must be below ALTITUDE_MAX ({self.altitude_max:g} m)"
            )
        if self.tile_size != 0:
            _within("TILE_SIZE", self.tile_size, 256, 20000, "px, or be 0 for automatic")
        _within("ERROR_BUDGET", self.error_budget, 0.001, 100, "px")


@dataclass(frozen=True)
class ErrorMapOptions(Options):
    """Map one view's equivalent error on the ground.

    ``view`` is a view's name, "" the first. ``altitude`` in metres above the ellipsoid, None the middle of the
    scene's range.
    """

    scene: str
    output: str
    view: str = ""
    altitude: Optional[float] = None
    report: Optional[str] = None

    def __post_init__(self) -> None:
        _given("SCENE", self.scene)
        _given("OUTPUT", self.output)
        if self.altitude is not None:
            _within("ALTITUDE", self.altitude, -12000, 10000, "m")


@dataclass(frozen=True)
class RefineOptions(Options):
    """Find the map from each refined pixel to its original pixel that makes the pinhole camera true.

    ``dem`` is the terrain model's surface; None takes the heights that the scene already has. ``order`` is the
    polynomial's, ``kernel`` resamples the refined images.
    """

    scene: str
    output_scene: str
    model: str = "polynomial"
    dem: Optional[str] = None
    order: int = 2
    kernel: str = "bilinear"
    write_images: bool = True
    report: Optional[str] = None

    def __post_init__(self) -> None:
        _given("SCENE", self.scene)
        _given("OUTPUT_SCENE", self.output_scene)
        _one_of("MODEL", self.model, MODELS)
        _within("ORDER", self.order, 2, 5)
        _one_of("KERNEL", self.kernel, KERNELS)


@dataclass(frozen=True)
class ExportCamerasOptions(Options):
    """Write refined images with their cameras for other software.

    ``folder`` gets one model a tile; ``tile`` is a tile's name, "" all. ``bits``: "8" stretched PNG or JPEG, "16" TIFF
    with the images' own values. ``kernel`` resamples images that the refinement did not write. ``centre`` turns each
    camera towards its image's middle, as COLMAP's triangulation and software in single precision need it.
    """

    scene: str
    folder: str
    format: str = "colmap"
    tile: str = ""
    bits: str = "8"
    kernel: str = "bilinear"
    centre: bool = True

    def __post_init__(self) -> None:
        _given("SCENE", self.scene)
        _given("FOLDER", self.folder)
        _one_of("FORMAT", self.format, CAMERA_FORMATS)
        _one_of("BITS", self.bits, BIT_DEPTHS)
        _one_of("KERNEL", self.kernel, KERNELS)
        if self.format == "whutlc" and self.bits != "8":
            raise OptionError("BITS", self.bits, "must be 8 for whutlc: its readers take nothing else")


@dataclass(frozen=True)
class ReconstructOptions(Options):
    """Tie points, relative pointing and dense matching.

    ``heights`` is the folder for the height maps and ``tie_points`` the vector file; None puts them beside the
    scene. ``gcps`` is a table or layer of ground control points, ``gcp_datum`` what their heights refer to (a vertical
    CRS; "" is the ellipsoid). ``pointing`` is each view's correction. ``adjustment`` is against the original RPCs, or
    COLMAP's of principal points (shifts only, and without ground control). ``workers`` 0 means one a core. ``memory``
    in MiB bounds what the workers take together, 0 means three quarters of what is free.
    ``geometric``, ``colmap_fusion``, ``window_radius`` (px) and ``gpu_memory`` (GiB, 0 = what is free) are the backend
    colmap's.
    ``own_surface``: before the matching, refine with the terrain model on the surface that the coarse level finds.
    """

    scene: str
    output_scene: str
    backend: str = "auto"
    gcps: Optional[str] = None
    gcp_datum: str = ""
    pointing: str = "auto"
    tie_points: Optional[str] = None
    heights: Optional[str] = None
    workers: int = 0
    adjustment: str = "rpc"
    memory: int = 0
    geometric: bool = True
    colmap_fusion: bool = False
    window_radius: int = 5
    gpu_memory: float = 0.0
    own_surface: bool = False

    def __post_init__(self) -> None:
        _given("SCENE", self.scene)
        _given("OUTPUT_SCENE", self.output_scene)
        _one_of("BACKEND", self.backend, BACKENDS)
        _whole("WINDOW_RADIUS", self.window_radius, 1, 20, "px")
        _within("GPU_MEMORY", self.gpu_memory, 0, 1024, "GiB")
        _one_of("POINTING", self.pointing, POINTINGS)
        _one_of("ADJUSTMENT", self.adjustment, ADJUSTMENTS)
        if self.adjustment == "colmap" and self.pointing == "affine":
            raise OptionError(
                "POINTING",
                self.pointing,
                "must be auto or shift where ADJUSTMENT is colmap, which "
                "moves principal points only; choose rpc for affine corrections",
            )
        if self.adjustment == "colmap" and self.gcps:
            raise OptionError(
                "ADJUSTMENT", self.adjustment, "must be rpc where there are GCPS: COLMAP's adjustment is relative"
            )
        _within("WORKERS", self.workers, 0, 1024)
        _within("MEMORY", self.memory, 0, 1 << 24, "MiB")


@dataclass(frozen=True)
class DsmFuseOptions(Options):
    """Fuse height maps into a DSM.

    ``resolution`` in units of the CRS, 0 = twice the ground sampling distance; ``crs`` any projected CRS, None the
    scene's UTM zone. ``vertical_datum`` is what heights refer to (a vertical CRS; "" is the ellipsoid). ``method`` of
    the heights of a cell that agree. ``fill``: ``occlusions``, cells that one image hides from the other take the
    background's height; ``all``, remaining holes are interpolated besides; or ``none``. ``outlier_radius`` in metres,
    None = from the data, 0 = off. ``confidence``, ``ortho``, ``cloud``, ``mesh``: files to write, None = not wanted;
    ``ept`` is a folder, and ``view_heights`` one for the DSM of each pair alone. ``mesh_vertices``: at most so many in
    the mesh, 0 = one a cell. ``memory`` as in ``ReconstructOptions``.
    """

    scene: str
    output: str
    resolution: float = 0.0
    crs: Optional[str] = None
    method: str = "mean"
    fill: str = "occlusions"
    outlier_radius: Optional[float] = None
    confidence: Optional[str] = None
    ortho: Optional[str] = None
    cloud: Optional[str] = None
    workers: int = 0
    vertical_datum: str = ""
    memory: int = 0
    ept: Optional[str] = None
    mesh: Optional[str] = None
    mesh_vertices: int = 500_000
    view_heights: Optional[str] = None

    def __post_init__(self) -> None:
        _given("SCENE", self.scene)
        _given("OUTPUT", self.output)
        if self.resolution != 0:
            _within("RESOLUTION", self.resolution, 0.01, 1000, "m, or be 0 for automatic")
        _one_of("METHOD", self.method, METHODS)
        _one_of("FILL", self.fill, FILLS)
        if self.outlier_radius is not None:
            _within("OUTLIER_RADIUS", self.outlier_radius, 0, 1000, "m")
        if self.cloud and not self.cloud.lower().endswith((".laz", ".las")):
            raise OptionError("CLOUD", self.cloud, "must end with .laz or .las")
        if self.mesh and not self.mesh.lower().endswith(".ply"):
            raise OptionError("MESH", self.mesh, "must end with .ply")
        _within("MESH_VERTICES", self.mesh_vertices, 0, MAX_VERTICES)
        _within("WORKERS", self.workers, 0, 1024)
        _within("MEMORY", self.memory, 0, 1 << 24, "MiB")


@dataclass(frozen=True)
class PipelineOptions(Options):
    """From images to a DSM: all stages in one workspace."""

    images: Tuple[str, ...]
    workspace: str
    output: str
    rpcs: Tuple[str, ...] = ()
    masks: Tuple[str, ...] = ()
    extent: Optional[Extent] = None
    extent_crs: str = "EPSG:4326"
    dem: Optional[str] = None
    altitude_min: Optional[float] = None
    altitude_max: Optional[float] = None
    tile_size: int = 0
    error_budget: float = 0.1
    model: str = "polynomial"
    order: int = 2
    backend: str = "auto"
    gcps: Optional[str] = None
    gcp_datum: str = ""
    pointing: str = "auto"
    adjustment: str = "rpc"
    resolution: float = 0.0
    crs: Optional[str] = None
    method: str = "mean"
    fill: str = "occlusions"
    outlier_radius: Optional[float] = None
    confidence: Optional[str] = None
    ortho: Optional[str] = None
    cloud: Optional[str] = None
    tiles: Optional[str] = None
    tie_points: Optional[str] = None
    report: Optional[str] = None
    command: Optional[str] = None
    workers: int = 0
    vertical_datum: str = ""
    memory: int = 0
    geometric: bool = True
    colmap_fusion: bool = False
    window_radius: int = 5
    gpu_memory: float = 0.0
    ept: Optional[str] = None
    mesh: Optional[str] = None
    mesh_vertices: int = 500_000
    view_heights: Optional[str] = None

    def __post_init__(self) -> None:
        # The stages' own options check everything else; building them here makes a wrong value fail at once.
        self.fit_options()
        RefineOptions("-", "-", self.model, order=self.order)
        ReconstructOptions(
            "-",
            "-",
            self.backend,
            self.gcps,
            self.gcp_datum,
            self.pointing,
            workers=self.workers,
            adjustment=self.adjustment,
            memory=self.memory,
            window_radius=self.window_radius,
            gpu_memory=self.gpu_memory,
        )
        DsmFuseOptions(
            "-",
            self.output,
            self.resolution,
            self.crs,
            self.method,
            self.fill,
            self.outlier_radius,
            cloud=self.cloud,
            mesh=self.mesh,
            mesh_vertices=self.mesh_vertices,
        )

    def fit_options(self) -> EpmFitOptions:
        """This run's first stage; its CRS is that of the DSM."""
        names = {field.name for field in dataclasses.fields(EpmFitOptions)} - {"report"}
        values = {name: getattr(self, name) for name in names}
        if self.model == "terrain" and not self.tile_size:
            values["tile_size"] = TERRAIN_TILE_PX
        return EpmFitOptions(**values)


@dataclass(frozen=True)
class CompareDsmOptions(Options):
    """Compare a DSM with a reference, on the reference's grid.

    ``align`` removes a vertical offset, or a 3-D shift, first. ``thresholds`` in metres, for the completeness.
    ``others`` are further DSMs for the same table, each aligned for itself; ``classes`` is a raster whose values errors
    are told apart by; ``profiles`` is a line layer to cut all surfaces along, None = twice through the middle.
    """

    dsm: str
    reference: str
    align: str = "none"
    thresholds: Tuple[float, ...] = (1.0, 2.5, 5.0)
    others: Tuple[str, ...] = ()
    classes: Optional[str] = None
    profiles: Optional[str] = None
    error: Optional[str] = None
    report: Optional[str] = None

    def __post_init__(self) -> None:
        _given("DSM", self.dsm)
        _given("REFERENCE", self.reference)
        _one_of("ALIGN", self.align, ALIGNMENTS)
        if isinstance(self.others, str) or not all(isinstance(path, str) and path for path in self.others):
            raise OptionError("OTHERS", self.others, "must be a list of rasters")
        if not self.thresholds:
            raise OptionError("THRESHOLDS", self.thresholds, "must name at least one height in metres")
        for value in self.thresholds:
            _within("THRESHOLDS", value, 1e-6, 10000, "m")


@dataclass(frozen=True)
class CheckGcpsOptions(Options):
    """Measure a scene's RPCs and pointing, and a DSM, at ground control points.

    ``scene`` or ``dsm`` may be left out, not both. ``gcps`` is a table or point layer, ``gcp_datum`` what its heights
    refer to (a vertical CRS; "" is the ellipsoid). ``output`` is the point layer to write, None = not wanted.
    """

    gcps: str
    scene: Optional[str] = None
    dsm: Optional[str] = None
    gcp_datum: str = ""
    output: Optional[str] = None
    report: Optional[str] = None

    def __post_init__(self) -> None:
        _given("GCPS", self.gcps)
        if not self.scene and not self.dsm:
            raise OptionError("SCENE", self.scene, "must be given, or DSM, or both: there is nothing to check")


@dataclass(frozen=True)
class SampleDataOptions(Options):
    """Make a truth scene: simulated images of a known surface."""

    folder: str
    kind: str = "urban"
    size: int = 800
    seed: int = 1

    def __post_init__(self) -> None:
        _given("FOLDER", self.folder)
        _one_of("KIND", self.kind, KINDS)
        _within("SIZE", self.size, 128, 20000, "px")
        _within("SEED", self.seed, 0, 2**31 - 1)


@dataclass(frozen=True)
class EnvironmentOptions(Options):
    """Report what is installed here and what is missing."""

    report: Optional[str] = None
