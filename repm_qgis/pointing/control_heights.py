"""Whether the heights of control points, as a whole, can be what their table says: above the ellipsoid and in metres.

Points that are all wrong by the same amount agree with each other, and an adjustment follows them. The vendors' RPCs
are an independent witness, as good as their promise; where they usually are better, a cause that fits is named already.
"""

from __future__ import annotations

from typing import Optional, Sequence

import numpy as np

from ..contracts.findings import Finding
from ..contracts.records import PointingFigures, ViewPair
from ..geometry.height_causes import likely_cause
from ..planning.height_uncertainty import usual_height_deviation
from ..planning.promises import promised
from ..scene import View
from .ground_control import Gcp, intersect
from .parameters import POINTING, PointingParameters


def heights_off(
    gcps: Sequence[Gcp],
    views: Sequence[View],
    pairs: Sequence[ViewPair],
    figures: Optional[PointingFigures],
    parameters: PointingParameters = POINTING,
) -> Optional[Finding]:
    """A finding where control points lie elsewhere in height than the vendors' RPCs see them, as a whole.

    ``pairs`` and ``figures`` say how well the RPCs agree, which shows how good their heights are; without them, they
    are as good as their promise.
    """
    promised_up_m = promised(views, parameters.planning).vertical_m
    usual_up_m = promised_up_m
    if pairs and figures is not None:
        usual_up_m = usual_height_deviation(pairs, figures, max(view.gsd_m for view in views), parameters.planning)
    plain = [view.with_pointing(np.eye(2, 3)) for view in views]
    control = [gcp for gcp in gcps if gcp.role == "control"]
    offsets = [(gcp, offset[2]) for gcp in control for offset in [intersect(gcp, plain)] if offset is not None]
    if not offsets:
        return None
    middle = float(np.median([up for _, up in offsets]))
    usual = parameters.places.believable * min(usual_up_m, promised_up_m)
    if abs(middle) <= usual:
        return None
    lon, lat, height = np.median([gcp.lon_lat_h for gcp, _ in offsets], axis=0)
    cause = likely_cause(middle, float(height), float(lon), float(lat), usual)
    if not cause and abs(middle) <= parameters.places.believable * promised_up_m:
        return None
    text = (
        f"The control points lie {abs(middle):.1f} m {'below' if middle > 0 else 'above'} where the vendors' RPCs see "
        f"them, as a whole, and usual errors of the RPCs are within {usual:.1f} m."
    )
    changed = f" They would change by {cause}." if cause else ""
    remedy = " Check the unit of their heights and GCP_DATUM."
    return Finding("gcp-heights-off", f"{text}{changed}{remedy}", "doubt")
