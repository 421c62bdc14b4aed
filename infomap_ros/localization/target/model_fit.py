"""The pose of a model from the points of a range map, weighted by their covariances.

Each measured point is compared with the plane of the model's nearest surface point. Points of one
patch of the image share part of their error, so n of them count as
``n / (1 + correlation (n - 1))`` (`RangeCloud.error_correlation`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from infomap_ros.geometry import invert_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray, perturb_transform
from infomap_ros.localization.target.model_shape import ModelShape
from infomap_ros.stereo import RangeCloud

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
