"""Poses of a model that a scene allows: votes, clusters, registration, check."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import make_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray, perturb_transform
from infomap_ros.localization.target.model_check import (
    Agreement,
    check_pose,
    flat_share,
    visible_points,
)
from infomap_ros.localization.target.model_scene import ModelScene, on_large_planes
from infomap_ros.localization.target.model_shape import ModelShape
from infomap_ros.localization.target.point_pairs import PairTable, Votes, build_table, vote

_PAIR_SPACING = 0.05  # of the points that vote, as a share of the diameter
_CHECK_SPACING = 0.02
_REFERENCES = 2000  # points of the scene that vote
_LARGE = 1.3  # planes that reach farther, in diameters, are not of the model
_CLUSTERS = 30  # that are registered
_NEAR = 0.1  # clusters: poses nearer than this share of the diameter
_TURNED = np.cos(np.radians(20.0))
_OTHER_TURNS = 100  # poses about the found place that are tried beside it


class Hypothesis(NamedTuple):
    """A pose that was registered.

    Attributes:
        transform: ``T_camera_model``, shape (4, 4).
        agreement: with the range image.
    """

    transform: FloatArray
    agreement: Agreement


class ModelSearch:
    """Searches one model.

    Args:
        shape: of the model.
        tolerance: difference of depth that counts as agreement, beside 3 sigma [m].
    """

    def __init__(self, shape: ModelShape, tolerance: float) -> None:
        self.shape, self.tolerance = shape, tolerance
        diameter = shape.diameter
        self._spacing = _CHECK_SPACING * diameter
        self._checked = shape.thinned(self._spacing)
        self._coarse = shape.thinned(2.0 * self._spacing)
        pairs = shape.thinned(_PAIR_SPACING * diameter)
        self._table: PairTable = build_table(pairs.points, pairs.normals, diameter)
        self._turns = _other_turns(shape.points)

    def find(self, scene: ModelScene) -> list[Hypothesis]:
        """Poses that the scene's points vote for, the best first."""
        points, normals = scene.thinned(_PAIR_SPACING * self.shape.diameter)
        diameter = self.shape.diameter
        large = on_large_planes(points, normals, _LARGE * diameter, _CHECK_SPACING * diameter)
        rest = np.flatnonzero(~large)
        step = max(1, len(rest) // _REFERENCES)
        votes = vote(self._table, points, normals, rest[::step])
        starts = self._clusters(votes)
        found = [self.refine(start, scene) for start in starts]
        return sorted(found, key=lambda one: -one.agreement.score)

    def others(self, scene: ModelScene, found: FloatArray) -> list[Hypothesis]:
        """Poses with the model turned about its middle, registered: what else may be there."""
        middle = make_transform(np.eye(3), self.shape.center)
        back = make_transform(np.eye(3), -self.shape.center)
        turned = [found @ middle @ make_transform(turn, np.zeros(3)) @ back for turn in self._turns]
        return [self.refine(start, scene) for start in turned]

    def refine(self, start: FloatArray, scene: ModelScene) -> Hypothesis:
        """Register the visible part of the model to the scene, and check the result."""
        pose, diameter = start, self.shape.diameter
        for reach in (0.1, 0.04):
            seen = visible_points(self._coarse, pose, 2.0 * self._spacing)
            if len(seen) < 20:
                break
            pose = register(self._coarse.points[seen], scene, pose, reach * diameter)
        return Hypothesis(pose, self.check(pose, scene))

    def check(self, pose: FloatArray, scene: ModelScene) -> Agreement:
        """How a pose agrees with the range image."""
        return check_pose(self._checked, pose, scene.cloud, self._spacing, self.tolerance)

    def flat_share(self, pose: FloatArray) -> float:
        """Share of what the camera sees of the model that lies on one plane."""
        return flat_share(self._checked, pose, self._spacing, self.tolerance)

    def _clusters(self, votes: Votes) -> list[FloatArray]:
        """The poses with most votes, those of poses nearby included."""
        middles = transform_points_of(votes.transforms, self.shape.center)
        order = np.argsort(-votes.votes)
        free = np.ones(len(order), bool)
        clusters: list[tuple[float, FloatArray]] = []
        for index in order:
            if not free[index]:
                continue
            apart = np.linalg.norm(middles - middles[index], axis=1)
            rotation = votes.transforms[index, :3, :3]
            trace = np.einsum("nij,ij->n", votes.transforms[:, :3, :3], rotation)
            same = free & (apart < _NEAR * self.shape.diameter) & (0.5 * (trace - 1.0) > _TURNED)
            free &= ~same
            clusters.append((float(votes.votes[same].sum()), votes.transforms[index]))
        clusters.sort(key=lambda one: -one[0])
        return [pose for _, pose in clusters[:_CLUSTERS]]

    def difference(self, first: FloatArray, second: FloatArray) -> tuple[float, float]:
        """How far apart two poses put the model's middle [m], and the turn between them [rad]."""
        apart = transform_points(first, self.shape.center) - transform_points(
            second, self.shape.center
        )
        turn = Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).magnitude()
        return float(np.linalg.norm(apart)), float(turn)


def register(
    points: FloatArray, scene: ModelScene, start: FloatArray, reach: float, iterations: int = 8
) -> FloatArray:
    """Move points onto the planes of their nearest neighbors (iterative closest points).

    Chen and Medioni 1992, doi:10.1016/0262-8856(92)90066-C.

    Args:
        points: in the model's frame, shape (N, 3) [m].
        scene: where to.
        start: first ``T_camera_model``, shape (4, 4).
        reach: pairs farther apart do not count [m].
        iterations: at most.

    Returns:
        ``T_camera_model``, shape (4, 4); as it was where fewer than six pairs are left.
    """
    pose = start
    for _ in range(iterations):
        placed = transform_points(pose, points)
        distance, index = scene.tree.query(placed, distance_upper_bound=reach)
        near = distance < reach
        if near.sum() < 6:
            break
        normals = scene.normals[index[near]]
        residual = np.einsum("ni,ni->n", normals, placed[near] - scene.points[index[near]])
        arms = placed[near] - pose[:3, 3]
        rows = np.hstack([normals, np.cross(arms, normals)])
        information = rows.T @ rows
        information += 1e-9 * np.trace(information) * np.eye(6)
        step = -np.linalg.solve(information, rows.T @ residual)
        pose = perturb_transform(pose, step)
        if np.linalg.norm(step[:3]) < 1e-3 * reach and np.linalg.norm(step[3:]) < 1e-3:
            break
    return pose


def transform_points_of(transforms: FloatArray, point: FloatArray) -> FloatArray:
    """One point through many transforms, shape (N, 3)."""
    return np.asarray(transforms[:, :3, :3] @ point + transforms[:, :3, 3])


def _other_turns(points: FloatArray) -> FloatArray:
    """Turns under which a model may look alike, shape (R, 3, 3).

    Quarter and half turns about the axes of its frame and its principal axes, and others evenly.
    """
    quarters = Rotation.create_group("O").as_matrix()
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    axes[2] *= np.linalg.det(axes)
    own = axes.T @ quarters @ axes
    turns = np.concatenate([quarters, own, _even_rotations(_OTHER_TURNS)])
    return np.asarray(turns[np.linalg.norm(turns - np.eye(3), axis=(1, 2)) > 0.2])


def _even_rotations(count: int) -> FloatArray:
    """Rotations spread evenly: super-Fibonacci spirals (Alexa 2022), shape (count, 3, 3).

    doi:10.1109/CVPR52688.2022.00811.
    """
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha = 2.0 * np.pi * s / np.sqrt(2.0)
    beta = 2.0 * np.pi * s / 1.533751168755204288118041
    quaternions = [inner * np.sin(alpha), inner * np.cos(alpha)]
    quaternions += [outer * np.sin(beta), outer * np.cos(beta)]
    return np.asarray(Rotation.from_quat(np.stack(quaternions, axis=1)).as_matrix())
