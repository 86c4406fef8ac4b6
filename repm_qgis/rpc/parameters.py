"""The numbers that the export of corrected RPCs chooses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from ..parameters import Parameters


@dataclass(frozen=True)
class CorrectionParameters(Parameters):
    """How an affine correction is put into the numerators of an RPC (docs/algorithms/exportrpc.md has the study)."""

    nodes: Tuple[int, int, int] = (16, 16, 7)  # of the virtual grid: columns, rows, heights; chosen
    outset: float = 0.5  # steps by which the grid reaches beyond the image and its heights; chosen
    check_nodes: Tuple[int, int, int] = (33, 33, 15)  # of the grid on which the result is measured ...
    check_inset: float = 0.3  # ... and the steps by which its ends lie inside, so that it shares no node; chosen


CORRECTION = CorrectionParameters()
