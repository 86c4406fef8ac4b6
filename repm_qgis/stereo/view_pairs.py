"""A pair of views that are matched with each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional


@dataclass(frozen=True)
class ViewPair:
    """Two views by name: convergence angle (degrees), base-to-height ratio, and the number of tiles that both see.

    ``share`` is the part of the scene's area that both see. ``days`` is the time between the two images, ``sun_deg``
    the angle between the two directions to the sun, ``shadow`` the distance between the ends of the two shadows (m for
    each m of height). They are None where a time is unknown, the last two also where the sun had set.
    """

    first: str
    second: str
    angle_deg: float
    base_to_height: float
    tiles: int
    share: float = 1.0
    days: Optional[float] = None
    sun_deg: Optional[float] = None
    shadow: Optional[float] = None
