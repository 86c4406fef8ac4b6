"""Keypoints with descriptors: SIFT (Lowe 2004), from one detector for all views of a scene, chosen once.

OpenCV's on the CPU; COLMAP's on an NVIDIA GPU, where pycolmap was built with CUDA and a device really answers. Both
give RootSIFT descriptors (Arandjelovic and Zisserman, Three things everyone should know to improve object retrieval,
2012) and pixels of which the first one's centre is (0, 0).
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable, Protocol, Tuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from .. import environment
from ..arrays import FloatArray
from ..errors import EmptyResultError, RepmError
from ..progress import Progress

Grey = NDArray[np.uint8]
T = TypeVar("T")

_CONTRAST = 0.02  # least contrast of a keypoint, as OpenCV counts it: over the layers of an octave
_LAYERS = 3  # of an octave
_MOST_COLMAP = 32768  # keypoints of an image that COLMAP may give: above that it keeps the coarse ones, not ours
_COLMAP_CORNER = 0.5  # COLMAP's first pixel has its centre at (0.5, 0.5)
_COLMAP_WARNINGS = 1
_STRENGTH_WINDOW = 5
_GPU_WORKERS = 4  # processes that share a GPU: each holds a context of some hundred MiB there
_ANSWER_SECONDS = 120
_BLOB_PX = 0.35  # by which a detector may miss the middle of a blob in the self-test


@dataclass(frozen=True)
class Keypoints:
    """(N, 2) pixels column, row; (N,) strength, comparable within an image; (N, 128) descriptors of unit length."""

    points: FloatArray
    strength: FloatArray
    descriptors: NDArray[np.float32]


Choice = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.intp]]
"""Which keypoints are wanted, by their (N, 2) places and (N,) strengths."""


def everything(points: NDArray[np.float64], strength: NDArray[np.float64]) -> NDArray[np.intp]:
    """All keypoints."""
    return np.arange(len(points))


class Detector(Protocol):
    """What finds keypoints; picklable, as workers get it with their task. ``name`` is what reports say."""

    @property
    def name(self) -> str: ...

    def workers(self, asked: int) -> int:
        """How many processes may use it at once, of as many as asked for (0: one a core)."""
        ...

    def detect(self, grey: Grey, mask: NDArray[np.uint8], most: int, choose: Choice = everything) -> Keypoints:
        """Keypoints of an image (rows, columns) where the mask is not 0, each place once: about ``most``, or more.

        Of these ``choose`` takes those that are wanted. Raises DetectorError where the device fails.
        """
        ...


class DetectorError(RepmError, RuntimeError):
    """A device that should find keypoints failed."""


@dataclass(frozen=True)
class OpenCvSift:
    """OpenCV's SIFT on the CPU."""

    name = "SIFT of OpenCV, on the CPU"

    def workers(self, asked: int) -> int:
        return asked

    def detect(self, grey: Grey, mask: NDArray[np.uint8], most: int, choose: Choice = everything) -> Keypoints:
        """See Detector; the strongest ``most``, by contrast."""
        # Without the precise doubling of the image all keypoints lie a quarter of a pixel right and below.
        sift = cv2.SIFT_create(most, nOctaveLayers=_LAYERS, contrastThreshold=_CONTRAST, enable_precise_upscale=True)
        points = sift.detect(grey, mask)
        if not points:
            return Keypoints(np.empty((0, 2)), np.empty(0), np.empty((0, 128), np.float32))
        # SIFT gives a strong corner once for each of its orientations: one is enough as a tie.
        places, once = np.unique(np.array([p.pt for p in points], dtype=np.float64), axis=0, return_index=True)
        strength = np.array([points[i].response for i in once])
        chosen = choose(places, strength)
        # Descriptors take most of the time: those of what is not wanted are not computed.
        _, descriptors = sift.compute(grey, [points[i] for i in once[chosen]])
        return Keypoints(places[chosen], strength[chosen], _roots(descriptors))


@dataclass(frozen=True)
class ColmapSift:
    """COLMAP's SIFT: VLFeat's on the ``device`` cpu, with one thread, and SiftGPU on cuda."""

    device: str = "cuda"

    @property
    def name(self) -> str:
        return f"SIFT of COLMAP, on the {'GPU' if self.device == 'cuda' else 'CPU'}"

    def workers(self, asked: int) -> int:
        return min(asked or environment.cores(), _GPU_WORKERS) if self.device == "cuda" else asked

    def detect(self, grey: Grey, mask: NDArray[np.uint8], most: int, choose: Choice = everything) -> Keypoints:
        """See Detector; all there are, in order of their places: a GPU gives them in any."""
        try:
            found, descriptors = _extractor(self.device).extract_from_uint8_array(grey)
            places = np.array([(k.x, k.y) for k in found], dtype=np.float64).reshape(-1, 2) - _COLMAP_CORNER
        except (RuntimeError, ValueError, AttributeError, MemoryError) as error:  # older versions lack the extractor
            raise DetectorError(f"{self.name} failed: {error}") from error
        nearest = np.clip(np.rint(places).astype(int), 0, np.array(grey.shape[::-1]) - 1)
        allowed = np.flatnonzero(mask[nearest[:, 1], nearest[:, 0]] > 0)
        chosen = allowed[np.unique(places[allowed], axis=0, return_index=True)[1]]
        # COLMAP does not say how strong a keypoint is.
        corners = cv2.cornerMinEigenVal(grey, _STRENGTH_WINDOW)
        strength = corners[nearest[chosen, 1], nearest[chosen, 0]].astype(np.float64)
        wanted = choose(places[chosen], strength)
        return Keypoints(places[chosen][wanted], strength[wanted], _unit(descriptors.data[chosen[wanted]]))


@lru_cache(maxsize=2)
def _extractor(device: str) -> Any:
    """COLMAP's SIFT on a device, one a process; its descriptors are roots already."""
    import pycolmap

    pycolmap.logging.minloglevel = max(pycolmap.logging.minloglevel, _COLMAP_WARNINGS)  # it tells of every extractor
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = 1
    options.use_gpu = device == "cuda"
    options.sift.max_num_features = _MOST_COLMAP
    options.sift.octave_resolution = _LAYERS
    options.sift.peak_threshold = _CONTRAST / _LAYERS
    options.sift.max_num_orientations = 1
    return pycolmap.FeatureExtractor.create(options, getattr(pycolmap.Device, device))


def _roots(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)).astype(np.float32)


def _unit(descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    lengths = np.linalg.norm(descriptors.astype(np.float32), axis=1, keepdims=True)
    return (descriptors / np.maximum(lengths, 1e-6)).astype(np.float32)


CPU_DETECTOR = OpenCvSift()


def best_detector() -> Detector:
    """COLMAP's SIFT on the GPU where that works here, else OpenCV's on the CPU."""
    if importlib.util.find_spec("pycolmap") is not None and environment.cuda()["usable"] and _answers("cuda"):
        return ColmapSift("cuda")
    return CPU_DETECTOR


def with_best_detector(work: Callable[[Detector], T], progress: Progress) -> Tuple[T, Detector]:
    """What ``work`` gives with the best detector, and that detector.

    All is done again on the CPU, with a warning, where a GPU fails or gives nothing to go on with: keypoints of one
    scene never come from two detectors. Errors on the CPU are the caller's.
    """
    detector = best_detector()
    if detector == CPU_DETECTOR:
        return work(detector), detector
    try:
        return work(detector), detector
    except (DetectorError, EmptyResultError) as error:
        progress.warn(f"Tie points are searched again on the CPU, because the GPU gave none: {error}")
    return work(CPU_DETECTOR), CPU_DETECTOR


def _answers(device: str) -> bool:
    """Whether a device finds known blobs where they are; asked in a process of its own, which a bad driver may end."""
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).resolve().parents[2])!r}); "
        f"from repm_qgis.sfm.keypoints import self_test; sys.exit(0 if self_test({device!r}) else 1)"
    )
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            stdin=subprocess.DEVNULL,  # noqa: S603 - our own code
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=_ANSWER_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def self_test(device: str) -> bool:
    """Whether COLMAP's SIFT on a device finds nine bright blobs at their middles: half a pixel beside is a failure."""
    rows, cols = np.indices((128, 128))
    middles = np.array([(x, y) for x in (26.25, 63.0, 101.75) for y in (25.0, 64.25, 100.5)])
    image = sum(190 * np.exp(-((cols - x) ** 2 + (rows - y) ** 2) / 32) for x, y in middles)
    try:
        found = ColmapSift(device).detect((30 + image).astype(np.uint8), np.ones((128, 128), np.uint8), 100).points
    except DetectorError:
        return False
    away = np.linalg.norm(found[None] - middles[:, None], axis=2)
    return bool(len(found) and (away.min(axis=1) < _BLOB_PX).all())
