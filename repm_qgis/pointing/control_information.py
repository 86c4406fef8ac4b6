"""How well ground control points determine a shift of the whole ground: their weight against other references."""

from __future__ import annotations

from typing import Collection, Sequence

import numpy as np

from ..contracts.arrays import FloatArray
from ..geometry.frames import EnuFrame
from ..scene import View
from .ground_control import Gcp


def control_information(
    gcps: Sequence[Gcp], rejected: Collection[str], views: Sequence[View], noise_px: float
) -> FloatArray:
    """(3, 3) information of a shift to the east, to the north and up, 1 / m²: its inverse is the shift's covariance.

    Each measured pixel of a control point observes the point's place with ``noise_px`` in each direction; ``rejected``
    points do not count.
    """
    information = np.zeros((3, 3))
    for gcp in gcps:
        if gcp.role != "control" or gcp.id in rejected:
            continue
        frame = EnuFrame(gcp.lon, gcp.lat, gcp.height)
        steps = frame.to_geodetic(np.vstack([np.eye(3), -np.eye(3)]))
        for view in views:
            if view.name in gcp.pixels:
                pixels = view.project(steps)
                derivatives = (pixels[:3] - pixels[3:]).T / 2.0
                information += derivatives.T @ derivatives / noise_px**2
    return information
