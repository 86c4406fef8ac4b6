"""The HTML page of an export of corrected RPCs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Sequence, Tuple

from ..contracts.arrays import FloatArray
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


def rpc_page(exported: Sequence[ExportedRpc], scene: str) -> Report:
    """How each RPC was corrected, how far it is from the pointed model, and where the image moves on the ground."""
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
    page.section("Files").table(
        "image | original | VRT | RPB | text",
        [[each.view.name, each.view.image, *each.files] for each in exported],
        "The VRT shows the original's pixels with the corrected RPC, and takes the image's place in all software that "
        "reads with GDAL. The other two hold the same RPC for software that looks for a file beside an image of that "
        "name.",
    )
    return page.facts([("Scene", scene)])
