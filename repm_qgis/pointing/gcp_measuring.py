"""Measuring ground control points in images by hand: where to look, what the clicks say, and every step back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, FrozenSet, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.errors import InputTableError
from ..geometry.frames import EnuFrame
from ..scene import View
from .ground_control import Gcp, intersect, point_of, residuals, write_gcps

_MOST_STEPS = 1000  # that can be undone


@dataclass(frozen=True)
class PointCheck:
    """How the pixels of a point agree with its place, and with each other.

    ``residuals`` are (2,) px by view, measured minus predicted from the point's place: the vendors' pointing errors are
    in them. ``offset`` is (3,) east, north, up in metres from the place to the intersection of the rays (None with
    fewer than two images), and ``misses`` are (2,) px by view, measured minus the intersection's projection: by how
    much the images contradict each other.
    """

    residuals: Dict[str, FloatArray]
    offset: Optional[FloatArray]
    misses: Dict[str, FloatArray]

    @property
    def distance_m(self) -> Optional[float]:
        """From the place to the intersection; None with fewer than two images."""
        return None if self.offset is None else float(np.linalg.norm(self.offset))

    @property
    def largest_miss_px(self) -> float:
        return max((float(np.hypot(*miss)) for miss in self.misses.values()), default=0.0)


def check_point(gcp: Gcp, views: Sequence[View]) -> PointCheck:
    """Compare a point's pixels with its place; ``views`` with their pointing, if they have one."""
    offset = intersect(gcp, views)
    if offset is None:
        return PointCheck(residuals(gcp, views), None, {})
    met = EnuFrame(gcp.lon, gcp.lat, gcp.height).to_geodetic(offset)
    return PointCheck(residuals(gcp, views), offset, residuals(gcp, views, met))


@dataclass(frozen=True)
class _State:
    points: Tuple[Gcp, ...] = ()
    skipped: FrozenSet[Tuple[str, str]] = frozenset()


class GcpMeasuring:
    """The points and their pixels while somebody measures them; every change can be undone."""

    def __init__(self, views: Sequence[View] = ()) -> None:
        self.views: Tuple[View, ...] = tuple(views)
        self._state = _State()
        self._steps: List[_State] = []
        self.unsaved = False

    @property
    def points(self) -> Tuple[Gcp, ...]:
        return self._state.points

    def point(self, name: str) -> Gcp:
        return next(gcp for gcp in self.points if gcp.id == name)

    def is_skipped(self, name: str, view: str) -> bool:
        """Whether the point cannot be seen in an image, as the user said."""
        return (name, view) in self._state.skipped

    def new_name(self) -> str:
        """The next name of the form P01 that no point has."""
        taken = {gcp.id for gcp in self.points}
        return next(name for name in (f"P{n:02d}" for n in range(1, len(taken) + 2)) if name not in taken)

    def predicted(self, gcp: Gcp, view: View) -> Optional[FloatArray]:
        """(2,) the pixel at which a view should show a point; None where that is outside the image.

        It is the RPC's, moved by the median residual of the other points that were measured in the view: the first
        point shows by how much the vendor's pointing is wrong.
        """
        others = [residuals(other, [view]) for other in self.points if other.id != gcp.id and view.name in other.pixels]
        pixel: FloatArray = view.project(gcp.lon_lat_h)
        if others:
            pixel = pixel + np.median([residual[view.name] for residual in others], axis=0)
        inside = np.isfinite(pixel).all() and (pixel > -0.5).all() and (pixel < np.array(view.size) - 0.5).all()
        return pixel if inside else None

    def load(self, points: Sequence[Gcp]) -> None:
        """Take these points in place of all."""
        self._change(_State(tuple(points)))
        self.unsaved = False

    def add(self, row: Dict[str, object]) -> Gcp:
        """Add a point by its fields id, lon, lat, height (m above the ellipsoid) and role.

        Raises InputTableError for what a table could not hold.
        """
        gcp = self._checked(row, "")
        self._change(replace(self._state, points=(*self.points, gcp)))
        return gcp

    def edit(self, name: str, **fields: object) -> Gcp:
        """Change some fields of a point; its pixels stay. Raises InputTableError for what a table could not hold."""
        old = self.point(name)
        row = {"id": old.id, "lon": old.lon, "lat": old.lat, "height": old.height, "role": old.role, **fields}
        gcp = replace(self._checked(row, name), pixels=old.pixels)
        skipped = frozenset((gcp.id if point == name else point, view) for point, view in self._state.skipped)
        self._change(_State(tuple(gcp if point is old else point for point in self.points), skipped))
        return gcp

    def remove(self, name: str) -> None:
        self._change(replace(self._state, points=tuple(gcp for gcp in self.points if gcp.id != name)))

    def measure(self, name: str, view: str, pixel: Optional[FloatArray]) -> None:
        """Set, or with None remove, the (2,) pixel of a point in a view, and forget that the view was skipped."""
        self._change(_State(self._with_pixel(name, view, pixel), self._state.skipped - {(name, view)}))

    def skip(self, name: str, view: str) -> None:
        """Say that a view does not show a point; its pixel there is removed."""
        self._change(_State(self._with_pixel(name, view, None), self._state.skipped | {(name, view)}))

    @property
    def can_undo(self) -> bool:
        return bool(self._steps)

    def undo(self) -> bool:
        """Take the last change back; False where there is none."""
        if not self._steps:
            return False
        self._state, self.unsaved = self._steps.pop(), True
        return True

    def save(self, path: str) -> None:
        """Write the table that GCPS takes, heights above the ellipsoid; raises WorkspaceError."""
        write_gcps(path, self.points)
        self.unsaved = False

    def _checked(self, row: Dict[str, object], former: str) -> Gcp:
        gcp = point_of(f"Point '{row.get('id') or former}'", row)
        if gcp.id != former and any(point.id == gcp.id for point in self.points):
            raise InputTableError(f"There is already a point '{gcp.id}': give each point a name of its own.")
        return gcp

    def _with_pixel(self, name: str, view: str, pixel: Optional[FloatArray]) -> Tuple[Gcp, ...]:
        def changed(gcp: Gcp) -> Gcp:
            pixels = {known: value for known, value in gcp.pixels.items() if known != view}
            if pixel is not None:
                pixels[view] = np.asarray(pixel, dtype=np.float64)
            return replace(gcp, pixels=pixels)

        return tuple(changed(gcp) if gcp.id == name else gcp for gcp in self.points)

    def _change(self, state: _State) -> None:
        self._steps = [*self._steps[-_MOST_STEPS + 1 :], self._state]
        self._state, self.unsaved = state, True
