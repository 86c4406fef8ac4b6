"""Parameters that several algorithms share, each with its bounds and its help."""

from __future__ import annotations

from typing import Any, Optional, Sequence

from qgis.core import (
    QgsProcessing,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterCrs,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterEnum,
    QgsProcessingParameterExtent,
    QgsProcessingParameterFile,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterMultipleLayers,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameterString,
    QgsProcessingParameterVectorDestination,
    QgsProcessingParameterVectorLayer,
)
from qgis.PyQt.QtCore import QCoreApplication

SCENE_FILTER = "REPM scene (*.json)"
HTML_FILTER = "HTML (*.html)"


def tr(text: str) -> str:
    return QCoreApplication.translate("RepmParameters", text)


def helped(parameter: QgsProcessingParameterDefinition, text: str) -> QgsProcessingParameterDefinition:
    """The parameter with its tooltip."""
    parameter.setHelp(text)
    return parameter


def advanced(parameter: QgsProcessingParameterDefinition) -> QgsProcessingParameterDefinition:
    """The parameter, shown only when the dialog's advanced part is open."""
    parameter.setFlags(parameter.flags() | QgsProcessingParameterDefinition.Flag.FlagAdvanced)
    return parameter


def real(
    name: str, label: str, default: Optional[float], low: float, high: float, text: str = ""
) -> QgsProcessingParameterDefinition:
    """A number; no default makes it optional."""
    parameter = QgsProcessingParameterNumber(
        name, label, QgsProcessingParameterNumber.Type.Double, default, default is None, low, high
    )
    parameter.setMetadata({"widget_wrapper": {"decimals": 3}})  # six, QGIS's own, are none that anybody sets here
    return helped(parameter, text)


def whole(name: str, label: str, default: int, low: int, high: int, text: str = "") -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterNumber(name, label, QgsProcessingParameterNumber.Type.Integer, default, False, low, high),
        text,
    )


def choice(
    name: str, label: str, options: Sequence[str], default: str, text: str = ""
) -> QgsProcessingParameterDefinition:
    """A choice whose values are the words themselves, so that commands and models stay readable."""
    return helped(
        QgsProcessingParameterEnum(name, label, list(options), defaultValue=default, usesStaticStrings=True), text
    )


class Images(QgsProcessingParameterMultipleLayers):
    """Rasters that QGIS does not open to check them.

    Its own check loads every image as a layer: slow, it may write statistics beside the image, and its message on a
    damaged one names no file. The engine is the better judge.
    """

    def checkValueIsAcceptable(self, input: Any, context: Any = None) -> bool:  # noqa: A002 - QGIS's name
        return super().checkValueIsAcceptable(input)

    def clone(self) -> Images:
        return Images(self)


class Raster(QgsProcessingParameterRasterLayer):
    """A raster that QGIS does not open to check it, as :class:`Images`: it would write statistics beside it."""

    def checkValueIsAcceptable(self, input: Any, context: Any = None) -> bool:  # noqa: A002 - QGIS's name
        return super().checkValueIsAcceptable(input)

    def clone(self) -> Raster:
        return Raster(self)


class Rasters(QgsProcessingParameterMultipleLayers):
    """Several of :class:`Raster`."""

    def checkValueIsAcceptable(self, input: Any, context: Any = None) -> bool:  # noqa: A002 - QGIS's name
        return super().checkValueIsAcceptable(input)

    def clone(self) -> Rasters:
        return Rasters(self)


class Points(QgsProcessingParameterVectorLayer):
    """A point layer or a table's file that QGIS does not open to check it: the engine reads both, and names what is
    wrong in them."""

    def checkValueIsAcceptable(self, input: Any, context: Any = None) -> bool:  # noqa: A002 - QGIS's name
        return super().checkValueIsAcceptable(input)

    def clone(self) -> Points:
        return Points(self)


def images() -> QgsProcessingParameterDefinition:
    parameter = Images("IMAGES", tr("Satellite images with RPCs"), QgsProcessing.SourceType.TypeRaster)
    parameter.setMinimumNumberInputs(2)
    return helped(
        parameter,
        tr(
            "Two or more images of the same ground in sensor geometry (level Basic, Sensor or "
            "Primary), each with its RPC in the file or beside it."
        ),
    )


def rpcs() -> QgsProcessingParameterDefinition:
    return advanced(
        helped(
            QgsProcessingParameterMultipleLayers(
                "RPCS",
                tr("RPC files (empty: in the images or beside them)"),
                QgsProcessing.SourceType.TypeFile,
                optional=True,
            ),
            tr("Only where the RPCs lie elsewhere: one file for each image, in the images' order."),
        )
    )


def masks() -> QgsProcessingParameterDefinition:
    return advanced(
        helped(
            QgsProcessingParameterMultipleLayers(
                "MASKS",
                tr("Masks of what is not to be used (empty: none)"),
                QgsProcessing.SourceType.TypeFile,
                optional=True,
            ),
            tr(
                "One raster for each image, in the images' order, of the same size in columns and rows: pixels that are "
                "neither zero nor nodata (clouds, water) are left out of everything, tie points too. What an image's own "
                "mask or alpha band hides is left out anyway."
            ),
        )
    )


def gcps(optional: bool = True) -> QgsProcessingParameterDefinition:
    return helped(
        Points("GCPS", tr("Ground control points"), [QgsProcessing.SourceType.TypeVector], optional=optional),
        tr(
            "A CSV file or point layer with one row for each point and image: id, lon, lat, height, view (the image's "
            "file name), col, row (the first pixel's centre is 0, 0), role (control or check). A layer's geometry may "
            "stand for lon and lat."
        ),
    )


def gcp_datum() -> QgsProcessingParameterDefinition:
    return advanced(
        helped(
            QgsProcessingParameterString(
                "GCP_DATUM",
                tr("Heights of the control points refer to (empty: the WGS 84 ellipsoid)"),
                "",
                optional=True,
            ),
            tr(
                "EGM96, EGM2008, or any vertical CRS that PROJ knows, such as EPSG:5773. Its grid must be installed: the "
                "Environment report names what is missing."
            ),
        )
    )


def vertical_datum() -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterString(
            "VERTICAL_DATUM", tr("Heights refer to (empty: the WGS 84 ellipsoid)"), "", optional=True
        ),
        tr(
            "EGM96, EGM2008, or any vertical CRS that PROJ knows, such as EPSG:5773; it is written into the DSM's CRS. "
            "Its grid must be installed: without it the run stops, and names the grid."
        ),
    )


def pointing() -> QgsProcessingParameterDefinition:
    from ..repm_qgis.options import POINTINGS

    return advanced(
        choice(
            "POINTING",
            tr("Correction of the images' pointing"),
            POINTINGS,
            "auto",
            tr(
                "shift: one shift an image; affine: also stretched and turned; auto: affine where the "
                "tie points show a trend and span the images well enough to carry it."
            ),
        )
    )


def adjustment() -> QgsProcessingParameterDefinition:
    from ..repm_qgis.options import ADJUSTMENTS

    return advanced(
        choice(
            "ADJUSTMENT",
            tr("Adjustment of the pointing"),
            ADJUSTMENTS,
            "rpc",
            tr(
                "rpc: against the original RPCs, exact, takes control points and affine corrections; "
                "colmap: the paper's way, COLMAP moves the principal points of the pinhole cameras: "
                "shifts only, and no control points."
            ),
        )
    )


def extent() -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterExtent("EXTENT", tr("Area (empty: all that two images see)"), optional=True),
        tr("Only this area is computed."),
    )


def dem() -> QgsProcessingParameterDefinition:
    return helped(
        Raster("DEM", tr("Coarse elevation model"), optional=True),
        tr(
            "Any DEM that covers the area: it narrows the range of altitudes, and is the surface of the "
            "terrain model. Heights above the ellipsoid or, where its CRS says so, above the geoid."
        ),
    )


def surface() -> QgsProcessingParameterDefinition:
    return helped(
        Raster("DEM", tr("Coarse elevation model (terrain model only)"), optional=True),
        tr(
            "The surface that the terrain model refines on; a DEM with cells of 30 m will do. Empty: the heights that "
            "the scene has already, where 'Reconstruct heights' has made some."
        ),
    )


def altitudes() -> list[QgsProcessingParameterDefinition]:
    text = tr("Metres above the WGS 84 ellipsoid. Empty: from the DEM, else from the images or the RPCs.")
    return [
        advanced(real("ALTITUDE_MIN", tr("Lowest altitude (m, empty: automatic)"), None, -12000, 10000, text)),
        advanced(real("ALTITUDE_MAX", tr("Highest altitude (m, empty: automatic)"), None, -12000, 10000, text)),
    ]


def tiles_and_budget() -> list[QgsProcessingParameterDefinition]:
    return [
        advanced(
            whole(
                "TILE_SIZE",
                tr("Tile size (px, 0: automatic)"),
                0,
                0,
                20000,
                tr("0 takes the largest tile that keeps the error under the budget, and fits memory."),
            )
        ),
        advanced(
            real(
                "ERROR_BUDGET",
                tr("Error budget (px)"),
                0.1,
                0.001,
                100,
                tr("What the pinhole model may cost at most, as equivalent error in the image."),
            )
        ),
    ]


def model() -> QgsProcessingParameterDefinition:
    from ..repm_qgis.options import MODELS

    return choice(
        "MODEL",
        tr("Refinement model"),
        MODELS,
        "polynomial",
        tr(
            "none: pinhole cameras on the images as they are; homography: plane to plane; polynomial: cures "
            "the curvature of the image; terrain: cures the parallax of altitude too, on a coarse surface."
        ),
    )


def order() -> QgsProcessingParameterDefinition:
    return whole(
        "ORDER",
        tr("Order of the polynomial"),
        2,
        2,
        5,
        tr(
            "2 is the paper's; 3 to 5 help only where the attitude of the satellite wobbles within a tile. "
            "Other models take no notice of it."
        ),
    )


def kernel() -> QgsProcessingParameterDefinition:
    from ..repm_qgis.options import KERNELS

    return choice(
        "KERNEL",
        tr("Resampling of the refined images"),
        KERNELS,
        "bilinear",
        tr(
            "bilinear: the paper's, and the fastest; cubic: sharper; lanczos: sharpest, may ring at edges. "
            "The heights are matched on the original images and do not depend on it."
        ),
    )


def backend() -> QgsProcessingParameterDefinition:
    from ..repm_qgis.options import BACKENDS

    return choice(
        "BACKEND",
        tr("Dense matching"),
        BACKENDS,
        "auto",
        tr(
            "sgm: semi-global matching on the CPU; colmap: COLMAP's PatchMatch on a CUDA GPU; auto: colmap "
            "where a CUDA device answers, else sgm."
        ),
    )


def patch_match() -> list[QgsProcessingParameterDefinition]:
    """What matters of the backend colmap."""
    return [
        advanced(
            helped(
                QgsProcessingParameterBoolean("GEOMETRIC", tr("COLMAP: geometric consistency"), True),
                tr(
                    "On: depths must also agree with those of the other images, in a second pass of the "
                    "same length. Off: half the time, more outliers."
                ),
            )
        ),
        advanced(
            helped(
                QgsProcessingParameterBoolean("COLMAP_FUSION", tr("COLMAP: only what its fusion keeps"), False),
                tr(
                    "On: COLMAP's own fusion of the depth maps decides which heights go on to the DSM: two "
                    "images must agree in place, depth and slope. Fewer heights, fewer outliers."
                ),
            )
        ),
        advanced(
            whole(
                "WINDOW_RADIUS",
                tr("COLMAP: radius of the window (px)"),
                5,
                1,
                20,
                tr(
                    "Smaller: sharper edges, more noise; larger: smoother, fills weak texture. The time "
                    "grows with its square."
                ),
            )
        ),
        advanced(
            real(
                "GPU_MEMORY",
                tr("COLMAP: memory of a GPU (GiB, 0: what is free)"),
                0.0,
                0.0,
                1024.0,
                tr("A tile that needs more is matched in parts."),
            )
        ),
    ]


def resolution() -> QgsProcessingParameterDefinition:
    return real(
        "RESOLUTION",
        tr("DSM resolution (m, 0: twice the ground sampling distance)"),
        0.0,
        0.0,
        1000.0,
        tr("Cell size in units of the CRS."),
    )


def crs() -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterCrs("CRS", tr("CRS of the results (empty: the scene's UTM zone)"), optional=True),
        tr("A projected CRS."),
    )


def fusion() -> list[QgsProcessingParameterDefinition]:
    from ..repm_qgis.options import FILLS, MAX_VERTICES, METHODS

    return [
        advanced(
            choice(
                "METHOD",
                tr("Fusion of the pairs' heights"),
                METHODS,
                "mean",
                tr("Of the heights that agree: mean has less noise, median is the paper's."),
            )
        ),
        advanced(
            choice(
                "FILL",
                tr("Fill"),
                FILLS,
                "occlusions",
                tr(
                    "occlusions: cells that one image hides take the height of the ground behind; all: "
                    "remaining holes are interpolated too; both are marked in the confidence raster. none: "
                    "they stay nodata."
                ),
            )
        ),
        advanced(
            real(
                "OUTLIER_RADIUS",
                tr("Outlier radius (m, empty: automatic, 0: off)"),
                None,
                0.0,
                1000.0,
                tr("Points with too few neighbours within this distance are dropped."),
            )
        ),
        advanced(
            whole(
                "MESH_VERTICES",
                tr("Most vertices of the mesh (0: one a cell)"),
                500_000,
                0,
                MAX_VERTICES,
                tr("Where the DSM has more cells, the mesh takes every second (third, ...) row and column."),
            )
        ),
    ]


def scene(label: Optional[str] = None) -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterFile(
            "SCENE", label or tr("Scene"), QgsProcessingParameterFile.Behavior.File, fileFilter=SCENE_FILTER
        ),
        tr("The scene.json that the stage before wrote."),
    )


def output_scene() -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterFileDestination("OUTPUT_SCENE", tr("Scene after this stage"), SCENE_FILTER),
        tr("What this stage makes is kept in this file's folder."),
    )


def workspace() -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterFolderDestination("WORKSPACE", tr("Workspace")),
        tr("A folder for the scene and all between; a second run there goes on where the first stopped."),
    )


def report() -> QgsProcessingParameterDefinition:
    return QgsProcessingParameterFileDestination("REPORT", tr("Report"), HTML_FILTER, optional=True)


def tiles() -> QgsProcessingParameterDefinition:
    return QgsProcessingParameterVectorDestination(
        "TILES", tr("Tiles"), QgsProcessing.SourceType.TypeVectorPolygon, optional=True
    )


def tie_points() -> QgsProcessingParameterDefinition:
    return QgsProcessingParameterVectorDestination(
        "TIE_POINTS", tr("Tie points"), QgsProcessing.SourceType.TypeVectorPoint, optional=True
    )


def dsm_products() -> list[QgsProcessingParameterDefinition]:
    """The DSM, and what may come with it."""
    extra: dict[str, Any] = {"optional": True, "createByDefault": False}
    return [
        QgsProcessingParameterRasterDestination("OUTPUT", tr("DSM")),
        QgsProcessingParameterRasterDestination("CONFIDENCE", tr("Confidence"), **extra),
        QgsProcessingParameterRasterDestination("ORTHO", tr("Orthophoto"), **extra),
        QgsProcessingParameterFileDestination("CLOUD", tr("Point cloud"), "LAZ (*.laz);;LAS (*.las)", **extra),
        helped(
            QgsProcessingParameterFolderDestination("EPT", tr("Point cloud for display (EPT)"), **extra),
            tr("A folder of its own with the points as Entwine point tiles, which every QGIS shows."),
        ),
        QgsProcessingParameterFileDestination("MESH", tr("Mesh"), "PLY (*.ply)", **extra),
        helped(
            QgsProcessingParameterFolderDestination("VIEW_HEIGHTS", tr("DSM of each pair alone"), **extra),
            tr(
                "A folder for the surface that each pair of images sees by itself, with its confidence: to see "
                "which pair an error comes from."
            ),
        ),
    ]
