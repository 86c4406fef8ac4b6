"""All numbers that matching by COLMAP chooses. "Chosen" means that no experiment is recorded."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class FrameParameters(Parameters):
    """The projective frame of a tile (docs/method.md, "The frame"); its effect on a GPU's heights is not measured."""

    distance: float = 4.0 / 3.0  # D: heights of +- D / 3 then have depths of 1 to 2
    half_width: float = 0.5  # of the tile, in units of D: views are then within 27 degrees of the vertical
    most_stretch: float = 4.0  # of heights against distances on the ground: more would make walls of roofs


@dataclass(frozen=True)
class TrackParameters(Parameters):
    """The grid of ground points that COLMAP gets as tracks. All values are chosen."""

    altitudes: int = 5
    points: int = 11  # along a side of the tile


@dataclass(frozen=True)
class PatchMatchParameters(Parameters):
    """COLMAP's patch match and fusion (Schoenberger et al. 2016), and the memory of a GPU."""

    memory_share: float = 0.8  # of a GPU's free memory that a tile may take; chosen
    depth_margin: float = 0.02  # of the depth range, searched beyond each end; chosen
    samples: int = 4  # drawn for each source; with one source all samples are the same
    most_samples: int = 15  # COLMAP's default
    fused_views: int = 2  # that must agree in COLMAP's fusion
    fused_normal_deg: float = 30.0  # COLMAP: 10; the frame stretches heights, so that normals differ by more; chosen
    fused_depth_share: float = 0.01  # of the depth, between a fused point and a pixel: COLMAP's max_depth_error
    most_parts: int = 64  # along a side of a tile that does not fit into memory; chosen


@dataclass(frozen=True)
class ColmapParameters(Parameters):
    """Matching by COLMAP, as a whole."""

    frame: FrameParameters = FrameParameters()
    tracks: TrackParameters = TrackParameters()
    patch_match: PatchMatchParameters = PatchMatchParameters()
    range_margin_px: float = 6.0  # of parallax: heights are kept so far beyond the altitudes of the tile; chosen
    score_window_px: int = 7  # side of the correlation window of the score; the same as that of sgm
    depth_steps: int = 4  # of the least-squares search for the depth that the sources' RPCs agree on; chosen


COLMAP = ColmapParameters()
