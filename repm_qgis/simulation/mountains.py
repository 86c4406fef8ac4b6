"""Mountains for truth scenes: ridges and valleys, rock, meadows, woods and snow.

Meadows and snow have little texture. The numbers below are heights and albedos of what covers the ground.
"""

from __future__ import annotations

import numpy as np

from ..runtime.progress import Progress
from .surface import Ground, fractal, slopes


def build_mountains(ground: Ground, base: float, relief: float, seed: int, progress: Progress) -> None:
    """Mountains from ``base`` to ``base + relief`` metres; the same arguments give the same mountains."""
    rng = np.random.default_rng([seed, 1])
    cell = ground.cell
    shape = ground.height.shape
    extent = cell * max(shape)
    progress.step(0.1, "raising the mountains")
    # Large scenes have tens of millions of nodes, so every raster is deleted as soon as it is no longer needed.
    share = np.abs(fractal(rng, shape, cell, extent / 2.0, extent / 40))
    share *= np.float32(-0.64)
    share += fractal(rng, shape, cell, extent / 1.5, 0.0, 1.25)
    share -= share.min()
    share /= share.max()
    progress.check_cancelled()
    height = ground.height
    np.multiply(share, np.float32(relief), out=height)
    height += np.float32(base)
    rock = np.hypot(*slopes(height, cell, False))
    rock /= np.median(rock)
    progress.step(0.4, "covering the ground with rock, woods and snow")
    progress.check_cancelled()
    fine = fractal(rng, shape, cell, 12 * cell, 0.0, 0.3)
    broad = fractal(rng, shape, cell, extent / 6, 8 * cell, 0.5)
    # Half the ground is rock, whatever the relief: it starts where the slope passes its median.
    rock = np.clip((rock + 0.3 * broad - 1.0) / 0.35, 0, 1)
    wood = np.clip((broad - 0.35) / 0.2, 0, 1) * (1 - rock) * np.clip((0.6 - share) / 0.1, 0, 1)
    snow = np.clip((share + 0.05 * broad - 0.74) / 0.03, 0, 1) * (1 - 0.8 * rock)
    del share
    height += 0.35 * cell * fine * rock
    height += 1.6 * wood * np.maximum(fine + 0.3, 0)
    albedo = 0.115 + 0.012 * broad + 0.007 * fine
    del broad
    albedo += rock * (0.07 + 0.035 * fine)
    albedo += wood * (0.02 * fine - 0.055)
    albedo += snow * (0.36 - albedo + 0.004 * fine)
    del rock, wood, snow, fine
    np.clip(albedo, 0.02, 0.6, out=ground.albedo)
