"""Running COLMAP's patch match on the GPUs: its options, its memory, one worker for each GPU, and its failures.

COLMAP is used unchanged (Schoenberger, Zheng, Pollefeys, Frahm, Pixelwise View Selection for Unstructured Multi-View
Stereo, 2016).
"""

from __future__ import annotations

import json
import os
import queue
import subprocess  # nosec B404 # see its one use
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence, TypeVar, Union

from ..contracts.errors import Cancelled, DeviceError
from ..runtime.environment import Gpu
from ..runtime.parallel import as_they_end
from ..runtime.progress import Progress
from ..runtime.workspace import write_text
from .parameters import COLMAP, PatchMatchParameters

ROOT = Path(__file__).resolve().parents[2]
_POLL_S = 0.1
_CONTEXT_BYTES = 600 << 20  # of CUDA itself
# Bytes for each pixel, by the buffers that COLMAP 4.2 allocates. Reference: random states (twice, while they are
# rotated), depth, normal, sums; each source: cost, selection probabilities, their rotated copies, image, depth.
_REFERENCE_BYTES, _SOURCE_BYTES = 136, 26
_FULL = ("out of memory", "std::bad_alloc", "memory allocation")

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class PatchMatchOptions:
    """The user's choices: geometric consistency, radius of the window (px), memory of a GPU (GiB, 0 is what is free).

    ``fusion``: only depths that COLMAP's own fusion uses are kept.
    """

    geometric: bool = True
    window_radius: int = 5
    memory_gib: float = 0.0
    fusion: bool = False


Runner = Callable[[str, Dict[str, object], Optional[Dict[str, object]], threading.Event], None]
"""Runs patch match in a workspace with COLMAP's options, and fusion with its own; it ends when the event is set."""


def fusion_options(parameters: PatchMatchParameters) -> Dict[str, object]:
    """The options of COLMAP's fusion."""
    views, angle = parameters.fused_views, parameters.fused_normal_deg
    return {"min_num_pixels": views, "max_normal_error": angle, "num_threads": 1}


def colmap_options(
    chosen: PatchMatchOptions,
    depths: Sequence[float],
    sources: int,
    gpu: int,
    parameters: PatchMatchParameters = COLMAP.patch_match,
) -> Dict[str, object]:
    """COLMAP's options for a tile whose depths are known, with up to so many sources for each reference.

    Angles between rays are not checked: in the frame they are smaller than on Earth, and pairs were chosen by the true
    ones. A source's cost does not change from sample to sample, so that few sources need few samples.
    """
    room = parameters.depth_margin * (depths[1] - depths[0])
    return {
        "gpu_index": str(gpu),
        "depth_min": depths[0] - room,
        "depth_max": depths[1] + room,
        "window_radius": chosen.window_radius,
        "geom_consistency": chosen.geometric,
        "filter": True,
        "num_samples": 1 if sources == 1 else min(parameters.most_samples, parameters.samples * sources),
        "min_triangulation_angle": 0.0,
        "filter_min_triangulation_angle": 0.0,
        "num_threads": 1,
    }


def bytes_needed(pixels: int, sources: int) -> int:
    """GPU memory that matching takes with images of so many pixels."""
    return _CONTEXT_BYTES + pixels * (_REFERENCE_BYTES + _SOURCE_BYTES * sources)


def bytes_allowed(gpu: Gpu, chosen: PatchMatchOptions, parameters: PatchMatchParameters = COLMAP.patch_match) -> int:
    """GPU memory that a tile may take."""
    free = int(parameters.memory_share * gpu.free_bytes)
    return min(free, int(chosen.memory_gib * 2**30)) if chosen.memory_gib else free


def run_patch_match(
    workspace: str,
    options: Dict[str, object],
    fusion: Optional[Dict[str, object]],
    stop: threading.Event,
    root: Path = ROOT,
) -> None:
    """Run patch match, and fusion if it has options, in a process of its own that finds the engine in ``root``.

    Raises DeviceError with COLMAP's own message where it fails, and Cancelled once ``stop`` is set.
    """
    job, log = (os.path.join(workspace, name) for name in ("job.json", "patch_match.log"))
    write_text(job, json.dumps({"workspace": workspace, "options": options, "fusion": fusion}))
    with open(log, "wb") as stream:
        process = subprocess.Popen(  # nosec B603 # this interpreter, with a module of our own
            [sys.executable, "-m", "repm_qgis.colmap.process", job],
            cwd=root,
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=subprocess.STDOUT,
        )
        try:
            while process.poll() is None and not stop.is_set():
                time.sleep(_POLL_S)
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
    if stop.is_set():
        raise Cancelled
    if process.returncode:
        with open(log, encoding="utf-8", errors="replace") as stream:
            raise failure(stream.read(), str(options["gpu_index"]), process.returncode)


def failure(log: str, gpu: str, code: int) -> DeviceError:
    """The error that the last message in COLMAP's log means."""
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    words = next(
        (line for line in reversed(lines) if any(text in line.lower() for text in (*_FULL, "error", "fail"))),
        lines[-1] if lines else f"exit code {code}",
    )[:300]
    if any(text in log.lower() for text in _FULL):
        return DeviceError(f"GPU {gpu} ran out of memory ('{words}'): free it, or choose a smaller GPU_MEMORY.")
    return DeviceError(
        f"GPU {gpu} was lost or refused the work ('{words}'): check it with nvidia-smi and run again, "
        "or choose BACKEND sgm."
    )


def on_gpus(
    function: Callable[[T, Gpu, threading.Event], R],
    tasks: Sequence[T],
    gpus: Sequence[Gpu],
    progress: Progress,
    describe: Callable[[T], str],
) -> List[Union[R, DeviceError]]:
    """``[function(task, gpu, stop) for task in tasks]``, one worker for each GPU; a DeviceError is a task's result.

    Cancel sets ``stop``. Any other exception is raised here.
    """
    free: "queue.SimpleQueue[Gpu]" = queue.SimpleQueue()
    for gpu in gpus:
        free.put(gpu)
    stop = threading.Event()

    def work(task: T) -> Union[R, DeviceError]:
        gpu = free.get()
        try:
            return function(task, gpu, stop)
        except DeviceError as error:
            return error
        finally:
            free.put(gpu)

    results: Dict[int, Union[R, DeviceError]] = {}
    with ThreadPoolExecutor(len(gpus)) as pool:
        pending: Dict["Future[Union[R, DeviceError]]", int] = {}
        pending.update((pool.submit(work, task), number) for number, task in enumerate(tasks))
        try:
            progress.step(0.0, f"{len(tasks)} tiles on {len(gpus)} GPU(s)")
            for index, future in as_they_end(pending, progress):
                results[index] = future.result()
                progress.step(len(results) / len(tasks), describe(tasks[index]))
        except BaseException:
            stop.set()
            for future in pending:
                future.cancel()
            raise
    return [results[i] for i in range(len(tasks))]
