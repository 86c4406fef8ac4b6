"""All numbers that the search for tie points chooses.

"Chosen" means that no experiment is recorded. "Pointing tables" are those of
docs/benchmarks/pointing.md, "Where the images really look".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class KeypointParameters(Parameters):
    """SIFT (Lowe 2004)."""

    contrast: float = 0.02  # least contrast of a keypoint over the layers of an octave, as OpenCV counts; chosen
    layers: int = 3  # of an octave (Lowe 2004)


@dataclass(frozen=True)
class PatchParameters(Parameters):
    """Where tie points are searched. All values are chosen; the pointing tables show the ties that come of them."""

    whole_px: int = 1600  # a scene up to this side is one patch
    least_px: int = 300  # side of a patch, at least
    most_px: int = 500  # and at most
    scene_patches: int = 6  # side of the scene over that of a patch: nine patches are a quarter of it
    least_cells: int = 3  # cells along a side of the scene; each gives one patch a round
    most_cells: int = 5
    cell_patches: int = 3  # a cell is at least so many patches wide
    places: int = 6  # places of a cell, along a side, of which the best is searched first
    least_inside: float = 0.3  # share of a patch that must lie in the area
    texture_px: int = 5  # window of the gradients' matrix
    texture_quantile: float = 0.9  # of its smallest eigenvalue's root over a patch
    missed_weight: float = 0.5  # of a patch's texture, for each view that does not show it
    most_rounds: int = 5  # patches searched in a cell
    enough_ties: int = 100  # of every pair; with fewer, the next patches are searched
    block_share: float = 0.25  # of the area, which most pairs of a block of frames do not see
    frame_patches: int = 3  # of each pair of a block: with fewer, a frame's ties lie in one corner
    frame_seen: float = 0.2  # share of a patch that a pair must see to be searched there
    frame_places: int = 4  # along a side of the ground that a pair of frames sees, of which the best is searched first
    frame_inside: float = 0.7  # share of a patch that must lie on that ground
    frame_apart: float = 0.5  # of a patch may lie on another one
    frame_ties: int = 40  # of every pair of a block, as ``enough_ties``: each frame has several pairs


@dataclass(frozen=True)
class TieParameters(Parameters):
    """Keypoints of patches and their matches. Values without a source are chosen."""

    reduction: float = 2.0  # SIFT on images of half size takes a sixth of the time and gives enough ties
    small_px: int = 500  # images of a scene of one patch below this side are not reduced
    small_patch_px: int = 300  # the same for one of several patches
    features_per_mpx: int = 2500  # of a refined image
    least_features: int = 600  # of a scene of one patch
    most_features: int = 4000
    least_patch_features: int = 300  # of each of several patches, which share those of a scene
    spare_features: int = 3  # times as many are detected, for an even choice among them
    buckets: int = 12  # along a side of a patch, for an even choice
    border_px: int = 4  # keypoints so near to pixels without data are not used
    least_keypoints: int = 8  # of a view over a patch
    margin_px: int = 24  # around a patch, in the views
    tolerance_px: float = 64.0  # vertical parallax from errors of RPCs: up to tens of px a view
    near_px: float = 8.0  # around a patch's vertical parallax, in the second search
    close_px: float = 2.5  # around the trend of a patch's vertical parallax, in the third search
    likely_px: float = 6.0  # by which a trend over the images may leave the most frequent vertical parallax
    mode_px: float = 1.0  # width of the interval that gives the most frequent value over all patches
    patch_mode_px: float = 2.0  # the same over one patch
    patch_mode_share: float = 0.15  # of a patch's matches must lie there for a second search
    trend_matches: int = 40  # near the most frequent value, for a plane instead of a constant
    trend_reach_px: Tuple[float, ...] = (6.0, 4.0, 3.0, 2.0, 2.0)  # of Tukey's weights, iteration by iteration
    patch_reach_px: float = 2.5  # by which a patch's median may be off the trend
    agree_px: float = 1.5  # matches of a patch lie so near to its median
    least_patch_matches: int = 4  # of a patch near the trend
    neighbours: int = 10  # of a match, in the first image
    supporters: int = 3  # neighbours that must have nearly its disparity: a match with the next roof has not
    support_step_px: float = 6.0  # of disparity between neighbours: a house
    support_slope: float = 0.4  # and a share of their distance: sloping ground
    ratio: float = 0.85  # of the best and the second descriptor distance (Lowe 2004: 0.8 without other constraints)
    most_distance: float = 0.8  # between descriptors of unit length
    least_ties: int = 12  # of a pair


@dataclass(frozen=True)
class AlignmentParameters(Parameters):
    """Subpixel alignment of ties (Lucas and Kanade 1981).

    The spread of vertical parallax falls from 0.5 px to 0.1 px on real and simulated Pleiades pairs.
    """

    window_px: int = 11  # side of the neighbourhood that is aligned; chosen
    iterations: int = 30  # at most
    stop_px: float = 0.005  # a smaller step ends the iteration
    margin_px: int = 24  # around the ties of a patch
    patch_px: int = 1700  # side of the patches in which images are aligned, at most: bounds memory
    kept_px: int = 1 << 25  # of resampled pairs that are kept for further ties: bounds memory
    gap: float = 0.1  # of that side: nothing is aligned between ties that are farther apart
    farthest_px: float = 1.5  # SIFT's error is never so large: what moves farther has found something else
    return_px: float = 0.1  # between a position and itself, aligned to the second image and back to the first
    least_alike: float = 0.25  # share of a patch's ties that can be aligned so: with less, as across seasons,
    wide_px: int = 21  # the window is wider,
    wide_return_px: float = 0.3  # and positions return less well
    most_alike: float = 0.7  # share of a patch's ties that stay: at edges of roofs windows hold two parallaxes
    enough: int = 30  # with fewer ties in a patch, that share is not taken
    even_px: float = 5.0  # standard deviation of the Gaussian that evens out intensity and contrast
    even_contrast: float = 40.0  # grey values: the contrast afterwards
    noise: float = 0.012  # contrast of the stretched image (0..1) that may be noise and is not amplified
    least_texture: float = 1e-3  # smallest eigenvalue of the gradients' matrix, as OpenCV normalises it


@dataclass(frozen=True)
class TiesParameters(Parameters):
    """All parameters of this package."""

    keypoints: KeypointParameters = KeypointParameters()
    patches: PatchParameters = PatchParameters()
    matches: TieParameters = TieParameters()
    alignment: AlignmentParameters = AlignmentParameters()


TIES = TiesParameters()
