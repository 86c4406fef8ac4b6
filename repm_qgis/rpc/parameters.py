"""The numbers that the fit of RPCs and the export of corrected ones choose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class CorrectionParameters(Parameters):
    """How an affine correction is put into the numerators of an RPC (docs/algorithms/exportrpc.md has the study)."""

    nodes: Tuple[int, int, int] = (16, 16, 7)  # of the virtual grid: columns, rows, heights; chosen
    wave_lines: int = 96  # the same along the lines of an image with jitter: several nodes for each wave; chosen
    outset: float = 0.5  # steps by which the grid reaches beyond the image and its heights; chosen
    check_nodes: Tuple[int, int, int] = (33, 33, 15)  # of the grid on which the result is measured ...
    check_inset: float = 0.3  # ... and the steps by which its ends lie inside, so that it shares no node; chosen


@dataclass(frozen=True)
class RpcFitParameters(Parameters):
    """The fit of an RPC to a sensor (Tao and Hu 2001)."""

    nodes: Tuple[int, int, int] = (16, 16, 7)  # of the virtual grid, along columns, rows and heights
    ridge: float = 1e-6  # of the largest singular value: costs under 1e-3 px, and keeps denominators near one
    reweights: int = 4  # passes, each weighted by the denominator of the one before


CORRECTION = CorrectionParameters()
RPC_FIT = RpcFitParameters()
