"""A district of large flat buildings for scenes of many dates: what stands there for years, and what each date changes.

Streets between blocks with towers over wide podiums, offices, car parks and lawns; trees and cars are kept apart from
the ground, because they look different on another date. The numbers below are sizes and albedos of what stands there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import List, Tuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from repm_qgis.contracts.arrays import FloatImage, Mask
from repm_qgis.runtime.progress import Progress
from repm_qgis.simulation.parameters import SIMULATION
from repm_qgis.simulation.seasons import foliage
from repm_qgis.simulation.surface import Area, Codes, Ground, fractal
from repm_qgis.simulation.town import Place, Town

from .parameters import DATED, DistrictParameters, EffectParameters

PLAIN, GRASS, EVERGREEN, SHEDDING, GRAVEL, METAL, MEMBRANE, CAR = range(8)  # places in DistrictParameters.materials
GROUND_CLASS, TREE_CLASS, BUILDING_CLASS = 2, 5, 6  # of the ASPRS, as lidar has them
_BOUGHS = 7
_CAR_TONES = (0.04, 0.06, 0.10, 0.22, 0.35, 0.55, 0.65)


@dataclass(frozen=True)
class Tree:
    """A tree in the district's turned axes, m; ``seed`` is that of its shape."""

    place: Place
    radius: float
    tall: float
    tone: float
    sheds: bool
    seed: int


@dataclass(frozen=True)
class Stall:
    """A place for a car in the district's turned axes; on a road or in a car park."""

    place: Place
    along_u: bool
    road: bool


@dataclass(frozen=True)
class Date:
    """When an image was taken: the day decides on parked cars, the moment on moving ones, the year's day on leaves."""

    day: int
    moment: int
    day_of_year: int


class District(Town):
    """Builds what stays: ground, buildings, materials and classes, and the places of trees and cars."""

    def __init__(
        self, ground: Ground, base: float, seed: int, progress: Progress, own: DistrictParameters = DATED.district
    ) -> None:
        super().__init__(ground, base, seed, progress, own.plan)
        self._own, self._seed = own, seed
        self._detail = fractal(self._rng, ground.height.shape, ground.cell, 3.0, 0.0, 0.1)
        self._boughs = fractal(self._rng, ground.height.shape, ground.cell, SIMULATION.season.bough_m, 0.0, 0.3)
        self.trees: List[Tree] = []
        self.stalls: List[Stall] = []
        self.material: Codes = np.zeros(ground.height.shape, np.uint8)
        self.building: Mask = np.zeros(ground.height.shape, bool)
        self._roof = MEMBRANE
        self.build()

    # What stays -------------------------------------------------------------------------------------------------------

    def _open_ground(self) -> None:
        """Streets of aged asphalt and concrete, lighter than a town's."""
        super()._open_ground()
        self._ground.albedo *= np.float32(1.7)

    def _block(self, i: int, j: int) -> None:
        """One block between four streets, of a kind that follows from its place."""
        width, depth = self._parameters.block_m
        centre = ((i + 0.5) * width, (j + 0.5) * depth)
        inner = (width - self._parameters.street_m, depth - self._parameters.street_m)
        self._street_life(centre)
        builders = (self._clinic, self._car_park, self._offices, self._low_rise)
        builders[(i + 2 * j) % 4](centre, inner)

    def _street_life(self, centre: Place) -> None:
        """Cars that drive, and trees along the pavements."""
        width, depth = self._parameters.block_m
        for k in range(-8, 8):
            for lane in (-2.4, 2.4):
                self._stall((centre[0] + 8.0 * k + lane, centre[1] - depth / 2 + lane), True, True)
                if abs(8.0 * k) < depth / 2:
                    self._stall((centre[0] - width / 2 + lane, centre[1] + 8.0 * k - lane), False, True)
            if self._rng.random() < 0.3:
                self._tree(centre[0] + 8.0 * k, centre[1] - depth / 2 + 8.6, 0.6)

    def _clinic(self, centre: Place, inner: Place) -> None:
        """A podium of many levels, and slabs of 30 to 44 m on it that cross."""
        self._cover(centre, inner, 0.22, PLAIN)
        self._podium(centre, (inner[0] * 0.49, inner[1] * 0.46), (5.0, 16.0), 26)
        slabs = (
            ((-0.12, 0.0), (9.0, 33.0), 44.0),
            ((-0.12, 0.0), (31.0, 8.0), 41.0),
            ((0.27, 0.06), (8.0, 24.0), 31.0),
        )
        for place, half, tall in slabs:
            self._roof_of(METAL if tall > 42 else MEMBRANE)
            where = (centre[0] + place[0] * inner[0], centre[1] + place[1] * inner[1])
            self._flat(where, half, tall, (0.5, 0.012) if tall > 42 else (0.3, 0.02), 9, 1.0)
        self._trees(6, centre, inner, 0.5, 0.49)

    def _podium(self, centre: Place, half: Place, levels: Tuple[float, float], count: int) -> None:
        """Flat roofs that overlap, the lowest first."""
        for tall in sorted(self._rng.uniform(*levels, count)):
            size = (self._draw(0.14, 0.42) * half[0], self._draw(0.16, 0.45) * half[1])
            place = [c + self._draw(-1, 1) * (h - s) for c, h, s in zip(centre, half, size)]
            self._roof_of(int(self._rng.choice([GRAVEL, GRAVEL, MEMBRANE, METAL])))
            self._flat((place[0], place[1]), size, float(tall), None, int(size[0] * size[1] / 14), self._draw(0.3, 1.0))

    def _offices(self, centre: Place, inner: Place) -> None:
        """One large building of two levels on a lawn, with parking at its back."""
        self._cover(centre, inner, 0.12, GRASS)
        place = (centre[0] - 0.06 * inner[0], centre[1] + 0.14 * inner[1])
        self._roof_of(METAL)
        self._flat(place, (inner[0] * 0.42, inner[1] * 0.27), 9.5, (0.3, 0.02), 40)
        self._roof_of(MEMBRANE)
        self._flat((place[0] + 8, place[1]), (inner[0] * 0.12, inner[1] * 0.33), 13.5, None, 16)
        back = (centre[0], centre[1] - 0.36 * inner[1])
        self._cover(back, (inner[0] * 0.9, 17.0), 0.2, PLAIN)
        self._stalls(back, inner[0] * 0.86, 0.0)
        self._trees(16, centre, inner, 0.48, 0.48)

    def _low_rise(self, centre: Place, inner: Place) -> None:
        """Three low buildings around a yard, and trees in groups."""
        self._cover(centre, inner, 0.2, PLAIN)
        for k, kind in ((-1, GRAVEL), (0, METAL), (1, GRAVEL)):
            self._roof_of(kind)
            place = (centre[0] + 0.3 * k * inner[0], centre[1] + self._draw(-0.08, 0.06) * inner[1])
            self._flat(place, (inner[0] * 0.13, inner[1] * self._draw(0.22, 0.33)), self._draw(4, 13), None, 20, 0.4)
            self._stalls((place[0], centre[1] - 0.44 * inner[1]), 0.25 * inner[0], 0.0)
        self._trees(30, (centre[0], centre[1] + 0.4 * inner[1]), inner, 0.48, 0.09)

    def _car_park(self, centre: Place, inner: Place) -> None:
        """Rows of stalls with islands of trees between them, and a lawn beside them."""
        self._cover(centre, inner, 0.17, PLAIN)
        for k in range(-2, 3):
            row = (centre[0] - 0.17 * inner[0], centre[1] + 17.0 * k)
            self._stalls(row, 0.6 * inner[0], 5.4)
            self._cover((row[0], row[1] + 2.7), (0.6 * inner[0], 1.6), 0.12, GRASS)
            for u in np.arange(-0.28, 0.29, 0.08):
                self._tree(row[0] + u * inner[0], row[1] + 2.7, 0.6)
        lawn = (centre[0] + 0.36 * inner[0], centre[1])
        self._cover(lawn, (0.24 * inner[0], 0.92 * inner[1]), 0.12, GRASS)
        self._trees(8, lawn, (0.24 * inner[0], inner[1]), 0.45, 0.45)

    def _stalls(self, row: Place, length: float, other: float) -> None:
        """One row of stalls with white lines, and another ``other`` metres and a stall beyond it."""
        for u in np.arange(-length / 2 + 1.4, length / 2, 2.7):
            for v in (0.0, other + 0.01) if other else (0.0,):
                self._stall((row[0] + u, row[1] + v), False, False)
                self._cover((row[0] + u - 1.35, row[1] + v), (0.25, 5.0), 0.32, PLAIN)

    def _stall(self, place: Place, along_u: bool, road: bool) -> None:
        self.stalls.append(Stall(place, along_u, road))

    def _cover(self, centre: Place, size: Place, albedo: float, material: int) -> None:
        """Paint a rectangle of ground with a material."""
        half = (size[0] / 2, size[1] / 2)
        self._paint(centre, half, albedo, 0.06 * albedo)
        found = self._footprint(centre, half)
        if found is not None:
            area, _, _, inside = found
            tone = self._ground.albedo[area] * (1 + np.float32(0.025) * self._detail[area])
            self._ground.albedo[area] = np.where(inside, tone, self._ground.albedo[area])
            self.material[area][inside] = material

    def _roof_of(self, material: int) -> None:
        self._roof = material

    def _put(self, area: Area, inside: Mask, height: ArrayLike, tone: ArrayLike) -> None:
        """A building's roof with stains and seams: its material and class besides."""
        rows, cols = np.indices(inside.shape) * self._ground.cell
        seams = (np.mod(rows, 11.0) < 0.2) | (np.mod(cols, 7.3) < 0.2)
        stains = 1 + 0.025 * self._detail[area] - 0.18 * (self._broad[area] + 0.25 * self._detail[area] > 1.6)
        super()._put(area, inside, height, tone * np.where(seams, 0.85, stains))
        self.material[area][inside] = self._roof
        self.building[area] |= inside

    def _tree(self, u: float, v: float, scale: float = 1.0) -> None:
        radius = scale * self._draw(2.2, 5.2)
        tall, tone = radius + scale * self._draw(2.0, 6.0), self._draw(0.05, 0.08)
        sheds, seed = self._rng.random() < self._own.shedding, int(self._rng.integers(2**31))
        patch = self._ground.patch(*self._map(u, v), radius)
        if patch is not None and not self.building[patch[0]].any():
            self.trees.append(Tree((u, v), radius, tall, tone, sheds, seed))

    # What each date changes -------------------------------------------------------------------------------------------

    def dated(self, date: Date, effects: EffectParameters) -> Tuple[Ground, Codes]:
        """The ground (a copy) with the trees and cars of a date, and its materials."""
        base = self._ground
        ground = replace(
            base, height=base.height.copy(), albedo=base.albedo.copy(), wall_albedo=base.wall_albedo.copy()
        )
        material = self.material.copy()
        grass = material == GRASS
        dry = effects.seasons * (1 - _in_year(self._own.green, date.day_of_year))
        ground.albedo[grass] *= np.float32(1 + dry * (self._own.dry_grass - 1))
        leaves = 1 - effects.seasons * (1 - _in_year(self._own.leaves, date.day_of_year))
        for tree in self.trees:
            self._plant(ground, material, tree, leaves if tree.sheds else 1.0, effects.rough_crowns)
        self._park_cars(ground, material, date if effects.moving_cars else Date(0, 0, 0))
        return ground, material

    def truth(self, date: Date, effects: EffectParameters) -> Tuple[FloatImage, Codes]:
        """Heights as lidar has them on a date, with the envelopes of crowns in leaf, and their classes."""
        ground, _ = self.dated(date, replace(effects, seasons=0.0))
        height = ground.height
        crowns = np.zeros(height.shape, bool)
        for tree in self.trees:
            found = self.crown(tree, effects.rough_crowns)
            if found is not None:
                area, top, inside = found
                height[area] = np.where(inside, np.maximum(height[area], top), height[area])
                crowns[area] |= inside
        classes = np.where(self.building, BUILDING_CLASS, np.where(crowns, TREE_CLASS, GROUND_CLASS))
        return height, classes.astype(np.uint8)

    def crown(self, tree: Tree, rough: bool) -> Tuple[Area, FloatImage, Mask] | None:
        """Nodes around a tree, the height of its envelope there, and which of them are under it."""
        patch = self._ground.patch(*self._map(*tree.place), 1.35 * tree.radius)
        if patch is None:
            return None
        area, x, y = patch
        foot, domes = tree.tall - tree.radius, [(0.0, 0.0, tree.radius, 1.0)]
        if rough:
            rng = np.random.default_rng(tree.seed)
            turns = rng.uniform(0, 2 * math.pi, _BOUGHS)
            away, size = rng.uniform(0.2, 0.65, _BOUGHS), rng.uniform(0.35, 0.65, _BOUGHS)
            lift = rng.uniform(0.55, 1.15, _BOUGHS)
            places = zip(turns, away, size, lift)
            domes = [(a * math.cos(t), a * math.sin(t), s * tree.radius, h) for t, a, s, h in places]
            domes = [(east * tree.radius, north * tree.radius, s, h) for east, north, s, h in domes]
        top = np.full(np.broadcast_shapes(x.shape, y.shape), -np.inf, np.float32)
        for east, north, size_m, share in domes:
            dome = 1 - ((x - east) ** 2 + (y - north) ** 2) / size_m**2
            reach = foot * (0.4 + 0.6 * share) + tree.radius * share * np.sqrt(np.maximum(dome, 0))
            top = np.maximum(top, np.where(dome > 0, reach, -np.inf))
        skin = 0.12 * tree.radius * self._boughs[area] if rough else 0.1 * self._fine[area]
        inside = np.isfinite(top) & ~self.building[area]
        return area, self._terrain[area] + np.maximum(np.where(inside, top, 0) + skin, 0.8).astype(np.float32), inside

    def _plant(self, ground: Ground, material: Codes, tree: Tree, leaves: float, rough: bool) -> None:
        """Raise the ground to a crown; through its gaps one sees the ground. Beer's law gives their share."""
        found = self.crown(tree, rough)
        if found is None:
            return
        area, top, inside = found
        solid, tone = foliage(self._boughs[area], tree.tone, leaves)
        if rough or leaves < 1:
            inside = inside & solid
        ground.height[area] = np.where(inside, top, ground.height[area])
        ground.albedo[area] = np.where(inside, tone, ground.albedo[area])
        near = ndimage.binary_dilation(inside, iterations=2)
        ground.wall_albedo[area] = np.where(near, np.float32(tree.tone), ground.wall_albedo[area])
        material[area][inside] = SHEDDING if tree.sheds else EVERGREEN

    def _park_cars(self, ground: Ground, material: Codes, date: Date) -> None:
        parked, driving = (np.random.default_rng([self._seed, n, date.day, date.moment * n]) for n in (0, 1))
        for stall in self.stalls:
            rng = driving if stall.road else parked
            here, tone, shift = rng.random(), float(rng.choice(_CAR_TONES)), rng.uniform(-0.5, 0.5, 2)
            if here > (self._own.street_cars if stall.road else self._own.occupied):
                continue
            half = (2.2, 0.9) if stall.along_u else (0.9, 2.2)
            shift = shift * (6.0 if stall.road else 0.6) * np.array([stall.along_u, not stall.along_u])
            found = self._footprint((stall.place[0] + shift[0], stall.place[1] + shift[1]), half)
            if found is None or self.building[found[0]].any():
                continue
            area, u, v, inside = found
            along = u if stall.along_u else v
            roof = inside & (np.abs(along + 0.2) < 1.2)  # bonnet and boot are lower
            body = self._terrain[area] + np.where(roof, 1.45, 0.95).astype(np.float32)
            glass = roof & (np.abs(np.abs(along + 0.2) - 1.0) < 0.25)
            inside &= ground.height[area] < body  # a crown may stand over the car
            ground.height[area] = np.where(inside, body, ground.height[area])
            ground.albedo[area] = np.where(inside, np.where(glass, 0.04, tone), ground.albedo[area])
            material[area][inside] = CAR


def _in_year(table: Tuple[Tuple[float, float], ...], day_of_year: int) -> float:
    days, values = zip(*table)
    return float(np.interp(day_of_year, days, values))
