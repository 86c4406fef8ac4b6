"""Where a height comes from, and its likely error: what the confidence raster states.

A height of the surface is supported by its cell's maps if it agrees with theirs within their noise; then it has their
number, their spread and their score. Otherwise it comes from the ground behind an occlusion or in a shadow, or from
neighbouring cells, and no map supports it. Each source has its own error model, from comparisons with true surfaces
(docs/method.md#confidence).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Iterable, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, Mask
from ..imagery.confidence import Provenance
from .aggregation import Candidate, FusedCells
from .parameters import FUSION, ErrorParameters, EvidenceParameters
from .surroundings import extremes


@dataclass(frozen=True)
class SurfaceCells:
    """The finished heights of cells, (H, W) each: ``height`` (m, NaN = none), the ``count`` of height maps that agree,
    their ``spread`` (m) and mean ``score`` (NaN where no map has the height), the ``source`` (:class:`.Provenance`) and
    the ``error`` and the ``le90`` within which about two thirds and nine tenths of such heights are right (m)."""

    height: FloatImage
    count: FloatImage
    spread: FloatImage
    score: FloatImage
    source: FloatImage
    error: FloatImage
    le90: FloatImage

    @classmethod
    def of(cls, arrays: Iterable[FloatImage]) -> SurfaceCells:
        """From the arrays of all fields, in their order."""
        return cls(**dict(zip((field.name for field in fields(cls)), arrays)))

    def facts(self) -> Tuple[FloatImage, ...]:
        """The confidence raster's bands, in their order."""
        return self.count, self.spread, self.score, self.source, self.error, self.le90


def described(
    fused: FusedCells,
    ground: FloatImage,
    height: FloatImage,
    reach: int,
    far: int,
    evidence: EvidenceParameters = FUSION.evidence,
    parameters: ErrorParameters = FUSION.error,
) -> SurfaceCells:
    """The surface with the chosen heights (H, W), m, of cells with these candidates.

    ``ground`` (H, W) is that of shadows, NaN = none. The error of a height that no map supports follows from the relief
    within ``reach`` cells, the LE90 of a matched one also from what lies within ``far`` cells. Pointing errors, which
    all cells share, are not included: the report states them.
    """
    nothing = np.full(height.shape, np.nan, np.float32)
    count, spread, score, source, error, le90 = (nothing.copy() for _ in range(6))
    known = np.isfinite(height)
    relief = _relief(height, known, reach)
    steps = np.float32(parameters.of_relief) * np.minimum(relief, np.float32(parameters.relief_m))
    unsure = ((Provenance.NEIGHBOURS, parameters.of_neighbours), (Provenance.SHADOW, parameters.of_shadow))
    kinds = [(known, unsure[0]), (known & (np.abs(height - ground) <= evidence.ground_m), unsure[1])]
    for each in (fused.second, fused.first):
        behind = each.filled & _supported(each, height, evidence)
        kinds.append((behind, (Provenance.BACKGROUND, parameters.of_background)))
    for cells, (kind, share) in kinds:
        least = parameters.least_shadow_m if kind == Provenance.SHADOW else parameters.least_m
        source[cells], error[cells] = kind, (least + share * relief)[cells]
    for each in (fused.second, fused.first):
        cells = (each.count > 0) & _supported(each, height, evidence)
        count[cells], spread[cells], score[cells] = each.count[cells], each.spread[cells], each.score[cells]
        source[cells] = Provenance.MATCHED
        # Heights that other maps contradict are less certain.
        agree = each.evidence[cells] / np.maximum(fused.evidence, each.evidence)[cells]
        own = np.float32(parameters.of_sigma) * each.sigma[cells] / (agree * np.sqrt(each.count[cells]))
        apart = np.nan_to_num(each.spread[cells]), height[cells] - each.height[cells]
        error[cells] = np.hypot(np.hypot(own, steps[cells]), np.hypot(*apart))
    le90[known] = np.float32(parameters.le90_of_others) * error[known]
    tails = _Tails.around(
        height, known, source == Provenance.MATCHED, count, reach=reach, far=far, parameters=parameters
    )
    for each, other in ((fused.second, fused.first), (fused.first, fused.second)):
        cells = (each.count > 0) & _supported(each, height, evidence)
        tail = tails.deviation(height, each, other, fused.evidence)
        le90[cells] = (tails.factor * np.hypot(parameters.le90_of_error * error, tail))[cells]
        error[cells] = np.hypot(error, parameters.of_tail * tail)[cells]
    return SurfaceCells(height, count, spread, score, source, error, le90)


@dataclass(frozen=True)
class _Tails:
    """Why an error of a matched height may be gross, (H, W) each: the ``scale`` of such errors (m), which is the relief
    around, up to some metres; the share of the cells beside it that are not matched (``holes``); and the share of the
    maps with heights nearby that is ``lacking``."""

    scale: FloatImage
    holes: FloatImage
    lacking: FloatImage
    parameters: ErrorParameters

    @classmethod
    def around(
        cls,
        height: FloatImage,
        known: Mask,
        matched: Mask,
        count: FloatImage,
        *,
        reach: int,
        far: int,
        parameters: ErrorParameters,
    ) -> _Tails:
        """Of a surface (see :func:`described`) and the ``count`` of maps that have its heights."""
        side = 2 * reach + 1
        scale = np.minimum(_relief(height, known, far), np.float32(parameters.tail_m))
        holes = cv2.boxFilter((~matched).astype(np.float32), -1, (side, side), normalize=False) / np.float32(side**2)
        enough = np.minimum(np.nan_to_num(count), np.float32(parameters.enough_maps))
        most = cv2.dilate(enough, np.ones((2 * far + 1, 2 * far + 1), np.uint8))
        return cls(scale, holes, 1 - enough / np.maximum(most, np.float32(1)), parameters)

    @property
    def factor(self) -> FloatImage:
        """(H, W) how many times larger errors are, where maps with heights nearby have none here."""
        return np.float32(1) + np.float32(self.parameters.tail_lacking) * self.lacking

    def deviation(self, height: FloatImage, own: Candidate, other: Candidate, evidence: FloatImage) -> FloatImage:
        """(H, W) the deviation, m, that gross errors add to the heights of a candidate; ``evidence`` is that of all
        maps.

        Errors are a mixture: a core, and a tail of gross errors that a share of the heights has (Huber 1981, "Robust
        Statistics"). More have them beside steps and holes, where a single map has the height, and where maps
        contradict each other.
        """
        p, maps = self.parameters, np.maximum(own.count, np.float32(1))
        beside = np.clip(2 - 2 * own.evidence / maps, 0, 1)
        against = 1 - own.evidence / np.maximum(np.maximum(evidence, own.evidence), np.float32(1e-6))
        apart = np.minimum(np.abs(np.nan_to_num(other.height - height)), np.float32(p.tail_m))
        share = (p.tail_beside * beside) ** 2 + (p.tail_holes * self.holes) ** 2 + p.tail_alone**2 / maps
        square = share * self.scale**2 / maps + (p.tail_against * against * apart) ** 2
        return np.asarray(np.sqrt(square), np.float32)


def _supported(candidate: Candidate, height: FloatImage, parameters: EvidenceParameters) -> Mask:
    with np.errstate(invalid="ignore"):
        result: Mask = np.abs(height - candidate.height) <= np.float32(parameters.same) * candidate.sigma
    return result


def _relief(height: FloatImage, known: Mask, reach: int) -> FloatImage:
    """(H, W) the difference between the highest and the lowest height around each cell, m."""
    low, high = extremes(height, known, reach)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.where(known, high - low, np.float32(np.nan))
