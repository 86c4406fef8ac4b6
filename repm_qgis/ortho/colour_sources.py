"""Where each view's colours come from: its own bands, or a multispectral image beside it."""

from __future__ import annotations

import glob
import math
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import AnyArray, FloatArray, FloatImage, Floats
from ..contracts.errors import ImageError, OptionError, OverlapError, RepmError
from ..contracts.options import DsmFuseOptions
from ..fusion.parameters import VisibilityParameters
from ..fusion.visible import nadir_first, pixels_on
from ..geometry.cell_grid import CellGrid
from ..geometry.footprints import footprint, geometry_of, ray_slope
from ..imagery.bands import band_name, intensity_bands, natural_bands, water_bands
from ..imagery.raster import opened, opened_masked, raster_identity
from ..imagery.warping import sample_source
from ..planning.empty_ends import without_empty_ends
from ..runtime.progress import Progress, counted, listed
from ..runtime.workspace import fingerprint
from ..scene import Scene, View, load_view
from .pansharpening import Multispectral, brovey
from .parameters import PansharpeningParameters

# How vendors name the panchromatic and the multispectral image of one acquisition; Airbus counts the two on.
_NAMES = (("-P1BS", "-M1BS"), ("_P_", "_MS_"), ("_PAN", "_MS"), ("_PAN", "_XS"), ("_PAN", "_MUL"), ("_PAN", "_MSS"))
_FOLDERS = (("_PAN", "_MUL"), ("_P_", "_MS_"), ("PAN", "MS"), ("PAN", "XS"), ("PAN", "MUL"))
_ENDS = ("_XS", "_MS")
_KINDS = {"Byte": "uint8", "UInt16": "uint16"}
_WIDER = ("uint8", "uint16", "float32")


@dataclass(frozen=True)
class ColourSource:
    """One view and its colours: those ``bands`` of its own image, or of the ``multispectral`` one.

    ``sharpened``: with the panchromatic image's detail. ``gains`` and ``offsets`` (of each band) bring the colours to
    those of the other views.
    """

    view: View
    bands: Tuple[int, ...]
    multispectral: Optional[Multispectral] = None
    sharpened: bool = False
    gains: Tuple[float, ...] = ()
    offsets: Tuple[float, ...] = ()

    @property
    def coloured(self) -> str:
        """The image that has the bands."""
        return self.view.image if self.multispectral is None else self.multispectral.image.image

    @property
    def gsd_m(self) -> float:
        """The ground sampling distance of the detail that its colours have."""
        pair = self.multispectral
        return self.view.gsd_m if pair is None or self.sharpened else pair.image.gsd_m

    @property
    def files(self) -> List[str]:
        """The images that are read."""
        return [self.view.image] if self.multispectral is None else [self.view.image, self.coloured]

    def colours(
        self,
        grid: CellGrid,
        height: Floats,
        crs: str,
        visibility: VisibilityParameters,
        step: int = 1,
        balanced: bool = True,
        kernel: str = "bilinear",
    ) -> FloatImage:
        """(B, H, W) colours of every ``step``-th row and column of cells, whether the view sees them or not; NaN
        outside the image and without a height (above the ellipsoid, m). ``kernel`` is how pixels are interpolated."""
        found = self._sampled(grid, height, crs, visibility, step=step, kernel=kernel)
        if balanced and self.gains:
            gains, offsets = (np.array(each, np.float32)[:, None, None] for each in (self.gains, self.offsets))
            found = found * gains + offsets
        return np.where(np.isfinite(found).all(axis=0), found, np.float32(np.nan))

    def _sampled(
        self, grid: CellGrid, height: Floats, crs: str, visibility: VisibilityParameters, *, step: int, kernel: str
    ) -> FloatImage:
        def pixels(camera: View | Multispectral) -> FloatArray:
            return pixels_on(camera, grid, height, crs, visibility)[::step, ::step]

        own = pixels(self.view)
        pair = self.multispectral
        with opened_masked(self.view.image, self.view.mask) as dataset:
            if pair is None:
                return np.stack([sample_source(dataset, band, own, kernel) for band in self.bands])
            pan = sample_source(dataset, self.view.band, own, kernel)
        places = pixels(pair)
        with opened_masked(pair.image.image, pair.image.mask) as dataset:
            read = pair.bands if self.sharpened else self.bands
            values = np.stack([sample_source(dataset, band, places, kernel) for band in read])
        if self.sharpened:
            values = brovey(values, pan, pair.weights)[[pair.bands.index(band) for band in self.bands]]
        # What the panchromatic view's mask excludes has no colour either.
        return np.where(np.isfinite(pan), values, np.float32(np.nan))


@dataclass(frozen=True)
class ColourPlan:
    """The sources, the most vertical one first; the ``names`` of the orthophoto's bands; whether the first three are
    red, green and blue; and the type of its numbers, which is the images' own."""

    sources: Tuple[ColourSource, ...]
    names: Tuple[str, ...]
    natural: bool
    kind: str

    @property
    def nodata(self) -> Optional[float]:
        """The value of cells without a colour: whole numbers begin with one."""
        return None if self.kind == "float32" else 0.0

    @property
    def files(self) -> List[str]:
        """All images that are read."""
        return [file for source in self.sources for file in source.files]

    def stored(self, colours: FloatImage) -> AnyArray:
        """(B, H, W) colours as the orthophoto keeps them."""
        if self.kind == "float32":
            return colours
        most = np.iinfo(self.kind).max
        return np.nan_to_num(np.clip(np.rint(colours), 1, most), nan=0.0).astype(self.kind)


@dataclass(frozen=True)
class _Bands:
    """The bands of an image that are taken, red, green and blue first where they are known (``natural``)."""

    chosen: Tuple[int, ...]
    every: Tuple[int, ...]
    natural: bool
    names: Tuple[str, ...]
    kind: str

    @classmethod
    def of(cls, path: str, sensor: str, everything: bool) -> _Bands:
        with opened(path) as dataset:
            every, natural = tuple(intensity_bands(dataset)), natural_bands(dataset, sensor)
            chosen = natural or every
            if everything and natural:
                chosen = (*natural, *(band for band in every if band not in natural))
            names = [band_name(dataset, band) for band in chosen]
            if natural:
                names[:3] = ["red", "green", "blue"]
            kinds = {gdal.GetDataTypeName(dataset.GetRasterBand(band).DataType) for band in chosen}
        known = [_KINDS.get(kind, "float32") for kind in kinds]
        return cls(chosen, every, natural is not None, tuple(names), max(known, key=_WIDER.index))


def colour_plan(
    scene: Scene, options: DsmFuseOptions, progress: Progress, parameters: PansharpeningParameters
) -> Optional[ColourPlan]:
    """Which colours orthophoto, clouds and mesh have; None for greys.

    Raises OptionError for XS that belong to no image, or images whose bands do not fit together; ImageError for XS of
    one band, an RpcError for XS without an RPC, OverlapError for XS that do not show what the images show.
    """
    views = nadir_first(scene)
    paired = _coloured(scene, views, options, progress, parameters)
    sources: List[ColourSource] = []
    found: List[_Bands] = []
    for view in views:
        xs = paired.get(view.name)
        bands = _Bands.of(xs.image if xs else view.image, (xs and xs.sensor) or view.sensor, options.colour == "all")
        if paired and xs is None:
            continue
        if xs is None and (len(bands.chosen) < 2 or (options.colour == "auto" and not bands.natural)):
            continue
        pair = Multispectral(view, xs, bands.every) if xs else None
        sources.append(ColourSource(view, bands.chosen, pair, options.pansharpen and xs is not None))
        found.append(bands)
    if not sources:
        return None
    without = [view.name for view in views if view.name not in {source.view.name for source in sources}]
    if without:
        progress.info(f"No colours from {listed(without)}, which have one band only and no multispectral image (XS).")
    for source, bands in zip(sources, found):
        if len(bands.chosen) != len(found[0].chosen):
            first, second, counts = sources[0].view.name, source.view.name, (len(found[0].chosen), len(bands.chosen))
            reason = f"finds {counts[0]} bands in '{first}' and {counts[1]} in '{second}'; choose another one"
            raise OptionError("COLOUR", options.colour, reason)
    natural = all(bands.natural for bands in found)
    if natural:
        order = ", ".join(f"{name} from band {band}" for name, band in zip(found[0].names, found[0].chosen))
        progress.info(f"Colours of {counted(len(sources), 'view')}: {order} (of '{sources[0].view.name}').")
    else:
        progress.info(
            "Neither file nor satellite says which bands are red, green and blue: all bands are used, in their order."
        )
    kind = max((bands.kind for bands in found), key=_WIDER.index)
    return ColourPlan(tuple(sources), found[0].names, natural, kind)


def water_sources(
    scene: Scene,
    options: DsmFuseOptions,
    plan: Optional[ColourPlan],
    progress: Progress,
    parameters: PansharpeningParameters,
) -> Tuple[ColourSource, ...]:
    """The views whose green and near infrared bands tell water from land, the most vertical one first; where colours
    are planned, from the same images. None with COLOUR=greys.

    Raises what :func:`colour_plan` raises for XS.
    """
    if options.colour == "greys":
        return ()
    views = nadir_first(scene)
    if plan is not None:
        pairs = [source.multispectral for source in plan.sources]
        paired = {pair.pan.name: pair.image for pair in pairs if pair is not None}
    else:
        paired = _coloured(scene, views, options, progress, parameters)
    sources: List[ColourSource] = []
    without: List[str] = []
    for view in views:
        xs = paired.get(view.name)
        image = xs or view
        with opened(image.image) as dataset:
            bands, several = water_bands(dataset, image.sensor or view.sensor), len(intensity_bands(dataset)) > 3
        if bands is not None:
            sources.append(ColourSource(view, bands, Multispectral(view, xs, bands) if xs else None))
        elif several:
            without.append(f"'{image.image}'")
    if without:
        progress.info(
            f"Nothing says which bands of {listed(without)} are green and near infrared. Name them in the file "
            "('green', 'near infrared'), so that water can be distinguished from land."
        )
    return tuple(sources)


def _coloured(
    scene: Scene,
    views: Sequence[View],
    options: DsmFuseOptions,
    progress: Progress,
    parameters: PansharpeningParameters,
) -> Dict[str, View]:
    """The multispectral image of each view, by the view's name, with a mask of its empty ends beside the scene."""
    found = _paired(scene, views, options.xs, parameters) or _beside(scene, views, progress, parameters)
    for name, image in found.items():
        kept = scene.path.parent / "xs_masks" / f"{image.name}_{fingerprint(raster_identity(image.image))[:12]}.tif"
        found[name] = replace(image, mask=str(kept)) if kept.exists() else without_empty_ends(image, kept, progress)
    return found


def _paired(
    scene: Scene, views: Sequence[View], files: Sequence[str], parameters: PansharpeningParameters
) -> Dict[str, View]:
    """The multispectral image of each view, by the view's name: that of the same time and line of sight."""
    found: Dict[str, View] = {}
    loaded: List[View] = []
    for path in files:
        image = _multispectral(path, loaded)
        loaded.append(image)
        view = _owner(scene, views, image, parameters)
        if view.name in found:
            before = found[view.name].image
            reason = f"has two images of one acquisition with '{view.name}', '{before}' and '{path}'; leave one out"
            raise OptionError("XS", list(files), reason)
        if image.plane is not None and view.plane is not None and not image.plane.source:
            # The vendor projected all bands of an acquisition at one height.
            image = replace(image, plane=replace(image.plane, height=view.plane.height, source=view.plane.source))
        found[view.name] = image
    return found


def _multispectral(path: str, others: Sequence[View]) -> View:
    image = load_view(path, others=others, whole=False)
    with opened(path) as dataset:
        if len(intensity_bands(dataset)) < 2:
            raise ImageError(f"'{path}' has one band only: give multispectral images as XS, or leave XS empty.")
    return image


def _owner(scene: Scene, views: Sequence[View], image: View, parameters: PansharpeningParameters) -> View:
    """The view that was taken together with a multispectral image."""
    altitude = sum(scene.altitudes) / 2
    outline = geometry_of(footprint(image.localise, image.size, altitude))
    near = [
        view
        for view in views
        if geometry_of(footprint(view.localise, view.size, altitude)).Intersection(outline).GetArea() > 0
    ]
    if not near:
        raise OverlapError(
            f"The multispectral image '{image.image}' does not overlap any image of the scene: give XS of the same "
            "place and acquisition, or leave it out."
        )
    centre = np.array([scene.frame.lon, scene.frame.lat])
    slope = ray_slope(image, centre, altitude)

    def turned(view: View) -> float:
        return float(np.linalg.norm(ray_slope(view, centre, altitude) - slope))

    def lapse(view: View) -> float:
        return 0.0 if view.time is None or image.time is None else abs((view.time - image.time).total_seconds())

    same = [
        view for view in near if turned(view) <= parameters.largest_turn and lapse(view) <= parameters.largest_lapse_s
    ]
    if not same:
        degrees = math.degrees(math.atan(min(map(turned, near))))
        raise OptionError(
            "XS",
            image.image,
            f"must be of the same acquisition as an image of the scene; the nearest one looks {degrees:.1f} degrees "
            "from another direction, or was taken at another time",
        )
    return min(same, key=turned)


def _beside(
    scene: Scene, views: Sequence[View], progress: Progress, parameters: PansharpeningParameters
) -> Dict[str, View]:
    """The multispectral images that lie beside panchromatic ones under their vendors' names; may be empty."""
    found: Dict[str, View] = {}
    for view in views:
        with opened(view.image) as dataset:
            if len(intensity_bands(dataset)) > 1:
                continue
        path = multispectral_beside(view.image)
        if not path:
            continue
        try:
            image = _multispectral(path, list(found.values()))
            if _owner(scene, [view], image, parameters) is view:
                found[view.name] = image
        except RepmError as error:
            progress.info(f"The multispectral image beside '{view.image}' is not used: {error}")
            continue
        progress.info(f"Colours of '{view.name}' from '{path}', which lies beside it; COLOUR=greys does without.")
    return found


def multispectral_beside(path: str) -> str:
    """The multispectral image that belongs to a panchromatic one by its name, in the same folder or in that of the
    product's other part; "" where there is none, or more than one."""
    name, folder = Path(path).name, Path(path).parent
    names = {name.replace(pan, xs) for pan, xs in _NAMES if pan in name}
    names |= {f"{Path(name).stem}{end}{Path(name).suffix}" for end in _ENDS}
    folders = {glob.escape(str(folder))}
    for pan, xs in _FOLDERS:
        if pan in folder.name:
            # Numbers at the end count the parts of the order.
            other = re.sub(r"\d{3}$", "*", folder.name.replace(pan, xs))
            folders.add(os.path.join(glob.escape(str(folder.parent)), other))
    patterns = {re.sub(r"-\d{3}(?=[_.])", "-*", glob.escape(each)) for each in names - {name}}
    found = sorted({file for place in folders for each in patterns for file in glob.glob(os.path.join(place, each))})
    return found[0] if len(found) == 1 else ""
