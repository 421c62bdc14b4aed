"""KLT + GTSAM: corners followed by Lucas and Kanade, poses and points by a fixed-lag smoother.

What one builds today of standard parts: corners are followed from image to image, PnP-RANSAC on the
points of the smoother removes wrong ones, and what is left are stereo factors with a robust noise
model in GTSAM's `IncrementalFixedLagSmoother` (iSAM2; Kaess et al. 2012,
doi:10.1177/0278364911430419). Its marginal covariances are those of the poses. It sees what every
method sees: images, and `RangeView.inverse_depths` with their sigmas.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from odometry_baselines import Followed, follow_corners, motion_of_points, orb_pnp, points_at

from infomap_ros.geometry import invert_transform, transform_points
from infomap_ros.localization.fiducials.range_view import RangeView

LAG = 10  # views that are optimized together
_CORNERS = 400
_APART = 10  # [px]
_PIXEL_SIGMA = 0.5
_HUBER = 1.345  # 95 % as efficient as least squares where errors are Gaussian
_UNKNOWN = 1e4  # disparity sigma where there is no range [px]
# A range is a factor of the disparity of a pair with this baseline: both are linear in 1/z.
_BASELINE = 0.1  # [m]
_ITERATIONS = 3
_FEW = 30  # corners
_FIXED = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
# Where the image gives no motion: rotation and position of a step from those of the last [rad, m].
_COASTING = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([0.2, 0.5], 3))


class KltSmoother:
    """Follows one camera; the map is the frame of the first one."""

    def __init__(self) -> None:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(0.001)
        parameters.relinearizeSkip = 1
        self._smoother = gtsam.IncrementalFixedLagSmoother(LAG, parameters)
        self._last: RangeView | None = None
        self._index = 0
        self._pose, self._step = np.eye(4), np.eye(4)
        self._pixels, self._names = np.zeros((0, 2)), np.zeros(0, int)
        self._created = 0
        self._points: dict[int, np.ndarray] = {}

    def add(self, view: RangeView) -> tuple[np.ndarray, np.ndarray, bool]:
        """T_map_camera, its covariance as in `Followed`, and whether the image gave the motion."""
        graph, values, key = gtsam.NonlinearFactorGraph(), gtsam.Values(), X(self._index)
        if self._last is None:
            pose, located = np.eye(4), True
            graph.push_back(gtsam.PriorFactorPose3(key, gtsam.Pose3(), _FIXED))
        else:
            pose, located = self._found_in(view)
            if not located:
                step = gtsam.Pose3(self._step)
                graph.push_back(gtsam.BetweenFactorPose3(key - 1, key, step, _COASTING))
        values.insert(key, gtsam.Pose3(pose))
        self._see_new(view, pose, values)
        self._measure(view, key, graph)
        ages = dict.fromkeys([key, *map(L, self._names.tolist())], float(self._index))
        self._smoother.update(graph, values, ages)
        for _ in range(_ITERATIONS - 1):
            self._smoother.update()
        estimate = self._smoother.calculateEstimate()
        self._points = {name: estimate.atPoint3(L(name)) for name in self._names.tolist()}
        last, self._pose = self._pose, estimate.atPose3(key).matrix()
        self._step = invert_transform(last) @ self._pose
        self._last, self._index = view, self._index + 1
        return self._pose, self._covariance(key), located

    def _found_in(self, view: RangeView) -> tuple[np.ndarray, bool]:
        """T_map_camera to begin with; keeps the corners that fit.

        Where few do, they are looked for again where the motion of ORB features has them.
        """
        points = np.array([self._points[name] for name in self._names.tolist()]).reshape(-1, 3)
        found, pixels = self._fitting(view, points, self._pixels)
        few = found is None or len(found[1]) < _FEW
        T_after_before = orb_pnp(self._last, view) if few else None
        if T_after_before is not None:
            there = transform_points(T_after_before @ invert_transform(self._pose), points)
            guess = view.camera.project(there)
            guess = np.where(np.isfinite(guess), guess, self._pixels)
            again = self._fitting(view, points, guess)
            if again[0] is not None and (found is None or len(again[0][1]) > len(found[1])):
                found, pixels = again
        if found is None:
            self._pixels, self._names = np.zeros((0, 2)), np.zeros(0, int)
            return self._pose @ self._step, False
        T_camera_map, chosen = found
        self._pixels, self._names = pixels[chosen], self._names[chosen]
        return invert_transform(T_camera_map), True

    def _fitting(
        self, view: RangeView, points: np.ndarray, guess: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray] | None, np.ndarray]:
        """What `motion_of_points` finds by the followed corners, and where they are now."""
        pixels, kept = follow_corners(self._last, view, self._pixels, guess)
        points = np.where(kept[:, None], points, np.nan)
        return motion_of_points(points, pixels, view.camera.matrix), pixels

    def _see_new(self, view: RangeView, T_map_camera: np.ndarray, values: gtsam.Values) -> None:
        """Corners of known range where there are too few."""
        free = np.full(view.image.shape, 255, np.uint8)
        for pixel in np.rint(self._pixels).astype(int).tolist():
            cv2.circle(free, pixel, _APART, 0, -1)
        wanted = _CORNERS - len(self._names)
        corners = None
        if wanted > 0:
            corners = cv2.goodFeaturesToTrack(view.image, wanted, 0.01, _APART, mask=free)
        if corners is None:
            return
        pixels = corners.reshape(-1, 2).astype(np.float64)
        points = points_at(view, pixels)
        known = np.isfinite(points).all(axis=1)
        names = np.arange(known.sum()) + self._created
        self._created += len(names)
        there = points[known] @ T_map_camera[:3, :3].T + T_map_camera[:3, 3]
        for name, point in zip(names.tolist(), there, strict=True):
            values.insert(L(name), point)
        self._pixels = np.vstack([self._pixels, pixels[known]])
        self._names = np.concatenate([self._names, names])

    def _measure(self, view: RangeView, key: int, graph: gtsam.NonlinearFactorGraph) -> None:
        """A factor for each corner: columns in both images of the pair, row."""
        camera = view.camera
        rig = gtsam.Cal3_S2Stereo(camera.fx, camera.fy, 0.0, camera.cx, camera.cy, _BASELINE)
        inverse, sigma = view.inverse_depths(self._pixels)
        known = np.isfinite(inverse) & np.isfinite(sigma)
        unit = camera.fx * _BASELINE
        disparities = np.where(known, inverse, 0.0) * unit
        sigmas = np.where(known, sigma * unit, _UNKNOWN)
        huber = gtsam.noiseModel.mEstimator.Huber.Create(_HUBER)
        for name, (u, v), disparity, sigma in zip(
            self._names.tolist(), self._pixels, disparities, sigmas, strict=True
        ):
            noise = np.diag(np.repeat(_PIXEL_SIGMA**2, 3))
            noise[0, 1] = noise[1, 0] = _PIXEL_SIGMA**2
            noise[1, 1] += sigma**2
            model = gtsam.noiseModel.Gaussian.Covariance(noise)
            robust = gtsam.noiseModel.Robust.Create(huber, model)
            place = gtsam.StereoPoint2(u, u - disparity, v)
            graph.push_back(gtsam.GenericStereoFactor3D(place, robust, key, L(name), rig))

    def _covariance(self, key: int) -> np.ndarray:
        """GTSAM perturbs a pose by rotation and translation in its own frame."""
        turn, none = self._pose[:3, :3], np.zeros((3, 3))
        turned = np.block([[none, turn], [turn, none]])
        return turned @ self._smoother.marginalCovariance(key) @ turned.T


def klt_gtsam(views: Iterable[RangeView]) -> Followed:
    """Follow all views."""
    smoother, stamps, results = KltSmoother(), list[int](), []
    for view in views:
        stamps.append(view.stamp)
        results.append(smoother.add(view))
    poses, covariances, located = zip(*results, strict=True)
    return Followed(stamps, np.array(poses), located.count(False), np.array(covariances))
