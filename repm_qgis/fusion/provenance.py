"""Where a height comes from, and its likely error: what the confidence raster states.

A height of the surface is supported by its cell's maps if it agrees with theirs within their noise; then it has their
number, their spread and their score. Otherwise it comes from the ground behind an occlusion or in a shadow, or from
neighbouring cells, and no map supports it. Each source has its own error model, from comparisons with true surfaces
(docs/method.md#confidence).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Iterable, Tuple

import numpy as np

from ..contracts.arrays import FloatImage, Mask
from ..imagery.confidence import Provenance
from ..numerics.accuracy import LE90
from .aggregation import Candidate, FusedCells
from .parameters import FUSION, ErrorParameters, EvidenceParameters
from .surroundings import extremes


@dataclass(frozen=True)
class SurfaceCells:
    """The finished heights of cells, (H, W) each: ``height`` (m, NaN = none), the ``count`` of height maps that agree,
    their ``spread`` (m) and mean ``score`` (NaN where no map has the height), the ``source`` (:class:`.Provenance`) and
    the ``error`` within which about two thirds of such heights are right (m)."""

    height: FloatImage
    count: FloatImage
    spread: FloatImage
    score: FloatImage
    source: FloatImage
    error: FloatImage

    @classmethod
    def of(cls, arrays: Iterable[FloatImage]) -> SurfaceCells:
        """From the arrays of all fields, in their order."""
        return cls(**dict(zip((field.name for field in fields(cls)), arrays)))

    def facts(self) -> Tuple[FloatImage, ...]:
        """The confidence raster's bands, in their order."""
        return self.count, self.spread, self.score, self.source, self.error, np.float32(LE90) * self.error


def described(
    fused: FusedCells,
    ground: FloatImage,
    height: FloatImage,
    reach: int,
    evidence: EvidenceParameters = FUSION.evidence,
    parameters: ErrorParameters = FUSION.error,
) -> SurfaceCells:
    """The surface with the chosen heights (H, W), m, of cells with these candidates.

    ``ground`` (H, W) is that of shadows, NaN = none. The error of a height that no map supports follows from the relief
    within ``reach`` cells. Pointing errors, which all cells share, are not included: the report states them.
    """
    nothing = np.full(height.shape, np.nan, np.float32)
    count, spread, score, source, error = (nothing.copy() for _ in range(5))
    known = np.isfinite(height)
    relief = _relief(height, known, reach)
    steps = np.float32(parameters.of_relief) * np.minimum(relief, np.float32(parameters.relief_m))
    unsure = ((Provenance.NEIGHBOURS, parameters.of_neighbours), (Provenance.SHADOW, parameters.of_shadow))
    kinds = [(known, unsure[0]), (known & (np.abs(height - ground) <= evidence.ground_m), unsure[1])]
    for each in (fused.second, fused.first):
        behind = each.filled & _supported(each, height, evidence)
        kinds.append((behind, (Provenance.BACKGROUND, parameters.of_background)))
    for cells, (kind, share) in kinds:
        source[cells], error[cells] = kind, (parameters.least_m + share * relief)[cells]
    for each in (fused.second, fused.first):
        cells = (each.count > 0) & _supported(each, height, evidence)
        count[cells], spread[cells], score[cells] = each.count[cells], each.spread[cells], each.score[cells]
        source[cells] = Provenance.MATCHED
        # Heights that other maps contradict are less certain.
        agree = each.evidence[cells] / np.maximum(fused.evidence, each.evidence)[cells]
        own = np.float32(parameters.of_sigma) * each.sigma[cells] / (agree * np.sqrt(each.count[cells]))
        apart = np.nan_to_num(each.spread[cells]), height[cells] - each.height[cells]
        error[cells] = np.hypot(np.hypot(own, steps[cells]), np.hypot(*apart))
    return SurfaceCells(height, count, spread, score, source, error)


def _supported(candidate: Candidate, height: FloatImage, parameters: EvidenceParameters) -> Mask:
    with np.errstate(invalid="ignore"):
        result: Mask = np.abs(height - candidate.height) <= np.float32(parameters.same) * candidate.sigma
    return result


def _relief(height: FloatImage, known: Mask, reach: int) -> FloatImage:
    """(H, W) the difference between the highest and the lowest height around each cell, m."""
    low, high = extremes(height, known, reach)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.where(known, high - low, np.float32(np.nan))
