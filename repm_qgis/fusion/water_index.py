"""Which cells the index of water takes for water: the threshold is found in the scene itself.

The index is NDWI = (green - near infrared) / (green + near infrared) (McFeeters 1996, International Journal of Remote
Sensing 17), whose own threshold, zero, holds for reflectances alone: digital numbers of the bands have gains of their
own, and the air's light makes shadows look like water. So the histogram of what was matched, nearly all of it land, and
that of what was not, with all of the water in it, are given the same weight, as Donchyts et al. (2016, Remote Sensing
8:386) do with what lies along edges, and cut by Otsu's method (1979, IEEE Transactions on Systems, Man, and Cybernetics
9). The upper part is cut again and again: plants, bare ground and roofs, and shadows go one after the other. Water is
above the cut that parts the two histograms best, if there is one where the upper part is what hardly was matched, and
stands apart from the rest. Without water there is none.

A large dark patch of shade or tarmac without texture stands apart, too. But the light that the air scatters gives all
dark ground an index towards that of the air, and so other ground that is as dark, and was matched, has the same one.
Water goes beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Iterator, List, Optional, Protocol, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Floats, Mask, Window
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..imagery.sampling import median_of_known
from .parameters import FUSION, FusionParameters, WaterParameters


class WaterIndex(Protocol):
    """Views that show the index; ``calibrated``: zero is where both bands reflect alike."""

    @property
    def calibrated(self) -> bool: ...

    def seen(
        self, grid: CellGrid, height: FloatImage, asked: Window, parameters: FusionParameters
    ) -> Iterator[Tuple[FloatImage, FloatImage, FloatImage]]:
        """The index, the near infrared, and the sum of both bands that each view shows of the window ``asked`` of cells
        with these heights (m above the ellipsoid), NaN where it sees none; what stands on the others may hide them."""
        ...


@dataclass(frozen=True)
class Colours:
    """The index of water of cells, their near infrared, and the sum of both bands, (H, W) each, medians of the views;
    NaN where none sees them."""

    index: FloatImage
    infrared: FloatImage
    total: FloatImage

    def shaded(self, water: Mask, land: Mask, cell: float, parameters: WaterParameters = FUSION.water) -> Mask:
        """(H, W) the bodies of a mask of ``water`` whose index is that of other dark ground: what was matched, is as
        dark, and lies away from all bodies, on cells ``cell`` metres wide.

        Where no other ground is as dark nothing can be said, and a body stays.
        """
        p = parameters
        side = 2 * max(int(round(p.narrowest_m / cell)), 1) + 1
        near = cv2.dilate(water.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))) > 0
        known = np.isfinite(self.index)
        others = known & land & ~near
        tones, values = self.total[others], self.index[others]
        order = np.argsort(tones)
        tones, values = tones[order], values[order]
        _, numbers, facts, _ = cv2.connectedComponentsWithStats(water.astype(np.uint8), connectivity=4)
        found = np.zeros(water.shape, bool)
        for number, (left, top, width, tall, area) in enumerate(facts[1:], start=1):
            part = slice(top, top + tall), slice(left, left + width)
            inside = numbers[part] == number
            own = inside & known[part]
            if 2 * own.sum() < area:
                continue
            tone, index = float(np.median(self.total[part][own])), float(np.median(self.index[part][own]))
            first, last = np.searchsorted(tones, [tone * (1 - p.as_dark), tone * (1 + p.as_dark)])
            if last - first < p.least_m2 / cell**2 * p.least_alike:
                continue
            if index < np.percentile(values[first:last], p.beyond_percentile) + p.beyond:
                found[part] |= inside
        return found


def parts(grid: CellGrid, around: int, parameters: FusionParameters) -> Iterator[Tuple[Window, Window, Window]]:
    """Blocks of cells that cover a grid: the own ones of each, these with ``around`` more to each side, and these with
    what may hide them."""
    p = parameters.water
    for own, near in overlapping_blocks(grid.size, max(p.least_part, int(p.part_m / grid.cell)), around):
        yield own, near, near.grown(parameters.brightness.hidden_cells, grid.size)


def colours_of(
    spectra: WaterIndex,
    grid: CellGrid,
    height: FloatImage,
    check: Callable[[], None],
    parameters: FusionParameters = FUSION,
) -> Colours:
    """What the views show of cells with these heights (m above the ellipsoid).

    Raises ImageError where an image cannot be read.
    """
    found = np.full((3, *grid.shape), np.nan, np.float32)
    for own, _, wide in parts(grid, 0, parameters):
        check()
        seen = list(spectra.seen(grid.part(wide), height[wide.slices], own.within(wide), parameters))
        if seen:
            found[(slice(None), *own.slices)] = np.stack([median_of_known(np.stack(each)) for each in zip(*seen)])
    index, infrared, total = found
    return Colours(index=index, infrared=infrared, total=total)


def wet_above(
    index: FloatImage,
    infrared: FloatImage,
    land: Mask,
    empty: Mask,
    cell: float,
    calibrated: bool,
    parameters: WaterParameters = FUSION.water,
) -> Tuple[Mask, Optional[float]]:
    """(H, W) what is water by its index, and the threshold; nothing and None where nothing in the scene stands apart.

    ``land`` was matched and ``empty`` was not, on cells ``cell`` metres wide.
    """
    known, nothing = np.isfinite(index), np.zeros(index.shape, bool)
    if not (known & land).any():
        return nothing, None
    least = parameters.least_m2 / cell**2
    threshold = water_threshold(index[known & land], index[known & empty], least, calibrated, parameters)
    if threshold is None:
        return nothing, None
    bright = np.percentile(infrared[known & land], parameters.infrared_percentile)
    with np.errstate(invalid="ignore"):
        wet: Mask = (index > np.float32(threshold)) & (infrared < bright)
    return wet, threshold


def water_threshold(
    land: Floats, empty: Floats, least: float, calibrated: bool, parameters: WaterParameters = FUSION.water
) -> Optional[float]:
    """The index above which is water, from those (N,) of cells that were matched and (M,) that were not, of which at
    least so many must be water; None where none are."""
    p = parameters
    edges = np.linspace(-1.0, 1.0, p.index_bins + 1)
    middles = (edges[1:] + edges[:-1]) / 2
    if not land.size or empty.size < least:
        return None
    shares = [np.histogram(values, edges)[0] / values.size for values in (land, empty)]
    both, first = shares[0] + shares[1], 0
    found: List[Tuple[float, float]] = []
    for _ in range(p.most_cuts):
        cut = first + otsu(both[first:], middles[first:])
        matched, unmatched = (float(share[cut:].sum()) for share in shares)
        if cut == first or unmatched * empty.size < least:
            break
        apart = unmatched >= p.enriched * matched and _valley(shares[1], cut) <= p.valley
        if apart and (edges[cut] >= 0.0 or not calibrated):
            found.append((unmatched - matched, float(edges[cut])))  # a further cut may leave less land, and all water
        first = cut
    return max(found)[1] if found else None


def otsu(frequencies: FloatArray, values: FloatArray) -> int:
    """Where a histogram (N,) of ascending values falls into two parts of the greatest variance between them: the index
    of the upper part's first value (Otsu 1979)."""
    weights, sums = np.cumsum(frequencies)[:-1], np.cumsum(frequencies * values)[:-1]
    whole, total = frequencies.sum(), (frequencies * values).sum()
    below, above = weights, whole - weights
    with np.errstate(divide="ignore", invalid="ignore"):
        between = np.where((below > 0) & (above > 0), (whole * sums - weights * total) ** 2 / (below * above), 0.0)
    if not between.size or not between.max() > 0:
        return 0
    # Between two parts that are far apart all cuts are as good: the middle one.
    best = np.flatnonzero(between >= between.max() * (1 - 1e-9))
    return int(best[len(best) // 2]) + 1


def _valley(frequencies: FloatArray, cut: int) -> float:
    """How frequent what lies at a cut is, by what is most frequent above it; of means over five values."""
    smooth = np.convolve(frequencies, np.full(5, 0.2), "same")
    most = float(smooth[cut:].max())
    return float(smooth[cut] / most) if most > 0 else 1.0
