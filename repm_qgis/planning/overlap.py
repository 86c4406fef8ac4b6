"""Which images show the same ground: the largest group of those that overlap is worked on, in all stages.

Images of another place would spoil what all have in common: the heights that are searched, the CRS and the area.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections import Counter
from typing import Callable, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import ogr

from ..contracts.arrays import Altitudes, FloatArray, Window
from ..contracts.errors import OverlapError, RpcInvalidError
from ..contracts.findings import Finding
from ..contracts.options import EpmFitOptions
from ..geometry.footprints import Polygon, footprint, geometry_of, ring, seen_twice
from ..geometry.frames import projected_from_geodetic
from ..imagery.deliveries import with_images
from ..imagery.raster import opened, read
from ..runtime.progress import Silent, listed
from ..scene import View, common_heights, load_views
from .parameters import PLANNING, PlanningParameters

Warn = Callable[[Finding], None]
"""It is given a sentence that the user should read."""

_DEGREE_M = 111_320.0  # of latitude: overlaps are compared with a least area, and need no projection
_FAR_DEG = 5.0  # between the middles of two images, which cannot overlap then: no strip is that long
_MOST_LEVELS = 64
_LARGER = 1.5  # times an image's side: an RPC that was made for more columns or rows is that of a larger image
_ROUNDED_PX = 1.0  # between two RPCs of one image, of which one may have been rounded
_MIDDLE = 16  # rows of an image's middle
_STRIP = 256  # rows that are compared at once
_STARTS = 0.05  # of its length: an RPC whose domain begins that near to the first pixel was not shifted with a crop


def places(views: Sequence[View], least_px: float) -> List[Tuple[View, ...]]:
    """The views in groups that overlap, directly or through others, in the views' order; those with most views first.

    Two views overlap where they share a square of ``least_px`` pixels at some height that both RPCs were made for.
    """
    groups: List[List[View]] = []
    for view in views:
        joined = [group for group in groups if any(_overlap(view, other, least_px) for other in group)]
        apart = [group for group in groups if group not in joined]
        groups = [*apart, [*(each for group in joined for each in group), view]]
    order = {id(view): number for number, view in enumerate(views)}
    found = [tuple(sorted(group, key=lambda view: order[id(view)])) for group in groups]
    return sorted(found, key=lambda group: (-len(group), order[id(group[0])]))


def views_of(options: EpmFitOptions, least_px: float, warn: Warn = lambda text: None) -> Tuple[View, ...]:
    """The views of a run: those of its images that show one place (:func:`of_one_place`), which EXTENT may choose.

    Raises whatever :func:`~repm_qgis.scene.load_views` raises, RpcInvalidError where two images have the same RPC, and
    OverlapError where no two of several images overlap.
    """
    options = with_images(options, Silent())
    views = load_views(options.images, options.rpcs, options.masks, options.extent is None, options.ortho_ready_height)
    return of_one_place(_each_once(views, warn), least_px, warn, _wanted(options))


def common_ground(
    views: Sequence[View], crs: str, altitudes: Altitudes, parameters: PlanningParameters = PLANNING
) -> ogr.Geometry:
    """The ground in ``crs`` that two views, or the only one, see at some altitude of a range, m above the ellipsoid;
    empty for none."""
    levels = np.linspace(*altitudes, parameters.area_altitudes)
    seen = [[projected_from_geodetic(crs, footprint(v.localise, v.size, z)) for v in views] for z in levels]
    return seen_twice([outlines * 2 for outlines in seen] if len(views) == 1 else seen)


class Doublet(NamedTuple):
    """A view that is no image of its own, and the sentence that says so; ``wrong``: nobody can say which of the two
    RPCs or pixels is right."""

    view: View
    text: str
    wrong: bool


def _each_once(views: Sequence[View], warn: Warn) -> List[View]:
    """The views without copies of others (:func:`without_doublets`); ``warn`` gets a sentence about each.

    Raises RpcInvalidError where a doublet is wrong, and OverlapError where all are copies of one.
    """
    kept, doublets = without_doublets(views)
    for each in doublets:
        if each.wrong:
            raise RpcInvalidError(each.text)
        warn(Finding("image-copied", each.text))
    if len(kept) == 1 < len(views):
        raise OverlapError(f"All images are copies of '{kept[0].image}': choose another image of the same ground.")
    return kept


def without_doublets(views: Sequence[View]) -> Tuple[List[View], List[Doublet]]:
    """The views that are images of their own, and the others: copies, which would count as independent evidence, other
    pixels with the same RPC, and the same pixels with another RPC. A copy's RPC may have been rounded.

    Raises ImageError where pixels cannot be read.
    """
    kept: List[View] = []
    doublets: List[Doublet] = []
    sizes = Counter(view.size for view in views)
    middles = {id(view): _middle(view) for view in views if sizes[view.size] > 1}

    def same_pixels(first: View, second: View) -> bool:
        if first.size != second.size or middles[id(first)] != middles[id(second)]:
            return False
        return _apart_px(first, second) < max(first.size) and _same_pixels(first, second)  # else it is of another place

    for view in views:
        same = next((other for other in kept if same_pixels(other, view)), None)
        alike = next((other for other in kept if other.model == view.model), None)
        if same is None and alike is not None:
            text = (
                f"The images {alike.name} and {view.name} have the same RPC: give each image its own RPC (the file "
                "beside it, or RPCS), and give the parts of one image as one image."
            )
            doublets.append(Doublet(view, text, wrong=True))
        elif same is None:
            kept.append(view)
        elif _apart_px(same, view) > _ROUNDED_PX:
            text = (
                f"The images {same.name} and {view.name} have the same pixels, but RPCs that place them "
                f"{_apart_px(same, view):.1f} px apart: give the image once, with its own RPC."
            )
            doublets.append(Doublet(view, text, wrong=True))
        else:
            text = f"The image {view.name} ('{view.image}') is a copy of {same.name}: only {same.name} is used."
            doublets.append(Doublet(view, text, wrong=False))
    return kept, doublets


def _middle(view: View) -> bytes:
    """A digest of an image's middle rows, which distinguishes it from most others."""
    with opened(view.image) as dataset:
        row = max((view.height - _MIDDLE) // 2, 0)
        pixels = read(dataset, Window(0, row, view.width, min(_MIDDLE, view.height)), view.band)
    return hashlib.sha256(pixels.tobytes()).digest()


def _same_pixels(first: View, second: View) -> bool:
    """Whether two views of one size are of one image, whatever its files are called."""
    if os.path.exists(first.image) and os.path.exists(second.image) and os.path.samefile(first.image, second.image):
        return True
    with opened(first.image) as one, opened(second.image) as other:
        for row in range(0, first.size[1], _STRIP):
            window = Window(0, row, first.size[0], min(_STRIP, first.size[1] - row))
            if not np.array_equal(read(one, window, first.band), read(other, window, second.band), equal_nan=True):
                return False
    return True


def _apart_px(first: View, second: View) -> float:
    """How far apart two views of the same size place what they show, px at most."""
    columns, rows = np.meshgrid(*(np.linspace(0, side - 1, 3) for side in first.size))
    pixels, low, high = np.stack([columns.ravel(), rows.ravel()], axis=1), *first.rpc.height_range
    ground = [first.localise(pixels, height) for height in (low, high)]
    return max(float(np.abs(second.project(each) - pixels).max()) for each in ground)


def of_one_place(
    views: Sequence[View], least_px: float, warn: Warn = lambda text: None, wanted: Optional[Polygon] = None
) -> Tuple[View, ...]:
    """The views of the place that most of them show; ``warn`` is given a sentence about the others.

    ``wanted`` (N, 2), longitudes and latitudes, is an area that may choose the place. Raises OverlapError, with where
    the images look, where no two of several overlap.
    """
    if len(views) == 1:
        return tuple(views)
    groups = places(views, least_px)
    if wanted is not None:
        groups.sort(key=lambda group: len(group) < 2 or not any(_shows(view, wanted) for view in group))
    first, *others = groups
    left = [view for group in others for view in group]
    if len(first) < 2:
        raise OverlapError(not_overlapping(views))
    if left:
        remedy = foreign_rpc(left) or "If one of them belongs to this place, check that its RPC is its own."
        text = f"Images of another place are left out: {_looking(left)}; used are {_looking(first)}. {remedy}"
        warn(Finding("images-elsewhere", text))
    return first


def not_overlapping(views: Sequence[View]) -> str:
    """The sentence that these images share no ground, with where each of them looks."""
    doubt = foreign_rpc(views) or "Check that each RPC belongs to its image."
    return f"The images do not overlap on the ground: {_looking(views)}. Choose images of one place. {doubt}"


def foreign_rpc(views: Sequence[View]) -> str:
    """The suspicion that RPCs are those of larger images, which were not shifted when the images were cut out of them;
    "" where there is no sign of it.

    The sign: an RPC that was made for an image that begins where this one does and is much larger.
    """
    found = []
    for view in (view for view in views if view.plane is None):
        rpc, size = view.rpc, np.array(view.size)
        middle, reach = np.array([rpc.col_off, rpc.row_off]), np.abs([rpc.col_scale, rpc.row_scale])
        made = np.rint(middle + reach + 1)
        if (np.abs(middle - reach) < _STARTS * 2 * reach).all() and (made > _LARGER * size).any():
            found.append(
                f"{view.name} has {view.width} x {view.height} px, its RPC was made for {made[0]:.0f} x {made[1]:.0f}"
            )
    if not found:
        return ""
    return (
        f"The RPC may be that of a larger image ({listed(found, '; ')}): a crop needs one that was shifted with it, as "
        "gdal_translate -srcwin does with RPC tags."
    )


def _looking(views: Sequence[View]) -> str:
    """Where images look: their middles, at the middle of their RPCs' heights."""
    texts = []
    for view in views:
        lon, lat, _ = view.localise((np.array(view.size) - 1) / 2, view.rpc.height_off)
        texts.append(f"{view.name} around longitude {lon:.4f}, latitude {lat:.4f}")
    return listed(texts, "; ")


def _wanted(options: EpmFitOptions) -> Optional[Polygon]:
    """EXTENT as longitudes and latitudes; None without one, or where PROJ cannot bring it there."""
    if options.extent is None:
        return None
    xmin, ymin, xmax, ymax = options.extent
    x, y = ring(np.linspace(xmin, xmax, 5), np.linspace(ymin, ymax, 5)).T
    try:
        found = np.column_stack(pyproj.Transformer.from_crs(options.extent_crs, 4326, always_xy=True).transform(x, y))
    except pyproj.exceptions.ProjError:
        return None
    return found if np.isfinite(found).all() else None


def _shows(view: View, wanted: Polygon) -> bool:
    """Whether a view shows ground of an area, at the middle of its RPC's heights."""
    outline = _outline(view, view.rpc.height_off)
    if len(outline) < 3:
        return False
    shown, area = (geometry_of(_metres(_apart(each, outline[0]), outline[0])) for each in (outline, wanted))
    return bool(shown.Intersects(area))


def _overlap(first: View, second: View, least_px: float) -> bool:
    """Whether two views share ground at some height."""
    low, high = common_heights((first, second))
    side = min(min(view.size) * view.gsd_m for view in (first, second))
    ends = [_between(first, second, height) for height in (low, high)]
    if np.abs(ends[0]).max() > _FAR_DEG * _DEGREE_M:
        return False
    # Between two levels, the footprints may move against each other by no more than half of the smaller one.
    steps = 2 * float(np.linalg.norm(ends[1] - ends[0])) / side
    count = int(np.clip(math.ceil(steps) + 1, 2, _MOST_LEVELS)) if math.isfinite(steps) else _MOST_LEVELS
    least = (least_px * min(first.gsd_m, second.gsd_m)) ** 2
    for height in np.linspace(low, high, count):
        outlines = [_outline(view, height) for view in (first, second)]
        if min(map(len, outlines)) < 3:
            continue
        origin = outlines[0][0]
        shapes = [geometry_of(_metres(_apart(outline, origin), origin)) for outline in outlines]
        common = shapes[0].Intersection(shapes[1])
        if common is not None and common.GetArea() >= least:
            return True
    return False


def _between(first: View, second: View, height: float) -> FloatArray:
    """(2,) metres east and north from the middle of one view to that of another; NaN where an RPC has no answer."""
    here, there = (view.localise((np.array(view.size) - 1) / 2, height)[:2] for view in (first, second))
    return _metres(_apart(there, here), here)


def _outline(view: View, height: float) -> Polygon:
    return footprint(view.localise, view.size, height)


def _apart(points: FloatArray, origin: FloatArray) -> FloatArray:
    """(..., 2) degrees of longitude and latitude from one place, on its side of the date line."""
    away: FloatArray = np.asarray(points) - origin
    return np.stack([(away[..., 0] + 180.0) % 360.0 - 180.0, away[..., 1]], axis=-1)


def _metres(degrees: FloatArray, place: FloatArray) -> FloatArray:
    """(..., 2) metres east and north for degrees around a place."""
    found: FloatArray = degrees * _DEGREE_M * np.array([math.cos(math.radians(float(place[1]))), 1.0])
    return found
