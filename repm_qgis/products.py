"""Every product that a stage writes, and every kind of layer on the map: one table each, which all others read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Iterator, List, Tuple

RASTER, POINTS, POLYGONS, FILE = "raster", "points", "polygons", "file"
FOLDER = "folder"  # files are written into it, others may be there
BUILT_FOLDER = "built folder"  # written under another name, and renamed once it is whole
SCENE = "scene"  # a file whose products lie in folders next to it

ALWAYS, UNLESS_SKIPPED, ON_REQUEST = "always", "unless skipped", "on request"

PIPELINE = ("epmfit", "refine", "reconstruct", "dsmfuse")
"""The stages of the pipeline, whose products are its own."""


@dataclass(frozen=True)
class Style:
    """A kind of layer: its template in resources/styles, and the colours that are spread over its values.

    ``off``: the layer is not switched on when it is added, as it hides others.
    """

    kind: str
    ramp: str = ""
    off: bool = False


STYLES = (
    Style("gcps"),
    Style("tie_points"),
    Style("tiles"),
    Style("error", "viridis"),
    Style("dsm_error", "diverging"),
    Style("ept", "elevation", off=True),
    Style("ortho", "grey", off=True),
    Style("confidence", "viridis", off=True),
    Style("mesh", "elevation", off=True),
    Style("hillshade"),
    Style("dsm", "elevation"),
)
"""From top to bottom of a scene's group: nothing hides what is to be looked at first."""


@dataclass(frozen=True)
class Product:
    """Something that a stage writes: the option and result that name it, its title, and what it is.

    ``wanted``: whether it is written always, unless the user skips it, or on request. ``style`` is its kind of layer,
    "" for none, ``layer`` the layer's name where that is not the title. ``filter`` are a file's types in dialogs.
    ``maker`` is the module of :mod:`repm_qgis.dsm` that makes it from the finished DSM, "" where its stage does.
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


_HTML = "HTML (*.html)"
SCENES = "REPM scene (*.json)"
PRODUCTS = (
    Product(
        stage="epmfit",
        option="workspace",
        title="Workspace",
        form=FOLDER,
        wanted=ALWAYS,
        help="A folder for the scene and everything in between; a second run there continues where the first stopped.",
    ),
    Product(stage="epmfit", option="tiles", title="Tiles", form=POLYGONS, wanted=UNLESS_SKIPPED, style="tiles"),
    Product(
        stage="refine",
        option="output_scene",
        title="Scene after this stage",
        form=SCENE,
        wanted=ALWAYS,
        filter=SCENES,
        help="The results of this stage are kept in this file's folder.",
    ),
    Product(
        stage="reconstruct",
        option="output_scene",
        title="Scene after this stage",
        form=SCENE,
        wanted=ALWAYS,
        filter=SCENES,
        help="The results of this stage are kept in this file's folder.",
    ),
    Product(
        stage="reconstruct",
        option="tie_points",
        title="Tie points",
        form=POINTS,
        wanted=UNLESS_SKIPPED,
        style="tie_points",
    ),
    Product(stage="reconstruct", option="heights", title="Height maps (skipped: beside the scene)", form=FOLDER),
    Product(stage="dsmfuse", option="output", title="DSM", form=RASTER, wanted=ALWAYS, style="dsm"),
    Product(stage="dsmfuse", option="confidence", title="Confidence", form=RASTER, style="confidence"),
    Product(stage="dsmfuse", option="ortho", title="Orthophoto", form=RASTER, style="ortho"),
    Product(stage="dsmfuse", option="cloud", title="Point cloud", form=FILE, filter="LAZ (*.laz);;LAS (*.las)"),
    Product(
        stage="dsmfuse",
        option="ept",
        title="Point cloud for display (EPT)",
        form=BUILT_FOLDER,
        style="ept",
        layer="Point cloud",
        maker="ept",
        help="A folder of its own with the points as Entwine point tiles, which every QGIS shows.",
    ),
    Product(stage="dsmfuse", option="mesh", title="Mesh", form=FILE, style="mesh", filter="PLY (*.ply)", maker="mesh"),
    Product(
        stage="dsmfuse",
        option="view_heights",
        title="DSM of each pair alone",
        form=FOLDER,
        help="A folder for the surface that each pair of images gives on its own, with its confidence: to "
        "find out which pair an error comes from.",
    ),
    Product(stage="errormap", option="output", title="Equivalent error", form=RASTER, wanted=ALWAYS, style="error"),
    Product(stage="exportcameras", option="folder", title="Folder", form=FOLDER, wanted=ALWAYS),
    Product(
        stage="comparedsm", option="error", title="Height error", form=RASTER, wanted=UNLESS_SKIPPED, style="dsm_error"
    ),
    Product(
        stage="checkgcps",
        option="output",
        title="Points with their errors",
        form=POINTS,
        wanted=ALWAYS,
        style="gcps",
        layer="Ground control points",
    ),
    Product(stage="sampledata", option="folder", title="Folder", form=FOLDER, wanted=ALWAYS),
    Product(stage="sampledata", option="truth", title="True DSM", form=RASTER, style="dsm"),
    *(
        Product(stage=stage, option="report", title="Report", form=FILE, wanted=UNLESS_SKIPPED, filter=_HTML)
        for stage in ("epmfit", "refine", "pipeline", "errormap", "comparedsm", "checkgcps")
    ),
    Product(stage="environment", option="report", title="Report", form=FILE, wanted=ALWAYS, filter=_HTML),
)


def products_of(stage: str) -> List[Product]:
    """What a stage writes; of the pipeline what its stages do, without their reports."""
    if stage != "pipeline":
        return [product for product in PRODUCTS if product.stage == stage]
    parts = [product for part in PIPELINE for product in products_of(part) if product.option != "report"]
    return [*parts, *(product for product in PRODUCTS if product.stage == stage)]


def product(stage: str, option: str) -> Product:
    return next(each for each in products_of(stage) if each.option == option)


def not_requested(stage: str) -> Dict[str, Any]:
    """The options of what a stage writes on request, all of them left out."""
    return {each.option: None for each in products_of(stage) if each.wanted == ON_REQUEST}


def forms() -> Dict[str, str]:
    """What each option that names a product is, whatever the stage; the products of an input scene lie next to it."""
    return {"scene": SCENE, **{each.option: each.form for each in PRODUCTS}}


def paths_of(products: List[Product], options: Any) -> Iterator[Tuple[Product, str]]:
    """The products that an object with options asks for, with their paths."""
    for each in products:
        path = getattr(options, each.option, None)
        if path:
            yield each, path
