"""Every product that a stage writes, and every kind of layer on the map: one table each, which all others read."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any, Dict, Iterator, List, Tuple

from .options import SCENES_AFTER, Options

RASTER, POINTS, POLYGONS, FILE = "raster", "points", "polygons", "file"
FOLDER = "folder"  # files are written into it, others may be there
BUILT_FOLDER = "built folder"  # written under another name, and renamed once it is whole
SCENE = "scene"  # a file whose products lie in folders next to it

ALWAYS, UNLESS_SKIPPED, ON_REQUEST = "always", "unless skipped", "on request"

PIPELINE = ("epmfit", "refine", "reconstruct", "dsmfuse")
"""The stages of the pipeline, whose products are its own."""


@dataclass(frozen=True)
class Style:
    """A kind of layer: the file of resources/styles that draws it, and the facts that this file does not contain.

    ``ramp`` are the colours that are spread over the values of a ``band``, with their ``unit`` in the legend;
    ``classes`` are the names of values 0, 1, ... of a discrete one. ``template`` is the file's name where that is not
    the kind's. ``off``: the layer hides others, or is there to check the run, so it is not switched on where there is a
    layer of one of the kinds ``beside``, a DSM as a rule. ``plain``: it has no template, and looks as QGIS shows such a
    file. ``coloured`` is the template of files that have red, green and blue. ``view_of``: not a layer of its own but
    one more style of the layers of that kind, with its ``title``.
    """

    kind: str
    ramp: str = ""
    off: bool = False
    beside: Tuple[str, ...] = ("dsm",)
    plain: bool = False
    template: str = ""
    coloured: str = ""
    unit: str = ""
    band: int = 1
    classes: Tuple[str, ...] = ()
    view_of: str = ""
    title: str = ""


_SOURCE_CLASSES = (
    "Matched",
    "Background of an occlusion",
    "Interpolated",
    "Interpolated on the DEM",
    "Ground in a shadow",
    "From neighbouring cells",
    "Edited by hand",
    "Level of the water",
)
STYLES = (
    Style("gcps"),
    Style("tie_points", off=True),
    Style("tiles", off=True),
    Style("footprints"),
    Style("scenes"),
    Style("overlaps", off=True),
    Style("error", off=True),
    Style("dsm_error", "diverging", template="ramp", unit=" m"),
    Style("volumes"),
    Style("buildings"),
    Style("contours"),
    Style("breaklines", off=True, beside=("contours",)),
    Style("significant", "diverging", template="ramp", unit=" m"),
    Style(
        "significant_level",
        "viridis",
        template="ramp",
        unit=" m",
        band=2,
        view_of="significant",
        title="Level of detection",
    ),
    Style("change", "diverging", off=True, beside=("significant",), template="ramp", unit=" m"),
    Style("changed", off=True, beside=("trend",), template="palette", title="First date of change"),
    Style("changed_last", template="palette", band=2, view_of="changed", title="Last date of change"),
    Style("trend", "diverging", template="ramp", unit=" m/a"),
    Style(
        "trend_error",
        "viridis",
        template="ramp",
        unit=" m/a",
        band=2,
        view_of="trend",
        title="Standard error of the trend",
    ),
    Style("dated", "elevation", off=True, beside=("trend",), template="ramp", unit=" m"),
    Style("stack", "elevation", off=True, beside=("trend",), template="ramp", unit=" m"),
    Style("offsets"),
    Style("differences", "diverging", template="ramp", unit=" m", band=2, title="After the registration"),
    Style(
        "differences_before",
        "diverging",
        template="ramp",
        unit=" m",
        view_of="differences",
        title="Before the registration",
    ),
    Style("ept", "elevation", off=True, coloured="ept_colours", unit=" m"),
    Style("ortho", "grey", off=True, coloured="ortho_colours"),
    Style("confidence", "viridis", off=True, template="ramp", unit=" m", band=5),
    Style("confidence_count", template="palette", view_of="confidence", title="Height maps that agree"),
    Style(
        "confidence_source",
        template="palette",
        band=4,
        classes=_SOURCE_CLASSES,
        view_of="confidence",
        title="Source of each height",
    ),
    Style(
        "confidence_le90",
        "viridis",
        template="ramp",
        unit=" m",
        band=6,
        view_of="confidence",
        title="LE90 of each height",
    ),
    Style("sources", off=True, template="palette"),
    Style("water", template="palette", classes=("Land", "Water"), off=True),
    Style("mesh", "elevation", off=True, unit=" m"),
    Style("image", plain=True),
    Style("objects", template="palette", classes=("Ground", "Object"), off=True),
    Style("object_heights", "viridis", off=True, template="ramp", unit=" m"),
    Style("slope", "viridis", off=True, beside=("dsm", "shading"), template="ramp", unit="°"),
    Style("ruggedness", "viridis", off=True, beside=("dsm", "shading"), template="ramp", unit=" m"),
    Style("shading", "grey", off=True, template="ortho"),
    Style("hillshade"),
    Style("dsm", "elevation", template="ramp", unit=" m"),
)
"""From top to bottom of a run's group: no layer hides those that a user looks at first."""


@dataclass(frozen=True)
class Product:
    """A file or folder that a stage writes: the option and result that name it, its title, and its kind.

    ``wanted``: whether it is written always, unless the user skips it, or on request. ``style`` is its kind of layer,
    "" for none, ``layer`` the layer's name where that is not the title. ``filter`` are a file's types in dialogs.
    ``tiled``: where a raster's name ends in .vrt, it is a VRT with a folder of tiles (:func:`tiles_folder`).
    ``several``: a raster with more than one band. ``maker`` is the module of :mod:`repm_qgis.solids` that makes it from
    the finished DSM, "" where its stage does.
    """

    stage: str
    option: str
    title: str
    form: str
    wanted: str = ON_REQUEST
    style: str = ""
    layer: str = ""
    filter: str = ""
    maker: str = ""
    help: str = ""
    tiled: bool = False
    several: bool = False


_HTML = "HTML (*.html)"
SCENES = "REPM scene (*.json)"
_WORKSPACE = "A folder for the scene and everything in between; a second run there continues where the first stopped."
_SCENE = "The results of this stage are kept in this file's folder. Skipped: beside the scene before it."
_FOOTPRINTS = "The outline of each image on the ground, with its time, its direction of view and the sun's."
_OVERLAPS = "The ground that each two images share, and whether it is worth matching the two."
_TILES = "The outlines of the tiles, with the equivalent error of each image's camera in px."
_TIES = "Points on the ground that two or more images show, with their residuals in px."
_HEIGHTS = "A folder for one height map of each pair and tile, from which the DSM is made. Skipped: beside the scene."
_DSM = "Heights in metres as a GeoTIFF; where nothing was matched, there is no height."
_CONFIDENCE = "For each height: its expected error and LE90 in metres, how many pairs agree, and how it was found."
_ORTHO = "The images in map geometry at their own resolution, in colour where the images have colours."
_DIFFERENCES = "The reference minus the scene's surface in metres: band 1 before, band 2 after the registration."
_OFFSETS = "Arrows: the shift that each part of the scene would need, in metres."
_WATER_MASK = "1 where the images and the matching show water, 0 on land, 255 where neither is known."
_CLOUD = "One point for each matched pixel, with its colour: LAZ, LAS, or PLY for 3-D programs without these."
_MESH = "Triangles: PLY for QGIS and 3-D programs, or GLB and OBJ with the orthophoto as picture, not for QGIS."
_ERROR_MAP = "How far the pinhole camera is from the RPC at each place on the ground, in px."
_EXPORTED = "A folder that gets one model for each tile, with its images and cameras."
_RPCS = (
    "A folder of its own: for each image a VRT with its pixels and the corrected RPC, and the RPC as two text files."
)
_HEIGHT_ERROR = "The DSM minus the reference in metres, cell by cell."
_CHANGE = "AFTER minus BEFORE in metres, cell by cell, after the alignment."
_SIGNIFICANT = "Band 1: what changed by more than the errors of both DSMs, m. Band 2: the level of detection, m."
_VOLUMES = "Outlines of the significant changes, with area, heights, and volume with its uncertainty."
_STACK = "A GeoTIFF with the heights of each date in a band of its own, all on the same cells, in metres."
_TREND = "Metres per year: the median trend of each cell, its standard error and its 95 % interval."
_CHANGED = "For each cell the number of the date at which a change is seen first, and of the one at which it had ended."
_OVER_TIME = "The areas, with their volume at each date since the first, and its uncertainty."
_TABLE = "The volume of each area at each date as CSV, for spreadsheets."
_LAYERS = "A folder with a map layer for each date, which QGIS's temporal controller shows one after the other."
_CHECKED = "The control points, with how far each of them is from where the RPCs, the scene and the DSM put it."
_SAMPLES = "A folder for the images, the true surface (a DSM) and the ground control points."
_REPORT = "A page for the browser with figures, pictures and warnings, in one file."
_EPT_TITLE = "Point cloud for display (EPT)"
_EPT = "A folder of its own with the points as Entwine point tiles, which every QGIS shows."
_PAIRS = (
    "A folder for the surface that each pair of images gives on its own, with its confidence: to find out which pair "
    "an error comes from."
)
_VIEWER = "The surface in 3-D, with rasters draped over it and profiles: a page for the browser, without any network."
_TILES3D = "A folder of its own with tileset.json and GLB files, for CesiumJS, QGIS 3.34 and later, and other viewers."

_STAC = "A STAC item beside the DSM: when and where the images were taken, and the files that were made."
_SOURCES = "The number of the DSM that each height comes from, how many DSMs have one there, and their spread."
_MOSAIC = "A name that ends in .vrt gives a folder of tiles and a VRT that shows them as one: for very large mosaics."
_TERRAIN = "Heights of the bare ground in metres as a GeoTIFF, in the vertical datum of the DSM."
_OBJECT_HEIGHTS = "The DSM minus the terrain in metres: how high houses and trees are."
_OBJECTS = "1 where something stands on the ground, 0 where the DSM shows the ground, 255 where it has no height."
_BUILDINGS = "Outlines with straight walls; height above the ground with its error, kind of roof, area and volume."
_CITYJSON = "Closed solids of the buildings for 3-D programs: blocks, and roofs where the DSM shows them."
_EDITED = "The DSM with all edits that are enabled, as a GeoTIFF; the original stays as it is."
_EDITED_CONFIDENCE = 'The confidence raster, in which edited heights have the source "edited" and no expected error.'
_MANY = "A folder for one folder a scene, with its DSM and report; a second run there does what is left to do."
_SCENE_FOOTPRINTS = "The outline of each scene, with its verdict, its figures, and links to its report and its DSM."
_REPORTS = {
    "inspect": "Report of the images",
    "epmfit": "Report of the cameras",
    "refine": "Report of the refinement",
    "register": "Report of the registration",
    "dsmfuse": "Report of the DSM",
    "pipeline": "Report of the run",
    "batch": "Report of all scenes",
    "mosaic": "Report of the mosaic",
    "dtm": "Report of the terrain",
    "buildings": "Report of the buildings",
    "errormap": "Report of the equivalent error",
    "comparedsm": "Report of the comparison",
    "change": "Report of the change",
    "series": "Report of the series",
    "checkgcps": "Report of the control points",
    "exportrpc": "Report of the corrected RPCs",
}
PRODUCTS = (
    Product("inspect", "footprints", "Footprints", POLYGONS, UNLESS_SKIPPED, "footprints", help=_FOOTPRINTS),
    Product("inspect", "overlaps", "Overlaps of pairs", POLYGONS, UNLESS_SKIPPED, "overlaps", help=_OVERLAPS),
    Product("epmfit", "workspace", "Workspace", FOLDER, ALWAYS, help=_WORKSPACE),
    Product("epmfit", "tiles", "Tiles", POLYGONS, UNLESS_SKIPPED, "tiles", help=_TILES),
    *(
        Product(stage, "output_scene", "Scene after this stage", SCENE, UNLESS_SKIPPED, filter=SCENES, help=_SCENE)
        for stage in SCENES_AFTER
    ),
    Product("reconstruct", "tie_points", "Tie points", POINTS, UNLESS_SKIPPED, "tie_points", help=_TIES),
    Product("reconstruct", "heights", "Height maps", FOLDER, help=_HEIGHTS),
    Product(
        "register",
        "differences",
        "Differences from the reference",
        RASTER,
        UNLESS_SKIPPED,
        "differences",
        help=_DIFFERENCES,
        several=True,
    ),
    Product("register", "offsets", "Offsets of the scene's parts", POINTS, UNLESS_SKIPPED, "offsets", help=_OFFSETS),
    Product("dsmfuse", "output", "DSM", RASTER, ALWAYS, "dsm", help=_DSM),
    Product(
        "dsmfuse", "confidence", "Confidence", RASTER, UNLESS_SKIPPED, "confidence", help=_CONFIDENCE, several=True
    ),
    Product("dsmfuse", "ortho", "Orthophoto", RASTER, style="ortho", help=_ORTHO, several=True),
    Product("dsmfuse", "water_mask", "Water", RASTER, style="water", help=_WATER_MASK),
    Product("dsmfuse", "cloud", "Point cloud", FILE, filter="LAZ (*.laz);;LAS (*.las);;PLY (*.ply)", help=_CLOUD),
    Product("dsmfuse", "ept", _EPT_TITLE, BUILT_FOLDER, style="ept", layer="Point cloud", maker="ept", help=_EPT),
    Product(
        "dsmfuse",
        "mesh",
        "Mesh",
        FILE,
        style="mesh",
        filter="PLY (*.ply);;GLB (*.glb);;OBJ (*.obj)",
        maker="mesh",
        help=_MESH,
    ),
    Product("dsmfuse", "view_heights", "DSM of each pair alone", FOLDER, help=_PAIRS),
    Product("dsmfuse", "viewer", "Surface in the browser (3-D)", FILE, filter=_HTML, help=_VIEWER),
    Product("dsmfuse", "stac", "STAC item for catalogues", FILE, filter="STAC (*.json)", help=_STAC),
    Product("batch", "output", "Footprints of the scenes", POLYGONS, UNLESS_SKIPPED, "scenes", help=_SCENE_FOOTPRINTS),
    Product("batch", "workspace", "Workspace of all scenes", FOLDER, ALWAYS, help=_MANY),
    Product("batch", "mosaic", "Mosaic of the DSMs", RASTER, style="dsm", layer="DSM mosaic", help=_MOSAIC, tiled=True),
    Product("mosaic", "output", "DSM", RASTER, ALWAYS, "dsm", "DSM mosaic", help=_MOSAIC, tiled=True),
    Product(
        "mosaic", "sources", "Sources of the mosaic", RASTER, style="sources", help=_SOURCES, tiled=True, several=True
    ),
    Product("dtm", "output", "Terrain (DTM)", RASTER, ALWAYS, "dsm", help=_TERRAIN),
    Product(
        "dtm", "heights", "Heights above the terrain", RASTER, UNLESS_SKIPPED, "object_heights", help=_OBJECT_HEIGHTS
    ),
    Product("dtm", "mask", "Objects", RASTER, style="objects", help=_OBJECTS),
    Product("buildings", "output", "Buildings", POLYGONS, ALWAYS, "buildings", help=_BUILDINGS),
    Product("buildings", "cityjson", "Buildings in 3-D (CityJSON)", FILE, filter="CityJSON (*.json)", help=_CITYJSON),
    Product("editdsm", "output", "Edited DSM", RASTER, ALWAYS, "dsm", help=_EDITED),
    Product(
        "editdsm",
        "edited_confidence",
        "Confidence of the edited DSM",
        RASTER,
        style="confidence",
        help=_EDITED_CONFIDENCE,
        several=True,
    ),
    Product("errormap", "output", "Equivalent error", RASTER, ALWAYS, "error", help=_ERROR_MAP, several=True),
    Product("exportcameras", "folder", "Folder", FOLDER, ALWAYS, help=_EXPORTED),
    Product("exportrpc", "rpc_folder", "Folder for the corrected RPCs", BUILT_FOLDER, ALWAYS, help=_RPCS),
    Product("comparedsm", "error", "Height error", RASTER, UNLESS_SKIPPED, "dsm_error", help=_HEIGHT_ERROR),
    Product(
        "checkgcps",
        "output",
        "Points with their errors",
        POINTS,
        ALWAYS,
        "gcps",
        "Ground control points",
        help=_CHECKED,
    ),
    Product("change", "output", "Difference of the dates", RASTER, ALWAYS, "change", help=_CHANGE),
    Product(
        "change",
        "significant",
        "Significant change",
        RASTER,
        UNLESS_SKIPPED,
        "significant",
        help=_SIGNIFICANT,
        several=True,
    ),
    Product("change", "volumes", "Volumes of the changes", POLYGONS, UNLESS_SKIPPED, "volumes", help=_VOLUMES),
    Product("series", "output", "Heights of all dates", RASTER, ALWAYS, "stack", help=_STACK, several=True),
    Product("series", "trend", "Trend", RASTER, UNLESS_SKIPPED, "trend", help=_TREND, several=True),
    Product("series", "changed", "Dates of change", RASTER, UNLESS_SKIPPED, "changed", help=_CHANGED, several=True),
    Product("series", "volumes", "Volumes over time", POLYGONS, UNLESS_SKIPPED, "volumes", help=_OVER_TIME),
    Product("series", "layers", "Layers of the dates", BUILT_FOLDER, UNLESS_SKIPPED, help=_LAYERS),
    Product("series", "table", "Table of the volumes", FILE, filter="CSV (*.csv)", help=_TABLE),
    Product("viewer", "viewer", "Surface in the browser (3-D)", FILE, ALWAYS, filter=_HTML, help=_VIEWER),
    Product("tiles3d", "tiles3d", "3-D Tiles", BUILT_FOLDER, ALWAYS, help=_TILES3D),
    Product("sampledata", "folder", "Folder", FOLDER, ALWAYS, help=_SAMPLES),
    Product("sampledata", "truth", "True DSM", RASTER, style="dsm"),
    *(
        Product(stage, "report", title, FILE, UNLESS_SKIPPED, filter=_HTML, help=_REPORT)
        for stage, title in _REPORTS.items()
    ),
    Product("environment", "report", "Report of the environment", FILE, UNLESS_SKIPPED, filter=_HTML, help=_REPORT),
)


def products_of(stage: str) -> List[Product]:
    """The products of a stage; for the pipeline those of its stages, without their reports."""
    if stage != "pipeline":
        return [product for product in PRODUCTS if product.stage == stage]
    parts = [product for part in PIPELINE for product in products_of(part) if product.option != "report"]
    return [*parts, *(product for product in PRODUCTS if product.stage == stage)]


_BESIDE_SCENES = {
    "epmfit": ("scene.json", "tiles.gpkg", "tiles.qml", "equivalent_error.html"),
    "refine": ("refinement.html",),
    "reconstruct": ("reconstruction.html",),
}


def registered_path(scene: str) -> str:
    """Where the registered scene of one of OTHERS is written: beside it."""
    return f"{os.path.splitext(scene)[0]}_registered.json"


def scene_files(stage: str, options: Any) -> Iterator[str]:
    """The scenes that a stage with these options writes, with what it writes beside them under names of its own; none
    of the pipeline."""
    if stage == "epmfit":
        scenes = [os.path.join(str(options.workspace), "scene.json")]
    elif any(product.form == SCENE for product in products_of(stage)) and stage != "pipeline":
        scenes = [str(options.output_scene), *map(registered_path, getattr(options, "others", ()))]
    else:
        return
    for scene in scenes:
        stem = os.path.splitext(scene)[0]
        yield from (scene, f"{stem}_tie_points.gpkg", f"{stem}_tie_points.qml")
        yield from (os.path.join(os.path.dirname(scene), name) for name in _BESIDE_SCENES.get(stage, ()))


_NAMES = {
    **{"pipeline": "dsm", "dsmfuse": "dsm", "epmfit": "cameras", "errormap": "equivalent_error"},
    **{"refine": "refinement", "reconstruct": "reconstruction", "register": "registration"},
}
"""What products of one name in several stages are called after, where they lie in the workspace. The engine's own
``tiles.gpkg`` and ``report.html`` are those of the last run, and are replaced by the next."""
_KINDS = {
    **{"batch": "scenes", "editdsm": "edited", "comparedsm": "comparison", "checkgcps": "points"},
    **{"exportcameras": "cameras", "exportrpc": "rpcs"},
}
"""What all other stages call their products, where that is not their own name."""
OF_SCENES = frozenset(_NAMES)
"""The stages whose products belong to the scene; those of others lie beside the surface that they are made from."""


def stem_of(stage: str, product: Product, surface: str = "") -> str:
    """The name, without its extension, of a product that the user has not named; ``surface`` is the file from which it
    is made."""
    if product.form == SCENE:
        return SCENES_AFTER[stage]
    if stage in _NAMES:
        shared = product.option if product.option in ("report", "tiles", "tie_points") else ""
        return f"{_NAMES[stage]}_{shared}" if shared else product.style or product.option
    kind = _KINDS.get(stage, stage)
    part = "" if product.option in ("output", "folder", "rpc_folder", stage) else product.option
    whose = os.path.splitext(os.path.basename(surface))[0] if surface else ""
    return "_".join(filter(None, (whose, kind, part.replace(f"{kind}_", ""))))


def product(stage: str, option: str) -> Product:
    return next(each for each in products_of(stage) if each.option == option)


def forms() -> Dict[str, str]:
    """The kind of product that each option names, whatever the stage; the products of an input scene lie next to it."""
    return {"scene": SCENE, **{each.option: each.form for each in PRODUCTS}}


def tiles_folder(path: str) -> str:
    """The folder for the tiles of a raster that is a VRT; "" for other names."""
    stem, kind = os.path.splitext(path)
    return f"{stem}_tiles" if kind.lower() == ".vrt" else ""


SO_FAR = "scenes_so_far"
"""The layer and the page, in the workspace of many scenes, of those that a run which has not ended has made."""


def kept_folder(path: str) -> str:
    """The folder, beside a mosaic, for the parts that a stopped run has finished."""
    return f"{os.path.splitext(path)[0]}_blocks"


def paths_of(stage: str, options: Options) -> Iterator[Tuple[Product, str]]:
    """The products that a stage's options name, with their paths; those of the pipeline's stages too.

    The folder of a VRT's tiles follows it, as a product of its own without a style.
    """
    for part in options.parts():
        named = {each.option: each for each in products_of(stage)}  # stages may have products of one name
        for option, each in named.items():
            path = getattr(part, option, None)
            if path:
                yield each, path
                if each.tiled and tiles_folder(path):
                    yield replace(each, form=BUILT_FOLDER, style="", tiled=False), tiles_folder(path)
