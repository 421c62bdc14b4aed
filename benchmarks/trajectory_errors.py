"""Errors of trajectories against the truth, by evo (Grupp, github.com/MichaelGrupp/evo)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from evo.core import lie_algebra, metrics
from evo.core.trajectory import PoseTrajectory3D
from scipy.spatial.transform import Rotation

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry import PoseBuffer, PoseBufferConfig, PoseRecord


@dataclass(frozen=True)
class TrajectoryErrors:
    """Errors of one trajectory.

    Attributes:
        frames: compared poses.
        length: of the true path [m].
        ape: root mean square of the position error after alignment by a rigid motion [m].
        rpe_percent: mean error of the translation over `delta` of the true path, of `delta` [%].
        rpe_degrees: mean error of the rotation over `delta` [deg].
        frame_rpe: root mean square of the translation error between successive frames [m].
        delta: [m].
    """

    frames: int
    length: float
    ape: float
    rpe_percent: float
    rpe_degrees: float
    frame_rpe: float
    delta: float


def truth_at(records: Sequence[PoseRecord], stamps: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """True poses at stamps: which stamps have one, shape (N,), and T_map_camera, (M, 4, 4)."""
    buffer = PoseBuffer(PoseBufferConfig(capacity=10_000_000))
    for record in records:
        buffer.add(record)
    poses, known = [], np.zeros(len(stamps), bool)
    for index, stamp in enumerate(stamps):
        try:
            poses.append(buffer.at(stamp).transform)
        except PoseUnavailableError:
            continue
        known[index] = True
    return known, np.array(poses).reshape(-1, 4, 4)


def trajectory_errors(
    stamps: Sequence[int], truth: np.ndarray, estimate: np.ndarray, delta: float
) -> TrajectoryErrors:
    """Compare.

    Args:
        stamps: of both [ns].
        truth: T_map_camera, shape (N, 4, 4).
        estimate: the same, in a map of its own.
        delta: length of the pieces over which relative errors are taken [m].
    """
    reference, guess = (_trajectory(stamps, poses) for poses in (truth, estimate))
    translation = metrics.PoseRelation.translation_part
    rotation = metrics.PoseRelation.rotation_angle_deg
    guess_aligned = _trajectory(stamps, estimate)
    guess_aligned.align(reference)
    ape = metrics.APE(translation)
    ape.process_data((reference, guess_aligned))
    return TrajectoryErrors(
        frames=len(stamps),
        length=float(reference.path_length),
        ape=float(ape.get_statistic(metrics.StatisticsType.rmse)),
        rpe_percent=100.0 * _relative(reference, guess, translation, delta) / delta,
        rpe_degrees=_relative(reference, guess, rotation, delta),
        frame_rpe=_of_frames(reference, guess),
        delta=delta,
    )


def pose_nees(
    truth: np.ndarray,
    estimate: np.ndarray,
    covariances: np.ndarray,
    truth_sigmas: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Squared errors of poses by their covariances, / 6: 1 on average where these are true.

    The map begins at the first pose: the others are compared with the truth relative to it, whose
    own error counts twice, and by how far the camera has come where the first pose is turned.

    Args:
        truth: T_map_camera, shape (N, 4, 4).
        estimate: the same, in a map of its own.
        covariances: of the estimates, shape (N, 6, 6).
        truth_sigmas: standard deviations of the truth's position and rotation [m, rad].

    Returns:
        Of all but the first, shape (N - 1,).
    """
    expected = (estimate[0] @ np.linalg.inv(truth[0])) @ truth
    turned = expected[1:, :3, :3] @ estimate[1:, :3, :3].transpose(0, 2, 1)
    errors = np.hstack(
        [expected[1:, :3, 3] - estimate[1:, :3, 3], Rotation.from_matrix(turned).as_rotvec()]
    )
    far = np.linalg.norm(estimate[1:, :3, 3] - estimate[0, :3, 3], axis=1)
    position, rotation = truth_sigmas
    noise = np.zeros((len(errors), 6))
    noise[:, :3] = (2.0 * position**2 + np.square(rotation * far))[:, None]
    noise[:, 3:] = 2.0 * rotation**2
    total = covariances[1:] + np.einsum("ni,ij->nij", noise, np.eye(6))
    return np.asarray(
        np.einsum("ni,ni->n", errors, np.linalg.solve(total, errors[..., None])[..., 0]) / 6.0
    )


def _relative(
    reference: PoseTrajectory3D,
    guess: PoseTrajectory3D,
    relation: metrics.PoseRelation,
    delta: float,
) -> float:
    rpe = metrics.RPE(
        relation,
        delta=delta,
        delta_unit=metrics.Unit.meters,
        rel_delta_tol=0.1,
        all_pairs=True,
        pairs_from_reference=True,
    )
    rpe.process_data((reference, guess))
    return float(rpe.get_statistic(metrics.StatisticsType.mean))


def _of_frames(reference: PoseTrajectory3D, guess: PoseTrajectory3D) -> float:
    rpe = metrics.RPE(metrics.PoseRelation.translation_part, 1, metrics.Unit.frames)
    rpe.process_data((reference, guess))
    return float(rpe.get_statistic(metrics.StatisticsType.rmse))


def _trajectory(stamps: Sequence[int], poses: np.ndarray) -> PoseTrajectory3D:
    exact = [lie_algebra.se3(_orthonormal(pose[:3, :3]), pose[:3, 3]) for pose in poses]
    return PoseTrajectory3D(poses_se3=exact, timestamps=1e-9 * np.asarray(stamps, np.float64))


def _orthonormal(rotation: np.ndarray) -> np.ndarray:
    """Rounding errors add up over many frames, and evo is strict."""
    left, _, right = np.linalg.svd(rotation)
    return left @ right
