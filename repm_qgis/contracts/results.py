"""What every stage returns: a frozen dataclass each. The algorithm's outputs, what the command line prints, the JSON
and the table of results in the algorithm's page come from these fields.

A field that is named like a product of the stage (:mod:`repm_qgis.contracts.products`) is its path, None where it was
not made. Each other field says what it means, and has a label where the algorithm has it as an output in QGIS. A number
is None where there is nothing to compute it from. No field has a default, so that a stage cannot forget one.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, Dict, Optional, Tuple, Type, TypeVar, get_args, get_origin

from .checks import types_of
from .documents import Keywords
from .record import Record

NUMBER, FILE, PAGE, RASTER, VECTOR, LAYERS = "number", "file", "page", "raster", "vector", "layers"
"""The kinds of outputs that QGIS has."""
Path = Optional[str]
"""Of a product, None where it was not made."""
S = TypeVar("S", bound="Result")


@dataclass(frozen=True)
class Meaning:
    """What a field of a result means; ``label`` and ``kind`` are those of the algorithm's output, "" for none."""

    text: str
    label: str = ""
    kind: str = NUMBER

    def problem(self, value: object) -> str:
        """No value is refused: the field's type says what it may be."""
        return ""


class Result(Record):
    """The base of what stages return; :meth:`from_mapping` refuses JSON that lacks a field."""

    @classmethod
    def meanings(cls) -> Dict[str, Meaning]:
        """The fields that are no products' paths, in their order."""
        meanings: Dict[str, Meaning] = {}
        for name, kind in types_of(cls).items():
            for note in get_args(kind)[1:] if get_origin(kind) is Annotated else ():
                if isinstance(note, Meaning):
                    meanings[name] = note
        return meanings

    @classmethod
    def outputs(cls) -> Dict[str, Meaning]:
        """The fields that are outputs of the algorithm beside its products."""
        return {name: meaning for name, meaning in cls.meanings().items() if meaning.label}

    def fields_of(self, base: Type[Result]) -> Keywords:
        """The values of the fields that a base class has, as arguments of another subclass."""
        return {each.name: getattr(self, each.name) for each in dataclasses.fields(base)}  # type: ignore[arg-type]


Seconds = Annotated[float, Meaning("seconds that the stage took")]
Datum = Annotated[Optional[str], Meaning("the vertical datum of the heights; none where it is unknown")]
Figure = Optional[float]


@dataclass(frozen=True)
class InspectResult(Result):
    """Of :mod:`repm_qgis.stages.inspect`."""

    footprints: Path
    overlaps: Path
    report: Path
    n_images: Annotated[int, Meaning("images that can be used", "Number of images that can be used")]
    n_pairs: Annotated[
        int,
        Meaning("pairs that can measure heights (`yes` and `with care`)", "Number of pairs that are worth matching"),
    ]
    pair: Annotated[
        Optional[Tuple[str, ...]],
        Meaning(
            "the images to begin with, as IMAGES of [the pipeline](pipeline.md) takes them: the best pair",
            "Images of the best pair",
            LAYERS,
        ),
    ]
    triplet: Annotated[
        Optional[Tuple[str, ...]],
        Meaning(
            "the same with the best third image, which makes a pair that is worth matching with both others; none "
            "where no image does",
            "Images of the best triplet",
            LAYERS,
        ),
    ]


@dataclass(frozen=True)
class EpmFitResult(Result):
    """Of :mod:`repm_qgis.stages.epmfit`."""

    workspace: str
    tiles: str
    report: str
    scene: Annotated[
        str, Meaning("`scene.json` in WORKSPACE: views, frame, tiles, cameras (P, K, R, t)", "Scene", FILE)
    ]
    rmse: Annotated[
        float,
        Meaning(
            "root of the mean squared error of all tiles and views, px, before refinement",
            "Equivalent error, RMSE (px)",
        ),
    ]
    max_error: Annotated[
        float, Meaning("the largest error of all tiles and views, px", "Equivalent error, largest (px)")
    ]


@dataclass(frozen=True)
class ErrorMapResult(Result):
    """Of :mod:`repm_qgis.stages.errormap`."""

    output: str
    report: Path
    rmse: Annotated[float, Meaning("root of the mean squared error at ALTITUDE, px", "Equivalent error, RMSE (px)")]
    max_error: Annotated[float, Meaning("the largest error at ALTITUDE, px", "Equivalent error, largest (px)")]
    altitude: Annotated[float, Meaning("the altitude, m above the ellipsoid")]
    seconds: Seconds


@dataclass(frozen=True)
class RefineResult(Result):
    """Of :mod:`repm_qgis.stages.refine`."""

    output_scene: str
    report: str
    rmse: Annotated[
        float, Meaning("root of the mean squared error that remains, px", "Remaining equivalent error, RMSE (px)")
    ]
    max_error: Annotated[
        float, Meaning("the largest error that remains, px", "Remaining equivalent error, largest (px)")
    ]


@dataclass(frozen=True)
class ExportCamerasResult(Result):
    """Of :mod:`repm_qgis.stages.exportcameras`."""

    folder: str
    models: Annotated[Tuple[str, ...], Meaning("the folder of each tile's model, in FOLDER")]
    images: Annotated[int, Meaning("how many images all models hold", "Number of images")]


@dataclass(frozen=True)
class ExportRpcResult(Result):
    """Of :mod:`repm_qgis.stages.exportrpc`."""

    rpc_folder: str
    report: Path
    images: Annotated[Tuple[str, ...], Meaning("the VRTs, for models", "Images with corrected RPCs", LAYERS)]
    max_error: Annotated[
        float,
        Meaning("the largest distance from the scene's model, px", "Largest difference from the pointed model (px)"),
    ]


@dataclass(frozen=True)
class ReconstructResult(Result):
    """Of :mod:`repm_qgis.stages.reconstruct`."""

    output_scene: str
    tie_points: str
    heights: str
    report: Annotated[
        str,
        Meaning(
            "pairs with angle, B/H, overlap, expected accuracy, time and angle between the suns; tie points by tile "
            "and by compass direction, and their vertical parallax before and after; the pointing and its reason, and "
            "the waves of each image where the satellite shook; ground control, or how uncertain the height is without "
            "it; matched share, and how far each height map was moved",
            "Report of the matching",
            PAGE,
        ),
    ]
    n_tie_points: Annotated[int, Meaning("tie points that the pointing comes from", "Number of tie points")]


@dataclass(frozen=True)
class RegisterResult(Result):
    """Of :mod:`repm_qgis.stages.register`."""

    output_scene: str
    differences: Path
    offsets: Path
    report: Path
    other_scenes: Annotated[Tuple[str, ...], Meaning("the registered scenes of OTHERS")]
    east: Annotated[float, Meaning("what was added to the scene's ground, m", "Added to the east (m)")]
    north: Annotated[float, Meaning("the same to the north, m", "Added to the north (m)")]
    up: Annotated[float, Meaning("the same upwards, m", "Added up (m)")]
    determined: Annotated[int, Meaning("how many horizontal directions the reference determines, 0 to 2")]
    east_deviation: Annotated[float, Meaning("standard deviation of EAST, m", "Standard deviation to the east (m)")]
    north_deviation: Annotated[float, Meaning("standard deviation of NORTH, m", "Standard deviation to the north (m)")]
    up_deviation: Annotated[float, Meaning("standard deviation of UP, m", "Standard deviation up (m)")]
    seconds: Seconds


@dataclass(frozen=True)
class FusedSurface(Result):
    """What a fusion makes and counts: all of it, cell by cell of the DSM, as
    :class:`~repm_qgis.contracts.records.FusionFacts` has it."""

    output: str
    confidence: Path
    ortho: Path
    water_mask: Path
    cloud: Path
    ept: Path
    mesh: Path
    view_heights: Path
    viewer: Path
    stac: Path
    vertical_datum: Annotated[str, Meaning("the vertical datum of the heights")]
    cells: Annotated[int, Meaning("cells that two images see")]
    valid: Annotated[int, Meaning("cells with a height")]
    valid_percent: Annotated[
        float, Meaning("cells with a height, of those that two images see, %", "Cells with a height (%)")
    ]
    matched: Annotated[int, Meaning("cells whose height was matched")]
    background: Annotated[
        int, Meaning("cells with heights of other sources: occlusions, shadows, neighbouring cells, water")
    ]
    interpolated: Annotated[int, Meaning("cells whose height is interpolated")]
    points: Annotated[int, Meaning("points of the cloud")]
    removed: Annotated[int, Meaning("cells left out because their heights disagree")]
    resolution: Annotated[float, Meaning("side of a cell in units of the CRS")]
    crs: Annotated[str, Meaning("the CRS of the DSM")]
    dem_offset: Annotated[
        Optional[Dict[str, Any]],
        Meaning(
            "how far the DSM lies above the DEM of the scene: `up_m` with `deviation_m`, and at most `most_m` to be "
            "expected; none without a DEM"
        ),
    ]
    needles: Annotated[int, Meaning("cells of spikes and pits that were removed")]
    water: Annotated[int, Meaning("bodies of water, where they were asked for")]
    water_m2: Annotated[float, Meaning("their area, m²")]
    water_evidence: Annotated[str, Meaning("what shows the water")]


@dataclass(frozen=True)
class DsmFuseResult(FusedSurface):
    """Of :mod:`repm_qgis.stages.dsmfuse`."""

    report: Path
    seconds: Seconds


@dataclass(frozen=True)
class PipelineResult(FusedSurface):
    """Of :mod:`repm_qgis.stages.pipeline`."""

    workspace: str
    tiles: str
    tie_points: str
    heights: str
    report: str
    scene: Annotated[
        str,
        Meaning(
            "`reconstructed.json`, or `registered.json` with REFERENCE: for [dsmfuse](dsmfuse.md) with other options",
            "Scene",
            FILE,
        ),
    ]
    rmse: Annotated[float, Meaning("equivalent error of all tiles and views before refinement, RMSE, px")]
    max_error: Annotated[float, Meaning("the largest of these errors, px")]
    n_tie_points: Annotated[int, Meaning("tie points that the pointing comes from", "Number of tie points")]
    seconds: Annotated[Dict[str, float], Meaning("seconds that each stage took")]
    footprints: Annotated[
        Path, Meaning("with PRESET preview: the images' outlines on the ground", "Footprints", VECTOR)
    ]
    overlaps: Annotated[
        Path, Meaning("with PRESET preview: the ground that each two images share", "Overlaps of pairs", VECTOR)
    ]
    matched_images: Annotated[
        Optional[Tuple[str, ...]],
        Meaning(
            "with PRESET preview: the images of pairs that matched, as IMAGES of the DSM's run",
            "Images of the preview's pairs",
            LAYERS,
        ),
    ]
    lowest: Annotated[
        Figure,
        Meaning(
            "with PRESET preview: ALTITUDE_MIN for the DSM's run, m above the ellipsoid; none where it does not show "
            "it",
            "Lowest altitude for the DSM (m)",
        ),
    ]
    highest: Annotated[Figure, Meaning("the same for ALTITUDE_MAX", "Highest altitude for the DSM (m)")]


@dataclass(frozen=True)
class SceneOutcome(Result):
    """What became of one of many scenes: its ``verdict`` is that of its report (``good``, ``look``, ``doubt``) or
    ``failed``, with the ``error``; ``le90_m`` is the median of its heights' LE90, ``height_deviation_m`` the stated
    standard deviation of its absolute height, None where they are not known."""

    scene: str
    verdict: str
    error: str
    findings: Tuple[str, ...]
    reused: bool
    seconds: float
    dsm: Path
    report: Path
    images: int
    pairs: int
    taken: Tuple[str, ...]
    valid_percent: Figure
    resolution: Figure
    vertical_datum: Optional[str]
    le90_m: Figure
    height_deviation_m: Figure


@dataclass(frozen=True)
class BatchResult(Result):
    """Of :mod:`repm_qgis.stages.batch`."""

    workspace: str
    output: Path
    report: Path
    mosaic: Path
    scenes: Annotated[
        Tuple[SceneOutcome, ...],
        Meaning(
            "for each scene its `verdict` (`good`, `look`, `doubt` or `failed`), `findings` or `error`, figures, "
            "`dsm` and `report`"
        ),
    ]
    dsms: Annotated[Tuple[str, ...], Meaning("the DSMs, for models", "DSMs", LAYERS)]
    n_scenes: Annotated[int, Meaning("number of scenes", "Number of scenes")]
    n_failed: Annotated[int, Meaning("scenes without a DSM", "Scenes that failed")]
    n_reused: Annotated[int, Meaning("scenes that an earlier run had completed", "Scenes that were complete before")]
    seconds: Seconds


@dataclass(frozen=True)
class DsmOffset(Result):
    """What a mosaic added to the heights of one DSM, m, with its standard deviation."""

    dsm: str
    added: float
    deviation: float


@dataclass(frozen=True)
class MosaicResult(Result):
    """Of :mod:`repm_qgis.stages.mosaic`."""

    output: str
    sources: Path
    report: Path
    offsets: Annotated[
        Tuple[DsmOffset, ...],
        Meaning("for each `dsm` what was `added` to its heights, m, and the standard `deviation`"),
    ]
    groups: Annotated[int, Meaning("groups of DSMs that overlap")]
    overlaps: Annotated[int, Meaning("pairs of DSMs that overlap")]
    seam: Annotated[
        Figure,
        Meaning(
            "median difference in m of two DSMs where their cells meet, before heights are feathered; none where there "
            "is no seam",
            "Difference of two DSMs along the seams, median (m)",
        ),
    ]
    valid_percent: Annotated[
        float, Meaning("cells with a height, of the rectangle around all DSMs, %", "Cells with a height (%)")
    ]
    vertical_datum: Datum
    seconds: Seconds


@dataclass(frozen=True)
class DtmResult(Result):
    """Of :mod:`repm_qgis.stages.dtm`."""

    output: str
    heights: Path
    mask: Path
    report: Path
    objects_percent: Annotated[
        float, Meaning("heights of the DSM that belong to objects, %", "Heights that belong to objects (%)")
    ]
    valid_percent: Annotated[float, Meaning("cells of the raster with a terrain, %", "Cells with a terrain (%)")]
    vertical_datum: Datum
    seconds: Seconds


@dataclass(frozen=True)
class BuildingsResult(Result):
    """Of :mod:`repm_qgis.stages.buildings`."""

    output: str
    cityjson: Path
    report: Path
    n_buildings: Annotated[int, Meaning("how many buildings there are", "Number of buildings")]
    n_roofed: Annotated[int, Meaning("how many have LoD 2.2", "Buildings with the planes of their roofs")]
    area_m2: Annotated[float, Meaning("the area of all, m²", "Area of all footprints (m²)")]
    volume_m3: Annotated[float, Meaning("the volume of all, m³", "Volume of all buildings (m³)")]
    seconds: Seconds


@dataclass(frozen=True)
class EditDsmResult(Result):
    """Of :mod:`repm_qgis.stages.editdsm`."""

    output: str
    edited_confidence: Path
    edits: Annotated[int, Meaning("how many edits were applied", "Number of edits")]
    edited_cells: Annotated[
        int,
        Meaning("how many cells they cover, cells of several edits counted several times", "Cells that edits cover"),
    ]
    vertical_datum: Datum


@dataclass(frozen=True)
class HeightAccuracy(Result):
    """Errors of heights of one set of cells, m; None where there is none to compare."""

    rmse: Annotated[Figure, Meaning("root of the mean squared error, m; a few gross errors dominate it", "RMSE (m)")]
    medae: Annotated[
        Figure,
        Meaning(
            'the median of abs(e) (the "median error" ME of the method\'s paper, not the bias), m: half of the cells '
            "are better",
            "Median absolute error (m)",
        ),
    ]
    mae: Annotated[Figure, Meaning("mean of abs(e), m", "Mean absolute error (m)")]
    nmad: Annotated[
        Figure,
        Meaning(
            "1.4826 median(abs(e − median(e))), m: the spread of most cells, without bias",
            "Normalised median absolute deviation (m)",
        ),
    ]
    le90: Annotated[
        Figure,
        Meaning(
            "the error that nine of ten cells do not exceed, m, with the bias and gross errors: "
            "[as contracts ask](../method.md#le90-and-ce90)",
            "LE90 (m): nine of ten heights are off by no more",
        ),
    ]
    completeness: Annotated[
        float,
        Meaning(
            "% of *all* reference cells that are right to the first threshold: a hole counts as wrong",
            "Completeness at the first threshold (%)",
        ),
    ]
    bias: Annotated[Figure, Meaning("mean of e, m")]
    valid: Annotated[float, Meaning("% of the reference's cells where the DSM has a height")]
    completeness_by_threshold: Annotated[Dict[str, float], Meaning("the completeness at each threshold, %")]
    cells: Annotated[int, Meaning("cells that were compared")]


@dataclass(frozen=True)
class AlignedAccuracy(HeightAccuracy):
    """The same after an alignment, with the shift in m that was added to the DSM."""

    dx: Annotated[float, Meaning("what the alignment added to the east, m")]
    dy: Annotated[float, Meaning("what it added to the north, m")]
    dz: Annotated[float, Meaning("what it added to the heights, m")]


@dataclass(frozen=True)
class OtherDsm(AlignedAccuracy):
    """The accuracy of one of OTHERS."""

    dsm: str


@dataclass(frozen=True)
class CompareDsmResult(AlignedAccuracy):
    """Of :mod:`repm_qgis.stages.comparedsm`."""

    error: Path
    report: Path
    along_normals: Annotated[HeightAccuracy, Meaning("the same for distances along the reference's normals")]
    by_class: Annotated[Dict[str, HeightAccuracy], Meaning("the same for each class of CLASSES")]
    others: Annotated[Tuple[OtherDsm, ...], Meaning("the same for each `dsm` of OTHERS")]


@dataclass(frozen=True)
class ChangeResult(Result):
    """Of :mod:`repm_qgis.stages.change`."""

    output: str
    significant: Path
    volumes: Path
    report: Path
    changes: Annotated[int, Meaning("significant changes", "Number of significant changes")]
    gained_m3: Annotated[float, Meaning("volume of all gains, m³", "Volume gained (m³)")]
    gained_deviation_m3: Annotated[float, Meaning("its standard deviation, m³", "Its standard deviation (m³)")]
    lost_m3: Annotated[float, Meaning("volume of all losses, m³, a positive number", "Volume lost (m³)")]
    lost_deviation_m3: Annotated[float, Meaning("its standard deviation, m³", "Its standard deviation (m³)")]
    level_m: Annotated[
        float, Meaning("the level of detection, median of all cells, m", "Level of detection, median (m)")
    ]
    dx: Annotated[float, Meaning("what the alignment added to AFTER to the east, m")]
    dy: Annotated[float, Meaning("what it added to the north, m")]
    dz: Annotated[float, Meaning("what it added to the heights, m")]


@dataclass(frozen=True)
class SeriesResult(Result):
    """Of :mod:`repm_qgis.stages.series`."""

    output: str
    trend: Path
    changed: Path
    volumes: Path
    table: Path
    layers: Path
    report: Path
    dates: Annotated[Tuple[str, ...], Meaning("the dates in their order")]
    maps: Annotated[Tuple[str, ...], Meaning("the layer of each date, in LAYERS", "Layers of the dates", LAYERS)]
    n_dates: Annotated[int, Meaning("number of dates", "Number of dates")]
    areas: Annotated[int, Meaning("areas whose volume is followed")]
    rising_m2: Annotated[
        float, Meaning("ground with a significant trend or change upwards, m²", "Ground that rises significantly (m²)")
    ]
    falling_m2: Annotated[float, Meaning("the same downwards, m²", "Ground that falls significantly (m²)")]
    volume_m3: Annotated[
        float,
        Meaning(
            "volume of the first area with heights at the last date, m³; 0 without an area",
            "Volume of the first area at the last date (m³)",
        ),
    ]
    volume_deviation_m3: Annotated[float, Meaning("its standard deviation, m³", "Its standard deviation (m³)")]
    offsets_m: Annotated[Tuple[float, ...], Meaning("how far each date's stable ground lay from the first date's, m")]
    errors_m: Annotated[Tuple[float, ...], Meaning("the uncertainty of each date's heights on level ground, m")]


@dataclass(frozen=True)
class PointErrors(Result):
    """Errors of control points in one direction, m."""

    medae: float
    rmse: float
    max: float
    le90: float
    count: int


@dataclass(frozen=True)
class CheckGcpsResult(Result):
    """Of :mod:`repm_qgis.stages.checkgcps`."""

    output: Path
    report: Path
    points: Annotated[int, Meaning("control points in the file")]
    wrong: Annotated[Tuple[str, ...], Meaning("points that were left out, as they are gross errors")]
    components: Annotated[
        Dict[str, Dict[str, PointErrors]],
        Meaning("MedAE, RMSE, LE90, Max and count of east, north and height, by `rpc`, `compensated`, `scene`, `dsm`"),
    ]
    rpc_medae: Annotated[
        Figure,
        Meaning("median of the absolute errors of heights by the RPCs, m", "MedAE of heights by RPC localisation (m)"),
    ]
    rpc_rmse: Annotated[Figure, Meaning("their RMSE, m", "RMSE of heights by RPC localisation (m)")]
    rpc_le90: Annotated[
        Figure, Meaning("the error that nine of ten points do not exceed, m", "LE90 of heights by RPC localisation (m)")
    ]
    rpc_max: Annotated[Figure, Meaning("the largest error, m", "Max of heights by RPC localisation (m)")]
    compensated_medae: Annotated[
        Figure,
        Meaning("the same by corrected RPCs, m", "MedAE of heights by RPCs with image-space compensation (m)"),
    ]
    compensated_rmse: Annotated[
        Figure, Meaning("by corrected RPCs: their RMSE, m", "RMSE of heights by RPCs with image-space compensation (m)")
    ]
    compensated_le90: Annotated[
        Figure,
        Meaning(
            "by corrected RPCs: the error that nine of ten points do not exceed, m",
            "LE90 of heights by RPCs with image-space compensation (m)",
        ),
    ]
    compensated_max: Annotated[
        Figure,
        Meaning("by corrected RPCs: the largest error, m", "Max of heights by RPCs with image-space compensation (m)"),
    ]
    scene_medae: Annotated[
        Figure, Meaning("the same by the scene's pointing, m", "MedAE of heights by the scene's pointing (m)")
    ]
    scene_rmse: Annotated[
        Figure, Meaning("by the scene's pointing: their RMSE, m", "RMSE of heights by the scene's pointing (m)")
    ]
    scene_le90: Annotated[
        Figure,
        Meaning(
            "by the scene's pointing: the error that nine of ten points do not exceed, m",
            "LE90 of heights by the scene's pointing (m)",
        ),
    ]
    scene_max: Annotated[
        Figure, Meaning("by the scene's pointing: the largest error, m", "Max of heights by the scene's pointing (m)")
    ]
    dsm_medae: Annotated[Figure, Meaning("the same by the DSM, m", "MedAE of heights by the DSM (m)")]
    dsm_rmse: Annotated[Figure, Meaning("by the DSM: their RMSE, m", "RMSE of heights by the DSM (m)")]
    dsm_le90: Annotated[
        Figure,
        Meaning("by the DSM: nine of ten points are off by no more, m", "LE90 of heights by the DSM (m)"),
    ]
    dsm_max: Annotated[Figure, Meaning("by the DSM: the largest error, m", "Max of heights by the DSM (m)")]
    rpc_ce90: Annotated[
        Figure,
        Meaning(
            "nine of ten points lie in a circle of this radius around their true places, m",
            "CE90 of positions by RPC localisation (m)",
        ),
    ]
    compensated_ce90: Annotated[
        Figure,
        Meaning("the same by corrected RPCs, m", "CE90 of positions by RPCs with image-space compensation (m)"),
    ]
    scene_ce90: Annotated[
        Figure, Meaning("the same by the scene's pointing, m", "CE90 of positions by the scene's pointing (m)")
    ]


@dataclass(frozen=True)
class ViewerResult(Result):
    """Of :mod:`repm_qgis.stages.viewer`."""

    viewer: str
    columns: Annotated[int, Meaning("columns of cells that the page has")]
    rows: Annotated[int, Meaning("rows of cells that it has")]


@dataclass(frozen=True)
class Tiles3dResult(Result):
    """Of :mod:`repm_qgis.stages.tiles3d`: of a surface ``vertices`` and ``triangles``, of a cloud ``points``."""

    tiles3d: str
    tileset: Annotated[
        str, Meaning("the file in TILES3D that programs open, `tileset.json`", "The file to open: tileset.json", FILE)
    ]
    tiles: Annotated[int, Meaning("tiles of all levels")]
    vertices: Annotated[Optional[int], Meaning("vertices of a surface")]
    triangles: Annotated[Optional[int], Meaning("triangles of a surface")]
    points: Annotated[Optional[int], Meaning("points of a cloud")]


@dataclass(frozen=True)
class SampleDataResult(Result):
    """Of :mod:`repm_qgis.stages.sampledata`."""

    folder: str
    images: Annotated[
        Tuple[str, ...],
        Meaning("`img_01.tif` ...: 12 bit, RPC tags with pointing errors, as vendors' RPCs have", "Images", LAYERS),
    ]
    truth: Annotated[str, Meaning("the true DSM, m above the ellipsoid", "True DSM", RASTER)]
    gcps: Annotated[
        str, Meaning("CSV: ground control points with their image coordinates", "Ground control points", VECTOR)
    ]
    rpc_fit_max_px: Annotated[
        float, Meaning("how far the RPCs are from the simulated sensor, px, before their pointing errors are added")
    ]


@dataclass(frozen=True)
class EnvironmentResult(Result):
    """Of :mod:`repm_qgis.stages.environment`; where it installs or removes, the environment's ``folder`` alone."""

    report: Path
    folder: Annotated[Optional[str], Meaning("the environment that was made, renewed or removed")]
    python: Annotated[Optional[str], Meaning("version of the engine's Python")]
    interpreter: Annotated[Optional[str], Meaning("its program")]
    platform: Annotated[Optional[str], Meaning("the system")]
    versions: Annotated[Dict[str, Optional[str]], Meaning("version of each package, none where it is missing")]
    missing: Annotated[Tuple[Dict[str, str], ...], Meaning("`package`, `purpose` and `remedy` of what is missing")]
    cuda: Annotated[Optional[Dict[str, Any]], Meaning("whether COLMAP can use a GPU, and why not")]
    memory: Annotated[Optional[Dict[str, Optional[int]]], Meaning("bytes of memory, all and free")]
    cores: Annotated[Optional[int], Meaning("cores that the engine uses")]
    disk_free_bytes: Annotated[Optional[int], Meaning("free space for temporary files, bytes")]
    proj: Annotated[Optional[Dict[str, Any]], Meaning("version, folders, grids and network of PROJ")]
