"""Map styles beside the products: ``dsm.tif`` gets ``dsm.qml``, which QGIS finds by itself when it opens the file.

The templates lie in ``resources/styles``; what depends on the data (the range, and the colours spread over it) is
filled in here. Each is valid for QGIS 3.22 and later.

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

import math
import os
from pathlib import Path
from typing import Dict, Optional, Tuple, Union

import numpy as np

from ..errors import OptionError, WorkspaceError
from ..imagery.raster import opened
from ..workspace import write_text
from .pictures import RAMPS, preview, rgb, spread

STYLES = Path(__file__).resolve().parents[2] / "resources" / "styles"
_RAMP_OF = {
    "dsm": "elevation",
    "error": "viridis",
    "dsm_error": "diverging",
    "confidence": "viridis",
    "ortho": "grey",
    "ept": "elevation",
    "mesh": "elevation",
}
KINDS = ("dsm", "hillshade", "error", "dsm_error", "confidence", "ortho", "tiles", "tie_points", "gcps", "ept", "mesh")
_SAMPLE_PX = 1200


def write_style(kind: str, path: Union[str, os.PathLike], limits: Optional[Tuple[float, float]] = None) -> str:
    """Write the style of a raster or vector file beside it; gives the path of the ``.qml``.

    ``limits`` set a raster's range by hand, so that maps that belong together can be compared by their colours; of
    ``gcps`` the second one is the error in metres that an arrow of 10 mm shows.

    A cloud (``ept``) and a ``mesh`` need them: see :func:`height_limits`.

    Raises OptionError for an unknown kind, ImageError for a raster that cannot be read, WorkspaceError where the
    style cannot be written.
    """
    if kind not in KINDS:
        raise OptionError("kind", kind, f"must be one of {', '.join(KINDS)}")
    template = STYLES / f"{kind}.qml"
    try:
        text = template.read_text(encoding="utf-8")
    except OSError as error:
        raise WorkspaceError(
            f"The style '{template}' cannot be read ({error.strerror or error}): install the plugin again."
        ) from error
    if kind in _RAMP_OF:
        if limits and kind in ("ept", "mesh"):
            values, band = np.empty(0), 1
        else:
            values, band = _shown(kind, path)
        text = _filled(text, kind, *(limits or _value_range(kind, values))).replace("@band@", str(band))
    if kind == "gcps":
        length = limits[1] if limits else 1.0
        text = text.replace("@scale@", f"{10.0 / length:.6g}").replace("@length@", f"{length:g}")
    return write_text(str(Path(path).with_suffix(".qml")), text)


def height_limits(dsm: str) -> Tuple[float, float]:
    """The range of heights over which a DSM's style spreads its colours."""
    return _value_range("dsm", _shown("dsm", dsm)[0])


def _shown(kind: str, path: Union[str, os.PathLike]) -> Tuple[np.ndarray, int]:
    """Values of the band that a style shows, and its number.

    Of a confidence that is the number of height maps that agree; where it is the same everywhere (two images make one
    height map) it tells nothing, and the matching score of band 3 takes its place.
    """
    values = preview(path, _SAMPLE_PX)[0]
    known = values[np.isfinite(values)]
    if kind == "confidence" and known.size and float(known.max() - known.min()) < 1e-6:
        with opened(os.fspath(path)) as dataset:
            bands = dataset.RasterCount
        if bands >= 3:
            return preview(path, _SAMPLE_PX, 3)[0], 3
    return values, 1


def _value_range(kind: str, values: np.ndarray) -> Tuple[float, float]:
    low, high = spread(values)
    if kind == "dsm_error":
        limit = max(abs(low), abs(high))
        return -limit, limit
    if kind == "error":
        return 0.0, high if high > 0 else 1.0
    return low, high


def _filled(template: str, kind: str, low: float, high: float) -> str:
    colours = RAMPS[_RAMP_OF[kind]]
    decimals = int(np.clip(2 - math.floor(math.log10(high - low)), 0, 8))
    places: Dict[str, str] = {
        "@min@": f"{low:.10g}",
        "@max@": f"{high:.10g}",
        "@precision@": str(decimals),
        "@first@": _colour(colours[0]),
        "@last@": _colour(colours[-1]),
        "@stops@": ":".join(f"{i / (len(colours) - 1):.6g};{_colour(c)}" for i, c in enumerate(colours[1:-1], start=1)),
        "@items@": "\n".join(
            _item(low + (high - low) * i / (len(colours) - 1), c, decimals) for i, c in enumerate(colours)
        ),
    }
    for place, value in places.items():
        template = template.replace(place, value)
    return template


def _item(value: float, colour: str, decimals: int) -> str:
    return f'          <item value="{value:.10g}" color="{colour}" alpha="255" label="{value + 0.0:.{decimals}f}"/>'


def _colour(hexadecimal: str) -> str:
    return ",".join(map(str, rgb(hexadecimal))) + ",255"
