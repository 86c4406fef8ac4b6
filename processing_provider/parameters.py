"""Parameters that several algorithms share, each with its bounds and its help."""

from __future__ import annotations

from typing import Optional

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterCrs,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterEnum,
    QgsProcessingParameterExtent,
    QgsProcessingParameterFile,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterMapLayer,
    QgsProcessingParameterMultipleLayers,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameters,
    QgsProcessingParameterString,
    QgsProcessingParameterVectorDestination,
    QgsProcessingParameterVectorLayer,
)
from qgis.PyQt.QtCore import QCoreApplication

from ..repm_qgis.contracts import products
from ..repm_qgis.contracts.checks import Number
from ..repm_qgis.contracts.file_kinds import IMAGE_ENDS, is_delivery
from ..repm_qgis.contracts.options import (
    DsmFuseOptions,
    EpmFitOptions,
    Options,
    PipelineOptions,
    ReconstructOptions,
    RefineOptions,
)
from ..repm_qgis.contracts.products import tiles_folder

SCENE_FILTER = products.SCENES


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


def basic(parameter: QgsProcessingParameterDefinition) -> QgsProcessingParameterDefinition:
    """The parameter, shown in the dialog's first part."""
    parameter.setFlags(parameter.flags() & ~QgsProcessingParameterDefinition.Flag.FlagAdvanced)
    return parameter


def number(
    stage: type[Options], name: str, label: str, text: str = "", optional: bool = False
) -> QgsProcessingParameterDefinition:
    """A number with the default and the bounds of an option; no default makes it optional."""
    option = stage.option(name)
    limits: Number = option.metadata["check"]
    kinds = QgsProcessingParameterNumber.Type
    low = min(limits.low, 0) if limits.automatic else limits.low
    parameter = QgsProcessingParameterNumber(
        name.upper(),
        label,
        kinds.Integer if limits.whole else kinds.Double,
        option.default,
        optional or option.default is None,
        low,
        limits.high,
    )
    if not limits.whole:
        parameter.setMetadata({"widget_wrapper": {"decimals": 3}})  # QGIS shows six by default, more than needed here
    return helped(parameter, text)


def choice(stage: type[Options], name: str, label: str, text: str = "") -> QgsProcessingParameterDefinition:
    """A choice whose values are the words of an option themselves, so that commands and models stay readable."""
    option = stage.option(name)
    words, chosen = list(option.metadata["check"].choices), option.default
    parameter = QgsProcessingParameterEnum(name.upper(), label, words, defaultValue=chosen, usesStaticStrings=True)
    return helped(parameter, text)


def switch(stage: type[Options], name: str, label: str, text: str = "") -> QgsProcessingParameterDefinition:
    return helped(QgsProcessingParameterBoolean(name.upper(), label, stage.option(name).default), text)


class Images(QgsProcessingParameterMultipleLayers):
    """Rasters that QGIS does not open to check them.

    Its own check loads every image as a layer: slow, it may write statistics beside the image, and its message on a
    damaged one names no file. The engine checks them better.
    """

    def checkValueIsAcceptable(self, input: object, context: object = None) -> bool:  # noqa: A002 - QGIS's name
        named = [input] if isinstance(input, str) else input if isinstance(input, list) else []
        # One folder may hold many images: the engine counts them.
        several = any(isinstance(path, str) and is_delivery(path) for path in named)
        return several or super().checkValueIsAcceptable(input)

    def createFileFilter(self) -> str:
        """What *Add file(s)...* offers: images, and what stands for several or for one in tiles.

        *Add directory...* takes all files whose endings stand after "*." here. These must be images only: a delivery
        also has sidecar files in XML and JSON.
        """
        every = [*IMAGE_ENDS, *(end.upper() for end in IMAGE_ENDS)]
        images = " ".join(f"*{end}" for end in every)
        products = " ".join(("*TIL", "*til", "DIM*XML", "*zip", "*ZIP", "*tar", "*TAR", "*json", "*geojson"))
        groups = (
            (tr("Images and products"), f"{images} {products}"),
            (tr("Images"), images),
            (tr("Products in tiles, archives and STAC items"), products),
            (tr("All files"), "*"),
        )
        return ";;".join(f"{name} ({patterns})" for name, patterns in groups)

    def clone(self) -> Images:
        return Images(self)


class Raster(QgsProcessingParameterRasterLayer):
    """A raster that QGIS does not open to check it, as :class:`Images`: it would write statistics beside it."""

    def checkValueIsAcceptable(self, input: object, context: object = None) -> bool:  # noqa: A002 - QGIS's name
        return super().checkValueIsAcceptable(input)

    def clone(self) -> Raster:
        return Raster(self)


class Rasters(QgsProcessingParameterMultipleLayers):
    """Several of :class:`Raster`."""

    def checkValueIsAcceptable(self, input: object, context: object = None) -> bool:  # noqa: A002 - QGIS's name
        return super().checkValueIsAcceptable(input)

    def clone(self) -> Rasters:
        return Rasters(self)


class TiledRaster(QgsProcessingParameterRasterDestination):
    """A raster to write that may also be a VRT, which the provider's other rasters may not."""

    def supportedOutputRasterLayerExtensions(self) -> list[str]:
        return [*super().supportedOutputRasterLayerExtensions(), "vrt"]

    def isSupportedOutputValue(self, value: object, context: QgsProcessingContext) -> tuple[bool, str]:
        path = QgsProcessingParameters.parameterAsOutputLayer(self, value, context)
        return (True, "") if tiles_folder(path) else super().isSupportedOutputValue(value, context)

    def clone(self) -> TiledRaster:
        return TiledRaster(self)


class Layer(QgsProcessingParameterMapLayer):
    """A raster or a vector layer that QGIS does not open to check it."""

    def checkValueIsAcceptable(self, input: object, context: object = None) -> bool:  # noqa: A002 - QGIS's name
        return super().checkValueIsAcceptable(input)

    def clone(self) -> Layer:
        return Layer(self)


def surface_or_cloud(name: str, label: str, text: str) -> QgsProcessingParameterDefinition:
    """A raster of heights, or a point cloud."""
    kinds = QgsProcessing.SourceType
    return helped(Layer(name, label, types=[kinds.TypeRaster, kinds.TypePointCloud]), text)


class Points(QgsProcessingParameterVectorLayer):
    """A point layer or a table's file that QGIS does not open to check it: the engine reads both, and reports their
    errors."""

    def checkValueIsAcceptable(self, input: object, context: object = None) -> bool:  # noqa: A002 - QGIS's name
        return super().checkValueIsAcceptable(input)

    def clone(self) -> Points:
        return Points(self)


def images(least: int = 2) -> QgsProcessingParameterDefinition:
    parameter = Images("IMAGES", tr("Satellite images with RPCs"), QgsProcessing.SourceType.TypeRaster)
    parameter.setMinimumNumberInputs(least)
    text = tr(
        "Two or more images of the same ground in sensor geometry (level Basic, Sensor or Primary), or "
        "ortho-ready, each with its RPC in the file or beside it. A tile stands for its whole image, and the path "
        "of a folder, a ZIP or TAR file or a STAC item, as it was delivered, for the images in it."
    )
    return helped(parameter, text if least > 1 else f"{text} {tr('One image alone has a camera, but no heights.')}")


def rpcs() -> QgsProcessingParameterDefinition:
    return advanced(
        helped(
            QgsProcessingParameterMultipleLayers(
                "RPCS",
                tr("RPC files"),
                QgsProcessing.SourceType.TypeFile,
                optional=True,
            ),
            tr(
                "Only needed where the RPCs are neither in the images nor beside them: one file for each image, in the "
                "order of the images."
            ),
        )
    )


def masks() -> QgsProcessingParameterDefinition:
    return advanced(
        helped(
            QgsProcessingParameterMultipleLayers(
                "MASKS",
                tr("Masks of pixels that must not be used"),
                QgsProcessing.SourceType.TypeFile,
                optional=True,
            ),
            tr(
                "One raster for each image, in the order of the images and of the same size in columns and rows: "
                "pixels that are neither zero nor nodata (clouds, water) are not used at all, not even for tie "
                "points. The image's own mask or alpha band is always used."
            ),
        )
    )


def confidences(text: str) -> QgsProcessingParameterDefinition:
    """One raster for each DSM; ``text`` says what they change, and what holds without them."""
    one_each = tr(
        "One raster for each DSM, in the order of the DSMs: this plugin's confidence raster, or one band with the "
        "expected error in metres."
    )
    return advanced(
        helped(
            QgsProcessingParameterMultipleLayers(
                "CONFIDENCES", tr("Confidence rasters"), QgsProcessing.SourceType.TypeFile, optional=True
            ),
            f"{one_each} {text}",
        )
    )


def gcps(optional: bool = True) -> QgsProcessingParameterDefinition:
    return helped(
        Points("GCPS", tr("Ground control points"), [QgsProcessing.SourceType.TypeVector], optional=optional),
        tr(
            "A CSV file or point layer with one row for each point and image: id, lon, lat, height, view "
            "(the image's file name), col, row (the first pixel's centre is 0, 0), role (control or check). "
            "The geometry of a layer can replace lon and lat."
        ),
    )


def references(optional: bool = False) -> QgsProcessingParameterDefinition:
    return helped(
        Rasters("REFERENCE", tr("References"), QgsProcessing.SourceType.TypeMapLayer, optional=optional),
        tr(
            "Known heights: a DEM such as Copernicus GLO-30 or SRTM, a lidar DEM or cloud (LAZ), an older DSM, points "
            "(CSV, GeoPackage), or ICESat-2 and GEDI (HDF5, CSV). The whole scene is moved onto them."
        ),
    )


def reference_datum() -> QgsProcessingParameterDefinition:
    return advanced(
        helped(
            QgsProcessingParameterString(
                "REFERENCE_DATUM", tr("Heights of the references refer to"), "auto", optional=True
            ),
            tr(
                "auto: what each file says, or else the datum that fits; the log names it. Or give ellipsoid, EGM96, "
                "EGM2008, or any vertical CRS that PROJ knows, such as EPSG:5773."
            ),
        )
    )


def stable() -> QgsProcessingParameterDefinition:
    return advanced(
        helped(
            Layer("STABLE", tr("Ground that has not changed"), optional=True),
            tr(
                "Polygons, or a raster that is not zero on such ground: only heights there count. Empty: all heights "
                "count."
            ),
        )
    )


def cluster() -> QgsProcessingParameterDefinition:
    return advanced(
        helped(
            QgsProcessingParameterString("CLUSTER", tr("Dask cluster"), "", optional=True),
            tr(
                "The address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its scheduler file: the work is done "
                "by the cluster's workers. They must see the images, the workspace and the products under the same "
                "paths. Empty: the cluster of the settings, or this machine where there is none."
            ),
        )
    )


def gcp_datum() -> QgsProcessingParameterDefinition:
    return advanced(
        helped(
            QgsProcessingParameterString(
                "GCP_DATUM",
                tr("Heights of the control points refer to"),
                "",
                optional=True,
            ),
            tr(
                "EGM96, EGM2008, or any vertical CRS that PROJ knows, such as EPSG:5773. Its grid must be installed: "
                "the Environment report names what is missing."
            ),
        )
    )


def vertical_datum() -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterString("VERTICAL_DATUM", tr("Heights refer to"), "", optional=True),
        tr(
            "EGM96, EGM2008, or any vertical CRS that PROJ knows, such as EPSG:5773; it is written into the DSM's CRS. "
            "Its grid must be installed: without it the run stops, and names the grid."
        ),
    )


def pointing() -> QgsProcessingParameterDefinition:
    return advanced(
        choice(
            ReconstructOptions,
            "pointing",
            tr("Pointing correction"),
            tr(
                "What is corrected in each image. shift: one shift; affine: also scale, shear and rotation; jitter: "
                "also waves of its lines, because the satellite shook; auto: affine where the tie points show a trend "
                "and span the images well enough, and jitter where they show waves."
            ),
        )
    )


def quality() -> QgsProcessingParameterDefinition:
    return advanced(
        choice(
            ReconstructOptions,
            "quality",
            tr("Quality of the matching"),
            tr(
                "fast: only as many pairs as connect all images, a fifth to a third less time, and more gaps; best: "
                "semi-global matching in eight directions instead of three, up to half more time and more "
                "memory, for mountains, low suns and oblique views; default: between the two."
            ),
        )
    )


def matching_cost() -> QgsProcessingParameterDefinition:
    return advanced(
        choice(
            ReconstructOptions,
            "matching_cost",
            tr("Matching cost"),
            tr(
                "What tells that two pixels show the same place. intensity: the images' grey values, for images of one "
                "day; learned: features of a small neural network, for images of different seasons, which takes up to "
                "twice the time; auto: decided for each pair by how well its images agree."
            ),
        )
    )


def pairs() -> QgsProcessingParameterDefinition:
    return advanced(
        choice(
            ReconstructOptions,
            "pairs",
            tr("Pairs of images"),
            tr(
                "best: all pairs of up to three images, and the two best ones of each of more images; fewest: only "
                "as many as connect all images, which takes less time and leaves more gaps."
            ),
        )
    )


def adjustment() -> QgsProcessingParameterDefinition:
    return advanced(
        choice(
            ReconstructOptions,
            "adjustment",
            tr("Adjustment that finds the pointing correction"),
            tr(
                "rpc: against the original RPCs, exact, with control points and affine corrections; colmap: as "
                "in the paper, COLMAP moves the principal points of the pinhole cameras: shifts only, and no "
                "control points."
            ),
        )
    )


def preset() -> QgsProcessingParameterDefinition:
    return choice(
        PipelineOptions,
        "preset",
        tr("Preset"),
        tr(
            "Values that go together, for advanced parameters below; the dialog fills them in, and you can change each "
            "of them afterwards. city: walls and streets; mountains: a surface without holes; fast: a first look, of "
            "the fewest pairs; preview: reduced images, in seconds. In a command, a value that you give overrides the "
            "preset's."
        ),
    )


def extent() -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterExtent("EXTENT", tr("Area"), optional=True),
        tr("Only this area is computed. Empty: all that two images see."),
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
        Raster("DEM", tr("Coarse elevation model"), optional=True),
        tr(
            "Only for the terrain model, which refines on this surface; a DEM with cells of 30 m is fine enough. "
            "Empty: the heights that the scene already has from 'Reconstruct heights'."
        ),
    )


def altitudes() -> list[QgsProcessingParameterDefinition]:
    text = tr("Metres above the WGS 84 ellipsoid. Empty: from the DEM, else from the images or the RPCs.")
    return [
        advanced(number(EpmFitOptions, "altitude_min", tr("Lowest altitude (m)"), text)),
        advanced(number(EpmFitOptions, "altitude_max", tr("Highest altitude (m)"), text)),
    ]


def ortho_ready_height() -> QgsProcessingParameterDefinition:
    return advanced(
        number(
            EpmFitOptions,
            "ortho_ready_height",
            tr("Height of ortho-ready images (m)"),
            tr(
                "The height above the WGS 84 ellipsoid to which ortho-ready images were projected (Maxar OR2A, Airbus "
                "projected, GF and ZY 2A), where their metadata do not state it. Empty: it is found with a DEM, or "
                "else the middle of the RPC's heights is assumed, and the log says so. Images in sensor geometry do "
                "not need it."
            ),
        )
    )


def tiles_and_budget() -> list[QgsProcessingParameterDefinition]:
    return [
        advanced(
            number(
                EpmFitOptions,
                "tile_size",
                tr("Tile size (px)"),
                tr("0 means the largest tile whose error stays within the budget and which fits into memory."),
            )
        ),
        advanced(
            number(
                EpmFitOptions,
                "error_budget",
                tr("Error budget (px)"),
                tr("The equivalent error in the image that the pinhole model may have at most."),
            )
        ),
    ]


def model() -> QgsProcessingParameterDefinition:
    return choice(
        RefineOptions,
        "model",
        tr("Refinement model"),
        tr(
            "none: pinhole cameras on the images as they are; homography: plane to plane; polynomial: "
            "removes the curvature of the image; terrain: removes the parallax of altitude too, on a coarse "
            "surface."
        ),
    )


def order() -> QgsProcessingParameterDefinition:
    return number(
        RefineOptions,
        "order",
        tr("Order of the polynomial"),
        tr(
            "2 is the paper's; 3 to 5 help only where the satellite's attitude changes quickly within a "
            "tile. Other models do not use it."
        ),
    )


def kernel() -> QgsProcessingParameterDefinition:
    return choice(
        RefineOptions,
        "kernel",
        tr("Resampling of the refined images"),
        tr(
            "bilinear: the paper's, and the fastest; cubic: sharper; lanczos: sharpest, may ring at edges. "
            "The heights are matched on the original images and do not depend on it."
        ),
    )


def backend() -> QgsProcessingParameterDefinition:
    return choice(
        ReconstructOptions,
        "backend",
        tr("Dense matching"),
        tr(
            "sgm: semi-global matching on the CPU; colmap: COLMAP's PatchMatch on a CUDA GPU; auto: sgm, "
            "which is faster and more accurate even beside an H100."
        ),
    )


def patch_match() -> list[QgsProcessingParameterDefinition]:
    """The most important parameters of the backend colmap."""
    return [
        advanced(
            switch(
                ReconstructOptions,
                "geometric",
                tr("COLMAP: geometric consistency"),
                tr(
                    "On: depths must also agree with those of the other images, in a second pass of the "
                    "same length. Off: half the time, more outliers."
                ),
            )
        ),
        advanced(
            switch(
                ReconstructOptions,
                "colmap_fusion",
                tr("COLMAP: only heights that its fusion keeps"),
                tr(
                    "On: COLMAP's own fusion of the depth maps decides which heights the DSM uses: two images must "
                    "agree in position, depth and slope. This gives fewer heights and fewer outliers."
                ),
            )
        ),
        advanced(
            number(
                ReconstructOptions,
                "window_radius",
                tr("COLMAP: radius of the window (px)"),
                tr(
                    "Smaller: sharper edges, more noise; larger: smoother, fills weak texture. The time "
                    "grows with its square."
                ),
            )
        ),
        advanced(
            number(
                ReconstructOptions,
                "gpu_memory",
                tr("COLMAP: memory of a GPU (GiB)"),
                tr("A tile that needs more is matched in parts. 0: what is free."),
            )
        ),
    ]


def resolution() -> QgsProcessingParameterDefinition:
    return number(
        DsmFuseOptions,
        "resolution",
        tr("DSM resolution (m)"),
        tr("Cell size in units of the CRS. 0: twice the ground sampling distance of the images."),
    )


def in_models(parameter: QgsProcessingParameterDefinition) -> QgsProcessingParameterDefinition:
    """A parameter of a model. The user's copy has QGIS's own dialog, where only the label can say what 0 means."""
    copy = parameter.clone()
    if copy.name() == "RESOLUTION":
        copy.setDescription(tr("DSM resolution (m), 0: automatic"))
    return copy


def crs() -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterCrs("CRS", tr("CRS of the results"), optional=True),
        tr("A projected CRS. Empty: the scene's UTM zone."),
    )


def fusion() -> list[QgsProcessingParameterDefinition]:
    return [
        advanced(
            choice(
                DsmFuseOptions,
                "method",
                tr("Fusion of the pairs' heights"),
                tr("How the heights that agree are combined: mean has less noise, median is the paper's."),
            )
        ),
        advanced(
            choice(
                DsmFuseOptions,
                "fill",
                tr("Fill"),
                tr(
                    "occlusions: cells that one image hides take the height of the ground behind, and cells that a "
                    "shadow leaves without texture that of the ground where it ends; all: remaining holes are "
                    "interpolated too; both are marked in the confidence raster. none: they stay nodata."
                ),
            )
        ),
        advanced(
            choice(
                DsmFuseOptions,
                "water",
                tr("Water surfaces"),
                tr(
                    "keep: as they were matched, mostly without heights; flatten: lakes get the level of their shore, "
                    "and rivers fall along their flow. Water is found where multispectral images show it (NDWI), else "
                    "where matching finds nothing and the images are dark and smooth; from 2000 m² and 12 m width on."
                ),
            )
        ),
        advanced(
            number(
                DsmFuseOptions,
                "outlier_radius",
                tr("Outlier radius (m)"),
                tr("Points with too few neighbours within this distance are removed. 0: none."),
                optional=True,  # models that were saved when there was no default leave it empty
            )
        ),
        advanced(
            number(
                DsmFuseOptions,
                "mesh_vertices",
                tr("Most vertices of the mesh"),
                tr(
                    "Where the DSM has more cells, the mesh has fewer vertices on level ground and roofs than at their "
                    "edges. It has about two triangles for each vertex: 500000 make a million. 0: one for each cell."
                ),
            )
        ),
    ]


def colours() -> list[QgsProcessingParameterDefinition]:
    """The orthophoto's cells, and the colours of orthophoto, clouds and mesh."""
    return [
        advanced(
            number(
                DsmFuseOptions,
                "ortho_resolution",
                tr("Orthophoto resolution (m)"),
                tr(
                    "Cell size in units of the CRS, not coarser than the DSM's. 0: the ground sampling distance of the "
                    "finest image. Half the size takes four times as long to make, and four times the space."
                ),
            )
        ),
        choice(
            DsmFuseOptions,
            "colour",
            tr("Colours of orthophoto, point cloud and mesh"),
            tr(
                "auto: natural colours where the images or the multispectral images have them, else greys; greys: one "
                "band; all: all bands, near infrared too."
            ),
        ),
        advanced(
            helped(
                Images(
                    "XS",
                    tr("Multispectral images (XS) of the panchromatic ones"),
                    QgsProcessing.SourceType.TypeRaster,
                    optional=True,
                ),
                tr(
                    "In any order, each with its own RPC: they are paired with the panchromatic images by their line "
                    "of sight and time. Empty: those that lie beside the images under their vendors' names."
                ),
            )
        ),
        advanced(
            switch(
                DsmFuseOptions,
                "pansharpen",
                tr("Pansharpening of multispectral images"),
                tr(
                    "On: colours with the detail of the panchromatic images. Off: the multispectral pixels as they are."
                ),
            )
        ),
        advanced(
            switch(
                DsmFuseOptions,
                "cloud_normals",
                tr("Normals in the point cloud"),
                tr(
                    "For shading and meshing in CloudCompare and others. Fusing takes more than twice as long, and a "
                    "LAZ is 1.6 times as large."
                ),
            )
        ),
    ]


def of_all_stages() -> list[QgsProcessingParameterDefinition]:
    """What a whole run takes for its stages, in their order, all of it advanced."""
    return [
        advanced(crs()),
        advanced(dem()),
        *altitudes(),
        gcp_datum(),
        reference_datum(),
        stable(),
        *tiles_and_budget(),
        advanced(model()),
        advanced(order()),
        pairs(),
        matching_cost(),
        pointing(),
        adjustment(),
        advanced(backend()),
        *patch_match(),
        *fusion(),
        *map(advanced, colours()),
    ]


def scene(label: Optional[str] = None) -> QgsProcessingParameterDefinition:
    return helped(
        QgsProcessingParameterFile(
            "SCENE", label or tr("Scene"), QgsProcessingParameterFile.Behavior.File, fileFilter=SCENE_FILTER
        ),
        tr("The scene.json that the previous stage wrote."),
    )


def product(stage: str, option: str) -> QgsProcessingParameterDefinition:
    """Where a product goes."""
    return _destination(products.product(stage, option))


def dsm_products() -> list[QgsProcessingParameterDefinition]:
    """The DSM, and the products that may come with it, without the stage's report."""
    return [_destination(each) for each in products.products_of("dsmfuse") if each.option != "report"]


def _destination(each: products.Product) -> QgsProcessingParameterDefinition:
    name, label = each.option.upper(), tr(each.title)
    more = {"optional": each.wanted != products.ALWAYS, "createByDefault": each.wanted != products.ON_REQUEST}
    types = QgsProcessing.SourceType
    if each.form == products.RASTER:
        kind = TiledRaster if each.tiled else QgsProcessingParameterRasterDestination
        made: QgsProcessingParameterDefinition = kind(name, label, **more)
    elif each.form in (products.POINTS, products.POLYGONS):
        shape = types.TypeVectorPoint if each.form == products.POINTS else types.TypeVectorPolygon
        made = QgsProcessingParameterVectorDestination(name, label, shape, **more)
    elif each.form in (products.FOLDER, products.BUILT_FOLDER):
        made = QgsProcessingParameterFolderDestination(name, label, **more)
    else:
        made = QgsProcessingParameterFileDestination(name, label, each.filter, **more)
    return helped(made, tr(each.help)) if each.help else made
