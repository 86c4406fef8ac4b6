"""The bounds beyond which what is used together does not fit together."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class GateParameters(Parameters):
    """Values without a source are chosen: what our own products keep, with room for a cell at edges and holes."""

    most_unstated: float = 5e-4  # share of a DSM's heights without an expected error
    most_strange: float = 0.05  # share of expected errors without a height
    most_error_m: float = 50.0  # median expected error: a DEM of 90 m cells has 10 m
    most_error_variations: float = 20.0  # the same, by how much heights vary; our DSMs have 1.2 to 1.7, centimetres 120
    variation_cells: int = 8  # between the heights whose second differences are this variation
    least_unlikely_m: float = 2.0  # the same for heights that vary by nothing, as those of lakes do; and so many cells
    least_unlikely_cells: float = 2.0
    most_uncovered: float = 0.01  # share of a DSM that a companion may leave out
    ground_percent: float = 5.0  # of a DSM's heights, at least, lie on the ground
    mode_share: float = 0.25  # of the differences, in the shortest interval that has so many: the ground
    most_off_m: float = 1.0  # between a terrain and the open ground of its DSM; what stands higher is no ground
    most_unseen_off_m: float = (
        3.0  # the same where no open ground is seen: geoids are tens of metres from the ellipsoid
    )
    open_cell_m: float = 2.0  # of the open ground: noise of cells is averaged
    open_width_m: float = 60.0  # of the opening that takes houses off
    open_near_m: float = 2.0  # above the opening, which follows the lowest heights
    open_gradient: float = 0.25  # m per m above the terrain, up to which cells are smooth
    open_share: float = 0.02  # of the cells that are open ground, at least, and
    open_cells: int = 50  # so many
    open_mode_share: float = 0.25  # of the most cells that lie in a metre: the lowest metre with so many is the ground
    open_tukey: float = 4.0  # spreads from the plane, from which on cells do not count
    open_least_m: float = 0.1  # of that spread
    most_left_m: float = 0.5  # spread of the open ground about a terrain: DSMs of lasers and images leave 0.02 to 0.43
    most_left_cells: float = 0.5
    unexplained: float = 0.5  # of that ground's own spread, which a terrain makes less; else it is another place's
    most_tilt_m: float = 0.75  # of two DSMs against each other, over their overlap; and so many cells
    most_tilt_cells: float = 0.25
    sure_tilt_m: float = 0.2  # over their overlap, from which on it counts for all of the larger one; and so many NMADs
    sure_tilt_nmads: float = 2.0  # about the plane
    object_width_m: float = 24.0  # of an opening that takes houses off, and leaves hills
    object_m: float = 3.0  # above that opening: a storey
    object_m2: float = 100.0  # that stand so high, and this share of the overlap
    object_share: float = 0.01
    least_objects: int = 4  # of them that are missing: a single heap or hall is a change
    most_gone: float = 0.8  # of the cells that stand so high in one DSM, and less than half as high in another
    near_m: float = (
        5.0  # of a DSM's heights to a terrain, where ground is compared with ground; larger misfits count so
    )
    most_uncertain_m: float = 2.0  # standard deviation of a reference's own height
    most_displaced_m: float = 2.0  # between a terrain and a DSM; and so many cells
    most_displaced_cells: float = 2.0
    displaced_gain: float = 0.8  # of the misfit, at most, after the shift; otherwise it explains nothing
    most_tilted_m: float = 1.0  # of the differences of two surfaces over their ground: real pairs have up to 0.3; and
    most_tilted_nmads: float = 2.0  # so many NMADs about the plane
    least_relief_m: float = 0.7  # misfit to what another surface shows elsewhere: less is no question of the place; and
    relief_noises: float = 3.0  # so many times the noise, by second differences over
    fits_elsewhere: float = 0.65  # of that misfit, at its place: real pairs have 0.1 to 0.5, other towns 0.7 to 1.1
    noise_lag_m: float = 4.0
    least_far_m: float = 1.0  # of a difference of two dates from the usual one; and
    far_spreads: float = 5.0  # so many standard deviations of it: real pairs have 1 to 20 % of such cells
    least_burst_m: float = 10.0  # of heights in one piece, from the others' difference to a reference; and far_spreads
    most_burst: float = 0.01  # of the heights: real DSMs and lidar have up to 0.4 %, of what was built between
    most_stray: float = 0.001  # of the heights, that no height of the reference explains
    most_apart: float = 0.05  # of the heights, far_spreads away from the others in one step; and
    step_spreads: float = 2.0  # so many spreads of these wide: trees and errors of matching have 10 and more
    class_search_m: float = 60.0  # around a class raster's place, where it is looked for; at most a quarter of its side
    most_unexplained: float = 0.6  # of the variance of heights by classes, at the best place: districts have 0.7 to 1
    class_height_m: float = 10.0  # above the open ground, from which on heights are alike
    least_class: float = 0.01  # share of the cells of a class that counts there
    narrow_m: float = 30.0  # of a class whose parts are houses, roads or crowns
    most_wide: float = 0.2  # of its cells that are in wider parts
    least_raised: float = 0.03  # of the cells that stand above the open ground: a town or a wood
    nothing_explained: float = 0.9  # of the variance, at least: other towns leave 0.91 to 1, the right ones 0.15 to 0.6
    least_shared: float = 0.65  # of the ground of the largest DSM that all dates have: two turned squares have 0.7
    least_year: int = 1957  # of the first satellite


GATE = GateParameters()
