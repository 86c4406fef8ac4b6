"""A truth scene of images of many sizes and ground sampling distances on disk: blocks of small frames, mixed sensors.

Files: the images, named as their exposures, uint16 GeoTIFF with RPC tags; ``truth.tif``: a square about the middle.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

import numpy as np

from repm_qgis.contracts.arrays import FloatArray
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.runtime.progress import Part, Progress
from repm_qgis.runtime.workspace import ensure_folder
from repm_qgis.simulation.parameters import SIMULATION, SimulationParameters
from repm_qgis.simulation.scene import (
    SceneSpec,
    fit_view_rpcs,
    make_surface,
    pointing_errors,
    surface_bounds,
    write_image,
    write_truth,
)
from repm_qgis.simulation.sensor import Look, PushbroomView, Sensor, aim

SKYSAT = Sensor("SKYSAT", 500e3, (), detectors=2560, wobble_rad=0.0, distortion_px=0.2)
"""A camera of frames: no attitude moves within one, because all its lines are exposed at once."""


@dataclass(frozen=True)
class Exposure:
    """One image: where its middle looks, metres along the flight and to its right of the scene's middle.

    Images of one ``flight`` have the same error of pointing, but for a part of their own.
    """

    name: str
    sensor: Sensor
    look: Look
    size: Tuple[int, int]
    along_m: float = 0.0
    right_m: float = 0.0
    flight: int = 0


def frames_of(
    looks: Sequence[Look], size: Tuple[int, int], grid: Tuple[int, int], overlap: Tuple[float, float] = (0.15, 0.25)
) -> List[Exposure]:
    """For each look, one pass of a camera of frames: ``grid`` frames to the right and along the flight.

    Neighbours share parts ``overlap`` of their width and of their height.
    """
    found = []
    for number, look in enumerate(looks, start=1):
        step = [side * (1.0 - shared) * look.gsd_m for side, shared in zip(size, overlap)]
        for row in range(grid[1]):
            for column in range(grid[0]):
                away = (row - (grid[1] - 1) / 2) * step[1], (column - (grid[0] - 1) / 2) * step[0]
                name = f"pass_{number}_frame_{row * grid[0] + column + 1:02d}"
                found.append(Exposure(name, SKYSAT, look, size, *away, number))
    return found


def exposed(spec: SceneSpec, exposures: Sequence[Exposure]) -> List[PushbroomView]:
    """The sensor model of each exposure."""
    low, high = spec.height_bounds
    height = 0.5 * (low + high) if spec.kind == "mountains" else spec.base_m
    frame, turn = EnuFrame(spec.lon, spec.lat, height), np.radians(spec.heading_deg)
    views = []
    for number, one in enumerate(exposures, start=1):
        east = one.along_m * np.sin(turn) + one.right_m * np.cos(turn)
        north = one.along_m * np.cos(turn) - one.right_m * np.sin(turn)
        place = (*frame.to_geodetic(np.array([[east, north, 0.0]]))[0][:2], height)
        seed = spec.seed + 101 * number
        views.append(
            aim(one.sensor, one.look, place, size=one.size, heading_deg=spec.heading_deg, seed=seed, name=one.name)
        )
    return views


def make_frames(
    spec: SceneSpec,
    exposures: Sequence[Exposure],
    folder: str,
    progress: Progress,
    parameters: SimulationParameters = SIMULATION,
) -> Dict[str, object]:
    """Simulate a scene of these exposures and write it into a folder; ``spec`` gives its ground, place and truth.

    Returns ``images`` (paths), ``truth`` (path) and ``biases``, (images, 2) px by which the RPCs are wrong. Raises
    WorkspaceError if the folder cannot be written, and Cancelled if the user stopped it; no half file is left.
    """
    folder = str(ensure_folder(os.path.abspath(folder)))
    views = exposed(spec, exposures)
    surface = make_surface(spec, surface_bounds(spec, views), Part(progress, 0.0, 0.3), parameters)
    fits = fit_view_rpcs(views, surface.height_range(), parameters)
    biases = _biases(spec, exposures, parameters)
    count = min(surface.height.shape) // spec.surface_step - 1
    row, column = ((side // spec.surface_step - count) // 2 * spec.surface_step for side in surface.height.shape)
    truth = os.path.join(folder, "truth.tif")
    write_truth(truth, surface, (row, column, count), spec.surface_step)
    images = []
    for number, (view, fit, bias) in enumerate(zip(views, fits, biases)):
        part = Part(progress, 0.3 + 0.7 * number / len(views), 0.3 + 0.7 * (number + 1) / len(views), view.name)
        images.append(os.path.join(folder, f"{view.name}.tif"))
        # Moving the image by -bias is the same as moving its RPC's projections by +bias.
        rpc = fit.rpc.shifted(-bias[0], -bias[1])
        write_image(images[-1], view, rpc, surface, spec.seed + number, part, parameters)
    progress.step(1.0, "done")
    return {"images": images, "truth": truth, "biases": biases}


def _biases(spec: SceneSpec, exposures: Sequence[Exposure], parameters: SimulationParameters) -> FloatArray:
    biases = np.empty((len(exposures), 2))
    for flight in sorted({one.flight for one in exposures}):
        own = [number for number, one in enumerate(exposures) if one.flight == flight]
        biases[own] = pointing_errors(len(own), spec.seed + flight, parameters.vendor)
    return biases
