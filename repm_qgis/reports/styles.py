"""Map styles as sidecar files of products: QGIS opens ``dsm.tif`` with ``dsm.qml`` beside it.

The templates lie in ``resources/styles``, and :data:`repm_qgis.contracts.products.STYLES` says which kind of layer has
which; this module fills in what depends on the data (the range, and the colours spread over it). Each is valid for QGIS
3.22 and later; an older QGIS ignores what it does not know (the elevation of 3.26).

| kind | what | range |
|---|---|---|
| dsm | elevation colours; it is a surface for profiles and 3-D views | 2..98 % of the heights |
| hillshade | QGIS's own hillshade, multiplied with the ``dsm`` that it lies over | none |
| error | equivalent error in px, in the classes and colours of the tiles | fixed classes in px |
| dsm_error | DSM - reference, blue (too low), white, red (too high) | symmetric about 0 |
| ept, mesh | elevation colours of the DSM that comes with them, in 3-D too; an ept with colours has these | given |
| confidence | the expected error in m, from dark (none) to bright | 0..98 % |
| confidence_count, confidence_source | the same raster's other bands: each value has its colour and name | all |
| objects | ground and objects, each with its colour and name | both |
| object_heights | heights of objects, from dark (none) to bright | 0..98 % |
| sources | the number of the DSM that a height of a mosaic comes from, each with its colour and name | all |
| ortho | grey, or red, green and blue; it has the time of its images | 2..98 %, of colours of 8 bits all |
| tiles | polygons by ``worst_rmse``, labelled | fixed classes in px |
| tie_points | points by ``residual``, arrows of the rows' residuals | fixed classes in px |
| differences, differences_before | reference - surface, m, as dsm_error | that of the differences before |
| offsets | arrows of the shift that each part of a scene would need, labelled with that of the height | given |
| change, significant | AFTER - BEFORE of two dates, m, as dsm_error; where it is significant | the usual change |
| significant_level | the level of detection in m, from dark (none) to bright | 0..98 % |
| trend | m per year, as dsm_error | symmetric about 0 |
| trend_error | its standard error, from dark (none) to bright | 0..98 % |
| changed, changed_last | the first and the last date of change, each with its colour and day | all |
| stack | elevation colours of the first date of a series | 2..98 % of its heights |
| dated | the heights of one date of a series, with its period | given |
| contours | lines, labelled with their ``height`` | none |
| slope, ruggedness | degrees and m of a DSM's relief, from dark (none) to bright | 0..98 % |
| shading | the grey hillshade of a DSM | 2..98 % |
| volumes | polygons by gain and loss, labelled with their volume in m3 | none |
| gcps | points by ``height_error``, labelled, arrows of their errors | fixed classes in m |
"""

from __future__ import annotations

import html
import json
import math
import os
import re
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatImage
from ..contracts.checks import as_text
from ..contracts.errors import OptionError
from ..contracts.products import STYLES, Style
from ..imagery.raster import opened
from ..runtime.translation import SOURCE_LANGUAGE, reader, said
from ..runtime.workspace import write_text
from .pictures import CLASSES, RAMPS, colour_limits, percentile_range, preview, ramp_table, rgb
from .templates import RESOURCES

_SAMPLE_PX = 1200
_FROM_ZERO = ("confidence", "object_heights", "significant_level", "trend_error", "slope", "ruggedness")
_AROUND_ZERO = ("dsm_error", "differences", "differences_before", "change", "significant", "trend")


def write_style(
    kind: str,
    path: str | os.PathLike[str],
    limits: Optional[Tuple[float, float]] = None,
    taken: Optional[Tuple[str, str]] = None,
) -> str:
    """Write the style of a raster or vector file as its sidecar; returns the path of the ``.qml``.

    ``limits`` and ``taken`` as for :func:`style_text`. Raises OptionError for an unknown kind, ImageError for a raster
    that cannot be read, WorkspaceError where the style cannot be written.
    """
    return write_text(str(Path(path).with_suffix(".qml")), style_text(kind, path, limits, taken))


def style_text(
    kind: str,
    path: str | os.PathLike[str],
    limits: Optional[Tuple[float, float]] = None,
    taken: Optional[Tuple[str, str]] = None,
) -> str:
    """The style of a raster or vector file, as the content of a ``.qml``.

    ``limits`` set a raster's range, so that maps that belong together have the same colours; a cloud (``ept``) and a
    ``mesh`` need them (see :func:`height_limits`). For ``gcps`` and ``offsets`` the second limit is the length in
    metres that an arrow of 10 mm shows. ``taken`` is when the first and the last image of an ``ortho`` or of
    ``footprints`` were taken, or the period of a ``dated`` layer, ISO 8601.

    Raises OptionError for an unknown kind, ImageError for a raster that cannot be read.
    """
    styles = {style.kind: style for style in STYLES if not style.plain}
    if kind not in styles:
        raise OptionError("kind", kind, f"must be one of {', '.join(sorted(styles))}")
    style = styles[kind]
    coloured = bool(style.coloured) and _has_colours(path)
    template = style.coloured if coloured else style.template or kind
    text = (RESOURCES / "styles" / f"{template}.qml").read_text(encoding="utf-8")
    if coloured:
        text = _stretched(text, path) if kind == "ortho" else text
    elif style.ramp:
        values, band = (np.empty(0, np.float32), 1) if limits and kind in ("ept", "mesh") else _shown(style, path)
        if kind == "differences":  # those before have the same colours
            values = preview(path, _SAMPLE_PX)[0]
        low, high = limits or value_range(kind, values)
        text = _filled(text, style, low, high).replace("@band@", str(band))
    elif style.template == "palette":
        text = text.replace("@items@", "\n".join(_entries(style, path))).replace("@band@", str(style.band))
    if "@arrow@" in text:
        length = limits[1] if limits else 1.0
        text = text.replace("@arrow@\n", (RESOURCES / "styles" / "arrow.xml").read_text(encoding="utf-8"))
        text = text.replace("@scale@", f"{10.0 / length:.6g}").replace("@length@", f"{length:g}")
    text = text.replace("@elevation@", str(int(kind == "dsm"))).replace("@temporal@", _temporal(kind, taken))
    return _in_readers_language(text)


def _has_colours(path: str | os.PathLike[str]) -> bool:
    """Whether a raster has three bands or more, or the points of an EPT have colours."""
    if Path(path).name == "ept.json":
        schema = json.loads(Path(path).read_text(encoding="utf-8"))["schema"]
        return any(dimension["name"] == "Red" for dimension in schema)
    with opened(os.fspath(path)) as dataset:
        return int(dataset.RasterCount) >= 3


def _stretched(template: str, path: str | os.PathLike[str]) -> str:
    """The template of colours with the range of each band; those of 8 bits are shown as they are."""
    for band, colour in enumerate(("red", "green", "blue"), start=1):
        low, high = colour_limits(path, band, _SAMPLE_PX)
        template = template.replace(f"@{colour}_min@", f"{low:.10g}").replace(f"@{colour}_max@", f"{high:.10g}")
    return template


def _in_readers_language(style: str) -> str:
    """A style with its labels in the reader's language, which a comment records."""
    if reader().language == SOURCE_LANGUAGE:
        return style
    labels = re.sub(r'(?<= label=")[^"]*', lambda label: html.escape(said(html.unescape(label[0]))), style)
    return labels.replace("<qgis ", f"<!-- language: {reader().language} -->\n<qgis ", 1)


def height_limits(dsm: str) -> Tuple[float, float]:
    """The range of heights over which a DSM's style spreads its colours."""
    return value_range("dsm", preview(dsm, _SAMPLE_PX)[0])


def _shown(style: Style, path: str | os.PathLike[str]) -> Tuple[FloatImage, int]:
    """Values of the band that a style shows, and its number: the first where the file does not have that many."""
    with opened(os.fspath(path)) as dataset:
        band = style.band if style.band <= dataset.RasterCount else 1
    return preview(path, _SAMPLE_PX, band)[0], band


def value_range(kind: str, values: FloatImage) -> Tuple[float, float]:
    """The range of a raster's values over which a kind of layer spreads its colours."""
    low, high = percentile_range(values)
    if kind in _AROUND_ZERO:
        limit = max(abs(low), abs(high))
        return -limit, limit
    return (0.0, high if high > 0 else 1.0) if kind in _FROM_ZERO else (low, high)


def _filled(template: str, style: Style, low: float, high: float) -> str:
    """A raster's template with the range, and the ramp's colours spread over it."""
    ramp = RAMPS[style.ramp]
    colours = [",".join(map(str, rgb(colour))) + ",255" for colour in ramp]
    decimals, last = int(np.clip(2 - math.floor(math.log10(high - low)), 0, 8)), len(colours) - 1
    stops = ":".join(f"{i / last:.6g};{colours[i]}" for i in range(1, last))
    items = [
        f'      <item value="{value:.10g}" color="{colour}" alpha="255" label="{value + 0.0:.{decimals}f}"/>'
        for value, colour in zip((low + (high - low) * i / last for i in range(last + 1)), ramp)
    ]
    shader = (RESOURCES / "styles" / "shader.xml").read_text(encoding="utf-8").rstrip()
    template = template.replace("@shader@", shader)
    places = {"min": f"{low:.10g}", "max": f"{high:.10g}", "precision": str(decimals), "stops": stops}
    places.update(first=colours[0], last=colours[-1], items="\n".join(items), unit=style.unit)
    places["plus"] = "true" if style.ramp == "diverging" else "false"
    for place, value in places.items():
        template = template.replace(f"@{place}@", value)
    return template


def _entries(style: Style, path: str | os.PathLike[str]) -> List[str]:
    """The colours and names of a discrete raster's values."""
    with opened(os.fspath(path)) as dataset:
        dates = [name for name in dataset.GetMetadata() if name.startswith("DATE_")]
        if dates:
            return _entries_of_dates([as_text(dataset.GetMetadataItem(f"DATE_{n}")) for n in range(1, len(dates) + 1)])
        # What the file states, or else what it holds.
        handle = dataset.GetRasterBand(min(style.band, dataset.RasterCount))
        most = handle.GetMaximum()
        highest = int(most if most is not None else handle.ComputeRasterMinMax(False)[1])
        files = {value: dataset.GetMetadataItem(f"DSM_{value}") for value in range(1, highest + 1)}
    if style.classes:
        named = [(value, name, CLASSES[value]) for value, name in enumerate(style.classes)]
    elif any(files.values()):
        names = {value: f"{value}: {Path(file).stem}" if file else str(value) for value, file in files.items()}
        named = [(value, name, CLASSES[(value - 1) % len(CLASSES)]) for value, name in names.items()]
    else:
        table = ramp_table("viridis", max(highest, 1))
        named = [(value, str(value), "#" + bytes(table[value - 1]).hex()) for value in files]
    return [_entry(value, name, colour) for value, name, colour in named]


def _entries_of_dates(labels: Sequence[str]) -> List[str]:
    """The colours of dates by their numbers, and their days as names."""
    colours = ramp_table("viridis", len(labels))
    return [_entry(value, label, "#" + bytes(colours[value - 1]).hex()) for value, label in enumerate(labels, start=1)]


def _entry(value: int, name: str, colour: str) -> str:
    return f'        <paletteEntry value="{value}" color="{colour}" alpha="255" label="{html.escape(name)}"/>'


def _temporal(kind: str, taken: Optional[Tuple[str, str]]) -> str:
    """When a layer shows the ground, for QGIS's temporal controller; "" where that is unknown."""
    if taken is None:
        return ""
    first, last = taken
    if kind == "footprints":  # each has its own time
        time = '"to_datetime(&quot;taken&quot;)"'
        return f'  <temporal enabled="1" mode="4" startExpression={time} endExpression={time}/>\n'
    ends = f"<fixedRange><start>{first}</start><end>{last}</end></fixedRange>"
    return f'  <temporal enabled="1" mode="0" fetchMode="0">{ends}</temporal>\n'
