"""Map styles as sidecar files of products: QGIS opens ``dsm.tif`` with ``dsm.qml`` beside it.

The templates lie in ``resources/styles``; this module fills in what depends on the data (the range, and the colours
spread over it). Each is valid for QGIS 3.22 and later.

| kind | what | range |
|---|---|---|
| dsm | elevation colours | 2..98 % of the heights |
| hillshade | QGIS's own hillshade, multiplied with the ``dsm`` that it lies over | none |
| error | equivalent error in px, from dark (none) to bright | 0..98 % |
| dsm_error | DSM - reference, blue (too low), white, red (too high) | symmetric about 0 |
| ept, mesh | elevation colours of the DSM that comes with them | given |
| confidence | height maps that agree, or the matching score where there is only one; dark (low) to bright | 2..98 % |
| ortho | grey | 2..98 % |
| tiles | polygons by ``worst_rmse``, labelled | fixed classes in px |
| tie_points | points by ``residual``, arrows of the rows' residuals | fixed classes in px |
| gcps | points by ``height_error``, labelled, arrows of their errors | fixed classes in m |
"""

from __future__ import annotations

import html
import math
import os
import re
from pathlib import Path
from typing import Optional, Tuple

import numpy as np

from ..arrays import FloatImage
from ..errors import OptionError
from ..imagery.raster import opened
from ..products import STYLES
from ..translation import SOURCE_LANGUAGE, reader, said
from ..workspace import write_text
from .pictures import RAMPS, percentile_range, preview, rgb
from .templates import RESOURCES

_RAMP_OF = {style.kind: style.ramp for style in STYLES if style.ramp}
_SAMPLE_PX = 1200


def write_style(kind: str, path: str | os.PathLike[str], limits: Optional[Tuple[float, float]] = None) -> str:
    """Write the style of a raster or vector file as its sidecar; returns the path of the ``.qml``.

    ``limits`` set a raster's range, so that maps that belong together have the same colours; a cloud (``ept``) and a
    ``mesh`` need them (see :func:`height_limits`). For ``gcps`` the second limit is the error in metres that an arrow
    of 10 mm shows.

    Raises OptionError for an unknown kind, ImageError for a raster that cannot be read, WorkspaceError where the
    style cannot be written.
    """
    templates = {template.stem: template for template in (RESOURCES / "styles").glob("*.qml")}
    if kind not in templates:
        raise OptionError("kind", kind, f"must be one of {', '.join(sorted(templates))}")
    text = templates[kind].read_text(encoding="utf-8")
    if kind in _RAMP_OF:
        values, band = (np.empty(0, np.float32), 1) if limits and kind in ("ept", "mesh") else _shown(kind, path)
        low, high = limits or _value_range(kind, values)
        text = _filled(text, _RAMP_OF[kind], low, high).replace("@band@", str(band))
    if kind == "gcps":
        length = limits[1] if limits else 1.0
        text = text.replace("@scale@", f"{10.0 / length:.6g}").replace("@length@", f"{length:g}")
    return write_text(str(Path(path).with_suffix(".qml")), _said(text))


def _said(style: str) -> str:
    """A style with its labels in the reader's language, which a comment records."""
    if reader().language == SOURCE_LANGUAGE:
        return style
    labels = re.sub(r'(?<= label=")[^"]*', lambda label: html.escape(said(html.unescape(label[0]))), style)
    return labels.replace("<qgis ", f"<!-- language: {reader().language} -->\n<qgis ", 1)


def height_limits(dsm: str) -> Tuple[float, float]:
    """The range of heights over which a DSM's style spreads its colours."""
    return _value_range("dsm", _shown("dsm", dsm)[0])


def _shown(kind: str, path: str | os.PathLike[str]) -> Tuple[FloatImage, int]:
    """Values of the band that a style shows, and its number.

    Of a confidence that is the number of height maps that agree. It is the same everywhere where two images make one
    height map; the matching score of band 3 is shown instead then.
    """
    values = preview(path, _SAMPLE_PX)[0]
    known = values[np.isfinite(values)]
    if kind == "confidence" and known.size and float(known.max() - known.min()) < 1e-6:
        with opened(os.fspath(path)) as dataset:
            bands = dataset.RasterCount
        if bands >= 3:
            return preview(path, _SAMPLE_PX, 3)[0], 3
    return values, 1


def _value_range(kind: str, values: FloatImage) -> Tuple[float, float]:
    low, high = percentile_range(values)
    if kind == "dsm_error":
        limit = max(abs(low), abs(high))
        return -limit, limit
    return (0.0, high if high > 0 else 1.0) if kind == "error" else (low, high)


def _filled(template: str, ramp: str, low: float, high: float) -> str:
    """A raster's template with the range, and the ramp's colours spread over it."""
    colours = [",".join(map(str, rgb(colour))) + ",255" for colour in RAMPS[ramp]]
    decimals, last = int(np.clip(2 - math.floor(math.log10(high - low)), 0, 8)), len(colours) - 1
    stops = ":".join(f"{i / last:.6g};{colours[i]}" for i in range(1, last))
    items = [
        f'          <item value="{value:.10g}" color="{colour}" alpha="255" label="{value + 0.0:.{decimals}f}"/>'
        for value, colour in zip((low + (high - low) * i / last for i in range(last + 1)), RAMPS[ramp])
    ]
    places = {"min": f"{low:.10g}", "max": f"{high:.10g}", "precision": str(decimals), "stops": stops}
    for place, value in {**places, "first": colours[0], "last": colours[-1], "items": "\n".join(items)}.items():
        template = template.replace(f"@{place}@", value)
    return template
