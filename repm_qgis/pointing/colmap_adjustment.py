"""The paper's Adapted COLMAP: known poses, triangulated ties, and a bundle adjustment of principal points only.

Ties are grouped into patches no larger than the scene's tiles. Each patch gets its own equivalent pinhole cameras, in a
frame with its origin and unit at the patch: satellites are some thousand times farther away than a patch is wide. The
cameras are rotated towards the middles of their images, because COLMAP needs principal points inside. COLMAP moves the
principal points. The Jacobian of M brings these moves into the original images, where each view gets one shift: the
mean of its patches, weighted by their ties.

A move of all ground points looks the same as a shift of all principal points (the gauge). COLMAP is given one ground
point that stays; afterwards the part of the shifts that a move of the ground explains is removed, so that no view is
assumed to be right and the mean correction is zero, as in ``adjustment``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Bounds, FloatArray, Size
from ..contracts.errors import EmptyResultError
from ..geometry.centring import centred
from ..geometry.equivalent_error import RefinedPinhole
from ..geometry.frames import EnuFrame, mean_place, projected_from_geodetic
from ..geometry.pinhole import PinholeCamera
from ..geometry.refinement import apply_homography
from ..numerics.robust import nmad
from ..planning.altitudes import ALTITUDES, AltitudeParameters
from ..runtime.environment import required_pycolmap
from ..runtime.progress import Progress
from ..scene import Scene, View
from ..stereo.pairing import refined_view
from ..ties.tie_alignment import clusters
from ..ties.tracks import Track, track_pixels
from .adjustment import Adjustment, with_shifts
from .parameters import POINTING, ColmapAdjustmentParameters, PointingParameters


@dataclass(frozen=True)
class _PatchView:
    """A view over a patch: the camera for COLMAP (patch frame), and the homography from refined pixels to its own."""

    view: View
    refined: RefinedPinhole
    camera: PinholeCamera
    size: Size
    turned_from_refined: FloatArray

    def measured(self, original_px: FloatArray) -> FloatArray:
        """(N, 2) original pixels in the camera's image."""
        return apply_homography(self.turned_from_refined, self.refined.to_original.refined_from_original(original_px))

    def original_shift(self, shift: FloatArray, at: FloatArray) -> FloatArray:
        """(2,) a shift of the camera's image as a shift of the original, near original pixels ``at`` (N, 2)."""
        here = self.measured(at.mean(axis=0)[None])[0]
        back = np.linalg.inv(self.turned_from_refined)
        steps = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
        ends = self.refined.to_original.original_from_refined(apply_homography(back, here + steps))
        return np.asarray(np.column_stack([ends[0] - ends[1], ends[2] - ends[3]]) @ shift)


@dataclass(frozen=True)
class _PatchShifts:
    """A patch's (v, 2) shifts of some views, original px, moves of the ground removed; and the number of its ties."""

    views: List[int]
    shifts: FloatArray
    projector: FloatArray
    ties: int


def adjust_colmap(
    scene: Scene,
    tracks: Sequence[Track],
    progress: Progress,
    parameters: PointingParameters = POINTING,
    altitudes: AltitudeParameters = ALTITUDES,
) -> Adjustment:
    """One shift for each view, from COLMAP's adjustment of principal points; the present pointing is not used.

    Raises MissingPackageError where pycolmap is not installed, EmptyResultError where no patch has enough ties.
    """
    pycolmap = required_pycolmap("ADJUSTMENT colmap needs", "choose rpc")
    views = [view.with_pointing(np.eye(2, 3)) for view in scene.views]
    altitude = sum(scene.altitudes) / 2
    start = with_shifts(views, tracks, altitude, {view.name: np.zeros(2) for view in views}, "")
    xy = projected_from_geodetic(scene.crs, start.ground)
    found = []
    # Over a patch of the size of the largest tile, one camera for each view is good enough.
    side = max(max(t.bounds[2] - t.bounds[0], t.bounds[3] - t.bounds[1]) for t in scene.tiles)
    parts = clusters(xy, np.arange(len(tracks)), side, parameters.ties.alignment.gap)
    for number, members in enumerate(parts):
        progress.check_cancelled()
        progress.step(number / len(parts), "COLMAP's bundle adjustment")
        shown = _Patch(scene, views, [tracks[k] for k in members], start.ground[members], xy[members])
        shifts = _adjust_patch(pycolmap, shown, parameters.colmap, altitudes.patch_m)
        if shifts is not None:
            found.append(shifts)
    if not found:
        few = f"No patch of the scene has {parameters.colmap.least_ties} tie points for COLMAP's adjustment"
        raise EmptyResultError(f"{few}: choose ADJUSTMENT rpc, or an EXTENT with more texture.")
    joined = dict(zip((view.name for view in views), _joined(found, len(views), parameters.colmap.least_rank)))
    ties = sum(patch.ties for patch in found)
    reason = f"principal points by COLMAP's bundle adjustment of {ties} ties in {len(found)} patches"
    return with_shifts(views, tracks, altitude, joined, reason)


@dataclass(frozen=True)
class _Patch:
    """Some tracks of a scene with their ground points: (N, 3) longitude, latitude, height, and (N, 2) in its CRS."""

    scene: Scene
    views: Sequence[View]
    tracks: Sequence[Track]
    ground: FloatArray
    xy: FloatArray


def _adjust_patch(
    pycolmap: ModuleType, patch: _Patch, parameters: ColmapAdjustmentParameters, headroom_m: float
) -> Optional[_PatchShifts]:
    """The shifts that fit a patch's ties; None where these are too few."""
    if len(patch.tracks) < parameters.least_ties:
        return None
    seen, origin, scale = _patch_views(patch, parameters, headroom_m)
    measured, numbers = _measured(seen, patch.tracks)
    usable = [k for k, pixels in enumerate(measured) if len(pixels) >= 2]
    if len(usable) < parameters.least_ties:
        return None
    places = (patch.scene.frame.from_geodetic(patch.ground) - origin) / scale
    model = _Model(pycolmap, seen, [measured[k] for k in usable], places[usable], parameters)
    moved = model.solve()
    indices = [k for k in sorted(seen) if k in moved]
    if len(indices) < 2:
        return None
    shifts = np.array([seen[i].original_shift(moved[i], numbers[i]) for i in indices])
    projector = _observable([patch.views[i] for i in indices], mean_place(patch.ground))
    return _PatchShifts(indices, (projector @ shifts.ravel()).reshape(-1, 2), projector, model.kept)


def _patch_views(
    patch: _Patch, parameters: ColmapAdjustmentParameters, headroom_m: float
) -> Tuple[Dict[int, _PatchView], FloatArray, float]:
    """Cameras of all views that see a patch, by index, and the patch's frame: origin (m, scene frame) and unit."""
    scene, ground, xy = patch.scene, patch.ground, patch.xy
    ends = np.percentile(ground[:, 2], (parameters.tail_percent, 100.0 - parameters.tail_percent))
    altitudes = float(ends[0] - headroom_m), float(ends[1] + headroom_m)
    around = Bounds.between(xy.min(axis=0), xy.max(axis=0))
    bounds = around.grown(parameters.margin_px * scene.gsd_m)
    enu = scene.frame.from_geodetic(ground)
    origin = np.median(enu, axis=0)
    scale = max(float(np.ptp(xy, axis=0).max()) / 2, 1.0)
    plain = replace(scene.lean(), views=tuple(patch.views))
    seen = {}
    for index, view in enumerate(patch.views):
        refined = refined_view(plain, view, bounds, altitudes)
        if refined is None:
            continue
        camera, size = centred(refined.camera, refined.size)
        homography = camera.K @ camera.R @ np.linalg.inv(refined.camera.K @ refined.camera.R)
        local = PinholeCamera(camera.K, camera.R, (camera.R @ origin + camera.t) / scale)
        seen[index] = _PatchView(view, refined, local, size, homography)
    return seen, origin, scale


def _measured(
    seen: Dict[int, _PatchView], tracks: Sequence[Track]
) -> Tuple[List[Dict[int, FloatArray]], Dict[int, FloatArray]]:
    """For each track its pixels in the cameras' images by view, and for each view its (N, 2) original pixels."""
    result: List[Dict[int, FloatArray]] = [{} for _ in tracks]
    originals: Dict[int, FloatArray] = {}
    for index, patch_view in seen.items():
        own = [k for k, track in enumerate(tracks) if patch_view.view.name in track.pixels]
        if not own:
            continue
        originals[index] = track_pixels(tracks, patch_view.view.name, own)
        for k, pixel in zip(own, patch_view.measured(originals[index])):
            if np.isfinite(pixel).all():
                result[k][index] = pixel
    return result, originals


class _Model:
    """A patch in COLMAP: one camera for each view, constant poses, and points triangulated from them."""

    def __init__(
        self,
        pycolmap: ModuleType,
        seen: Dict[int, _PatchView],
        measured: Sequence[Dict[int, FloatArray]],
        places: FloatArray,
        parameters: ColmapAdjustmentParameters,
    ) -> None:
        self._pycolmap, self._seen, self._measured, self._parameters = pycolmap, seen, measured, parameters
        self._points = np.array([self._triangulated(pixels, place) for pixels, place in zip(measured, places)])
        self._use = np.ones(len(measured), dtype=bool)
        # COLMAP counts pixels from the corner of the first one.
        self._centre = {i: view.camera.K[:2, 2] + 0.5 for i, view in seen.items()}
        self._start = {i: centre.copy() for i, centre in self._centre.items()}

    @property
    def kept(self) -> int:
        return int(self._use.sum())

    def solve(self) -> Dict[int, FloatArray]:
        """(2,) the move of each view's principal point, px."""
        parameters, scale = self._parameters, self._parameters.first_scale_px
        for _ in range(parameters.passes):
            residual = self._adjusted(scale)
            sigma = max(nmad(residual[self._use], 0.0), parameters.least_sigma_px)
            self._use = residual < parameters.wrong * sigma
            scale = parameters.cauchy * sigma
        used = {i for pixels, use in zip(self._measured, self._use) if use for i in pixels}
        return {i: self._centre[i] - self._start[i] for i in self._seen if i in used}

    def _triangulated(self, pixels: Dict[int, FloatArray], fallback: FloatArray) -> FloatArray:
        """(3,) the point triangulated from known poses; that of the RPCs where COLMAP finds none."""
        cameras = [self._seen[i].camera for i in pixels]
        rays = np.array([np.linalg.solve(camera.K, [*pixel, 1.0]) for camera, pixel in zip(cameras, pixels.values())])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        poses = [np.column_stack([camera.R, camera.t]) for camera in cameras]
        point = self._pycolmap.triangulate_multi_view_point(poses, rays)
        return fallback if point is None or not np.isfinite(point).all() else np.asarray(point).ravel()

    def _adjusted(self, scale_px: float) -> FloatArray:
        """Bundle adjustment of the principal points and the points in use; (tracks,) residuals of all, px."""
        made = self._reconstruction()
        config = self._pycolmap.BundleAdjustmentConfig()
        for image in made.images.values():
            config.add_image(image.image_id)
            config.set_constant_rig_from_world_pose(image.frame_id)
        config.add_constant_point(self._anchor())
        self._pycolmap.create_default_bundle_adjuster(self._options(scale_px), config, made).solve()
        for i in self._seen:
            camera = made.cameras[i + 1]
            self._centre[i] = np.array([camera.principal_point_x, camera.principal_point_y])
        for k in np.flatnonzero(self._use):
            self._points[k] = made.points3D[int(k) + 1].xyz
        return self._residuals()

    def _options(self, scale_px: float) -> Any:
        options = self._pycolmap.BundleAdjustmentOptions()
        options.refine_principal_point = True
        options.refine_focal_length = options.refine_extra_params = options.refine_rig_from_world = False
        options.print_summary = False
        options.ceres.loss_function_type = self._pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = scale_px
        solver = options.ceres.solver_options
        solver.num_threads = 1  # sums in one order, for the same result every time
        solver.gradient_tolerance, solver.function_tolerance = 1e-10, 1e-12
        return options

    def _reconstruction(self) -> Any:
        pycolmap = self._pycolmap
        made = pycolmap.Reconstruction()
        places: Dict[int, List[FloatArray]] = {i: [] for i in self._seen}
        elements = []
        for pixels in self._measured:
            elements.append([(i, len(places[i])) for i in pixels])
            for i, pixel in pixels.items():
                places[i].append(pixel + 0.5)
        for i, view in self._seen.items():
            params = [view.camera.K[0, 0], view.camera.K[1, 1], *self._centre[i]]
            image = pycolmap.Image(view.view.name, np.array(places[i]).reshape(-1, 2), i + 1, i + 1)
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(view.camera.R), view.camera.t)
            width, height = view.size
            camera = pycolmap.Camera(camera_id=i + 1, model="PINHOLE", width=width, height=height, params=params)
            made.add_camera_with_trivial_rig(camera)
            made.add_image_with_trivial_frame(image, pose)
        for k in np.flatnonzero(self._use):
            track = pycolmap.Track([pycolmap.TrackElement(i + 1, place) for i, place in elements[k]])
            made.add_point3D_with_id(int(k) + 1, pycolmap.Point3D(xyz=self._points[k], track=track))
        return made

    def _anchor(self) -> int:
        """The constant point: seen by most views, and with the median residual among these."""
        residual = np.where(self._use, self._residuals(), np.inf)
        views = np.array([len(pixels) for pixels in self._measured])
        most = np.flatnonzero(self._use & (views == views[self._use].max()))
        return int(most[np.argsort(residual[most], kind="stable")[len(most) // 2]]) + 1

    def _residuals(self) -> FloatArray:
        """(tracks,) root mean square distance of measured and projected pixels."""
        square, count = np.zeros(len(self._measured)), np.zeros(len(self._measured))
        for i, view in self._seen.items():
            own = np.array([k for k, pixels in enumerate(self._measured) if i in pixels], dtype=int)
            if len(own):
                pixels = np.array([self._measured[k][i] for k in own])
                moved = self._centre[i] - self._start[i]
                square[own] += ((view.camera.project(self._points[own]) + moved - pixels) ** 2).sum(axis=1)
                count[own] += 1
        return np.asarray(np.sqrt(square / np.maximum(count, 1)))


def _observable(views: Sequence[View], ground: FloatArray) -> FloatArray:
    """(2v, 2v) projector of shifts onto the part that no move of the ground explains."""
    frame = EnuFrame(*map(float, ground))
    base = [view.project(ground) for view in views]
    moved = frame.to_geodetic(np.eye(3))
    moves = np.concatenate([(view.project(moved) - start).T for view, start in zip(views, base)])
    return np.asarray(np.eye(2 * len(views)) - moves @ np.linalg.pinv(moves))


def _joined(patches: Sequence[_PatchShifts], count: int, least_rank: float) -> FloatArray:
    """(views, 2) the smallest shifts that fit those of all patches, weighted by their ties."""
    normal, right = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    for patch in patches:
        columns = np.concatenate([[2 * i, 2 * i + 1] for i in patch.views])
        normal[np.ix_(columns, columns)] += patch.ties * patch.projector
        right[columns] += patch.ties * patch.shifts.ravel()
    return np.asarray((np.linalg.pinv(normal, rcond=least_rank, hermitian=True) @ right).reshape(count, 2))
