"""What the pairs and ties of a scene mean for its heights, and what to do about it, in sentences."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..progress import counted
from ..scene import Scene
from .view_pairs import ViewPair

FloatArray = NDArray[np.float64]

MATCHING_PX = 0.25
"""What dense matching is good for, px: the expected height accuracy of a pair is so many pixels of its parallax."""

NARROW, WIDE = 0.1, 0.9
_FEW_TIES = 5       # in a tile's neighbourhood
_CELLS = 5          # a side of the scene: ties are looked for in a patch of each
_UNCERTAIN_M, _UNCERTAIN_GSD = 5.0, 10.0     # two standard deviations


def ties_by_tile(scene: Scene, xy: FloatArray) -> List[Dict[str, Any]]:
    """How many ties (N, 2) lie around each tile: within it, or within a fifth of the scene where that is more.

    Ties come from patches spread over a large scene, so that a small tile may well have none of its own.
    """
    bounds = np.array([tile.bounds for tile in scene.tiles])
    least = (bounds[:, 2:].max(axis=0) - bounds[:, :2].min(axis=0)) / _CELLS
    result = []
    for tile, box in zip(scene.tiles, bounds):
        middle, reach = (box[:2] + box[2:]) / 2, np.maximum(box[2:] - box[:2], least) / 2
        result.append({"tile": tile.id, "ties": int((np.abs(xy - middle) <= reach).all(axis=1).sum())})
    return result


def advice(scene: Scene, pairs: Sequence[ViewPair], figures: Mapping[str, Any]) -> List[str]:
    """Warnings, each with what the analyst can do; ``figures`` are those of the pointing, with ``tiles``."""
    said = []
    for pair in pairs:
        accuracy = MATCHING_PX * scene.gsd_m / pair.base_to_height
        if pair.base_to_height < NARROW:
            said.append(f"{pair.first} and {pair.second} look from nearly one direction (B/H "
                        f"{pair.base_to_height:.2f}, {pair.angle_deg:.1f} degrees): heights of this pair are good to "
                        f"some {accuracy:.1f} m only; add an image from farther away, or leave one of the two out.")
        elif pair.base_to_height > WIDE:
            said.append(f"{pair.first} and {pair.second} look from very different directions (B/H "
                        f"{pair.base_to_height:.2f}, {pair.angle_deg:.1f} degrees): walls and trees will not match; "
                        "add an image from between.")
    said += _thin(figures["tiles"])
    uncertain = figures.get("height_uncertainty_m", 0.0)
    if uncertain > max(_UNCERTAIN_M, _UNCERTAIN_GSD * scene.gsd_m):
        said.append(f"The vendors' RPCs disagree so much that the absolute height is uncertain by some {uncertain:.1f} "
                    "m: give ground control points (GCPS), or align the DSM with a reference ('Compare a DSM with a "
                    "reference', ALIGN=3d).")
    return said


def _thin(tiles: Sequence[Mapping[str, Any]]) -> List[str]:
    few = [entry["tile"] for entry in tiles if entry["ties"] < _FEW_TIES]
    if not few or len(tiles) < 2:
        return []
    names = ", ".join(few[:12]) + (f" and {len(few) - 12} more" if len(few) > 12 else "")
    return [f"{counted(len(few), 'tile')} of {len(tiles)} {'has' if len(few) == 1 else 'have'} hardly any tie point "
            f"({names}): water, cloud or shadow, or the images differ there. Their pointing comes from the rest of the "
            "scene; look at their rows in 'Height maps', or leave them out with EXTENT."]
