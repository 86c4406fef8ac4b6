"""What an unbiased adjustment with noisy control points can reach at best: the Cramer-Rao bound."""

from __future__ import annotations

from typing import List, Sequence

import numpy as np

from benchmarks.pointing_case import Case, numeric_moves
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.numerics.robust import NMAD_FACTOR
from repm_qgis.pointing.adjustment import adjust
from repm_qgis.pointing.ground_control import Gcp
from repm_qgis.pointing.pointing import Pointing
from repm_qgis.ties.tracks import Track

DRAWS = 10  # of noisy control points
TERMS = {"shift": 2, "affine": 6}  # of a view's correction


def pointing_basis(pixels: np.ndarray, kind: str, size: int) -> np.ndarray:
    """(N, 2, p) how a view's pixels move with its shift or affine correction."""
    scaled = 2 * pixels / (size - 1) - 1
    one = np.column_stack([np.ones(len(pixels)), *([scaled] if kind == "affine" else [])])
    return np.concatenate([np.stack([one, 0 * one], axis=1), np.stack([0 * one, one], axis=1)], axis=2)


def tie_information(case: Case, tracks: Sequence[Track], ground: np.ndarray, kind: str) -> np.ndarray:
    """Fisher information of the ties about all views' corrections, with the noise that they have about the truth."""
    p = TERMS[kind]
    enu = EnuFrame(*ground.mean(axis=0))
    moves = [numeric_moves(view, ground, enu) for view in case.true]
    seen = [view.project(ground) for view in case.true]
    parts, sizes = [], []
    for k, track in enumerate(tracks):
        views = [i for i, view in enumerate(case.true) if view.name in track.pixels]
        J = np.concatenate([moves[i][k] for i in views])
        free = np.eye(len(J)) - J @ np.linalg.pinv(J)
        design = np.zeros((len(J), p * len(case.true)))
        for row, i in enumerate(views):
            basis = pointing_basis(seen[i][k : k + 1], kind, case.size)[0]
            design[2 * row : 2 * row + 2, i * p : (i + 1) * p] = basis
        misfit = free @ np.concatenate([track.pixels[case.true[i].name] - seen[i][k] for i in views])
        sizes.append(np.linalg.norm(misfit) / np.sqrt(len(J) - 3))
        parts.append(free @ design)
    design = np.concatenate(parts)
    return design.T @ design / (NMAD_FACTOR * float(np.median(sizes))) ** 2


def expected_px(case: Case, ties: np.ndarray, gcps: Sequence[Gcp], noise: float, kind: str) -> float:
    """The Cramer-Rao bound of the absolute error: RMS over the views at points of the surface, px."""
    information = ties.copy()
    surface, p, variance = case.ground(600, 78), TERMS[kind], []
    for gcp in gcps:
        for i, view in enumerate(case.true):
            basis = pointing_basis(view.project(gcp.lon_lat_h[None]), kind, case.size)[0]
            information[i * p : (i + 1) * p, i * p : (i + 1) * p] += basis.T @ basis / noise**2
    covariance = np.linalg.inv(information)
    for i, view in enumerate(case.true):
        basis = pointing_basis(view.project(surface), kind, case.size)
        own = covariance[i * p : (i + 1) * p, i * p : (i + 1) * p]
        variance.append(np.einsum("nij,jk,nik->n", basis, own, basis))
    return float(np.sqrt(np.mean(variance)))


def controlled(case: Case, found: Pointing, altitude: float, kind: str) -> List[object]:
    """The table's columns of ground control: absolute errors with exact and noisy points, and what noise allows."""
    plain, surface = case.views(), case.ground(600, 78)
    ties = tie_information(case, found.tracks, found.adjusted.ground, kind)
    cells, named, right, square, bound = [], [], 0, [], []
    for noise, draw in [(0.0, 0), *((0.3, draw) for draw in range(DRAWS))]:
        gcps = case.gcps(12, noise, 2, 4 + draw)
        made = adjust(plain, found.tracks, altitude, "auto", gcps)
        named.append(", ".join(sorted(made.rejected)) or "none")
        right += made.model == kind
        if draw == 0:
            error = case.absolute_px(made.pointing)
            cells.append(f"{np.median(error):.3f} / {error.max():.3f}")
        if noise:
            misfits = case.misfits(made.pointing, surface)
            square.append(np.mean([(misfit**2).sum(axis=1) for misfit in misfits]))
            bound.append(expected_px(case, ties, gcps[2:], noise, kind) ** 2)
    rms = (f"{np.sqrt(np.mean(part)):.3f}" for part in (square, bound))
    names = "; ".join(f"{name} ({named.count(name)})" for name in dict.fromkeys(named))
    return [*cells, *rms, f"{right} of {DRAWS + 1}", names]
