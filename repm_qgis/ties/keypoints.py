"""Keypoints with descriptors: SIFT (Lowe 2004), from one detector for all views of a scene.

OpenCV's on the CPU; COLMAP's on an NVIDIA GPU, where pycolmap was built with CUDA and the device passes a self-test.
Both give RootSIFT descriptors (Arandjelovic and Zisserman, Three things everyone should know to improve object
retrieval, 2012) and pixels that count from the centre of the first one, (0, 0).
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable, Protocol, Tuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import ByteImage, FloatArray, FloatImage
from ..contracts.errors import EmptyResultError, RepmError
from ..runtime import environment
from ..runtime.parallel import cores
from ..runtime.progress import Progress
from .parameters import TIES, KeypointParameters

T = TypeVar("T")

_COLMAP_CORNER = 0.5  # the centre of COLMAP's first pixel is (0.5, 0.5)
_TEXTURE_PX = 192  # side of the self-test's image
_COLMAP_WARNINGS = 1  # the level of its log that shows warnings and errors


@dataclass(frozen=True)
class Keypoints:
    """(N, 2) pixels column, row; (N,) strength, comparable within an image; (N, 128) descriptors of unit length."""

    points: FloatArray
    strength: FloatArray
    descriptors: FloatImage


Choice = Callable[[FloatArray, FloatArray], NDArray[np.intp]]
"""Indices of the keypoints to describe, by their (N, 2) places and (N,) strengths."""


def everything(points: FloatArray, strength: FloatArray) -> NDArray[np.intp]:
    """All keypoints."""
    return np.arange(len(points))


class Detector(Protocol):
    """Finds keypoints; it is picklable, because workers get it with their task. Reports state its ``name``."""

    @property
    def name(self) -> str: ...

    def workers(self, asked: int) -> int:
        """How many processes may use it at once, if so many are asked for (0: one for each core)."""
        ...

    def detect(self, grey: ByteImage, mask: ByteImage, most: int, choose: Choice = everything) -> Keypoints:
        """Those keypoints of an image (rows, columns) that ``choose`` selects, each place once.

        Keypoints lie where the mask is not 0; there are about ``most`` of them, or more, to choose from. Raises
        DetectorError where the device fails.
        """
        ...


class DetectorError(RepmError, RuntimeError):
    """The device that finds keypoints failed."""


@dataclass(frozen=True)
class OpenCvSift:
    """OpenCV's SIFT on the CPU."""

    parameters: KeypointParameters = TIES.keypoints
    name = "SIFT of OpenCV, on the CPU"

    def workers(self, asked: int) -> int:
        return asked

    def detect(self, grey: ByteImage, mask: ByteImage, most: int, choose: Choice = everything) -> Keypoints:
        """The ``most`` keypoints with the strongest contrast, for ``choose``."""
        # Without the precise doubling of the image, all keypoints lie a quarter of a pixel too far right and below.
        layers, contrast = self.parameters.layers, self.parameters.contrast
        sift = cv2.SIFT_create(most, layers, contrastThreshold=contrast, enable_precise_upscale=True)
        points = sift.detect(grey, mask)
        if not points:
            return Keypoints(np.empty((0, 2)), np.empty(0), np.empty((0, 128), np.float32))
        # SIFT returns a keypoint once for each of its orientations: one is enough for a tie.
        places, once = np.unique(np.array([p.pt for p in points], dtype=np.float64), axis=0, return_index=True)
        strength = np.array([points[i].response for i in once])
        chosen = choose(places, strength)
        # Descriptors take most of the time: only those that are needed are computed.
        _, descriptors = sift.compute(grey, [points[i] for i in once[chosen]])
        return Keypoints(places[chosen], strength[chosen], _roots(descriptors))


@dataclass(frozen=True)
class ColmapSift:
    """COLMAP's SIFT: VLFeat with one thread on the ``device`` cpu, SiftGPU on cuda."""

    device: str = "cuda"
    parameters: KeypointParameters = TIES.keypoints

    @property
    def name(self) -> str:
        return f"SIFT of COLMAP, on the {'GPU' if self.device == 'cuda' else 'CPU'}"

    def workers(self, asked: int) -> int:
        return min(asked or cores(), self.parameters.gpu_workers) if self.device == "cuda" else asked

    def detect(self, grey: ByteImage, mask: ByteImage, most: int, choose: Choice = everything) -> Keypoints:
        """All keypoints for ``choose``, sorted by place: a GPU returns them in any order."""
        try:
            found, descriptors = _extractor(self.device, self.parameters).extract_from_uint8_array(grey)
            places = np.array([(k.x, k.y) for k in found], dtype=np.float64).reshape(-1, 2) - _COLMAP_CORNER
        except (RuntimeError, ValueError, AttributeError, MemoryError) as error:  # older versions lack the extractor
            raise DetectorError(f"{self.name} failed: {error}") from error
        nearest = np.clip(np.rint(places).astype(int), 0, np.array(grey.shape[::-1]) - 1)
        allowed = np.flatnonzero(mask[nearest[:, 1], nearest[:, 0]] > 0)
        chosen = allowed[np.unique(places[allowed], axis=0, return_index=True)[1]]
        # COLMAP does not state the strength of a keypoint.
        corners = cv2.cornerMinEigenVal(grey, self.parameters.strength_window_px)
        strength = corners[nearest[chosen, 1], nearest[chosen, 0]].astype(np.float64)
        wanted = choose(places[chosen], strength)
        return Keypoints(places[chosen][wanted], strength[wanted], _unit(descriptors.data[chosen[wanted]]))


@lru_cache(maxsize=2)
def _extractor(device: str, parameters: KeypointParameters) -> Any:
    """COLMAP's SIFT on a device, one for each process; its descriptors are RootSIFT already."""
    import pycolmap

    pycolmap.logging.minloglevel = max(pycolmap.logging.minloglevel, _COLMAP_WARNINGS)  # it logs every extractor
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = 1
    options.use_gpu = device == "cuda"
    options.sift.max_num_features = parameters.most_colmap
    options.sift.octave_resolution = parameters.layers
    options.sift.peak_threshold = parameters.contrast / parameters.layers
    options.sift.max_num_orientations = 1
    return pycolmap.FeatureExtractor.create(options, getattr(pycolmap.Device, device))


def _roots(descriptors: FloatImage) -> FloatImage:
    roots: FloatImage = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))
    return roots.astype(np.float32)


def _unit(descriptors: ByteImage) -> FloatImage:
    lengths = np.linalg.norm(descriptors.astype(np.float32), axis=1, keepdims=True)
    return np.asarray((descriptors / np.maximum(lengths, 1e-6)).astype(np.float32))


CPU_DETECTOR = OpenCvSift()


def best_detector(parameters: KeypointParameters = TIES.keypoints) -> Detector:
    """COLMAP's SIFT on the GPU where that works here, else OpenCV's on the CPU."""
    if parameters.colmap_device == "cpu":
        return ColmapSift("cpu", parameters)
    wanted = parameters.colmap_device == "cuda" and importlib.util.find_spec("pycolmap") is not None
    if wanted and environment.cuda_usable() and answers("cuda", parameters):
        return ColmapSift("cuda", parameters)
    return OpenCvSift(parameters)


def with_best_detector(
    work: Callable[[Detector], T], progress: Progress, parameters: KeypointParameters = TIES.keypoints
) -> Tuple[T, Detector]:
    """The result of ``work`` with the best detector, and that detector.

    Where a GPU fails or its keypoints give too few ties, all is done again on the CPU, with a warning: the keypoints of
    one scene never come from two detectors. Errors on the CPU are raised.
    """
    detector = best_detector(parameters)
    on_cpu = OpenCvSift(parameters)
    if detector == on_cpu:
        return work(detector), detector
    try:
        return work(detector), detector
    except (DetectorError, EmptyResultError) as error:
        progress.warn(f"Tie points are searched again on the CPU, because the GPU failed: {error}")
    return work(on_cpu), on_cpu


def answers(device: str, parameters: KeypointParameters = TIES.keypoints) -> bool:
    """Whether a device passes the self-test, in a process of its own, because a faulty driver may end it."""
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).resolve().parents[2])!r}); "
        f"from repm_qgis.ties.keypoints import ColmapSift, self_test; print(self_test(ColmapSift({device!r})))"
    )
    return environment.fresh_answer(code, parameters.answer_s).endswith("True")


def self_test(detector: Detector, parameters: KeypointParameters = TIES.keypoints) -> bool:
    """Whether a detector finds nearly all of OpenCV's keypoints of a random texture, at their places.

    An error of half a pixel fails. Round spots would not do: they have no direction, and COLMAP on CUDA drops them.
    """
    noise = np.random.default_rng(0).normal(size=(3, _TEXTURE_PX, _TEXTURE_PX))
    texture = sum(scale * cv2.GaussianBlur(layer, (0, 0), scale) for scale, layer in zip((1.5, 3.0, 6.0), noise))
    image = np.clip(128 + 45 * texture / texture.std(), 0, 255).astype(np.uint8)
    whole = np.ones_like(image)
    try:
        found = detector.detect(image, whole, image.size).points
    except DetectorError:
        return False
    wanted = OpenCvSift(parameters).detect(image, whole, image.size).points
    away = np.linalg.norm(found[None] - wanted[:, None], axis=2).min(axis=1, initial=np.inf)
    return bool((away < parameters.same_px).mean() > parameters.same_share)
