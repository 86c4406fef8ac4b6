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


@dataclass(frozen=True)
class EffectParameters(Parameters):
    """What makes images of different dates differ; with the defaults nothing does. ``REAL`` has the real values."""

    moving_sun: bool = False  # each image has the sun of its own time; else all have the first one's
    sun_disc_deg: float = 0.0  # the sun's diameter, which makes the edges of shadows soft; 0 is a point
    seasons: float = 0.0  # share of the year's change of grass and of trees that shed their leaves
    rough_crowns: bool = False  # trees of many boughs with gaps between them; else half ellipsoids
    gloss: float = 0.0  # of the mirror-like part of roofs and cars, as a share of a real one
    moving_cars: bool = False  # each day has its own parked cars, each image its own moving ones
    colour_ratio: int = 1  # GSD of the colours over that of the panchromatic band; 1: colours as sharp as it
    chip_blur_px: float = 0.0  # deviation of the blur that the vendor's resampling adds
    tone_curve: bool = False  # 8 bits by the vendor's curve; else digital numbers of 12 bits


REAL = EffectParameters(
    moving_sun=True,
    sun_disc_deg=0.53,  # the sun's mean angular diameter
    seasons=1.0,
    rough_crowns=True,
    gloss=1.0,
    moving_cars=True,
    colour_ratio=4,  # WorldView-3: 0.31 m and 1.24 m
    chip_blur_px=0.2,  # so that the power spectrum falls as that of the chips of jax_068 does (docs/method.md)
    tone_curve=True,
)


@dataclass(frozen=True)
class Material(Parameters):
    """How a kind of ground or roof reflects: its colour as shares of the albedo, and its mirror-like part."""

    red: float = 1.0
    green: float = 1.0
    blue: float = 1.0
    gloss: float = 0.0  # share of the light that is reflected as by a mirror, about Blinn and Phong's half vector


@dataclass(frozen=True)
class DistrictParameters(Parameters):
    """The plan of a district of large flat buildings, its trees and cars, and the light of its dates."""

    plan: TownParameters = TownParameters(
        block_m=(132.0, 104.0),
        street_m=15.0,
        roadway_m=5.0,
        turn_deg=1.0,  # most American towns stand north-up, and so do rows of cells
        flats=((0.30, 0.012), (0.16, 0.01), (0.24, 0.015), (0.33, 0.012), (0.20, 0.013), (0.55, 0.012)),
    )
    materials: Tuple[Material, ...] = (
        Material(),  # asphalt, concrete
        Material(0.92, 1.1, 0.85),  # grass
        Material(0.88, 1.1, 0.85),  # evergreen leaves
        Material(0.92, 1.1, 0.85),  # leaves that fall
        Material(1.15, 0.97, 0.85, 0.01),  # gravel and bitumen
        Material(0.97, 1.0, 1.04, 0.08),  # metal sheets, painted or galvanised
        Material(1.0, 1.0, 1.0, 0.03),  # membranes
        Material(1.0, 1.0, 1.0, 0.05),  # cars
    )
    shininess: float = 25.0  # Blinn and Phong's exponent: weathered metal and plastic, lobes of some 15 degrees
    sun_colour: Tuple[float, float, float] = (1.05, 1.0, 0.93)  # red, green, blue of sunlight over the mean,
    sky_colour: Tuple[float, float, float] = (0.78, 1.0, 1.28)  # and of the blue sky, which alone lights shadows
    haze_colour: Tuple[float, float, float] = (0.8, 1.0, 1.3)  # and of the light that the air scatters
    leaves: Tuple[Tuple[float, float], ...] = ((0, 0.1), (60, 0.1), (95, 1), (305, 1), (345, 0.1), (366, 0.1))
    """Day of the year, and the share of their leaves that trees have that shed them: at 30 degrees north."""
    green: Tuple[Tuple[float, float], ...] = ((0, 0.25), (60, 0.25), (110, 1), (290, 1), (350, 0.25), (366, 0.25))
    """Day of the year, and the share of grass that is green."""
    dry_grass: float = 1.6  # albedo of dry over green grass (ASTER spectral library: 0.12 to 0.2 against 0.08 to 0.1)
    shedding: float = 0.5  # share of trees that shed their leaves
    leaf_area: Tuple[float, float] = (
        4.0,
        0.9,
    )  # plant area index with and without leaves: the gaps are exp(-index / 2)
    bough_m: float = 2.0  # longest wavelength of the gaps between boughs
    bark: float = 0.10  # albedo of boughs without leaves
    occupied: float = 0.6  # share of stalls and of places on roads with a car
    street_cars: float = 0.25
    tone_black: float = (
        0.85  # black over the intensity that 0.2 % of pixels are below: shadows are not black in the chips
    )
    tone_white: float = 0.965  # share of pixels below white (measured in jax_068: 0.94 to 0.975)
    tone_gamma: float = 1.9  # of the curve: the medians of the chips of jax_068 are 139 to 166 of 255
    colour_noise_dn: float = 3.0  # standard deviation of the noise of the colours, at their own GSD


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
    district: DistrictParameters = DistrictParameters()
    effects: EffectParameters = EffectParameters()


SIMULATION = SimulationParameters()
