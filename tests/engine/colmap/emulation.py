"""What COLMAP 4.2 does on the GPU, in numpy and in single precision: from the files of a workspace to depth maps.

Written after the formulas of patch_match_cuda.cu: relative poses, the homography of a plane composed entry by entry,
its turned versions for the four sweeps, and a window's pixels reached by adding steps to its first.
"""

from __future__ import annotations

import os

import cv2
import numpy as np
import pycolmap

from repm_qgis.colmap.process import fuse

F = np.float32


def write_map(path, values):
    """Write a (height, width) or (height, width, channels) array as COLMAP does."""
    layers = np.moveaxis(np.atleast_3d(values), -1, 0)
    channels, height, width = layers.shape
    with open(path, "wb") as stream:
        stream.write(f"{width}&{height}&{channels}&".encode("ascii"))
        stream.write(np.ascontiguousarray(layers, dtype="<f4").tobytes())


class Camera:
    """K, R, t as COLMAP has them: float32, no skew, pixels' centres at whole numbers."""

    def __init__(self, K, R, t, size):
        self.K, self.R, self.t, self.size = K.astype(F), R.astype(F), t.astype(F), size
        self.name = ""

    @classmethod
    def of(cls, camera, size):
        return cls(camera.K, camera.R, camera.t, size)


def turned(camera, quarter):
    """fx, cx, fy, cy, R, t of a reference turned by so many quarters, as for COLMAP's sweeps."""
    (fx, cx), (fy, cy) = camera.K[0, [0, 2]], camera.K[1, [1, 2]]
    width, height = (F(n) for n in camera.size)
    K = [
        (fx, cx, fy, cy),
        (fy, cy, fx, width - F(1) - cx),
        (fx, width - F(1) - cx, fy, height - F(1) - cy),
        (fy, height - F(1) - cy, fx, cx),
    ][quarter]
    R, t = camera.R, camera.t
    turn = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], dtype=F)
    for _ in range(quarter):
        R, t = turn @ R, turn @ t
    return np.array(K, dtype=F), R, t


def turned_pixel(pixels, size, quarter):
    """(N, 2) pixels after so many quarters."""
    width, height = size
    for _ in range(quarter):
        pixels = np.stack([pixels[:, 1], width - 1 - pixels[:, 0]], axis=1)
        width, height = height, width
    return pixels


def turned_normal(normals, quarter):
    for _ in range(quarter):
        normals = np.stack([normals[:, 1], -normals[:, 0], normals[:, 2]], axis=1)
    return normals


def homographies(reference, source, pixels, depths, normals, quarter=0):
    """(N, 9) float32 homographies from the reference to the source, of planes through pixels at depths."""
    (fx, cx, fy, cy), R1, t1 = turned(reference, quarter)
    inverse = np.array([F(1) / fx, -cx / fx, F(1) / fy, -cy / fy], dtype=F)
    R = (source.R @ R1.T).astype(F)
    T = (source.t - R @ t1).astype(F)
    k = np.array([source.K[0, 0], source.K[0, 2], source.K[1, 1], source.K[1, 2]], dtype=F)
    col, row = pixels.astype(F).T
    n = normals.astype(F).T
    distance = depths.astype(F) * (
        n[0] * (inverse[0] * col + inverse[1]) + n[1] * (inverse[2] * row + inverse[3]) + n[2]
    )
    n = n * (F(1) / distance)
    turn = [[R[i, j] + n[j] * T[i] for j in range(3)] for i in range(3)]
    upper = [
        [k[0] * turn[0][j] + k[1] * turn[2][j] for j in range(3)],
        [k[2] * turn[1][j] + k[3] * turn[2][j] for j in range(3)],
        turn[2],
    ]
    H = [
        entry
        for line in upper
        for entry in (inverse[0] * line[0], inverse[2] * line[1], line[2] + inverse[1] * line[0] + inverse[3] * line[1])
    ]
    assert all(entry.dtype == F for entry in H)
    return np.stack(H, axis=1)


def warped(H, pixels, radius=5):
    """(N, side, side, 2) float32 source pixels of the windows around pixels, reached step by step."""
    side = 2 * radius + 1
    found = np.empty((len(H), side, side, 2), dtype=F)
    col, row = (pixels.astype(F) - F(radius)).T
    base = [H[:, 3 * i] * col + H[:, 3 * i + 1] * row + H[:, 3 * i + 2] for i in range(3)]
    for r in range(side):
        at = list(base)
        for c in range(side):
            inverse = F(1) / at[2]
            found[:, r, c] = np.stack([inverse * at[0], inverse * at[1]], axis=1)
            at = [value + H[:, 3 * i] for i, value in enumerate(at)]
        base = [value + H[:, 3 * i + 1] for i, value in enumerate(base)]
    return found


def exact(reference, source, pixels, depths, normals, radius=5):
    """The same in double precision, from cameras (K, R, t): rays through the windows' pixels meet the planes."""
    offset = np.arange(-radius, radius + 1, dtype=np.float64)
    window = pixels[:, None, None, :] + np.stack(np.meshgrid(offset, offset), axis=-1)
    inverse = np.linalg.inv(reference.K)
    ray = np.concatenate([window, np.ones(window.shape[:-1] + (1,))], axis=-1) @ inverse.T
    centre = np.column_stack([pixels, np.ones(len(pixels))]) @ inverse.T
    plane = depths * (normals * centre).sum(axis=1)
    depth = plane[:, None, None] / np.einsum("nrcx,nx->nrc", ray, normals)
    world = (ray * depth[..., None] - reference.t) @ reference.R
    return source.project(world)


def worst_error(reference, source, size, pixels, depths, normals, source_size=None):
    """The largest error in px of the single-precision warp over all windows and the four sweeps.

    ``normals`` (N, 3) of planes, in the reference camera's frame. ``size`` and ``source_size`` are the images'.
    """
    pixels = np.rint(pixels)
    truth = exact(reference, source, pixels, depths, normals)
    a, b = Camera.of(reference, size), Camera.of(source, source_size or size)
    worst = 0.0
    for quarter in range(4):
        at = turned_pixel(pixels, size, quarter)
        H = homographies(a, b, at, depths, turned_normal(normals, quarter), quarter)
        windows = warped(H, at)
        # The window's own axes are turned too: turn them back.
        windows = np.rot90(windows, k=-quarter, axes=(1, 2)).astype(np.float64)
        worst = max(worst, float(np.abs(windows - truth).max()))
    return worst


class Workspace:
    """The cameras, images and lists of a workspace, read from its files."""

    def __init__(self, folder):
        self.folder = folder
        model = pycolmap.Reconstruction(os.path.join(folder, "sparse"))
        self.cameras, self.images = {}, {}
        for image in model.images.values():
            camera, pose = model.cameras[image.camera_id], image.cam_from_world()
            self.cameras[image.name] = Camera(
                camera.calibration_matrix(),
                pose.rotation.matrix(),
                np.asarray(pose.translation),
                (camera.width, camera.height),
            )
            pixels = cv2.imread(os.path.join(folder, "images", image.name), cv2.IMREAD_GRAYSCALE)
            assert pixels.shape == (camera.height, camera.width)
            self.images[image.name] = pixels.astype(F) / F(255)
        with open(os.path.join(folder, "stereo", "patch-match.cfg"), encoding="utf-8") as stream:
            lines = [line.strip() for line in stream if line.strip()]
        self.problems = {name: others.split(", ") for name, others in zip(lines[::2], lines[1::2])}

    def correlations(self, name, other, depths, radius):
        """(depths, H, W) correlation of an image's windows with another's, on planes that face the camera."""
        reference, source = self.cameras[name], self.cameras[other]
        image, (width, height) = self.images[name], self.cameras[name].size
        side = (2 * radius + 1,) * 2
        columns, rows = np.meshgrid(np.arange(width, dtype=F), np.arange(height, dtype=F))
        mean = cv2.blur(image, side)
        spread = cv2.blur(image * image, side) - mean * mean
        facing = np.array([[0.0, 0.0, -1.0]])
        result = np.empty((len(depths), height, width), dtype=F)
        for k, depth in enumerate(depths):
            H = homographies(reference, source, np.array([[width // 2, height // 2]]), np.array([depth]), facing)[0]
            z = H[6] * columns + H[7] * rows + H[8]
            moved = cv2.remap(
                self.images[other],
                (H[0] * columns + H[1] * rows + H[2]) / z,
                (H[3] * columns + H[4] * rows + H[5]) / z,
                cv2.INTER_LINEAR,
            )
            average = cv2.blur(moved, side)
            variance = cv2.blur(moved * moved, side) - average * average
            common = cv2.blur(image * moved, side) - mean * average
            result[k] = np.where(
                np.minimum(spread, variance) < 1e-5, -1, common / np.sqrt(np.maximum(spread * variance, 1e-10))
            )
        return result

    def sweep(self, name, depth_range, count, radius):
        """(H, W) depth of the best of planes that face the camera, evenly spaced in 1 / depth; 0 where none agrees."""
        inverse = np.linspace(1 / depth_range[1], 1 / depth_range[0], count)
        volume = np.mean([self.correlations(name, other, 1 / inverse, radius) for other in self.problems[name]], axis=0)
        best = np.clip(volume.argmax(axis=0), 1, count - 2)
        left, peak, right = (np.take_along_axis(volume, best[None] + step, 0)[0] for step in (-1, 0, 1))
        bend = 2 * peak - left - right
        step = np.where(bend > 1e-6, np.clip((right - left) / np.maximum(2 * bend, 1e-6), -0.5, 0.5), 0)
        found = inverse[0] + (best + step) * (inverse[1] - inverse[0])
        return np.where(peak > 0.5, 1 / found, 0).astype(F)

    def consistent(self, name, depths):
        """(H, W) depth where a source's own depth leads back to within a pixel, else 0: COLMAP's geometric filter."""
        a, depth = self.cameras[name], depths[name]
        columns, rows = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in a.size))
        kept = np.zeros(depth.shape, dtype=bool)
        for other in self.problems[name]:
            b = self.cameras[other]
            there = _moved(a, b, columns, rows, depth)
            c, r = (np.rint(there[..., i]).astype(int) for i in (0, 1))
            inside = (c >= 0) & (r >= 0) & (c < b.size[0]) & (r < b.size[1])
            seen = np.where(inside, depths[other][np.where(inside, r, 0), np.where(inside, c, 0)], 0)
            back = _moved(b, a, there[..., 0], there[..., 1], seen)
            distance = np.hypot(back[..., 0] - columns, back[..., 1] - rows)
            kept |= (seen > 0) & (distance <= 1)
        return np.where(kept, depth, 0).astype(F)


def _moved(a, b, columns, rows, depth):
    """(H, W, 2) where camera b sees a's pixels at their depths; far outside where there is no depth."""
    rays = np.stack([columns, rows, np.ones_like(columns)], axis=-1) @ np.linalg.inv(a.K.astype(np.float64)).T
    world = (rays * np.where(depth > 0, depth, 1)[..., None] - a.t) @ a.R.astype(np.float64)
    seen = (world @ b.R.T.astype(np.float64) + b.t) @ b.K.T.astype(np.float64)
    return np.where((depth > 0)[..., None], seen[..., :2] / seen[..., 2:], -1e6)


def plane_sweep(folder, options, fusion, stop, count=160):
    """A runner for the backend: depth and normal maps where COLMAP would write them, by sweeping planes."""
    workspace = Workspace(folder)
    depths = {
        name: workspace.sweep(name, (options["depth_min"], options["depth_max"]), count, options["window_radius"])
        for name in workspace.problems
    }
    for name in workspace.problems:
        for kind, values in (("photometric", depths[name]), ("geometric", workspace.consistent(name, depths))):
            normals = np.zeros(values.shape + (3,), dtype=F)
            normals[..., 2] = np.where(values > 0, -1, 0)
            write_map(os.path.join(folder, "stereo", "depth_maps", f"{name}.{kind}.bin"), values)
            write_map(os.path.join(folder, "stereo", "normal_maps", f"{name}.{kind}.bin"), normals)
    if fusion is not None:
        fuse(folder, True, fusion)
