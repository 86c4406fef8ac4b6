"""One height a cell from several height maps, and cells that stand alone removed (paper, "DSMs aggregation").

Where the maps agree, their mean is the height. Where they do not, heights within each other's noise form groups, and
one group wins. Matching widens what stands out (a window at a roof's edge holds the roof's texture), so that at true
steps the lower group is right; but a lower height is also what a failed match leaves. Three things tell the two apart,
all taken from the tile itself: how its matching score ranks among those of cells where the maps agree, whether the
agreed surface nearby has that height, and how often backgrounds of occlusions are confirmed where others were matched.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from ..matching.occlusions import STEP_PX

REACH_CELLS = 12
"""How far off the agreed surface is looked for: the margin that a part of a tile needs."""

_SIGMA_PX = 0.2  # what matching leaves, px of disparity (make bench-subpixel: 0.12 narrow, 0.25 wide pairs)
_TOLERANCE = 2.5  # of these: so far may heights differ that mean the same surface
_WEIGHT_POWER = 0.5  # weights are metres_per_px ** -0.5: between equal ones and the noise of disparities alone
_COMPANY = 3  # of the eight cells around, in the same map
_SLOPE = 1.9  # times as far may neighbours in a map differ: surfaces slope
_LEAST_AGREED = 500  # cells: fewer do not tell how scores are distributed
_RANK_ALONE, _RANK_OUTVOTED, _RANK_ISOLATED = 0.03, 0.05, 0.1
_CONFIRMED = 0.45  # of backgrounds: fewer, and gaps here are failures rather than occlusions
_AROUND = 2  # of eight directions in which the agreed surface has a background's height
_SHARE = 0.2  # of the usual number of neighbours that a cell needs
_DIRECTIONS = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))


@dataclass(frozen=True)
class Layer:
    """A height map on the cells: ``height`` (m, NaN = not matched) with its ``score``, ``background`` (m, NaN = none)
    where an occlusion hides the cell, the height that one px of disparity means; which cells matched points cover by
    less than half, and which the background's (None: none)."""

    height: Floats
    score: Floats
    background: Floats
    metres_per_px: float
    partial: Optional[NDArray[np.bool_]] = None
    partial_background: Optional[NDArray[np.bool_]] = None


@dataclass(frozen=True)
class Aggregate:
    """Fused cells, all of one shape: ``height`` (m, NaN = none), ``count`` of height maps that agree, ``spread`` (m)
    between them (NaN for one alone), mean matching ``score``, and which cells are ``filled`` from the background."""

    height: Floats
    count: NDArray[np.uint8]
    spread: Floats
    score: Floats
    filled: NDArray[np.bool_]


def aggregate(layers: Sequence[Layer], method: str) -> Aggregate:
    """Fuse height maps cell by cell. Where one covers a cell, those that cover a part of it do not count.

    Parameters
    ----------
    method : ``mean`` or ``median`` of the heights that agree, weighted by metres_per_px ** -0.5 either way.
    """
    heights = np.stack([layer.height for layer in layers]).astype(np.float32)
    scores = np.stack([layer.score for layer in layers]).astype(np.float32)
    backgrounds = np.stack([layer.background for layer in layers]).astype(np.float32)
    metres = np.array([layer.metres_per_px for layer in layers])
    if len(layers) > 1:
        _drop_outdone(layers, heights)
        if _Votes(heights, scores, backgrounds, metres).trusted():
            _drop_outdone(layers, heights, backgrounds)
    backgrounds[np.isfinite(heights)] = np.nan
    return _Votes(heights, scores, backgrounds, metres).decided(method)


def _drop_outdone(layers: Sequence[Layer], heights: Floats, backgrounds: Optional[Floats] = None) -> None:
    """Set heights NaN that stand for a part of their cell only, where another map or a background covers the cell."""
    covered = np.zeros(heights.shape[1:], dtype=bool)
    for number, layer in enumerate(layers):
        values, partial = (heights, layer.partial) if backgrounds is None else (backgrounds, layer.partial_background)
        covered |= np.isfinite(values[number]) if partial is None else np.isfinite(values[number]) & ~partial
    for layer, height in zip(layers, heights):
        if layer.partial is not None:
            height[layer.partial & covered] = np.nan


class _Votes:
    """The maps' heights of all cells, (maps, H, W), and what most cells say of the maps."""

    def __init__(self, heights: Floats, scores: Floats, backgrounds: Floats, metres: Floats) -> None:
        self.heights, self.scores, self.backgrounds = heights, np.nan_to_num(scores), backgrounds
        self.matched, self.sigma = np.isfinite(heights), (_SIGMA_PX * metres).astype(np.float32)
        self.weights = (metres**-_WEIGHT_POWER).astype(np.float32)
        self.mean, self.count = self._mean(self.matched), self.matched.sum(axis=0, dtype=np.uint8)
        self.agreed = (self.count >= 2) & self._within(self.mean)

    def _mean(self, members: NDArray[np.bool_]) -> Floats:
        total = np.zeros(members.shape[1:], np.float32)
        value = np.zeros(members.shape[1:], np.float32)
        for height, member, weight in zip(self.heights, members, self.weights):
            total += weight * member
            value += np.where(member, weight * height, np.float32(0))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(total > 0, value / total, np.float32(np.nan))

    def _within(self, centre: Floats) -> NDArray[np.bool_]:
        """Whether all maps' matched heights mean the same surface as the centre."""
        result = np.ones(centre.shape, dtype=bool)
        for height, matched, sigma in zip(self.heights, self.matched, self.sigma):
            with np.errstate(invalid="ignore"):
                result &= ~matched | (np.abs(height - centre) <= _TOLERANCE * sigma)
        return result

    def decided(self, method: str) -> Aggregate:
        """The heights of all cells: agreed ones first, then single ones, then those that groups contend for."""
        members = self.matched.copy()
        single = (self.count == 1) & ~np.isfinite(self.backgrounds).any(axis=0)
        height = np.where(self.agreed | single, self.mean, np.float32(np.nan))
        contended = np.flatnonzero(
            ~(self.agreed | single) & ((self.count > 0) | np.isfinite(self.backgrounds).any(axis=0))
        )
        filled = np.zeros(height.shape, dtype=bool)
        if contended.size:
            chosen, values, from_behind = self._contended(contended)
            members.reshape(len(members), -1)[:, contended] = chosen
            height.ravel()[contended] = values
            filled.ravel()[contended] = from_behind
        if method == "median" and len(self.heights) > 2:
            several = members.sum(axis=0) > 2
            height[several] = _weighted_median(self.heights[:, several], self.weights[:, None] * members[:, several])
        return self._described(height, members, filled)

    def _described(self, height: Floats, members: NDArray[np.bool_], filled: NDArray[np.bool_]) -> Aggregate:
        weight = self.weights[:, None, None] * members
        total = weight.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            score = (weight * self.scores).sum(axis=0) / total
        count = members.sum(axis=0, dtype=np.uint8)
        spread = np.full(height.shape, np.nan, np.float32)
        if len(self.heights) > 1:
            mean = self._mean(members)
            with np.errstate(invalid="ignore", divide="ignore"):
                variance = np.where(members, weight * (self.heights - mean) ** 2, np.float32(0)).sum(axis=0) / total
            spread = np.where(count > 1, np.sqrt(variance), spread)
        return Aggregate(height, count, spread, score, filled)

    def _contended(self, cells: NDArray[np.int64]) -> Tuple[NDArray[np.bool_], Floats, NDArray[np.bool_]]:
        """For (N,) cells: (maps, N) which matched heights count, the heights, and whether they are backgrounds."""
        count = len(self.heights)
        contradicted, confirmed = self._backgrounds_checked()
        matched = self.matched.reshape(count, -1)[:, cells] & self._coherent(cells)
        matched |= ~matched.any(axis=0) & self.matched.reshape(count, -1)[:, cells]
        values = np.where(
            matched, self.heights.reshape(count, -1)[:, cells], self.backgrounds.reshape(count, -1)[:, cells]
        )
        groups = self._groups(values, matched, self._ranks(cells))
        neighbours = self._neighbours(cells, np.where(self.agreed & ~contradicted, self.mean, np.float32(np.nan)))
        winner = _winner(groups, self._supported(groups.height, neighbours), confirmed)
        everyone = np.arange(len(cells))
        members = groups.members[winner, :, everyone].T
        height = groups.height[winner, everyone]
        return members & matched, height, np.isfinite(height) & ~(members & matched).any(axis=0)

    def trusted(self) -> bool:
        """Whether backgrounds are mostly right where maps agree."""
        return self._backgrounds_checked()[1]

    def _backgrounds_checked(self) -> Tuple[NDArray[np.bool_], bool]:
        """Cells where a background contradicts two or more maps, and whether backgrounds may be trusted in the tile."""
        contradicted, said = np.zeros(self.agreed.shape, dtype=bool), 0
        for background, sigma in zip(self.backgrounds, self.sigma):
            tolerance = _TOLERANCE * math.hypot(sigma, self.sigma.min())
            with np.errstate(invalid="ignore"):
                contradicted |= self.agreed & (np.abs(background - self.mean) > tolerance)
            said += int((self.agreed & np.isfinite(background)).sum())
        wrong = int(contradicted.sum())
        return contradicted, said < _LEAST_AGREED or said - wrong >= _CONFIRMED * said

    def _ranks(self, cells: NDArray[np.int64]) -> Floats:
        """(maps, N) shares of the agreed cells whose score is no higher: comparable between scenes."""
        ranks = np.ones((len(self.scores), len(cells)), np.float32)
        for rank, score, matched in zip(ranks, self.scores, self.matched):
            usual = np.sort(score[self.agreed & matched])
            if usual.size >= _LEAST_AGREED:
                rank[:] = np.searchsorted(usual, score.ravel()[cells], side="right") / usual.size
        return ranks

    def _coherent(self, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(maps, N) whether a height has company of its own map around it: gross errors of single points have not."""
        width = self.mean.shape[1] + 2
        row, column = np.divmod(cells, self.mean.shape[1])
        place = (row + 1) * width + column + 1
        result = np.zeros((len(self.heights), len(cells)), dtype=bool)
        for known, heights, sigma in zip(result, self.heights, self.sigma):
            padded = np.pad(heights, 1, constant_values=np.nan).ravel()
            company = np.zeros(len(cells), np.int8)
            for dr, dc in _DIRECTIONS:
                with np.errstate(invalid="ignore"):
                    company += np.abs(padded[place + dr * width + dc] - padded[place]) <= _TOLERANCE * _SLOPE * sigma
            known[:] = company >= _COMPANY
        return result

    def _groups(self, values: Floats, matched: NDArray[np.bool_], ranks: Floats) -> "_Groups":
        known = np.isfinite(values)
        shape = values.shape
        height, rank = np.full(shape, np.nan, np.float32), np.zeros(shape, np.float32)
        votes, support = np.zeros(shape, np.int16), np.zeros(shape, np.float32)
        members = np.zeros((len(values),) + shape, dtype=bool)
        for i, sigma in enumerate(self.sigma):
            tolerance = _TOLERANCE * np.hypot(self.sigma, sigma)[:, None]
            with np.errstate(invalid="ignore"):
                near = known & known[i] & (np.abs(values - values[i]) <= tolerance)
            seen = near & matched
            votes[i] = seen.sum(axis=0)
            used = np.where(votes[i] > 0, seen, near)
            weight = used * self.weights[:, None]
            with np.errstate(invalid="ignore", divide="ignore"):
                height[i] = np.where(used, values * weight, 0).sum(axis=0) / weight.sum(axis=0)
            rank[i] = np.where(seen, ranks, 0).max(axis=0)
            support[i] = seen.sum(axis=0) + 0.5 * (near & ~matched).sum(axis=0)
            members[i] = used
        metres = np.where(members, (self.sigma / np.float32(_SIGMA_PX))[None, :, None], np.inf).min(axis=1)
        return _Groups(height, votes, support, rank, members, metres)

    def _neighbours(self, cells: NDArray[np.int64], surface: Floats) -> List[Floats]:
        """The nearest agreed height in each of eight directions, (N,) each; NaN where none is within reach."""
        rim = REACH_CELLS
        width = surface.shape[1] + 2 * rim
        padded = np.pad(surface, rim, constant_values=np.nan).ravel()
        row, column = np.divmod(cells, surface.shape[1])
        place = (row + rim) * width + column + rim
        result = []
        for dr, dc in _DIRECTIONS:
            found = np.full(len(cells), np.nan, np.float32)
            todo = np.arange(len(cells))
            for distance in range(1, REACH_CELLS + 1):
                value = padded[place[todo] + distance * (dr * width + dc)]
                found[todo] = value
                todo = todo[np.isnan(value)]
            result.append(found)
        return result

    def _supported(self, heights: Floats, neighbours: Sequence[Floats]) -> NDArray[np.int16]:
        """In how many directions the agreed surface has a group's height."""
        tolerance = _TOLERANCE * math.sqrt(2) * float(self.sigma.min())
        result = np.zeros(heights.shape, np.int16)
        for near in neighbours:
            with np.errstate(invalid="ignore"):
                result += np.abs(heights - near) <= tolerance
        return result


@dataclass(frozen=True)
class _Groups:
    """For each map's height in each cell, (maps, N), the group of those that mean the same surface: its ``height``,
    ``votes`` of maps that were matched, ``support`` (backgrounds count half), best ``rank``, ``members``, and the
    ``metres`` of a px in the member with the finest."""

    height: Floats
    votes: NDArray[np.int16]
    support: Floats
    rank: Floats
    members: NDArray[np.bool_]
    metres: Floats


def _winner(groups: _Groups, supported: NDArray[np.int16], confirmed: bool) -> NDArray[np.intp]:
    """(N,) which group a cell takes: the lowest that is credible, else that with most support."""
    most = groups.votes.max(axis=0)
    asked = np.where(supported > 0, np.where(most >= 2, _RANK_OUTVOTED, _RANK_ALONE), _RANK_ISOLATED)
    asked[2 * groups.votes >= np.maximum(most, 4)] = 0.0
    known = np.isfinite(groups.height)
    credible = known & (groups.votes > 0) & (3 * groups.votes > most) & (groups.rank >= asked)
    if confirmed:
        credible |= known & (groups.votes == 0) & (supported >= _AROUND) & _unrivalled(groups, most)
    order = 1000.0 * (groups.votes > 0) + 100.0 * groups.support + 50.0 * groups.rank + supported
    order = np.where(credible, 1e6 - np.nan_to_num(groups.height), order)
    return np.where(known, order, -np.inf).argmax(axis=0)


def _unrivalled(groups: _Groups, most: NDArray[np.int16]) -> NDArray[np.bool_]:
    """(maps, N) whether backgrounds may stand against what was matched.

    Against a single map they do, unless more maps than theirs speak for its height; and then, too, where the step
    between the two is too small for all of those to see, but not for the map that the background is from.
    """
    maps = 2 * groups.support - groups.votes
    alone = (most <= 1) & (maps >= np.where(groups.votes > 0, maps, 0).max(axis=0))
    top = np.where(groups.votes == most, groups.height, -np.inf).argmax(axis=0)
    everyone = np.arange(len(top))
    with np.errstate(invalid="ignore"):
        step = (groups.height[top, everyone] - groups.height) / STEP_PX
        return alone | (step >= groups.metres) & (step < groups.metres[top, everyone])


def _weighted_median(stack: Floats, weight: Floats) -> Floats:
    """Weighted median along the first axis: where the weights below and above balance, linear between.

    With two values that is their weighted mean, with equal weights the ordinary median.
    """
    order = np.argsort(np.where(weight > 0, stack, np.inf), axis=0)
    values = np.take_along_axis(stack, order, axis=0)
    weights = np.take_along_axis(weight, order, axis=0)
    total = weights.sum(axis=0)
    # Each value sits in the middle of its own weight on the cumulative axis.
    middle = weights.cumsum(axis=0) - weights / 2
    half = total / 2
    result = np.where(total > 0, values[0], np.nan)
    for k in range(1, len(stack)):
        span = middle[k] - middle[k - 1]
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.clip((half - middle[k - 1]) / span, 0.0, 1.0)
        within = (weights[k] > 0) & (half > middle[k - 1])
        result = np.where(within, values[k - 1] + share * (values[k] - values[k - 1]), result)
    return result


def automatic_radius(cell: float, spacing: float = 0.0) -> float:
    """The radius of the outlier filter in metres where none is given: three cells, at least 1.5 m.

    The paper has no standard parameter. A grid's density is known: one point a cell, or one in ``spacing`` metres each
    way where points are sparser than cells; a disc of three of these holds 28 neighbours on a whole surface.
    """
    return max(3.0 * max(cell, spacing), 1.5)


def lonely(height: Floats, cell: float, radius: float) -> Tuple[NDArray[np.bool_], int]:
    """Cells with too few neighbours within ``radius`` metres: the radius outlier filter, on the grid.

    Neighbours count on a disc of that radius where they differ by no more than the radius in height: in a ball, a
    steep slope would have fewer neighbours than level ground. How many a cell needs comes from the density: a fifth
    of what half the cells have, at least two. The corner of a roof keeps a quarter. Returns the cells to remove, and
    the number of neighbours that was asked for.
    """
    reach = max(1, int(radius / cell))
    offsets = [
        (dr, dc)
        for dr in range(-reach, reach + 1)
        for dc in range(-reach, reach + 1)
        if (dr or dc) and math.hypot(dr, dc) * cell <= radius + 1e-9
    ]
    neighbours = np.zeros(height.shape, dtype=np.uint16)
    padded = np.pad(height, reach, constant_values=np.nan)
    rows, columns = height.shape
    for dr, dc in offsets:
        other = padded[reach + dr : reach + dr + rows, reach + dc : reach + dc + columns]
        with np.errstate(invalid="ignore"):
            neighbours += np.abs(other - height) <= radius
    known = np.isfinite(height)
    needed = max(2, int(round(_SHARE * float(np.median(neighbours[known]))))) if known.any() else 2
    return known & (neighbours < needed), needed
