"""The altitude range of the ground, from the images themselves.

An RPC's own range may be kilometres wide, and windows, cameras and tiles grow with it. A plane sweep over a few
strongly reduced patches (Collins, A space-sweep approach to true multi-image matching, 1996) finds the real range to
within some ten metres, with numpy alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import List, Optional, Sequence, Tuple

import numpy as np
from osgeo import ogr

from ..contracts.arrays import Altitudes, Bounds, FloatArray, FloatImage, Mask, Window
from ..contracts.errors import ImageError, OptionError
from ..contracts.findings import Finding
from ..contracts.records import ViewPair
from ..geometry.footprints import bounds_of, box, footprint, geometry_of, ray_slope
from ..geometry.frames import EnuFrame, geodetic_from_projected, mean_place, projected_from_geodetic
from ..geometry.interpolation import upsample_grid
from ..geometry.tiles import pixel_window
from ..imagery.correlation import window_statistics
from ..imagery.dem import dem_range
from ..imagery.raster import opened_masked, read
from ..imagery.sampling import box_mean, sample
from ..runtime.progress import Part, Progress
from ..runtime.spare_cores import spread
from ..scene import View
from ..stereo.pairing import reductions
from .altitudes import ALTITUDES, AltitudeParameters
from .overlap import common_ground
from .pair_selection import change_cost, pair_at, usual_change
from .parameters import PLANNING, PlanningParameters, SweepParameters

_ROOM = 1.5  # times the distance at which two images may just touch: their RPCs may be wrong, and ground high


@dataclass(frozen=True)
class SweepResult:
    """The range found, margins included; how many of all cells gave an altitude; the distance between planes; and the
    (N, 3) longitudes, latitudes and altitudes of these cells."""

    altitudes: Altitudes
    matched: int
    cells: int
    step_m: float
    points: FloatArray


def sweep_altitudes(
    views: Sequence[View],
    crs: str,
    bounds: Bounds,
    *,
    search: Altitudes,
    progress: Progress,
    parameters: SweepParameters = PLANNING.sweep,
    altitudes: AltitudeParameters = ALTITUDES,
) -> Optional[SweepResult]:
    """Find the altitude range of the ground within ``bounds`` (in ``crs``), inside ``search`` metres.

    None where the images do not show it: no texture, no overlap, or all pairs too narrow.
    """
    best: Optional[SweepResult] = None
    pairs = _pairs(views, bounds, crs, search, parameters)
    parts = _of_block(views, pairs, bounds, crs, search, parameters)
    if parts is not None:
        every = []
        for k, (part, (first, second, base_to_height)) in enumerate(parts):
            own = Part(progress, k / len(parts), (k + 1) / len(parts))
            every.append(_swept(first, second, base_to_height, crs, part, search, own, parameters, altitudes))
        return _joined([each for each in every if each is not None])
    for first, second, base_to_height in pairs[: parameters.pairs]:
        found = _swept(first, second, base_to_height, crs, bounds, search, progress, parameters, altitudes)
        if found is not None and (best is None or found.matched > best.matched):
            best = found
        if best is not None and best.matched >= parameters.enough_share * best.cells:
            break
    return best


Candidate = Tuple[View, View, float]  # with their base-to-height ratio


def _of_block(
    views: Sequence[View],
    pairs: Sequence[Candidate],
    bounds: Bounds,
    crs: str,
    search: Altitudes,
    parameters: SweepParameters,
) -> Optional[List[Tuple[Bounds, Candidate]]]:
    """Of a block of frames, parts of the area, each with the best pair that sees most of it; None where one of the best
    pairs sees enough of the area by itself."""
    if len(views) <= parameters.pairs:
        return None
    whole = box(bounds)
    shapes = [
        {
            view.name: geometry_of(projected_from_geodetic(crs, footprint(view.localise, view.size, altitude)))
            for view in views
        }
        for altitude in np.linspace(*search, parameters.block_levels)
    ]

    def seen(pair: Candidate, of: ogr.Geometry, level: int) -> Optional[ogr.Geometry]:
        common = shapes[level][pair[0].name].Intersection(shapes[level][pair[1].name])
        return None if common is None else common.Intersection(of)

    least = parameters.block_share * whole.GetArea()
    if any(
        _area(seen(pair, whole, level)) >= least for pair in pairs[: parameters.pairs] for level in range(len(shapes))
    ):
        return None
    found, middle = [], len(shapes) // 2
    for part in sweep_patches(bounds, max(view.gsd_m for view in views), parameters):
        grounds = [seen(pair, box(part), middle) for pair in pairs]
        most = max(map(_area, grounds), default=0.0)
        if most > 0:
            best = next(k for k, ground in enumerate(grounds) if _area(ground) >= parameters.most_seen * most)
            found.append((bounds_of(grounds[best]), pairs[best]))
    return found


def _area(ground: Optional[ogr.Geometry]) -> float:
    return 0.0 if ground is None else float(ground.GetArea())


def _joined(found: Sequence[SweepResult]) -> Optional[SweepResult]:
    """What several parts of an area show together; None of none."""
    if not found:
        return None
    ends = min(each.altitudes[0] for each in found), max(each.altitudes[1] for each in found)
    return SweepResult(
        altitudes=ends,
        matched=sum(each.matched for each in found),
        cells=sum(each.cells for each in found),
        step_m=max(each.step_m for each in found),
        points=np.concatenate([each.points for each in found]),
    )


def _swept(
    first: View,
    second: View,
    base_to_height: float,
    crs: str,
    bounds: Bounds,
    search: Altitudes,
    progress: Progress,
    parameters: SweepParameters,
    altitudes: AltitudeParameters,
) -> Optional[SweepResult]:
    """What one pair of views shows."""
    gsd = max(first.gsd_m, second.gsd_m)
    step = max(gsd * parameters.reduction / base_to_height, (search[1] - search[0]) / parameters.most_planes)
    sweep = _Sweep(first, second, crs, np.arange(search[0], search[1] + step, step), parameters)
    found: List[FloatArray] = []
    cells = 0
    patches = sweep_patches(bounds, gsd, parameters)
    shift = _pointing_shift(sweep, patches)

    def begin(ended: int, patch: Bounds) -> None:
        progress.check_cancelled()
        progress.step(ended / len(patches), "altitude range from the images")

    swept = spread(lambda patch: _sweep_patch(sweep, patch, shift), patches, begin)
    for patch, (altitude, score) in zip(patches, swept):
        good = _in_large_parts(np.where(score > parameters.least_correlation, altitude, np.nan), step, parameters)
        cells += score.size
        places = upsample_grid(_lattice(crs, patch), (altitude.shape[0], altitude.shape[1]))[good]
        found.append(np.column_stack([places, altitude[good]]))
    points = np.concatenate(found) if found else np.empty((0, 3))
    heights = points[:, 2]
    if heights.size < max(parameters.least_cells, parameters.least_share * cells):
        return None
    low, high = np.percentile(heights, (parameters.tail_percent, 100.0 - parameters.tail_percent))
    low, high = altitudes.around_sweep(low, high, step)
    return SweepResult((max(search[0], low), min(search[1], high)), int(heights.size), cells, float(step), points)


def _in_large_parts(altitude: FloatArray, step: float, parameters: SweepParameters) -> Mask:
    """Which cells belong to a connected part of at least a correlation window's size: a wrong match is one feature
    in its window, so its cells are no more than that. Neighbours belong together where they differ by few planes.

    Unknown cells are NaN. The labels spread to neighbours, and jump to the labels of their labels until none changes.
    """
    label = np.arange(altitude.size).reshape(altitude.shape)
    with np.errstate(invalid="ignore"):
        across, down = (np.abs(np.diff(altitude, axis=axis)) <= parameters.joined_planes * step for axis in (1, 0))
    before = np.full_like(label, -1)
    while (label != before).any():
        before = label.copy()
        for one, other, joined in (
            (label[:, :-1], label[:, 1:], across),
            (label[:-1], label[1:], down),
        ):
            least = np.where(joined, np.minimum(one, other), altitude.size)
            np.minimum(one, least, out=one)
            np.minimum(other, least, out=other)
        label = label.ravel()[label]
    known = np.isfinite(altitude)
    count = np.bincount(label[known], minlength=altitude.size)
    large: Mask = known & (count[label] >= (2 * parameters.window_radius + 1) ** 2)
    return large


@dataclass(frozen=True)
class _Sweep:
    """Two views, the altitudes of the planes, and the CRS of the patches."""

    first: View
    second: View
    crs: str
    planes: FloatArray
    parameters: SweepParameters


def _pairs(
    views: Sequence[View], bounds: Bounds, crs: str, search: Altitudes, parameters: SweepParameters
) -> List[Tuple[View, View, float]]:
    """Pairs that are wide enough, with their base-to-height ratios, the best first: those that differ least in time
    and sun, and whose ratio is near the best one.

    Dates count as where pairs to match are chosen: images of two seasons hardly correlate.
    """
    lon, lat = geodetic_from_projected(crs, np.array([(bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2]))
    place = float(lon), float(lat), (search[0] + search[1]) / 2
    pairs = [pair_at(first, second, _seen_by(first, second, place), 0, 0.0) for first, second in _near(views, search)]
    pairs = [pair for pair in pairs if pair.base_to_height >= parameters.least_base_to_height]
    unknown, named = usual_change(pairs), {view.name: view for view in views}

    def cost(pair: ViewPair) -> float:
        changed = change_cost(pair)
        ratio = pair.base_to_height / parameters.best_base_to_height
        return abs(math.log(ratio)) + (unknown if changed is None else changed)

    return [(named[pair.first], named[pair.second], pair.base_to_height) for pair in sorted(pairs, key=cost)]


def _near(views: Sequence[View], search: Altitudes) -> List[Tuple[View, View]]:
    """The pairs of views whose images may overlap: their middles are no farther apart than their diagonals."""
    altitude, room = sum(search) / 2, search[1] - search[0]  # by which a wrong height may move oblique views
    middles = [view.localise((np.array(view.size) - 1) / 2, altitude) for view in views]
    lon, lat = map(float, mean_place(np.array(middles)[:, :2]))
    frame = EnuFrame(lon, lat, altitude)
    places = [frame.from_geodetic(middle)[:2] for middle in middles]
    reach = [math.hypot(*view.size) * view.gsd_m / 2 for view in views]
    return [
        (views[i], views[j])
        for i, j in combinations(range(len(views)), 2)
        if not np.hypot(*(places[i] - places[j])) > _ROOM * (reach[i] + reach[j]) + room
    ]


def _seen_by(first: View, second: View, place: Tuple[float, float, float]) -> Tuple[float, float, float]:
    """A place, or that between the middles of two frames that do not both show it: an RPC is only valid around its
    image."""
    pixels = [view.project(np.array(place)) for view in (first, second)]
    if all((pixel > 0).all() and (pixel < view.size).all() for pixel, view in zip(pixels, (first, second))):
        return place
    middles = [view.localise((np.array(view.size) - 1) / 2, place[2])[:2] for view in (first, second)]
    lon, lat = np.mean(middles, axis=0)
    return float(lon), float(lat), place[2]


def sweep_patches(bounds: Bounds, gsd: float, parameters: SweepParameters) -> List[Bounds]:
    """Square patches spread over the area: all of it where it is small."""
    side = parameters.cells * parameters.reduction * gsd
    axes = []
    for low, high in ((bounds[0], bounds[2]), (bounds[1], bounds[3])):
        # Patches may be larger than usual, rather than overlap almost wholly.
        count = int(np.clip(np.round((high - low) / side), 1, parameters.patches))
        width = min(parameters.most_stretch * side, (high - low) / count)
        axes.append([(float(s), float(s + width)) for s in np.linspace(low, high - width, count)])
    return [Bounds(x0, y0, x1, y1) for y0, y1 in axes[1] for x0, x1 in axes[0]]


def _middle(patch: Bounds) -> Bounds:
    """The inner quarter of a patch."""
    low, high = np.array(patch[:2]), np.array(patch[2:])
    return Bounds.between(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high)


def _sweep_patch(sweep: _Sweep, patch: Bounds, shift: Tuple[int, int]) -> Tuple[FloatArray, FloatArray]:
    """Best altitude and its correlation for each cell of a patch."""
    shape, lon_lat, images = _reduced_pair(sweep, patch)
    best_score, best_altitude = np.full(shape, -1.0), np.zeros(shape)
    if images is None:
        return best_altitude, best_score
    for altitude in sweep.planes:
        first, second = (_on_plane(image, lon_lat, altitude, shape) for image in images)
        score = _correlation(first, second, shift, sweep.parameters)
        better = score > best_score
        best_score[better], best_altitude[better] = score[better], altitude
    # A best plane at either end of the search is no maximum.
    inner = (best_altitude > sweep.planes[0]) & (best_altitude < sweep.planes[-1])
    return best_altitude, np.where(inner, best_score, -1.0)


def _reduced_pair(sweep: _Sweep, patch: Bounds) -> Tuple[Tuple[int, int], FloatArray, Optional[List[_Reduced]]]:
    """A patch's shape in cells, the lattice of its longitudes and latitudes, and its images (None: not both see it)."""
    cell = max(sweep.first.gsd_m, sweep.second.gsd_m) * sweep.parameters.reduction
    shape = (max(8, int((patch[3] - patch[1]) / cell)), max(8, int((patch[2] - patch[0]) / cell)))
    lon_lat = _lattice(sweep.crs, patch)
    images = [_Reduced.of(view, sweep, patch) for view in (sweep.first, sweep.second)]
    known = [image for image in images if image is not None]
    return shape, lon_lat, known if len(known) == 2 else None


def _lattice(crs: str, patch: Bounds) -> FloatArray:
    """(9, 9, 2) longitudes and latitudes over a patch, from its first cell's to its last one's, rows running south."""
    u, v = np.linspace(patch[0], patch[2], 9), np.linspace(patch[3], patch[1], 9)
    return geodetic_from_projected(crs, np.stack(np.meshgrid(u, v), axis=-1))


@dataclass(frozen=True)
class _Reduced:
    """A window of a view, reduced, as square roots of its intensity."""

    view: View
    pixels: FloatImage
    window: Window

    @classmethod
    def of(cls, view: View, sweep: _Sweep, patch: Bounds) -> Optional["_Reduced"]:
        altitudes = float(sweep.planes[0]), float(sweep.planes[-1])
        ratio = reductions(sweep.first, sweep.second)[0 if view is sweep.first else 1]
        reduction = sweep.parameters.reduction * max(1, round(ratio))

        def to_geodetic(xy: FloatArray) -> FloatArray:
            return geodetic_from_projected(sweep.crs, xy)

        window = pixel_window(
            view.project, to_geodetic, patch, altitudes=altitudes, size=view.size, smallest=8 * reduction
        )
        if window is None:
            return None
        size = max(1, window[2] // reduction), max(1, window[3] // reduction)
        with opened_masked(view.image, view.mask, overviews=False) as dataset:
            pixels = read(dataset, window, view.band, size)
        return cls(view, np.sqrt(np.maximum(pixels, 0)), Window(*window))


def _on_plane(image: _Reduced, lon_lat: FloatArray, altitude: float, shape: Tuple[int, int]) -> FloatImage:
    """The image as it lies on a plane of one altitude, on the patch's cells."""
    ground = np.concatenate([lon_lat, np.full(lon_lat.shape[:2] + (1,), altitude)], axis=-1)
    reduced = np.array(image.pixels.shape[::-1]) / image.window[2:]
    nodes = (image.view.project(ground) - image.window[:2] + 0.5) * reduced - 0.5
    columns, rows = (upsample_grid(nodes[..., i].astype(np.float32), shape) for i in (0, 1))
    return sample(image.pixels, columns, rows)


def _correlation(a: FloatImage, b: FloatImage, shift: Tuple[int, int], parameters: SweepParameters) -> FloatImage:
    """Normalised cross-correlation of windows around each cell; -1 where either has gaps or no contrast."""
    b = np.roll(b, shift, axis=(0, 1))
    known = np.isfinite(a) & np.isfinite(b)
    if not known.any():
        return np.full(a.shape, np.float32(-1))
    # The means are subtracted first, because sums of squares would exceed single precision.
    middle_a, middle_b = a[known].mean(), b[known].mean()
    found = window_statistics(a - middle_a, b - middle_b, known, lambda part: box_mean(part, parameters.window_radius))
    noise = parameters.least_contrast
    poor = found.share < parameters.least_known
    poor |= found.variance_a < noise * (found.mean_a + middle_a) ** 2
    poor |= found.variance_b < noise * (found.mean_b + middle_b) ** 2
    return np.where(poor, np.float32(-1), found.correlation())


def _pointing_shift(sweep: _Sweep, patches: Sequence[Bounds]) -> Tuple[int, int]:
    """The shift, in whole cells across the parallax, that the errors of the two RPCs make.

    It is the same all over the images: that of the first patch with a good correlation, the middle one first, else
    the best of three.
    """
    found = []
    for index in dict.fromkeys((len(patches) // 2, 0, len(patches) - 1)):
        found.append(_cross_shift(sweep, _middle(patches[index])))
        if found[-1][0] > sweep.parameters.least_correlation:
            break
    return max(found)[2]


def _cross_shift(sweep: _Sweep, patch: Bounds) -> Tuple[float, int, Tuple[int, int]]:
    """The correlation of a patch, minus the number of cells, and the shift (rows, columns), where it is best."""
    shape, lon_lat, images = _reduced_pair(sweep, patch)
    if images is None:
        return -1.0, 0, (0, 0)
    centre = mean_place(lon_lat.reshape(-1, 2))
    slopes = [ray_slope(view, centre, float(sweep.planes.mean())) for view in (sweep.first, sweep.second)]
    parallax = slopes[1] - slopes[0]
    across = np.array([-parallax[1], parallax[0]]) / max(float(np.linalg.norm(parallax)), 1e-9)
    some = sweep.planes[:: max(1, len(sweep.planes) // sweep.parameters.shift_planes)]
    stack = [[_on_plane(image, lon_lat, z, shape) for image in images] for z in some]

    def scored(step: int) -> Tuple[float, int, Tuple[int, int]]:
        # Rows run south: a move north is a move up.
        shift = (int(round(-step * across[1])), int(round(step * across[0])))
        best = np.max([_correlation(a, b, shift, sweep.parameters) for a, b in stack], axis=0)
        return float(np.mean(best)), -abs(step), shift

    return max(spread(scored, range(-sweep.parameters.most_shift, sweep.parameters.most_shift + 1)))


def ground_altitude(
    views: Sequence[View],
    crs: str,
    *,
    search: Altitudes,
    progress: Progress,
    parameters: PlanningParameters = PLANNING,
) -> Tuple[float, bool]:
    """The median altitude of the ground that two views see, m above the ellipsoid, and whether the images show it: the
    sweep of :func:`altitude_range`. Where they show none, or cannot be read, the middle of ``search``.
    """
    area = common_ground(views, crs, search, parameters)
    if not area.IsEmpty():
        bounds = Bounds(*bounds_of(area))
        try:
            swept = sweep_altitudes(views, crs, bounds, search=search, progress=progress, parameters=parameters.sweep)
        except ImageError:
            swept = None
        if swept is not None:
            return float(np.median(swept.points[:, 2])), True
    return sum(search) / 2, False


def altitude_range(
    views: Sequence[View],
    crs: str,
    bounds: Bounds,
    *,
    search: Altitudes,
    given: Tuple[Optional[float], Optional[float]],
    dem: Optional[str],
    progress: Progress,
    parameters: SweepParameters = PLANNING.sweep,
    altitudes: AltitudeParameters = ALTITUDES,
) -> Tuple[Altitudes, str]:
    """The altitude range to work in, and where it comes from: one word, or one for each end.

    The first of these that is there: the user's, that of a DEM, of the images, of the RPCs (``search``). Where the
    user gives one end only, it replaces that end. Raises OptionError where nothing is left between the ends.
    """
    if given[0] is not None and given[1] is not None:
        return (given[0], given[1]), "given"
    if dem:
        low, high, known = dem_range(dem, crs, bounds)
        if not known:
            unknown = f"The DEM '{dem}' does not state its vertical datum"
            progress.warn(
                Finding(
                    "dem-datum-unknown", f"{unknown}: its heights are assumed to be metres above the WGS 84 ellipsoid."
                )
            )
        found, source = altitudes.around_dem(low, high), "DEM"
    else:
        swept = sweep_altitudes(
            views, crs, bounds, search=search, progress=progress, parameters=parameters, altitudes=altitudes
        )
        if swept is None:
            for view in views:  # an image that shows nothing is an error of its own
                view.stretch()
            low, high = search
            text = (
                "The altitude range could not be found from the images: that of the RPCs is used, "
                f"{low:.0f} to {high:.0f} m. With a DEM, or ALTITUDE_MIN and ALTITUDE_MAX, the run is faster and more "
                "reliable."
            )
            if len(views) == 1:
                text = (
                    f"One image does not show how high its ground is: the altitudes of its RPC are used, {low:.0f} to "
                    f"{high:.0f} m. With a DEM, or ALTITUDE_MIN and ALTITUDE_MAX, the errors are those at the ground's "
                    "altitudes."
                )
            progress.warn(Finding("altitudes-of-rpcs", text))
            found, source = search, "RPC"
        else:
            found, source = swept.altitudes, "images"
    low, high = (end if own is None else own for end, own in zip(found, given))
    # The images' range ends where the search did, unless it found an end of its own.
    from_rpc = [source == "images" and end == most for end, most in zip(found, search)]
    sources = ["given" if own is not None else "RPC" if rpc else source for own, rpc in zip(given, from_rpc)]
    if low >= high:
        option, value = ("ALTITUDE_MIN", low) if given[0] is not None else ("ALTITUDE_MAX", high)
        ends = f"{found[0]:.0f} and {found[1]:.0f} m"
        raise OptionError(option, value, f"leaves no altitude range: the ground lies between {ends}")
    return (float(low), float(high)), sources[0] if sources[0] == sources[1] else f"{sources[0]} and {sources[1]}"
