"""Charts as SVG, without a plotting library; they take the page's text colour, so they suit light and dark pages.

The templates draw (``resources/templates/charts.svg``); this module computes where everything lies, in px of the
drawing. Values that are not finite are left out; where nothing is left the drawing says so.
"""

from __future__ import annotations

import itertools
import math
import os
from dataclasses import dataclass, field
from typing import Iterable, List, Mapping, Optional, Sequence, Tuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..contracts.arrays import FloatArray
from ..runtime.progress import counted
from ..runtime.translation import said
from .templates import Drawing, draw

COLOURS = ("#2b83ba", "#e08214", "#35a06a", "#d1495b", "#8367b5", "#8c7a4b", "#1b9e9e", "#b5628f")
_WIDTH, _TOP, _BINS, _MOST_ARROWS = 640, 46, 80, 1500
_LONGEST = 24  # letters of a name in a key
_MOST_NAMED = 14  # outlines, in a key beside them
_IDS = itertools.count(1)  # an id is unique on the page, not only in its drawing

Pair = Tuple[float, float]
Values = TypeVar("Values", float, FloatArray)


def ticks(low: float, high: float, count: int = 6) -> List[float]:
    """Round numbers (1, 2 or 5 times a power of ten apart) inside [low, high], about ``count`` of them."""
    if not high > low:
        return [low]
    raw = (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * 0.999999)
    first = math.ceil(low / step - 1e-9)
    return [index * step for index in range(first, math.floor(high / step + 1e-9) + 1)]


def histogram(values: ArrayLike, unit: str = "", title: str = "") -> Drawing:
    """How often values (of any shape) occur, within their 0.5..99.5 % quantiles."""
    flat = np.asarray(values, float).ravel()
    flat = flat[np.isfinite(flat)]
    if flat.size == 0:
        return _nothing(title)
    counts, edges = np.histogram(flat, bins=_BINS, range=_opened(tuple(np.quantile(flat, (0.005, 0.995)))))
    return counted_histogram(counts, edges, unit, title, int(flat.size - counts.sum()))


def counted_histogram(
    counts: ArrayLike, edges: FloatArray, unit: str = "", title: str = "", outside: int = 0
) -> Drawing:
    """Bars of counts (n,) between edges (n + 1,), with a line at zero where zero lies inside.

    ``outside`` more values lie beyond the edges, and the drawing says so.
    """
    counts = np.asarray(counts, float)
    if counts.sum() == 0:
        return _nothing(title)
    total = counts.sum() + outside
    share = 100.0 * counts / total
    plot = _Plot((edges[0], edges[-1]), (0.0, float(share.max()) * 1.06), unit, "share of cells (%)")
    left, right, top = plot.x(edges[:-1]), plot.x(edges[1:]), plot.y(share)
    sizes = np.maximum(right - left - 0.4, 0.4), np.maximum(plot.y(0) - top, 0)
    note = f"{100.0 * outside / total:.2g} % outside this range" if outside else ""
    zero = plot.x(0) if edges[0] < 0 < edges[-1] else None
    return draw("histogram", title=title, plot=plot, bars=zip(left, top, *sizes), zero=zero, note=note)


def curves(
    series: Mapping[str, Tuple[ArrayLike, ArrayLike]],
    xlabel: str = "",
    ylabel: str = "",
    title: str = "",
    xlim: Optional[Pair] = None,
    ylim: Optional[Pair] = None,
) -> Drawing:
    """Lines through (x (n,), y (n,)), with their names. Lines break where a value is not finite."""
    data = [np.column_stack([np.asarray(v, float).ravel() for v in xy]) for xy in series.values()]
    known = np.concatenate([_finite(points) for points in data] or [np.empty((0, 2))])
    if len(known) == 0:
        return _nothing(title)
    plot = _Plot(xlim or _range(known[:, 0]), ylim or _range(known[:, 1], pad=0.05), xlabel, ylabel)
    parts = [(COLOURS[index % len(COLOURS)], part) for index, points in enumerate(data) for part in _runs(points)]
    lines = [(colour, _points(np.column_stack([plot.x(x), plot.y(y)]), 2)) for colour, (x, y) in parts]
    legend, more = _legend(list(series), plot) if len(data) > 1 else ([], None)
    return draw("curves", title=title, plot=plot, lines=lines, legend=legend, more=more)


def footprints(polygons: Mapping[str, ArrayLike], area: Optional[ArrayLike] = None, title: str = "") -> Drawing:
    """A map of outlines (N, 2) with a scale bar, north up, in metres of one CRS; ``area`` is drawn filled.

    Outlines of more images than a key can name have one colour, and only the pointer shows their names.
    """
    shapes = {name: _finite(points) for name, points in polygons.items()}
    shapes = {name: points for name, points in shapes.items() if len(points)}
    ground = _finite(area if area is not None else [])
    everything = np.concatenate([*shapes.values(), ground])
    if len(everything) == 0:
        return _nothing(title)
    low = everything.min(0)
    span = np.maximum(everything.max(0) - low, 1.0)
    metres_per_px = max(span[0] / (_WIDTH - 240.0), span[1] / 360.0)
    height = span[1] / metres_per_px + _TOP + 54

    def drawn(points: FloatArray) -> str:
        offset = (points - low) / metres_per_px
        return _points(np.column_stack([24 + offset[:, 0], height - 44 - offset[:, 1]]), 1)

    many = len(shapes) > _MOST_NAMED
    coloured = [
        (COLOURS[0 if many else i % len(COLOURS)], name, drawn(points))
        for i, (name, points) in enumerate(shapes.items())
    ]
    named = [said(counted(len(shapes), "image"))] if many else _apart(list(shapes))
    legend = [(colour, name) for (colour, _, _), name in zip(coloured, named)]
    legend += [("currentColor", said("area"))] * bool(len(ground))
    length = _nice_length(metres_per_px * 140)
    bar_text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    bar = {"bar": length / metres_per_px, "bar_text": bar_text, "height": max(height, 140.0, 54.0 + 18 * len(legend))}
    return draw("footprints", title=title, area=drawn(ground), shapes=coloured, legend=legend, **bar)


def arrows(
    positions: ArrayLike, vectors: ArrayLike, title: str = "", unit: str = "px", labels: Sequence[str] = ()
) -> Drawing:
    """Vectors (N, 2) in ``unit`` at their places (N, 2) in an image; the row axis points down.

    They are drawn so much longer that the 95 % longest is 1/25 of the width, and 1/10 where ``labels`` name the
    (few) points. Of very many an even selection is drawn.
    """
    at, by = np.asarray(positions, float).reshape(-1, 2), np.asarray(vectors, float).reshape(-1, 2)
    good = np.isfinite(at).all(1) & np.isfinite(by).all(1)
    at, by, names = at[good], by[good], [name for name, yes in zip(labels, good) if yes]
    if len(at) == 0:
        return _nothing(title)
    low, high = at.min(0), at.max(0)
    if names:  # room for arrows beyond the outermost points
        low, high = low - 0.12 * (high - low).max(), high + 0.12 * (high - low).max()
    span = np.maximum(high - low, 1.0)
    zoom = min((_WIDTH - 40.0) / span[0], 420.0 / span[1])
    typical = float(np.quantile(np.hypot(by[:, 0], by[:, 1]), 0.95)) or 1.0
    grow = span.max() / (10.0 if names else 25.0) / typical
    pick = np.unique(np.linspace(0, len(at) - 1, min(len(at), _MOST_ARROWS)).astype(int))
    start = (at[pick] - low) * zoom + (20.0, _TOP)
    end = start + by[pick] * grow * zoom
    key = _nice_length(typical)
    shafts = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for (a, b), (c, d) in zip(start, end))
    named = [(names[k], a, b) for k, (a, b) in zip(pick, start)] if names else []
    bar = {"bar": key * grow * zoom, "bar_text": f"{key:g} {unit} · {len(pick)} of {len(at)} vectors"}
    size = {"height": span[1] * zoom + _TOP + 44, "box": span * zoom}
    return draw("arrows", title=title, shafts=shafts, starts=start, names=named, **size, **bar)


def colour_bar(colours: Sequence[str], low: float, high: float, unit: str = "") -> Drawing:
    """The key of a coloured picture; ``colours`` are evenly spaced ``#rrggbb`` from ``low`` to ``high``."""
    values = ticks(low, high, 5)
    marks = [(16.0 + (v - low) / ((high - low) or 1.0) * 360.0, _label(v, values)) for v in values]
    stops = [(i / (len(colours) - 1), colour) for i, colour in enumerate(colours)]
    return draw("colour_bar", key=f"d{next(_IDS)}", stops=stops, marks=marks, unit=unit)


def legend(classes: Sequence[Tuple[str, str]]) -> Drawing:
    """The key of a picture of classes: colours (``#rrggbb``) and names, in their order."""
    return draw("legend", entries=[(16.0, 8.0 + 20 * row, *entry) for row, entry in enumerate(classes)])


@dataclass
class _Plot:
    """Axes in a fixed frame, and how values become places in it."""

    xlim: Pair
    ylim: Pair
    xlabel: str
    ylabel: str
    left, right, top, bottom = 62, 622, _TOP, 272
    clip: str = field(default_factory=lambda: f"d{next(_IDS)}")

    def __post_init__(self) -> None:
        self.xlim, self.ylim = _opened(self.xlim), _opened(self.ylim)

    def x(self, value: Values) -> Values:
        """A number's or an array's place."""
        return self.left + (value - self.xlim[0]) / (self.xlim[1] - self.xlim[0]) * (self.right - self.left)

    def y(self, value: Values) -> Values:
        return self.bottom - (value - self.ylim[0]) / (self.ylim[1] - self.ylim[0]) * (self.bottom - self.top)

    def x_ticks(self) -> Iterable[Tuple[float, str]]:
        values = ticks(*self.xlim, 7)
        return ((self.x(value), _label(value, values)) for value in values)

    def y_ticks(self) -> Iterable[Tuple[float, str]]:
        values = ticks(*self.ylim, 5)
        return ((self.y(value), _label(value, values)) for value in values)


def _nothing(title: str) -> Drawing:
    return draw("nothing", title=title)


def _range(values: FloatArray, pad: float = 0.0) -> Pair:
    low, high = float(values.min()), float(values.max())
    extra = (high - low) * pad
    return (low - extra if low < 0 or low > extra else low), high + extra


def _opened(limits: Tuple[float, ...]) -> Pair:
    """Limits that are apart."""
    low, high = float(limits[0]), float(limits[1])
    half = max(abs(low) * 0.01, 0.5)
    return (low, high) if high > low else (low - half, low + half)


def _finite(points: ArrayLike) -> FloatArray:
    """(n, 2) of the points whose both coordinates are finite."""
    array = np.asarray(points, float).reshape(-1, 2)
    finite: FloatArray = array[np.isfinite(array).all(1)]
    return finite


def _runs(points: FloatArray) -> List[FloatArray]:
    """The x and y, (2, n >= 2), of unbroken stretches of finite points."""
    parts = np.split(points, np.flatnonzero(~np.isfinite(points).all(1)))
    return [part.T for part in map(_finite, parts) if len(part) >= 2]


def _points(places: FloatArray, decimals: int) -> str:
    return " ".join(f"{x:.{decimals}f},{y:.{decimals}f}" for x, y in places)


def _nice_length(most: float) -> float:
    power = 10.0 ** math.floor(math.log10(most))
    return next(factor * power for factor in (5, 2, 1) if factor * power <= most * 1.000001)


def _legend(names: Sequence[str], plot: _Plot) -> Tuple[List[Tuple[str, float, str]], Optional[Tuple[float, str]]]:
    """Colour, place and text of the names that fit into one line, and place and text of how many do not."""
    found: List[Tuple[str, float, str]] = []
    x = float(plot.left)
    for index, name in enumerate(names):
        label = _short(said(name))
        width = 30 + 6.8 * len(label)
        if x + width > plot.right:
            return found, (x, f"and {len(names) - index} more")
        found.append((COLOURS[index % len(COLOURS)], x, label))
        x += width
    return found, None


def _apart(names: Sequence[str]) -> List[str]:
    """Names that fit into a key; of long ones what they have in common is left out, as products' names have much."""
    if len(names) < 2 or all(len(name) <= _LONGEST for name in names):
        return [_short(name) for name in names]
    before = len(os.path.commonprefix(list(names)))
    after = len(os.path.commonprefix([name[:before:-1] for name in names]))
    return [_short(f"{'…' * (before > 0)}{name[before : len(name) - after]}{'…' * (after > 0)}") for name in names]


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST else name[:11] + "…" + name[-11:]


def _label(value: float, all_ticks: Sequence[float]) -> str:
    step = abs(all_ticks[1] - all_ticks[0]) if len(all_ticks) > 1 else abs(value) or 1.0
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value + 0.0:.{decimals}f}" if step < 1e6 else f"{value:g}"
