"""The altitude range of the ground, from the images themselves.

An RPC's own range may be kilometres wide, and windows, cameras and tiles grow with it. A plane sweep over a few
strongly reduced patches (Collins, A space-sweep approach to true multi-image matching, 1996) finds what is really
there to within some ten metres; numpy alone suffices.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from ..altitudes import ALTITUDES, AltitudeParameters
from ..arrays import FloatArray
from ..errors import OptionError
from ..geometry.footprints import ray_slope
from ..geometry.frames import geodetic_from_projected
from ..geometry.interpolation import upsample_grid
from ..geometry.tiles import pixel_window
from ..imagery.dem import dem_range
from ..imagery.enhancement import view_stretch
from ..imagery.raster import opened_masked, read
from ..imagery.sampling import box_mean, sample
from ..progress import Progress
from ..scene import View

_REDUCTION = 8  # image px a cell
_CELLS = 160  # cells a side of a patch
_PATCHES = 3  # patches a side of the area, at most
_WINDOW = 5  # radius of the correlation window, cells
_MIN_CORRELATION = 0.7
_MIN_CELLS = 60
_MAX_PLANES = 180


@dataclass(frozen=True)
class SweepResult:
    """The range found (margins included), and on how many cells of how many it rests."""

    altitudes: Tuple[float, float]
    matched: int
    cells: int
    step_m: float


def sweep_altitudes(
    views: Sequence[View],
    crs: str,
    bounds: Tuple[float, float, float, float],
    search: Tuple[float, float],
    progress: Progress,
    altitudes: AltitudeParameters = ALTITUDES,
) -> Optional[SweepResult]:
    """Find the altitude range of the ground within ``bounds`` (in ``crs``), inside ``search`` metres.

    None where the images do not say (no texture, too narrow a pair, no overlap).
    """
    first, second, base_to_height = _best_pair(views, bounds, crs, search)
    if base_to_height < 0.05:
        return None
    gsd = max(first.gsd_m, second.gsd_m)
    step = max(gsd * _REDUCTION / base_to_height, (search[1] - search[0]) / _MAX_PLANES)
    planes = np.arange(search[0], search[1] + step, step)
    found: List[FloatArray] = []
    cells = 0
    patches = _patches(bounds, gsd)
    shift = _pointing_shift(first, second, crs, patches, planes)
    for index, patch in enumerate(patches):
        progress.check_cancelled()
        progress.step(index / len(patches), "altitude range from the images")
        altitude, score = _sweep_patch(first, second, crs, patch, planes, shift)
        good = score > _MIN_CORRELATION
        cells += score.size
        found.append(altitude[good])
    heights = np.concatenate(found) if found else np.empty(0)
    if heights.size < max(_MIN_CELLS, 0.01 * cells):
        return None
    low, high = np.percentile(heights, (0.5, 99.5))
    low, high = altitudes.around_sweep(low, high, step)
    return SweepResult((max(search[0], low), min(search[1], high)), int(heights.size), cells, float(step))


def _best_pair(
    views: Sequence[View], bounds: Tuple[float, float, float, float], crs: str, search: Tuple[float, float]
) -> Tuple[View, View, float]:
    """The pair with the base-to-height ratio nearest to 0.3: wide enough to tell heights, narrow enough to match."""
    centre = geodetic_from_projected(crs, np.array([(bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2]))
    middle = (search[0] + search[1]) / 2
    slopes = [ray_slope(view, centre, middle) for view in views]
    ranked = []
    for i, j in combinations(range(len(views)), 2):
        ratio = float(np.linalg.norm(slopes[i] - slopes[j]))
        ranked.append((abs(np.log(max(ratio, 1e-6) / 0.3)), i, j, ratio))
    _, i, j, ratio = min(ranked)
    return views[i], views[j], ratio


def _patches(bounds: Tuple[float, float, float, float], gsd: float) -> List[Tuple[float, float, float, float]]:
    """Square patches spread over the area: all of it where it is small."""
    side = _CELLS * _REDUCTION * gsd
    axes = []
    for low, high in ((bounds[0], bounds[2]), (bounds[1], bounds[3])):
        # Patches take up to half as much again, rather than another one that overlaps them almost wholly.
        count = int(np.clip(np.round((high - low) / side), 1, _PATCHES))
        width = min(1.5 * side, (high - low) / count)
        axes.append([(s, s + width) for s in np.linspace(low, high - width, count)])
    return [(x0, y0, x1, y1) for y0, y1 in axes[1] for x0, x1 in axes[0]]


def _middle(patch: Tuple[float, float, float, float]) -> Tuple[float, float, float, float]:
    """The inner quarter of a patch."""
    xmin, ymin, xmax, ymax = patch
    return 0.75 * xmin + 0.25 * xmax, 0.75 * ymin + 0.25 * ymax, 0.25 * xmin + 0.75 * xmax, 0.25 * ymin + 0.75 * ymax


def _sweep_patch(
    first: View,
    second: View,
    crs: str,
    patch: Tuple[float, float, float, float],
    planes: FloatArray,
    shift: Tuple[int, int],
) -> Tuple[FloatArray, FloatArray]:
    """Best altitude and its correlation for each cell of a patch."""
    shape, lon_lat, images = _reduced_pair(first, second, crs, patch, planes)
    best_score, best_altitude = np.full(shape, -1.0), np.zeros(shape)
    if any(image is None for image in images):
        return best_altitude, best_score
    for altitude in planes:
        score = _correlation(*(_on_plane(image, lon_lat, altitude, shape) for image in images), shift)
        better = score > best_score
        best_score[better], best_altitude[better] = score[better], altitude
    # A best plane at either end of the search is no maximum.
    inner = (best_altitude > planes[0]) & (best_altitude < planes[-1])
    return best_altitude, np.where(inner, best_score, -1.0)


def _reduced_pair(
    first: View, second: View, crs: str, patch: Tuple[float, float, float, float], planes: FloatArray
) -> Tuple[Tuple[int, int], FloatArray, List[Optional["_Reduced"]]]:
    """A patch's shape in cells, the lattice of its longitudes and latitudes, and what both views show of it."""
    cell = max(first.gsd_m, second.gsd_m) * _REDUCTION
    shape = (max(8, int((patch[3] - patch[1]) / cell)), max(8, int((patch[2] - patch[0]) / cell)))
    u, v = np.linspace(patch[0], patch[2], 9), np.linspace(patch[3], patch[1], 9)
    lon_lat = geodetic_from_projected(crs, np.stack(np.meshgrid(u, v), axis=-1))
    return (
        shape,
        lon_lat,
        [_Reduced.of(view, crs, patch, (float(planes[0]), float(planes[-1]))) for view in (first, second)],
    )


@dataclass(frozen=True)
class _Reduced:
    """A window of a view, reduced, with its mean brightness taken out."""

    view: View
    pixels: NDArray[np.float32]
    window: Tuple[int, int, int, int]

    @classmethod
    def of(
        cls, view: View, crs: str, patch: Tuple[float, float, float, float], altitudes: Tuple[float, float]
    ) -> Optional["_Reduced"]:
        window = pixel_window(
            view.project,
            lambda xy: geodetic_from_projected(crs, xy),
            patch,
            altitudes,
            view.size,
            smallest=8 * _REDUCTION,
        )
        if window is None:
            return None
        with opened_masked(view.image, view.mask) as dataset:
            pixels = read(
                dataset, window, view.band, (max(1, window[2] // _REDUCTION), max(1, window[3] // _REDUCTION))
            )
        return cls(view, np.sqrt(np.maximum(pixels, 0)), window)


def _on_plane(image: _Reduced, lon_lat: FloatArray, altitude: float, shape: Tuple[int, int]) -> FloatArray:
    """The image as it lies on a plane of one altitude, on the patch's cells."""
    ground = np.concatenate([lon_lat, np.full(lon_lat.shape[:2] + (1,), altitude)], axis=-1)
    reduced = np.array(image.pixels.shape[::-1]) / image.window[2:]
    nodes = (image.view.project(ground) - image.window[:2] + 0.5) * reduced - 0.5
    return sample(image.pixels, *(upsample_grid(nodes[..., i].astype(np.float32), shape) for i in (0, 1)))


def _correlation(a: FloatArray, b: FloatArray, shift: Tuple[int, int]) -> FloatArray:
    """Normalised cross-correlation of windows around each cell; -1 where either has gaps or no contrast."""
    b = np.roll(b, shift, axis=(0, 1))
    known = np.isfinite(a) & np.isfinite(b)
    if not known.any():
        return np.full(a.shape, np.float32(-1))
    # About their means, so that the squares' sums do not lose what single precision has not.
    middle_a, middle_b = a[known].mean(), b[known].mean()
    a, b = np.where(known, a - middle_a, np.float32(0)), np.where(known, b - middle_b, np.float32(0))
    count, mean_a, mean_b, var_a, var_b, covariance = (
        box_mean(part, _WINDOW) for part in (known.astype(np.float32), a, b, a * a, b * b, a * b)
    )
    safe = np.maximum(count, np.float32(1e-6))
    mean_a, mean_b = mean_a / safe, mean_b / safe
    var_a, var_b = var_a / safe - mean_a**2, var_b / safe - mean_b**2
    covariance = covariance / safe - mean_a * mean_b
    # Contrast below a hundredth of the brightness's root is noise.
    flat = (var_a < 1e-4 * (mean_a + middle_a) ** 2) | (var_b < 1e-4 * (mean_b + middle_b) ** 2) | (count < 0.8)
    return np.where(flat, np.float32(-1), covariance / np.sqrt(np.maximum(var_a * var_b, np.float32(1e-12))))


def _pointing_shift(
    first: View, second: View, crs: str, patches: Sequence[Tuple[float, float, float, float]], planes: FloatArray
) -> Tuple[int, int]:
    """The whole-cell shift across the parallax that the pointing errors make.

    It is the same all over the images: the first patch that agrees well tells it, from the middle on, else the best
    of three.
    """
    found = []
    for index in dict.fromkeys((len(patches) // 2, 0, len(patches) - 1)):
        found.append(_cross_shift(first, second, crs, _middle(patches[index]), planes))
        if found[-1][0] > _MIN_CORRELATION:
            break
    return max(found)[2]


def _cross_shift(
    first: View, second: View, crs: str, patch: Tuple[float, float, float, float], planes: FloatArray
) -> Tuple[float, int, Tuple[int, int]]:
    """The whole-cell shift across the parallax that makes a patch agree best: pointing errors of tens of px.

    Gives how well it agrees, and the shift last.
    """
    shape, lon_lat, images = _reduced_pair(first, second, crs, patch, planes)
    if any(image is None for image in images):
        return -1.0, 0, (0, 0)
    lon, lat = lon_lat.reshape(-1, 2).mean(axis=0)
    slopes = [ray_slope(view, np.array([lon, lat]), float(planes.mean())) for view in (first, second)]
    parallax = slopes[1] - slopes[0]
    across = np.array([-parallax[1], parallax[0]]) / max(float(np.linalg.norm(parallax)), 1e-9)
    some = planes[:: max(1, len(planes) // 40)]
    stack = [tuple(_on_plane(image, lon_lat, z, shape) for image in images) for z in some]
    scored = []
    for step in (0, -1, 1, -2, 2, -3, 3):
        # Rows run south: a move north is a move up.
        shift = (int(round(-step * across[1])), int(round(step * across[0])))
        best = np.max([_correlation(a, b, shift) for a, b in stack], axis=0)
        scored.append((float(np.mean(best)), -abs(step), shift))
    return max(scored)


def altitude_range(
    views: Sequence[View],
    crs: str,
    bounds: Tuple[float, float, float, float],
    search: Tuple[float, float],
    given: Tuple[Optional[float], Optional[float]],
    dem: Optional[str],
    progress: Progress,
    altitudes: AltitudeParameters = ALTITUDES,
) -> Tuple[Tuple[float, float], str]:
    """The altitude range to work in, and where it comes from.

    Best first: what the user gives, a DEM, the images, the RPCs' own range (``search``). A given end replaces that
    end of whatever the others say.
    """
    if given[0] is not None and given[1] is not None:
        return (given[0], given[1]), "given"
    if dem:
        low, high, said = dem_range(dem, crs, bounds)
        if not said:
            progress.warn(
                f"The DEM '{dem}' does not say what its heights refer to: they are taken as metres above "
                "the WGS 84 ellipsoid."
            )
        found, source = altitudes.around_dem(low, high), "DEM"
    else:
        swept = sweep_altitudes(views, crs, bounds, search, progress, altitudes)
        if swept is None:
            for view in views:  # before the altitudes get the blame: does every image show something?
                view_stretch(view.image, view.band, view.mask)
            progress.warn(
                f"The images do not tell the altitude range: the RPCs' own is taken, {search[0]:.0f} to "
                f"{search[1]:.0f} m. A DEM, or ALTITUDE_MIN and ALTITUDE_MAX, would save time and errors."
            )
            found, source = search, "RPC"
        else:
            found, source = swept.altitudes, "images"
    low = found[0] if given[0] is None else given[0]
    high = found[1] if given[1] is None else given[1]
    if low >= high:
        raise OptionError(
            "ALTITUDE_MIN" if given[0] is not None else "ALTITUDE_MAX",
            low if given[0] is not None else high,
            f"leaves no range: the ground lies between {found[0]:.0f} and {found[1]:.0f} m",
        )
    return (float(low), float(high)), source
