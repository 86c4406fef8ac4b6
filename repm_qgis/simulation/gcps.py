"""Ground control points of a truth scene: where all views see the ground, and what they measure there."""

from __future__ import annotations

import csv
import dataclasses
import io
from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np

from ..errors import OptionError
from ..workspace import write_text
from .render import RayCaster
from .sensor import PushbroomView
from .surface import FloatArray, SimulatedSurface

GCP_COUNT = 12
GCP_NOISE_PX = 0.3
_EDGE_PX = 4.0
_FLAT_M = 0.3


def common_square(surface: SimulatedSurface, views: Sequence[PushbroomView], step: int) -> Tuple[int, int, int]:
    """The largest square around the surface's middle that lies inside every image at every height.

    Returns
    -------
    First row and first column (multiples of ``step``) of nodes, and the count of every ``step``-th node a side.

    Raises OptionError if there is none.
    """
    middle = [step * int(round((n - 1) / 2 / step)) for n in surface.height.shape]
    low, high = 0, min(min(m, n - 1 - m) for m, n in zip(middle, surface.height.shape)) // step
    while low < high:
        half = (low + high + 1) // 2
        if _seen_by_all(surface, views, middle, half * step):
            low = half
        else:
            high = half - 1
    if low < 8:
        raise OptionError("SIZE", views[0].size[0], "is too small: the views have no ground in common")
    return middle[0] - low * step, middle[1] - low * step, 2 * low + 1


def _seen_by_all(surface: SimulatedSurface, views: Sequence[PushbroomView], middle: Sequence[int], half: int) -> bool:
    """Whether a square's edge projects into every image at the surface's lowest and highest height."""
    side = np.linspace(-half, half, 5)
    col, row = (part.ravel() for part in np.meshgrid(middle[1] + side, middle[0] + side))
    ground = surface.ground(col, row)
    for view in views:
        for height in surface.height_range():
            ground[:, 2] = height
            pixels = view.project(ground)
            if pixels.min() < _EDGE_PX or (pixels > np.array(view.size) - 1 - _EDGE_PX).any():
                return False
    return True


@dataclass(frozen=True)
class SimulatedGcp:
    """One point in one view: degrees, metres above the ellipsoid, px (first pixel's centre is (0, 0))."""

    id: str
    lon: float
    lat: float
    height: float
    view: str
    col: float
    row: float
    role: str


def choose_gcps(
    surface: SimulatedSurface, views: Sequence[PushbroomView], square: Tuple[int, int, int], step: int, seed: int
) -> List[SimulatedGcp]:
    """Flat, visible places spread over the common square, measured in the real sensor with noise of 0.3 px.

    In each of 4 x 3 fields of the square, the candidate seen by most views, among flat ground and roofs if there are
    any, else among the flattest places. Points that fewer than two views see are left out; a view that does not see a
    point has no row for it. Roles alternate by point.
    """
    rng = np.random.default_rng([seed, 3])
    casters = [RayCaster(surface, view) for view in views]
    extent = (square[2] - 1) * step
    result: List[SimulatedGcp] = []
    for number in range(GCP_COUNT):
        field_col, field_row = number % 4, number // 4
        place = rng.uniform(0.08, 0.92, (240, 2))
        col = square[1] + (field_col + place[:, 0]) / 4 * extent
        row = square[0] + (field_row + place[:, 1]) / 3 * extent
        # A flat roof is no better than flat enough ground: what is under the limit keeps its random order.
        uneven = np.maximum(_unevenness(surface, col, row, 2.5 * step), _FLAT_M)
        flattest = np.argsort(uneven, kind="stable")[:12]
        noise = rng.normal(0.0, GCP_NOISE_PX, (len(views), 2))
        best: List[Tuple[int, FloatArray]] = []
        for ground in surface.ground(col[flattest], row[flattest]):
            seen = [(n, pixel) for n, c in enumerate(casters) if (pixel := _seen_at(c, ground)) is not None]
            if len(seen) > len(best):
                best, point = seen, ground
            if len(best) == len(views):
                break
        if len(best) < 2:
            continue
        role = "check" if number % 2 else "control"
        for n, pixel in best:
            measured = pixel + noise[n]
            result.append(
                SimulatedGcp(f"P{number + 1:02d}", *map(float, point), views[n].name, *map(float, measured), role)
            )
    return result


def _unevenness(surface: SimulatedSurface, col: FloatArray, row: FloatArray, reach: float) -> FloatArray:
    """(N,) highest less lowest of 25 heights within ``reach`` nodes around places, m."""
    side = np.linspace(-reach, reach, 5)
    right, down = (part.ravel() for part in np.meshgrid(side, side))
    around = surface.heights(col[:, None] + right, row[:, None] + down)
    return np.ptp(around, axis=1)


def _seen_at(caster: RayCaster, ground: FloatArray) -> Optional[FloatArray]:
    """The pixel at which a view really sees a ground point; None if something hides it or it is outside."""
    pixel = caster.view.project(ground[None])[0]
    if pixel.min() < 0 or (pixel > np.array(caster.view.size) - 1).any():
        return None
    return pixel if abs(caster.heights_at(pixel[None])[0] - ground[2]) < 0.1 else None


def write_gcps(path: str, gcps: Sequence[SimulatedGcp]) -> None:
    """CSV with the header id, lon, lat, height, view, col, row, role."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([field.name for field in dataclasses.fields(SimulatedGcp)])
    for gcp in gcps:
        table.writerow(
            [
                gcp.id,
                f"{gcp.lon:.10f}",
                f"{gcp.lat:.10f}",
                f"{gcp.height:.4f}",
                gcp.view,
                f"{gcp.col:.4f}",
                f"{gcp.row:.4f}",
                gcp.role,
            ]
        )
    write_text(path, text.getvalue())
