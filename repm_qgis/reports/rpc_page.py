"""The HTML page of an export of corrected RPCs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..evaluation.gcp_accuracy import GcpAccuracy
from ..rpc.correction import CorrectedRpc
from ..runtime.progress import counted
from ..scene import View
from .report import Report, fixed


@dataclass(frozen=True)
class ExportedRpc:
    """A view's corrected RPC, and the correction at the image's middle.

    ``shift_px`` (2,) are columns and rows, ``moved_m`` (2,) metres east and north on the ground, NaN where they are not
    known.
    """

    view: View
    corrected: CorrectedRpc
    shift_px: FloatArray
    moved_m: FloatArray

    @property
    def files(self) -> Tuple[str, str, str]:
        """The names of its VRT, RPB and text."""
        name = self.view.name
        return f"{name}.vrt", f"{name}.RPB", f"{name}_RPC.TXT"


def within_px(exported: Sequence[ExportedRpc]) -> float:
    """The largest distance from the pointed model, rounded up to 0.0001 px, so that the stated bound holds."""
    worst = max(each.corrected.max_px for each in exported)
    return max(math.ceil(worst * 1e4), 1) / 1e4


def control_sentence(control: GcpAccuracy, view: str) -> str:
    """By how many control points a view was shifted, and how well they fit."""
    shift, used = control.shifts[view], control.rows("control")
    left = [each[view] for each, yes in zip(control.residuals["compensated"], used) if yes and view in each]
    count = sum(view in gcp.pixels for gcp, yes in zip(control.gcps, used) if yes)
    text = f"{view} was shifted by {shift[0]:+.2f}, {shift[1]:+.2f} px by {counted(count, 'control point')}"
    if not left:
        return f"{text}, which nothing checks."
    rms = float(np.sqrt(np.mean(np.sum(np.square(left), axis=1))))
    return f"{text}, which then fit to {rms:.2f} px (RMS, each without itself)."


def _add_control(page: Report, control: GcpAccuracy) -> None:
    """Each point in each image, before and after the shift."""
    rows = []
    for gcp, before, after in zip(control.gcps, control.residuals["rpc"], control.residuals["compensated"]):
        for view, residual in before.items():
            left = after.get(view, np.full(2, np.nan))
            role = "left out" if gcp.id in control.wrong else gcp.role
            rows.append([gcp.id, view, role, *fixed(*residual, *left, sign="+")])
    page.section("Control points")
    for view in control.shifts:
        page.paragraph(control_sentence(control, view))
    page.table(
        "point | image | role | column before, px | row before, px | column after, px | row after, px",
        rows,
        "Measured minus projected, with the RPC as delivered and with the shift, which is the mean of the control "
        "points' residuals: for a control point that of the others.",
    )


def rpc_page(exported: Sequence[ExportedRpc], scene: str, control: Optional[GcpAccuracy] = None) -> Report:
    """How each RPC was corrected, how far it is from the pointed model, where the image moves on the ground, and any
    control points that shifted it."""
    page = Report("Corrected RPCs", counted(len(exported), "image"))
    page.verdict(f"Every exported RPC is within {within_px(exported):.4f} px of the pointed model.")
    rows = []
    for each in exported:
        made = each.corrected
        errors = fixed(made.max_px, made.rms_px, decimals=5)
        rows.append([each.view.name, made.method, *errors, *fixed(*each.shift_px, *each.moved_m, sign="+")])
    page.section("Corrections").table(
        "image | method | largest difference, px | RMS, px | column shift, px | row shift, px | east, m | north, m",
        rows,
        "The difference is that of the exported RPC from the scene's pointed model, over the image and its heights, at "
        "points that no fit has used. The shift is the correction at the image's middle; east and north are how far "
        "the ground point of that pixel moves, at the middle of the scene's altitudes. Where the scene was made "
        "without control points and without a reference, corrections only make the images agree with each other.",
    )
    if control is not None:
        _add_control(page, control)
    page.section("Files").table(
        "image | original | VRT | RPB | text",
        [[each.view.name, each.view.image, *each.files] for each in exported],
        "The VRT shows the original's pixels with the corrected RPC, and takes the image's place in all software that "
        "reads with GDAL. The other two hold the same RPC for software that looks for a file beside an image of that "
        "name.",
    )
    return page.facts([("Scene", scene)])
