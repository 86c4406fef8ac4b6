"""Choices of the simulation. They change the images, so equal values and an equal seed give equal bytes.

Where no source is named, a value was chosen so that images look like those of real sensors; it was not measured. What
stands on a lot of the town, and which albedo rock, wood and snow have, is written where it is built.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

from ..contracts.parameters import Parameters
from ..rpc.parameters import RpcFitParameters


@dataclass(frozen=True)
class LightParameters(Parameters):
    """Sunlight, and the digital numbers (12 bits) that a camera makes of it."""

    haze_dn: float = 120.0  # light that the air scatters into the camera
    sun_dn: float = 5200.0  # what a white, flat surface that faces the sun reflects
    sky_share: float = 0.22  # light of the open sky, as a share of the sun's
    penumbra_m: float = 0.3  # height over which a shadow turns to light: the sun is a disc, a crisp edge would alias
    sky_window_m: float = 12.0  # surroundings that can hide the sky from a place
    sky_loss_per_m: float = 0.035  # share of the sky lost for each metre that the surroundings stand higher
    least_sky: float = 0.35  # share of the sky that the deepest place sees
    wall_albedo: float = 0.3  # of walls without an albedo of their own; they see half the sky
    window_tone: float = 0.55  # radiance of windows, as a share of the wall's
    storey_m: Tuple[float, float] = (3.0, 1.2)  # height of a storey, and of the wall below its windows
    window_m: Tuple[float, float] = (2.6, 1.3)  # from window to window, and the wall between them
    sun_disc_deg: Optional[float] = None  # the sun's diameter, which softens long shadows more; None: ``penumbra_m``


@dataclass(frozen=True)
class RenderParameters(Parameters):
    """Casting of rays, and exposure."""

    oversample: int = 2  # rays a pixel along each axis
    strip_rows: int = 256  # rows that are finished together, with noise of their own: the height of a file's tiles
    chunk_cols: int = 256  # columns of which the rays are cast together
    node_px: int = 64  # spacing of exact rays; cubic splines between them are within 1e-4 px
    nodes_per_wave: int = 24  # the same along the lines of a view with jitter, for its shortest period
    halo_px: int = 3  # reach of the point spread
    coarse_cells: int = 8  # side of a cell of the coarse maxima, and sub-pixels between coarse rays
    wall_hit_m: float = 0.3  # a hit so far below the surface there is on a wall
    bisections: int = 6  # halvings of the last step, of half a cell


@dataclass(frozen=True)
class VendorParameters(Parameters):
    """What is wrong with a vendor's RPC, and for which heights it is made."""

    common_pointing_px: float = 2.0  # pointing errors of one pass are mostly common to its views,
    view_pointing_px: float = 1.0  # and differ by less
    height_margin_m: float = 20.0  # beyond the surface's lowest and highest point, then rounded outwards to 10 m


@dataclass(frozen=True)
class JitterParameters(Parameters):
    """Waves of the attitude: those of ZY-3 have 0.2 to 1.5 px (Tong et al. 2015, IEEE TGRS 53)."""

    sines: int = 3  # of each view, in each direction
    periods: Tuple[float, float] = (360.0, 1700.0)  # lines; one sine in each of as many equal parts, logarithmically
    growth: float = 0.5  # power of the period with which the largest amplitude grows: slow waves are the larger ones
    least_share: float = 0.3  # of the largest amplitude that a sine has at least


@dataclass(frozen=True)
class SimulatedGcpParameters(Parameters):
    """Places and errors of ground control points."""

    fields: Tuple[int, int] = (4, 3)  # columns and rows of fields of the common square, with one point in each
    candidates: int = 240  # random places of a field
    flattest: int = 12  # of them that are tried, the flattest first
    flat_m: float = 0.3  # unevenness below which one place is as good as another
    reach_cells: float = 2.5  # half the side of the square whose unevenness counts, in cells of the true DSM
    noise_px: float = 0.3  # standard deviation of a measured position
    edge_px: float = 4.0  # the common square stays so far inside every image
    visible_m: float = 0.1  # a point is visible if its ray meets the surface within this height


@dataclass(frozen=True)
class TownParameters(Parameters):
    """The plan of the town."""

    block_m: Tuple[float, float] = (86.0, 62.0)  # from street to street
    street_m: float = 11.0  # between the fronts
    roadway_m: float = 3.6  # half the width between the kerbs
    turn_deg: float = 17.0  # of the grid of streets against the north, so that walls follow no rows of cells
    tiles: Tuple[Tuple[float, float], ...] = ((0.21, 0.03), (0.28, 0.035), (0.18, 0.03), (0.24, 0.045))
    """Albedo and contrast of tiled roofs."""
    flats: Tuple[Tuple[float, float], ...] = ((0.3, 0.004), (0.17, 0.012), (0.42, 0.006), (0.24, 0.02), (0.29, 0.03))
    """Albedo and contrast of flat roofs; the first are nearly plain."""
    wall_m: float = 0.9  # nodes that differ by more have a vertical wall between them
    relief_m: float = 3.0  # standard deviation of the terrain, in waves of 120 to 500 m
    trees: bool = True  # without them, there is what stands and lies below the crowns of the same town


@dataclass(frozen=True)
class SeasonParameters(Parameters):
    """What all seasons have in common."""

    leaf_area: Tuple[float, float] = (4.0, 0.9)  # plant area with and without leaves: the gaps are exp(-index / 2)
    bough_m: float = 2.0  # longest wavelength of the gaps between boughs
    bark: float = 0.10  # albedo of boughs without leaves
    own_m: float = 8.0  # longest wavelength of the texture that is a date's own
    snow: float = 0.75  # albedo of snow that is some days old
    snow_m: Tuple[float, float] = (60.0, 5.0)  # longest and shortest wavelength of its patches
    snow_sun: float = 2.0  # deviations of chance that the whole noon sun weighs, which melts it
    snow_roof: float = 1.0  # and a warm roof


@dataclass(frozen=True)
class SimulationParameters(Parameters):
    """All of them."""

    light: LightParameters = LightParameters()
    render: RenderParameters = RenderParameters()
    rpc_fit: RpcFitParameters = RpcFitParameters()
    vendor: VendorParameters = VendorParameters()
    control: SimulatedGcpParameters = SimulatedGcpParameters()
    jitter: JitterParameters = JitterParameters()
    town: TownParameters = TownParameters()
    farmland: TownParameters = TownParameters(
        block_m=(180.0, 130.0), street_m=9.0, roadway_m=2.0, turn_deg=31.0, relief_m=14.0
    )
    season: SeasonParameters = SeasonParameters()


SIMULATION = SimulationParameters()
