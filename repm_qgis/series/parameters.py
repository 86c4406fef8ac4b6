"""The numbers that a series of DSMs chooses; docs/algorithms/series.md says what each is for."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class SeriesParameters(Parameters):
    """Trends and dates of change. "Chosen" means that no experiment is recorded."""

    share: float = 0.95  # of the intervals hold the true trend; of unchanged cells have no date of change
    efficiency: float = 1.0472  # variance of the slope over that of least squares at regular times: pi / 3 (Sen 1968)
    unconfirmed: float = 2.0  # levels that a change needs of which the first or the last date alone tells
    chosen_cells: float = 3.5  # errors of a cell that an outlined area's mean change has; errors alone make 2.0 to 3.2
    chosen_areas: float = 8.0  # or so many deviations of its volume; errors alone make up to 6
    beside_cells: int = 3  # around what changes: not stable either; chosen
    values_at_once: int = 4_000_000  # slopes of pairs of dates that lie in memory together
    stack_values: int = 16_000_000  # heights of all dates in a block, about
    block_cells: int = 1024  # side of a block, at most
    least_block_cells: int = 128  # and at least
    offset_errors: float = 0.5  # an offset of a date is worth a warning from so many of its errors on ...
    least_offset_m: float = 0.05  # ... and not below; chosen


SERIES = SeriesParameters()
