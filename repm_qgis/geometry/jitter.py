"""Attitude jitter: how far the content of an image line is displaced from where the view's RPC puts it.

Satellites shake: waves of 0.1 to 1 px and some hundred to some thousand lines, which no RPC can hold. A wave is a
uniform cubic B-spline of the image's lines (de Boor, A Practical Guide to Splines, 1978), one for columns and one for
rows. It is a function of the line that a pixel really lies in, because each line was recorded at one time, with the
attitude of that time: from the image to the ground it is subtracted directly, and from the ground to the image by
iteration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Optional, Tuple

import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import FloatArray
from ..contracts.checks import Array, Number
from ..contracts.record import Record

_STEPS = 30  # at most: each makes the error fifty times smaller
_TOLERANCE_PX = 1e-9
_STEEPEST = 0.3  # px for each line: real jitter has a tenth of it, and up to 1 the iteration would converge
ORDER = 4  # of cubic splines: so many of them are not zero in a line


@dataclass(frozen=True)
class Jitter(Record):
    """The waves of one view: ``coefficients`` (n, 2) px, column and row, of splines from the line ``first`` to the line
    ``last``. Beyond these the waves go on with their values there.
    """

    first: Annotated[float, Number(-1e6, 1e9)]
    last: Annotated[float, Number(-1e6, 1e9)]
    coefficients: Annotated[FloatArray, Array((-1, 2), most=1e4)]

    def contradiction(self) -> str:
        if len(self.coefficients) < ORDER:
            return f"has {len(self.coefficients)} coefficients of splines, fewer than {ORDER}"
        if self.last < self.first + 1.0:
            return "has a last line that is not after its first one"
        steps = np.abs(np.diff(self.coefficients, axis=0))
        # A spline is nowhere steeper than the steps of its coefficients.
        if steps.max() * (len(self.coefficients) - ORDER + 1) > _STEEPEST * (self.last - self.first):
            return "has waves that are too steep for jitter"
        return ""

    def packed(self) -> FloatArray:
        """(n + 1, 2) the first and the last line, and below them the coefficients."""
        return np.vstack([[self.first, self.last], self.coefficients])

    @classmethod
    def unpacked(cls, values: Optional[FloatArray]) -> Optional[Jitter]:
        """The jitter of :meth:`packed` values; None of None."""
        return None if values is None else cls(float(values[0, 0]), float(values[0, 1]), values[1:])

    def at(self, rows: FloatArray) -> FloatArray:
        """(..., 2) px, column and row, in lines (...) of the image; NaN in gives NaN out."""
        places = np.asarray(rows, dtype=np.float64)
        first, weights = splines(places.ravel(), (self.first, self.last), len(self.coefficients))
        moved = np.zeros((places.size, 2))
        for k in range(ORDER):
            moved += weights[:, k, None] * self.coefficients[first + k]
        return moved.reshape(places.shape + (2,))

    @property
    def most_px(self) -> float:
        """The largest distance by which a line is moved."""
        return float(np.linalg.norm(self.at(self._some_lines()), axis=1).max())

    @property
    def rms_px(self) -> Tuple[float, float]:
        """The root mean square of the waves over the lines, px: of columns and rows."""
        columns, rows = np.sqrt(np.mean(self.at(self._some_lines()) ** 2, axis=0))
        return float(columns), float(rows)

    def _some_lines(self) -> FloatArray:
        return np.linspace(self.first, self.last, 10 * len(self.coefficients))

    def removed(self, pixels: FloatArray) -> FloatArray:
        """(..., 2) pixels as a steady camera would have them, from those of the image."""
        steady: FloatArray = pixels - self.at(pixels[..., 1])
        return steady

    def added(self, steady: FloatArray) -> FloatArray:
        """The inverse of :meth:`removed`: pixels of the image from those of a steady camera."""
        pixels: FloatArray = steady + self.at(steady[..., 1])
        for _ in range(_STEPS):
            better = steady + self.at(pixels[..., 1])
            change = np.abs(better - pixels)
            pixels = better
            if not (change > _TOLERANCE_PX).any():
                break
        return pixels


def splines(rows: FloatArray, ends: Tuple[float, float], count: int) -> Tuple[NDArray[np.intp], FloatArray]:
    """The four of ``count`` splines between the lines ``ends`` that are not zero in lines (N,): the number of the first
    one (N,), and the values of all four (N, 4), whose sum is one."""
    intervals = count - ORDER + 1
    t = (np.clip(rows, *ends) - ends[0]) * (intervals / (ends[1] - ends[0]))
    first = np.minimum(np.nan_to_num(t), intervals - 1).astype(np.intp)
    u = t - first
    v = 1.0 - u
    values = (v**3, 3 * u**3 - 6 * u**2 + 4, 3 * v**3 - 6 * v**2 + 4, u**3)
    return first, np.stack(values, axis=-1) / 6.0
