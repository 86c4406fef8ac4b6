"""All numbers that the registration to a reference chooses. "Chosen" means that no experiment is recorded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class WaveParameters(Parameters):
    """Waves along the parallax from the differences of a reference. All values are chosen (`make bench-jitter`)."""

    per_spline: float = 20.0  # differences for each spline of a view, at least
    across: int = 3  # pixels of a height map that are read along a side of a support, at least
    covered: float = 0.3  # of the pixels that a support should have, which a mean of them needs
    most_supports: int = 200_000  # of a reference: more of them add nothing and take time
    steepest: float = 1.0  # slope of the ground: on steeper one, errors of place are larger than waves
    iterations: int = 6
    tukey: float = 4.685  # as above
    least_noise_m: float = 0.01
    limit: float = 3.0  # NMADs at which differences are cut for the information criterion
    block_widths: float = 8.0  # side of the blocks in which errors may be alike, in widths of a support
    least_blocks: int = 20
    first_spread: float = 10.0  # differences that count as one independent value, before this is estimated


@dataclass(frozen=True)
class RegistrationParameters(Parameters):
    """How a surface is laid onto a reference; lengths in metres where nothing else is said. Chosen, unless a source is
    given."""

    covered: float = 0.6  # of a support's area that must have heights of the own surface
    least_supports: int = 50  # heights of the reference that see the own surface: fewer are refused
    search_supports: int = 4000  # of them that the search over whole steps looks at, evenly taken
    search_step: float = 0.5  # of the larger of the surface's cell and the support's width
    keep_share: float = 0.5  # of the supports that must still overlap after a shift of the search
    cap_nmad: float = 3.0  # differences are truncated here in the search
    iterations: int = 30  # Gauss-Newton steps, at most
    converged_m: float = 0.002  # a step as small as this is the last
    tukey: float = 4.685  # of the biweight, in standard deviations: 95 % efficiency (Holland and Welsch 1977)
    slope_bins: int = 6  # parts of the supports by slope, for which the noise is estimated (Hugonnet et al. 2022)
    least_noise_m: float = 0.01
    mode_share: float = 0.5  # of the differences: the shortest interval that holds so many lies at their mode
    lags: int = 64  # classes of distance of the differences' correlation ...
    reach: float = 0.5  # ... up to this share of the extent's diagonal
    pairs: int = 4_000_000  # of differences that their correlation is estimated from, about
    floor_up_cells: float = 0.01  # of the own surface: no number of heights makes the height more certain. Chosen
    slope_steps: Tuple[float, ...] = (0.5, 1.0)  # of a cell or a support, the larger: for the slope of the equations
    lattice: int = 400  # cells along the longer side, in which the covariance sums up scores
    # Supports of lasers: a disc's diameter, or west to east and south to north of a rectangle. ICESat-2's ground tracks
    # run within 10 degrees of north up to 70 degrees of latitude (inclination 92 degrees), so its segments do too.
    atl03_disc_m: float = 12.0  # footprint 11 m (Magruder et al. 2020, Earth and Space Science 7)
    atl06_m: Tuple[float, float] = (12.0, 40.0)  # segments of 40 m (Smith et al. 2019, Remote Sens. Environ. 233)
    atl08_m: Tuple[float, float] = (12.0, 100.0)  # segments of 100 m (Neuenschwander and Pitts 2019, RSE 221) ...
    atl08_part_m: Tuple[float, float] = (12.0, 20.0)  # ... and their parts, since release 5
    gedi_disc_m: float = 25.0  # footprint (Dubayah et al. 2020, Science of Remote Sensing 1)
    least_confidence: int = 3  # of ATL03 photons: medium (Neumann et al. 2019, Remote Sens. Environ. 233)
    low_confidence: int = 2  # of photons that count where they are dense, by day and in weak beams
    photon_window_m: Tuple[float, float] = (25.0, 3.5)  # along the track and in height, that photons are counted in ...
    photon_cells: Tuple[int, int] = (5, 7)  # ... in so many cells, odd numbers
    photon_least: int = 6  # photons in a window, at least ...
    photon_sigma: float = 4.0  # ... and so many standard deviations (Poisson) more than noise puts there
    cloud_points: int = 4  # that a cell of a gridded cloud needs
    cloud_cells: int = 4_000_000  # of a gridded cloud: larger scenes have larger cells
    cloud_single: int = 200_000  # points of a sparse cloud, at most: more of them add nothing and take time
    sparse: float = 0.5  # of the points in cells with enough of them, or of the blocks: fewer are no cells. Chosen
    known_slopes: float = 0.5  # of a reference's heights: where fewer have slopes, they are fitted, or not used. Chosen
    most_heights: int = 10_000_000  # of points and lasers within the scene: more do not fit into memory
    believable: float = 3.0  # promised standard deviations of height, within which a vertical datum is likely
    local_parts: int = 4  # along each side of the surface, whose offsets are shown
    most_cells: int = 6_000_000  # of the own surface: half a gigabyte; more would change millimetres only
    cells_across: float = 6.0  # of the own surface in a support of the reference, if the images are fine enough
    coarse_cells: float = 2.5  # in a support, of a surface that is made of a part of the heights
    averaged_cells: float = 3.0  # of the own surface that cells of a finer reference are averaged to: it sees no finer
    search: float = 3.0  # a shift is looked for up to so many CE90 that the vendor promises ...
    least_search_m: float = 40.0  # ... and at least up to this
    contradiction: float = 3.0  # standard deviations between two sources, from which on they contradict each other
    least_contradiction_m: float = 0.1
    copy_m: float = 0.002  # by which heights and places of a copy differ at most: rounding. Chosen
    copy_share: float = 0.9  # of a reference's heights that another one has too: then one is a copy. Chosen
    copy_heights: int = 5000  # of a reference that are looked for in another one
    dem_cells: int = 250_000  # coarse cells of a DSM that is compared with the user's DEM, about
    relief_m: float = 5.0  # NMAD of a reference's heights: with less, noise and roofs may have any correlation. Chosen
    level: Tuple[float, float] = (0.05, 0.95)  # quantiles of a reference's heights, between which its relief is. Chosen
    unexplained: float = 0.7  # of the spread of a surface's heights, which a reference of its ground makes less. Chosen
    most_left_m: float = 3.0  # spread of the differences from a reference: more is not noise, if it is no less. Chosen
    least_covered: float = 0.1  # of the parts of a scene that have heights of the reference: less is said. Chosen
    cover_parts: int = 10  # along each side of the scene, of which these are
    least_alike: float = 0.5  # rank correlation of a surface with a reference; sound ones have 0.99. Chosen
    most_scaled: float = 1.5  # times as high, or as low; feet are 3.3. Chosen
    certain_alike: float = 0.95  # rank correlation of heights of one surface without doubt: 0.98 and more in mountains,
    most_alike_scaled: float = 1.15  # whose relief may differ by this factor. Chosen
    dem_m: float = 2.4  # standard deviation of a DEM's own height: LE90 4 m of Copernicus DEM (Airbus, handbook, 2020)
    unexpected: float = 2.0  # standard deviations from which on such an offset is more than is to be expected
    fine_cells: float = 4.0  # of the own surface: a raster with narrower cells has slopes no better than its own
    trusted_widths: float = 0.05  # of a support's width: a position less certain than that is not taken from coarse ...
    trusted_m: float = 1.0  # ... references, whose systematic errors are as large; from fine ones up to this
    undetermined: float = 0.3  # of the promised standard deviation: a direction less certain than that stays as it was
    waves: WaveParameters = WaveParameters()


REGISTRATION = RegistrationParameters()
