"""Charts as SVG text, drawn by hand: no plotting library, and the page's own text colour, so they suit light and dark.

Every function gives one ``<svg>`` element for :meth:`repm_qgis.evaluation.report.Report.svg`. Values that are not
finite are left out; where nothing is left the drawing says so.
"""

from __future__ import annotations

import html
import itertools
import math
from typing import Any, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

COLOURS = ("#2b83ba", "#e08214", "#35a06a", "#d1495b", "#8367b5", "#8c7a4b", "#1b9e9e", "#b5628f")
_WIDTH, _HEIGHT = 640, 320
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 18, 46, 48
_FONT = "font-family=\"system-ui,'Segoe UI','Noto Sans','DejaVu Sans',sans-serif\""
_EARTH_RADIUS_M = 6371008.8
_IDS = itertools.count(1)  # ids are the page's, not the drawing's

Pair = Tuple[float, float]
Series = Mapping[str, Tuple[Any, Any]]


def ticks(low: float, high: float, count: int = 6) -> List[float]:
    """Round numbers (1, 2 or 5 times a power of ten apart) inside [low, high], about ``count`` of them."""
    if not high > low:
        return [low]
    raw = (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * 0.999999)
    first = math.ceil(low / step - 1e-9)
    return [index * step for index in range(first, math.floor(high / step + 1e-9) + 1)]


def histogram(values: Any, unit: str = "", title: str = "", bins: int = 80, limits: Optional[Pair] = None) -> str:
    """Bars of how often values occur, with a line at zero where zero lies inside.

    Parameters
    ----------
    values : array of any shape, or a pair (counts (n,), edges (n + 1,)) that was counted already.
    limits : range to draw, in ``unit``; None takes the 0.5..99.5 % quantiles, and the text says what lies outside.
    """
    counts, edges, outside = _counted(values, bins, limits)
    if counts.size == 0 or counts.sum() == 0:
        return _nothing(title)
    share = 100.0 * counts / (counts.sum() + outside)
    plot = _Plot((edges[0], edges[-1]), (0.0, float(share.max()) * 1.06), title)
    plot.axes(unit, "share of cells (%)")
    for value, left, right in zip(share, edges[:-1], edges[1:]):
        x, y = plot.x(left), plot.y(value)
        plot.add(
            f'<rect x="{x:.2f}" y="{y:.2f}" width="{max(plot.x(right) - x - 0.4, 0.4):.2f}" '
            f'height="{max(plot.y(0) - y, 0):.2f}" fill="{COLOURS[0]}"/>'
        )
    if edges[0] < 0 < edges[-1]:
        plot.line(0, plot.ylim[0], 0, plot.ylim[1], 'stroke="currentColor" stroke-dasharray="3 3" stroke-opacity="0.7"')
    if outside:
        plot.note(f"{100.0 * outside / (counts.sum() + outside):.2g} % outside this range")
    return plot.svg()


def curves(
    series: Series,
    xlabel: str = "",
    ylabel: str = "",
    title: str = "",
    xlim: Optional[Pair] = None,
    ylim: Optional[Pair] = None,
) -> str:
    """Lines through (x, y); ``series`` is {name: (x (n,), y (n,))}. Lines break where a value is not finite."""
    data = {name: (np.asarray(x, float).ravel(), np.asarray(y, float).ravel()) for name, (x, y) in series.items()}
    good = [(x[ok], y[ok]) for x, y in data.values() for ok in [np.isfinite(x) & np.isfinite(y)]]
    all_x, all_y = (np.concatenate([pair[i] for pair in good]) if good else np.empty(0) for i in (0, 1))
    if all_x.size == 0:
        return _nothing(title)
    plot = _Plot(xlim or _range(all_x), ylim or _range(all_y, pad=0.05), title)
    plot.axes(xlabel, ylabel)
    for index, (x, y) in enumerate(data.values()):
        colour = COLOURS[index % len(COLOURS)]
        for part in _runs(x, y):
            points = " ".join(f"{plot.x(a):.2f},{plot.y(b):.2f}" for a, b in part)
            plot.add(
                f'<polyline clip-path="url(#{plot.clip})" points="{points}" fill="none" stroke="{colour}" '
                'stroke-width="2" stroke-linejoin="round"/>'
            )
    if len(data) > 1:
        plot.legend(list(data))
    return plot.svg()


def bars(values: Mapping[str, float], unit: str = "", title: str = "") -> str:
    """One horizontal bar for each name, with its value written beside it."""
    items = [(str(name), float(value)) for name, value in values.items() if math.isfinite(float(value))]
    if not items:
        return _nothing(title)
    row, top = 26, 30 if title else 10
    left = min(30 + 7 * max(len(name) for name, _ in items), 260)
    top_value = max(max(value for _, value in items), 0.0) or 1.0
    parts = [_title(title)]
    for index, (name, value) in enumerate(items):
        y = top + row * index
        width = max(value, 0.0) / top_value * (_WIDTH - left - 110)
        label = html.escape(name if len(name) <= 34 else name[:33] + "…")
        parts.append(_text(left - 8, y + 16, label, anchor="end"))
        parts.append(
            f'<rect x="{left}" y="{y + 4}" width="{max(width, 0.5):.2f}" height="{row - 9}" rx="2" '
            f'fill="{COLOURS[0]}"/>'
        )
        parts.append(_text(left + width + 7, y + 16, f"{value:.4g} {html.escape(unit)}".strip()))
    return _wrap("".join(parts), height=top + row * len(items) + 10)


def footprints(
    polygons: Mapping[str, Any], area: Any = None, title: str = "", geographic: Optional[bool] = None
) -> str:
    """A map of outlines with a scale bar, north up.

    Parameters
    ----------
    polygons : {name: (N, 2) x, y}; longitude and latitude in degrees, or metres of one projected CRS.
    area : (N, 2) outline in the same coordinates, drawn filled; None = none.
    geographic : whether the coordinates are degrees; None = yes where all lie within ±360.
    """
    shapes = {str(name): _outline(points) for name, points in polygons.items()}
    shapes = {name: points for name, points in shapes.items() if len(points)}
    ground = _outline(area) if area is not None else np.empty((0, 2))
    everything = np.concatenate([*shapes.values(), ground]) if shapes or len(ground) else ground
    if len(everything) == 0:
        return _nothing(title)
    if geographic is None:
        geographic = bool(np.abs(everything).max() <= 360)
    place, metres_per_px, height = _map_frame(everything, geographic)
    parts = [_title(title)]
    if len(ground):
        parts.append(
            f'<polygon points="{_points(place(ground))}" fill="currentColor" fill-opacity="0.12" '
            'stroke="currentColor" stroke-width="1.4" stroke-dasharray="5 3"/>'
        )
    for index, (name, points) in enumerate(shapes.items()):
        colour, inside = COLOURS[index % len(COLOURS)], place(points)
        parts.append(
            f'<polygon points="{_points(inside)}" fill="{colour}" fill-opacity="0.08" stroke="{colour}" '
            f'stroke-width="1.6"><title>{html.escape(name)}</title></polygon>'
        )
    names = list(shapes) + (["area"] if len(ground) else [])
    parts.append(_legend_rows(names, _WIDTH - 190, _TOP + 8, area=bool(len(ground))))
    parts.append(_scale_bar(metres_per_px, height))
    return _wrap("".join(parts), height=height)


def arrows(
    positions: Any,
    vectors: Any,
    title: str = "",
    unit: str = "px",
    scale: Optional[float] = None,
    size: Optional[Pair] = None,
    most: int = 1500,
    labels: Sequence[str] = (),
) -> str:
    """Small vectors at their places in an image, such as residuals of tie points; the row axis points down.

    Parameters
    ----------
    positions, vectors : (N, 2) column, row and their change, in ``unit``.
    scale : how much longer than the positions' scale vectors are drawn; None makes the 95 % longest 1/25 of the width.
    size : width, height of the image; None = from the positions.
    most : of more vectors an even selection is drawn.
    labels : names of few points, written beside them; the vectors are drawn longer then, 1/10 of the width.
    """
    at, by = np.asarray(positions, float).reshape(-1, 2), np.asarray(vectors, float).reshape(-1, 2)
    good = np.isfinite(at).all(1) & np.isfinite(by).all(1)
    at, by, names = at[good], by[good], [name for name, yes in zip(labels, good) if yes]
    if len(at) == 0:
        return _nothing(title)
    low, high = (np.zeros(2), np.asarray(size, float)) if size else (at.min(0), at.max(0))
    if names:  # room for what reaches beyond the outermost points
        low, high = low - 0.12 * (high - low).max(), high + 0.12 * (high - low).max()
    span = np.maximum(high - low, 1.0)
    box_w, box_h = _WIDTH - 40.0, 420.0
    zoom = min(box_w / span[0], box_h / span[1])
    lengths = np.hypot(by[:, 0], by[:, 1])
    typical = float(np.quantile(lengths, 0.95)) or 1.0
    grow = scale if scale else span.max() / (10.0 if names else 25.0) / typical
    pick = np.unique(np.linspace(0, len(at) - 1, min(len(at), most)).astype(int))
    start = (at[pick] - low) * zoom + (20.0, _TOP)
    end = start + by[pick] * grow * zoom
    shafts = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for (a, b), (c, d) in zip(start, end))
    dots = "".join(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="1.5"/>' for a, b in start)
    height = span[1] * zoom + _TOP + 44
    key = _nice_length(typical)
    bar = key * grow * zoom
    parts = [
        _title(title),
        f'<rect x="20" y="{_TOP}" width="{span[0] * zoom:.1f}" height="{span[1] * zoom:.1f}" fill="none" '
        'stroke="currentColor" stroke-opacity="0.35"/>',
        f'<path d="{shafts}" fill="none" stroke="{COLOURS[3]}" stroke-width="1.2"/>',
        f'<g fill="{COLOURS[0]}">{dots}</g>',
        *(
            _text(a + 4, b - 4, html.escape(name))
            for name, (a, b) in zip((names[k] for k in pick) if names else (), start)
        ),
        f'<path d="M20 {height - 22:.1f}h{bar:.1f}" stroke="{COLOURS[3]}" stroke-width="2.4"/>',
        _text(28 + bar, height - 18, f"{key:g} {html.escape(unit)} · {len(pick)} of {len(at)} vectors"),
    ]
    return _wrap("".join(parts), height=height)


def colour_bar(colours: Sequence[str], low: float, high: float, unit: str = "") -> str:
    """The key of a coloured picture; ``colours`` are evenly spaced ``#rrggbb`` from ``low`` to ``high``."""
    width, left = 360.0, 16.0
    key = _next_id()
    stops = "".join(
        f'<stop offset="{i / (len(colours) - 1):.4f}" stop-color="{html.escape(c)}"/>' for i, c in enumerate(colours)
    )
    values = ticks(low, high, 5)
    parts = [
        f'<defs><linearGradient id="{key}">{stops}</linearGradient></defs>',
        f'<rect x="{left}" y="6" width="{width}" height="14" fill="url(#{key})" stroke="currentColor" '
        'stroke-opacity="0.4"/>',
    ]
    for value in values:
        x = left + (value - low) / ((high - low) or 1.0) * width
        parts.append(f'<path d="M{x:.1f} 20v4" stroke="currentColor"/>')
        parts.append(_text(x, 37, _label(value, values), anchor="middle"))
    parts.append(_text(left + width + 12, 18, html.escape(unit)))
    return _wrap("".join(parts), height=44)


class _Plot:
    """Axes in a fixed frame, and how values become places in it."""

    def __init__(self, xlim: Pair, ylim: Pair, title: str) -> None:
        self.xlim, self.ylim = _opened(xlim), _opened(ylim)
        self._parts = [_title(title)]
        self.clip = _next_id()
        self._parts.append(
            f'<clipPath id="{self.clip}"><rect x="{_LEFT}" y="{_TOP}" width="{_WIDTH - _LEFT - _RIGHT}" '
            f'height="{_HEIGHT - _TOP - _BOTTOM}"/></clipPath>'
        )

    def x(self, value: float) -> float:
        share = (value - self.xlim[0]) / (self.xlim[1] - self.xlim[0])
        return _LEFT + share * (_WIDTH - _LEFT - _RIGHT)

    def y(self, value: float) -> float:
        share = (value - self.ylim[0]) / (self.ylim[1] - self.ylim[0])
        return _HEIGHT - _BOTTOM - share * (_HEIGHT - _TOP - _BOTTOM)

    def add(self, text: str) -> None:
        self._parts.append(text)

    def line(self, x0: float, y0: float, x1: float, y1: float, style: str) -> None:
        self.add(
            f'<line x1="{self.x(x0):.2f}" y1="{self.y(y0):.2f}" x2="{self.x(x1):.2f}" y2="{self.y(y1):.2f}" {style}/>'
        )

    def axes(self, xlabel: str, ylabel: str) -> None:
        grid = 'stroke="currentColor" stroke-opacity="0.15"'
        x_ticks, y_ticks = ticks(*self.xlim, 7), ticks(*self.ylim, 5)
        for value in x_ticks:
            self.line(value, self.ylim[0], value, self.ylim[1], grid)
            self.add(_text(self.x(value), _HEIGHT - _BOTTOM + 16, _label(value, x_ticks), anchor="middle"))
        for value in y_ticks:
            self.line(self.xlim[0], value, self.xlim[1], value, grid)
            self.add(_text(_LEFT - 7, self.y(value) + 4, _label(value, y_ticks), anchor="end"))
        frame = 'stroke="currentColor" stroke-opacity="0.6"'
        self.line(self.xlim[0], self.ylim[0], self.xlim[1], self.ylim[0], frame)
        self.line(self.xlim[0], self.ylim[0], self.xlim[0], self.ylim[1], frame)
        middle = (_TOP + _HEIGHT - _BOTTOM) / 2
        self.add(_text((_LEFT + _WIDTH - _RIGHT) / 2, _HEIGHT - 10, html.escape(xlabel), anchor="middle"))
        self.add(
            f'<g transform="translate(14 {middle:.0f}) rotate(-90)">'
            f"{_text(0, 0, html.escape(ylabel), anchor='middle')}</g>"
        )

    def legend(self, names: Sequence[str]) -> None:
        self.add(_legend_line(names, _LEFT, _TOP - 14))

    def note(self, text: str) -> None:
        self.add(_text(_WIDTH - _RIGHT, _TOP - 6, html.escape(text), anchor="end", size=11))

    def svg(self) -> str:
        return _wrap("".join(self._parts))


def _next_id() -> str:
    return f"d{next(_IDS)}"


def _counted(values: Any, bins: int, limits: Optional[Pair]) -> Tuple[np.ndarray, np.ndarray, int]:
    if isinstance(values, tuple) and len(values) == 2 and len(values[1]) == len(values[0]) + 1:
        return np.asarray(values[0], float), np.asarray(values[1], float), 0
    flat = np.asarray(values, float).ravel()
    flat = flat[np.isfinite(flat)]
    if flat.size == 0:
        return np.empty(0), np.empty(0), 0
    low, high = limits or tuple(np.quantile(flat, (0.005, 0.995)))
    if not high > low:
        low, high = _opened((low, high))
    counts, edges = np.histogram(flat, bins=bins, range=(low, high))
    return counts.astype(float), edges, int(flat.size - counts.sum())


def _range(values: np.ndarray, pad: float = 0.0) -> Pair:
    low, high = float(values.min()), float(values.max())
    extra = (high - low) * pad
    return (low - extra if low < 0 or low > extra else low), high + extra


def _opened(limits: Pair) -> Pair:
    low, high = float(limits[0]), float(limits[1])
    half = max(abs(low) * 0.01, 0.5)
    return (low, high) if high > low else (low - half, low + half)


def _runs(x: np.ndarray, y: np.ndarray) -> List[np.ndarray]:
    """Unbroken stretches of finite points, each (n >= 2, 2)."""
    both = np.column_stack([x, y])
    breaks = np.flatnonzero(~np.isfinite(both).all(1))
    parts = np.split(both, breaks)
    cleaned = [part[np.isfinite(part).all(1)] for part in parts]
    return [part for part in cleaned if len(part) >= 2]


def _outline(points: Any) -> np.ndarray:
    array = np.asarray(points, float).reshape(-1, 2)
    return array[np.isfinite(array).all(1)]


def _map_frame(points: np.ndarray, geographic: bool) -> Tuple[Any, float, float]:
    """A function from coordinates to the drawing, the metres of one of its px, and its height in px."""
    low, high = points.min(0), points.max(0)
    middle = (low + high) / 2
    unit = np.ones(2)
    if geographic:
        degree = math.radians(1) * _EARTH_RADIUS_M
        unit = np.array([degree * max(math.cos(math.radians(middle[1])), 0.01), degree])
    span = np.maximum((high - low) * unit, 1.0)
    metres_per_px = max(span[0] / (_WIDTH - 240.0), span[1] / 360.0)
    height = span[1] / metres_per_px + _TOP + 54

    def place(these: np.ndarray) -> np.ndarray:
        offset = (these - low) * unit / metres_per_px
        return np.column_stack([24 + offset[:, 0], height - 44 - offset[:, 1]])

    return place, metres_per_px, max(height, 140.0)


def _points(places: np.ndarray) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places)


def _nice_length(most: float) -> float:
    power = 10.0 ** math.floor(math.log10(most))
    return next(factor * power for factor in (5, 2, 1) if factor * power <= most * 1.000001)


def _scale_bar(metres_per_px: float, height: float) -> str:
    length = _nice_length(metres_per_px * 140)
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    y = height - 14
    return (
        f'<path d="M24 {y - 5:.1f}v5h{length / metres_per_px:.1f}v-5" fill="none" stroke="currentColor" '
        f'stroke-width="1.5"/>{_text(32 + length / metres_per_px, y, text)}'
    )


def _legend_rows(names: Sequence[str], x: float, y: float, area: bool = False) -> str:
    shown = list(names[:14])
    parts = []
    for index, name in enumerate(shown):
        colour = "currentColor" if area and index == len(names) - 1 else COLOURS[index % len(COLOURS)]
        parts.append(f'<rect x="{x}" y="{y + 18 * index}" width="14" height="4" fill="{colour}"/>')
        parts.append(_text(x + 20, y + 18 * index + 6, html.escape(_short(name)), size=12))
    if len(names) > len(shown):
        parts.append(_text(x + 20, y + 18 * len(shown) + 6, f"and {len(names) - len(shown)} more", size=12))
    return "".join(parts)


def _legend_line(names: Sequence[str], x: float, y: float) -> str:
    parts = []
    for index, name in enumerate(names):
        label = _short(name)
        width = 30 + 6.8 * len(label)
        if x + width > _WIDTH - _RIGHT:
            parts.append(_text(x, y + 5, f"and {len(names) - index} more", size=12))
            break
        parts.append(f'<rect x="{x:.1f}" y="{y - 1}" width="14" height="4" fill="{COLOURS[index % len(COLOURS)]}"/>')
        parts.append(_text(x + 19, y + 5, html.escape(label), size=12))
        x += width
    return "".join(parts)


def _short(name: str) -> str:
    return name if len(name) <= 24 else name[:11] + "…" + name[-11:]


def _label(value: float, all_ticks: Sequence[float]) -> str:
    step = abs(all_ticks[1] - all_ticks[0]) if len(all_ticks) > 1 else abs(value) or 1.0
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value + 0.0:.{decimals}f}" if step < 1e6 else f"{value:g}"


def _title(text: str) -> str:
    return _text(16, 18, html.escape(text), size=14, weight="600") if text else ""


def _text(x: float, y: float, text: str, anchor: str = "start", size: int = 12, weight: str = "400") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="{size}" font-weight="{weight}" '
        f'fill="currentColor" {_FONT}>{text}</text>'
    )


def _nothing(title: str) -> str:
    return _wrap(_title(title) + _text(_WIDTH / 2, 70, "no data", anchor="middle"), height=110)


def _wrap(inner: str, height: Union[int, float] = _HEIGHT) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height:.0f}" width="{_WIDTH}" '
        f'height="{height:.0f}" role="img">{inner}</svg>'
    )
