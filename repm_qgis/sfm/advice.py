"""What the pairs and ties of a scene mean for its heights, and what to do about it, in sentences."""

from __future__ import annotations

from typing import Dict, List, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from osgeo import ogr

from ..arrays import FloatArray
from ..geometry.footprints import bounds_of
from ..geometry.footprints import box as rectangle
from ..imagery.acquisition import apart_text
from ..progress import counted
from ..records import PointingFigures, ViewPair
from ..scene import Scene
from .pair_selection import days_off_season, sun_over
from .parameters import POINTING

MATCHING_PX = 0.25
"""What dense matching is good for, px: the expected height accuracy of a pair is so many pixels of its parallax."""

_SUN_DEG = 10.0  # 40 minutes of a day, or four weeks in spring and autumn
_SEASON_DAYS, _OLD_DAYS = 60.0, 365.0
_BUILDING_M = 10.0
_MOST_NAMED = 6
_PARTS = (("north-west", "north", "north-east"), ("west", "middle", "east"), ("south-west", "south", "south-east"))
_FEW_TIES = 5  # in a tile's neighbourhood
_LEAST_PART = 0.1  # of a ninth of the area's bounds: less of it is a corner
_CELLS = 5  # a side of the scene: ties are looked for in a patch of each
_UNCERTAIN_M, _UNCERTAIN_GSD = 5.0, 10.0  # two standard deviations


def ties_by_tile(scene: Scene, xy: FloatArray) -> Dict[str, int]:
    """How many ties (N, 2) lie around each tile: within it, or within a fifth of the scene where that is more.

    Ties come from patches spread over a large scene, so that a small tile may well have none of its own.
    """
    bounds = np.array([tile.bounds for tile in scene.tiles])
    least = (bounds[:, 2:].max(axis=0) - bounds[:, :2].min(axis=0)) / _CELLS
    result = {}
    for tile, box in zip(scene.tiles, bounds):
        middle, reach = (box[:2] + box[2:]) / 2, np.maximum(box[2:] - box[:2], least) / 2
        result[tile.id] = int((np.abs(xy - middle) <= reach).all(axis=1).sum())
    return result


def ties_by_part(scene: Scene, xy: FloatArray) -> Dict[str, int]:
    """How many ties (N, 2) lie in the north-west, north ... of the area, by ninths of its bounds that it fills."""
    area = ogr.CreateGeometryFromWkt(scene.area)
    xmin, ymin, xmax, ymax = bounds_of(area)
    x, y = np.linspace(xmin, xmax, 4), np.linspace(ymax, ymin, 4)
    result = {}
    for row, names in enumerate(_PARTS):
        for column, name in enumerate(names):
            part = rectangle((x[column], y[row + 1], x[column + 1], y[row]))
            if area.Intersection(part).GetArea() >= _LEAST_PART * part.GetArea():
                inside = _within(xy, (x[column], y[row + 1]), (x[column + 1], y[row]))
                result[name] = int(inside.sum())
    return result


def _within(xy: FloatArray, low: Sequence[float], high: Sequence[float]) -> NDArray[np.bool_]:
    return ((xy >= low) & (xy <= high)).all(axis=1)


def advice(scene: Scene, pairs: Sequence[ViewPair], figures: PointingFigures) -> List[str]:
    """Warnings, each with what the analyst can do."""
    said = [text for pair in pairs for text in _geometry(pair, scene.gsd_m)]
    said += _left_out(scene, pairs) + _groups(scene, pairs) + _at_night(scene) + _suns(pairs) + _dates(pairs)
    said += _thin(scene, figures.ties_by_tile, figures.ties_by_part)
    uncertain = figures.height_uncertainty_m or 0.0
    if uncertain > max(_UNCERTAIN_M, _UNCERTAIN_GSD * scene.gsd_m):
        said.append(
            f"The vendors' RPCs disagree so much that the absolute height is uncertain by some {uncertain:.1f} "
            "m: give ground control points (GCPS), or align the DSM with a reference ('Compare a DSM with a "
            "reference', ALIGN=3d)."
        )
    return said


def _geometry(pair: ViewPair, gsd_m: float) -> List[str]:
    """A pair that is too narrow or too wide."""
    looks = f"(B/H {pair.base_to_height:.2f}, {pair.angle_deg:.1f} degrees)"
    if pair.base_to_height < POINTING.pairs.narrow:
        return [
            f"{pair.first} and {pair.second} look from nearly one direction {looks}: heights of this pair are good "
            f"to some {MATCHING_PX * gsd_m / pair.base_to_height:.1f} m only; add an image from farther away, or "
            "leave one of the two out."
        ]
    if pair.base_to_height > POINTING.pairs.wide:
        return [
            f"{pair.first} and {pair.second} look from very different directions {looks}: walls and trees will not "
            "match; add an image from between."
        ]
    return []


def _left_out(scene: Scene, pairs: Sequence[ViewPair]) -> List[str]:
    """Views that no pair uses."""
    used = {name for pair in pairs for name in (pair.first, pair.second)}
    names = [view.name for view in scene.views if view.name not in used]
    return (
        [
            f"{_listed(names)}: not used, for no other image that sees the same ground looks from a direction at least "
            "3 degrees away; leave it out, or add an image from farther away."
        ]
        if names
        else []
    )


def _groups(scene: Scene, pairs: Sequence[ViewPair]) -> List[str]:
    """Groups of views that no pair connects."""
    groups = [{view.name} for view in scene.views]
    for pair in pairs:
        joined = [group for group in groups if group & {pair.first, pair.second}]
        groups = [group for group in groups if group not in joined] + [set().union(*joined)]
    names = [", ".join(sorted(group)) for group in groups if len(group) > 1]
    return (
        [
            f"The images fall into {len(names)} groups that no pair connects ({_listed(names, '; ')}): their heights "
            "may differ by metres; add an image that overlaps both, give ground control points (GCPS), or work on each "
            "group by itself."
        ]
        if len(names) > 1
        else []
    )


def _at_night(scene: Scene) -> List[str]:
    """Times at which no satellite takes pictures."""
    names = [
        f"{view.name} ({view.time:%Y-%m-%d %H:%M} UTC)"
        for view in scene.views
        if view.time is not None and sun_over(scene, view)[1] <= 0
    ]
    return (
        [
            f"{_listed(names)}: the sun had set at the time that the product's files tell, so that only its date was "
            "used; check the files beside the image."
        ]
        if names
        else []
    )


def _suns(pairs: Sequence[ViewPair]) -> List[str]:
    """Pairs whose shadows lie elsewhere."""
    named = [
        f"{pair.first} and {pair.second} ({apart_text(pair.days)}, {pair.sun_deg:.0f} degrees between the suns: "
        f"the shadow of a {_BUILDING_M:.0f} m building ends {_BUILDING_M * pair.shadow:.0f} m elsewhere)"
        for pair in pairs
        if _other_sun(pair)
    ]
    return (
        [
            f"The sun stood differently over {_listed(named)}: shadows' edges match as if they were ground, and ground "
            "in shadow does not match; take images of one pass or of alike suns, or leave the odd one out."
        ]
        if named
        else []
    )


def _other_sun(pair: ViewPair) -> bool:
    return pair.sun_deg is not None and pair.sun_deg > _SUN_DEG


def _dates(pairs: Sequence[ViewPair]) -> List[str]:
    """Pairs of other seasons or years; those of other suns have been named already."""
    named = [
        f"{pair.first} and {pair.second} ({apart_text(pair.days)})"
        for pair in pairs
        if pair.days is not None
        and not _other_sun(pair)
        and (days_off_season(pair.days) > _SEASON_DAYS or pair.days > _OLD_DAYS)
    ]
    return (
        [
            f"Seasons or years lie between {_listed(named)}: fields, leaves, snow and building sites have changed, and "
            "leave gaps or wrong heights; take images of one pass, or leave the odd one out."
        ]
        if named
        else []
    )


def _listed(names: Sequence[str], between: str = ", ") -> str:
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return between.join(names[:_MOST_NAMED]) + more


def _thin(scene: Scene, tiles: Mapping[str, int], parts: Mapping[str, int]) -> List[str]:
    """Where the area has hardly any tie."""
    total = sum(parts.values())
    # With few ties in all, every part has few; then none is worse than the others.
    bare = [name for name, count in parts.items() if count < min(_FEW_TIES, 0.25 * total / len(parts))]
    few = [name for name, count in tiles.items() if count < _FEW_TIES] if len(tiles) > 1 else []
    if not few and not bare:
        return []
    where = _listed([*bare, *dict.fromkeys(_part_of(scene, tile) for tile in few if _part_of(scene, tile) not in bare)])
    names = f" ({counted(len(few), 'tile')} of {len(tiles)}: {_listed(few)})" if few else ""
    return [
        f"Hardly any tie point in the {where} of the overlap{names}: water, cloud or shadow, or the images differ "
        "there, and the pointing comes from the rest of the scene; look at the arrows of the tie points around it "
        "(their field 'row') and at its rows in 'Height maps', or leave it out with EXTENT."
    ]


def _part_of(scene: Scene, tile_id: str) -> str:
    """The ninth of the area that a tile's middle lies in."""
    xmin, ymin, xmax, ymax = bounds_of(ogr.CreateGeometryFromWkt(scene.area))
    x0, y0, x1, y1 = next(tile.bounds for tile in scene.tiles if tile.id == tile_id)
    column = int(np.clip(3 * ((x0 + x1) / 2 - xmin) / (xmax - xmin), 0, 2))
    row = int(np.clip(3 * (ymax - (y0 + y1) / 2) / (ymax - ymin), 0, 2))
    return _PARTS[row][column]
