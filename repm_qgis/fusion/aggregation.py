"""One height for each cell from several height maps (paper, "DSMs aggregation").

Where the maps agree, their mean is the height. Where they do not, heights within each other's noise form groups, and
one group is chosen. Matching widens what stands up (a window at a roof's edge contains the roof's texture), so that at
true steps the lower group is right; but a failed match also leaves a lower height. Three facts separate the two, all
taken from the tile itself: the rank of a height's matching score among the cells where the maps agree, whether the
agreed surface nearby has that height, and how often backgrounds of occlusions are confirmed where others were matched.
At last all maps are heard about the chosen heights: what they look through is replaced (``sight_lines.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import ByteImage, Floats, IntArray, Mask
from .parameters import FUSION, FusionParameters
from .sight_lines import Counts, Witnesses

_DIRECTIONS = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))


@dataclass(frozen=True)
class HeightLayer:
    """A height map on the cells: ``height`` (m, NaN = not matched) with its ``score``, ``background`` (m, NaN = none)
    where an occlusion hides the cell, and the height of one px of disparity. ``partial`` cells are covered by matched
    points to less than half, ``partial_background`` by the background's (None: no cells are)."""

    height: Floats
    score: Floats
    background: Floats
    metres_per_px: float
    partial: Optional[Mask] = None
    partial_background: Optional[Mask] = None


@dataclass(frozen=True)
class FusedCells:
    """Fused cells, all of one shape: ``height`` (m, NaN = none), ``count`` of height maps that agree, ``spread`` (m)
    between them (NaN for one alone), mean matching ``score``, and which cells are ``filled`` from the background."""

    height: Floats
    count: ByteImage
    spread: Floats
    score: Floats
    filled: Mask

    def without(self, cells: Mask) -> FusedCells:
        """The same with no heights in some cells."""
        height, spread, score = (np.where(cells, np.nan, values) for values in (self.height, self.spread, self.score))
        return FusedCells(height, np.where(cells, 0, self.count).astype(np.uint8), spread, score, self.filled & ~cells)

    def with_background(self, height: Floats) -> FusedCells:
        """The same where a background (m, NaN = none) replaces what cells have."""
        cells = np.isfinite(height)
        own = self.without(cells)
        return FusedCells(np.where(cells, height, self.height), own.count, own.spread, own.score, self.filled | cells)


def aggregate(
    layers: Sequence[HeightLayer],
    method: str,
    parameters: FusionParameters = FUSION,
    witnesses: Optional[Witnesses] = None,
) -> FusedCells:
    """Fuse height maps cell by cell. Maps that cover a part of a cell do not count where another covers more of it.

    ``method`` is ``mean`` or ``median`` of the heights that agree, weighted by metres_per_px ** -0.5 in both.
    ``witnesses`` are the maps that tell whether they look through a height; None asks nobody.
    """
    heights, scores, backgrounds = (
        np.stack([getattr(layer, name) for layer in layers]).astype(np.float32)
        for name in ("height", "score", "background")
    )
    metres = np.array([layer.metres_per_px for layer in layers])
    if len(layers) > 1:
        _drop_partial(layers, heights)
        if _Votes(heights, scores, backgrounds, metres, parameters).check_backgrounds()[1]:
            _drop_partial(layers, heights, backgrounds)
    backgrounds[np.isfinite(heights)] = np.nan
    return _Votes(heights, scores, backgrounds, metres, parameters).fused(method, witnesses)


def _drop_partial(layers: Sequence[HeightLayer], heights: Floats, backgrounds: Optional[Floats] = None) -> None:
    """Set heights NaN that cover a part of their cell only, where another map, or a background, covers the cell."""
    covered = np.zeros(heights.shape[1:], dtype=bool)
    for number, layer in enumerate(layers):
        values, partial = (heights, layer.partial) if backgrounds is None else (backgrounds, layer.partial_background)
        covered |= np.isfinite(values[number]) if partial is None else np.isfinite(values[number]) & ~partial
    for layer, height in zip(layers, heights):
        if layer.partial is not None:
            height[layer.partial & covered] = np.nan


class _Votes:
    """The heights of all cells in all maps, (maps, H, W), and in which cells all maps agree."""

    def __init__(
        self, heights: Floats, scores: Floats, backgrounds: Floats, metres: Floats, parameters: FusionParameters
    ) -> None:
        self._p, self._step_px, self._sight = parameters.aggregation, parameters.step_px, parameters.sight_lines
        self.heights, self.scores, self.backgrounds = heights, np.nan_to_num(scores), backgrounds
        self.matched, self.sigma = np.isfinite(heights), (self._p.sigma_px * metres).astype(np.float32)
        self.weights = (metres**-self._p.weight_power).astype(np.float32)
        self.mean, self.count = self._mean(self.matched), self.matched.sum(axis=0, dtype=np.uint8)
        self.agreed = (self.count >= 2) & self._within(self.mean)
        self._usual_scores: Optional[List[Floats]] = None

    def _mean(self, members: Mask) -> Floats:
        total, value = np.zeros((2, *members.shape[1:]), np.float32)
        for height, member, weight in zip(self.heights, members, self.weights):
            total += weight * member
            value += np.where(member, weight * height, np.float32(0))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(total > 0, value / total, np.float32(np.nan))

    def _within(self, centre: Floats) -> Mask:
        """Whether the matched heights of all maps mean the same surface as the centre."""
        result: Mask = np.ones(centre.shape, dtype=bool)
        for height, matched, sigma in zip(self.heights, self.matched, self.sigma):
            with np.errstate(invalid="ignore"):
                result &= ~matched | (np.abs(height - centre) <= self._p.tolerance * sigma)
        return result

    def fused(self, method: str, witnesses: Optional[Witnesses]) -> FusedCells:
        """The heights of all cells: agreed ones first, then those of one map, then those in conflict; then witnesses
        are heard."""
        members = self.matched.copy()
        hidden: Mask = np.isfinite(self.backgrounds).any(axis=0)
        clear = self.agreed | (self.count == 1) & ~hidden
        height = np.where(clear, self.mean, np.float32(np.nan))
        filled = np.zeros(height.shape, dtype=bool)

        def decide(cells: IntArray) -> None:
            if cells.size:
                chosen, values, from_background = self._resolve(cells)
                members.reshape(len(members), -1)[:, cells] = chosen
                height.ravel()[cells] = values
                filled.ravel()[cells] = from_background

        decide(np.flatnonzero(~clear & ((self.count > 0) | hidden)))
        contested = np.zeros(height.shape, dtype=bool)
        if witnesses is not None:
            contested.ravel()[self._heard(witnesses, height, decide)] = True
        if method == "median" and len(self.heights) > 2:
            several = members.sum(axis=0) > 2
            height[several] = _weighted_median(self.heights[:, several], self.weights[:, None] * members[:, several])
        return self._with_facts(height, members, filled).without(contested)

    def _heard(self, witnesses: Witnesses, height: Floats, decide: Callable[[IntArray], None]) -> IntArray:
        """Replace heights that the maps look through by what is left without them; the cells of those that as many
        maps look through as see them, in the end."""
        seen, seen_through = np.zeros((2, height.size), np.int16)
        asked = np.flatnonzero(np.isfinite(height))
        for _ in range(self._sight.rounds):
            seen[asked], seen_through[asked] = witnesses.counts(asked, height.ravel()[asked])
            asked = asked[self._outvoted(seen[asked], seen_through[asked])]
            if not asked.size:
                break
            self._take_away(asked, height.ravel()[asked])
            decide(asked)
            seen[asked] = seen_through[asked] = 0
            asked = asked[np.isfinite(height.ravel()[asked])]
        seen[asked], seen_through[asked] = witnesses.counts(asked, height.ravel()[asked])
        return np.flatnonzero((seen_through > 0) & (seen_through >= seen))

    def _outvoted(self, seen: Counts, seen_through: Counts) -> Mask:
        """Whether a height is replaced: one map that looks through it may be wrong, against one that sees it."""
        few: Mask = (seen_through >= self._sight.outvoting) & (2 * seen_through > seen)
        return few | (seen_through > seen)

    def _take_away(self, cells: IntArray, height: Floats) -> None:
        """Remove what all maps have at these heights (m) of N cells, matched or behind an occlusion."""
        self.agreed.ravel()[cells] = False
        parts = (part.reshape(len(self.heights), -1) for part in (self.heights, self.backgrounds, self.matched))
        for own, background, matched, sigma in zip(*parts, self.sigma):
            reach = self._sight.through_px * sigma / self._p.sigma_px
            for values in (own, background):
                with np.errstate(invalid="ignore"):
                    values[cells[np.abs(values[cells] - height) <= reach]] = np.nan
            matched[cells] = np.isfinite(own[cells])

    def _with_facts(self, height: Floats, members: Mask, filled: Mask) -> FusedCells:
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
        return FusedCells(height, count, spread, score, filled)

    def _resolve(self, cells: IntArray) -> Tuple[Mask, Floats, Mask]:
        """For (N,) cells in conflict: (maps, N) matched heights that count, the heights, and which are backgrounds."""
        contradicted, confirmed = self.check_backgrounds()
        count = len(self.heights)
        heights, backgrounds = (stack.reshape(count, -1)[:, cells] for stack in (self.heights, self.backgrounds))
        known = self.matched.reshape(count, -1)[:, cells]
        matched = known & self._supported_by_neighbours(cells)
        matched |= ~matched.any(axis=0) & known
        groups = self._groups(np.where(matched, heights, backgrounds), matched, self._ranks(cells))
        nearby = self._nearby(cells, np.where(self.agreed & ~contradicted, self.mean, np.float32(np.nan)))
        winner = self._winner(groups, self._directions(groups.height, nearby), confirmed)
        everyone = np.arange(len(cells))
        members = groups.members[winner, :, everyone].T & matched
        height = groups.height[winner, everyone]
        return members, height, np.isfinite(height) & ~members.any(axis=0)

    def check_backgrounds(self) -> Tuple[Mask, bool]:
        """Cells where a background contradicts two or more maps, and whether most backgrounds of the tile are right."""
        contradicted, checked = np.zeros(self.agreed.shape, dtype=bool), 0
        for background, sigma in zip(self.backgrounds, self.sigma):
            tolerance = self._p.tolerance * math.hypot(sigma, self.sigma.min())
            with np.errstate(invalid="ignore"):
                contradicted |= self.agreed & (np.abs(background - self.mean) > tolerance)
            checked += int((self.agreed & np.isfinite(background)).sum())
        right = checked - int(contradicted.sum())
        return contradicted, checked < self._p.agreed_cells or right >= self._p.confirmed * checked

    def _ranks(self, cells: IntArray) -> Floats:
        """(maps, N) shares of the agreed cells whose score is no higher: comparable between scenes."""
        if self._usual_scores is None:
            self._usual_scores = [np.sort(score[self.agreed & own]) for score, own in zip(self.scores, self.matched)]
        ranks = np.ones((len(self.scores), len(cells)), np.float32)
        for rank, score, usual in zip(ranks, self.scores, self._usual_scores):
            if usual.size >= self._p.agreed_cells:
                rank[:] = np.searchsorted(usual, score.ravel()[cells], side="right") / usual.size
        return ranks

    def _supported_by_neighbours(self, cells: IntArray) -> Mask:
        """(maps, N) whether enough neighbours in its own map have a height's surface: gross errors have few."""
        width = self.mean.shape[1] + 2
        row, column = np.divmod(cells, self.mean.shape[1])
        place = (row + 1) * width + column + 1
        result = np.zeros((len(self.heights), len(cells)), dtype=bool)
        for supported, heights, sigma in zip(result, self.heights, self.sigma):
            tolerance = self._p.tolerance * self._p.neighbour_tolerance * sigma
            padded = np.pad(heights, 1, constant_values=np.nan).ravel()
            count = np.zeros(len(cells), np.int8)
            for dr, dc in _DIRECTIONS:
                with np.errstate(invalid="ignore"):
                    count += np.abs(padded[place + dr * width + dc] - padded[place]) <= tolerance
            supported[:] = count >= self._p.neighbours
        return result

    def _groups(self, values: Floats, matched: Mask, ranks: Floats) -> _Groups:
        known = np.isfinite(values)
        shape = values.shape
        height, rank = np.full(shape, np.nan, np.float32), np.zeros(shape, np.float32)
        votes, support = np.zeros(shape, np.int16), np.zeros(shape, np.float32)
        members = np.zeros((len(values),) + shape, dtype=bool)
        for i, sigma in enumerate(self.sigma):
            tolerance = self._p.tolerance * np.hypot(self.sigma, sigma)[:, None]
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
        metres = (self.sigma / np.float32(self._p.sigma_px))[None, :, None]
        return _Groups(height, votes, support, rank, members, np.where(members, metres, np.inf).min(axis=1))

    def _nearby(self, cells: IntArray, surface: Floats) -> List[Floats]:
        """The nearest agreed height in each of eight directions, (N,) each; NaN where none is within reach."""
        rim = self._p.reach_cells
        width = surface.shape[1] + 2 * rim
        padded = np.pad(surface, rim, constant_values=np.nan).ravel()
        row, column = np.divmod(cells, surface.shape[1])
        place = (row + rim) * width + column + rim
        result = []
        for dr, dc in _DIRECTIONS:
            found = np.full(len(cells), np.nan, np.float32)
            todo = np.arange(len(cells))
            for distance in range(1, rim + 1):
                value = padded[place[todo] + distance * (dr * width + dc)]
                found[todo] = value
                todo = todo[np.isnan(value)]
            result.append(found)
        return result

    def _directions(self, heights: Floats, nearby: Sequence[Floats]) -> NDArray[np.int16]:
        """In how many directions the agreed surface has a group's height."""
        tolerance = self._p.tolerance * math.sqrt(2) * float(self.sigma.min())
        result = np.zeros(heights.shape, np.int16)
        for near in nearby:
            with np.errstate(invalid="ignore"):
                result += np.abs(heights - near) <= tolerance
        return result

    def _winner(self, groups: _Groups, directions: NDArray[np.int16], confirmed: bool) -> NDArray[np.intp]:
        """(N,) which group a cell takes: the lowest that is credible, else the one with most support."""
        most = groups.votes.max(axis=0)
        least_rank = np.where(most >= 2, self._p.rank_outvoted, self._p.rank_single)
        least_rank = np.where(directions > 0, least_rank, self._p.rank_unsupported)
        least_rank[2 * groups.votes >= np.maximum(most, 4)] = 0.0
        known = np.isfinite(groups.height)
        credible = known & (groups.votes > 0) & (3 * groups.votes > most) & (groups.rank >= least_rank)
        if confirmed:
            supported = directions >= self._p.background_directions
            credible |= known & (groups.votes == 0) & supported & self._unrivalled(groups, most)
        order = 1000.0 * (groups.votes > 0) + 100.0 * groups.support + 50.0 * groups.rank + directions
        order = np.where(credible, 1e6 - np.nan_to_num(groups.height), order)
        winner: NDArray[np.intp] = np.where(known, order, -np.inf).argmax(axis=0)
        return winner

    def _unrivalled(self, groups: _Groups, most: NDArray[np.int16]) -> Mask:
        """(maps, N) whether a group of backgrounds may be chosen against what was matched.

        Against a single map it may, unless more maps than its own have the matched height; and also where the step
        between the two is too small for all of those to see, but not for the map that the background is from.
        """
        maps = 2 * groups.support - groups.votes
        alone: Mask = (most <= 1) & (maps >= np.where(groups.votes > 0, maps, 0).max(axis=0))
        top = np.where(groups.votes == most, groups.height, -np.inf).argmax(axis=0)
        everyone = np.arange(len(top))
        with np.errstate(invalid="ignore"):
            step = (groups.height[top, everyone] - groups.height) / self._step_px
            small: Mask = (step >= groups.metres) & (step < groups.metres[top, everyone])
        return alone | small


@dataclass(frozen=True)
class _Groups:
    """For the height of each map in each cell, (maps, N), the group of those that mean the same surface: its
    ``height``, ``votes`` of maps that were matched, ``support`` (backgrounds count half), best ``rank``, ``members``,
    and the least ``metres`` of height that one px of disparity has in its members."""

    height: Floats
    votes: NDArray[np.int16]
    support: Floats
    rank: Floats
    members: Mask
    metres: Floats


def _weighted_median(stack: Floats, weight: Floats) -> Floats:
    """Weighted median along the first axis: where the weights below and above balance, linear between.

    With two values that is their weighted mean, with equal weights the ordinary median.
    """
    order = np.argsort(np.where(weight > 0, stack, np.inf), axis=0)
    values, weights = np.take_along_axis(stack, order, axis=0), np.take_along_axis(weight, order, axis=0)
    total = weights.sum(axis=0)
    # Each value sits in the middle of its own weight on the cumulative axis.
    middle = weights.cumsum(axis=0) - weights / 2
    half = total / 2
    result = np.where(total > 0, values[0], np.nan)
    for k in range(1, len(stack)):
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.clip((half - middle[k - 1]) / (middle[k] - middle[k - 1]), 0.0, 1.0)
        within = (weights[k] > 0) & (half > middle[k - 1])
        result = np.where(within, values[k - 1] + share * (values[k] - values[k - 1]), result)
    return result
