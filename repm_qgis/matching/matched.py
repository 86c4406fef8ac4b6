"""What a matcher gives, whichever backend it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Matched:
    """Disparities of a rectified first image, all (H, W).

    ``disparity`` in px, first column minus second column, NaN where there is none. ``score`` the correlation of the
    matched neighbourhoods, 0..1, NaN where nothing was matched. ``filled`` says which disparities were not matched
    but taken from the background beside an occlusion.
    """

    disparity: NDArray[np.float32]
    score: NDArray[np.float32]
    filled: NDArray[np.bool_]
