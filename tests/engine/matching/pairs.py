"""Pairs at the resolution of the coarse level, for tests that have the whole images."""

from __future__ import annotations

from repm_qgis.imagery.warping import reduced
from repm_qgis.matching.disparity_prior import ReducedPair
from repm_qgis.matching.parameters import MATCHING


def reduced_pair(first, second, disparities):
    """A pair reduced as the coarse level has it; the disparities are whole multiples of the reduction."""
    factor = MATCHING.prior.factor
    low, high = (end // factor for end in disparities)
    return ReducedPair(reduced(first, factor), reduced(second, factor), (low, high))
