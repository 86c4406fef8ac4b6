"""Room around altitude ranges: every range is found from something that misses the tops of buildings and masts."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.arrays import Altitudes
from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class AltitudeParameters(Parameters):
    """How far each altitude range is widened, m: a margin on both sides, and more above for what was missed.

    A margin is the greater of ``*_margin_m`` and ``*_margin_share`` of the range. All values are chosen: a range that
    is too narrow loses buildings, a wider one costs time. A storey is about 3 m high.
    """

    sweep_margin_m: float = 15.0  # plane sweep over strongly reduced images: accurate to some 10 m
    sweep_margin_share: float = 0.1
    sweep_margin_planes: float = 1.5  # distances between two planes
    sweep_above_m: float = 25.0  # its cells of several metres do not show a building of eight storeys
    dem_margin_m: float = 20.0  # a DEM may be years older than the images
    dem_margin_share: float = 0.05
    dem_above_m: float = 40.0  # terrain models hold no buildings at all
    ground_margin_m: float = 15.0  # tie points or the coarse surface of a tile
    ground_margin_share: float = 0.1
    ground_above_m: float = 30.0  # towers are few, and SIFT prefers points on the ground
    prior_above_m: float = 40.0  # the coarse level of matching loses masts and narrow towers
    patch_m: float = 30.0  # below and above the tie points of a patch, for the cameras of COLMAP's adjustment

    def around_sweep(self, low: float, high: float, step_m: float) -> Altitudes:
        """The range of a plane sweep with planes every ``step_m``, widened."""
        margin = max(self.sweep_margin_m, self.sweep_margin_planes * step_m, self.sweep_margin_share * (high - low))
        return float(low - margin), float(high + margin + self.sweep_above_m)

    def around_dem(self, low: float, high: float) -> Altitudes:
        """The range of a DEM, widened."""
        margin = max(self.dem_margin_m, self.dem_margin_share * (high - low))
        return float(low - margin), float(high + margin + self.dem_above_m)

    def around_ground(self, low: float, high: float) -> Altitudes:
        """The range of tie points or of a coarse surface, widened."""
        margin = max(self.ground_margin_m, self.ground_margin_share * (high - low))
        return float(low - margin), float(high + margin + self.ground_above_m)


ALTITUDES = AltitudeParameters()
