"""Camera pose, fiducials and kept poses, estimated together from images and motion.

The extended Kalman filter of eq. (16)-(18) of doi:10.1177/0278364905051774 over everything that
the camera has seen: fiducials stay, so that coming back to a known place takes out the drift, and
an absolute pose corrects the poses that were kept. Errors are right-invariant
(`infomap_ros.localization.filter.invariant_state`), so that the covariance can be trusted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular
from scipy.special import chdtri

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, PoseUncertainty, check_covariance, check_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.config import (
    FiducialFilterConfig,
    Fiducials,
    FilterUpdate,
    KeptPoses,
)
from infomap_ros.localization.filter.history import FiducialHistory
from infomap_ros.localization.filter.hypothesis_choice import CONTESTED, Image, explain
from infomap_ros.localization.filter.invariant_state import (
    CALIBRATION,
    FIXED_BLOCKS,
    InvariantState,
)
from infomap_ros.localization.filter.lie import renormalized, skews
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.filter.pose_hypothesis import Hypothesis
from infomap_ros.localization.filter.shared_errors import (
    CLONES,
    SharedErrors,
    invariant_difference,
    invariant_from_pose,
    most_redundant,
    pose_covariances,
    square_root,
)
from infomap_ros.localization.filter.sight import Measured

# A map whose frame is put elsewhere: all values and errors of the filter move with it.
#
# With ``X_new = T X_old`` and an error of T itself, all errors (xi, theta) of the invariant state
# become ``Ad(T) (xi, theta)`` plus that of T, which all share:
#
#     theta' = R theta + theta_T        xi' = R xi + skew(t) R theta + xi_T
#
# Nothing is linearized but the covariance of T.


def move_state(state: InvariantState, T_new_old: FloatArray, covariance: FloatArray) -> None:
    """Put the frame of a map elsewhere.

    Args:
        state: is changed.
        T_new_old: the frame as it was, in the new one, shape (4, 4).
        covariance: of that, in the new frame, shape (6, 6); zero for a mere change of names.
    """
    turn, shift = T_new_old[:3, :3], T_new_old[:3, 3]
    over = invariant_from_pose(T_new_old[None])[0]
    shared = _sharing(state) @ over @ covariance @ over.T @ _sharing(state).T
    once = _moved_errors(state, T_new_old, state.P)
    state.P[:] = _moved_errors(state, T_new_old, once.T) + shared
    state.P[:] = 0.5 * (state.P + state.P.T)
    state.considered[:] = _moved_errors(state, T_new_old, state.considered)
    state.T_map_camera = renormalized(T_new_old @ state.T_map_camera)
    state.positions = state.positions @ turn.T + shift
    state.kept = T_new_old @ state.kept


def _moved_errors(state: InvariantState, T_new_old: FloatArray, errors: FloatArray) -> FloatArray:
    """Errors in the new frame, shape (n, m), of columns of errors in the old one, (n, m)."""
    turn, lever = T_new_old[:3, :3], skews(T_new_old[:3, 3])
    blocks = errors.reshape(-1, 3, errors.shape[1])
    moved = np.asarray((turn @ blocks).reshape(errors.shape))
    moved[CALIBRATION] = errors[CALIBRATION]
    theta = moved[3:6].copy()
    moved[:3] += lever @ theta
    for rows in state.fiducial_rows(slice(None)):
        moved[rows] += lever @ theta
    for rows in np.vstack([state.kept_rows(), state.clone_rows()]):
        moved[rows[:3]] += lever @ moved[rows[3:]]
    return moved


def _sharing(state: InvariantState) -> FloatArray:
    """How an error (xi, theta) of everything enters all errors, shape (n, 6)."""
    over = np.zeros((len(state.P), 6))
    over[:6] = np.eye(6)
    over[state.fiducial_rows(slice(None)).ravel(), :3] = np.tile(np.eye(3), (len(state.ids), 1))
    for poses in (state.kept_rows(), state.clone_rows()):
        over[poses.ravel()] = np.tile(np.eye(6), (len(poses), 1))
    return over


def known_poses(state: InvariantState) -> KeptPoses:
    """The kept poses of a state."""
    rows = state.kept_rows()
    errors = state.covariance(rows[:, :, None], rows[:, None, :])
    covariances = pose_covariances(state.kept, errors)
    return KeptPoses(state.stamps.copy(), state.kept.copy(), covariances)


def known_fiducials(state: InvariantState) -> Fiducials:
    """The fiducials of a state."""
    rows = state.fiducial_rows(slice(None))
    over = np.zeros((len(rows), 3, 6))
    over[:, :, :3] = np.eye(3)
    over[:, :, 3:] = -skews(state.positions)
    rows = np.hstack([rows, np.broadcast_to(np.arange(3, 6), rows.shape)])
    errors = state.covariance(rows[:, :, None], rows[:, None, :])
    covariances = over @ errors @ over.transpose(0, 2, 1)
    return Fiducials(state.ids.copy(), state.positions.copy(), covariances)


_REST = MotionPrior(np.eye(4), np.zeros((6, 6)))


class FiducialFilter:
    """Estimates the camera's pose together with what it is known by.

    The order of use for each image is `predict`, `update`, and where new fiducials are wanted
    `add`.

    Args:
        camera: that measures the fiducials.
        config: gates and sizes.
    """

    def __init__(self, camera: PinholeCamera, config: FiducialFilterConfig | None = None) -> None:
        self.camera = camera
        self.config = config or FiducialFilterConfig()
        self._pose_limit = float(chdtri(6, 1.0 - self.config.joint_gate))
        self._shared = SharedErrors(InvariantState(np.eye(4), np.zeros((6, 6)), self._capacity))
        self.start(np.eye(4), np.zeros((6, 6)))

    def start(
        self,
        T_map_camera: ArrayLike,
        covariance: ArrayLike,
        calibration_sigmas: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        """Begin anew, with no fiducials and no kept poses.

        Args:
            T_map_camera: pose, shape (4, 4).
            covariance: in the map frame, shape (6, 6); zero where the pose defines the map.
            calibration_sigmas: of the camera, as `InvariantState` has them, shape (3,).

        Raises:
            InvalidInputError: not a rigid transform, or not a covariance.
        """
        pose = check_transform(T_map_camera, "T_map_camera")
        over = invariant_from_pose(pose[None])[0]
        errors = over @ check_covariance(covariance, 6) @ over.T
        self._state = InvariantState(pose, errors, self._capacity, calibration_sigmas)
        self._shared = self._shared.following(self._state)
        self._motion = _REST
        self._history = FiducialHistory(self.config.drift_memory, self.config.drift_gate)

    @property
    def _capacity(self) -> int:
        return (
            FIXED_BLOCKS + self.config.max_fiducials + 2 * (self.config.max_kept_poses + 1 + CLONES)
        )

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that it knows, as arrays that can be written to a file."""
        motion = {
            "motion": self._motion.T_before_after,
            "motion_covariance": self._motion.covariance,
        }
        return self._state.arrays() | self._history.state() | self._shared.state() | motion

    def resume(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on where another filter of the same sizes stood.

        Args:
            state: of that filter's `state`.

        Raises:
            InvalidInputError: it holds more than this filter can.
        """
        self._state = InvariantState.resume(state, self._capacity)
        self._motion = MotionPrior(state["motion"], state["motion_covariance"])
        self._history = FiducialHistory(self.config.drift_memory, self.config.drift_gate)
        self._history.resume(state)
        self._shared.resume(state)

    @property
    def pose(self) -> tuple[FloatArray, FloatArray]:
        """``T_map_camera``, shape (4, 4), and its covariance in the map frame, shape (6, 6)."""
        pose, pending = self._state.expected(self._motion)
        rows = np.arange(6)
        P = self._state.covariance(rows[:, None], rows) + pending
        return pose, pose_covariances(pose[None], P[None])[0]

    @property
    def covariance_by_calibration(self) -> FloatArray:
        """Covariance of the pose in the map frame if the calibration were right, shape (6, 6).

        It tells how well the camera is known among the things that it sees.
        """
        pose, pending = self._state.expected(self._motion)
        return pose_covariances(pose[None], (self._state.P[:6, :6] + pending)[None])[0]

    def divide_covariance(self, *, is_keyframe: bool) -> PoseUncertainty:
        """The parts of the present pose's covariance; once for each image.

        Args:
            is_keyframe: whether later poses are compared with this one.
        """
        return self._shared.divide(self._state, self._motion, is_keyframe=is_keyframe)

    def predict(self, prior: MotionPrior) -> None:
        """Take that the camera has moved; several motions add up."""
        self._motion = self._motion.then(prior)

    def update(
        self, observations: FiducialObservations, more: MotionPrior | None = None
    ) -> FilterUpdate:
        """Correct everything by the known fiducials of an image.

        Where it is not consistent nothing changes: the pose stays the predicted one.

        Args:
            observations: of the image.
            more: motion beyond what was predicted, on trial: it is taken where it explains the
                image.
        """
        motion = self._motion if more is None else self._motion.then(more)
        indices, is_known = self._look_up(observations.ids)
        known = observations.select(is_known).corrected(self.camera, self._state.calibration)
        unknown = observations.ids[~is_known]
        measured = Measured.of(self.camera, known)
        image = Image(known.ids, indices, measured)
        chosen, reason, overruled = explain(self._state, motion, image, self._history, self.config)
        if chosen is None:
            if reason in CONTESTED and more is None:
                self._history.contradicted(known.ids)
            nothing = np.zeros(0, np.int64)
            return FilterUpdate(False, reason, nothing, nothing, unknown, np.nan, 0, np.nan)
        self._motion = motion
        self._history.agreed(known.ids, chosen.members, chosen.innovations)
        self._apply(chosen, indices)
        used, rejected = known.ids[chosen.members], known.ids[chosen.rejected]
        return FilterUpdate(
            True, "", used, rejected, unknown, chosen.correction.nis,
            chosen.degrees_of_freedom, chosen.motion_nis, overruled,
        )  # fmt: skip

    def add(self, observations: FiducialObservations) -> NDArray[np.int64]:
        """Add new fiducials, as seen from the present pose.

        Where there are too many, those that were seen least often, and of these the longest ago,
        make room.

        Args:
            observations: those without a certain range, and those that are known, are left out.

        Returns:
            Ids of those that were added, shape (A,).
        """
        _, is_known = self._look_up(observations.ids)
        with np.errstate(invalid="ignore"):
            certainty = observations.inverse_depths / observations.inverse_depth_sigmas
            certain = certainty >= self.config.range_certainty
        new = observations.select(np.flatnonzero(~is_known & certain)[: self.config.max_fiducials])
        new = new.corrected(self.camera, self._state.calibration)
        self._take_motion()
        self._make_room(len(new))
        points, covariances = new.points(self.camera), new.covariances(self.camera)
        self._state.add_fiducials(new.ids, points, covariances)
        self._history.begin(new.ids)
        return new.ids

    def add_landmarks(
        self, ids: ArrayLike, points: ArrayLike, covariance: ArrayLike, *, in_map: bool = False
    ) -> None:
        """Add points that are never taken for others: one in view is enough for an update.

        Args:
            ids: below zero, shape (M,), none of them known.
            points: in the camera frame, as a known size tells them, or in the map, (M, 3) [m].
            covariance: of all together, shape (3M, 3M) [m^2].
            in_map: whether the points are in the map.
        """
        names, places = np.asarray(ids, np.int64), np.asarray(points, np.float64)
        self._take_motion()
        self._make_room(len(names))
        add = self._state.place_fiducials if in_map else self._state.add_fiducials
        add(names, places, np.asarray(covariance, np.float64))
        self._history.begin(names)

    def observe_pose(self, T_map_camera: ArrayLike, covariance: ArrayLike) -> bool:
        """Correct everything by an absolute pose, as of the target.

        Args:
            T_map_camera: pose, shape (4, 4).
            covariance: in the map frame, shape (6, 6).

        Returns:
            Whether it agreed with what was known; if not, nothing is changed.

        Raises:
            InvalidInputError: not a rigid transform, or not a covariance.
        """
        measured = check_transform(T_map_camera, "T_map_camera")
        noise = check_covariance(covariance, 6)
        self._take_motion()
        state = self._state
        P, over = state.P, invariant_from_pose(measured[None])[0]
        S = P[:6, :6] + over @ noise @ over.T
        innovation = invariant_difference(measured, state.T_map_camera)
        try:
            factor = np.linalg.cholesky(S)
        except np.linalg.LinAlgError:  # noise that vanishes in rounding beside P
            return False
        pull = solve_triangular(factor, innovation, lower=True)
        if float(pull @ pull) > self._pose_limit:
            return False
        white = solve_triangular(factor, P[:6], lower=True)
        considered = solve_triangular(factor, state.considered[:6], lower=True)
        state.learn(white.T @ pull, white, considered)
        self._shared.is_corrected = True
        return True

    def keep_pose(self, stamp: int) -> NDArray[np.int64]:
        """Keep the present pose, so that later images correct it too.

        Where there are too many, the one that is nearest to its neighbors in time is forgotten,
        never the first or the new one.

        Args:
            stamp: [ns], later than those kept.

        Returns:
            Stamps of poses that were forgotten, shape (F,).

        Raises:
            InvalidInputError: the stamp is not later than those kept.
        """
        state = self._state
        if len(state.stamps) and stamp <= state.stamps[-1]:
            raise InvalidInputError("stamp", f"{stamp} is not later than {state.stamps[-1]}")
        self._take_motion()
        state.keep_pose(stamp)
        forgotten = np.zeros(0, np.int64)
        if len(state.stamps) > self.config.max_kept_poses:
            forgotten = state.stamps[[most_redundant(state.stamps, state.kept)]]
            self.forget_poses(forgotten)
        return forgotten

    def kept_poses(self) -> KeptPoses:
        """The kept poses as they are known now."""
        return known_poses(self._state)

    def forget_poses(self, stamps: ArrayLike) -> None:
        """Keep the poses of these stamps no longer; others are ignored."""
        self._state.remove_kept(np.isin(self._state.stamps, np.asarray(stamps, np.int64)))

    def move(self, T_new_old: FloatArray, covariance: FloatArray) -> None:
        """Put the map's frame elsewhere; see `move_state`."""
        move_state(self._state, T_new_old, covariance)

    def fiducials(self) -> Fiducials:
        """The fiducials as they are known now."""
        return known_fiducials(self._state)

    def remove(self, ids: ArrayLike) -> None:
        """Forget fiducials; ids that are not held are ignored."""
        gone = np.isin(self._state.ids, np.asarray(ids, np.int64))
        self._history.forget(self._state.ids[gone])
        self._state.remove_fiducials(gone)

    def _look_up(self, ids: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Indices in the state of those ids that are known, and which are."""
        order = np.argsort(self._state.ids)
        found = np.searchsorted(self._state.ids, ids, sorter=order)
        found = order[np.minimum(found, len(order) - 1)] if len(order) else found
        known = np.isin(ids, self._state.ids)
        return found[known], known

    def _make_room(self, count: int) -> None:
        """Forget so many fiducials that new ones find room."""
        surplus = len(self._state.ids) + count - self.config.max_fiducials
        if surplus > 0:
            self.remove(self._history.least_useful(self._state.ids, surplus))

    def _take_motion(self) -> None:
        """Make the predicted motion part of the state."""
        if self._motion is _REST:
            return
        state = self._state
        pose = state.T_map_camera @ self._motion.T_before_after
        noise = state.motion_noise(pose, state.T_map_camera[:3, :3])
        root = noise @ square_root(self._motion.covariance)
        state.add_to_covariance(root, root.T)
        state.T_map_camera = pose
        self._motion = _REST

    def _apply(self, chosen: Hypothesis, indices: NDArray[np.int64]) -> None:
        """Correct the state by the members of a hypothesis, eq. (18)."""
        state, expectation = self._state, chosen.expectation
        members = indices[chosen.members]
        rows, every = state.fiducial_rows(members).ravel(), np.arange(len(state.P))
        noise = expectation.noise[rows] - np.tile(expectation.noise[:3], (len(members), 1))
        seen = state.apparent_errors(members, expectation.T_map_camera, every)
        seen += noise @ expectation.motion_covariance @ expectation.noise.T
        white = chosen.correction.whitened(seen)
        considered = state.apparent_considered(members, expectation.T_map_camera)
        considered = chosen.correction.whitened(considered)
        pull = solve_triangular(
            chosen.correction.factor, chosen.correction.innovation, lower=True, check_finite=False
        )
        root = expectation.noise @ square_root(expectation.motion_covariance)
        state.T_map_camera = expectation.T_map_camera
        error = expectation.noise @ expectation.shift + white.T @ pull
        state.add_to_covariance(root, root.T)
        state.learn(error, white, considered)
        self._motion, self._shared.is_corrected = _REST, True
