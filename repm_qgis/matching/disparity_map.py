"""What a matcher of rectified pairs takes and gives, whichever matcher it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Tuple

from ..arrays import FloatImage, Mask


@dataclass(frozen=True)
class DisparityMap:
    """Disparities of a rectified first image, all (H, W).

    ``disparity`` in px, first column minus second column, NaN where there is none. ``score`` is the correlation of the
    matched neighbourhoods, 0..1, NaN where nothing was matched. ``filled`` marks disparities that were not matched but
    taken from the background beside an occlusion.
    """

    disparity: FloatImage
    score: FloatImage
    filled: Mask


class PairMatcher(Protocol):
    """A function of a module (worker processes import it by its name) that matches a rectified pair."""

    def __call__(
        self, first: FloatImage, second: FloatImage, disparities: Tuple[int, int], nearer: float, lean: float = 0.0
    ) -> DisparityMap:
        """Disparities of a rectified pair.

        Parameters
        ----------
        first : (H, W) brightness in 0..1, NaN where there is none.
        second : (H, W + high - low), brightness whose column c shows the rectified column c - high.
        disparities : low, high: whole px, least and greatest first column minus second column.
        nearer : +1 if greater disparities are higher ground, -1 if lower.
        lean : by how many columns the first image moves what rises by one px of disparity (0: it looks straight down).
        """
