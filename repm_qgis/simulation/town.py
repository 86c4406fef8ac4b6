"""A town for truth scenes: streets in a turned grid, and lots with houses, halls, towers, trees and cars.

Plain roofs and fields have little texture. The numbers below are the sizes and albedos of what stands in the town.
"""

from __future__ import annotations

import math
from typing import Optional, Tuple

import numpy as np
from numpy.typing import ArrayLike

from ..contracts.arrays import FloatArray, Mask
from ..runtime.progress import Progress
from .parameters import SIMULATION, TownParameters
from .surface import Area, Cover, Ground, fractal

Place = Tuple[float, float]
Finish = Optional[Tuple[float, float]]
Footprint = Tuple[Area, FloatArray, FloatArray, Mask]


class Town:
    """Builds on gentle ground around ``base`` metres; the same arguments give the same town.

    ``u, v`` are metres along the town's own axes.
    """

    def __init__(
        self, ground: Ground, base: float, seed: int, progress: Progress, parameters: TownParameters = SIMULATION.town
    ) -> None:
        rng = np.random.default_rng([seed, 2])
        self._ground, self._rng, self._progress, self._parameters = ground, rng, progress, parameters
        shape, cell = ground.height.shape, ground.cell
        ground.height[:] = np.float32(base) + parameters.relief_m * fractal(rng, shape, cell, 500.0, 120.0)
        self._terrain = ground.height.copy()
        self._fine = fractal(rng, shape, cell, 6.0, 0.0, 0.2)
        self._broad = fractal(rng, shape, cell, 60.0, 2.0, 0.5)
        self._east = ground.west + (shape[1] - 1) / 2 * cell
        self._north = ground.north - (shape[0] - 1) / 2 * cell
        self._half = 0.5 * cell * math.hypot(*shape)
        turn = math.radians(parameters.turn_deg)
        self._cos, self._sin = math.cos(turn), math.sin(turn)

    def build(self) -> None:
        """Streets first, then block by block."""
        self._open_ground()
        across, along = (int(self._half / size) + 1 for size in self._parameters.block_m)
        for i in range(-across, across + 1):
            self._progress.step(0.1 + 0.55 * (i + across) / (2 * across + 1), "building the town")
            self._progress.check_cancelled()
            for j in range(-along, along + 1):
                self._block(i, j)

    def _draw(self, low: float, high: float) -> float:
        return float(self._rng.uniform(low, high))

    def _map(self, u: float, v: float) -> Tuple[float, float]:
        """Easting and northing of a place in the town's turned axes."""
        return self._east + u * self._cos - v * self._sin, self._north + u * self._sin + v * self._cos

    def _turned(self, x: FloatArray, y: FloatArray) -> Tuple[FloatArray, FloatArray]:
        """The turned coordinates u, v of metres east and north."""
        return x * self._cos + y * self._sin, y * self._cos - x * self._sin

    def _open_ground(self) -> None:
        """Yards and gardens everywhere, and over them streets with kerbs and lane marks."""
        ground, plan = self._ground, self._parameters
        rows, cols = ground.height.shape
        x = (ground.west + np.arange(cols) * ground.cell - self._east)[None, :]
        y = (ground.north - np.arange(rows) * ground.cell - self._north)[:, None]
        yard = 0.105 + 0.02 * self._broad + 0.016 * self._fine
        street, pavement, marks = np.zeros((3, rows, cols), bool)
        u, v = self._turned(x, y)
        for size, place, other in ((plan.block_m[0], u, v), (plan.block_m[1], v, u)):
            away = np.abs(np.mod(place + size / 2, size) - size / 2)
            street |= away < plan.roadway_m
            pavement |= away < plan.street_m / 2
            marks |= (away < 0.15) & (np.mod(other, 9.0) < 4.0)
        albedo = np.where(pavement, 0.19 + 0.012 * self._fine, yard)
        albedo = np.where(street, 0.088 + 0.008 * self._broad + 0.006 * self._fine, albedo)
        ground.albedo[:] = np.clip(np.where(marks & street, 0.20, albedo), 0.02, 0.7)
        ground.cover[:] = np.where(pavement, Cover.STREET, np.where(self._broad < -0.8, Cover.SOIL, Cover.GRASS))
        ground.height -= np.where(street, np.float32(0.12), np.float32(0))
        ground.wall_albedo[:] = np.clip(0.3 + 0.08 * self._broad, 0.12, 0.6)

    def _block(self, i: int, j: int) -> None:
        """One block between four streets: mostly lots with houses, sometimes a park, a field, a hall or towers."""
        width, depth = self._parameters.block_m
        centre = ((i + 0.5) * width, (j + 0.5) * depth)
        inner = (width - self._parameters.street_m, depth - self._parameters.street_m)
        # The kind follows from the block's place, so that small scenes have some of everything.
        kind = (3 * i + 5 * j + 2) % 11
        self._street_life(centre)
        if kind == 0:
            self._park(centre, inner)
        elif kind == 4:
            self._field(centre, inner)
        elif kind == 7:
            self._hall(centre, inner)
        elif kind in (2, 9):
            self._towers(centre, inner)
        else:
            self._lots(centre, inner, old=kind in (1, 5, 8))

    def _lots(self, centre: Place, inner: Place, old: bool) -> None:
        """Two rows of houses with yards between them; old towns are closed rows of tiled roofs."""
        rng = self._rng
        for side in (-1.0, 1.0):
            edge = -inner[0] / 2
            while edge < inner[0] / 2 - 7:
                width = min(self._draw(9, 17) if old else self._draw(13, 25), inner[0] / 2 - edge)
                depth = self._draw(10, 15)
                gap = 0.0 if old and rng.random() < 0.8 else self._draw(2, 6)
                place = (centre[0] + edge + width / 2, centre[1] + side * (inner[1] / 2 - depth / 2 - 0.5))
                if rng.random() < (0.85 if old else 0.45):
                    self._gabled(place, (max(width - gap, 6) / 2, depth / 2), self._draw(4, 11))
                elif rng.random() < 0.93:
                    self._flat(place, (max(width - gap, 6) / 2, depth / 2), self._draw(6, 21))
                edge += width
        self._trees(int(rng.integers(4, 12)), centre, inner, 0.46, 0.12)
        if rng.random() < 0.6:
            shed = (centre[0] + self._draw(-25, 25), centre[1] + self._draw(-5, 5))
            self._gabled(shed, (self._draw(3, 6), self._draw(2.5, 4)), 2.8)

    def _park(self, centre: Place, inner: Place) -> None:
        self._paint(centre, (inner[0] / 2, inner[1] / 2), 0.11, 0.012)
        self._trees(70, centre, inner, 0.48, 0.48)
        self._paint(centre, (inner[0] / 2, 1.5), 0.26, 0.01, Cover.STREET)

    def _field(self, centre: Place, inner: Place) -> None:
        """A plain sports field: texture near the noise, with marked lines."""
        self._paint(centre, (inner[0] / 2, inner[1] / 2), 0.20, 0.012)
        self._paint(centre, (inner[0] / 2 - 6, inner[1] / 2 - 5), 0.33, 0.0)
        self._paint(centre, (inner[0] / 2 - 6.6, inner[1] / 2 - 5.6), 0.13, 0.0015)
        self._paint(centre, (0.3, inner[1] / 2 - 5), 0.33, 0.0)

    def _hall(self, centre: Place, inner: Place) -> None:
        """A large plain roof with skylights, and a car park."""
        half = (inner[0] * 0.31, inner[1] * 0.42)
        place = (centre[0] - inner[0] * 0.17, centre[1])
        self._paint(centre, (inner[0] / 2, inner[1] / 2), 0.105, 0.008, Cover.STREET)
        self._flat(place, half, 9.0, finish=(0.36, 0.004), boxes=0)
        for k in range(-2, 3):
            self._flat((place[0] + k * half[0] / 2.8, place[1]), (1.2, half[1] * 0.7), 9.8, (0.5, 0.004), 0, 0.0)
        for k in range(int(inner[1] // 3) - 2):
            for row in (0.27, 0.36, 0.45):
                if self._rng.random() < 0.6:
                    self._car(centre[0] + row * inner[0], centre[1] - inner[1] / 2 + 4 + 3.0 * k, True)

    def _towers(self, centre: Place, inner: Place) -> None:
        self._paint(centre, (inner[0] / 2, inner[1] / 2), 0.13, 0.018)
        for side in (-1.0, 1.0):
            place = (centre[0] + side * inner[0] * 0.27, centre[1] + self._draw(-6, 6))
            half = (self._draw(8, 12), self._draw(7, 11))
            self._flat(place, half, self._draw(24, 52))
        for _ in range(22):
            u = centre[0] + self._draw(-0.48, 0.48) * inner[0]
            across = 0.40 if self._rng.random() < 0.5 else -0.40
            self._tree(u, centre[1] + across * inner[1] + self._draw(-2, 2))

    def _street_life(self, centre: Place) -> None:
        """Parked cars and trees along the block's streets."""
        width, depth = self._parameters.block_m
        for k in range(-6, 7):
            if self._rng.random() < 0.55:
                self._car(centre[0] + 6.0 * k, centre[1] - depth / 2 + 2.4, True)
            if self._rng.random() < 0.25:
                self._tree(centre[0] + 6.0 * k, centre[1] - depth / 2 + 4.6, 0.55)
        for k in range(-4, 5):
            if self._rng.random() < 0.5:
                self._car(centre[0] - width / 2 - 2.4, centre[1] + 6.0 * k, False)

    def _footprint(self, place: Place, half: Place) -> Optional[Footprint]:
        """Slices of the nodes around a turned rectangle, their u and v, and which are in it; None outside the grid."""
        patch = self._ground.patch(*self._map(*place), math.hypot(*half) + 1)
        if patch is None:
            return None
        area, x, y = patch
        u, v = self._turned(x, y)
        inside = (np.abs(u) <= half[0]) & (np.abs(v) <= half[1])
        return (area, u, v, inside) if inside.any() else None

    def _paint(self, place: Place, half: Place, albedo: float, contrast: float, cover: Cover = Cover.GRASS) -> None:
        """Give a rectangle of ground another albedo and cover, with its own share of the fine texture."""
        found = self._footprint(place, half)
        if found is None:
            return
        area, _, _, inside = found
        tone = albedo + contrast * (self._fine[area] + 0.7 * self._broad[area])
        self._ground.albedo[area] = np.where(inside, np.clip(tone, 0.02, 0.7), self._ground.albedo[area])
        self._ground.cover[area][inside & (self._ground.cover[area] < Cover.ROOF)] = cover

    def _flat(
        self, place: Place, half: Place, tall: float, finish: Finish = None, boxes: int = 3, rim_m: float = 0.6
    ) -> None:
        """A level roof with a parapet and a few boxes on it, ``tall`` metres above the terrain."""
        flats = self._parameters.flats
        found = self._footprint(place, half)
        # Houses outside draw random numbers too, so that the next house does not depend on the edge of the grid.
        albedo, contrast = finish or flats[int(self._rng.integers(len(flats)))]
        spots = self._rng.uniform(-0.6, 0.6, (boxes, 2))
        if found is None:
            return
        area, u, v, inside = found
        top = float(self._terrain[area][inside].max()) + tall
        rim = inside & ((np.abs(u) > half[0] - 0.4) | (np.abs(v) > half[1] - 0.4))
        height = np.where(rim, top + rim_m, top)
        tone = np.where(rim, albedo * 1.15, albedo + contrast * (self._fine[area] + self._broad[area]))
        for spot in spots:
            box = (np.abs(u - spot[0] * half[0]) < 1.3) & (np.abs(v - spot[1] * half[1]) < 1.0) & inside
            height = np.where(box, top + 1.8, height)
            tone = np.where(box, 0.42, tone)
        self._put(area, inside, height, tone)

    def _gabled(self, place: Place, half: Place, eaves_m: float) -> None:
        """A tiled roof of 25 to 40 degrees whose ridge runs along the longer side."""
        pitch = math.tan(math.radians(self._draw(25, 40)))
        tiles = self._parameters.tiles
        albedo, contrast = tiles[int(self._rng.integers(len(tiles)))]
        chimney = self._rng.uniform(-0.7, 0.7)
        found = self._footprint(place, half)
        if found is None:
            return
        area, u, v, inside = found
        along, across, length, width = (u, v, *half) if half[0] >= half[1] else (v, u, half[1], half[0])
        eaves = float(self._terrain[area][inside].max()) + eaves_m
        height = eaves + pitch * (width - np.abs(across))
        courses = 0.012 * np.sign(np.sin(2 * np.pi * across / 1.4))
        tone = albedo + courses + contrast * (0.5 * self._fine[area] + self._broad[area])
        stack = (np.abs(along - chimney * length) < 0.5) & (np.abs(across - 0.3 * width) < 0.5)
        self._put(area, inside, np.where(stack, height + 1.6, height), np.where(stack, 0.33, tone))

    def _put(self, area: Area, inside: Mask, height: ArrayLike, tone: ArrayLike) -> None:
        """Raise the ground to a building's roof where it stands."""
        ground = self._ground
        ground.height[area] = np.where(inside, height, ground.height[area])
        ground.albedo[area] = np.where(inside, np.clip(tone, 0.03, 0.7), ground.albedo[area])
        ground.cover[area][inside] = Cover.ROOF

    def _trees(self, count: int, centre: Place, inner: Place, across: float, along: float) -> None:
        """Trees at random within these shares of a block's sides from its centre."""
        for _ in range(count):
            u = centre[0] + self._draw(-across, across) * inner[0]
            self._tree(u, centre[1] + self._draw(-along, along) * inner[1])

    def _tree(self, u: float, v: float, scale: float = 1.0) -> None:
        """A crown: half an ellipsoid with a rough skin; never on a house."""
        radius = scale * self._draw(1.8, 4.4)
        tall = 1.1 * radius + scale * self._draw(1.0, 4.5)
        tone = self._draw(0.055, 0.085)
        patch = self._ground.patch(*self._map(u, v), radius)
        if patch is None or not self._parameters.trees:
            return
        area, x, y = patch
        ground, terrain = self._ground, self._terrain[area]
        if float((ground.height[area] - terrain).max()) > 2.0:
            return
        dome = 1.0 - (x * x + y * y) / radius**2
        inside = dome > 0
        skin = tall - radius + radius * np.sqrt(np.maximum(dome, 0)) + 0.35 * scale * self._fine[area]
        ground.height[area] = np.where(inside, terrain + np.maximum(skin, 0.5), ground.height[area])
        leaves = np.clip(tone + 0.015 * self._fine[area], 0.02, 0.2)
        ground.albedo[area] = np.where(inside, leaves, ground.albedo[area])
        # Evergreens are the darker ones.
        ground.cover[area][inside] = Cover.SHEDDING if tone > 0.065 else Cover.EVERGREEN

    def _car(self, u: float, v: float, along_u: bool) -> None:
        tone = float(self._rng.choice([0.05, 0.10, 0.22, 0.45, 0.60]))
        found = self._footprint((u, v), (2.2, 0.9) if along_u else (0.9, 2.2))
        if found is None:
            return
        area, _, _, inside = found
        if float((self._ground.height[area] - self._terrain[area]).max()) > 1.0:
            return
        self._put(area, inside, self._terrain[area] + 1.4, np.float32(tone))
        self._ground.cover[area][inside] = Cover.STREET


class Farmland(Town):
    """Hills with fields, hedges and woods between tracks, and here and there a farm."""

    def _block(self, i: int, j: int) -> None:
        """One block between four tracks: strips of fields with a hedge along one side, or a wood."""
        width, depth = self._parameters.block_m
        centre = ((i + 0.5) * width, (j + 0.5) * depth)
        inner = (width - self._parameters.street_m, depth - self._parameters.street_m)
        kind = (3 * i + 5 * j + 2) % 11
        if kind == 0:
            self._trees(int(inner[0] * inner[1] / 45), centre, inner, 0.5, 0.5)
            return
        count = int(self._rng.integers(2, 6))
        for k in range(count):
            place = (centre[0] + ((k + 0.5) / count - 0.5) * inner[0], centre[1])
            cover = Cover(int(self._rng.integers(Cover.GRASS, Cover.STREET)))
            self._paint(place, (inner[0] / count / 2, inner[1] / 2), 0.11, 0.012, cover)
        self._trees(int(inner[0] / 6), (centre[0], centre[1] + inner[1] / 2), inner, 0.48, 0.02)
        self._trees(4, centre, inner, 0.45, 0.45)
        if kind in (3, 7):
            for u in (-20.0, 0.0, 18.0):
                place = (centre[0] + u, centre[1] + self._draw(-9, 9))
                self._gabled(place, (self._draw(5, 9), self._draw(4, 6)), self._draw(3, 6))
