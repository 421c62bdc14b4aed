"""The target as a CAD model, found in a range map without a first guess.

Steps: votes of point pairs; registration of the best; the check that refuses what the camera looks
through or what is part of something larger; the other poses that fit as well, as those of a
symmetric model do; refinement with the covariances of the points.

The pose of a model from the points of a range map, weighted by their covariances.

Each measured point is compared with the plane of the model's nearest surface point. Points of one
patch of the image share part of their error, so n of them count as
``n / (1 + correlation (n - 1))`` (`RangeCloud.error_correlation`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import invert_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray, perturb_transform
from infomap_ros.localization.target.config import ModelTargetConfig
from infomap_ros.localization.target.model_check import PoseComparison
from infomap_ros.localization.target.model_scene import ModelScene, ModelShape, load_model
from infomap_ros.localization.target.model_search import Hypothesis, ModelSearch
from infomap_ros.localization.target.target import RefusalReason, TargetRefusal, TargetSighting
from infomap_ros.stereo import RangeCloud

if TYPE_CHECKING:
    from infomap_ros.localization.fiducials.range_view import RangeView


_PATCH = 12  # [px] edge of a patch whose points share errors
_MOST_POINTS = 4000
_ITERATIONS = 12
_HUBER = 1.5  # sigmas
_FEWEST = 50


class ModelFit(NamedTuple):
    """A refined pose.

    Attributes:
        transform: ``T_camera_model``, shape (4, 4).
        covariance: in the camera frame, shape (6, 6).
        residual: rms of the normalized distances to the surface; 1 is as the noise predicts.
        points: how many took part.
    """

    transform: FloatArray
    covariance: FloatArray
    residual: float
    points: int


class ModelFitter:
    """Refines poses of one model.

    Args:
        shape: of the model, densely sampled.
        surface_sigma: how far the real surface is from the model's [m].
    """

    def __init__(self, shape: ModelShape, surface_sigma: float) -> None:
        self._shape, self._surface_sigma = shape, surface_sigma
        self._tree = cKDTree(shape.points)
        self._margin = 0.05 * shape.diameter

    def fit(self, cloud: RangeCloud, start: FloatArray, reach: float) -> ModelFit | None:
        """Refine a pose.

        Args:
            cloud: the range map.
            start: first ``T_camera_model``, shape (4, 4).
            reach: points farther from the model's surface do not take part [m].

        Returns:
            The fit, or None where too few points are near the surface.
        """
        points, covariances, patches = self._near(cloud, start, 2.0 * reach)
        pose, used = start, np.zeros(0, np.int64)
        for iteration in range(_ITERATIONS):
            limit = reach if iteration else 2.0 * reach
            residual, rows, variance, used = self._compare(points, covariances, pose, limit)
            if len(used) < _FEWEST:
                return None
            ratio = np.abs(residual) / np.sqrt(variance)
            weights = np.minimum(1.0, _HUBER / np.maximum(ratio, 1e-12)) / variance
            information = (weights[:, None] * rows).T @ rows
            if np.linalg.cond(information) > 1e12:
                return None
            step = -np.linalg.solve(information, rows.T @ (weights * residual))
            pose = perturb_transform(pose, step)
            if np.linalg.norm(step[:3]) < 1e-6 and np.linalg.norm(step[3:]) < 1e-6:
                break
        rms = float(np.sqrt(np.mean(np.minimum(ratio, 3.0) ** 2)))
        shared = _shared_weights(patches[used], cloud.error_correlation)
        covariance = _covariance(rows, weights, shared) * max(1.0, rms) ** 2
        return ModelFit(pose, covariance, rms, len(used))

    def _near(
        self, cloud: RangeCloud, pose: FloatArray, reach: float
    ) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
        """Points near the surface with their covariances and the patch that each is in."""
        inside = transform_points(invert_transform(pose), cloud.points)
        box = (
            np.abs(inside - self._shape.center) <= 0.5 * np.ptp(self._shape.points, axis=0) + reach
        )
        near = np.flatnonzero(box.all(axis=1))
        near = near[self._tree.query(inside[near], distance_upper_bound=reach)[0] < reach]
        near = near[:: max(1, len(near) // _MOST_POINTS)]
        v, u = (axis[near] for axis in np.nonzero(cloud.valid))
        patches = (v // _PATCH) * (cloud.camera.width // _PATCH + 1) + u // _PATCH
        points = cloud.points[near].astype(np.float64)
        return points, cloud.covariances[near].astype(np.float64), patches

    def _compare(
        self, points: FloatArray, covariances: FloatArray, pose: FloatArray, reach: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
        """Distances to the surface's planes, derivatives (N, 6), variances, and which points."""
        inside = transform_points(invert_transform(pose), points)
        distance, index = self._tree.query(inside, distance_upper_bound=reach)
        near = np.flatnonzero(distance < reach)
        index = index[near]
        normals = self._shape.normals[index] @ pose[:3, :3].T
        towards = -np.einsum("ni,ni->n", normals, points[near]) > 0.0  # seen from the front
        near, index, normals = near[towards], index[towards], normals[towards]
        apart = inside[near] - self._shape.points[index]
        residual = np.einsum("ni,ni->n", self._shape.normals[index], apart)
        arms = points[near] - pose[:3, 3]
        rows = np.hstack([-normals, np.cross(normals, arms)])
        variance = np.einsum("ni,nij,nj->n", normals, covariances[near], normals)
        return residual, rows, variance + self._surface_sigma**2, near


def _shared_weights(patches: NDArray[np.int64], correlation: float) -> FloatArray:
    """Variance of a point of each patch relative to that of independent points, shape (N,)."""
    _, group, counts = np.unique(patches, return_inverse=True, return_counts=True)
    return np.asarray(1.0 + correlation * (counts[np.ravel(group)] - 1.0))


def _covariance(rows: FloatArray, weights: FloatArray, shared: FloatArray) -> FloatArray:
    """Of the weighted estimate, whose weights ignore that patches share errors, shape (6, 6)."""
    inverse = np.linalg.inv((weights[:, None] * rows).T @ rows)
    scatter = ((weights * shared)[:, None] * rows).T @ rows
    return np.asarray(inverse @ scatter @ inverse)


_NAME = "model"
_FINE = 0.02  # spacing of the scene's points, as a share of the diameter
_DENSE = 0.008  # of the model's points for the refinement
_SAME_PLACE = 0.05  # poses nearer than this share of the diameter and
_SAME_OBJECT = 0.5  # as is the object of poses nearer than this
_SAME_TURN = 0.2  # [rad] are the same
_CLEARLY_WORSE = 0.5  # poses that score less by this are none
_TOLERANCE = 0.015  # difference of depth that agrees, beside 3 sigma, as a share of the diameter
_MIN_SCORE = 0.82  # share of the visible surface that must agree, less what is seen through
_MAX_SEEN_THROUGH = 0.1  # share of the visible surface with range behind it
# By how much less any other pose must score; less is ambiguous, as for a symmetric model.
_DISTINCTION = 0.05
# Points of the visible surface, a fiftieth of the diameter apart, that must tell a pose from any
# other at the same place, as those of a handle do; fewer are ambiguous.
_MIN_EVIDENCE = 40
_MAX_AGAINST = 0.25  # share of them that may speak for the other pose
# Share of the visible surface that may lie on one plane, which could be anything.
_MAX_FLAT = 0.6
_SURFACE_SIGMA = 0.001  # how far the real surface is from the mesh [m]
# Less certain sightings are refused [m], [rad].
_MAX_POSITION_SIGMA, _MAX_ROTATION_SIGMA = 0.05, 0.1


class ModelTargetDetector:
    """Finds a CAD model; see `target.TargetDetector`.

    Args:
        config: the model.
        shape: the model's surface, where it does not come from ``config.file``.

    Raises:
        ConfigError: neither a file nor a shape is given.
        InvalidInputError: the file cannot be read.
    """

    def __init__(self, config: ModelTargetConfig, shape: ModelShape | None = None) -> None:
        if shape is None and not config.file:
            raise ConfigError("file", config.file, "the path of a mesh")
        self.config = config
        self.shape = shape or load_model(config.file, config.scale)
        diameter = self.shape.diameter
        self._search = ModelSearch(self.shape, _TOLERANCE * diameter)
        dense = self.shape.thinned(_DENSE * diameter)
        self._fitter = ModelFitter(dense, _SURFACE_SIGMA)
        self._comparison = PoseComparison(
            self.shape.thinned(_FINE * diameter),
            dense,
            _FINE * diameter,
            _TOLERANCE * diameter,
        )

    def detect(self, view: RangeView) -> TargetSighting | TargetRefusal:
        """Find the model in the view's dense range map, or say why not."""
        scene = ModelScene.of_cloud(view.cloud(), _FINE * self.shape.diameter)
        if len(scene.points) < 100:
            return _refuse("not in view", f"{len(scene.points)} points with a usable range")
        found = self._search.find(scene)
        believed = [one for one in found if self._believed(one)]
        if not believed:
            text = found[0].agreement.text() if found else "no votes"
            return _refuse("not in view", f"best pose: {text}")
        shaped = [one for one in believed if self._is_shaped(one)]
        if not shaped:
            return _refuse("ambiguous", "most of what is seen is one plane")
        others = self._search.others(scene, shaped[0].transform)
        shaped += [one for one in others if self._believed(one) and self._is_shaped(one)]
        best = max(shaped, key=lambda one: one.agreement.score)
        rival = self._rival(best, [*found, *others])
        if rival is not None:
            apart, turn = self._search.difference(best.transform, rival.transform)
            text = f"a pose {apart:.2f} m and {np.degrees(turn):.0f} deg away fits as well"
            return _refuse("ambiguous", text)
        return self._nearly_alike(scene, best, [*found, *others]) or self._sighting(scene, best)

    def _believed(self, one: Hypothesis) -> bool:
        agreement = one.agreement
        return agreement.score >= _MIN_SCORE and agreement.seen_through <= _MAX_SEEN_THROUGH

    def _is_shaped(self, one: Hypothesis) -> bool:
        return self._search.flat_share(one.transform) <= _MAX_FLAT

    def _rival(self, best: Hypothesis, others: list[Hypothesis]) -> Hypothesis | None:
        """Another pose that fits about as well, or one of a single plane that fits better."""
        limit = best.agreement.score - _DISTINCTION
        for other in others:
            apart, turn = self._search.difference(best.transform, other.transform)
            elsewhere = apart > _SAME_PLACE * self.shape.diameter or turn > _SAME_TURN
            if not elsewhere or other.agreement.score <= limit:
                continue
            same_object = apart < _SAME_OBJECT * self.shape.diameter
            better = other.agreement.score > best.agreement.score
            if same_object or better or self._is_shaped(other):
                return other
        return None

    def _nearly_alike(
        self, scene: ModelScene, best: Hypothesis, others: list[Hypothesis]
    ) -> TargetRefusal | None:
        """Refuse a pose that too little tells from another one of the same object."""
        for other in others:
            apart, turn = self._search.difference(best.transform, other.transform)
            if turn <= _SAME_TURN or apart > _SAME_OBJECT * self.shape.diameter:
                continue
            if other.agreement.score < best.agreement.score - _CLEARLY_WORSE:
                continue
            found = self._comparison.evidence(scene.cloud, best.transform, other.transform)
            few = found.places < _MIN_EVIDENCE
            if few or found.against_share > _MAX_AGAINST:
                text = (
                    f"{found.places} points tell it from a pose {np.degrees(turn):.0f} deg away, "
                    f"{found.against} of them speak against it"
                )
                return _refuse("ambiguous", text)
        return None

    def _sighting(self, scene: ModelScene, best: Hypothesis) -> TargetSighting | TargetRefusal:
        reach = _TOLERANCE * self.shape.diameter
        depth = transform_points(best.transform, self.shape.center)[2]
        near = np.abs(scene.cloud.points[:, 2] - depth) < 0.5 * self.shape.diameter
        sigma = float(np.sqrt(np.median(scene.cloud.covariances[near, 2, 2])))
        fit = self._fitter.fit(scene.cloud, best.transform, max(reach, 3.0 * sigma))
        if fit is None:
            return _refuse("too uncertain", "the visible surface leaves a direction open")
        moved, turned = self._search.difference(best.transform, fit.transform)
        if moved > _SAME_PLACE * self.shape.diameter or turned > _SAME_TURN:
            return _refuse("too uncertain", f"the refinement went {moved:.3f} m astray")
        position, rotation = _largest_sigmas(fit.covariance, fit.transform, self.shape.center)
        if position > _MAX_POSITION_SIGMA or rotation > _MAX_ROTATION_SIGMA:
            return _refuse("too uncertain", f"sigma {position:.3f} m and {rotation:.3f} rad")
        refined = Hypothesis(fit.transform, self._search.check(fit.transform, scene))
        if not self._believed(refined):
            return _refuse("inconsistent", f"after refinement: {refined.agreement.text()}")
        return TargetSighting(fit.transform, fit.covariance, refined.agreement.score, _NAME)


def _largest_sigmas(
    covariance: FloatArray, pose: FloatArray, center: FloatArray
) -> tuple[float, float]:
    """Largest sigma of the position of the model's middle [m] and of the rotation [rad]."""
    sighting = TargetSighting(pose, covariance, 0.0, _NAME)
    shift = np.eye(4)
    shift[:3, 3] = center
    moved = sighting.of_frame(shift).covariance
    position = float(np.sqrt(np.linalg.eigvalsh(moved[:3, :3])[-1]))
    return position, float(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1]))


def _refuse(reason: RefusalReason, detail: str) -> TargetRefusal:
    return TargetRefusal(reason, detail, _NAME)
