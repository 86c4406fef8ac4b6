"""Water of a surface: where it is, and how high, from what matching left empty, the images, and the shore.

Over water a matcher finds nothing that holds (matching/reliability.py), so water is empty. But so are clouds, haze and
changed ground. Where multispectral images show a cell, their index of water says which of these it is
(fusion/water_index.py), and also where something was matched on water. Elsewhere, water is darker than nearly all of
the land, and no rougher than the images' noise. Shadows of houses are both, too, but narrow or small. The shore says
how high the water is, if enough of it is known: a cloud may hide its lowest part. Where that falls along the water by
more than it scatters, it is a river, which nowhere rises along its flow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Iterator, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from ..contracts.arrays import ByteImage, FloatArray, FloatImage, IntArray, Mask, Window
from ..geometry.cell_grid import CellGrid
from ..imagery.confidence import Provenance
from ..imagery.sampling import median_of_known
from ..matching.reliability import large_components
from .brightness import Witnesses, lights
from .parameters import FUSION, FusionParameters, WaterParameters
from .provenance import SurfaceCells
from .surface import Block
from .water_index import Colours, WaterIndex, colours_of, parts, wet_above

DARK = "empty, dark and smooth"


@dataclass(frozen=True)
class WaterBody:
    """One lake or river: its area (m2), and its lowest and highest level (m above the ellipsoid); NaN where too little
    of its shore is known."""

    area: float
    lowest: float
    highest: float

    @property
    def known(self) -> bool:
        """Whether it has a level."""
        return math.isfinite(self.lowest)

    @property
    def falls(self) -> bool:
        """Whether it is a river."""
        return self.highest > self.lowest


@dataclass(frozen=True)
class Water:
    """The water of a grid. ``level`` (rows, columns) is its height, m above the ellipsoid, NaN on land, and infinite
    where it is not known, on cells that are ``step`` x ``step`` cells of the grid. ``evidence`` is what told it from
    land, for the products' metadata.
    ``patches`` are how many dark bodies were left out, because other land has their colours."""

    step: int
    level: FloatImage
    bodies: Tuple[WaterBody, ...]
    evidence: str = DARK
    patches: int = 0

    def within(self, window: Window) -> FloatImage:
        """(H, W) levels of the water on the cells of a window, NaN on land, infinite where a level is not known."""
        rows, columns = (
            np.arange(start, start + count) // self.step
            for start, count in ((window.row, window.height), (window.col, window.width))
        )
        found: FloatImage = self.level[rows[:, None], columns[None, :]]
        return found


def find_water(
    blocks: Sequence[Block],
    grid: CellGrid,
    witnesses: Witnesses,
    check: Callable[[], None],
    parameters: FusionParameters = FUSION,
    spectra: Optional[WaterIndex] = None,
) -> Water:
    """The water among the surface's ``blocks``, which cover the ``grid``; images say how bright and how rough it is,
    ``spectra`` of which colour.

    Raises ImageError where an image cannot be read.
    """
    p, step = parameters.water, 1
    while grid.size[0] * grid.size[1] > p.most_cells * step * step:
        step *= 2  # blocks begin at multiples of it
    shape = tuple(-(-count // step) for count in grid.shape)
    height = np.full(shape, np.nan, np.float32)
    for block in blocks:
        check()
        place = block.own
        part = _means(matched_heights(block.surface()), step)
        height[place.row // step :, place.col // step :][: part.shape[0], : part.shape[1]] = part
    cells = CellGrid(grid.west, grid.north, step * grid.cell, (shape[0], shape[1]))
    land, nothing = np.isfinite(height), Water(step, np.full(shape, np.nan, np.float32), ())
    empty = _broad(~land, p.narrowest_m / cells.cell, p.least_m2 / cells.cell**2)
    if not empty.any() or not land.any():
        return nothing
    # What is looked at lies at the level of its shore: otherwise images would show other places.
    assumed = np.where(land, height, np.float32(np.nanpercentile(height, p.shore_percentile)))
    for shore in _shores(empty, height, cells.cell, p):
        if shore.heights.size >= p.least_shore:
            assumed[shore.part][shore.inside] = np.percentile(shore.heights, p.shore_percentile)
        check()
    looks, dry, evidence, colours = _looks_of_water(witnesses, spectra, cells, assumed, land, empty, check, parameters)
    side = 2 * max(int(round(p.narrowest_m / cells.cell / 4)), 1) + 1
    alike = cv2.boxFilter(looks.astype(np.float32), -1, (side, side), borderType=cv2.BORDER_CONSTANT)
    water = _broad((empty | looks) & (alike > p.share), p.narrowest_m / cells.cell, p.least_m2 / cells.cell**2)
    # The windows of both questions reach over the bank: what is empty so far beside water belongs to it.
    rim = cv2.dilate(water.astype(np.uint8), _disc(side // 2 + p.window_cells // 2 + 1)) > 0
    water = large_components(water | (rim & empty & ~dry), p.least_m2 / cells.cell**2)
    patches = 0
    if colours is not None:
        shaded = colours.shaded(water, land, cells.cell, p)
        patches = cv2.connectedComponents(shaded.astype(np.uint8), connectivity=4)[0] - 1
        water &= ~shaded
    level, bodies = nothing.level.copy(), []
    for shore in _shores(water, height, cells.cell, p):
        check()
        if shore.heights.size >= p.least_shore and shore.empty >= p.least_empty:
            whole = _without_islands(shore.inside, p.island_m2 / cells.cell**2)
            own = water_levels(whole, shore.rows, shore.columns, shore.heights, cells.cell, p)
            lowest, highest = float(np.nanmin(own)), float(np.nanmax(own))
            if lowest == highest and not shore.tells(lowest, p):
                lowest = highest = math.nan
                own = np.where(whole, np.float32(np.inf), own)
            level[shore.part] = np.where(whole, own, level[shore.part])
            bodies.append(WaterBody(float(whole.sum() * cells.cell**2), lowest, highest))
    return Water(step, level, tuple(bodies), evidence, patches)


def matched_heights(surface: SurfaceCells) -> FloatImage:
    """(H, W) the heights that were matched, NaN elsewhere."""
    return np.where(surface.source == Provenance.MATCHED, surface.height, np.float32(np.nan))


def flattened(surface: SurfaceCells, level: FloatImage) -> SurfaceCells:
    """The surface with the water at its level (H, W), NaN on land: such heights have no witness and no known error.
    Where the level is not known, and infinite, the surface stays as it is."""
    water = np.isfinite(level)
    unknown = {name: np.where(water, np.float32(np.nan), getattr(surface, name)) for name in _UNKNOWN}
    source = np.where(water, np.float32(Provenance.WATER), surface.source)
    return SurfaceCells(height=np.where(water, level, surface.height), source=source, **unknown)


_UNKNOWN = ("count", "spread", "score", "error", "le90")


# Where ------------------------------------------------------------------------------------------------------------


def _means(values: FloatImage, step: int) -> FloatImage:
    """Means over step x step cells; NaN where fewer than half of them are known."""
    if step == 1:
        return values
    rows, columns = (-(-count // step) for count in values.shape)
    padded = np.full((rows * step, columns * step), np.nan, np.float32)
    padded[: values.shape[0], : values.shape[1]] = values
    parts = padded.reshape(rows, step, columns, step).transpose(0, 2, 1, 3).reshape(rows, columns, -1)
    known = np.isfinite(parts)
    count = known.sum(axis=-1)
    mean = np.where(known, parts, 0).sum(axis=-1) / np.maximum(count, 1)
    return np.where(2 * count >= step * step, mean, np.nan).astype(np.float32)


def _disc(radius: float) -> ByteImage:
    side = 2 * max(int(round(radius)), 1) + 1
    disc: ByteImage = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return disc


def _broad(empty: Mask, width: float, least: float) -> Mask:
    """What holds a disc ``width`` cells wide, with what lies beside it; components of ``least`` cells or more."""
    disc, mask = _disc(width / 2), empty.astype(np.uint8)
    framed = cv2.copyMakeBorder(mask, *(disc.shape[0],) * 4, cv2.BORDER_CONSTANT, value=0)
    core = cv2.dilate(cv2.erode(framed, disc), disc) & framed
    inner = (slice(disc.shape[0], -disc.shape[0]),) * 2
    grown = (cv2.dilate(core, disc) & framed)[inner]
    return large_components(grown > 0, least)


def _without_islands(inside: Mask, most: float) -> Mask:
    """A body with its small holes."""
    around = large_components(np.pad(~inside, 1, constant_values=True), most)
    return ~around[1:-1, 1:-1]


def _looks_of_water(
    witnesses: Witnesses,
    spectra: Optional[WaterIndex],
    grid: CellGrid,
    height: FloatImage,
    land: Mask,
    empty: Mask,
    check: Callable[[], None],
    parameters: FusionParameters,
) -> Tuple[Mask, Mask, str, Optional[Colours]]:
    """Which cells look like water, which certainly not, and what says so: the index of water wherever an image shows
    it, of matched cells as well, and darkness of ``empty`` ones elsewhere. And the colours that images show."""
    looks, evidence, known = np.zeros(grid.shape, bool), "", np.zeros(grid.shape, bool)
    colours = None
    if spectra is not None:
        colours = colours_of(spectra, grid, height, check, parameters)
        known = np.isfinite(colours.index)
        looks, threshold = wet_above(
            colours.index,
            colours.infrared,
            land=land,
            empty=empty,
            cell=grid.cell,
            calibrated=spectra.calibrated,
            parameters=parameters.water,
        )
        if known[empty].any():
            evidence = "no NDWI of water" if threshold is None else f"NDWI above {threshold:.2f}"
    # A pixel on the bank is what more than half of it shows.
    dry = known & ~looks
    if colours is not None and looks.any() and (known & land & ~looks).any():
        index = colours.index
        with np.errstate(invalid="ignore"):
            dry &= index < (np.median(index[looks]) + np.median(index[known & land & ~looks])) / 2
    if known[empty].all():
        return looks, dry, evidence, colours
    dark = empty & ~known & _dark_and_flat(witnesses, grid, height, land, check, parameters)
    if evidence and dark.any():
        evidence = f"{evidence}; elsewhere {DARK}"
    return looks | dark, dry, evidence or DARK, colours


def _dark_and_flat(
    witnesses: Witnesses,
    grid: CellGrid,
    height: FloatImage,
    land: Mask,
    check: Callable[[], None],
    parameters: FusionParameters,
) -> Mask:
    """Which cells are dark and flat, compared with land that was matched; only what two views see can be."""
    p, bright = parameters.water, parameters.brightness
    light, texture = np.full((2, *grid.shape), np.nan, np.float32)
    twice = np.zeros(grid.shape, bool)
    for own, near, wide in parts(grid, p.window_cells // 2, parameters):
        check()
        asked = near.within(wide)
        seen = list(lights(witnesses, grid.part(wide), height[wide.slices], bright, parameters.visibility, asked))
        if len(seen) < 2:
            continue
        inner, each = own.inside(near), np.stack(seen)
        twice[own.slices] = (np.isfinite(each).sum(axis=0) >= 2)[inner]
        light[own.slices] = median_of_known(each)[inner]
        texture[own.slices] = median_of_known(np.stack([_roughness(one, p.window_cells) for one in seen]))[inner]
    known = land & np.isfinite(light) & np.isfinite(texture)
    if not known.any():
        return np.zeros(grid.shape, bool)
    with np.errstate(invalid="ignore"):
        darker = light < np.percentile(light[known], p.dark_percentile)
        flatter = texture < np.float32(p.flat) * np.median(texture[known])
    found: Mask = twice & darker & flatter
    return found


def _roughness(light: FloatImage, side: int) -> FloatImage:
    """The standard deviation of the known values in a window around each cell."""
    known = np.isfinite(light)
    values = np.where(known, light, np.float32(0)).astype(np.float64)
    count, total, squares = (
        cv2.boxFilter(part.astype(np.float64), -1, (side, side), borderType=cv2.BORDER_CONSTANT)
        for part in (known, values, values**2)
    )
    count = np.maximum(count, 1e-9)
    spread = np.sqrt(np.maximum(squares / count - (total / count) ** 2, 0.0))
    return np.where(known, spread, np.nan).astype(np.float32)


# How high ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Shore:
    """A body's ``part`` of the grid with a margin, its cells in it, the share of them without a matched height, how
    many cells its ``whole`` shore has, and the matched heights (m) of these with their places in the part."""

    part: Tuple[slice, slice]
    inside: Mask
    empty: float
    whole: int
    rows: IntArray
    columns: IntArray
    heights: FloatArray

    @classmethod
    def of(
        cls, numbers: IntArray, number: int, facts: IntArray, height: FloatImage, cell: float, p: WaterParameters
    ) -> _Shore:
        """The shore of the component of a ``number``, whose ``facts`` are OpenCV's."""
        reach = max(int(round(p.shore_m / cell)), p.shore_cells)
        left, top, width, tall = (int(value) for value in facts[:4])
        part = (
            slice(max(top - reach, 0), top + tall + reach),
            slice(max(left - reach, 0), left + width + reach),
        )
        inside = numbers[part] == number  # in its part alone: there may be many components
        around = cv2.dilate(inside.astype(np.uint8), _disc(reach)) > 0
        known = np.isfinite(height[part])
        rows, columns = np.nonzero(around & ~inside)
        there = known[rows, columns]
        heights = height[part][rows[there], columns[there]].astype(np.float64)
        empty = 1.0 - float(known[inside].mean())
        return cls(part, inside, empty, rows.size, rows[there], columns[there], heights)

    def tells(self, level: float, p: WaterParameters) -> bool:
        """Whether the shore says that a lake has this level (m): most of it is known, or much of it is as low.

        The shore is as low as the water where the ground comes down to it, and higher at walls and cliffs. What a cloud
        hides may be the lowest part, unless others are about as low, and all the same.
        """
        low = int((self.heights < level + p.same_level_m).sum())
        return self.heights.size >= p.known_shore * self.whole or low >= p.level_shore * self.whole


def _shores(water: Mask, height: FloatImage, cell: float, p: WaterParameters) -> Iterator[_Shore]:
    """The shores of all components of a mask."""
    _, numbers, facts, _ = cv2.connectedComponentsWithStats(water.astype(np.uint8), connectivity=4)
    for number in range(1, len(facts)):
        yield _Shore.of(numbers, number, facts[number], height, cell, p)


def water_levels(
    inside: Mask,
    rows: IntArray,
    columns: IntArray,
    heights: FloatArray,
    cell: float,
    parameters: WaterParameters = FUSION.water,
) -> FloatImage:
    """(H, W) the level of a body of water, NaN beside it, from the heights (m) of its shore at these rows and columns.

    A lake has one level. A river's level follows the low percentile of its shore along its length, made monotonic by
    least squares (pool adjacent violators: Ayer et al. 1955, Annals of Mathematical Statistics 26).
    """
    level = np.full(inside.shape, np.nan, np.float32)
    level[inside] = np.percentile(heights, parameters.shore_percentile)
    along, shore = _lengths(inside, rows, columns, cell, parameters)
    if along is None or shore is None or float(along.max()) ** 2 < parameters.least_elongation * inside.sum() * cell**2:
        return level
    edges = np.arange(0.0, float(along.max()) + parameters.bin_m, parameters.bin_m)
    bins = np.clip(np.digitize(shore, edges) - 1, 0, len(edges) - 2)
    middles, lows, weights = [], [], []
    for number in range(len(edges) - 1):
        own = heights[bins == number]
        if own.size >= parameters.least_shore:
            middles.append(0.5 * (edges[number] + edges[number + 1]))
            lows.append(float(np.percentile(own, parameters.shore_percentile)))
            weights.append(float(own.size))
    if len(lows) < parameters.least_bins:
        return level
    low, weight = np.array(lows), np.array(weights)
    up, down = monotonic(low, weight), -monotonic(-low, weight)
    best = min((up, down), key=lambda fit: float((weight * (low - fit) ** 2).sum()))
    fall = abs(float(best[-1] - best[0]))
    scatter = float(np.sqrt((weight * (low - best) ** 2).sum() / weight.sum()))
    if fall > max(parameters.least_fall_m, parameters.fall_scatters * scatter):
        level[inside] = np.interp(along, middles, best)
    return level


def monotonic(values: FloatArray, weights: FloatArray) -> FloatArray:
    """The non-decreasing values that are nearest to some by weighted least squares."""
    pools: List[Tuple[float, float, int]] = []
    for value, weight in zip(values, weights):
        pools.append((float(value), float(weight), 1))
        while len(pools) > 1 and pools[-2][0] > pools[-1][0]:
            (a, wa, na), (b, wb, nb) = pools[-2:]
            pools[-2:] = [((a * wa + b * wb) / (wa + wb), wa + wb, na + nb)]
    return np.concatenate([np.full(count, value) for value, _, count in pools])


def _lengths(
    inside: Mask, rows: IntArray, columns: IntArray, cell: float, p: WaterParameters
) -> Tuple[Optional[FloatArray], Optional[FloatArray]]:
    """How far along the water each of its cells lies, and each place of its shore, m; None for a body of one piece."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    step = 1
    while inside.sum() > p.most_nodes * step * step:
        step *= 2
    thin = inside[::step, ::step]
    number = np.full(thin.shape, -1)
    number[thin] = np.arange(int(thin.sum()))
    pairs, lengths = [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        first = number[: thin.shape[0] - down, max(-right, 0) : thin.shape[1] - max(right, 0)]
        second = number[down:, max(right, 0) : thin.shape[1] - max(-right, 0)]
        both = (first >= 0) & (second >= 0)
        pairs.append(np.stack([first[both], second[both]]))
        lengths.append(np.full(int(both.sum()), step * cell * float(np.hypot(down, right))))
    links, length = np.concatenate(pairs, axis=1), np.concatenate(lengths)
    if not links.size:
        return None, None
    graph = coo_matrix((length, (links[0], links[1])), shape=(int(thin.sum()),) * 2).tocsr()
    far = 0
    for _ in range(2):  # the second time from one end
        away = dijkstra(graph, directed=False, indices=far)
        away = np.where(np.isfinite(away), away, 0.0)
        far = int(away.argmax())
    tree = cKDTree(step * np.argwhere(thin))
    own = away[tree.query(np.argwhere(inside))[1]]
    return own, away[tree.query(np.stack([rows, columns], axis=1))[1]]
