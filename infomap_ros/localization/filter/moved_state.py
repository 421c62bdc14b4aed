"""A map whose frame is put elsewhere: all values and errors of the filter move with it.

With ``X_new = T X_old`` and an error of T itself, all errors (xi, theta) of the invariant state
become ``Ad(T) (xi, theta)`` plus that of T, which all share:

    theta' = R theta + theta_T        xi' = R xi + skew(t) R theta + xi_T

Nothing is linearized but the covariance of T.
"""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.invariant_state import CALIBRATION, InvariantState
from infomap_ros.localization.filter.lie import renormalized, skews
from infomap_ros.localization.filter.pose_errors import invariant_from_pose


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
